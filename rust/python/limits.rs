//! Controls within limits.

use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::error::ShapeError;
use super::limited::{BoxControl, RowsControl};
use super::run::{run, run_to_best};
use super::shared::Shared;
use crate::limits::{self, Batch, Bounds, Penalty, Rows, RowsSolution, Solution, Solver, Status, Steps, Until};
use crate::memory::try_copy;
use crate::{Result, Stop};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Signs<'py> = PyReadonlyArray1<'py, i8>;
type Given<'py> = (Bound<'py, PyArray2<f64>>, Option<Bound<'py, PyArray1<f64>>>);

/// Elementary operations up to which a call does not look for signals.
const SHORT: f64 = 1e7;

/// `R`: its diagonal, or all of it.
#[derive(FromPyObject)]
pub(super) enum PenaltyArgument<'py> {
    Diagonal(Vector<'py>),
    Full(Matrix<'py>),
}

impl PenaltyArgument<'_> {
    fn get(&self) -> PyResult<Penalty<'_>> {
        Ok(match self {
            Self::Diagonal(values) => Penalty::Diagonal(slice("R", values)?),
            Self::Full(values) => Penalty::Full(slice("R", values)?),
        })
    }
}

pub(super) fn signs<'a>(values: &'a Option<Signs<'_>>) -> PyResult<Option<&'a [i8]>> {
    let contiguous = |_| ShapeError::new_err("`warm` must be C-contiguous");
    values.as_ref().map(|values| values.as_slice().map_err(contiguous)).transpose()
}

pub(super) fn seconds(limit: Option<f64>) -> Option<Duration> {
    limit.map(|limit| Duration::try_from_secs_f64(limit).unwrap_or(Duration::MAX))
}

/// After Ctrl-C the best control so far, if the result says that it was interrupted.
pub(super) fn to_best<T, F>(py: Python<'_>, cost: f64, status: fn(&T) -> Status, work: F) -> PyResult<T>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    if cost < SHORT {
        return run(py, cost, work);
    }
    match run_to_best(py, work)? {
        (found, Some(signal)) if status(&found) != Status::Interrupted => Err(signal),
        (found, _) => Ok(found),
    }
}

fn together<'a, A, B>(names: &str, first: &'a Option<A>, second: &'a Option<B>) -> PyResult<Option<(&'a A, &'a B)>> {
    match (first, second) {
        (Some(first), Some(second)) => Ok(Some((first, second))),
        (None, None) => Ok(None),
        _ => Err(ShapeError::new_err(format!("{names} go together: one of them is missing"))),
    }
}

fn status_of(found: &Solution) -> Status {
    found.status
}

/// The least `||M u - y||^2 + u' R u` within limits.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn box_control(
    py: Python<'_>,
    m: Matrix<'_>,
    y: Vector<'_>,
    r: PenaltyArgument<'_>,
    low: Vector<'_>,
    high: Vector<'_>,
    warm: Option<Signs<'_>>,
    time_limit: Option<f64>,
) -> PyResult<BoxControl> {
    let (rows, d) = m.as_array().dim();
    let (m, y, r) = (slice("M", &m)?, slice("y", &y)?, r.get()?);
    let (bounds, warm) = (Bounds::new(slice("low", &low)?, slice("high", &high)?, d)?, signs(&warm)?);
    let cost = (d * d) as f64 * (rows + 10 * d) as f64;
    let limit = seconds(time_limit);
    let found =
        to_best(py, cost, status_of, |stop| limits::box_control(m, y, r, bounds, warm, Until::new(stop, limit)))?;
    Ok(BoxControl(found))
}

/// One `M` for many `y`.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct BoxSolver {
    inner: Shared<Solver>,
    size: usize,
}

#[pymethods]
impl BoxSolver {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
    fn new(
        py: Python<'_>,
        m: Matrix<'_>,
        r: PenaltyArgument<'_>,
        low: Vector<'_>,
        high: Vector<'_>,
        shift: usize,
        state: Option<Matrix<'_>>,
        target: Option<Vector<'_>>,
    ) -> PyResult<Self> {
        let (rows, d) = m.as_array().dim();
        let (m, r) = (slice("M", &m)?, r.get()?);
        let bounds = Bounds::new(slice("low", &low)?, slice("high", &high)?, d)?;
        let goal = match together("`state` and `target`", &state, &target)? {
            Some((state, target)) => Some((slice("state", state)?, slice("target", target)?)),
            None => None,
        };
        let cost = (d * d) as f64 * (2 * rows + 2 * d) as f64;
        let solver = run(py, cost, |stop| Solver::new(m, r, bounds, shift, goal, stop))?;
        Ok(Self { inner: Shared::new("solver", solver), size: d })
    }

    fn solve(&self, py: Python<'_>, given: Vector<'_>, time_limit: Option<f64>) -> PyResult<BoxControl> {
        let (given, limit) = (slice("given", &given)?, seconds(time_limit));
        let cost = (self.size as f64).powi(3);
        Ok(BoxControl(self.inner.with(py, cost, |solver, stop| solver.solve(given, Until::new(stop, limit)))?))
    }

    fn warm<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray1<i8>>>> {
        let copy = |solver: &mut Solver, _: &Stop| solver.warm().map(|warm| try_copy("a start", warm)).transpose();
        self.inner.with(py, 0.0, copy)?.map(|warm| array1(py, warm)).transpose()
    }

    fn resume(&self, py: Python<'_>, warm: Option<Signs<'_>>) -> PyResult<()> {
        let copy = signs(&warm)?.map(|warm| try_copy("a start", warm)).transpose()?;
        self.inner.with(py, 0.0, |solver, _| solver.resume(copy))
    }
}

