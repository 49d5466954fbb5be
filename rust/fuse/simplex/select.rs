//! The choice of the algorithm, and the closed forms.

use super::budget::Budget;
use super::certificate::{Certificate, certify};
use super::newton_system;
use super::operator::Operator;
use super::problem::Phase;
use super::problem::SEARCH;
use super::run_sequence::run_sequence;
use super::semismooth::{self, Setting};
use super::sifting::sift;
use super::singletons::Singletons;
use super::task::{Found, Task, Work, start_or_uniform};
use super::threshold::project;
use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_extend, try_zeros};

/// The warm weights if they are good enough; else a subset first if it is much smaller, then all realizations.
pub(crate) fn run(task: &Task, warm: Option<&[f64]>, budget: &mut Budget) -> Result<(Found, bool)> {
    if let Some(weights) = warm {
        let iterate = semismooth::measure(&Setting::of(task), try_copy(SEARCH, weights)?, budget)?;
        if iterate.gap <= task.tol {
            return Ok((Found { weights: iterate.weights, phase: Phase::Start, work: Work::default() }, false));
        }
    }
    Ok(match sift(task, budget)? {
        Some(found) => (found, true),
        None => (run_sequence(task, warm, budget)?, false),
    })
}

/// Reduces a small residual of a reachable target to rounding, if possible.
///
/// The least-norm correction on the support, `dw = (I - 11^T/K) S_J^T (S_J (I - 11^T/K) S_J^T)^+ (q - S w)`, keeps the
/// sum. Weights that would become negative leave the support, and the correction is repeated. The result is used only
/// if it is exact.
pub(crate) fn polish(
    task: &Task,
    target: &[f64],
    weights: &mut Vec<f64>,
    certificate: Certificate,
    budget: &mut Budget,
) -> Result<Certificate> {
    let op = task.op;
    if certificate.exact || certificate.objective > 1e-10 * task.gamma {
        return Ok(certificate);
    }
    let mut trial = try_copy(SEARCH, weights)?;
    let mut last = certificate.objective;
    for round in 0..6 {
        if budget.exhausted() {
            break;
        }
        let mut force = op.residual_compensated(&trial, target)?.residual;
        force.iter_mut().for_each(|r| *r = -*r);
        let support: Vec<usize> = try_collect(SEARCH, (0..op.size()).filter(|&i| trial[i] > 0.0))?;
        trial = newton_system::corrected(op, &trial, &support, &force, budget)?;
        let after = certify(op, target, &trial)?;
        if after.exact {
            *weights = trial;
            return Ok(after);
        }
        if round > 1 && after.objective > 0.25 * last {
            break;
        }
        last = after.objective;
    }
    Ok(certificate)
}

/// The solution if only one line has a nonzero weight (in particular if there is only one).
///
/// The marginal `Y` on the hit entries is the projection of `target / g` on the simplex (subsimplex: clip, project only
/// if the sum exceeds one), shared equally among the realizations that hit the entry.
pub(crate) fn closed_form<I: crate::sample::Index>(
    op: &Singletons<I>,
    target: &[f64],
    g: &[f64],
    subsimplex: bool,
) -> Result<Option<Vec<f64>>> {
    let n = op.size();
    let mut active = g.iter().enumerate().filter(|(_, g)| **g > 0.0);
    let Some((j, &g)) = active.next() else {
        return start_or_uniform(None, n).map(Some);
    };
    if active.next().is_some() {
        return Ok(None);
    }
    let place = op.line(j)?;
    let length = target.len() / op.entries();
    let mut counts: Vec<f64> = try_zeros(SEARCH, length)?;
    for &r in &place {
        counts[r] += 1.0;
    }
    let hit: Vec<usize> = try_collect(SEARCH, (0..length).filter(|&r| counts[r] > 0.0))?;
    let mut marginal: Vec<f64> = try_collect(SEARCH, hit.iter().map(|&r| target[j * length + r] / g))?;
    let positive: f64 = marginal.iter().map(|v| v.max(0.0)).sum();
    let whole = !subsimplex || positive > 1.0;
    if whole {
        project(&mut marginal)?;
    }
    let mut share = try_zeros(SEARCH, length)?;
    for (&r, y) in hit.iter().zip(&marginal) {
        share[r] = y.max(0.0) / counts[r];
    }
    let mut w: Vec<f64> = try_collect(SEARCH, place.iter().map(|&r| share[r]))?;
    if subsimplex {
        try_extend(SEARCH, &mut w, [if whole { 0.0 } else { 1.0 - positive }])?;
    }
    Ok(Some(w))
}
