//! The two outer methods around the semismooth Newton solver.
//!
//! * [`direct`]: centre `1/N` and one tiny `mu`, when `S w = q` is (nearly) solvable: from about two realizations per dimension;
//! * [`augmented`]: the proximal point method (SSNAL; Li, Sun, Toh, SIAM J. Optim. 28, 2018), the centre being the last weights:
//!   it identifies the support for any target, and is the safety net.

use super::budget::Budget;
use super::factor::{LARGEST_FACTOR, solve_cost};
use super::hessian::factor_cost;
use super::newton_cg::{self, Effort};
use super::newton_system::Memory;
use super::operator::Operator;
use super::problem::SEARCH;
use super::semismooth::{Ended, Inner, Point, Rules, Setting, distance, measure};
use super::task::{Iterate, Work};
use crate::error::Result;
use crate::memory::{try_copy, try_filled, try_room};
use crate::vector::norm;

/// A proximal step moves the centre by `1 + RELAXATION` times itself (below 2 it converges: Eckstein and Bertsekas, Math.
/// Program. 55, 1992).
const RELAXATION: f64 = 0.4;
/// Changes of the support still to come, for one in the last proximal step (measured).
const STEPS: f64 = 5.0;
/// The active set method takes over when it is expected to cost at most this much of what has been spent.
const EAGER: f64 = 1.5;
/// What Newton-CG may spend on an unchanged support, in units of what has been spent, and when it may try again.
const TRIAL: f64 = 0.5;
const AGAIN: f64 = 1.3;

/// One proximal step from the uniform weights with a tiny `mu`.
///
/// At the solution `gap <= 2 mu max_i (w_i - c_i) + 2 reach ||F||`, which fixes `mu` beforehand. `None` if the target turns out
/// to be out of reach (support below the dimension) or the steps become short.
pub(crate) fn direct<O: Operator>(set: &Setting<O>, budget: &mut Budget, work: &mut Work) -> Result<Option<Iterate>> {
    let n = set.op.size();
    let center = try_filled(SEARCH, 1.0 / n as f64, n)?;
    let mut point = Point::origin(n, set.op.dim())?;
    let least_support = (1.05 * set.dimension as f64) as usize;

    let goal = set.residual_goal();
    let exact = |_: &Point| goal;
    let direct_rules = Rules { stop: &exact, newton: 40, cg: 2000, least_support };

    // A rough solve with a larger mu first: it finds the support cheaply.
    let rough = |p: &Point| 1e-2 * distance(&p.image, set.q);
    let mut memory = Memory::new(2.0, 0);
    let mut inner =
        Inner { set, center: &center, mu: 1e-6 * set.scale(), memory: &mut memory, scratch: try_room(SEARCH, n)? };
    if matches!(
        inner.run(&mut point, &Rules { stop: &rough, ..direct_rules }, budget, work)?,
        Ended::Infeasible | Ended::Limit
    ) {
        return Ok(None);
    }
    inner.mu = set.tol * n as f64 / 40.0;
    let mut best: Option<Iterate> = None;
    for _ in 0..8 {
        let ended = inner.run(&mut point, &direct_rules, budget, work)?;
        if ended == Ended::Infeasible {
            break;
        }
        let found = measure(set, try_copy(SEARCH, &point.w)?, budget)?;
        let gap = found.gap;
        if best.as_ref().is_none_or(|b| gap < b.gap) {
            best = Some(found);
        }
        if gap <= set.tol || ended == Ended::Limit || ended == Ended::Stuck {
            break;
        }
        inner.mu *= (0.4 * set.tol / gap).clamp(1e-3, 0.5);
    }
    Ok(best)
}

