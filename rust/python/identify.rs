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

/// p-values of five statistics of least squares of `rows` (N, d + n) by `draws` simulations, and how far off each is;
/// None with too few pairs.
#[pyfunction]
pub(super) fn residual_checks<'py>(
    py: Python<'py>,
    rows: PyReadonlyArray2<'py, f64>,
    d: usize,
    tested: Vec<usize>,
    draws: usize,
    key: &[u8],
    threads: usize,
) -> PyResult<Option<(Vector<'py>, Vector<'py>)>> {
    let (width, values, key) = (rows.as_array().dim().1, slice("rows", &rows)?, self::key(key)?);
    let found = run(py, UNTIL_STOPPED, |stop| {
        identify::residual_checks(values, width, d, &tested, draws, &key, threads, stop)
    })?;
    found.map(|[p, distances]| Ok((array1(py, p.into())?, array1(py, distances.into())?))).transpose()
}
