//! ALSE for all problems without a closed form: `min ||sum_i w_i E_i - E*||^2` over the weights, certified.
//!
//! First our own solver ([`super::simplex`]); if its gap is too large, Clarabel on scaled data; then the better of
//! both. A solver only proposes weights. Their gap is recomputed from the realizations and gives the status, together
//! with the reason why the search ended if the gap is too large.

mod clarabel;
mod realizations;
mod solution;
mod verify;

use super::distance;
use super::simplex;
use crate::error::{Error, Result};
use crate::memory::try_filled;
use crate::parallel::Stop;
use crate::sample::Singletons;

pub use super::simplex::WeightStatus;
pub use realizations::Realizations;
pub use solution::{CertifiedWeights, Settings};

use solution::{Clock, Proposal};

/// Nonzero entries up to which Clarabel is tried: about a minute on one core.
const SECOND_OPINION: usize = 200_000;

/// Solves `min ||sum_i w_i E_i - target||` to a gap of `tol ||target||^2`.
///
/// A limit or a stop ends the search without an error: the result has the best feasible weights, their gap, and a
/// status that says so.
///
/// # Errors
/// [`Error::Numerical`] if a solver refuses the problem, [`Error::Memory`].
pub fn alse(
    realizations: &impl Realizations,
    target: &[f64],
    settings: &Settings,
    stop: &Stop,
) -> Result<CertifiedWeights> {
    let clock = Clock::start(settings);
    let own = realizations.solve(target, &settings.options(&clock), None, stop)?;
    certified(realizations, own, target, settings, &clock, stop)
}

/// [`alse`] for the first `k` realizations, for each `k` in the increasing `sizes`; the results go to `visit` in this
/// order.
///
/// The weights of one prefix, padded with zeros, are the start of the next. They are the result if the new realizations
/// do not help, and with few realizations per dimension they save Newton-CG the search for the support; with many, a
/// cold start is faster. The time limit is for all prefixes together, the limit on passes for each.
///
/// # Errors
/// As [`alse`], and those of `visit`.
pub fn alse_prefixes(
    draws: &Singletons,
    target: &[f64],
    settings: &Settings,
    sizes: &[usize],
    stop: &Stop,
    mut visit: impl FnMut(&CertifiedWeights) -> Result<()>,
) -> Result<()> {
    let clock = Clock::start(settings);
    let mut warm: Option<Vec<f64>> = None;
    for &size in sizes {
        let prefix = draws.prefix(size);
        let own = prefix.solve(target, &settings.options(&clock), warm.as_deref(), stop)?;
        let solution = certified(&prefix, own, target, settings, &clock, stop)?;
        visit(&solution)?;
        warm = Some(solution.weights);
    }
    Ok(())
}

/// Our solver's weights with their estimate; Clarabel's if ours are not good enough and Clarabel's are better.
fn certified(
    realizations: &impl Realizations,
    own: simplex::Solution,
    target: &[f64],
    settings: &Settings,
    clock: &Clock,
    stop: &Stop,
) -> Result<CertifiedWeights> {
    let spent = settings.max_passes.is_some_and(|most| own.info.passes >= most as f64);
    let status = match own.status {
        WeightStatus::UserLimit if !spent && !clock.over() => WeightStatus::OptimalInaccurate,
        status => status,
    };
    // one pass, also after a stop, since the caller needs the estimate
    let estimate = realizations.combine(&own.weights, &Stop::new())?;
    let error = distance(&estimate, target);
    let first = CertifiedWeights {
        error,
        estimate,
        gap: own.gap,
        lower_bound: own.least_error.min(error),
        unseen: own.unseen,
        exact: own.exact,
        status,
        solver: own.info.phase.as_str(),
        iterations: own.info.passes as u64,
        weights: own.weights,
    };
    if status != WeightStatus::OptimalInaccurate || realizations.nonzeros() > SECOND_OPINION {
        return Ok(first);
    }
    let left = Settings { time_limit: clock.left(), ..*settings };
    match second_opinion(realizations, target, &left, stop) {
        Ok(second) if second.gap < first.gap => Ok(CertifiedWeights { unseen: first.unseen, ..second }),
        Ok(second) if second.status == WeightStatus::UserLimit => {
            Ok(CertifiedWeights { status: WeightStatus::UserLimit, ..first })
        }
        Ok(_) => Ok(first),
        Err(Error::Interrupted) => Ok(CertifiedWeights { status: WeightStatus::Interrupted, ..first }),
        Err(error) => Err(error),
    }
}

/// Clarabel's weights, with their gap recomputed. `settings.time_limit` is checked after each iteration; there is no
/// limit on passes.
///
/// # Errors
/// As [`alse`], and [`Error::Interrupted`] after a stop.
pub fn second_opinion(
    realizations: &impl Realizations,
    target: &[f64],
    settings: &Settings,
    stop: &Stop,
) -> Result<CertifiedWeights> {
    let clock = Clock::start(settings);
    let size = realizations.size();
    let norm = realizations.norm();
    let proposal = if norm == 0.0 {
        // every realization is zero: all weights give the same estimate
        Proposal { weights: try_filled("the weights", 1.0 / size as f64, size)?, solver: "none", iterations: 0 }
    } else {
        clarabel::propose(realizations, target, settings, norm, stop)?
    };
    let solution = verify::verify(realizations, proposal, target, settings, stop)?;
    let limited = solution.status == WeightStatus::OptimalInaccurate && clock.over();
    Ok(CertifiedWeights { status: if limited { WeightStatus::UserLimit } else { solution.status }, ..solution })
}
