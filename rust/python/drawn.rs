//! What follows from the law of an estimate: drawn models, their misses, and the next runs.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::convert::{array1, array2, key, slice};
use super::run::{UNTIL_STOPPED, run};
use super::window::PyWindow;
use crate::certificate::{self, Goal, NextRuns, PlannedRun};
use crate::identify::{Centre, EstimateLaw, NoiseLaw};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

/// `(H (n, d), white (rank, d), S (n, n), what is known of the covariance, degrees of freedom)`
#[derive(FromPyObject)]
pub(super) struct LawArgument<'py>(Matrix<'py>, Matrix<'py>, Matrix<'py>, String, usize);

impl LawArgument<'_> {
    fn get(&self) -> PyResult<EstimateLaw<'_>> {
        let noise = match self.3.as_str() {
            "known" => NoiseLaw::Known,
            "scalar" => NoiseLaw::Scalar(self.4),
            "diagonal" => NoiseLaw::Diagonal(self.4),
            "full" => NoiseLaw::Full(self.4),
            other => return Err(PyValueError::new_err(format!("no covariance is called {other:?}"))),
        };
        let centre = Centre { model: slice("H", &self.0)?, white: slice("white", &self.1)? };
        Ok(EstimateLaw::new(centre, slice("S", &self.2)?, noise)?)
    }
}

/// Models (size, n d) that may be the true one.
#[pyfunction]
pub(super) fn estimate_draws<'py>(
    py: Python<'py>,
    law: LawArgument<'py>,
    size: usize,
    key: &[u8],
    threads: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (given, key, width) = (law.get()?, self::key(key)?, law.0.as_array().len());
    array2(py, run(py, UNTIL_STOPPED, |stop| given.models(&key, size, threads, stop))?, size, width)
}

/// `||x(K) - xf||` of drawn models under `inputs` (K, m); of models of outputs, with a `window`, of the last outputs
/// together; with a `gain` (m, states) of plans that are followed.
#[pyfunction]
#[pyo3(signature = (law, x0, inputs, xf, noise, size, key, threads, window=None, gain=None))]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn drawn_misses<'py>(
    py: Python<'py>,
    law: LawArgument<'py>,
    x0: Vector<'py>,
    inputs: Matrix<'py>,
    xf: Vector<'py>,
    noise: bool,
    size: usize,
    key: &[u8],
    threads: usize,
    window: Option<&Bound<'py, PyWindow>>,
    gain: Option<Matrix<'py>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let window = window.map(|one| one.get().0);
    let (given, key, m) = (law.get()?, self::key(key)?, inputs.as_array().dim().1);
    let (x0, inputs, target) = (slice("x0", &x0)?, slice("inputs", &inputs)?, slice("xf", &xf)?);
    let gain = gain.as_ref().map(|one| slice("gain", one)).transpose()?;
    let aim = PlannedRun { x0, inputs, m, target, noise, window, gain };
    array1(py, run(py, UNTIL_STOPPED, |stop| certificate::drawn_misses(&given, aim, &key, size, threads, stop))?)
}

/// `(inputs (runs, steps m), phi (runs + 1))`.
type Found<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>);

/// The next runs from `starts` (runs, n).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn next_runs<'py>(
    py: Python<'py>,
    model: Matrix<'py>,
    white: Matrix<'py>,
    covariance: Matrix<'py>,
    x0: Vector<'py>,
    inputs: Matrix<'py>,
    starts: Matrix<'py>,
    steps: usize,
    low: Matrix<'py>,
    high: Matrix<'py>,
    key: &[u8],
) -> PyResult<Found<'py>> {
    let (n, m, count, key) =
        (x0.as_array().len(), inputs.as_array().dim().1, starts.as_array().dim().0, self::key(key)?);
    let goal = Goal {
        model: slice("H", &model)?,
        n,
        m,
        white: slice("white", &white)?,
        covariance: slice("covariance", &covariance)?,
        x0: slice("x0", &x0)?,
        inputs: slice("inputs", &inputs)?,
    };
    let (starts, low, high) = (slice("starts", &starts)?, slice("low", &low)?, slice("high", &high)?);
    let runs = NextRuns { starts, steps, low, high };
    let found = run(py, UNTIL_STOPPED, |stop| certificate::next_runs(goal, runs, &key, stop))?;
    Ok((array2(py, found.inputs, count, steps * m)?, array1(py, found.phi)?))
}
