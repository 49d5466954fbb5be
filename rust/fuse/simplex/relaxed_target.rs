//! Exact target replacement for singleton ensembles.
//!
//! Every `S w` with `w` in the simplex lies in the affine set "line sums `g_j`, zero where no sample has hit". With `q`
//! the projection of the target `e` on that set, Pythagoras gives `||S w - e||^2 = ||S w - q||^2 + ||q - e||^2`
//! *exactly*, and `S^T (q - e)` is a constant vector, so the gap does not change either. On hit entries, `sigma_j` the
//! sum of the target over the `h_j` hit entries of line `j`:
//!
//! ```text
//! q_jr = e_jr + (s g_j - sigma_j) / h_j       s = 1
//! ```
//!
//! Without the entries that no sample reaches, the problem is no longer degenerate, and `||q - e||^2` is a lower bound
//! on the optimum in closed form. All this holds for any target; `q >= 0` is certain only for the target that was
//! sampled.
//!
//! For `sum w <= 1` the line sums are `s g_j` with one free `s`, so the set is a linear space and
//! `s = (sum_j g_j sigma_j / h_j) / (sum_j g_j^2 / h_j)`; then `S^T (q - e) = 0`.

use super::problem::SEARCH;
use crate::error::Result;
use crate::memory::{try_room, try_zeros};

/// The projected target, and the lower bound and dimension that follow from it.
pub(crate) struct Relaxed {
    pub q: Vec<f64>,
    /// `||q - e||^2`: no weights can do better.
    pub floor: f64,
    /// Dimension of the affine set.
    pub dimension: usize,
    /// Entries of the target that are not zero and that no sample has hit.
    pub unseen: usize,
    /// `q` has clearly negative entries: `S w = q` has no solution.
    pub unreachable: bool,
    /// Hits of each entry; empty for dense realizations.
    pub counts: Vec<f64>,
}

/// Projects `target` given the hit `counts` (both line-major) and the line weights `g`.
pub(crate) fn relax(target: &[f64], counts: Vec<f64>, g: &[f64], length: usize, subsimplex: bool) -> Result<Relaxed> {
    let mut q = try_zeros(SEARCH, target.len())?;
    let mut lines = try_room(SEARCH, g.len())?;
    let (mut dimension, mut unseen) = (0, 0);
    for (j, &g) in g.iter().enumerate() {
        let line = j * length..(j + 1) * length;
        let (mut hit, mut sigma) = (0_usize, 0.0);
        for (&t, &c) in target[line.clone()].iter().zip(&counts[line]) {
            if c > 0.0 && g > 0.0 {
                hit += 1;
                sigma += t;
            } else if t != 0.0 {
                unseen += 1;
            }
        }
        if hit > 0 {
            dimension += hit - 1;
            lines.push((j, g, sigma, hit as f64));
        }
    }

    let mut s = 1.0;
    if subsimplex {
        let top: f64 = lines.iter().map(|(_, g, sigma, h)| g * sigma / h).sum();
        let bottom: f64 = lines.iter().map(|(_, g, _, h)| g * g / h).sum();
        s = if bottom > 0.0 { top / bottom } else { 0.0 };
        dimension += 1;
    }
    let mut unreachable = s < 0.0 || (subsimplex && s > 1.0 + 1e-9);
    for (j, g, sigma, hit) in lines {
        let line = j * length..(j + 1) * length;
        let shift = (s * g - sigma) / hit;
        for ((q, &t), &c) in q[line.clone()].iter_mut().zip(&target[line.clone()]).zip(&counts[line]) {
            if c > 0.0 {
                *q = t + shift;
                unreachable |= *q < -1e-12 * g;
            }
        }
    }
    let floor = q.iter().zip(target).map(|(q, t)| (q - t) * (q - t)).sum::<f64>();
    Ok(Relaxed { q, floor, dimension: dimension.max(1), unseen, unreachable, counts })
}
