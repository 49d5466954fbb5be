//! Convex programs for Clarabel in sparse form: `min 1/2 z' P z + q' z` with `C z = c` for the first rows, `<=` for the
//! rest.

use std::sync::Arc;
use std::time::Duration;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverError, SupportedConeT};

use super::task::WHAT;
use crate::error::{Error, Result};
use crate::limits::quadratic::Until;
use crate::memory::{covered, try_copy, try_push, try_zeros};
use crate::parallel::{Stop, detached_until};

/// Tolerances asked of Clarabel, more than it reaches: what it gives is judged from the data.
const TOLERANCE: f64 = 1e-13;

/// Entries in any order; those of one place are added.
#[derive(Default)]
struct Entries {
    rows: Vec<usize>,
    columns: Vec<usize>,
    values: Vec<f64>,
}

impl Entries {
    fn push(&mut self, row: usize, column: usize, value: f64) -> Result<()> {
        try_push(WHAT, &mut self.rows, row)?;
        try_push(WHAT, &mut self.columns, column)?;
        try_push(WHAT, &mut self.values, value)
    }

    fn matrix(self, rows: usize, columns: usize) -> CscMatrix<f64> {
        CscMatrix::new_from_triplets(rows, columns, self.rows, self.columns, self.values)
    }
}

pub(super) struct Program {
    quadratic: Entries,
    pub(super) linear: Vec<f64>,
    constraints: Entries,
    pub(super) right: Vec<f64>,
    equal: usize,
    /// Steps, and variables of a step.
    stages: (usize, usize),
}

/// What Clarabel found: variables, multipliers and slacks of the rows.
pub(super) struct Point {
    pub(super) z: Vec<f64>,
    pub(super) multipliers: Vec<f64>,
    pub(super) slacks: Vec<f64>,
    pub(super) iterations: usize,
    pub(super) timed_out: bool,
}

impl Program {
    pub(super) fn new(variables: usize, stages: (usize, usize)) -> Result<Self> {
        let linear = try_zeros(WHAT, variables)?;
        let (quadratic, constraints) = Default::default();
        Ok(Self { quadratic, linear, constraints, right: Vec::new(), equal: 0, stages })
    }

    /// Adds `scale W` for the variables from `start` on; `W` is symmetric.
    pub(super) fn weigh(&mut self, start: usize, w: &[f64], side: usize, scale: f64) -> Result<()> {
        for i in 0..side {
            for j in i..side {
                if w[i * side + j] != 0.0 {
                    self.quadratic.push(start + i, start + j, scale * w[i * side + j])?;
                }
            }
        }
        Ok(())
    }

    /// One more row; equalities come first.
    pub(super) fn row(&mut self, entries: &[(usize, f64)], right: f64, equal: bool) -> Result<()> {
        self.equal += usize::from(equal);
        let row = self.right.len();
        for &(column, value) in entries {
            self.entry(row, column, value)?;
        }
        try_push(WHAT, &mut self.right, right)
    }

    pub(super) fn entry(&mut self, row: usize, column: usize, value: f64) -> Result<()> {
        if value == 0.0 { Ok(()) } else { self.constraints.push(row, column, value) }
    }

    /// Bytes that Clarabel allocates for this problem, at most: an ordering for little fill goes from step to step, and
    /// leaves for each the full triangle of what two of them share. The rest are vectors and copies of the entries.
    fn bytes(&self) -> u128 {
        let (rows, columns) = (self.right.len() as u128, self.linear.len() as u128);
        let entries = (self.constraints.values.len() + self.quadratic.values.len()) as u128;
        let (steps, width) = (self.stages.0 as u128, self.stages.1 as u128);
        let factor = 2 * entries + 3 * steps * width * width;
        16 * (3 * factor + 12 * entries + 60 * (rows + columns)) + (1 << 16)
    }

    /// On its own thread, which an interrupted caller leaves behind, and which ends at its next iteration; Clarabel
    /// looks at the clock after its first factorization only.
    pub(super) fn solve(self, until: Until<'_>) -> Result<Point> {
        let cancelled = Arc::new(Stop::new());
        let (hook, limit) = (Arc::clone(&cancelled), until.left());
        let result = detached_until("stochens-clarabel", || until.overdue(), move || self.run(limit, hook));
        if result.is_err() {
            cancelled.request();
        }
        result
    }

    fn run(self, limit: Option<Duration>, cancelled: Arc<Stop>) -> Result<Point> {
        let refused = |e: &dyn std::fmt::Display| Error::Numerical(format!("Clarabel refused the problem: {e}"));
        let settings: DefaultSettings<f64> = DefaultSettingsBuilder::default()
            .verbose(false)
            .tol_gap_abs(TOLERANCE)
            .tol_gap_rel(TOLERANCE)
            .tol_feas(TOLERANCE)
            .max_iter(100)
            .time_limit(limit.map_or(f64::INFINITY, |limit| limit.as_secs_f64()))
            .presolve_enable(false)
            .build()
            .map_err(|e| refused(&e))?;
        let (rows, columns) = (self.right.len(), self.linear.len());
        let cones = [SupportedConeT::ZeroConeT(self.equal), SupportedConeT::NonnegativeConeT(rows - self.equal)];
        let solved = covered("Clarabel", self.bytes(), || {
            let (quadratic, constraints) =
                (self.quadratic.matrix(columns, columns), self.constraints.matrix(rows, columns));
            let mut solver = DefaultSolver::new(&quadratic, &self.linear, &constraints, &self.right, &cones, settings)?;
            solver.set_termination_callback(move |_| cancelled.requested());
            solver.solve();
            Ok(solver.solution)
        })?;
        let found = solved.map_err(|e: SolverError| refused(&e))?;
        Ok(Point {
            z: try_copy(WHAT, &found.x)?,
            multipliers: try_copy(WHAT, &found.z)?,
            slacks: try_copy(WHAT, &found.s)?,
            iterations: found.iterations as usize,
            timed_out: found.status == clarabel::solver::SolverStatus::MaxTime,
        })
    }
}
