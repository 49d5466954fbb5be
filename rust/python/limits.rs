//! Controls within limits.

use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::error::ShapeError;
use super::limited::BoxControl;
use super::run::{run, run_to_best};
use crate::limits::{self, Bounds, Penalty, Solution, Status, Until};
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
    let status = |found: &Solution| found.status;
    let found = to_best(py, cost, status, |stop| limits::box_control(m, y, r, bounds, warm, Until::new(stop, limit)))?;
    Ok(BoxControl(found))
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
    let (u, gaps) = run(py, cost, |stop| limits::box_batch(m, y, size, r, bounds, gaps, threads, stop))?;
    Ok((array2(py, u, size, d)?, gaps.map(|gaps| array1(py, gaps)).transpose()?))
}
