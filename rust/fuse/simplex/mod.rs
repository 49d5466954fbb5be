//! `min_w || sum_i w_i E_i - E* ||_F^2` over the simplex, certified.
//!
//! The realizations `E_i` have one nonzero per line (column), so `S w = sum_i w_i E_i` is a scatter and `S^T r` a
//! gather over the index array; no realization is written out. The steps for one problem:
//!
//! 1. `problem`: sizes and indices are checked; [`solve`] scales by a power of two;
//! 2. `relaxed_target`: the target is replaced by its projection on the affine hull, exactly;
//! 3. `sifting`: with far more realizations than dimensions, a subset is solved and certified on all;
//! 4. `run_sequence`: `newton_cg` up to 1.05 realizations per dimension, `proximal::direct` above 1.9,
//!    `proximal::augmented` between and if they fail, then `active_set` once the support is nearly found;
//! 5. `certificate`: gap and bounds are recomputed from the data, in compensated arithmetic, and give the `status`.

mod active_set;
mod budget;
mod certificate;
mod dense;
mod face;
mod factor;
mod hessian;
mod kernel;
mod newton_cg;
mod newton_system;
mod operator;
mod parallel;
mod problem;
mod proximal;
mod relaxed_target;
mod run_sequence;
mod select;
mod semismooth;
mod sifting;
mod singletons;
mod task;
#[cfg(test)]
mod tests;
mod threshold;
mod triangle;

pub use problem::{DenseProblem, IndexView, Info, Invalid, Options, Phase, SingletonProblem, Solution, WeightStatus};

use crate::error::Result;
use crate::memory::{try_collect, try_filled, try_room};
use crate::parallel::Stop;
use crate::sample::Index;
use crate::vector::dot;
use budget::{Budget, Limit};
pub(crate) use certificate::nonnegative;
use dense::Dense;
use operator::Operator;
use problem::SEARCH;
use task::{Found, Task};
pub(crate) use threshold::project;

use relaxed_target::{Relaxed, relax};
use singletons::Singletons;

/// Weights for realizations with one nonzero per line.
///
/// `warm` are weights of a similar problem; shorter ones are padded with zeros. A request of `stop` returns the best
/// weights so far.
pub fn solve(problem: &SingletonProblem, options: &Options, warm: Option<&[f64]>, stop: &Stop) -> Result<Solution> {
    match problem.indices {
        IndexView::U8(rows) => solve_rows(rows, problem, options, warm, stop),
        IndexView::U16(rows) => solve_rows(rows, problem, options, warm, stop),
        IndexView::U32(rows) => solve_rows(rows, problem, options, warm, stop),
    }
}

fn solve_rows<I: Index>(
    rows: &[I],
    problem: &SingletonProblem,
    options: &Options,
    warm: Option<&[f64]>,
    stop: &Stop,
) -> Result<Solution> {
    let scale = Scale::of(&[problem.g, problem.target]);
    let (g, target) = (scale.down(problem.g)?, scale.down(problem.target)?);
    let op = Singletons::new(rows, problem.length, &g, options.subsimplex, options.threads);
    let relaxed = relax(&target, op.counts()?, &g, problem.length, options.subsimplex)?;
    let line = select::closed_form(&op, &target, &g, options.subsimplex)?;
    let zero = problem.target.iter().all(|t| *t == 0.0);
    finish(&op, &target, relaxed, scale, options, Start { warm, line, zero }, stop)
}

/// Weights for dense realizations.
pub fn solve_dense(problem: &DenseProblem, options: &Options, warm: Option<&[f64]>, stop: &Stop) -> Result<Solution> {
    let scale = Scale::of(&[problem.samples, problem.target]);
    let target = scale.down(problem.target)?;
    let dim = target.len();
    let op = if scale.is_one() {
        Dense::new(problem.samples, dim, options.subsimplex, options.threads)
    } else {
        Dense::new(scale.down(problem.samples)?, dim, options.subsimplex, options.threads)
    };
    let dimension = dim.min(problem.size.saturating_sub(1)).max(1);
    let mut hit = try_filled(SEARCH, false, dim)?;
    for sample in problem.samples.chunks_exact(dim) {
        hit.iter_mut().zip(sample).for_each(|(hit, e)| *hit |= *e != 0.0);
    }
    let unseen = target.iter().zip(&hit).filter(|(t, hit)| **t != 0.0 && !**hit).count();
    let relaxed = Relaxed {
        q: try_collect(SEARCH, target.iter().copied())?,
        floor: 0.0,
        dimension,
        unseen,
        unreachable: false,
        counts: Vec::new(),
    };
    let zero = problem.target.iter().all(|t| *t == 0.0);
    finish(&op, &target, relaxed, scale, options, Start { warm, line: None, zero }, stop)
}

struct Start<'a> {
    warm: Option<&'a [f64]>,
    /// The solution, if there is a closed form.
    line: Option<Vec<f64>>,
    /// Whether the target is zero, not only so small beside the realizations that its square vanishes.
    zero: bool,
}

