//! Quantiles of the length of a normal vector: of `sqrt(sum_i lam_i g_i^2)`, g standard normal.
//!
//! With `b = min lam_i`, `sum_i lam_i g_i^2 / b` is a mixture of chi^2 of `n + 2 k` degrees with weights (Ruben 1962)
//!
//! ```text
//! a_0 = prod sqrt(b / lam_i),    a_{k+1} = sum_i h_i / (2 (k + 1)),    h_i <- (1 - b / lam_i) (h_i + a_k).
//! ```
//!
//! All are positive with sum 1, so that for every `last`,
//! `sum_{k<=last} a_k P(chi^2_{n+2k} > x) + 1 - sum_{k<=last} a_k` is an upper bound of the tail.

use statrs::function::gamma::{checked_gamma_ur, ln_gamma};

use crate::error::{Error, Result};
use crate::memory::{try_push, try_room, try_zeros};

use super::distributions::{chi2_upper, level};
use super::symmetric::Symmetric;

const WHAT: &str = "the quantile of a normal vector";
/// Eigenvalues are raised to this share of the largest, which widens the quantile by less than .0005 at `n = 4` and
/// bounds the number of terms.
const LEAST: f64 = 1e-3;
/// The same where a tenth of the time is worth .005.
const COARSE: f64 = 1e-2;
/// What the weights that are left out may sum up to, and what is added to the tail for rounding.
const LEFT: f64 = 1e-12;
const ROUNDING: f64 = 1e-11;
/// Eigenvalues of singular matrices by rounding, of the largest.
const NOTHING: f64 = 1e-15;
/// A level that this does not change by more than .1 %.
const SMALL: f64 = 1e-8;

/// `t` with `P(||x|| > t) <= delta` for normal x of mean 0 and this `covariance` (n, n), symmetric; nearly equal, as
/// `LEAST` allows. Infinite where an entry is not finite.
///
/// # Errors
/// [`Error::Shape`], [`Error::Value`] for a `delta` outside (0, 1), [`Error::Memory`].
pub fn normal_quantile(covariance: &[f64], n: usize, delta: f64) -> Result<f64> {
    raised_quantile(covariance, n, delta, LEAST)
}

/// [`normal_quantile`], wider by .005 at `n = 4` and in a tenth of the time.
pub(crate) fn coarse_normal_quantile(covariance: &[f64], n: usize, delta: f64) -> Result<f64> {
    raised_quantile(covariance, n, delta, COARSE)
}

fn raised_quantile(covariance: &[f64], n: usize, delta: f64, least: f64) -> Result<f64> {
    level("delta", delta)?;
    if covariance.len() != n * n {
        let (expected, found) = (format!("{n} x {n} entries"), covariance.len().to_string());
        return Err(Error::Shape { name: "covariance", expected, found });
    }
    if !covariance.iter().all(|v| v.is_finite()) {
        return Ok(f64::INFINITY);
    }
    let mut small = Symmetric::new(n)?;
    small.matrix.copy_from_slice(covariance);
    let values = small.eigenvalues()?;
    let largest = values.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return Ok(0.0);
    }
    // eigenvalues below rounding are left out; chi^2_n > 200 + 3 n has probability below LEFT
    let (mut ratios, nothing) = (try_room(WHAT, n)?, NOTHING * n as f64);
    let values = values.iter().map(|v| v / largest);
    ratios.extend(values.filter(|v| *v > nothing).map(|v| v.max(least)));
    let rest = nothing * (200.0 + 3.0 * n as f64) * f64::from(u8::from(ratios.len() < n));
    Ok(((quantile(&ratios, delta)? + rest) * largest).sqrt())
}

