//! The fusing methods, for `Draws` and for dense realizations.

use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyList;

use super::convert::{array1, array2, method, sizes, target};
use super::draws::Draws;
use super::realizations::{Realizations, dense};
use super::run::{run, run_to_best};
use crate::fuse::{self, Samples, Settings, Weights};
use crate::memory::{try_collect, try_extend, try_room};

type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;

fn set(subsimplex: bool) -> Weights {
    if subsimplex { Weights::Subsimplex } else { Weights::Simplex }
}

/// Arguments of the solver as Python passes them: `(subsimplex, tol, time_limit, max_passes, threads)`.
type Wishes = (bool, f64, Option<f64>, Option<usize>, usize);

fn settings((subsimplex, tol, time_limit, max_passes, threads): Wishes) -> Settings {
    let time_limit = time_limit.map(|seconds| Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX));
    Settings { set: set(subsimplex), tol, time_limit, max_passes, threads }
}

/// Returns the result after Ctrl-C if its status is "interrupted", otherwise raises the exception.
fn told<T>((result, signal): (T, Option<PyErr>), says_so: impl Fn(&T) -> bool) -> PyResult<T> {
    match signal {
        Some(signal) if !says_so(&result) => Err(signal),
        _ => Ok(result),
    }
}

/// ALSE of every line by itself: `(weights, estimate, error, gap, relative_gap, unseen)`.
#[pyfunction]
pub(super) fn closed_form<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    subsimplex: bool,
) -> PyResult<(Array2<'py>, Array2<'py>, f64, f64, f64, usize)> {
    let inner = draws.inner.clone();
    let (lines, length) = (inner.law().lines(), inner.law().length());
    let values = self::target(&target, lines * length)?;
    let cost = 3.0 * inner.size() as f64 * lines as f64;
    let fit = run(py, cost, |stop| fuse::closed_form(&inner, values, set(subsimplex), stop))?;
    let weights = array2(py, fit.weights, inner.size(), lines)?;
    let estimate = array2(py, fit.estimate, lines, length)?;
    Ok((weights, estimate, fit.error, fit.gap.absolute, fit.gap.relative, fit.unseen))
}

/// ALSE by a certified solver.
#[pyclass(frozen, get_all, module = "stochens_rs._core")]
pub(super) struct Alse {
    weights: Py<PyArray1<f64>>,
    estimate: Py<PyArray2<f64>>,
    error: f64,
    gap: f64,
    lower_bound: f64,
    unseen: usize,
    exact: bool,
    status: &'static str,
    solver: &'static str,
    iterations: u64,
}

/// ALSE by a certified solver; `limits` are `(subsimplex, tol, time_limit, max_passes, threads)`.
#[pyfunction]
pub(super) fn alse<'py>(
    py: Python<'py>,
    realizations: Realizations<'py>,
    target: PyReadonlyArray2<'py, f64>,
    limits: Wishes,
) -> PyResult<Alse> {
    let (lines, length) = target.as_array().dim();
    let settings = settings(limits);
    let ended = match &realizations {
        Realizations::Draws(draws) => {
            let (inner, values) = (draws.inner.clone(), self::target(&target, draws.inner.law().values().len())?);
            run_to_best(py, |stop| fuse::alse(&inner, values, &settings, stop))?
        }
        Realizations::Dense(samples) => {
            let samples = dense(samples)?;
            let values = self::target(&target, samples.dim())?;
            run_to_best(py, |stop| fuse::alse(&samples, values, &settings, stop))?
        }
    };
    let solution = told(ended, |solution| solution.status == fuse::WeightStatus::Interrupted)?;
    Ok(Alse {
        weights: array1(py, solution.weights)?.unbind(),
        estimate: array2(py, solution.estimate, lines, length)?.unbind(),
        error: solution.error,
        gap: solution.gap,
        lower_bound: solution.lower_bound,
        unseen: solution.unseen,
        exact: solution.exact,
        status: solution.status.as_str(),
        solver: solution.solver,
        iterations: solution.iterations,
    })
}

