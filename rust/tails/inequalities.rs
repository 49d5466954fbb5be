//! The inequalities, as formulas of a setting, its rates and a level `L = log(1 / delta)`.

use super::control::FusedControl;
use super::lines::{Lines, Norm};
use crate::error::Result;
use crate::named::named;

/// The level of a tenth of delta, the share of an event that is not the main one.
const SHARE: f64 = std::f64::consts::LN_10;
/// The largest error can occur, and is rounded, too.
const ABOVE_ROUNDING: f64 = 1.0 + 1e-12;

/// An inequality, and with a setting the error that is exceeded with probability `exp(-level)` at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Inequality {
    /// `U l / 3 + sqrt((U l / 3)^2 + 2 v l)` for matrices, `l = log((n + m) / delta)`, best for large ones: J. A.
    /// Tropp, "User-friendly tail bounds for sums of random matrices", Found. Comput. Math. 12, 2012. `v` is the
    /// larger of `||T_A(1)||_2` and `max_j (g_j^2 - ||a_j||^2)`, over N, and `U` the largest deviation of one line of
    /// one realization, over N: the average is a sum of `N m` independent matrices of rank one. Exact and zero lines do
    /// not count in n and m.
    Bernstein,
    /// `E + sqrt(2 L (lam + 2 U E)) + U L / 3`, for many realizations, which is Talagrand's inequality for the supremum
    /// of `<v, average - mean>` over unit vectors v: E its mean, at most the root mean square, `lam` the largest
    /// variance of a projection, `U` the largest deviation of one of N independent terms over N. O. Bousquet, "A
    /// Bennett concentration inequality and its application to suprema of empirical processes", C. R. Acad. Sci. Paris
    /// 334, 2002.
    ///
    /// Of a product, `y_hat - y = [(xf_hat - xf) - A (x0_hat - x0) - (A_hat - A) x0] - (A_hat - A)(x0_hat - x0)`: the
    /// bracket is the average of N independent terms, one for each index (one size for all), with 0.8 delta. The rest
    /// is O(1/N): with `||x0_hat - x0|| <= r` (0.1 delta), given `x0_hat`, McDiarmid with 0.1 delta. With `x0` or `A`
    /// exact there is no rest, and the bracket has all of delta.
    Bousquet,
    /// `E + sqrt(V L)` for products, E the root mean square, for `x0_hat` near `x0` or for any `x0_hat`: C. McDiarmid,
    /// "On the method of bounded differences", Surveys in Combinatorics, 1989. The smaller of two: in one
    /// `||x0_hat - x0||` exceeds its own bound with probability `delta/10`, and the rest of delta is for McDiarmid. For
    /// the state this implies the exponent `N t^2 / (gf^2 + 3 g0^2 gA^2)`. The sizes of the entities may differ.
    McDiarmid,
    /// `g sqrt(2 (log(2^n - 2) + L) / N)` for a vector in the 1-norm, n nonzero entries, best for few:
    /// `P(||p_hat - p||_1 >= eps) <= (2^n - 2) exp(-N eps^2 / 2)`, T. Weissman et al., "Inequalities for the L1
    /// deviation of the empirical distribution", HP Laboratories, HPL-2003-97, 2003. In the 2-norm it is smaller by
    /// `sqrt(2)`: the errors of the frequencies add up to 0, and then `||z||_1 >= sqrt(2) ||z||_2`.
    Weissman,
    /// `sqrt(sum_j k_j g_j^2) / N` for systematic samples, never exceeded, for every delta: each of the `k_j` nonzero
    /// entries of a line is hit `floor(N p_i)` or `ceil(N p_i)` times.
    Systematic,
}

named!(Inequality {
    Bernstein => "Bernstein",
    Bousquet => "Bousquet",
    McDiarmid => "McDiarmid",
    Weissman => "Weissman",
    Systematic => "systematic",
});

