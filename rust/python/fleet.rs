//! One command for many units, and its risk.

use numpy::{PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::error::ShapeError;
use super::horizon_arguments::TaskArgument;
use super::limits::{seconds, to_best};
use super::run::run;
use crate::fleet::{self, Units};
use crate::limits;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Cube<'py> = PyReadonlyArray3<'py, f64>;

/// Units `x_s(k+1) = A_s x_s(k) + B_s u(k) + c_s` and where they begin; the arrays are borrowed for every call.
#[derive(FromPyObject)]
pub(super) struct UnitsArgument<'py>(Cube<'py>, Cube<'py>, Option<Matrix<'py>>, Matrix<'py>);

/// What is asked of them.
struct Asked<'a> {
    task: &'a TaskArgument,
    stage: Vec<f64>,
    terminal: Vec<f64>,
}

impl<'a> Asked<'a> {
    fn new(task: &'a TaskArgument, n: usize) -> PyResult<Self> {
        Ok(Self { task, stage: limits::root(&task.stage.0, n)?, terminal: limits::root(&task.terminal.0, n)? })
    }

    fn units(&'a self, given: &'a UnitsArgument<'_>) -> PyResult<Units<'a>> {
        let (size, n, m) = given.1.as_array().dim();
        let units = Units {
            a: slice("A", &given.0)?,
            b: slice("B", &given.1)?,
            c: given.2.as_ref().map_or(Ok(&[][..]), |c| slice("c", c))?,
            x0: slice("x0", &given.3)?,
            reference: &self.task.reference.0,
            stage: &self.stage,
            terminal: &self.terminal,
            n,
            m,
            steps: self.task.reference.0.len() / n.max(1),
            size,
        };
        Ok(units.checked()?)
    }
}

fn work(units: &Units<'_>) -> f64 {
    (units.size * units.steps) as f64 * (units.n * (units.n + units.m)) as f64
}

type Found<'py> = (Bound<'py, PyArray2<f64>>, f64, f64, f64, &'static str);

/// `(u (K, m), value, lower_bound, missing, status)`: the least mean.
#[pyfunction]
pub(super) fn fleet_mean<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    task: TaskArgument,
    time_limit: Option<f64>,
    threads: usize,
) -> PyResult<Found<'py>> {
    let asked = Asked::new(&task, units.1.as_array().dim().1)?;
    let given = asked.units(&units)?;
    let time = seconds(time_limit);
    let work = |stop: &crate::Stop| fleet::least_mean(&given, task.limits(), time, threads, stop);
    let found = to_best(py, f64::INFINITY, |found: &fleet::LeastMean| found.status, work)?;
    let u = array2(py, found.control, given.steps, given.m)?;
    Ok((u, found.value, found.lower_bound, found.missing, found.status.as_str()))
}

type Looked<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// The miss of every unit at `u` (N,), and by how much its states leave their limits.
#[pyfunction]
pub(super) fn fleet_misses<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    task: TaskArgument,
    u: Matrix<'py>,
    threads: usize,
) -> PyResult<Looked<'py>> {
    let asked = Asked::new(&task, units.1.as_array().dim().1)?;
    let (given, u) = (asked.units(&units)?, slice("u", &u)?);
    if u.len() != given.steps * given.m {
        return Err(ShapeError::new_err(format!("`u` must have {} entries, got {}", given.steps * given.m, u.len())));
    }
    let (misses, excess) = run(py, work(&given), |stop| fleet::misses(&given, task.limits(), u, threads, stop))?;
    Ok((array1(py, misses)?, array1(py, excess)?))
}

type Few<'py> = (Found<'py>, Vec<usize>, Vec<usize>, Option<Bound<'py, PyArray2<f64>>>, Option<usize>);

/// `((u, value, lower_bound, missing, status), support, removed, R, widest)`: the least largest miss.
#[pyfunction]
pub(super) fn fleet_worst<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    task: TaskArgument,
    tiny: bool,
    discard: usize,
    time_limit: Option<f64>,
    threads: usize,
) -> PyResult<Few<'py>> {
    let asked = Asked::new(&task, units.1.as_array().dim().1)?;
    let given = asked.units(&units)?;
    let time = seconds(time_limit);
    let work = |stop: &crate::Stop| fleet::of_few(&given, task.limits(), (tiny, discard), time, threads, stop);
    let found = to_best(py, f64::INFINITY, |found: &fleet::Few| found.status, work)?;
    let u = array2(py, found.control, given.steps, given.m)?;
    let r = if found.r.is_empty() { None } else { Some(array2(py, found.r, given.m, given.m)?) };
    let all = (u, found.value, found.lower_bound, found.missing, found.status.as_str());
    Ok((all, found.support, found.removed, r, found.widest))
}

/// The command (K, m) of some units alone, as `fleet_worst` computes it.
#[pyfunction]
pub(super) fn fleet_alone<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    task: TaskArgument,
    tiny: bool,
    few: Vec<usize>,
    threads: usize,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let asked = Asked::new(&task, units.1.as_array().dim().1)?;
    let given = asked.units(&units)?;
    let u = run(py, f64::INFINITY, |stop| fleet::alone(&given, task.limits(), tiny, &few, threads, stop))?;
    array2(py, u, given.steps, given.m)
}

/// `e` with `P(Bin(size, e) <= most) = beta`.
#[pyfunction]
pub(super) fn scenario_at_most(size: usize, most: usize, beta: f64) -> PyResult<f64> {
    Ok(fleet::at_most(size, most, beta)?)
}

/// The rank of the order statistic of held-out runs.
#[pyfunction]
pub(super) fn scenario_rank(size: usize, delta: f64, beta: f64) -> PyResult<usize> {
    Ok(fleet::rank(size, delta, beta)?)
}

/// Wait and judge.
#[pyfunction]
pub(super) fn scenario_judged(size: usize, support: usize, beta: f64) -> PyResult<f64> {
    Ok(fleet::judged(size, support, beta)?)
}

/// Of a command that a few units give.
#[pyfunction]
pub(super) fn scenario_compression(size: usize, support: usize, violations: usize, beta: f64) -> PyResult<f64> {
    Ok(fleet::compression(size, support, violations, beta)?)
}

/// From below and from above.
#[pyfunction]
pub(super) fn scenario_relaxed(size: usize, support: usize, beta: f64) -> PyResult<(f64, f64)> {
    Ok(fleet::relaxed(size, support, beta)?)
}

/// After some were left out.
#[pyfunction]
pub(super) fn scenario_discarding(size: usize, discarded: usize, dimension: usize, beta: f64) -> PyResult<f64> {
    Ok(fleet::discarding(size, discarded, dimension, beta)?)
}

/// The smallest size.
#[pyfunction]
pub(super) fn scenario_required(epsilon: f64, dimension: usize, beta: f64) -> PyResult<usize> {
    Ok(fleet::required(epsilon, dimension, beta)?)
}