/// `x` with `P(sum_i lam_i g_i^2 > x) = delta`, the largest `lam_i` being 1.
///
/// By Newton's steps for the logarithm of the tail from the quantile of the chi^2 with the same mean and variance;
/// above, it is `sum lam_i + 2 sqrt(sum lam_i^2 l) + 2 l`, `l = log(1 / delta)` (Laurent and Massart 2000).
fn quantile(lam: &[f64], delta: f64) -> Result<f64> {
    const CLOSE: f64 = 1e-7;
    if delta < SMALL {
        return chi2_upper(delta, lam.len() as f64); // as if all were as large
    }
    let (half, least, log) = (lam.len() as f64 / 2.0, lam.iter().copied().fold(1.0, f64::min), -delta.ln());
    let (sum, squares) = lam.iter().fold((0.0, 0.0), |(sum, squares), v| (sum + v, squares + v * v));
    let (mut low, mut high) = (0.0, 1.01 * (sum + 2.0 * (squares * log).sqrt() + 2.0 * log));
    let weights = Weights::new(lam, least, high / (2.0 * least))?;
    let missing = (1.0 - weights.total()).max(0.0) + ROUNDING;
    let tail = |x: f64| {
        let (above, density) = weights.above(x / (2.0 * least), half);
        (missing + above, density / (2.0 * least))
    };
    let mut at = (squares / sum * about_chi2(delta, sum * sum / squares)).min(high);
    for _ in 0..200 {
        let (value, density) = tail(at);
        if value <= delta {
            high = at
        } else {
            low = at
        }
        let mut next = at + (value / delta).ln() * value / density;
        if (next - at).abs() <= CLOSE * at {
            // where the tail is not above delta
            let mut room = 1e-12;
            while tail(next * (1.0 + room)).0 > delta && room < CLOSE {
                room *= 4.0;
            }
            if room < CLOSE {
                return Ok(next * (1.0 + room));
            }
        }
        if !(next > low && next < high) {
            next = f64::midpoint(low, high);
        }
        at = next;
    }
    Err(Error::Numerical("a quantile of the length of a normal vector did not converge".into()))
}

/// Near the upper quantile of chi^2 (Wilson and Hilferty 1931; the normal one by Hastings 1955).
fn about_chi2(delta: f64, degrees: f64) -> f64 {
    let t = (-2.0 * delta.min(1.0 - delta).ln()).sqrt();
    let z = t - (2.515517 + t * (0.802853 + t * 0.010328)) / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)));
    let share = 2.0 / (9.0 * degrees);
    degrees * (1.0 - share + z.copysign(0.5 - delta) * share.sqrt()).max(0.05).powi(3)
}

/// `a_first, a_{first+1}, ..`, those before being nearly 0, until all but `LEFT` is there or those that are left are
/// multiplied by nearly 1, and the sums of those before each.
struct Weights {
    first: f64,
    a: Vec<f64>,
    before: Vec<f64>,
}

impl Weights {
    /// For tails at `x` and below.
    fn new(lam: &[f64], least: f64, x: f64) -> Result<Self> {
        const LARGE: f64 = 1e200;
        const MOST: usize = 2_000_000;
        let nearly = LEFT * 1e-6;
        let (mut log, mut a) = (0.5 * lam.iter().map(|v| (least / v).ln()).sum::<f64>(), 1.0);
        let mut found = Self { first: 0.0, a: try_room(WHAT, 64)?, before: try_room(WHAT, 64)? };
        // 1 - b / lam_i, those that are 0 left out
        const SIDE: usize = 4;
        let mut g = try_room::<f64>(WHAT, lam.len() + SIDE)?;
        g.extend(lam.iter().map(|lam| 1.0 - least / lam).filter(|g| *g > 0.0));
        g.resize(g.len().next_multiple_of(SIDE), 0.0);
        let (mut h, mut sum) = (try_zeros::<f64>(WHAT, g.len())?, 0.0);
        // P(Poisson(x) >= k) is below e^-30 from here on (Bernstein's inequality)
        let last = MOST.min((x + 20.0 + (100.0 + 60.0 * x).sqrt()) as usize);
        for k in 0..last {
            let weight = a * f64::exp(log);
            if found.a.is_empty() && weight <= nearly {
                found.first = (k + 1) as f64;
            } else {
                try_push(WHAT, &mut found.a, weight)?;
                try_push(WHAT, &mut found.before, sum)?;
                sum += weight;
            }
            if sum >= 1.0 - LEFT || (sum > 0.5 && weight < nearly) {
                break;
            }
            let mut next = [0.0; SIDE];
            for (h, g) in h.chunks_exact_mut(SIDE).zip(g.chunks_exact(SIDE)) {
                for ((h, g), next) in h.iter_mut().zip(g).zip(&mut next) {
                    *h = g * (*h + a);
                    *next += *h;
                }
            }
            a = next.iter().sum::<f64>() * (0.5 / (k + 1) as f64);
            if a > LARGE {
                (a, log) = (a / LARGE, log + LARGE.ln());
                h.iter_mut().for_each(|h| *h /= LARGE);
            }
        }
        Ok(found)
    }

