//! The sequence of algorithms, until the gap is small enough.

use super::active_set;
use super::budget::Budget;
use super::newton_cg::{self, Effort};
use super::problem::Phase;
use super::proximal;
use super::semismooth::{self, Setting};
use super::task::{Found, Iterate, Task, Work, start_or_uniform};
use crate::error::Result;

/// Realizations per dimension up to which projected Newton-CG goes first. At N = 1.1 d, d = 1000, dense, going first
/// takes it 384 ms instead of 30 ms for a far target, and half the time of the others for two easier ones; 1.3 s
/// instead of 1.0 s for four problems.
const NEWTON_CG_TO: f64 = 1.05;
/// Realizations per dimension from which `S w = q` is tried: half of all centred point clouds of `2 d` points contain
/// their centre (Wendel, Math. Scand. 11, 1962), hardly any with fewer points.
const DIRECT_FROM: f64 = 1.9;
/// Passes of PNCG before the next method is tried.
const NEWTON_CG_PASSES: f64 = 700.0;

/// Projected Newton-CG or the direct semismooth solve, then SSNAL and the active set method; returns the best weights.
///
/// What each saves, measured on one core of an EPYC (S: sampled `n x n` matrices, D: dense vectors of n entries, N
/// realizations), in ms with it and without:
///
/// | algorithm | case | with | without |
/// |---|---|---|---|
/// | Newton-CG | S, n = 100, N = 1000 | 4.1 | 115 |
/// | direct solve | S, n = 30, N = 10 000 | 7.6 | 45 |
/// | SSNAL before the active set | S, n = 30, N = 1700 | 43 | 125 |
/// | active set | D, n = 1000, N = 1900 | 1870 | over the limit of passes |
/// | Newton-CG within SSNAL | S, n = 100, N = 13 000 | 850 | 1210 |
/// | sifting ([`super::sifting`]) | S, n = 10, N = 1 000 000 | 54 | 839 |
/// | closed form ([`super::select`]) | one vector, n = 1000, N = 1000 | 0.05 | 1.4 |
pub(crate) fn run_sequence(task: &Task, warm: Option<&[f64]>, budget: &mut Budget) -> Result<Found> {
    let (op, q, tol) = (task.op, &task.relaxed.q[..], task.tol);
    let n = op.size();
    let set = Setting::of(task);
    let mut work = Work::default();

    // The warm or uniform weights may be good enough.
    let start = semismooth::measure(&set, start_or_uniform(warm, n)?, budget)?;
    let mut best = Best { iterate: start, phase: Phase::Start };
    if best.done(tol) || budget.exhausted() {
        return Ok(best.found(work));
    }

    let few = (n as f64) < NEWTON_CG_TO * task.relaxed.dimension as f64;
    if few {
        best.offer(
            newton_cg::solve(op, q, warm, tol, Effort::Passes(NEWTON_CG_PASSES), budget, &mut work)?,
            Phase::NewtonCg,
        );
    } else if n as f64 > DIRECT_FROM * task.relaxed.dimension as f64
        && !task.relaxed.unreachable
        && let Some(found) = proximal::direct(&set, budget, &mut work)?
    {
        best.offer(found, Phase::Direct);
    }
    if !best.done(tol) && !budget.exhausted() {
        let (rough, from) = proximal::augmented(&set, budget, &mut work)?;
        best.offer(rough, Phase::Augmented);
        if !best.done(tol) && !budget.exhausted() {
            best.offer(active_set::solve(op, q, &from, tol, budget, &mut work)?, Phase::ActiveSet);
        }
    }
    Ok(best.found(work))
}

struct Best {
    iterate: Iterate,
    phase: Phase,
}

impl Best {
    fn offer(&mut self, iterate: Iterate, phase: Phase) {
        if iterate.gap < self.iterate.gap {
            (self.iterate, self.phase) = (iterate, phase);
        }
    }

    fn done(&self, tol: f64) -> bool {
        self.iterate.gap <= tol
    }

    fn found(self, work: Work) -> Found {
        Found { weights: self.iterate.weights, phase: self.phase, work }
    }
}