impl Lines {
    /// The bound, where the inequality is one for lines; its rate is `1 / N`.
    #[must_use]
    pub fn radius(&self, by: Inequality, rate: f64, level: f64) -> Option<f64> {
        let (lines, entries, nonzero) = self.sizes;
        Some(match by {
            Inequality::Bousquet => {
                supremum((self.mean_square * rate).sqrt(), self.top * rate, self.farthest * rate, level)
            }
            Inequality::Bernstein => {
                let exponent = level + ((lines + entries).max(1) as f64).ln();
                let linear = self.deviation.sqrt() * rate * exponent / 3.0;
                linear + (linear * linear + 2.0 * self.variance * rate * exponent).sqrt()
            }
            Inequality::Weissman => {
                let n = nonzero as f64;
                // log(2^n - 2)
                let sets = if nonzero > 1 { n * 2f64.ln() + (-(2f64.powf(1.0 - n))).ln_1p() } else { 0.0 };
                let factor = if self.norm == Norm::One { 2.0 } else { 1.0 };
                self.g * (factor * rate * (sets + level)).sqrt()
            }
            Inequality::Systematic => self.hits.sqrt() * rate,
            Inequality::McDiarmid => return None,
        })
    }

    /// The largest possible error, for every rate, with what rounding may add to it.
    #[must_use]
    pub fn cap(&self) -> f64 {
        self.farthest * ABOVE_ROUNDING
    }
}

impl FusedControl {
    /// The bound, where the inequality is one for this fusion.
    ///
    /// # Errors
    /// [`Error::Numerical`](crate::Error::Numerical), [`Error::Memory`](crate::Error::Memory).
    pub fn radius(&self, by: Inequality, rates: [f64; 3], level: f64) -> Result<Option<f64>> {
        let most = rates.iter().fold(0.0f64, |m, rate| m.max(*rate));
        let mean = self.mean_square(rates).sqrt();
        Ok(Some(match by {
            Inequality::Bousquet if self.paired => {
                supremum(mean, self.variance(rates)?, self.farthest(rates) * most, level)
            }
            Inequality::Bousquet => self.product_bousquet(rates, most, level)?,
            Inequality::McDiarmid if !self.paired => self.mcdiarmid(rates, mean, level),
            _ => return Ok(None),
        }))
    }

    /// The largest possible error, or a larger number, with what rounding may add to it.
    #[must_use]
    pub fn cap(&self, rates: [f64; 3]) -> f64 {
        self.farthest(rates) * ABOVE_ROUNDING
    }

    fn mcdiarmid(&self, rates: [f64; 3], mean: f64, level: f64) -> f64 {
        let (at, [r0, _, ra]) = (&self.image, rates);
        let range = at.range(&at.x0);
        if r0 == 0.0 || ra == 0.0 {
            return differences(mean, self.spread(rates, range), level);
        }
        let surely = differences(mean, self.spread(rates, at.cap_a), level);
        let likely = range + at.slope_a * self.distance(r0, level + SHARE);
        surely.min(differences(mean, self.spread(rates, likely), level - 0.9f64.ln()))
    }

    fn product_bousquet(&self, rates: [f64; 3], most: f64, level: f64) -> Result<f64> {
        let (at, [r0, _, ra]) = (&self.image, rates);
        let bracket = [self.linear_rms(rates), self.variance(rates)?, self.farthest_linear(rates) * most];
        let linear = |level| supremum(bracket[0], bracket[1], bracket[2], level);
        if r0 == 0.0 || ra == 0.0 {
            return Ok(linear(level));
        }
        let share = level + SHARE;
        let hit = at.tau.iter().zip(&at.x0).filter(|(_, x)| **x != 0.0);
        let largest_tau = hit.fold(0.0f64, |m, (tau, _)| m.max(*tau));
        let rest = differences((largest_tau * ra).sqrt(), at.slope_a * at.slope_a * ra / 2.0, share);
        Ok(linear(level - 0.8f64.ln()) + self.distance(r0, share) * rest)
    }

    /// A bound of `||x0_hat - x0||_2`: the smaller one of Bousquet and Weissman.
    fn distance(&self, rate: f64, level: f64) -> f64 {
        let start = &self.start;
        let found = [Inequality::Bousquet, Inequality::Weissman].map(|by| start.radius(by, rate, level));
        start.unit * found.into_iter().flatten().fold(start.cap(), f64::min)
    }
}

/// `E + sqrt(V L)`
fn differences(mean: f64, spread: f64, level: f64) -> f64 {
    mean + (spread * level).sqrt()
}

/// `E + sqrt(2 L (lam + 2 U E)) + U L / 3`
fn supremum(mean: f64, variance: f64, largest: f64, level: f64) -> f64 {
    mean + (2.0 * level * (variance + 2.0 * largest * mean)).sqrt() + largest * level / 3.0
}
