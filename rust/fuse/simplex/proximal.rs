//! The two outer methods around the semismooth Newton solver.
//!
//! * [`direct`]: centre `1/N` and one tiny `mu`, if `S w = q` is (nearly) solvable: from about two realizations per
//!   dimension;
//! * [`augmented`]: the proximal point method (SSNAL; Li, Sun, Toh, SIAM J. Optim. 28, 2018), whose centre is the last
//!   weights. It finds the support for any target, and is used when the others fail.

use super::budget::Budget;
use super::factor::{LARGEST_FACTOR, solve_cost};
use super::hessian::factor_cost;
use super::newton_cg::{self, Effort};
use super::newton_system::Memory;
use super::problem::SEARCH;
use super::semismooth::{Ended, Inner, Point, Rules, Setting, distance, measure};
use super::task::{Iterate, Work};
use crate::error::Result;
use crate::memory::{try_copy, try_filled, try_room};
use crate::vector::norm;

/// A proximal step moves the centre by `1 + RELAXATION` times itself (below 2 it converges: Eckstein and Bertsekas,
/// Math. Program. 55, 1992).
const RELAXATION: f64 = 0.4;
/// Changes of the support still to come, for each in the last proximal step (measured).
const STEPS: f64 = 5.0;
/// The active set method takes over when its expected cost is at most this multiple of the cost so far.
const EAGER: f64 = 1.5;
/// Share of the cost so far that Newton-CG may spend on an unchanged support, and the growth of that cost before it may
/// try again.
const TRIAL: f64 = 0.5;
const AGAIN: f64 = 1.3;

/// One proximal step from the uniform weights with a tiny `mu`.
///
/// At the solution `gap <= 2 mu max_i (w_i - c_i) + 2 reach ||F||`, which determines `mu`. `None` if the target turns
/// out to be out of reach (support below the dimension) or the steps become short.
pub(crate) fn direct(set: &Setting, budget: &mut Budget, work: &mut Work) -> Result<Option<Iterate>> {
    let n = set.op.size();
    let center = try_filled(SEARCH, 1.0 / n as f64, n)?;
    let mut point = Point::origin(n, set.op.dim())?;
    let least_support = (1.05 * set.dimension as f64) as usize;

    let goal = set.residual_goal();
    let exact = |_: &Point| goal;
    let direct_rules = Rules { stop: &exact, newton: 40, cg: 2000, least_support };

    // First a rough solve with a larger mu, which finds the support quickly.
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
/// Once the support is known, the remaining steps are many and alike, so other methods take over. Newton-CG is tried
/// when the support has not changed, with a share of the cost so far. The method ends before convergence, as soon as
/// the active set method is expected to finish for `EAGER` times the cost so far. Returns the best weights, and the
/// last ones as its start.
pub(crate) fn augmented(set: &Setting, budget: &mut Budget, work: &mut Work) -> Result<(Iterate, Vec<f64>)> {
    let n = set.op.size();
    let mut center = try_filled(SEARCH, 1.0 / n as f64, n)?;
    let mut best = measure(set, try_copy(SEARCH, &center)?, budget)?;
    let mut point = Point::origin(n, set.op.dim())?;
    let mut mu = 3e-2 * set.scale();
    let nearly = (set.dimension + set.dimension / 20 + 2).min(LARGEST_FACTOR);
    let mut memory = Memory::new(1.0, nearly);
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
            // Too far for one proximal step: keep the centre, with a larger mu.
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
        if point.support <= nearly && rest(set, point.support, changed) <= EAGER * spent {
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
            *c = w + RELAXATION * (w - *c);
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

/// Expected passes of the active set method: a factor, and one step per change of the support.
fn rest(set: &Setting, support: usize, changed: usize) -> f64 {
    let pass = 2.0 * (set.op.size() * set.op.entries()) as f64;
    let step = solve_cost(support) + pass;
    (factor_cost(support, set.op.entries()) + STEPS * changed as f64 * step) / pass
}
