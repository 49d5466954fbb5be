//! What is asked of ALSE and what comes out: settings with their clock, proposed weights, certified weights.

use std::time::{Duration, Instant};

use crate::fuse::Weights;
use crate::fuse::simplex::{Options, WeightStatus};

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
    #[must_use]
    pub const fn new(set: Weights, tol: f64) -> Self {
        Self { set, tol, time_limit: None, max_passes: None, threads: 1 }
    }

    pub(super) fn options(&self, clock: &Clock) -> Options {
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
pub(super) struct Clock(Option<Instant>);

impl Clock {
    pub(super) fn start(settings: &Settings) -> Self {
        Self(settings.time_limit.and_then(|limit| Instant::now().checked_add(limit)))
    }

    pub(super) fn left(&self) -> Option<Duration> {
        self.0.map(|end| end.saturating_duration_since(Instant::now()))
    }

    pub(super) fn over(&self) -> bool {
        self.left() == Some(Duration::ZERO)
    }
}

/// Weights with their certificate.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct CertifiedWeights {
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
    pub status: WeightStatus,
    /// Which solver proposed the weights, and its number of iterations.
    pub solver: &'static str,
    /// Iterations of that solver.
    pub iterations: u64,
}

/// Weights from a solver, feasible or not.
pub(super) struct Proposal {
    pub(super) weights: Vec<f64>,
    pub(super) solver: &'static str,
    pub(super) iterations: u64,
}
