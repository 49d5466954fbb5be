//! Identification from measured pairs: triangles, certificates, ensembles, tests.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::{array1, array2, key, slice};
use super::error::{InputError, ShapeError};
use super::run::{UNTIL_STOPPED, run};
use crate::identify;

type Matrix<'py> = Bound<'py, PyArray2<f64>>;
type Vector<'py> = Bound<'py, PyArray1<f64>>;

/// `R` (k, k) of `rows` (N, k) `= Q R`, upper triangular with a diagonal `>= 0`.
#[pyfunction]
pub(super) fn triangle<'py>(
    py: Python<'py>,
    rows: PyReadonlyArray2<'py, f64>,
    threads: usize,
) -> PyResult<Matrix<'py>> {
    let (size, k) = rows.as_array().dim();
    let values = slice("rows", &rows)?;
    let cost = 0.3 * (size * k * k) as f64;
    let r = run(py, cost, |stop| identify::triangle(values, k, threads, stop))?;
    array2(py, r, k, k)
}

/// Takes `rows` (N, k) into the triangle `r` (k, k), in place.
#[pyfunction]
pub(super) fn triangle_update<'py>(
    py: Python<'py>,
    r: &Bound<'py, PyArray2<f64>>,
    rows: PyReadonlyArray2<'py, f64>,
) -> PyResult<()> {
    let (size, k) = rows.as_array().dim();
    let values = slice("rows", &rows)?;
    let mut r = r.try_readwrite().map_err(|_| InputError::new_err("`r` is in use by another call"))?;
    if r.as_array().dim() != (k, k) || !r.is_c_contiguous() {
        return Err(ShapeError::new_err(format!("`r` must be C-contiguous and {k} x {k}, as `rows` has {k} columns")));
    }
    let r = r.as_slice_mut().map_err(|_| ShapeError::new_err("`r` must be C-contiguous"))?;
    run(py, 0.3 * (size * k * k) as f64, |stop| identify::update(r, values, k, stop))
}

/// `(q (N, rank), residuals (N, n), leverages (N))` of the rows of `z` (N, d) and `y` (N, n) with `white` (rank, d).
#[pyfunction]
pub(super) fn residuals<'py>(
    py: Python<'py>,
    z: PyReadonlyArray2<'py, f64>,
    y: PyReadonlyArray2<'py, f64>,
    white: PyReadonlyArray2<'py, f64>,
) -> PyResult<(Matrix<'py>, Matrix<'py>, Vector<'py>)> {
    let ((size, d), (_, n), (rank, _)) = (z.as_array().dim(), y.as_array().dim(), white.as_array().dim());
    let (z, y, white) = (slice("Z", &z)?, slice("Y", &y)?, slice("white", &white)?);
    let found = run(py, (size * rank * (d + n)) as f64, |stop| identify::residuals(z, y, white, (d, n), stop))?;
    Ok((array2(py, found.basis, size, rank)?, array2(py, found.residuals, size, n)?, array1(py, found.leverages)?))
}

/// p-values of five statistics of the residuals `y - H z` by `draws` simulations; NaN for too few pairs.
#[pyfunction]
pub(super) fn residual_p_values<'py>(
    py: Python<'py>,
    z: PyReadonlyArray2<'py, f64>,
    y: PyReadonlyArray2<'py, f64>,
    white: PyReadonlyArray2<'py, f64>,
    draws: usize,
    key: &[u8],
    threads: usize,
) -> PyResult<(Vector<'py>, Vector<'py>)> {
    let (d, n) = (z.as_array().dim().1, y.as_array().dim().1);
    let (z, y, white, key) = (slice("Z", &z)?, slice("Y", &y)?, slice("white", &white)?, self::key(key)?);
    let [p, distances] = run(py, UNTIL_STOPPED, |stop| {
        let found = identify::residuals(z, y, white, (d, n), stop)?;
        identify::residual_p_values(&found, n, draws, &key, threads, stop)
    })?;
    Ok((array1(py, p.into())?, array1(py, distances.into())?))
}
