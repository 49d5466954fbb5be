//! Clarabel as a proposer of weights: the augmented sparse form on data of unit norm.
//!
//! Variables `(w, y)`: minimise `1/2 ||y||^2` subject to `S w - y = E*` (rows that some realization hits), `sum w = 1`
//! (or `<= 1`) and `w >= 0`. All data are divided by the largest norm of a realization first. The Gram form is denser,
//! and interior-point solvers have reported wrong optima as solved for it, and for badly scaled data.

use std::sync::Arc;
use std::time::Duration;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverError, SupportedConeT};

use super::realizations::Realizations;
use super::solution::{Proposal, Settings};
use crate::error::{Error, Result};
use crate::fuse::Weights;
use crate::memory::{covered, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::{Stop, detached};

const WHAT: &str = "the problem for Clarabel";

/// The conic data, owned, so that the solve can outlive an interrupted call.
struct Conic {
    size: usize,
    quadratic: CscMatrix<f64>,
    constraints: CscMatrix<f64>,
    right: Vec<f64>,
    cones: Vec<SupportedConeT<f64>>,
}

/// Weights from Clarabel, to be judged by their gap. `norm` is the largest norm of a realization.
pub(super) fn propose(
    realizations: &impl Realizations,
    target: &[f64],
    settings: &Settings,
    norm: f64,
    stop: &Stop,
) -> Result<Proposal> {
    run(conic(realizations, target, settings.set, norm)?, settings.time_limit, stop)
}

fn conic(realizations: &impl Realizations, target: &[f64], set: Weights, norm: f64) -> Result<Conic> {
    let size = realizations.size();
    let mut row_of = try_filled(WHAT, usize::MAX, target.len())?;
    let mut hit: Vec<usize> = try_room(WHAT, target.len())?;
    for i in 0..size {
        realizations.entries(i, |k, _| {
            if row_of[k] == usize::MAX {
                row_of[k] = hit.len();
                hit.push(k);
            }
        });
    }
    // rows: the hit entries of S w - y = E*, then the sum, then -w <= 0
    let d = hit.len();
    let nonzeros = realizations.nonzeros() + 2 * size + d;
    let (mut rows, mut values) = (try_room(WHAT, nonzeros)?, try_room(WHAT, nonzeros)?);
    let mut start = try_room(WHAT, size + d + 1)?;
    start.push(0);
    let mut column: Vec<(usize, f64)> = try_room(WHAT, d + 2)?;
    for i in 0..size {
        column.clear();
        realizations.entries(i, |k, v| column.push((row_of[k], v / norm)));
        column.sort_unstable_by_key(|&(row, _)| row);
        column.extend([(d, 1.0), (d + 1 + i, -1.0)]);
        rows.extend(column.iter().map(|c| c.0));
        values.extend(column.iter().map(|c| c.1));
        start.push(rows.len());
    }
    for row in 0..d {
        rows.push(row);
        values.push(-1.0);
        start.push(rows.len());
    }
    let mut right = try_zeros(WHAT, d + 1 + size)?;
    right.iter_mut().zip(&hit).for_each(|(right, &k)| *right = target[k] / norm);
    right[d] = 1.0;
    let sum_cone = match set {
        Weights::Simplex => SupportedConeT::ZeroConeT(1),
        Weights::Subsimplex => SupportedConeT::NonnegativeConeT(1),
    };
    let quadratic_start = try_collect(WHAT, (0..=size + d).map(|j| j.saturating_sub(size)))?;
    let diagonal = (try_collect(WHAT, size..size + d)?, try_filled(WHAT, 1.0, d)?);
    let mut cones = try_room(WHAT, 3)?;
    cones.extend([SupportedConeT::ZeroConeT(d), sum_cone, SupportedConeT::NonnegativeConeT(size)]);
    Ok(Conic {
        size,
        quadratic: CscMatrix::new(size + d, size + d, quadratic_start, diagonal.0, diagonal.1),
        constraints: CscMatrix::new(d + 1 + size, size + d, start, rows, values),
        right,
        cones,
    })
}

impl Conic {
    /// Bytes that Clarabel allocates for this problem, at most.
    ///
    /// The factor has `2 (size + d) + d + 1` rows. An ordering for little fill eliminates the weights first. This
    /// leaves columns of the entries of a realization, and a full triangle for the rows they hit (or for the
    /// realizations, if there are fewer rows than these). The rest are vectors and a bounded number of copies of the
    /// constraints.
    fn bytes(&self) -> u128 {
        let (rows, columns) = (self.constraints.m as u128, self.constraints.n as u128);
        let side = (columns - self.size as u128).min(self.size as u128) + 1;
        let factor = self.constraints.nzval.len() as u128 + side * side;
        16 * (3 * factor + 60 * (rows + columns)) + (1 << 16)
    }
}

/// Clarabel checks for a stop once per iteration, which can take seconds. It therefore solves on its own thread, which
/// an interrupted caller leaves behind, and which ends at its next iteration.
fn run(problem: Conic, time_limit: Option<Duration>, stop: &Stop) -> Result<Proposal> {
    let cancelled = Arc::new(Stop::new());
    let hook = Arc::clone(&cancelled);
    let result = detached("stochens-clarabel", stop, move || solve(&problem, time_limit, hook));
    if result.is_err() {
        cancelled.request();
    }
    result
}

fn solve(problem: &Conic, time_limit: Option<Duration>, cancelled: Arc<Stop>) -> Result<Proposal> {
    let refused = |e: &dyn std::fmt::Display| Error::Numerical(format!("Clarabel refused the problem: {e}"));
    let settings: DefaultSettings<f64> = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-13)
        .tol_gap_rel(1e-13)
        .tol_feas(1e-13)
        .max_iter(200)
        .time_limit(time_limit.map_or(f64::INFINITY, |limit| limit.as_secs_f64()))
        .presolve_enable(false)
        .build()
        .map_err(|e| refused(&e))?;
    let linear = try_zeros(WHAT, problem.quadratic.n)?;
    let Conic { quadratic, constraints, right, cones, size } = problem;
    let solved = covered("Clarabel", problem.bytes(), || {
        let mut solver = DefaultSolver::new(quadratic, &linear, constraints, right, cones, settings)?;
        solver.set_termination_callback(move |_| cancelled.requested());
        solver.solve();
        Ok(solver.solution)
    })?;
    let solution = solved.map_err(|e: SolverError| refused(&e))?;
    Ok(Proposal {
        weights: try_copy(WHAT, &solution.x[..*size])?,
        solver: "clarabel",
        iterations: u64::from(solution.iterations),
    })
}
