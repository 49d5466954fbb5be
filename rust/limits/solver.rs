//! One `M` for many states.

use super::bounds::Bounds;
use super::dense::Dense;
use super::orthogonal::reduce;
use super::quadratic::{Quadratic, Until};
use super::search::{FACTORIZATIONS, Search};
use super::solve::{Most, Penalty, Solution, Warm, find, measured, stacked, tell};
use crate::error::{Error, Result, require_finite, sized};
use crate::memory::{checked_len, try_copy, try_zeros};
use crate::parallel::Stop;

const WHAT: &str = "a control within limits";

/// Gradients for each factorization, at most.
const GRADIENTS: usize = 6;

/// One `M`, `R` and limits for many `x` with `y = target - state x`.
#[derive(Debug)]
pub struct Solver {
    dense: Dense,
    search: Search,
    low: Vec<f64>,
    high: Vec<f64>,
    shift: usize,
    /// `[state target]` after reduction: the rows of `T` first, then those that no input changes.
    map: Vec<f64>,
    n: usize,
    /// `(x, 1)`, and the lines of its entries, where these are few.
    z: Vec<f64>,
    lines: [Vec<f64>; 2],
    warm: Warm,
    /// `y` and result of a call.
    y: Vec<f64>,
    found: Solution,
}

impl Solver {
    /// Everything that does not depend on `x` is computed here. `shift`: each call begins at the limits that the call
    /// before has reached, this many inputs later.
    /// `state` is (rows, n).
    ///
    /// # Errors
    /// As [`super::box_control`], and [`Error::Interrupted`].
    pub fn new(
        m: &[f64],
        r: Penalty<'_>,
        bounds: Bounds<'_>,
        shift: usize,
        (state, target): (&[f64], &[f64]),
        stop: &Stop,
    ) -> Result<Self> {
        let d = bounds.low.len();
        let (dense, rows) = stacked(m, d, r)?;
        let n = state.len().checked_div(rows).unwrap_or(0);
        if target.len() != rows || state.len() != n * rows || n == 0 {
            let found = format!("{} and {}", state.len(), target.len());
            let expected = format!("{rows} rows, as many as `target`");
            return Err(Error::Shape { name: "state", expected, found });
        }
        let (mut dense, map) = reduced(&dense, rows, state, target, n, stop)?;
        dense.prepare(Until::new(stop, None))?;
        let (low, high) = (try_copy(WHAT, bounds.low)?, try_copy(WHAT, bounds.high)?);
        dense.reserve()?;
        let (warm, y, found, mut search) = (Warm::new(d)?, try_zeros(WHAT, d)?, Solution::sized(d)?, Search::new(d)?);
        search.reserve()?;
        let (mut z, mut lines) = (try_zeros(WHAT, n + 1)?, <[Vec<f64>; 2]>::default());
        z[n] = 1.0;
        if 2 * n < d {
            let of_inputs = map[..d * (n + 1)].chunks_exact(n + 1);
            let entry = |row: &[f64], j: usize| if j < n { -row[j] } else { row[n] };
            let column = |j, y: &mut [f64]| y.iter_mut().zip(of_inputs.clone()).for_each(|(y, row)| *y = entry(row, j));
            lines = dense.lines(n + 1, column, Until::new(stop, None))?;
        }
        Ok(Self { search, dense, low, high, shift, map, n, z, lines, warm, y, found })
    }

    /// The best control for `x`. After an error, all is as before. Without allocations, unless rounding hides the best.
    ///
    /// # Errors
    /// As [`super::box_control`].
    pub fn solve(&mut self, x: &[f64], until: Until<'_>) -> Result<&Solution> {
        let (d, n) = (self.low.len(), self.n);
        sized("x", x.len(), n)?;
        require_finite("x", x)?;
        let (of_inputs, others) = self.map.split_at(d * (n + 1));
        let at = |row: &[f64]| row[n] - x.iter().zip(row).map(|(x, v)| x * v).sum::<f64>();
        self.y.iter_mut().zip(of_inputs.chunks_exact(n + 1)).for_each(|(y, row)| *y = at(row));
        self.dense.rest = others.chunks_exact(n + 1).map(|row| at(row).powi(2)).sum();
        if self.lines[0].is_empty() {
            self.dense.aim(&self.y)?;
        } else {
            self.z[..n].copy_from_slice(x);
            self.dense.combine(&self.lines, &self.y, &self.z)?;
        }
        let bounds = Bounds { low: &self.low, high: &self.high };
        let first = self.warm.later(self.shift);
        let ended = find(&mut self.dense, &mut self.search, bounds, first, until)?;
        tell(&self.search, bounds, ended, (self.dense.scale(), self.dense.scale()), &mut self.found);
        self.warm.reached(&self.found.active);
        Ok(&self.found)
    }

