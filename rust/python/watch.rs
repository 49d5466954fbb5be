//! The alarm of a loop in use, what changed, and tests of new logs.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::error::InputError;
use super::fitted::PyFitted;
use super::region::PyRegion;
use super::run::{UNTIL_STOPPED, run};
use super::shared::Shared;
use super::window::PyWindow;
use crate::error::Result;
use crate::memory::{try_collect, try_copy};
use crate::watch::{Bank, Bet, Frame, Fresh, Laws, Look, Null, Promise, Rang, State, Watch, open_loop};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;
/// The rows that are watched; estimate, radius, and what the region adds; the largest violations of all, without each group of
/// columns, and without each row; gains with both radii; white, root and factor.
type Looked<'py> = (
    Vec<usize>,
    [Array2<'py>; 3],
    f64,
    (Array1<'py>, Array1<'py>),
    [Array1<'py>; 3],
    (Array2<'py>, Array2<'py>, f64),
);
/// Call, onset, kind, row or column, column, whether it fell, steps.
type Alarmed = (u64, u64, &'static str, usize, usize, bool, usize);

const WHAT: &str = "a watch";

/// The evidence, and the pairs after an alarm.
struct Watched {
    watch: Watch,
    fresh: Fresh,
    collects: bool,
}

impl Watched {
    fn step(&mut self, y: &[f64], acted: &[f64]) -> Result<(State, f64, u64)> {
        let before = self.watch.counts().2;
        let looked = self.watch.step(y, acted)?;
        let (evidence, _, alarms) = self.watch.counts();
        if looked && self.collects {
            let (z, e) = self.watch.pair();
            self.fresh.add(self.watch.frame(), z, e);
        }
        self.collects |= alarms > before; // from the next pair on
        Ok((self.watch.state(), evidence, alarms))
    }
}

fn bet(of: Bet) -> (&'static str, usize, usize) {
    match of {
        Bet::Entry(i, j) => ("entry", i, j),
        Bet::Load(i) => ("load", i, 0),
        Bet::Gain(j) => ("gain", j, 0),
    }
}

fn looked<'py>(py: Python<'py>, frame: &Frame, look: Look) -> PyResult<Looked<'py>> {
    let (n, d) = (frame.n(), frame.width());
    let table = |values: Vec<f64>| array2(py, values, n, d);
    let [new, old] = look.radius;
    let [gain, radius, allowed] = look.gains;
    let rank = look.white.len() / d;
    Ok((
        try_copy(WHAT, &frame.rows)?,
        [table(look.estimate)?, table(new)?, table(old)?],
        look.outside,
        (array1(py, look.columns)?, array1(py, look.rows)?),
        [array1(py, gain)?, array1(py, radius)?, array1(py, allowed)?],
        (array2(py, look.white, rank, d)?, array2(py, look.root, rank, d)?, look.factor),
    ))
}

/// An alarm whose false alarms are bounded.
#[pyclass(frozen, module = "stochens_rs._core", name = "Watch")]
pub(super) struct PyWatch(Shared<Watched>);

#[pymethods]
impl PyWatch {
    /// `promise`: steps between false alarms if at least 1, else the probability of one; `gains`: columns of inputs.
    #[new]
    fn new(
        region: &Bound<'_, PyRegion>,
        noise: Matrix<'_>,
        window: &Bound<'_, PyWindow>,
        law: (&str, bool),
        promise: f64,
        pairs: usize,
        gains: Vec<usize>,
    ) -> PyResult<Self> {
        let frame = Frame::new(&region.get().0, slice("noise", &noise)?, pairs)?;
        let window = window.get().0;
        if gains.iter().any(|j| *j >= frame.width()) {
            return Err(InputError::new_err(format!("`gains` must be below {}", frame.width())));
        }
        let bank = Bank::new(&frame, &gains, window.intercept())?;
        let kind = match law.0 {
            "variance" => Laws::Variance,
            "gaussian" => Laws::Gaussian,
            "symmetric" => Laws::Symmetric,
            _ => Laws::Bounded,
        };
        let null = if law.1 { Null::Moving } else { Null::Constant };
        let promise = if promise >= 1.0 { Promise::Every(promise) } else { Promise::Ever(promise) };
        let fresh = Fresh::new(&frame, None)?;
        let watch = Watch::new(frame, bank, kind, null, promise, window)?;
        Ok(Self(Shared::new("watch", Watched { watch, fresh, collects: false })))
    }

    /// Status, evidence, and the number of alarms.
    fn step(&self, py: Python<'_>, y: Vector<'_>, acted: Vector<'_>) -> PyResult<(&'static str, f64, u64)> {
        let (y, acted) = (slice("y", &y)?, slice("u", &acted)?);
        let (state, evidence, alarms) = self.0.with(py, 0.0, |of, _| of.step(y, acted))?;
        let status = match state {
            State::Quiet => "quiet",
            State::Alarm => "alarm",
            State::Blind => "blind",
            State::Skipping => "skipping",
        };
        Ok((status, evidence, alarms))
    }

