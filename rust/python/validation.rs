//! Held-out runs and fresh systems against a plan.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice, view};
use super::run::run;
use crate::simulate::{Predicted, Scores, Systems, mean_miss, order_statistic, weighted_order_statistic};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Cube<'py> = PyReadonlyArray3<'py, f64>;
/// `(deviations, misses)`, one of each per run.
type Found<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// `(path (K + 1, n) or (M (K + 1), n), A (n, n), scale (K, n), target (n,))`
#[derive(FromPyObject)]
pub(super) struct PredictedArgument<'py>(Matrix<'py>, Matrix<'py>, Matrix<'py>, Vector<'py>);

impl PredictedArgument<'_> {
    fn get(&self) -> PyResult<Predicted<'_>> {
        Ok(Predicted {
            n: self.3.as_array().len(),
            path: slice("predicted", &self.0)?,
            a: slice("A", &self.1)?,
            scale: slice("scale", &self.2)?,
            target: slice("target", &self.3)?,
        })
    }
}

fn found(py: Python<'_>, scores: Scores) -> PyResult<Found<'_>> {
    Ok((array1(py, scores.deviations)?, array1(py, scores.misses)?))
}

/// The scores of runs (M, K + 1, n), nan after the end of a run that was aborted.
#[pyfunction]
pub(super) fn validation_runs<'py>(
    py: Python<'py>,
    predicted: PredictedArgument<'py>,
    runs: Cube<'py>,
    threads: usize,
) -> PyResult<Found<'py>> {
    let (given, states) = (predicted.get()?, slice("runs", &runs)?);
    let cost = (states.len() * given.n) as f64;
    found(py, run(py, cost, |stop| given.runs(states, threads, stop))?)
}

/// The scores of systems that run once each: transposed, `a` (N, n n) and `b` (N, m n); `c` (N, n), `x0` (1, n) or (N,
/// n).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn validation_systems<'py>(
    py: Python<'py>,
    predicted: PredictedArgument<'py>,
    a: Matrix<'py>,
    b: Matrix<'py>,
    c: Option<Matrix<'py>>,
    x0: Matrix<'py>,
    u: Matrix<'py>,
    threads: usize,
) -> PyResult<Found<'py>> {
    let given = predicted.get()?;
    let (steps, m) = u.as_array().dim();
    let systems = Systems {
        n: given.n,
        m,
        a: slice("A", &a)?,
        b: slice("B", &b)?,
        c: c.as_ref().map(|c| slice("c", c)).transpose()?,
        x0: slice("x0", &x0)?,
        u: slice("u", &u)?,
    };
    let cost = 2.0 * steps as f64 * (systems.a.len() + systems.b.len()) as f64;
    found(py, run(py, cost, |stop| given.systems(&systems, threads, stop))?)
}

/// The deviations (steps, n) that noise of a covariance gives to the states after the start.
#[pyfunction]
pub(super) fn noise_deviations<'py>(
    py: Python<'py>,
    a: Matrix<'py>,
    covariance: Matrix<'py>,
    steps: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let n = a.as_array().dim().1;
    let (a, covariance) = (view("A", &a)?, view("covariance", &covariance)?);
    let cost = 2.0 * (n * n * n) as f64 * steps as f64;
    array2(py, run(py, cost, |_| crate::simulate::noise_deviations(a, covariance, steps))?, steps, n)
}

/// A bound of the distance of the mean of Gaussian `ends` (M, n) from the target.
#[pyfunction]
pub(super) fn validation_mean(py: Python<'_>, ends: Matrix<'_>, target: Vector<'_>, delta: f64) -> PyResult<f64> {
    let (ends, target) = (slice("ends", &ends)?, slice("target", &target)?);
    run(py, (ends.len() * target.len()) as f64, |_| mean_miss(ends, target, delta))
}

/// The score of this rank, from 1; infinite beyond the last one.
#[pyfunction]
pub(super) fn validation_rank(py: Python<'_>, scores: Vector<'_>, rank: usize) -> PyResult<f64> {
    let scores = slice("scores", &scores)?;
    run(py, 30.0 * scores.len() as f64, |_| order_statistic(scores, rank))
}

/// The same for weights (M + 1,), the last of the run to come.
#[pyfunction]
pub(super) fn validation_weighted(
    py: Python<'_>,
    scores: Vector<'_>,
    weights: Vector<'_>,
    delta: f64,
) -> PyResult<f64> {
    let (scores, weights) = (slice("scores", &scores)?, slice("weights", &weights)?);
    run(py, 30.0 * scores.len() as f64, |_| weighted_order_statistic(scores, weights, delta))
}
