//! `min z` subject to `||M_w u - t_w|| <= z` for some units and to limits of u, by Clarabel.

use std::time::Duration;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverError, SupportedConeT};

use super::units::WHAT;
use crate::error::{Error, Result};
use crate::memory::{covered, try_collect, try_copy, try_room, try_zeros};

/// Units that are solved for together, scaled: `u = unit v`, `M = gain M'`, `t = unit gain t'`, powers of two.
pub(super) struct Problem<'a> {
    /// `(count * rows, d)`
    pub(super) maps: &'a [f64],
    /// `count * rows`
    pub(super) targets: &'a [f64],
    pub(super) rows: usize,
    pub(super) low: &'a [f64],
    pub(super) high: &'a [f64],
    /// Inputs that are not fixed; the others are at `low`.
    pub(super) free: &'a [usize],
    pub(super) gain: f64,
    pub(super) unit: f64,
}

/// A proposal: the inputs, inside their limits, and the vectors `v_w` of the dual.
pub(super) struct Proposal {
    pub(super) control: Vec<f64>,
    pub(super) vectors: Vec<f64>,
}

impl Problem<'_> {
    pub(super) fn solve(&self, time: Option<Duration>) -> Result<Proposal> {
        let (d, free, p) = (self.low.len(), self.free.len(), self.rows);
        let count = self.targets.len() / p;
        let finite = |ends: &[f64]| self.free.iter().filter(|&&j| ends[j].is_finite()).count();
        let (up, down) = (finite(self.high), finite(self.low));
        let cone_start = up + down;
        let height = cone_start + count * (p + 1);
        let nonzeros = cone_start + count * (p * free + 1);
        let (mut rows, mut values) = (try_room(WHAT, nonzeros)?, try_room(WHAT, nonzeros)?);
        let mut start = try_room(WHAT, free + 2)?;
        start.push(0);
        let mut right = try_zeros(WHAT, height)?;
        // rows: u <= high, -u <= -low, then (z, M_w u - t_w) of every unit
        let (mut above, mut below) = (0, up);
        for &j in self.free {
            if self.high[j].is_finite() {
                rows.push(above);
                values.push(1.0);
                right[above] = self.high[j] / self.unit;
                above += 1;
            }
            if self.low[j].is_finite() {
                rows.push(below);
                values.push(-1.0);
                right[below] = -self.low[j] / self.unit;
                below += 1;
            }
            for (i, row) in self.maps.chunks_exact(d).enumerate() {
                rows.push(cone_start + i / p * (p + 1) + 1 + i % p);
                values.push(-row[j] / self.gain);
            }
            start.push(rows.len());
        }
        for w in 0..count {
            rows.push(cone_start + w * (p + 1));
            values.push(-1.0);
        }
        start.push(rows.len());
        for (i, (row, t)) in self.maps.chunks_exact(d).zip(self.targets).enumerate() {
            let fixed = |j: &usize| self.low[*j] == self.high[*j];
            let taken: f64 = (0..d).filter(fixed).map(|j| row[j] * self.low[j]).sum();
            right[cone_start + i / p * (p + 1) + 1 + i % p] = -(t - taken) / self.gain / self.unit;
        }
        let mut cones = try_room(WHAT, count + 1)?;
        cones.push(SupportedConeT::NonnegativeConeT(cone_start));
        cones.extend((0..count).map(|_| SupportedConeT::SecondOrderConeT(p + 1)));
        let linear = try_collect(WHAT, (0..=free).map(|j| f64::from(u8::from(j == free))))?;
        let none = CscMatrix::new(free + 1, free + 1, try_zeros(WHAT, free + 2)?, Vec::new(), Vec::new());
        let constraints = CscMatrix::new(height, free + 1, start, rows, values);
        let (x, z) = clarabel(&none, &linear, &constraints, &right, &cones, count, time)?;
        let mut control = try_copy(WHAT, self.low)?;
        for (&j, v) in self.free.iter().zip(&x) {
            control[j] = (v * self.unit).clamp(self.low[j], self.high[j]);
        }
        let mut vectors = try_room(WHAT, count * p)?;
        for block in z[cone_start..].chunks_exact(p + 1) {
            vectors.extend(block[1..].iter().map(|v| -v));
        }
        Ok(Proposal { control, vectors })
    }
}

fn clarabel(
    none: &CscMatrix<f64>,
    linear: &[f64],
    constraints: &CscMatrix<f64>,
    right: &[f64],
    cones: &[SupportedConeT<f64>],
    count: usize,
    time: Option<Duration>,
) -> Result<(Vec<f64>, Vec<f64>)> {
    let refused = |e: &dyn std::fmt::Display| Error::Numerical(format!("Clarabel refused the problem: {e}"));
    let settings: DefaultSettings<f64> = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-10)
        .tol_gap_rel(1e-10)
        .tol_feas(1e-10)
        .max_iter(100)
        .time_limit(time.map_or(f64::INFINITY, |time| time.as_secs_f64()))
        .presolve_enable(false)
        .build()
        .map_err(|e| refused(&e))?;
    // copies of the constraints, cones of more than four rows with two columns more, and a factor that is full
    let (height, width) = (constraints.m as u128, constraints.n as u128);
    let side = width + 2 * count as u128 + 8;
    let bytes = 16 * (8 * constraints.nzval.len() as u128 + 4 * side * side + 120 * (height + width)) + (1 << 18);
    let solved = covered("Clarabel", bytes, || {
        let mut solver = DefaultSolver::new(none, linear, constraints, right, cones, settings)?;
        solver.solve();
        Ok((solver.solution.x, solver.solution.z))
    })?;
    solved.map_err(|e: SolverError| refused(&e))
}
