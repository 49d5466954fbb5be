//! The fused control under uniform weights, or the state it leads to.

use std::sync::OnceLock;

use super::image::{Image, Problem};
use super::lines::{Lines, Norm};
use super::moments::Moments;
use super::sizes::WHAT;
use crate::control::symmetric_norm;
use crate::error::Result;
use crate::memory::try_collect;

/// The numbers of a fused control, for rates of `x0`, `xf` and `A`.
///
/// The error is `||B (u - v*)||_2` or `||u - v*||_2` for `v* = B^+ (xf - A x0)`. The paper's lemmas use norms of the
/// data; moments and diameters here are those of the image under `B B^+` (state) or `B^+` (control), never larger. By
/// product fusion the error is bilinear: `y_hat - y = (xf_hat - xf) - A (x0_hat - x0) - (A_hat - A) x0_hat`. By
/// diagonal fusion it is that of the average of N pairs, `xf^s` and `z^s = A^s x0^s`; one size for all that is not
/// exact.
#[derive(Debug)]
pub struct FusedControl {
    /// What realizations can be.
    pub image: Image,
    pub(super) paired: bool,
    /// The average of the realizations of `x0`.
    pub(super) start: Lines,
    moments: Moments,
    /// Largest eigenvalues of the sums of covariances, by which of them are in it.
    tops: [OnceLock<f64>; 16],
}

impl FusedControl {
    /// The numbers of a problem.
    ///
    /// # Errors
    /// As [`Image::new`].
    pub fn new(of: Problem<'_>) -> Result<Self> {
        let image = Image::new(of)?;
        let (start, moments) = (Lines::new(&image.x0, image.n, Norm::Frobenius)?, Moments::new(&image)?);
        Ok(Self { image, paired: of.paired, start, moments, tops: Default::default() })
    }

    /// `E||M (y_hat - y)||^2`, exact.
    #[must_use]
    pub fn mean_square(&self, [r0, rf, ra]: [f64; 3]) -> f64 {
        let [t0, tf, ta, ta0] = self.moments.traces;
        // r (C0 + CA + CA0) where both are sampled in pairs: the last term does not get r^2
        let both = if self.paired { r0.min(ra) } else { r0 * ra };
        r0 * t0 + rf * tf + ra * ta + both * ta0
    }

    /// Root mean square of the part of the error that is linear in `x0_hat`, `xf_hat` and `A_hat`.
    pub(super) fn linear_rms(&self, [r0, rf, ra]: [f64; 3]) -> f64 {
        let [t0, tf, ta, _] = self.moments.traces;
        (t0 * r0 + tf * rf + ta * ra).sqrt()
    }

    /// The largest possible error, or a larger number: convex in every line, so that no average is worse than the worst
    /// realization.
    pub(super) fn farthest(&self, rates: [f64; 3]) -> f64 {
        let [r0, rf, ra] = rates;
        if r0 == 0.0 || ra == 0.0 {
            return self.farthest_linear(rates);
        }
        self.farthest_linear([0.0, rf, 0.0]) + self.image.reach_z
    }

    /// Largest deviation of `M (xf^s - A x0^s - A^s x0)` over the entities with a rate.
    pub(super) fn farthest_linear(&self, rates: [f64; 3]) -> f64 {
        let reaches = [self.image.reach_0, self.image.reach_f, self.image.reach_a];
        rates.iter().zip(reaches).filter(|(rate, _)| **rate > 0.0).map(|(_, reach)| reach).sum()
    }

    /// Half the summed squared ranges of the martingale differences, for realizations revealed in the order `xf`, `x0`,
    /// `A`, with this range of one `M A^s x0_hat`.
    pub(super) fn spread(&self, [r0, rf, ra]: [f64; 3], range: f64) -> f64 {
        (self.image.d_f.powi(2) * rf + self.image.d_0_squared(ra) * r0 + range * range * ra) / 2.0
    }

    /// Largest variance of a projection: of the average pair, or of the part of the error that is linear.
    pub(super) fn variance(&self, rates: [f64; 3]) -> Result<f64> {
        let [r0, rf, ra] = rates.map(|rate| rate > 0.0);
        let part = [r0, rf, ra, self.paired && r0 && ra];
        let known = &self.tops[part.iter().fold(0, |k, in_it| 2 * k + usize::from(*in_it))];
        let most = rates.iter().fold(0.0f64, |m, rate| m.max(*rate));
        if let Some(top) = known.get() {
            return Ok(top * most);
        }
        let covariances = &self.moments.covariances;
        let sum = |at: usize| covariances.iter().zip(part).filter(|(_, in_it)| *in_it).map(|(c, _)| c[at]).sum::<f64>();
        let total = try_collect(WHAT, (0..covariances[0].len()).map(sum))?;
        let top = symmetric_norm(&total, self.image.rank())?;
        Ok(known.get_or_init(|| top) * most)
    }
}
