//! Controls within limits, as Python sees them.

use numpy::PyArray1;
use pyo3::prelude::*;

use super::convert::{array1, getters};
use crate::limits::Solution;
use crate::memory::try_copy;

/// A control within limits, and how far from the best one it can be.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct BoxControl(pub(super) Solution);

getters! {
    BoxControl {
        status: &'static str = |own| own.0.status.as_str();
        gap: f64 = |own| own.0.gap;
        distance: f64 = |own| own.0.distance;
        objective: f64 = |own| own.0.objective;
        at_zero: f64 = |own| own.0.at_zero;
        iterations: usize = |own| own.0.iterations;
        method: &'static str = |own| own.0.method.as_str();
    }

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
}
