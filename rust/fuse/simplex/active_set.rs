//! Primal active set method with a factor: the last method to be tried, and the one near the hard spot `N = 2 d`.
//!
//! On a face of the homogenised problem (see `newton_cg`) the minimiser solves one linear system with the free block
//! `H_FF`. The iteration moves towards it. A weight that reaches zero on the way leaves the face; at the minimiser, the
//! sample with the most negative gradient enters (Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23). It
//! ends where conjugate gradients converge slowly, but each step changes one sample, so the start must have nearly the
//! right support.
//!
//! The linear systems are solved with the factor of an earlier face, bordered (see `face`).

use super::budget::Budget;
use super::face::Face;
use super::factor::solve_cost;
use super::operator::Operator;
use super::problem::SEARCH;
use super::task::{Iterate, Work};
use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_filled, try_zeros};
use crate::vector::{axpy, dot, min, norm, sum};

/// Steps before the search is given up.
const STEPS: usize = 20_000;

/// Walks from `start` (on the simplex) until the gap is below `tol` or no step helps.
pub(crate) fn solve(
    op: &dyn Operator,
    q: &[f64],
    start: &[f64],
    tol: f64,
    budget: &mut Budget,
    work: &mut Work,
) -> Result<Iterate> {
    let (n, d) = (op.size(), op.dim());
    let qq = dot(q, q);
    let mut images = try_zeros(SEARCH, n)?;
    op.apply_transpose(q, &mut images)?;
    let spread = (0..n).map(|i| (op.squared_norm(i) - 2.0 * images[i] + qq).max(0.0)).sum::<f64>() / n as f64;
    let kappa = (spread / (d as f64).sqrt()).max(f64::MIN_POSITIVE);

    let mut w = try_copy(SEARCH, start)?;
    let mut free: Vec<bool> = try_collect(SEARCH, w.iter().map(|w| *w > 0.0))?;
    let mut best = Iterate { weights: try_copy(SEARCH, &w)?, gap: f64::INFINITY };
    let (mut r, mut a, mut p) = (try_zeros(SEARCH, d)?, try_zeros(SEARCH, n)?, try_zeros(SEARCH, n)?);
    let mut face: Option<Face> = None;
    let mut barred: Option<usize> = None;
    for _ in 0..STEPS {
        let s = sum(&w);
        op.apply(&w, &mut r)?;
        axpy(-s, q, &mut r);
        op.apply_transpose(&r, &mut a)?;
        let rq = dot(q, &r);
        for v in &mut a {
            *v -= rq;
        }
        let gap = 2.0 * (dot(&r, &r) / (s * s) - min(&a) / s);
        if gap < best.gap {
            best.weights.copy_from_slice(&w);
            best.gap = gap;
        }
        if !(gap > tol && s > 0.0) || budget.charge(2, n, op.entries()) {
            break;
        }
        for v in &mut a {
            *v += kappa * (s - 1.0);
        }
        let (mut residual, mut lowest, mut enter) = (0.0_f64, 0.0, None);
        for i in 0..n {
            if free[i] {
                residual = residual.max(a[i].abs());
            } else if a[i] < lowest && barred != Some(i) {
                (lowest, enter) = (a[i], Some(i));
            }
        }

        let count = free.iter().filter(|f| **f).count();
        if face.as_ref().is_none_or(|f| f.changes() > (count / 6).clamp(4, 96.max(count / 25))) {
            work.factors += 1;
            face = Face::new(op, q, kappa, &images, &free, budget)?;
        }
        let Some(face) = face.as_mut() else { break };
        // At the minimiser of the face, the sample with the most negative gradient enters.
        if residual <= 0.1 * lowest.abs()
            && let Some(i) = enter
        {
            free[i] = true;
            face.enter(i, budget)?;
        } else if enter.is_none() && residual <= 1e-3 * tol {
            break;
        }
        if !face.newton(&a, &mut p)? {
            break;
        }
        work.newton += 1;
        budget.charge(1, solve_cost(count) as usize, 1);
        // The longest step that keeps w >= 0
        let (mut length, mut blocking) = (1.0, None);
        for i in 0..n {
            if free[i] && p[i] < 0.0 && w[i] + length * p[i] < 0.0 {
                (length, blocking) = (-w[i] / p[i], Some(i));
            }
        }
        for ((w, p), free) in w.iter_mut().zip(&p).zip(&free) {
            if *free {
                *w = (*w + length * p).max(0.0);
            }
        }
        face.stepped(length);
        barred = None;
        if let Some(i) = blocking {
            w[i] = 0.0;
            free[i] = false;
            face.leave(i)?;
            if length == 0.0 {
                barred = Some(i);
            }
        } else if norm(&p) <= 1e-16 * norm(&w) {
            break;
        }
    }
    if !super::threshold::normalise(&mut best.weights) {
        best = Iterate { weights: try_filled(SEARCH, 1.0 / n as f64, n)?, gap: f64::INFINITY };
    }
    Ok(best)
}
