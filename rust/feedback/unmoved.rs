//! Modes that do not decay, and that no input is seen to move.

use faer::linalg::solvers::Solve;
use faer::{Mat, c64};

use crate::error::{Error, Result};
use crate::memory::{covered, room_for_products, try_zeros};
use crate::region::Region;

use super::data::{WHAT, matrix};
use super::loops::bytes;
use super::spectrum::eigen;

/// The largest state of a mode, and how many times as large it is after a step: that which grows most of those with
/// `|L| >= 1` that no input is seen to move. The first `p` rows of the region are known by data alone.
///
/// With `w'(A - L I) = 0` and x how the other rows follow an input `e L^t`, the mode is moved by `w_p'(A_p x + B_p e)`,
/// which the region knows up to `||w_p|| ||(Theta - C)(x, e)||`.
///
/// # Errors
/// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`].
pub fn unmoved(region: &Region, p: usize) -> Result<Option<(usize, f64)>> {
    let (d, n, m) = (region.width(), region.n, region.m);
    if p > n {
        return Err(Error::Shape { name: "p", expected: format!("at most {n} rows"), found: p.to_string() });
    }
    room_for_products()?;
    let mut z = [try_zeros::<f64>(WHAT, d)?, try_zeros::<f64>(WHAT, d)?];
    covered(WHAT, 4 * bytes(n, d), || {
        let centre = matrix(region.centre(), n, d);
        let a = centre.subcols(0, n).to_owned();
        let (values, left) = eigen(&a.transpose().to_owned())?;
        let mut found: Option<(usize, f64)> = None;
        for k in (0..n).filter(|k| values[*k].norm() >= 1.0 && values[*k].im >= 0.0) {
            let shift = Mat::from_fn(n, n, |i, j| {
                let own = if i < p { 0.0 } else { a[(i, j)] };
                if i == j { values[k] - c64::new(own, 0.0) } else { c64::new(-own, 0.0) }
            });
            let inputs = Mat::from_fn(n, m, |i, j| c64::new(if i < p { 0.0 } else { centre[(i, n + j)] }, 0.0));
            let x = shift.partial_piv_lu().solve(inputs);
            let size = (0..p).map(|i| left[(i, k)].norm().powi(2)).sum::<f64>().sqrt();
            let mut seen = false;
            for j in 0..m {
                let next = |i: usize| {
                    let along = (0..n).map(|q| x[(q, j)] * a[(i, q)]).sum::<c64>();
                    left[(i, k)] * (along + c64::new(centre[(i, n + j)], 0.0))
                };
                for i in 0..n {
                    (z[0][i], z[1][i]) = (x[(i, j)].re, x[(i, j)].im);
                }
                z[0][n + j] = 1.0;
                let off = region.bound(&z[0], false)? + region.bound(&z[1], false)?;
                z[0][n + j] = 0.0;
                seen |= (0..p).map(next).sum::<c64>().norm() > size * off;
            }
            let grown = values[k].norm();
            if !seen && found.is_none_or(|(_, most)| grown > most) {
                let largest = (0..p).max_by(|i, j| left[(*i, k)].norm().total_cmp(&left[(*j, k)].norm()));
                found = largest.map(|state| (state, grown));
            }
        }
        Ok(found)
    })?
}