    /// Other limits, as many.
    pub(super) fn limit(&mut self, low: &[f64], high: &[f64]) {
        let fixed = |low: &[f64], high: &[f64], i: usize| low[i] == high[i];
        if (0..low.len()).any(|i| fixed(low, high, i) != fixed(&self.low, &self.high, i)) {
            self.dense.whole = false; // a factor of all inputs but those that were fixed
        }
        self.low.copy_from_slice(low);
        self.high.copy_from_slice(high);
    }

    /// The work of a call at most, by the time that a factorization and a gradient take now.
    ///
    /// # Errors
    /// As [`super::box_control`].
    pub fn most(&mut self) -> Result<Most> {
        let (d, stop) = (self.low.len() as f64, Stop::new());
        self.search.fixed.fill(0);
        self.search.u.fill(0.0);
        let seconds = measured(|| {
            self.dense.barrier(&self.search.fixed, &self.y, Until::new(&stop, None))?;
            for _ in 0..GRADIENTS {
                self.dense.slope(&self.search.u, &mut self.search.g);
            }
            Ok(())
        })?;
        let each = d * d * (d / 3.0 + 4.0 * GRADIENTS as f64);
        // those by orthogonal factors take four times the work
        let (factorizations, count) = (2 * FACTORIZATIONS, 5.0 * FACTORIZATIONS as f64);
        Ok(Most { factorizations, operations: count * each, seconds: count * seconds })
    }

    /// The limits at which the next call begins.
    pub fn warm(&self) -> Option<&[i8]> {
        self.warm.last()
    }

    /// Sets them.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn resume(&mut self, warm: Option<Vec<i8>>) -> Result<()> {
        self.warm.resume(warm.as_deref())
    }
}

/// `[M state target; R^(1/2) 0 0] = Q [T S t; 0 S2 t2]`:
/// `||M u - y||^2 + u'R u = ||T u - (t - S x)||^2 + ||t2 - S2 x||^2`.
fn reduced(
    dense: &Dense,
    rows: usize,
    state: &[f64],
    target: &[f64],
    n: usize,
    stop: &Stop,
) -> Result<(Dense, Vec<f64>)> {
    let (d, ld) = (dense.d, dense.ld);
    let mut columns = try_zeros(WHAT, checked_len(WHAT, n + 1, dense.y.len())?)?;
    let height = dense.y.len().max(1);
    for (j, column) in columns.chunks_exact_mut(height).enumerate() {
        let value = |i: usize| if j < n { state[i * n + j] } else { target[i] };
        column.iter_mut().take(rows).enumerate().for_each(|(i, to)| *to = value(i));
    }
    let right = crate::memory::try_collect(WHAT, columns.chunks_exact(height))?;
    let (all, width) = reduce((&dense.m, d, ld), &dense.r, &right, stop)?;
    let (mut t, mut map) =
        (try_zeros(WHAT, checked_len(WHAT, d, d)?)?, try_zeros(WHAT, checked_len(WHAT, width, n + 1)?)?);
    for (i, row) in all.chunks_exact(width).enumerate() {
        if i < d {
            t[i * d..(i + 1) * d].copy_from_slice(&row[..d]);
        }
        map[i * (n + 1)..(i + 1) * (n + 1)].copy_from_slice(&row[d..]);
    }
    let mut small = Dense::new(d, d)?;
    small.set(&t, &try_zeros(WHAT, d)?)?;
    (small.triangular, small.least) = (true, dense.least);
    Ok((small, map))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// It costs three times the factor that is enough there.
    #[test]
    fn an_inverse_is_formed_for_limits_only() {
        let (d, stop) = (40, Stop::new());
        let m: Vec<f64> =
            (0..d * d).map(|i| if i % (d + 1) == 0 { 2.0 } else { (i as f64).sin() / d as f64 }).collect();
        let (low, high, r) = (vec![-1.0; d], vec![1.0; d], vec![0.1; d]);
        let bounds = Bounds { low: &low, high: &high };
        // y = x: state = -I, target = 0
        let state: Vec<f64> = (0..d * d).map(|i| if i % (d + 1) == 0 { -1.0 } else { 0.0 }).collect();
        let goal = (&state[..], &vec![0.0; d][..]);
        let mut solver = Solver::new(&m, Penalty::Diagonal(&r), bounds, 0, goal, &stop).unwrap();
        for size in [0.1, 0.2, 0.3] {
            let y: Vec<f64> = (0..d).map(|i| size * (i as f64).cos()).collect();
            let found = solver.solve(&y, Until::new(&stop, None)).unwrap();
            assert!(found.gap <= 1e-12 && found.active.iter().all(|side| *side == 0), "{found:?}");
            assert!(solver.dense.inverse().is_none());
        }
        let y: Vec<f64> = (0..d).map(|i| if i < 5 { 9.0 } else { 0.1 }).collect();
        for _ in 0..3 {
            let found = solver.solve(&y, Until::new(&stop, None)).unwrap();
            assert!(found.gap <= 1e-11 && found.active[..5] == [1; 5], "{found:?}");
        }
        assert!(solver.dense.inverse().is_some());
    }
}
