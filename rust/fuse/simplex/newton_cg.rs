//! Projected Newton-CG (PNCG): few realizations, `N < d`.
//!
//! The constraint `sum w = 1` is replaced by a penalty. With `s = 1^T w` and a factor `kappa`,
//!
//! ```text
//! min_{w >= 0}  1/2 ||S w - s q||^2 + kappa/2 (s - 1)^2
//! ```
//!
//! is nonnegative least squares whose minimiser is a multiple of the minimiser on the simplex. Each step fixes the
//! entries that are zero with a nonnegative gradient, solves the Newton equations on the others by conjugate gradients
//! on a contiguous copy of their samples, and projects (Bertsekas, SIAM J. Control Optim. 20, 1982). It is well
//! conditioned while `N < d`, and every iteration gives a certificate at no extra cost.

use super::budget::Budget;
use super::hessian::Hessian;
use super::operator::Operator;
use super::problem::SEARCH;
use super::task::{Iterate, Work, start_or_uniform};
use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_zeros};
use crate::vector::{axpy, dot, min, norm, sum};

/// Most inner iterations per Newton step.
const MAX_CG: usize = 400;

/// Limits of the search.
#[derive(Clone, Copy)]
pub(crate) enum Effort {
    /// A bounded number of passes.
    Passes(f64),
    /// From nearly the right support: a bounded number of passes, Newton equations solved accurately.
    Finish(f64),
}

/// Minimises from `start` (uniform if `None`) until the gap is below `tol` or the limit is reached.
pub(crate) fn solve(
    op: &dyn Operator,
    q: &[f64],
    start: Option<&[f64]>,
    tol: f64,
    effort: Effort,
    budget: &mut Budget,
    work: &mut Work,
) -> Result<Iterate> {
    let (n, d) = (op.size(), op.dim());
    let (passes, patience) = match effort {
        Effort::Passes(passes) => (passes, 60),
        Effort::Finish(passes) => (passes, 6),
    };
    let stop_at = budget.passes() + passes;
    let qq = dot(q, q);
    // ||E_i - q||^2 = ||E_i||^2 - 2 <E_i, q> + ||q||^2
    let mut images = try_zeros(SEARCH, n)?;
    op.apply_transpose(q, &mut images)?;
    let mut diagonal: Vec<f64> =
        try_collect(SEARCH, (0..n).map(|i| (op.squared_norm(i) - 2.0 * images[i] + qq).max(0.0)))?;
    let spread = sum(&diagonal) / n as f64;
    let kappa = (spread / (d as f64).sqrt()).max(f64::MIN_POSITIVE);
    for v in &mut diagonal {
        *v = 1.0 / (*v + kappa).max(1e-10 * spread);
    }

    let mut w = start_or_uniform(start, n)?;
    let (mut r, mut a, mut s_dw) = (try_zeros(SEARCH, d)?, try_zeros(SEARCH, n)?, try_zeros(SEARCH, d)?);
    let mut best = Iterate { weights: try_copy(SEARCH, &w)?, gap: f64::INFINITY };
    let mut free: Vec<usize> = Vec::new();
    let (mut settled, mut stalled) = (false, 0);

    for iteration in 0..10_000 {
        // r = S w - s q, recomputed at intervals
        let s = sum(&w);
        if iteration % 10 == 0 {
            op.apply(&w, &mut r)?;
            axpy(-s, q, &mut r);
            budget.charge(1, n, op.entries());
        }
        // a_i = <E_i - q, r>; the gradient is a + kappa (s - 1)
        op.apply_transpose(&r, &mut a)?;
        budget.charge(1, n, op.entries());
        let rq = dot(q, &r);
        for v in &mut a {
            *v -= rq;
        }
        // at w / s: gap = 2 (||r/s||^2 - min a / s)
        let gap = 2.0 * (dot(&r, &r) / (s * s) - min(&a) / s);
        if gap < best.gap {
            if gap < 0.9 * best.gap {
                stalled = 0;
            }
            best.weights.copy_from_slice(&w);
            best.gap = gap;
        }
        stalled += 1;
        if !(gap > tol && s > 0.0) || budget.exhausted() || budget.passes() > stop_at || stalled > patience {
            break;
        }

        let shift = kappa * (s - 1.0);
        let before = std::mem::take(&mut free);
        free = try_collect(SEARCH, (0..n).filter(|&i| w[i] > 0.0 || a[i] + shift < 0.0))?;
        settled &= free == before;
        let sub = op.subset(&free)?;
        let eta = if matches!(effort, Effort::Finish(_)) {
            1e-4
        } else if settled {
            1e-3
        } else if iteration < 2 {
            0.1
        } else {
            0.03
        };
        let gradient: Vec<f64> = try_collect(SEARCH, free.iter().map(|&i| a[i] + shift))?;
        let inverse: Vec<f64> = try_collect(SEARCH, free.iter().map(|&i| diagonal[i]))?;
        let hessian = Hessian { sub: &*sub, q, kappa };
        let most = match effort {
            Effort::Finish(_) => ((stop_at - budget.passes()) * n as f64 / free.len().max(1) as f64) as usize,
            _ => MAX_CG,
        };
        let step = conjugate_gradients(&hessian, &gradient, &inverse, eta, most, budget, work)?;
        work.newton += 1;

        // Armijo on the projected arc; the decrease of the quadratic is evaluated from the step itself (no
        // cancellation):
        //   f(w + dw) - f(w) = <g, dw> + 1/2 ||S dw - (1^T dw) q||^2 + kappa/2 (1^T dw)^2
        let mut length = 1.0;
        let mut dw = try_zeros(SEARCH, free.len())?;
        let mut accepted = false;
        for _ in 0..30 {
            for ((dw, &i), p) in dw.iter_mut().zip(&free).zip(&step) {
                *dw = (w[i] + length * p).max(0.0) - w[i];
            }
            sub.apply(&dw, &mut s_dw)?;
            budget.charge(1, free.len(), op.entries());
            let ds = sum(&dw);
            axpy(-ds, q, &mut s_dw);
            let linear = dot(&gradient, &dw);
            let change = linear + 0.5 * dot(&s_dw, &s_dw) + 0.5 * kappa * ds * ds;
            if change <= 1e-4 * linear && linear < 0.0 {
                accepted = true;
                break;
            }
            let curvature = change - linear;
            let shrink = if curvature > 0.0 { -linear / (2.0 * curvature) } else { 0.5 };
            length *= shrink.clamp(0.1, 0.5);
        }
        if !accepted {
            break;
        }
        settled = length == 1.0;
        for (&i, dw) in free.iter().zip(&dw) {
            w[i] += dw;
        }
        axpy(1.0, &s_dw, &mut r);
    }
    if !super::threshold::normalise(&mut best.weights) {
        best = Iterate { weights: start_or_uniform(None, n)?, gap: f64::INFINITY };
    }
    Ok(best)
}