    fn total(&self) -> f64 {
        self.before.last().copied().unwrap_or(0.0) + self.a.last().copied().unwrap_or(0.0)
    }

    /// An upper bound of `sum a_k Q(half + k, x)`, Q the upper incomplete gamma function, which rises with k:
    /// `Q(s + 1, x) = Q(s, x) + x^s e^-x / Gamma(s + 1)`; and nearly how fast it falls with x.
    fn above(&self, x: f64, half: f64) -> (f64, f64) {
        // far below the mean x the terms are nearly 0, far above it nearly 1
        let low = (x - half - 12.0 * x.sqrt() - 50.0 - self.first).floor().clamp(0.0, self.a.len() as f64);
        let at = low as usize;
        let mut s = half + self.first + low;
        let mut q = checked_gamma_ur(s, x).unwrap_or(1.0);
        let mut size = (s * x.ln() - x - ln_gamma(s + 1.0)).exp();
        let (mut sum, mut density) = (q * self.before.get(at).copied().unwrap_or(self.total()), 0.0);
        for (a, before) in self.a[at..].iter().zip(&self.before[at..]) {
            if q >= 1.0 {
                sum += self.total() - before;
                break;
            }
            sum += a * q;
            density += a * s * size;
            q = if s > x && size < 1e-17 { 1.0 } else { (q + size).min(1.0) };
            s += 1.0;
            size *= x / s;
        }
        // relative error of x^s e^-x / Gamma(s + 1) from its logarithm
        (sum * (1.0 + 8.0 * f64::EPSILON * (x * x.max(2.0).ln() + 10.0)), density / x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Not below, and above by what the tail is kept below `delta`: 1.2e-11, relative to a delta of 0.04 at least.
    fn check(lam: &[f64], delta: f64, expected: f64) {
        let above = quantile(lam, delta).unwrap() / expected - 1.0;
        assert!(-1e-12 < above && above < 3e-10, "{lam:?} {delta}: {above:e}");
    }

    #[test]
    fn known_quantiles() {
        check(&[1.0, 1.0], 0.05, 2.0 * 20f64.ln());
        check(&[1.0, 0.25], 0.05, 4.144720728963);
        check(&[1.0, 0.5, 0.25], 0.04, 5.302345035389);
        check(&[1.0, 0.75, 0.5, 0.25], 0.04, 26.727927802189 / 4.0);
        check(&[1.0, 0.1, 0.01, 0.001], 0.04, 4.335753820206);
        check(&[1.0, 1e-3, 1e-3, 1e-3], 0.04, 4.220886445195);
        check(&[1.0], 0.05, 3.841458820694124);
    }

    /// Two unequal variances: the tail is the mean of `exp(-t / (2 (lam_1 cos^2 + lam_2 sin^2)))` over an angle.
    #[test]
    fn two_dimensions_by_quadrature() {
        for (other, delta) in [(0.6, 0.3), (0.1, 1e-3), (0.01, 1e-6), (0.003, 0.05), (1e-3, 0.9)] {
            let t = quantile(&[1.0, other], delta).unwrap();
            let points = 4000;
            let angle = |i: usize| (f64::from(i as u32) + 0.5) * std::f64::consts::PI / f64::from(points as u32);
            let at = |phi: f64| (-t / (2.0 * (phi.cos().powi(2) + other * phi.sin().powi(2)))).exp();
            let tail = (0..points).map(|i| at(angle(i))).sum::<f64>() / f64::from(points as u32);
            assert!(tail <= delta && tail >= delta - 1.2e-11 - 1e-9 * delta, "{other} {delta}: {tail}");
        }
    }

    /// Many directions of nearly no size do not leave the range of doubles.
    #[test]
    fn many_dimensions() {
        let mut lam = [LEAST; 300];
        lam[0] = 1.0;
        let found = quantile(&lam, 0.05).unwrap();
        assert!(found > 3.841 + 0.299 && found < 3.841 + 0.31, "{found}");
        assert_eq!(normal_quantile(&[0.0; 4], 2, 0.05), Ok(0.0));
        assert_eq!(normal_quantile(&[], 0, 0.05), Ok(0.0));
        let one = normal_quantile(&[4.0, 2.0, 2.0, 1.0], 2, 0.05).unwrap(); // rank one
        assert!((one / (5.0f64.sqrt() * 1.959963984540) - 1.0).abs() < 3e-10);
    }
}
