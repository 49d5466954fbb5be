//! Exact covariances of averages of realizations.

use numpy::{PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::arrays::array;
use super::control::PyFactors;
use super::convert::{array2, slice};
use super::run::run;
use crate::tails::{self, Averaged, Sampling};

type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Square<'py> = PyResult<Bound<'py, PyArray2<f64>>>;
type Squares<'py> = PyResult<Bound<'py, PyArray3<f64>>>;

fn averaged<'a>(of: &'a Matrix<'_>, rows: bool, size: u64, systematic: bool) -> PyResult<Averaged<'a>> {
    let average = Sampling { size, systematic };
    Ok(Averaged { entries: slice("matrix", of)?, columns: of.as_array().dim().1, rows, average })
}

/// `E||average - w||^2` of the lines (k, n), summed.
#[pyfunction]
pub(super) fn mean_square(py: Python<'_>, lines: Matrix<'_>, size: u64, systematic: bool) -> PyResult<f64> {
    let (of, n) = (slice("lines", &lines)?, lines.as_array().dim().1);
    run(py, 100.0 * of.len() as f64, |_| Sampling { size, systematic }.mean_square(of, n))
}

/// The covariances (k, n, n) of the averages of lines (k, n).
#[pyfunction]
pub(super) fn line_covariances<'py>(py: Python<'py>, of: Matrix<'py>, size: u64, systematic: bool) -> Squares<'py> {
    let (lines, (count, n)) = (slice("lines", &of)?, of.as_array().dim());
    let cost = 10.0 * (lines.len() * n) as f64;
    array(py, run(py, cost, |stop| Sampling { size, systematic }.covariances(lines, n, stop))?, [count, n, n])
}

/// `E[A^s M A^s']`.
#[pyfunction]
pub(super) fn second_moment<'py>(py: Python<'py>, a: Matrix<'py>, m: Matrix<'py>, rows: bool) -> Square<'py> {
    let (of, m, n) = (averaged(&a, rows, 1, false)?, slice("M", &m)?, a.as_array().dim().0);
    array2(py, run(py, (4 * of.entries.len()) as f64 * n as f64, |_| of.second_moment(m))?, n, n)
}

/// The covariance of `xf_hat - A_hat x0_hat`, or of the control (true) or the state that it gives with factors of B;
/// `law`: whether rows are drawn, systematically, in pairs.
#[pyfunction]
pub(super) fn fused_covariance<'py>(
    py: Python<'py>,
    a: Matrix<'py>,
    ends: (Vector<'py>, Vector<'py>),
    sizes: [u64; 3],
    law: (bool, bool, bool),
    factors: Option<(Bound<'py, PyFactors>, bool)>,
) -> Square<'py> {
    let ([first, last, of_a], (rows, systematic, paired)) = (sizes, law);
    let (of, ends) = (averaged(&a, rows, of_a, systematic)?, [slice("x0", &ends.0)?, slice("xf", &ends.1)?]);
    let b = factors.as_ref().map(|(factors, control)| (&*factors.get().0, *control));
    let side = b.map_or(ends[1].len(), |(b, control)| if control { b.cols } else { b.rows });
    let cost = 10.0 * of.entries.len() as f64 * ends[1].len() as f64;
    array2(py, run(py, cost, |_| tails::fused_covariance(of, ends, [first, last], paired, b))?, side, side)
}

/// That of the state after the steps of the best control, of which `states` (K + 1, n) are exact.
#[pyfunction]
pub(super) fn final_covariance<'py>(
    py: Python<'py>,
    a: Matrix<'py>,
    states: Matrix<'py>,
    xf: Vector<'py>,
    sizes: [u64; 3],
    rows: bool,
) -> Square<'py> {
    let [first, last, of_a] = sizes;
    let (of, x, xf) = (averaged(&a, rows, of_a, false)?, slice("states", &states)?, slice("xf", &xf)?);
    let cost = of.entries.len() as f64 * (of.entries.len() + x.len()) as f64;
    array2(py, run(py, cost, |stop| tails::final_covariance(of, x, xf, [first, last], stop))?, xf.len(), xf.len())
}

/// Those along `states` (K + 1, n), of averages of so many realizations of A, B and x0.
#[pyfunction]
pub(super) fn trajectory_covariances<'py>(
    py: Python<'py>,
    a: Matrix<'py>,
    b: Matrix<'py>,
    states: Matrix<'py>,
    u: Matrix<'py>,
    sizes: [u64; 3],
    rows: bool,
) -> Squares<'py> {
    let [of_a, of_b, size] = sizes;
    let of = [averaged(&a, rows, of_a, false)?, averaged(&b, rows, of_b, false)?];
    let (x, u, (times, n)) = (slice("states", &states)?, slice("u", &u)?, states.as_array().dim());
    let (start, cost) = (Sampling { size, systematic: false }, 10.0 * x.len() as f64 * (n * n) as f64);
    array(py, run(py, cost, |stop| tails::trajectory_covariances(of, start, x, u, stop))?, [times, n, n])
}
