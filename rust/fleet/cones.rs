//! `min z^2 + ||u||_R^2` (without R: `min z`) subject to `||M_w u - t_w|| <= z` for some units and to limits of u, by
//! Clarabel.

use std::time::Duration;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverError, SupportedConeT};

use super::units::WHAT;
use crate::error::{Error, Result};
use crate::memory::{checked_len, covered, try_collect, try_copy, try_room, try_zeros};
use crate::vector::{axpy, dot};

/// What a command may be, and what else it costs.
#[derive(Clone, Copy)]
pub struct Limits<'a> {
    /// Lower limits, `d`.
    pub low: &'a [f64],
    /// Upper limits, `d`.
    pub high: &'a [f64],
    /// `R = diag(diagonal) + cost'cost`: `d` entries.
    pub diagonal: &'a [f64],
    /// `(rows, d)`, or empty.
    pub cost: &'a [f64],
}

/// Units that are solved for together, scaled: `u = unit v`, `M = gain M'`, `t = unit gain t'`, powers of two.
pub(super) struct Problem<'a> {
    /// `(count * rows, d)`
    pub(super) maps: &'a [f64],
    /// `count * rows`
    pub(super) targets: &'a [f64],
    pub(super) rows: usize,
    pub(super) limits: Limits<'a>,
    /// Inputs that are not fixed; the others are at `low`.
    pub(super) free: &'a [usize],
    pub(super) gain: f64,
    pub(super) unit: f64,
}

/// A proposal: the inputs, inside their limits, and the vectors of the dual: `v_w`, and `cost u` behind them.
pub(super) struct Proposal {
    pub(super) control: Vec<f64>,
    pub(super) vectors: Vec<f64>,
}

impl Problem<'_> {
    pub(super) fn solve(&self, time: Option<Duration>) -> Result<Proposal> {
        let (d, free, p) = (self.limits.low.len(), self.free.len(), self.rows);
        let count = self.targets.len() / p;
        let finite = |ends: &[f64]| self.free.iter().filter(|&&j| ends[j].is_finite()).count();
        let (up, down) = (finite(self.limits.high), finite(self.limits.low));
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
            if self.limits.high[j].is_finite() {
                rows.push(above);
                values.push(1.0);
                right[above] = self.limits.high[j] / self.unit;
                above += 1;
            }
            if self.limits.low[j].is_finite() {
                rows.push(below);
                values.push(-1.0);
                right[below] = -self.limits.low[j] / self.unit;
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
            let fixed = |j: &usize| self.limits.low[*j] == self.limits.high[*j];
            let taken: f64 = (0..d).filter(fixed).map(|j| row[j] * self.limits.low[j]).sum();
            right[cone_start + i / p * (p + 1) + 1 + i % p] = -(t - taken) / self.gain / self.unit;
        }
        let mut cones = try_room(WHAT, count + 1)?;
        cones.push(SupportedConeT::NonnegativeConeT(cone_start));
        cones.extend((0..count).map(|_| SupportedConeT::SecondOrderConeT(p + 1)));
        let (squares, linear) = self.objective()?;
        let constraints = CscMatrix::new(height, free + 1, start, rows, values);
        let (x, z) = clarabel(&squares, &linear, &constraints, &right, &cones, count, time)?;
        let mut control = try_copy(WHAT, self.limits.low)?;
        for (&j, v) in self.free.iter().zip(&x) {
            control[j] = (v * self.unit).clamp(self.limits.low[j], self.limits.high[j]);
        }
        let mut vectors = try_room(WHAT, count * p + self.limits.cost.len() / d)?;
        for block in z[cone_start..].chunks_exact(p + 1) {
            vectors.extend(block[1..].iter().map(|v| -v * self.gain * self.unit));
        }
        vectors.extend(self.limits.cost.chunks_exact(d).map(|row| dot(row, &control)));
        Ok(Proposal { control, vectors })
    }

    /// `(z^2 + ||u||_R^2) / 2` of the free inputs, scaled, or `z` where R is 0: the upper triangle of its second
    /// derivative, and its slope.
    fn objective(&self) -> Result<(CscMatrix<f64>, Vec<f64>)> {
        let (d, free) = (self.limits.low.len(), self.free.len());
        let fixed = try_collect(
            WHAT,
            (0..d).map(|j| if self.limits.low[j] == self.limits.high[j] { self.limits.low[j] } else { 0.0 }),
        )?;
        let weighed = self.weighed();
        let (mut rows, mut values) = (Vec::new(), Vec::new());
        let mut start = try_room(WHAT, free + 2)?;
        let (mut linear, mut column) = (try_zeros(WHAT, free + 1)?, try_zeros(WHAT, d)?);
        let most = if self.limits.cost.is_empty() { free } else { checked_len(WHAT, free, free)? };
        if weighed {
            (rows, values) = (try_room(WHAT, most + 1)?, try_room(WHAT, most + 1)?);
        }
        start.push(0);
        for (k, &j) in self.free.iter().enumerate() {
            if weighed {
                column.fill(0.0);
                column[j] = self.limits.diagonal[j];
                for row in self.limits.cost.chunks_exact(d).filter(|row| row[j] != 0.0) {
                    axpy(row[j], row, &mut column);
                }
                linear[k] = dot(&column, &fixed) / self.gain / self.gain / self.unit;
                for (i, &to) in self.free[..=k].iter().enumerate().filter(|(_, to)| column[**to] != 0.0) {
                    rows.push(i);
                    values.push(column[to] / self.gain / self.gain);
                }
            }
            start.push(rows.len());
        }
        if weighed {
            rows.push(free);
            values.push(1.0);
        } else {
            linear[free] = 1.0;
        }
        start.push(rows.len());
        Ok((CscMatrix::new(free + 1, free + 1, start, rows, values), linear))
    }

    fn weighed(&self) -> bool {
        !self.limits.cost.is_empty() || self.limits.diagonal.iter().any(|weight| *weight > 0.0)
    }
}

fn clarabel(
    squares: &CscMatrix<f64>,
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
    let entries = (constraints.nzval.len() + squares.nzval.len()) as u128;
    let bytes = 16 * (8 * entries + 4 * side * side + 120 * (height + width)) + (1 << 18);
    let solved = covered("Clarabel", bytes, || {
        let mut solver = DefaultSolver::new(squares, linear, constraints, right, cones, settings)?;
        solver.solve();
        Ok((solver.solution.x, solver.solution.z))
    })?;
    solved.map_err(|e: SolverError| refused(&e))
}
