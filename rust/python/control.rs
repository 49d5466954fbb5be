//! The pseudoinverse and the controls of realizations.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::error::{InputError, ShapeError};
use super::realizations::EntityArgument;
use super::run::{run, run_unstoppable};
use crate::control::{self, Realized};
use crate::memory::try_copy;

type Matrix<'py> = Bound<'py, PyArray2<f64>>;

/// `B` (n, m) of rank r factored: `(left (r, n), right (r, m), singular_values, condition, matrix (m, n))`, the singular
/// vectors above the cut-off row by row, all singular values, and `B^+`.
#[pyfunction]
#[expect(clippy::type_complexity, reason = "one tuple per call, named in the stub")]
pub(super) fn pseudoinverse<'py>(
    py: Python<'py>,
    b: PyReadonlyArray2<'py, f64>,
) -> PyResult<(Matrix<'py>, Matrix<'py>, Bound<'py, PyArray1<f64>>, f64, Matrix<'py>)> {
    let (rows, cols) = b.as_array().dim();
    let values = try_copy("B", slice("B", &b)?)?;
    let cost = 10.0 * (rows * cols * rows.min(cols)) as f64;
    let p = run_unstoppable(py, cost, move || control::pseudoinverse(&values, rows, cols))?;
    Ok((
        array2(py, p.basis, p.rank, rows)?,
        array2(py, p.right, p.rank, cols)?,
        array1(py, p.singular_values),
        p.condition,
        array2(py, p.matrix, cols, rows)?,
    ))
}

/// `B^+ (xf^s - A^s x0^s)` for every realization, given `B^+` (m, n), into `out` (size, m); `fresh`: it has never been
/// written.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "three entities and what belongs to them")]
pub(super) fn realization_controls<'py>(
    py: Python<'py>,
    out: &Bound<'py, PyArray2<f64>>,
    fresh: bool,
    pinv: PyReadonlyArray2<'py, f64>,
    x0: EntityArgument<'py>,
    xf: EntityArgument<'py>,
    a: EntityArgument<'py>,
    rows: bool,
    threads: usize,
) -> PyResult<()> {
    let (m, n) = pinv.as_array().dim();
    let values = slice("pinv", &pinv)?;
    let realized = Realized::new(x0.entity("x0", false)?, xf.entity("xf", false)?, a.entity("A", rows)?, n)?;
    let cost = realized.size() as f64 * ((m * n) as f64 + realized.cost());
    let taken = |_| InputError::new_err("`out` is in use by another call: every thread needs its own array");
    let mut out = out.try_readwrite().map_err(taken)?;
    let out = out.as_slice_mut().map_err(|_| ShapeError::new_err("`out` must be C-contiguous"))?;
    let memory = if fresh { control::Memory::Fresh } else { control::Memory::Used };
    run(py, cost, |stop| realized.controls_into(values, m, out, memory, threads, stop))
}

/// The mean of `xf^s - A^s x0^s` over the paired realizations (n,).
#[pyfunction]
pub(super) fn mean_difference<'py>(
    py: Python<'py>,
    n: usize,
    x0: EntityArgument<'py>,
    xf: EntityArgument<'py>,
    a: EntityArgument<'py>,
    rows: bool,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let realized = Realized::new(x0.entity("x0", false)?, xf.entity("xf", false)?, a.entity("A", rows)?, n)?;
    let cost = realized.size() as f64 * realized.cost();
    let mean = run(py, cost, |stop| realized.mean(stop))?;
    Ok(array1(py, mean))
}
