//! Windows of readings and inputs.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, slice};
use super::error::{InputError, ShapeError};
use super::fitted::places;
use super::run::{UNTIL_STOPPED, run};
use crate::memory::{try_collect, try_copy};
use crate::window::{self, Kind, Search, Window};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Made<'py> = Bound<'py, PyArray2<f64>>;
type Row<'py> = Bound<'py, PyArray1<f64>>;

const WHAT: &str = "a window";

/// A window: so many lags, or filters of one pole.
#[pyclass(frozen, module = "stochens_rs._core", name = "Window")]
pub(super) struct PyWindow(pub(super) Window);

getters! {
    PyWindow {
        length: usize = |own| own.0.length();
        states: usize = |own| own.0.states();
        fill: usize = |own| own.0.fill();
    }

    #[new]
    #[pyo3(signature = (outputs, inputs, count, pole=None, delay=0, intercept=false, burn=0))]
    fn new(
        outputs: usize,
        inputs: usize,
        count: usize,
        pole: Option<f64>,
        delay: usize,
        intercept: bool,
        burn: usize,
    ) -> PyResult<Self> {
        let kind = pole.map_or(Kind::Lags(count), |pole| Kind::Filters { pole, count });
        Ok(Self(Window::new(outputs, inputs, kind, delay, intercept, burn)?))
    }

    /// The rows (z, y one step later) of `pairs`, and the places of their pairs.
    fn rows<'py>(
        &self,
        py: Python<'py>,
        pairs: Matrix<'py>,
        first: Vec<bool>,
    ) -> PyResult<(Made<'py>, Bound<'py, PyArray1<i64>>)> {
        let values = slice("pairs", &pairs)?;
        let width = self.0.length() + self.0.outputs();
        let cost = (first.len() * (width + self.0.states())) as f64;
        let (rows, at) = run(py, cost, |_| self.0.rows(values, &first))?;
        Ok((array2(py, rows, at.len(), width)?, places(py, &at)?))
    }

    /// x at the last of the readings.
    fn state_of<'py>(&self, py: Python<'py>, y: Matrix<'py>, u: Matrix<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.fits("y", y.shape()[1], self.0.outputs())?;
        self.fits("u", u.shape()[1], self.0.inputs())?;
        array1(py, self.0.state_of(slice("y", &y)?, slice("u", &u)?)?)
    }

    /// x one step later.
    fn advance<'py>(
        &self,
        py: Python<'py>,
        x: Vector<'py>,
        y: Vector<'py>,
        u: Vector<'py>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        self.fits("x", x.len(), self.0.states())?;
        self.fits("y", y.len(), self.0.outputs())?;
        self.fits("u", u.len(), self.0.inputs())?;
        let mut next = try_copy(WHAT, slice("x", &x)?)?;
        self.0.advance(&mut next, slice("y", &y)?, slice("u", &u)?);
        array1(py, next)
    }

    /// `(x, z, off, rounding)` where outputs and inputs were always these.
    fn rest<'py>(
        &self,
        py: Python<'py>,
        theta: Matrix<'py>,
        outputs: Vector<'py>,
        inputs: Vector<'py>,
    ) -> PyResult<(Row<'py>, Row<'py>, f64, f64)> {
        let (y, u) = (slice("outputs", &outputs)?, slice("inputs", &inputs)?);
        let found = self.0.rest(slice("theta", &theta)?, y, u)?;
        Ok((array1(py, found.x)?, array1(py, found.z)?, found.off, found.rounding))
    }

    /// J, `[A B c]` and G for these coefficients.
    fn linear<'py>(&self, py: Python<'py>, theta: Matrix<'py>) -> PyResult<(Made<'py>, Made<'py>, Made<'py>)> {
        let (n, d, y) = (self.0.states(), self.0.length(), self.0.outputs());
        let k = n + self.0.inputs() + usize::from(self.0.intercept());
        let found = self.0.linear(slice("theta", &theta)?)?;
        Ok((array2(py, found.entering, d, k)?, array2(py, found.matrix, n, k)?, array2(py, found.noise, n, y)?))
    }
}

impl PyWindow {
    fn fits(&self, name: &str, found: usize, expected: usize) -> PyResult<()> {
        if found == expected {
            return Ok(());
        }
        Err(ShapeError::new_err(format!("`{name}` must have {expected} columns or entries, got {found}")))
    }
}

/// The rows that fill `count` filters of this pole.
#[pyfunction]
pub(super) fn window_burn(py: Python<'_>, pole: f64, count: usize, ratio: f64, pieces: usize) -> PyResult<usize> {
    run(py, UNTIL_STOPPED, |stop| window::burn(pole, count, ratio, pieces, stop))
}

/// The largest range of a reading over the deviation of its noise.
#[pyfunction]
pub(super) fn readings_over_noise(
    py: Python<'_>,
    pairs: Matrix<'_>,
    first: Vec<bool>,
    outputs: usize,
    inputs: usize,
    intercept: bool,
) -> PyResult<f64> {
    let values = slice("pairs", &pairs)?;
    let cost = 400.0 * values.len() as f64;
    run(py, cost, |stop| window::readings_over_noise(values, &first, outputs, inputs, intercept, stop))
}

/// `(pole or None, count, delay, burn, count by the criterion, rows compared)` of the window that the first part asks for.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the windows to choose from")]
pub(super) fn choose_window(
    py: Python<'_>,
    pairs: Matrix<'_>,
    first: Vec<bool>,
    outputs: usize,
    inputs: usize,
    intercept: bool,
    poles: Vec<f64>,
    most: (usize, usize),
    delays: (usize, usize),
    pieces: (usize, usize),
) -> PyResult<(Option<f64>, usize, usize, usize, usize, usize)> {
    let values = slice("pairs", &pairs)?;
    if poles.len() > 1000 {
        return Err(InputError::new_err("`poles` must be at most 1000"));
    }
    let (filters, lags) = most;
    let poles = try_collect(WHAT, poles)?;
    let of = Search {
        outputs,
        inputs,
        intercept,
        poles: &poles,
        filters,
        lags,
        delays: delays.into(),
        pieces: pieces.into(),
    };
    let found = run(py, 1e9, |stop| window::choose(values, &first, of, stop))?;
    let (pole, count) = match found.kind {
        Kind::Lags(count) => (None, count),
        Kind::Filters { pole, count } => (Some(pole), count),
    };
    let burn = if pole.is_some() { found.window.fill() - found.delay } else { 0 };
    Ok((pole, count, found.delay, burn, found.found, found.rows))
}
