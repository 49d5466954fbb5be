//! The scaled problem, its solution, and the counters of the report.

use super::operator::Operator;
use super::problem::Phase;
use super::problem::SEARCH;
use super::relaxed_target::Relaxed;
use crate::error::Result;
use crate::memory::{try_copy, try_filled};

/// The scaled problem with its relaxed target and absolute tolerance.
pub(crate) struct Task<'a> {
    pub op: &'a dyn Operator,
    pub relaxed: &'a Relaxed,
    pub tol: f64,
    /// `max_i ||E_i||^2`
    pub gamma: f64,
}

/// Weights on the simplex and the algorithm that found them.
pub(crate) struct Found {
    pub weights: Vec<f64>,
    pub phase: Phase,
    pub work: Work,
}

/// Weights on the simplex and their gap in plain arithmetic.
#[derive(Clone)]
pub(crate) struct Iterate {
    pub weights: Vec<f64>,
    pub gap: f64,
}

/// Counters for the report.
#[derive(Clone, Copy, Default)]
pub(crate) struct Work {
    pub newton: usize,
    pub cg: usize,
    pub factors: usize,
}

/// Weights to start from: the uniform ones if there are none.
pub(crate) fn start_or_uniform(start: Option<&[f64]>, n: usize) -> Result<Vec<f64>> {
    start.map_or_else(|| try_filled(SEARCH, 1.0 / n as f64, n), |start| try_copy(SEARCH, start))
}