fn given(py: Python<'_>, (u, gaps): Batch, size: usize, d: usize) -> PyResult<Given<'_>> {
    Ok((array2(py, u, size, d)?, gaps.map(|gaps| array1(py, gaps)).transpose()?))
}

/// Controls (N, d) for the rows of `y` (N, rows), and their gaps.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn box_batch<'py>(
    py: Python<'py>,
    m: Matrix<'py>,
    y: Matrix<'py>,
    r: PenaltyArgument<'py>,
    low: Vector<'py>,
    high: Vector<'py>,
    gaps: bool,
    threads: usize,
) -> PyResult<Given<'py>> {
    let ((rows, d), size) = (m.as_array().dim(), y.as_array().dim().0);
    let bounds = Bounds::new(slice("low", &low)?, slice("high", &high)?, d)?;
    let (m, y, r) = (slice("M", &m)?, slice("y", &y)?, r.get()?);
    let cost = size as f64 * (d * (rows + d)) as f64;
    let found = run(py, cost, |stop| limits::box_batch(m, y, size, r, bounds, gaps, threads, stop))?;
    given(py, found, size, d)
}

/// The same for `M` of their own: `m` (N, rows d).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn box_batch_each<'py>(
    py: Python<'py>,
    m: Matrix<'py>,
    y: Matrix<'py>,
    r: PenaltyArgument<'py>,
    low: Vector<'py>,
    high: Vector<'py>,
    gaps: bool,
    threads: usize,
) -> PyResult<Given<'py>> {
    let (size, d) = (y.as_array().dim().0, low.len());
    let bounds = Bounds::new(slice("low", &low)?, slice("high", &high)?, d)?;
    let cost = m.len() as f64 * 10.0 * d as f64;
    let (m, y, r) = (slice("M", &m)?, slice("y", &y)?, r.get()?);
    let found = run(py, cost, |stop| limits::box_batch_each(m, y, size, r, bounds, gaps, threads, stop))?;
    given(py, found, size, d)
}

fn horizon<'a>(
    a: &'a Matrix<'_>,
    b: &'a Matrix<'_>,
    x0: &'a Vector<'_>,
    reference: &'a Matrix<'_>,
    stage: &'a Matrix<'_>,
    terminal: &'a Matrix<'_>,
    r: &'a Matrix<'_>,
) -> PyResult<Steps<'a>> {
    Ok(Steps {
        a: slice("A", a)?,
        b: slice("B", b)?,
        x0: slice("x0", x0)?,
        reference: slice("reference", reference)?,
        stage: slice("stage", stage)?,
        terminal: slice("terminal", terminal)?,
        r: slice("R", r)?,
    })
}

/// The best inputs of many steps within limits.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn horizon_control(
    py: Python<'_>,
    a: Matrix<'_>,
    b: Matrix<'_>,
    x0: Vector<'_>,
    reference: Matrix<'_>,
    stage: Matrix<'_>,
    terminal: Matrix<'_>,
    r: Matrix<'_>,
    low: Matrix<'_>,
    high: Matrix<'_>,
    warm: Option<Signs<'_>>,
    time_limit: Option<f64>,
) -> PyResult<BoxControl> {
    let ((n, m), steps) = (b.as_array().dim(), reference.as_array().dim().0);
    let horizon = horizon(&a, &b, &x0, &reference, &stage, &terminal, &r)?;
    let bounds = Bounds::new(slice("low", &low)?, slice("high", &high)?, steps.saturating_mul(m))?;
    let (warm, limit) = (signs(&warm)?, seconds(time_limit));
    let cost = 30.0 * steps as f64 * ((n + m) * (n + m) * n) as f64;
    let found =
        to_best(py, cost, status_of, |stop| limits::horizon_control(&horizon, bounds, warm, Until::new(stop, limit)))?;
    Ok(BoxControl(found))
}

/// The best inputs of many steps within limits on inputs, their changes and states.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn rows_control(
    py: Python<'_>,
    a: Matrix<'_>,
    b: Matrix<'_>,
    x0: Vector<'_>,
    reference: Matrix<'_>,
    stage: Matrix<'_>,
    terminal: Matrix<'_>,
    r: Matrix<'_>,
    low: Matrix<'_>,
    high: Matrix<'_>,
    rate: Option<Vector<'_>>,
    previous: Option<Vector<'_>>,
    state_low: Option<Matrix<'_>>,
    state_high: Option<Matrix<'_>>,
    soft: Option<f64>,
    warm: Option<Signs<'_>>,
    time_limit: Option<f64>,
) -> PyResult<Py<RowsControl>> {
    let ((n, m), steps) = (b.as_array().dim(), reference.as_array().dim().0);
    let horizon = horizon(&a, &b, &x0, &reference, &stage, &terminal, &r)?;
    let bounds = Bounds::new(slice("low", &low)?, slice("high", &high)?, steps.saturating_mul(m))?;
    let mut rows = Rows { soft, ..Rows::default() };
    if let Some((rate, previous)) = together("`rate` and `previous`", &rate, &previous)? {
        rows.rate = Some((slice("rate", rate)?, slice("previous", previous)?));
    }
    if let Some((low, high)) = together("`state_low` and `state_high`", &state_low, &state_high)? {
        rows.states = Some((slice("state_low", low)?, slice("state_high", high)?));
    }
    let (warm, limit) = (signs(&warm)?, seconds(time_limit));
    let cost = 300.0 * steps as f64 * ((2 * n + m) as f64).powi(3);
    let status = |found: &RowsSolution| found.found.status;
    let found =
        to_best(py, cost, status, |stop| limits::rows_control(&horizon, bounds, rows, warm, Until::new(stop, limit)))?;
    RowsControl::of(py, found)
}
