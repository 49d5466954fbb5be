//! A horizon for one state after another.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, slice};
use super::horizon_arguments::{Entries, TaskArgument, cost, made};
use super::limited::BoxControl;
use super::limits::{seconds, signs};
use super::run::run;
use super::shared::Shared;
use crate::limits::Until;
use crate::limits::horizon::RecedingHorizon;
use crate::memory::try_copy;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

/// The best inputs from one state after another.
#[pyclass(frozen, name = "Loop", module = "stochens_rs._core")]
pub(super) struct PyLoop {
    inner: Shared<RecedingHorizon>,
    cost: f64,
}

#[pymethods]
impl PyLoop {
    #[new]
    fn new(py: Python<'_>, a: Entries, b: Entries, c: Option<Entries>, task: TaskArgument) -> PyResult<Self> {
        let horizon = made(py, &a, &b, c.as_ref(), task.task(None, None))?;
        let cost = cost(&horizon);
        let made = run(py, cost, |stop| RecedingHorizon::new(horizon, stop))?;
        // one map for all states leaves a factorization
        let cost = if made.condensed() { (task.low.0.len() as f64).powi(3) } else { cost };
        Ok(Self { inner: Shared::new("loop", made), cost })
    }

    /// Whether one map serves all states.
    #[getter]
    fn condensed(&self, py: Python<'_>) -> PyResult<bool> {
        self.inner.with(py, 0.0, |inner, _| Ok(inner.condensed()))
    }

    fn solve(&self, py: Python<'_>, x: Vector<'_>, time_limit: Option<f64>) -> PyResult<BoxControl> {
        let (x, limit) = (slice("x", &x)?, seconds(time_limit));
        Ok(BoxControl(self.inner.with(py, self.cost, |inner, stop| inner.solve(x, Until::new(stop, limit)).cloned())?))
    }

    /// Inputs (m,) and states (n,) from which those of the plans count; the limits are moved by them. With values of
    /// inputs that are not chosen (K, m), nan for the others.
    #[pyo3(signature = (inputs, states, fixed=None))]
    fn about(&self, py: Python<'_>, inputs: Vector<'_>, states: Vector<'_>, fixed: Option<Matrix<'_>>) -> PyResult<()> {
        let (inputs, states) = (slice("inputs", &inputs)?, slice("states", &states)?);
        let fixed = fixed.as_ref().map(|fixed| slice("fixed", fixed)).transpose()?;
        self.inner.with(py, 0.0, |inner, _| {
            fixed.map_or(Ok(()), |fixed| inner.fix(fixed))?;
            inner.about(inputs, states)
        })
    }

    /// The states (K, n) that plans follow from now on.
    fn toward(&self, py: Python<'_>, reference: Matrix<'_>) -> PyResult<()> {
        let reference = slice("reference", &reference)?;
        self.inner.with(py, self.cost, |inner, stop| inner.toward(reference, stop))
    }

    /// Factorizations, operations and seconds of a call at most; None where they have no bound.
    fn most(&self, py: Python<'_>) -> PyResult<Option<(usize, f64, f64)>> {
        let most = self.inner.with(py, self.cost, |inner, _| inner.most())?;
        Ok(most.map(|most| (most.factorizations, most.operations, most.seconds)))
    }

    /// The input that is applied now.
    fn follow(&self, py: Python<'_>, previous: Vector<'_>) -> PyResult<()> {
        let previous = slice("previous", &previous)?;
        self.inner.with(py, 0.0, |inner, _| inner.follow(previous))
    }

    fn warm<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray1<i8>>>> {
        let copy = |inner: &mut RecedingHorizon, _: &crate::Stop| {
            inner.warm().map(|warm| try_copy("a start", warm)).transpose()
        };
        self.inner.with(py, 0.0, copy)?.map(|warm| array1(py, warm)).transpose()
    }

    fn resume(&self, py: Python<'_>, warm: Option<PyReadonlyArray1<'_, i8>>) -> PyResult<()> {
        let copy = signs(&warm)?.map(|warm| try_copy("a start", warm)).transpose()?;
        self.inner.with(py, 0.0, |inner, _| inner.resume(copy))
    }
}
