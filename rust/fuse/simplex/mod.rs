//! ALSE for everything the closed form does not cover: `min ||sum_i w_i E_i - E*||^2` over the weights, certified.
//!
//! A solver only proposes weights. They are made feasible, and the gap that judges them is recomputed from the
//! realizations ([`certificate`]); the status follows from that gap alone.

mod certificate;
mod clarabel;

use super::{Dense, Weights};
use crate::error::Result;
use crate::parallel::Stop;
use crate::sample::Singletons;

/// How a solution ended; judged by the recomputed gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// The gap is at most `tol ||E*||^2` (`tol` times the squared norm of a realization where `E* = 0`).
    Optimal,
    /// The best weights found, with a larger gap.
    OptimalInaccurate,
}

impl Status {
    /// The status as a word of the convex-optimization world.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Optimal => "optimal",
            Self::OptimalInaccurate => "optimal_inaccurate",
        }
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
    /// What the gap says.
    pub status: Status,
    /// Which solver proposed the weights, and its number of iterations.
    pub solver: &'static str,
    /// Iterations of that solver.
    pub iterations: u64,
}

/// Weights that a solver found, feasible or not.
struct Proposal {
    weights: Vec<f64>,
    solver: &'static str,
    iterations: u64,
}

/// Realizations as a linear map from weights to entries.
pub trait Realizations {
    /// Number of realizations.
    fn size(&self) -> usize;
    /// `sum_i w_i E_i`.
    fn combine(&self, weights: &[f64], stop: &Stop) -> Result<Vec<f64>>;
    /// `<r, E_i>` for every `i`.
    fn correlate(&self, r: &[f64]) -> Vec<f64>;
    /// The largest norm of a realization.
    fn norm(&self) -> f64;
    /// Appends the nonzero entries of realization `i`, by increasing position.
    fn entries(&self, i: usize, out: &mut Vec<(usize, f64)>);
}

impl Realizations for Singletons {
    fn size(&self) -> usize {
        Singletons::size(self)
    }
    fn combine(&self, weights: &[f64], stop: &Stop) -> Result<Vec<f64>> {
        Singletons::combine(self, weights, stop)
    }
    fn correlate(&self, r: &[f64]) -> Vec<f64> {
        Singletons::correlate(self, r)
    }
    fn norm(&self) -> f64 {
        self.law().gamma().iter().fold(0.0, |norm: f64, &g| norm.hypot(g))
    }
    fn entries(&self, i: usize, out: &mut Vec<(usize, f64)>) {
        use crate::sample::Index as _;
        let (lines, length) = (self.law().lines(), self.law().length());
        crate::sample::with_indices!(&**self.indices(), indices => {
            for (j, r) in indices[i * lines..(i + 1) * lines].iter().enumerate() {
                let k = j * length + r.get();
                let value = self.law().gamma()[j].copysign(self.law().values()[k]);
                if value != 0.0 {
                    out.push((k, value));
                }
            }
        });
    }
}

impl Realizations for Dense<'_> {
    fn size(&self) -> usize {
        Dense::size(self)
    }
    fn combine(&self, weights: &[f64], _: &Stop) -> Result<Vec<f64>> {
        Ok(Dense::combine(self, weights))
    }
    fn correlate(&self, r: &[f64]) -> Vec<f64> {
        Dense::correlate(self, r)
    }
    fn norm(&self) -> f64 {
        let norm = |i| self.row(i).iter().fold(0.0, |norm: f64, &e| norm.hypot(e));
        (0..Dense::size(self)).map(norm).fold(0.0, f64::max)
    }
    fn entries(&self, i: usize, out: &mut Vec<(usize, f64)>) {
        out.extend(self.row(i).iter().enumerate().filter(|(_, e)| **e != 0.0).map(|(k, e)| (k, *e)));
    }
}

/// Solves `min ||sum_i w_i E_i - target||` over `set` to a gap of `tol ||target||^2`.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop; [`crate::Error::Numerical`] only if the solver refuses the problem.
pub fn solve(
    realizations: &impl Realizations,
    target: &[f64],
    set: Weights,
    tol: f64,
    stop: &Stop,
) -> Result<Solution> {
    let size = realizations.size();
    let norm = realizations.norm();
    let proposal = if norm == 0.0 {
        // every realization is zero: all weights give the same estimate
        Proposal { weights: vec![1.0 / size as f64; size], solver: "none", iterations: 0 }
    } else {
        clarabel::propose(realizations, target, set, norm, stop)?
    };
    certificate::judge(realizations, proposal, target, set, tol, stop)
}
