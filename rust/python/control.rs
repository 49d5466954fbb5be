//! The pseudoinverse and the controls of realizations.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
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
        array1(py, p.singular_values)?,
        p.condition,
        array2(py, p.matrix, cols, rows)?,
    ))
}

/// The best control over `steps` steps from the factors of `C_K` by [`pseudoinverse`] and a lower bound `gap` of its least
/// singular value that is not 0: `((control, free, needed, residual), (control_rounding, state_rounding, upper, lower,
/// size, unit))`, see [`control::Best`].
#[pyfunction]
#[expect(clippy::type_complexity, reason = "one tuple per call, named in the stub")]
pub(super) fn best_control<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    steps: usize,
    factors: (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>, f64),
    x0: PyReadonlyArray1<'py, f64>,
    xf: PyReadonlyArray1<'py, f64>,
) -> PyResult<([Bound<'py, PyArray1<f64>>; 4], [f64; 6])> {
    let (n, m) = b.as_array().dim();
    let (left, right, singular_values, gap) = &factors;
    let rank = left.as_array().nrows();
    let fits = [
        ("A", a.as_array().dim(), (n, n)),
        ("x0 and xf", (x0.len(), xf.len()), (n, n)),
        ("left", left.as_array().dim(), (rank, n)),
        ("right", right.as_array().dim(), (rank, m.saturating_mul(steps))),
    ];
    for (name, found, expected) in fits {
        if found != expected || steps == 0 || n == 0 || m == 0 {
            return Err(ShapeError::new_err(format!("`{name}` must have the shape {expected:?}, got {found:?}")));
        }
    }
    if singular_values.len() < rank {
        return Err(ShapeError::new_err(format!("`singular_values` must have {rank} entries at least")));
    }
    let motion = control::Motion { a: slice("A", &a)?, b: slice("B", &b)?, n, m, steps };
    let factors = control::Factors {
        basis: slice("left", left)?,
        right: slice("right", right)?,
        singular_values: slice("singular_values", singular_values)?,
        gap: *gap,
    };
    let (x0, xf) = (slice("x0", &x0)?, slice("xf", &xf)?);
    let cost = 200.0 * (n * (n + m)) as f64 * steps as f64;
    let best = run(py, cost, |stop| control::best_control(&motion, &factors, x0, xf, stop))?;
    let vectors =
        [array1(py, best.control)?, array1(py, best.free)?, array1(py, best.needed)?, array1(py, best.residual)?];
    let numbers = [best.control_rounding, best.state_rounding, best.upper, best.lower, best.size, best.unit];
    Ok((vectors, numbers))
}

/// `C_K (high + low)` for a control in the order of `C_K`, and a bound on the error of that; rounding to doubles is not in
/// it.
#[pyfunction]
pub(super) fn pushed<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    steps: usize,
    high: PyReadonlyArray1<'py, f64>,
    low: PyReadonlyArray1<'py, f64>,
) -> PyResult<(Bound<'py, PyArray1<f64>>, f64)> {
    let (n, m) = b.as_array().dim();
    let width = m.saturating_mul(steps);
    let (found, expected) = ((a.as_array().dim(), high.len(), low.len()), ((n, n), width, width));
    if found != expected || steps == 0 || n == 0 || m == 0 {
        return Err(ShapeError::new_err(format!("the shapes must be {expected:?}, got {found:?}")));
    }
    let motion = control::Motion { a: slice("A", &a)?, b: slice("B", &b)?, n, m, steps };
    let (high, low) = (slice("high", &high)?, slice("low", &low)?);
    let cost = 20.0 * (n * (n + m)) as f64 * steps as f64;
    let (state, off) = run(py, cost, |_| control::pushed(&motion, high, low))?;
    Ok((array1(py, state)?, off))
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
    array1(py, mean)
}