/// Prefixes by a method without a solver: `(weights, estimate, errors, estimates)`, the last two at `sizes`.
#[pyfunction]
pub(super) fn fuse_path<'py>(
    py: Python<'py>,
    realizations: Realizations<'py>,
    target: PyReadonlyArray2<'py, f64>,
    method: &str,
    sizes: &Bound<'py, PyList>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array2<'py>, Array1<'py>, Array2<'py>)> {
    let (method, (lines, length)) = (self::method(method)?, target.as_array().dim());
    let (inner, rows);
    let (samples, size, dim, entries) = match &realizations {
        Realizations::Draws(draws) => {
            inner = draws.inner.clone();
            let (size, law) = (inner.size(), inner.law());
            (Samples::Drawn(&inner), size, law.values().len(), size * law.lines())
        }
        Realizations::Dense(samples) => {
            rows = dense(samples)?;
            (Samples::Dense(&rows), rows.size(), rows.dim(), rows.values().len())
        }
    };
    let (sizes, values) = (self::sizes(sizes, size)?, self::target(&target, dim)?);
    let cost = 5.0 * (entries + sizes.len() * dim) as f64;
    let fit = run(py, cost, |stop| method.fuse(samples, values, &sizes, keep_estimates, stop))?;
    let kept = if keep_estimates { sizes.len() } else { 0 };
    Ok((
        array1(py, fit.weights)?,
        array2(py, fit.estimate, lines, length)?,
        array1(py, fit.errors)?,
        array2(py, fit.estimates, kept, lines * length)?,
    ))
}

/// The closed form of prefixes: `(errors, gaps, relative_gaps, estimates)`.
#[pyfunction]
pub(super) fn alse_path<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    subsimplex: bool,
    sizes: &Bound<'py, PyList>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array1<'py>, Array1<'py>, Array2<'py>)> {
    let inner = draws.inner.clone();
    let sizes = self::sizes(sizes, inner.size())?;
    let values = self::target(&target, inner.law().values().len())?;
    let cost = (inner.size() * inner.law().lines()) as f64 + 50.0 * (sizes.len() * values.len()) as f64;
    let path = run(py, cost, |stop| fuse::alse_path(&inner, values, set(subsimplex), &sizes, keep_estimates, stop))?;
    let kept = if keep_estimates { sizes.len() } else { 0 };
    let gaps = try_collect("the gaps", path.gaps.iter().map(|gap| gap.absolute))?;
    let relative = try_collect("the gaps", path.gaps.iter().map(|gap| gap.relative))?;
    let estimates = array2(py, path.estimates, kept, values.len())?;
    Ok((array1(py, path.errors)?, array1(py, gaps)?, array1(py, relative)?, estimates))
}

/// ALSE of prefixes by the certified solver: `(errors, gaps, statuses, estimates)`; `limits` as for `alse`.
#[pyfunction]
pub(super) fn alse_prefixes<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    limits: Wishes,
    sizes: &Bound<'py, PyList>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array1<'py>, Vec<&'static str>, Array2<'py>)> {
    let inner = draws.inner.clone();
    let sizes = self::sizes(sizes, inner.size())?;
    let values = self::target(&target, inner.law().values().len())?;
    let settings = settings(limits);
    let ended = run_to_best(py, |stop| {
        const WHAT: &str = "a path";
        let (mut errors, mut gaps) = (try_room(WHAT, sizes.len())?, try_room(WHAT, sizes.len())?);
        let (mut statuses, mut estimates) = (try_room(WHAT, sizes.len())?, Vec::new());
        fuse::alse_prefixes(&inner, values, &settings, &sizes, stop, |fit| {
            errors.push(fit.error);
            gaps.push(fit.gap);
            statuses.push(fit.status);
            if keep_estimates {
                try_extend(WHAT, &mut estimates, fit.estimate.iter().copied())?;
            }
            Ok(())
        })?;
        Ok((errors, gaps, statuses, estimates))
    })?;
    let (errors, gaps, statuses, estimates) = told(ended, |path| path.2.contains(&fuse::WeightStatus::Interrupted))?;
    let kept = if keep_estimates { sizes.len() } else { 0 };
    let statuses = try_collect("the statuses", statuses.iter().map(|status| status.as_str()))?;
    Ok((array1(py, errors)?, array1(py, gaps)?, statuses, array2(py, estimates, kept, values.len())?))
}
