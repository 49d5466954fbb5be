//! Least squares of some rows of a model.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, slice};
use super::run::run;
use crate::identify::{self, Fitted};
use crate::memory::{try_collect, try_copy};

const WHAT: &str = "least squares";

/// Least squares for some rows and columns of Theta.
#[pyclass(frozen, module = "stochens_rs._core", name = "Fitted")]
pub(super) struct PyFitted(pub(super) Arc<Fitted>);

/// Places as an array.
pub(super) fn places<'py>(py: Python<'py>, values: &[usize]) -> PyResult<Bound<'py, PyArray1<i64>>> {
    array1(py, try_collect(WHAT, values.iter().map(|&v| v as i64))?)
}

/// A matrix with this many columns, copied.
pub(super) fn copied<'py>(
    py: Python<'py>,
    values: &[f64],
    rows: usize,
    columns: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    array2(py, try_copy(WHAT, values)?, rows, columns)
}

getters! {
    PyFitted {
        rows<'py>: PyResult<Bound<'py, PyArray1<i64>>> = |own, py| places(py, &own.0.rows);
        columns<'py>: PyResult<Bound<'py, PyArray1<i64>>> = |own, py| places(py, &own.0.columns);
        rounding<'py>: PyResult<Bound<'py, PyArray1<f64>>> = |own, py| array1(py, try_copy(WHAT, &own.0.rounding)?);
        rank: usize = |own| own.0.rank();
        nu: usize = |own| own.0.degrees();
        ratio: f64 = |own| own.0.ratio;
    }

    #[getter(H)]
    fn model<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        copied(py, &self.0.model, self.0.rows.len(), self.0.columns.len())
    }

    #[getter(S)]
    fn residual<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        copied(py, &self.0.residual, self.0.rows.len(), self.0.rows.len())
    }

    #[getter]
    fn white<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        copied(py, &self.0.white, self.0.rank(), self.0.columns.len())
    }

    #[getter]
    fn root<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        copied(py, &self.0.root, self.0.rank(), self.0.columns.len())
    }

    #[getter]
    fn missing<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let d = self.0.columns.len();
        copied(py, &self.0.missing, d, d - self.0.rank())
    }

    fn combinations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let d = self.0.columns.len();
        array2(py, self.0.combinations()?, d - self.0.rank(), d)
    }

    /// Rows without a residual, those that are tied to each other, and those of them without which the others are
    /// independent.
    fn span(&self, tested: Vec<usize>) -> PyResult<(Vec<usize>, Vec<usize>, Vec<usize>)> {
        let found = self.0.span(&tested)?;
        Ok((found.zero, found.tied, found.last))
    }

    #[getter(N)]
    fn size(&self) -> usize {
        self.0.size
    }
}

/// Least squares of `size` pairs from `rows` (any, d + n) `= [Z Y]`, or their triangle.
#[pyfunction]
pub(super) fn fit(
    py: Python<'_>,
    rows: PyReadonlyArray2<'_, f64>,
    d: usize,
    size: usize,
    threads: usize,
) -> PyResult<PyFitted> {
    let (count, width) = rows.as_array().dim();
    let values = slice("rows", &rows)?;
    let cost = 0.3 * (count * width * width) as f64 + 30.0 * d.pow(3) as f64;
    let found = run(py, cost, |stop| identify::fit(values, width, d, size, threads, stop))?;
    Ok(PyFitted(Arc::new(found)))
}
