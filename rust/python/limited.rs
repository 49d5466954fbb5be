//! Controls within limits, as Python sees them.

use numpy::PyArray1;
use pyo3::prelude::*;

use super::convert::array1;
use crate::limits::Solution;
use crate::memory::try_copy;

/// A control within limits, and how far from the best one it can be.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct BoxControl(pub(super) Solution);

#[pymethods]
impl BoxControl {
    #[getter]
    fn control<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        array1(py, try_copy("a control", &self.0.control)?)
    }

    #[getter]
    fn active<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i8>>> {
        array1(py, try_copy("the limits of a control", &self.0.active)?)
    }

    #[getter]
    fn multipliers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        array1(py, try_copy("the multipliers of a control", &self.0.multipliers)?)
    }

    #[getter]
    fn status(&self) -> &'static str {
        self.0.status.as_str()
    }

    #[getter]
    fn gap(&self) -> f64 {
        self.0.gap
    }

    #[getter]
    fn distance(&self) -> f64 {
        self.0.distance
    }

    #[getter]
    fn objective(&self) -> f64 {
        self.0.objective
    }

    #[getter]
    fn at_zero(&self) -> f64 {
        self.0.at_zero
    }

    #[getter]
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    #[getter]
    fn method(&self) -> &'static str {
        self.0.method.as_str()
    }
}
