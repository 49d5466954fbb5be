//! ALSE for all problems without a closed form: `min ||sum_i w_i E_i - E*||^2` over the weights, certified.
//!
//! First our own solver ([`super::simplex`]); if its gap is too large, Clarabel on scaled data; then the better of
//! both. A solver only proposes weights. Their gap is recomputed from the realizations and gives the status, together
//! with the reason why the search ended if the gap is too large.

mod clarabel;
mod judge;
mod realizations;

use std::time::{Duration, Instant};

use super::simplex::{self, Options};
use super::{Weights, distance};
use crate::error::{Error, Result};
use crate::memory::try_filled;
use crate::parallel::Stop;
use crate::sample::Singletons;

pub use super::simplex::Status;
pub use realizations::Realizations;

/// Nonzero entries up to which Clarabel is tried: about a minute on one core.
const SECOND_OPINION: usize = 200_000;

/// Weight set, tolerance, and limits on time and passes.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// The set of feasible weights.
    pub set: Weights,
    /// Largest gap, relative to `||E*||^2` (to the squared norm of a realization where `E* = 0`).
    pub tol: f64,
    /// Wall time after which the best weights so far are returned.
    pub time_limit: Option<Duration>,
    /// Passes over the realizations (one product with `S`, one with `S^T`) after which the best weights so far are
    /// returned.
    pub max_passes: Option<usize>,
    /// Number of threads, which share the realizations.
    pub threads: usize,
}

impl Settings {
    /// One thread and no limits.
    pub const fn new(set: Weights, tol: f64) -> Self {
        Self { set, tol, time_limit: None, max_passes: None, threads: 1 }
    }

    fn options(&self, clock: &Clock) -> Options {
        let defaults = Options::default();
        Options {
            tol: self.tol,
            subsimplex: self.set == Weights::Subsimplex,
            threads: self.threads,
            time_limit: clock.left(),
            max_passes: self.max_passes.unwrap_or(defaults.max_passes),
        }
    }
}

/// When the time limit ends.
struct Clock(Option<Instant>);

impl Clock {
    fn start(settings: &Settings) -> Self {
        Self(settings.time_limit.and_then(|limit| Instant::now().checked_add(limit)))
    }

    fn left(&self) -> Option<Duration> {
        self.0.map(|end| end.saturating_duration_since(Instant::now()))
    }

    fn over(&self) -> bool {
        self.left() == Some(Duration::ZERO)
    }
}

/// Weights with their certificate.
#[derive(Debug, Clone)]
pub struct Solution {
    /// One weight per realization, feasible.
    pub weights: Vec<f64>,
    /// `sum_i w_i E_i`.
    pub estimate: Vec<f64>,
    /// `||sum_i w_i E_i - E*||`.
    pub error: f64,
    /// `max_v <f'(w), w - v>` over the weight set, for `f = ||sum_i w_i E_i - E*||^2`: at least `f(w) - min f`.
    pub gap: f64,
    /// A proved lower bound on the error of any weights.
    pub lower_bound: f64,
    /// Nonzero entries of the target that are zero in every realization.
    pub unseen: usize,
    /// The target lies in the hull of the realizations, so the error is rounding only.
    pub exact: bool,
    /// Status that follows from the recomputed gap.
    pub status: Status,
    /// Which solver proposed the weights, and its number of iterations.
    pub solver: &'static str,
    /// Iterations of that solver.
    pub iterations: u64,
}

/// Weights from a solver, feasible or not.
struct Proposal {
    weights: Vec<f64>,
    solver: &'static str,
    iterations: u64,
}

/// Solves `min ||sum_i w_i E_i - target||` to a gap of `tol ||target||^2`.
///
/// A limit or a stop ends the search without an error: the result has the best feasible weights, their gap, and a
/// status that says so.
///
/// # Errors
/// [`Error::Numerical`] if a solver refuses the problem, [`Error::Memory`].
pub fn alse(realizations: &impl Realizations, target: &[f64], settings: &Settings, stop: &Stop) -> Result<Solution> {
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
    mut visit: impl FnMut(&Solution) -> Result<()>,
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
) -> Result<Solution> {
    let spent = settings.max_passes.is_some_and(|most| own.info.passes >= most as f64);
    let status = match own.status {
        Status::UserLimit if !spent && !clock.over() => Status::OptimalInaccurate,
        status => status,
    };
    // one pass, also after a stop, since the caller needs the estimate
    let estimate = realizations.combine(&own.weights, &Stop::new())?;
    let error = distance(&estimate, target);
    let first = Solution {
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
    if status != Status::OptimalInaccurate || realizations.nonzeros() > SECOND_OPINION {
        return Ok(first);
    }
    let left = Settings { time_limit: clock.left(), ..*settings };
    match second_opinion(realizations, target, &left, stop) {
        Ok(second) if second.gap < first.gap => Ok(Solution { unseen: first.unseen, ..second }),
        Ok(second) if second.status == Status::UserLimit => Ok(Solution { status: Status::UserLimit, ..first }),
        Ok(_) => Ok(first),
        Err(Error::Interrupted) => Ok(Solution { status: Status::Interrupted, ..first }),
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
) -> Result<Solution> {
    let clock = Clock::start(settings);
    let size = realizations.size();
    let norm = realizations.norm();
    let proposal = if norm == 0.0 {
        // every realization is zero: all weights give the same estimate
        Proposal { weights: try_filled("the weights", 1.0 / size as f64, size)?, solver: "none", iterations: 0 }
    } else {
        clarabel::propose(realizations, target, settings, norm, stop)?
    };
    let solution = judge::judge(realizations, proposal, target, settings, stop)?;
    let limited = solution.status == Status::OptimalInaccurate && clock.over();
    Ok(Solution { status: if limited { Status::UserLimit } else { solution.status }, ..solution })
}
