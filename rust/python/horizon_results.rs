//! The results of the calls of a horizon.

use numpy::PyArray2;
use pyo3::prelude::*;

use super::arrays::array;
use super::convert::array2;
use crate::limits::horizon::Solved;
use crate::memory::try_copy;

const WHAT: &str = "the control within limits";

type Array2<'py> = Bound<'py, PyArray2<f64>>;
type FollowedArrays<'py> = (Array2<'py>, Array2<'py>, usize, f64);

/// Bounds of the distance from the best control.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct Apart(pub(super) crate::limits::horizon::Apart);

#[pymethods]
impl Apart {
    #[getter]
    fn state(&self) -> f64 {
        self.0.state
    }

    #[getter]
    fn weighted(&self) -> f64 {
        self.0.weighted
    }

    #[getter]
    fn distance(&self) -> f64 {
        self.0.distance
    }

    #[getter]
    fn control(&self) -> f64 {
        self.0.control
    }

    #[getter]
    fn excess(&self) -> f64 {
        self.0.excess
    }
}

/// The best control of a horizon.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct HorizonControl {
    pub(super) solved: Solved,
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) steps: usize,
}

#[pymethods]
impl HorizonControl {
    #[getter]
    fn u<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        array2(py, try_copy(WHAT, &self.solved.found.control)?, self.steps, self.m)
    }

    #[getter]
    fn active<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i8>>> {
        array(py, try_copy(WHAT, &self.solved.found.active)?, [self.steps, self.m])
    }

    #[getter]
    fn multipliers<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        array2(py, try_copy(WHAT, &self.solved.found.multipliers)?, self.steps, self.m)
    }

    #[getter]
    fn state_active<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<i8>>>> {
        let Some(sides) = &self.solved.state_active else { return Ok(None) };
        array(py, try_copy(WHAT, sides)?, [self.steps, self.n]).map(Some)
    }

    #[getter]
    fn gap(&self) -> f64 {
        self.solved.found.gap
    }

    #[getter]
    fn distance(&self) -> f64 {
        self.solved.found.distance
    }

    #[getter]
    fn objective(&self) -> f64 {
        self.solved.found.objective
    }

    #[getter]
    fn missed(&self) -> f64 {
        self.solved.missed
    }

    #[getter]
    fn status(&self) -> &'static str {
        self.solved.found.status.as_str()
    }

    #[getter]
    fn missing(&self) -> f64 {
        self.solved.missing
    }

    /// Of a plan to be followed: states (K, n), the feedback (K m, n), steps over which the inputs alone lead to the
    /// states, and `J` of the inputs alone.
    #[getter]
    fn followed<'py>(&self, py: Python<'py>) -> PyResult<Option<FollowedArrays<'py>>> {
        let Some(followed) = &self.solved.followed else { return Ok(None) };
        let states = array2(py, try_copy(WHAT, &followed.states)?, self.steps, self.n)?;
        let feedback = array2(py, try_copy(WHAT, &followed.feedback)?, self.steps * self.m, self.n)?;
        Ok(Some((states, feedback, followed.open_until, followed.open_objective)))
    }
}