/// Solves the scaled problem, certifies the result, and scales back.
fn finish(
    op: &dyn Operator,
    target: &[f64],
    relaxed: Relaxed,
    scale: Scale,
    options: &Options,
    start: Start,
    stop: &Stop,
) -> Result<Solution> {
    let n = op.size();
    let entries = n * op.entries();
    let mut budget = Budget::new(stop, options.time_limit, options.max_passes, entries);
    let gamma = (0..n).map(|i| op.squared_norm(i)).fold(0.0, f64::max);
    let reference = if start.zero { gamma } else { dot(target, target) };
    let scale_of_gap = if reference > 0.0 { reference } else { gamma };
    let task = Task { op, relaxed: &relaxed, tol: 0.5 * options.tol * scale_of_gap, gamma };
    let warm = start.warm.map(|w| padded(w, n, options.subsimplex)).transpose()?;
    let (Found { mut weights, phase, work }, sifted) = match start.line {
        Some(weights) => (Found { weights, phase: Phase::ClosedForm, work: task::Work::default() }, false),
        None => select::run(&task, warm.as_deref(), &mut budget)?,
    };
    threshold::settle(&mut weights); // a solver only proposes: what is certified and handed out is on the simplex
    let mut certificate = certificate::certify(op, target, &weights)?;
    if !certificate.exact && relaxed.unseen == 0 && relaxed.floor <= 1e-24 * reference && phase != Phase::ClosedForm {
        certificate = select::polish(&task, target, &mut weights, certificate, &mut budget)?;
    }
    let relative_gap = if certificate.gap > 0.0 { certificate.gap / reference } else { 0.0 };
    let status = if relative_gap <= options.tol {
        WeightStatus::Optimal
    } else {
        match budget.limit() {
            Some(Limit::Stop) => WeightStatus::Interrupted,
            Some(Limit::Time | Limit::Work) => WeightStatus::UserLimit,
            None => WeightStatus::OptimalInaccurate,
        }
    };
    // The bound in closed form is a sum of d rounded squares.
    let floor = relaxed.floor * (1.0 - 4.0 * f64::EPSILON * (op.dim() as f64 + 4.0)).max(0.0);
    let lower_bound = (certificate.objective - certificate.gap).max(floor).min(certificate.objective).max(0.0);
    if options.subsimplex {
        weights.truncate(n - 1);
    }
    Ok(Solution {
        weights,
        gap: scale.up_square(certificate.gap),
        objective: scale.up_square(certificate.objective),
        lower_bound: scale.up_square(lower_bound),
        least_error: scale.up(lower_bound.sqrt() * (1.0 - f64::EPSILON)),
        exact: certificate.exact,
        status,
        info: Info {
            phase,
            sifted,
            passes: budget.passes(),
            newton_steps: work.newton,
            cg_steps: work.cg,
            relative_gap,
            dimension: relaxed.dimension,
        },
        unseen: relaxed.unseen,
    })
}

/// Warm weights of the right length, padded with zeros; the zero realization gets the rest of the sum.
fn padded(warm: &[f64], n: usize, subsimplex: bool) -> Result<Vec<f64>> {
    let given = n - usize::from(subsimplex);
    let mut w = try_room(SEARCH, n)?;
    w.extend(warm.iter().take(given).map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 }));
    w.resize(n, 0.0);
    if subsimplex && let Some(rest) = w.last_mut() {
        *rest = (1.0 - warm.iter().take(given).sum::<f64>()).max(0.0);
    }
    if !threshold::normalise(&mut w) {
        w.fill(1.0 / n as f64);
    }
    Ok(w)
}

/// A power of two that brings the largest number to `[1, 2)`; multiplication by it is exact.
#[derive(Clone, Copy)]
struct Scale {
    exponent: i32,
}

impl Scale {
    fn of(parts: &[&[f64]]) -> Self {
        let largest = parts.iter().flat_map(|p| p.iter()).fold(0.0_f64, |m, v| m.max(v.abs()));
        let exponent = if largest > 0.0 { largest.log2().floor() as i32 } else { 0 };
        Self { exponent }
    }

    fn is_one(self) -> bool {
        self.exponent == 0
    }

    fn down(self, values: &[f64]) -> Result<Vec<f64>> {
        // Two factors: one alone can overflow for subnormal input.
        let half = -self.exponent / 2;
        let (a, b) = (power(half), power(-self.exponent - half));
        try_collect(SEARCH, values.iter().map(|v| v * a * b))
    }

    fn up(self, value: f64) -> f64 {
        let half = self.exponent / 2;
        value * power(half) * power(self.exponent - half)
    }

    fn up_square(self, value: f64) -> f64 {
        let p = power(self.exponent);
        value * p * p
    }
}

fn power(exponent: i32) -> f64 {
    2.0_f64.powi(exponent)
}
