//! The fusing methods, for `Draws` and for dense realizations.

use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{Realizations, array1, array2, dense, sizes, target};
use super::draws::Draws;
use super::error::InputError;
use super::run::run;
use crate::fuse::{self, Weights};

type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;

fn set(subsimplex: bool) -> Weights {
    if subsimplex { Weights::Subsimplex } else { Weights::Simplex }
}

fn require_one_line(draws: &Draws) -> PyResult<()> {
    match draws.inner.law().lines() {
        1 => Ok(()),
        lines => Err(InputError::new_err(format!("`draws` must have one line for the closed form, got {lines}"))),
    }
}

/// ALSE of a vector: `(weights, estimate, error, gap, relative_gap)`.
#[pyfunction]
pub(super) fn closed_form<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    subsimplex: bool,
) -> PyResult<(Array1<'py>, Array2<'py>, f64, f64, f64)> {
    require_one_line(&draws)?;
    let (inner, length) = (draws.inner.clone(), draws.inner.law().length());
    let values = self::target(&target, length)?;
    let fit = run(py, 3.0 * inner.size() as f64, |stop| fuse::closed_form(&inner, values, set(subsimplex), stop))?;
    let estimate = array2(py, fit.estimate, 1, length)?;
    Ok((array1(py, fit.weights), estimate, fit.error, fit.gap.absolute, fit.gap.relative))
}

/// ALSE by a certified solver: `(weights, estimate, error, gap, status, solver, iterations, exact)`.
#[pyfunction]
#[expect(clippy::type_complexity, reason = "one tuple per call, named in the stub")]
pub(super) fn alse<'py>(
    py: Python<'py>,
    realizations: Realizations<'py>,
    target: PyReadonlyArray2<'py, f64>,
    subsimplex: bool,
    tol: f64,
    threads: usize,
) -> PyResult<(Array1<'py>, Array2<'py>, f64, f64, &'static str, &'static str, u64, bool)> {
    let (lines, length) = target.as_array().dim();
    let set = set(subsimplex);
    let solution = match &realizations {
        Realizations::Draws(draws) => {
            let (inner, values) = (draws.inner.clone(), self::target(&target, draws.inner.law().values().len())?);
            run(py, f64::INFINITY, |stop| fuse::alse(&inner, values, set, tol, threads, stop))?
        }
        Realizations::Dense(samples) => {
            let samples = dense(samples)?;
            let values = self::target(&target, samples.dim())?;
            run(py, f64::INFINITY, |stop| fuse::alse(&samples, values, set, tol, threads, stop))?
        }
    };
    Ok((
        array1(py, solution.weights),
        array2(py, solution.estimate, lines, length)?,
        solution.error,
        solution.gap,
        solution.status.as_str(),
        solution.solver,
        solution.iterations,
        solution.exact,
    ))
}

/// SLSE: `(weights, estimate, errors, estimates)`, the last two at `sizes`.
#[pyfunction]
pub(super) fn slse<'py>(
    py: Python<'py>,
    realizations: Realizations<'py>,
    target: PyReadonlyArray2<'py, f64>,
    safeguard: bool,
    sizes: Vec<usize>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array2<'py>, Array1<'py>, Array2<'py>)> {
    let (lines, length) = target.as_array().dim();
    let fit = match &realizations {
        Realizations::Draws(draws) => {
            let inner = draws.inner.clone();
            self::sizes(&sizes, inner.size())?;
            let values = self::target(&target, inner.law().values().len())?;
            let cost = 5.0 * inner.size() as f64 * inner.law().lines() as f64 + (sizes.len() * values.len()) as f64;
            run(py, cost, |stop| fuse::slse(&inner, values, safeguard, &sizes, keep_estimates, stop))?
        }
        Realizations::Dense(samples) => {
            let samples = dense(samples)?;
            self::sizes(&sizes, samples.size())?;
            let values = self::target(&target, samples.dim())?;
            let cost = 5.0 * samples.values().len() as f64 + (sizes.len() * values.len()) as f64;
            run(py, cost, |stop| fuse::slse_dense(&samples, values, safeguard, &sizes, keep_estimates, stop))?
        }
    };
    let kept = if keep_estimates { sizes.len() } else { 0 };
    Ok((
        array1(py, fit.weights),
        array2(py, fit.estimate, lines, length)?,
        array1(py, fit.errors),
        array2(py, fit.estimates, kept, lines * length)?,
    ))
}

/// Uniform averages of prefixes: `(errors, estimates)`.
#[pyfunction]
pub(super) fn uniform_path<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    sizes: Vec<usize>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array2<'py>)> {
    let inner = draws.inner.clone();
    self::sizes(&sizes, inner.size())?;
    let values = self::target(&target, inner.law().values().len())?;
    let cost = (inner.size() * inner.law().lines()) as f64 + 5.0 * (sizes.len() * values.len()) as f64;
    let path = run(py, cost, |stop| fuse::uniform_path(&inner, values, &sizes, keep_estimates, stop))?;
    let kept = if keep_estimates { sizes.len() } else { 0 };
    Ok((array1(py, path.errors), array2(py, path.estimates, kept, values.len())?))
}

/// The closed form of prefixes: `(errors, gaps, relative_gaps, estimates)`.
#[pyfunction]
pub(super) fn alse_path<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    subsimplex: bool,
    sizes: Vec<usize>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array1<'py>, Array1<'py>, Array2<'py>)> {
    require_one_line(&draws)?;
    let inner = draws.inner.clone();
    self::sizes(&sizes, inner.size())?;
    let values = self::target(&target, inner.law().values().len())?;
    let cost = inner.size() as f64 + 50.0 * (sizes.len() * values.len()) as f64;
    let path = run(py, cost, |stop| fuse::alse_path(&inner, values, set(subsimplex), &sizes, keep_estimates, stop))?;
    let kept = if keep_estimates { sizes.len() } else { 0 };
    let gaps = path.gaps.iter().map(|gap| gap.absolute).collect();
    let relative = path.gaps.iter().map(|gap| gap.relative).collect();
    let estimates = array2(py, path.estimates, kept, values.len())?;
    Ok((array1(py, path.errors), array1(py, gaps), array1(py, relative), estimates))
}

/// ALSE of prefixes by the certified solver: `(errors, gaps, statuses, estimates)`.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn alse_prefixes<'py>(
    py: Python<'py>,
    draws: PyRef<'py, Draws>,
    target: PyReadonlyArray2<'py, f64>,
    subsimplex: bool,
    tol: f64,
    threads: usize,
    sizes: Vec<usize>,
    keep_estimates: bool,
) -> PyResult<(Array1<'py>, Array1<'py>, Vec<&'static str>, Array2<'py>)> {
    let inner = draws.inner.clone();
    self::sizes(&sizes, inner.size())?;
    let values = self::target(&target, inner.law().values().len())?;
    let path = run(py, f64::INFINITY, |stop| {
        fuse::alse_prefixes(&inner, values, set(subsimplex), tol, threads, &sizes, stop)
    })?;
    let errors = path.iter().map(|fit| fit.error).collect();
    let gaps = path.iter().map(|fit| fit.gap).collect();
    let statuses = path.iter().map(|fit| fit.status.as_str()).collect();
    let kept = if keep_estimates { sizes.len() } else { 0 };
    let estimates = path.into_iter().take(kept).flat_map(|fit| fit.estimate).collect();
    Ok((array1(py, errors), array1(py, gaps), statuses, array2(py, estimates, kept, values.len())?))
}
