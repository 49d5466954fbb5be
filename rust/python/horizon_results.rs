//! The results of the calls of a horizon.

use numpy::PyArray2;
use pyo3::prelude::*;

use super::arrays::array;
use super::convert::{array2, getters};
use crate::limits::horizon::Solved;
use crate::memory::try_copy;

const WHAT: &str = "the control within limits";

type Array2<'py> = Bound<'py, PyArray2<f64>>;
type FollowedArrays<'py> = (Array2<'py>, Array2<'py>, usize, f64);

/// Bounds of the distance from the best control.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct Apart(pub(super) crate::limits::horizon::Apart);

getters! {
    Apart {
        state: f64 = |own| own.0.state;
        weighted: f64 = |own| own.0.weighted;
        distance: f64 = |own| own.0.distance;
        control: f64 = |own| own.0.control;
        excess: f64 = |own| own.0.excess;
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

getters! {
    HorizonControl {
        gap: f64 = |own| own.solved.found.gap;
        distance: f64 = |own| own.solved.found.distance;
        objective: f64 = |own| own.solved.found.objective;
        missed: f64 = |own| own.solved.missed;
        status: &'static str = |own| own.solved.found.status.as_str();
        missing: f64 = |own| own.solved.missing;
    }

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
