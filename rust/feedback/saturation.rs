//! Where a linear feedback keeps limits for all time, without noise.

use faer::Mat;
use faer::linalg::solvers::Solve;

use crate::error::{Error, Result};
use crate::memory::covered;
use crate::parallel::Stop;
use crate::scaled::nearest_power_of_two;

use super::data::WHAT;
use super::loops::{Loop, bytes, squares};
use super::tube::Run;

impl Loop {
    /// `s` such that all runs that begin in `{x'Q^-1 x <= s}` keep `|x_i|` and `|u_j|` below `limits` (n + m) for all
    /// time, for every member; and how many times `x0` may be taken, if it is given. The larger of: that level set, one
    /// around the multiples of `x0` alone, and the tube. 0 where nothing is proved: also with an offset, where 0 is no
    /// point of rest.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn holds(&self, limits: &[f64], x0: Option<&[f64]>, stop: &Stop) -> Result<(f64, Option<f64>)> {
        let (n, m) = (self.data.n, self.data.m);
        if limits.len() != n + m || x0.is_some_and(|x0| x0.len() != n) {
            let found = limits.len().to_string();
            return Err(Error::Shape { name: "limits", expected: format!("{} entries", n + m), found });
        }
        let Some(root) = self.proof.as_ref().filter(|_| self.data.c.is_none()) else {
            return Ok((0.0, x0.map(|_| 0.0)));
        };
        // what holds of a direction holds of its multiples: of one near 1, so that squares neither overflow nor vanish
        let size = x0.map_or(1.0, |x0| x0.iter().fold(0.0f64, |most, x| most.max(x.abs())));
        let size = if size > 0.0 { nearest_power_of_two(size) } else { 1.0 };
        let mut direction = Vec::new();
        direction.extend(x0.unwrap_or(&[]).iter().map(|x| x / size));
        let x0 = x0.map(|_| direction.as_slice());
        let rows = self.rows();
        // the largest multiple of sizes below the limits
        let within = |sizes: &[f64]| {
            let each =
                limits.iter().zip(sizes).map(|(most, size)| if *size > 0.0 { most / size } else { f64::INFINITY });
            each.fold(f64::INFINITY, f64::min) * (1.0 - 1e-6)
        };
        let rooted = |mut squares: Vec<f64>| {
            squares.iter_mut().for_each(|v| *v = v.sqrt());
            squares
        };
        let (level, mut scale) = covered(WHAT, bytes(n, self.data.region.d), || {
            let level = within(&rooted(squares(root, &rows))).powi(2);
            let Some(x0) = x0 else { return (level, None) };
            let x = Mat::from_fn(n, 1, |i, _| x0[i] / self.data.unit[i]);
            let inside = root.partial_piv_lu().solve(&x).squared_norm_l2();
            let mut scale = (level / inside).sqrt() * (1.0 - 1e-6);
            let around = &x * x.transpose() * faer::Scale(1.0 + 1e-6);
            if let Some(root) = self.smallest(&super::data::symmetric(&around), 1.0, &rows) {
                scale = scale.max(within(&rooted(squares(&root, &rows))));
            }
            (level, Some(scale))
        })?;
        if let Some(x0) = x0 {
            let run = Run { x0, steps: 1, plan: &[], start: 0.0, rest: None, noise: None };
            let along = within(&self.tube(run, stop)?.reach);
            scale = scale.map(|scale| scale.max(along));
        }
        Ok((level, scale.map(|scale| if scale.is_finite() { (scale / size).min(f64::MAX) } else { scale })))
    }
}