/// The proximal point method with a decreasing sequence of `mu`, over-relaxed.
///
/// The last steps, the support being known, are long and all alike, so they are left to others: Newton-CG has a try when the
/// support has not changed, on a part of what has been spent. With `early` it ends, not converged, as soon as the active set method
/// is expected to finish for what has been spent. Returns the best weights and the last ones, where that would start.
pub(crate) fn augmented<O: Operator>(
    set: &Setting<O>,
    early: bool,
    budget: &mut Budget,
    work: &mut Work,
) -> Result<(Iterate, Vec<f64>)> {
    let n = set.op.size();
    let mut center = try_filled(SEARCH, 1.0 / n as f64, n)?;
    let mut best = measure(set, try_copy(SEARCH, &center)?, budget)?;
    let mut point = Point::origin(n, set.op.dim())?;
    let mut mu = 3e-2 * set.scale();
    let nearly = (set.dimension + set.dimension / 20 + 2).min(LARGEST_FACTOR);
    let mut memory = Memory::new(1.0, if early { nearly } else { 0 });
    // The safety net takes no risks.
    let relaxation = if early { RELAXATION } else { 0.0 };
    let started = budget.passes();
    let mut next_trial = 0.0;
    let mut support = try_filled(SEARCH, true, n)?;
    for _ in 0..100 {
        if best.gap <= set.tol || budget.exhausted() {
            break;
        }
        let floor = set.residual_goal();
        let stop = |p: &Point| {
            let moved: f64 = p.w.iter().zip(&center).map(|(w, c)| (w - c) * (w - c)).sum();
            (0.3 * distance(&p.image, set.q).min((mu * moved).sqrt())).max(floor)
        };
        let mut inner = Inner { set, center: &center, mu, memory: &mut memory, scratch: try_room(SEARCH, n)? };
        let rules = Rules { stop: &stop, newton: 25, cg: 2000, least_support: 0 };
        let before = work.newton;
        let ended = inner.run(&mut point, &rules, budget, work)?;
        let found = measure(set, try_copy(SEARCH, &point.w)?, budget)?;
        if found.gap < best.gap {
            best = found;
        }
        if ended == Ended::Stuck && norm(&point.force) > 0.5 * distance(&point.image, set.q) {
            // Too far for one proximal step: stay at the centre, with a larger mu.
            mu *= 5.0;
            set.op.apply(&center, &mut point.image)?;
            for ((z, q), x) in point.z.iter_mut().zip(set.q).zip(&point.image) {
                *z = (q - x) / mu;
            }
            continue;
        }

        let mut changed = 0;
        for (known, w) in support.iter_mut().zip(&point.w) {
            changed += usize::from(*known != (*w > 0.0));
            *known = *w > 0.0;
        }
        let spent = budget.passes() - started;
        if early && point.support <= nearly && rest(set, point.support, changed) <= EAGER * spent {
            break;
        }
        if changed == 0 && point.support <= set.dimension && spent >= next_trial {
            let found =
                newton_cg::solve(set.op, set.q, Some(&point.w), set.tol, Effort::Finish(TRIAL * spent), budget, work)?;
            if found.gap < best.gap {
                best = found;
            }
            next_trial = AGAIN * (budget.passes() - started);
        }

        for (c, w) in center.iter_mut().zip(&point.w) {
            *c = w + relaxation * (w - *c);
        }
        let shrink = match work.newton - before {
            0..=2 => 0.5,
            3..=12 => 0.75,
            _ => 1.0,
        };
        let next = (shrink * mu).max(1e-13 * set.scale());
        for z in &mut point.z {
            *z *= mu / next;
        }
        mu = next;
    }
    let last = if super::threshold::normalise(&mut point.w) { point.w } else { try_copy(SEARCH, &best.weights)? };
    Ok((best, last))
}

/// Passes the active set method is expected to take: a factor, and steps, one sample each.
fn rest<O: Operator>(set: &Setting<O>, support: usize, changed: usize) -> f64 {
    let pass = 2.0 * (set.op.size() * set.op.entries()) as f64;
    let step = solve_cost(support) + pass;
    (factor_cost(support, set.op.entries()) + STEPS * changed as f64 * step) / pass
}
