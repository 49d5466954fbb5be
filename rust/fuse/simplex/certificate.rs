//! The Frank-Wolfe gap, recomputed from the data.
//!
//! With `f(w) = ||S w - e||^2` and `r = S w - e`,
//!
//! ```text
//! gap = max_i <grad f(w), w - e_i> = 2 (<r, S w> - min_i <r, E_i>),     f(w) - gap <= min f <= f(w),
//! ```
//!
//! by convexity, for any `w`. The residual is accumulated in twice the working precision. The minimum is found in plain
//! arithmetic, and every candidate within rounding of it is evaluated again in twice the precision. The cost is one
//! pass.

use super::operator::{Operator, Residual};
use super::problem::SEARCH;
use crate::compensated::{Sum, dot};
use crate::error::Result;
use crate::memory::try_zeros;

/// The certificate of given weights.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Certificate {
    /// `||S w - e||^2`
    pub objective: f64,
    /// The Frank-Wolfe gap, not below zero.
    pub gap: f64,
    /// `||S w - e||` is rounding error: the target lies in the hull.
    pub exact: bool,
}

/// A gap that is no number proves nothing: it is infinite.
pub(crate) fn nonnegative(gap: f64) -> f64 {
    if gap.is_nan() { f64::INFINITY } else { gap.max(0.0) }
}

/// Certifies `w` against `target`.
pub(crate) fn certify(op: &dyn Operator, target: &[f64], w: &[f64]) -> Result<Certificate> {
    let Residual { residual, image } = op.residual_compensated(w, target)?;
    let mut values = try_zeros(SEARCH, op.size())?;
    op.apply_transpose(&residual, &mut values)?;
    let low = crate::vector::min(&values);

    // |fl(<r, E_i>) - <r, E_i>| <= eps (entries + 2) ||r|| ||E_i||
    let largest = (0..op.size()).fold(0.0_f64, |m, i| m.max(op.squared_norm(i))).sqrt();
    let slack = f64::EPSILON * (op.entries() + 2) as f64 * crate::vector::norm(&residual) * largest;
    let mut minimum = (f64::INFINITY, 0.0);
    for (i, &v) in values.iter().enumerate() {
        if v <= low + 2.0 * slack {
            let pair = op.value_compensated(i, &residual);
            if pair.0 - minimum.0 + (pair.1 - minimum.1) < 0.0 {
                minimum = pair;
            }
        }
    }
    let at = dot(&residual, &image);
    let mut gap = Sum::default();
    for term in [at.0, -minimum.0, at.1, -minimum.1] {
        gap.add(term);
    }
    // weights whose sum is 1 but for rounding are compared with those of the simplex
    let mut sum = Sum::default();
    w.iter().for_each(|w| sum.add(*w));
    // and r is rounded: eps / 2 of it and eps^2 of each of its terms, times the distance of two realizations
    let rounding = crate::vector::norm(&residual) + f64::EPSILON * w.len() as f64 * largest;
    let off = ((sum.value() - 1.0) * at.0).abs() + f64::EPSILON * rounding * largest;
    let (objective, rest) = dot(&residual, &residual);

    // Each entry of S w is a sum of products rounded at most once per factor: a few units in the last place of the
    // target.
    let size = crate::vector::norm(target).max(crate::vector::norm(&image));
    Ok(Certificate {
        objective: objective + rest,
        gap: nonnegative(2.0 * (gap.value() + off)),
        exact: objective.sqrt() <= 16.0 * f64::EPSILON * size,
    })
}
