//! One command for many units, and its risk.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;

use super::convert::{array1, slice};
use super::error::{InputError, ShapeError};
use super::limits::{seconds, to_best};
use super::run::run;
use crate::fleet::{self, Limits, Units};
use crate::limits::Bounds;
use crate::memory::{try_collect, try_copy, try_filled};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Cube<'py> = PyReadonlyArray3<'py, f64>;

/// Units `x_s(k+1) = A_s x_s(k) + B_s u(k) + c_s`; the arrays are borrowed for every call.
#[derive(FromPyObject)]
pub(super) struct UnitsArgument<'py>(
    Cube<'py>,
    Cube<'py>,
    Option<Matrix<'py>>,
    Matrix<'py>,
    Vector<'py>,
    Matrix<'py>,
    usize,
);

impl UnitsArgument<'_> {
    fn get(&self) -> PyResult<Units<'_>> {
        let (size, n, m) = self.1.as_array().dim();
        let units = Units {
            a: slice("A", &self.0)?,
            b: slice("B", &self.1)?,
            c: self.2.as_ref().map_or(Ok(&[][..]), |c| slice("c", c))?,
            x0: slice("x0", &self.3)?,
            xf: slice("xf", &self.4)?,
            root: slice("root", &self.5)?,
            n,
            m,
            steps: self.6,
            size,
        };
        Ok(units.checked()?)
    }

    fn cost(&self) -> f64 {
        let (size, n, m) = self.1.as_array().dim();
        (size * self.6) as f64 * (n * (n + m)) as f64
    }
}

fn command<'a>(units: &Units<'_>, u: &'a Vector<'_>) -> PyResult<&'a [f64]> {
    let u = slice("u", u)?;
    if u.len() != units.steps * units.m {
        return Err(ShapeError::new_err(format!("`u` must have {} entries, got {}", units.steps * units.m, u.len())));
    }
    Ok(u)
}

/// `(u (d,), value, lower_bound, status)`: the least mean; `r` (m, m) is the weight of one input.
#[pyfunction]
pub(super) fn fleet_mean<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    low: Vector<'py>,
    high: Vector<'py>,
    r: Option<Matrix<'py>>,
    time_limit: Option<f64>,
    threads: usize,
) -> PyResult<(Bound<'py, PyArray1<f64>>, f64, f64, &'static str)> {
    let given = units.get()?;
    let bounds = Bounds::new(slice("low", &low)?, slice("high", &high)?, given.steps * given.m)?;
    let r = r.as_ref().map_or(Ok(&[][..]), |r| slice("R", r))?;
    let time = seconds(time_limit);
    let work = |stop: &crate::Stop| fleet::least_mean(&given, bounds, r, time, threads, stop);
    let found = to_best(py, f64::INFINITY, |found: &fleet::LeastMean| found.status, work)?;
    Ok((array1(py, found.control)?, found.value, found.lower_bound, found.status.as_str()))
}

/// The miss of every unit at `u` (N,); `beside` is the square that the inputs cost.
#[pyfunction]
pub(super) fn fleet_misses<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    u: Vector<'py>,
    beside: f64,
    threads: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (given, cost) = (units.get()?, units.cost());
    let u = command(&given, &u)?;
    array1(py, run(py, cost, |stop| given.misses(u, beside, threads, stop))?)
}

/// `||Q^1/2 G_s||_F^2` of every unit (N,).
#[pyfunction]
pub(super) fn fleet_gains<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    threads: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let (given, cost) = (units.get()?, units.cost());
    let d = given.steps * given.m;
    array1(py, run(py, cost * d as f64, |stop| fleet::gains(&given, threads, stop))?)
}

type Found<'py> = (Bound<'py, PyArray1<f64>>, f64, f64, Vec<usize>, Bound<'py, PyArray1<f64>>, &'static str, usize);

/// `(u (d,), value, lower_bound, working, shares, status, solves)`: the least largest miss without the units in `skip`.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn fleet_worst<'py>(
    py: Python<'py>,
    units: UnitsArgument<'py>,
    low: Vector<'py>,
    high: Vector<'py>,
    cost: (Vector<'py>, Matrix<'py>),
    skip: Vec<usize>,
    start: Vec<usize>,
    tolerance: f64,
    time_limit: Option<f64>,
    threads: usize,
) -> PyResult<Found<'py>> {
    let given = units.get()?;
    let limits = Limits {
        low: slice("low", &low)?,
        high: slice("high", &high)?,
        diagonal: slice("R", &cost.0)?,
        cost: slice("R", &cost.1)?,
    };
    let mut left_out = try_filled("a command for a fleet", false, given.size)?;
    for s in skip {
        let of = left_out.get_mut(s).ok_or_else(|| InputError::new_err(format!("there is no unit {s}")))?;
        *of = true;
    }
    let time = seconds(time_limit);
    let work = |stop: &crate::Stop| fleet::worst(&given, limits, (&left_out, &start), tolerance, time, threads, stop);
    let found = to_best(py, f64::INFINITY, |found: &fleet::Worst| found.status, work)?;
    let working = try_collect("a command for a fleet", found.working.iter().copied())?;
    let control = array1(py, try_copy("a command for a fleet", &found.control)?)?;
    let shares = array1(py, found.shares)?;
    Ok((control, found.value, found.lower_bound, working, shares, found.status.as_str(), found.solves))
}

/// `e` with `P(Bin(size, e) <= most) = beta`.
#[pyfunction]
pub(super) fn scenario_at_most(size: usize, most: usize, beta: f64) -> PyResult<f64> {
    Ok(fleet::at_most(size, most, beta)?)
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
