//! ALSE for everything the closed form does not cover: `min ||sum_i w_i E_i - E*||^2` over the weights, certified.
//!
//! A ladder: our own solver ([`super::simplex`]); where its gap is too large, Clarabel on scaled data; then whichever is
//! better, with an honest status. A solver only proposes weights: the gap that judges them is recomputed from the
//! realizations, and the status follows from that gap alone.

mod clarabel;
mod judge;

use super::simplex::{self, DenseProblem, IndexView, Options, SingletonProblem};
use super::{Dense, Weights, distance};
use crate::error::{Error, Result};
use crate::parallel::Stop;
use crate::sample::{Indices, Singletons};

/// Nonzero entries up to which Clarabel is asked: about a minute on one core.
const SECOND_OPINION: usize = 200_000;

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
    /// A proved lower bound on the squared error of any weights.
    pub lower_bound: f64,
    /// The target lies in the hull of the realizations: the error is rounding.
    pub exact: bool,
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
    /// Nonzero entries of all realizations together, at most.
    fn nonzeros(&self) -> usize;
    /// Weights and certificate of our own solver.
    fn solve(&self, target: &[f64], options: &Options, stop: &Stop) -> Result<simplex::Solution>;
}

/// The solver checks its input again; after the checks here that cannot fail.
fn refused(invalid: simplex::Invalid) -> Error {
    Error::Numerical(format!("the solver refused the problem: {invalid}"))
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
    fn nonzeros(&self) -> usize {
        Singletons::size(self) * self.law().lines()
    }
    fn solve(&self, target: &[f64], options: &Options, stop: &Stop) -> Result<simplex::Solution> {
        with_problem(self, target, |problem| simplex::solve(problem, options, None, stop.flag()))
    }
}

/// Poses the problem of `draws` in the solver's terms: sign-free, the law's signs divided out of the target.
fn with_problem<T>(draws: &Singletons, target: &[f64], work: impl FnOnce(&SingletonProblem<'_>) -> T) -> Result<T> {
    let law = draws.law();
    let signs = law.signs();
    let target: Vec<f64> = target.iter().zip(&signs).map(|(t, s)| if *s == 0.0 { *t } else { t * s }).collect();
    let used = draws.size() * law.lines();
    let indices = match &**draws.indices() {
        Indices::U8(v) => IndexView::U8(&v[..used]),
        Indices::U16(v) => IndexView::U16(&v[..used]),
        Indices::U32(v) => IndexView::U32(&v[..used]),
    };
    SingletonProblem::new(indices, draws.size(), law.lines(), law.length(), law.gamma(), &target)
        .map(|problem| work(&problem))
        .map_err(refused)
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
    fn nonzeros(&self) -> usize {
        self.values().len()
    }
    fn solve(&self, target: &[f64], options: &Options, stop: &Stop) -> Result<simplex::Solution> {
        DenseProblem::new(self.values(), Dense::size(self), target)
            .map(|problem| simplex::solve_dense(&problem, options, None, stop.flag()))
            .map_err(refused)
    }
}

fn options(set: Weights, tol: f64, threads: usize) -> Options {
    Options { tol, subsimplex: set == Weights::Subsimplex, threads, ..Options::default() }
}

/// Solves `min ||sum_i w_i E_i - target||` over `set` to a gap of `tol ||target||^2`.
///
/// # Errors
/// [`Error::Interrupted`] after a stop, [`Error::Numerical`] if a solver refuses the problem.
pub fn alse(
    realizations: &impl Realizations,
    target: &[f64],
    set: Weights,
    tol: f64,
    threads: usize,
    stop: &Stop,
) -> Result<Solution> {
    let options = options(set, tol, threads);
    let own = realizations.solve(target, &options, stop)?;
    certified(realizations, own, target, set, tol, stop)
}

/// [`alse`] for the first `k` realizations, for each `k` in the increasing `sizes`: each solution starts from the last
/// one where that pays, and each has its own certificate.
///
/// # Errors
/// As [`alse`].
pub fn alse_prefixes(
    draws: &Singletons,
    target: &[f64],
    set: Weights,
    tol: f64,
    threads: usize,
    sizes: &[usize],
    stop: &Stop,
) -> Result<Vec<Solution>> {
    let options = options(set, tol, threads);
    let path = with_problem(draws, target, |problem| simplex::solve_path(problem, sizes, &options, stop.flag()))?;
    path.into_iter()
        .zip(sizes)
        .map(|(own, &size)| certified(&draws.prefix(size), own, target, set, tol, stop))
        .collect()
}

/// Our solver's weights with their estimate, or Clarabel's where those are not good enough and Clarabel's are better.
fn certified(
    realizations: &impl Realizations,
    own: simplex::Solution,
    target: &[f64],
    set: Weights,
    tol: f64,
    stop: &Stop,
) -> Result<Solution> {
    stop.check()?;
    let estimate = realizations.combine(&own.weights, stop)?;
    let first = Solution {
        error: distance(&estimate, target),
        estimate,
        gap: own.gap,
        lower_bound: own.lower_bound,
        exact: own.exact,
        status: if own.status == simplex::Status::Optimal { Status::Optimal } else { Status::OptimalInaccurate },
        solver: own.info.phase.as_str(),
        iterations: own.info.passes as u64,
        weights: own.weights,
    };
    if first.status == Status::Optimal || realizations.nonzeros() > SECOND_OPINION {
        return Ok(first);
    }
    let second = second_opinion(realizations, target, set, tol, stop)?;
    Ok(if second.gap < first.gap { second } else { first })
}

/// Clarabel's weights, judged by the same measure.
///
/// # Errors
/// As [`alse`].
pub fn second_opinion(
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
    judge::judge(realizations, proposal, target, set, tol, stop)
}