    #[getter]
    fn threshold(&self, py: Python<'_>) -> PyResult<f64> {
        self.0.with(py, 0.0, |of, _| Ok(of.watch.threshold()))
    }

    #[getter]
    fn last(&self, py: Python<'_>) -> PyResult<Option<Alarmed>> {
        let last = self.0.with(py, 0.0, |of, _| Ok(of.watch.last()))?;
        Ok(last.map(|last| {
            let ((kind, one, other), fell, steps) = match last.rang {
                Rang::Bet(of, fell, steps) => (bet(of), fell, steps),
                Rang::Noise => (("noise", 0, 0), false, 1),
                Rang::Mixed => (("mixed", 0, 0), false, 1),
            };
            (last.call, last.onset, kind, one, other, fell, steps)
        }))
    }

    /// Kind, row or column, and the least change that would be seen within so many steps.
    fn sights(&self, py: Python<'_>, steps: f64) -> PyResult<Vec<(&'static str, usize, f64)>> {
        let sights = self.0.with(py, 0.0, |of, _| of.watch.sights(steps))?;
        Ok(try_collect(WHAT, sights.iter().map(|one| (bet(one.bet).0, bet(one.bet).1, one.least)))?)
    }

    /// Takes the alarm as seen: the pairs after it are forgotten.
    fn clear(&self, py: Python<'_>) -> PyResult<()> {
        self.0.with(py, 0.0, |of, _| {
            of.watch.clear();
            of.collects = false;
            of.fresh = Fresh::new(of.watch.frame(), None)?;
            Ok(())
        })
    }

    #[getter]
    fn collected(&self, py: Python<'_>) -> PyResult<u64> {
        self.0.with(py, 0.0, |of, _| Ok(of.fresh.size()))
    }

    fn look<'py>(&self, py: Python<'py>, alpha: f64, groups: Vec<Vec<usize>>) -> PyResult<Looked<'py>> {
        let (frame, look) = self.0.with(py, UNTIL_STOPPED, |of, _| {
            let frame = of.watch.frame().clone();
            let look = of.fresh.look(&frame, alpha, &groups)?;
            Ok((frame, look))
        })?;
        looked(py, &frame, look)
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<(Array1<'py>, Array1<'py>, u64, bool)> {
        let (numbers, triangle, size, collects) = self.0.with(py, 0.0, |of, _| {
            let triangle = try_copy(WHAT, of.fresh.triangle())?;
            Ok((of.watch.numbers()?, triangle, of.fresh.size(), of.collects))
        })?;
        Ok((array1(py, numbers)?, array1(py, triangle)?, size, collects))
    }

    fn resume(&self, py: Python<'_>, numbers: Vector<'_>, triangle: Vector<'_>, size: u64, on: bool) -> PyResult<()> {
        let (numbers, triangle) = (slice("numbers", &numbers)?, slice("triangle", &triangle)?);
        self.0.with(py, 0.0, |of, _| {
            of.fresh.resume(triangle, size)?;
            of.collects = on;
            of.watch.resume(numbers)
        })
    }
}

/// What rows (z, y) say against a region, and how many of them could be used.
#[pyfunction]
pub(super) fn look_of_rows<'py>(
    py: Python<'py>,
    region: &Bound<'_, PyRegion>,
    noise: Matrix<'_>,
    pairs: usize,
    rows: Matrix<'_>,
    alpha: f64,
    groups: Vec<Vec<usize>>,
) -> PyResult<(Looked<'py>, u64)> {
    let frame = Frame::new(&region.get().0, slice("noise", &noise)?, pairs)?;
    let (d, width, values) = (frame.width(), rows.as_array().dim().1, slice("rows", &rows)?);
    if width < d + 1 + frame.rows.last().copied().unwrap_or(0) {
        return Err(InputError::new_err(format!("`rows` must have {d} regressors and the readings, got {width}")));
    }
    let (look, size) = run(py, UNTIL_STOPPED, |_| {
        let mut fresh = Fresh::new(&frame, None)?;
        let zeros = |count: usize| crate::memory::try_zeros::<f64>(WHAT, count);
        let (mut e, mut wz, mut h) = (zeros(frame.n())?, zeros(frame.white.len() / d)?, zeros(frame.count())?);
        for row in values.chunks_exact(width) {
            if frame.residual(&row[..d], &row[d..], &mut e, &mut wz, &mut h) {
                fresh.add(&frame, &row[..d], &e);
            }
        }
        Ok((fresh.look(&frame, alpha, &groups)?, fresh.size()))
    })?;
    Ok((looked(py, &frame, look)?, size))
}

/// The exact test of two logs in open loop: statistic and its limit.
#[pyfunction]
pub(super) fn test_of_two_logs(
    py: Python<'_>,
    one: &Bound<'_, PyFitted>,
    other: &Bound<'_, PyFitted>,
    level: f64,
    threads: usize,
) -> PyResult<(f64, f64)> {
    let (one, other) = (&one.get().0, &other.get().0);
    let found = run(py, UNTIL_STOPPED, |stop| open_loop(one, other, level, threads, stop))?;
    Ok((found.statistic, found.limit))
}