/// `H p = -g` to `||residual|| <= eta ||g||`; `inverse` is that of the diagonal of `H`.
fn conjugate_gradients(
    hessian: &Hessian,
    gradient: &[f64],
    inverse: &[f64],
    eta: f64,
    most: usize,
    budget: &mut Budget,
    work: &mut Work,
) -> Result<Vec<f64>> {
    let k = gradient.len();
    let mut p = try_zeros(SEARCH, k)?;
    let mut residual: Vec<f64> = try_collect(SEARCH, gradient.iter().map(|g| -g))?;
    let mut z = try_zeros(SEARCH, k)?;
    let precondition = |r: &[f64], z: &mut [f64]| z.iter_mut().zip(r).zip(inverse).for_each(|((z, r), m)| *z = r * m);
    precondition(&residual, &mut z);
    let mut direction = try_copy(SEARCH, &z)?;
    let (mut h, mut image) = (try_zeros(SEARCH, k)?, try_zeros(SEARCH, hessian.q.len())?);
    let mut rz = dot(&residual, &z);
    let stop = eta * norm(gradient);
    for _ in 0..most.min(2 * k + 10) {
        if norm(&residual) <= stop || rz <= 0.0 || budget.charge(2, k, hessian.sub.entries()) {
            break;
        }
        work.cg += 1;
        hessian.apply(&direction, &mut image, &mut h)?;
        let curvature = dot(&direction, &h);
        if curvature <= 0.0 {
            break;
        }
        let alpha = rz / curvature;
        axpy(alpha, &direction, &mut p);
        axpy(-alpha, &h, &mut residual);
        precondition(&residual, &mut z);
        let next = dot(&residual, &z);
        let beta = next / rz;
        rz = next;
        for (d, z) in direction.iter_mut().zip(&z) {
            *d = z + beta * *d;
        }
    }
    Ok(p)
}
