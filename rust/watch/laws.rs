//! What the noise is assumed to be, and the bets that follow: of expectation at most 1 for every system of the region.

use crate::named::named;

/// Largest factor of one bet, and largest evidence of a start: cutting a factor lowers it, which is valid.
pub(super) const LARGEST: f64 = 1e260;
/// Of the standard deviation: where a bet on symmetric noise is cut.
const CUT: f64 = 1.5;

/// The law of the noise `w` given the past, with `Sbar` the bound of its covariance. With `v >= var(x)` and `p` what
/// the region may add to `x`:
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Laws {
    /// Mean 0 and `Cov <= Sbar`: `exp(phi(a (x - p))) / (1 + a^2 v / 2)`, `phi(t) = sign(t) log(1 + |t| + t^2 / 2)`;
    /// valid as `exp(phi(t)) <= 1 + t + t^2 / 2` and phi rises.
    Variance,
    /// Gaussian, or sub-Gaussian with proxy `Sbar`: `exp(a (x - p) - a^2 v / 2)`.
    Gaussian,
    /// Symmetric: `1 + b clip((x - p) / s, -1, 1)`, `s = 1.5 sqrt(v)`.
    Symmetric,
    /// Mean 0 and `w' Sbar^-1 w <= 1`: as Gaussian (Hoeffding), and `|x| > p + sqrt(v)` is impossible.
    Bounded,
}

named!(Laws { Variance => "variance", Gaussian => "gaussian", Symmetric => "symmetric", Bounded => "bounded" });

/// `1 + |t| + t^2 / 2`.
fn square(t: f64) -> f64 {
    1.0 + t.abs() + 0.5 * t * t
}

/// `exp(phi(t))`.
fn tempered(t: f64) -> f64 {
    if t >= 0.0 { square(t) } else { 1.0 / square(t) }
}

impl Laws {
    /// The factor of one step for the amplitude `a >= 0`, a number of the past.
    #[must_use]
    pub fn factor(self, a: f64, x: f64, p: f64, v: f64) -> f64 {
        if a <= 0.0 || v <= 0.0 {
            return 1.0;
        }
        let t = a * (x - p);
        let factor = match self {
            Self::Variance => tempered(t) / (1.0 + 0.5 * a * a * v),
            Self::Gaussian => (t - 0.5 * a * a * v).exp(),
            Self::Bounded if x > p + v.sqrt() * (1.0 + 1e-9) => LARGEST,
            Self::Bounded => (t - 0.5 * a * a * v).exp(),
            Self::Symmetric => {
                let deviation = v.sqrt();
                1.0 + (CUT * a * deviation).min(0.9) * ((x - p) / (CUT * deviation)).clamp(-1.0, 1.0)
            }
        };
        if factor.is_nan() { 0.0 } else { factor.min(LARGEST) }
    }

    /// What a block adds up for a constant system: parts of `log` of the factor without p that are odd and even in x,
    /// and `phi'`; finite numbers.
    #[must_use]
    pub fn block(self, s: f64, x: f64, v: f64) -> [f64; 3] {
        let (t, even) = ((s * x).clamp(-1e150, 1e150), (0.5 * s * s * v).min(1e290));
        if self == Self::Variance {
            [t.signum() * square(t).ln(), even.ln_1p(), (1.0 + t.abs()) / square(t)]
        } else {
            [t, even, 1.0]
        }
    }

    /// What a block subtracts for `|phi''| <= 1/4`, in `s^2 sum p^2`; 0 where phi is linear.
    #[must_use]
    pub fn curvature(self) -> f64 {
        if self == Self::Variance { 0.125 } else { 0.0 }
    }

    /// The factor of a bet on the energy `r^2`, `r <= ||Sbar^(-1/2) w||` in `n` dimensions, with the share `b` in (0,
    /// 1): `1 - b + b r^2 / n`, for Gaussian noise `(1 - b)^(n/2) exp(b r^2 / 2)`.
    #[must_use]
    pub fn energy(self, b: f64, r: f64, n: usize) -> f64 {
        match self {
            Self::Gaussian => (0.5 * (n as f64 * (-b).ln_1p() + b * r * r)).exp(),
            Self::Bounded if r > 1.0 + 1e-9 => LARGEST,
            Self::Bounded => 1.0 - b + b * r * r,
            Self::Variance | Self::Symmetric => 1.0 - b + b * r * r / n as f64,
        }
    }

    /// The shares of the bets on the energy; none where it has no bound.
    #[must_use]
    pub fn shares(self) -> &'static [f64] {
        match self {
            Self::Gaussian => &[0.1, 0.3, 0.6, 0.9],
            Self::Variance | Self::Bounded => &[0.05, 0.2, 0.5, 0.9],
            Self::Symmetric => &[],
        }
    }
}
