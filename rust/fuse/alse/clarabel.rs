//! Clarabel as a proposer of weights: the augmented sparse form on data of unit norm.
//!
//! Variables `(w, y)`: minimise `1/2 ||y||^2` subject to `S w - y = E*` (rows that some realization hits), `sum w = 1` (or
//! `<= 1`) and `w >= 0`. The Gram form is denser and, like badly scaled data, has made interior-point solvers report
//! wrong optima as solved; everything is divided by the largest norm of a realization first.

use std::sync::Arc;
use std::time::Duration;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SupportedConeT};

use super::{Proposal, Realizations, Settings};
use crate::error::{Error, Result};
use crate::fuse::Weights;
use crate::parallel::{Stop, detached};

/// The conic data, owned, so that the solve can outlive an interrupted caller.
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
    run(conic(realizations, target, settings.set, norm), settings.time_limit, stop)
}

fn conic(realizations: &impl Realizations, target: &[f64], set: Weights, norm: f64) -> Conic {
    let size = realizations.size();
    let mut columns = Vec::with_capacity(size);
    let mut row_of = vec![usize::MAX; target.len()];
    let mut hit: Vec<usize> = Vec::new();
    for i in 0..size {
        let mut entries = Vec::new();
        realizations.entries(i, &mut entries);
        for &(k, _) in &entries {
            if row_of[k] == usize::MAX {
                row_of[k] = hit.len();
                hit.push(k);
            }
        }
        columns.push(entries);
    }
    // rows: the hit entries of S w - y = E*, then the sum, then -w <= 0
    let d = hit.len();
    let (mut start, mut rows, mut values) = (vec![0], Vec::new(), Vec::new());
    for (i, entries) in columns.into_iter().enumerate() {
        let mut column: Vec<(usize, f64)> = entries.into_iter().map(|(k, v)| (row_of[k], v / norm)).collect();
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
    let mut right: Vec<f64> = hit.iter().map(|&k| target[k] / norm).collect();
    right.push(1.0);
    right.resize(d + 1 + size, 0.0);
    let sum_cone = match set {
        Weights::Simplex => SupportedConeT::ZeroConeT(1),
        Weights::Subsimplex => SupportedConeT::NonnegativeConeT(1),
    };
    let quadratic_start = (0..=size + d).map(|j| j.saturating_sub(size)).collect();
    Conic {
        size,
        quadratic: CscMatrix::new(size + d, size + d, quadratic_start, (size..size + d).collect(), vec![1.0; d]),
        constraints: CscMatrix::new(d + 1 + size, size + d, start, rows, values),
        right,
        cones: vec![SupportedConeT::ZeroConeT(d), sum_cone, SupportedConeT::NonnegativeConeT(size)],
    }
}

/// Clarabel looks at its stop hook once per iteration, which can take seconds: it solves on a thread that an interrupted
/// caller leaves behind, and that ends at its next iteration.
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
    let linear = vec![0.0; problem.quadratic.n];
    let mut solver =
        DefaultSolver::new(&problem.quadratic, &linear, &problem.constraints, &problem.right, &problem.cones, settings)
            .map_err(|e| refused(&e))?;
    solver.set_termination_callback(move |_| cancelled.requested());
    solver.solve();
    Ok(Proposal {
        weights: solver.solution.x[..problem.size].to_vec(),
        solver: "clarabel",
        iterations: u64::from(solver.solution.iterations),
    })
}
