//! Windows of readings and inputs.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, slice, view};
use super::error::ShapeError;
use super::pieces::PyPieces;
use super::run::run;
use crate::memory::{try_collect, try_copy};
use crate::window::{Kind, Window};

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
        count: usize = |own| own.0.count();
        pole: Option<f64> = |own| own.0.pole();
        delay: usize = |own| own.0.delay();
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

    /// The rows (z, y one step later) of `pairs`: of the `first` ones, and of those behind them.
    fn rows<'py>(
        &self,
        py: Python<'py>,
        pairs: Matrix<'py>,
        runs: &PyPieces,
        first: usize,
    ) -> PyResult<(Made<'py>, Made<'py>)> {
        let (values, places) = (slice("pairs", &pairs)?, runs.0.places()?);
        let begins = try_collect(WHAT, places.iter().map(|&place| place == 0))?;
        let width = self.0.length() + self.0.outputs();
        let cost = (places.len() * (width + self.0.states())) as f64;
        let (mut before, at) = run(py, cost, |_| self.0.rows(values, &begins))?;
        let count = at.partition_point(|&t| t < first);
        if count == at.len() {
            return Err(self.0.too_long(&places, first).into());
        }
        let after = try_copy(WHAT, &before[count * width..])?;
        before.truncate(count * width);
        Ok((array2(py, before, count, width)?, array2(py, after, at.len() - count, width)?))
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
        let found = self.0.rest(view("theta", &theta)?, y, u)?;
        Ok((array1(py, found.x)?, array1(py, found.z)?, found.off, found.rounding))
    }

    /// J, `[A B c]` and G for these coefficients.
    fn linear<'py>(&self, py: Python<'py>, theta: Matrix<'py>) -> PyResult<(Made<'py>, Made<'py>, Made<'py>)> {
        let (n, d, y) = (self.0.states(), self.0.length(), self.0.outputs());
        let k = n + self.0.inputs() + usize::from(self.0.intercept());
        let found = self.0.linear(view("theta", &theta)?)?;
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
