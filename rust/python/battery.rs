//! Tests of the log of a model.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, slice};
use super::error::{InputError, ShapeError};
use super::fitted::{PyFitted, places};
use super::run::run;
use super::window::PyWindow;
use crate::identify::{Declared, Test};
use crate::memory::{try_collect, try_push, try_room};
use crate::window::{self, Log, Logged};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Places<'py> = PyReadonlyArray1<'py, i64>;
/// Pairs (x, u, x one step later), the place of each in its piece, and its run.
type Pairs<'py> = (Matrix<'py>, Places<'py>, Places<'py>);
/// The kind of noise or covariance, and the known covariance.
type Noise<'py> = (String, Option<Matrix<'py>>);
/// Name, probability, share, where, and the share of each outcome.
type Tested<'py> = (&'static str, f64, f64, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

const WHAT: &str = "the tests of a log";

/// The tests of the log of a model that is `fitted` to the windows of `pairs` behind the `first` ones: the last ones of the runs
/// `whole`, if there are any; `read`: of outputs; `piloted`: whether starts are declared to be independent of all noise.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn log_tests<'py>(
    py: Python<'py>,
    pairs: Pairs<'py>,
    whole: Option<Pairs<'py>>,
    window: &PyWindow,
    first: usize,
    read: bool,
    piloted: bool,
    fitted: &PyFitted,
    tested: Vec<usize>,
    noise: Noise<'py>,
) -> PyResult<Vec<Tested<'py>>> {
    let (f, window) = (std::sync::Arc::clone(&fitted.0), &window.0);
    let orders = order(&pairs)?;
    let whole_orders = whole.as_ref().map(order).transpose()?;
    let of = Logged {
        log: log(&pairs, &orders, window)?,
        whole: whole.as_ref().zip(whole_orders.as_ref()).map(|(one, orders)| log(one, orders, window)).transpose()?,
        window,
        first,
        read,
        piloted,
        fitted: &f,
        tested: &tested,
        declared: declared(&noise, f.rows.len())?,
    };
    let (d, n, m) = (window.length(), window.outputs(), window.inputs());
    let cost = (orders.0.len() * (d + n + m) * (4 * d + 20 * m + 40)) as f64;
    handed(py, run(py, cost, |stop| window::log_tests(&of, stop))?)
}

/// Tests of what was declared of the noise, from the residuals of some rows.
#[pyfunction]
pub(super) fn noise_tests<'py>(
    py: Python<'py>,
    fitted: &PyFitted,
    tested: Vec<usize>,
    noise: Noise<'py>,
) -> PyResult<Vec<Tested<'py>>> {
    handed(py, window::declared_tests(&fitted.0, &tested, declared(&noise, fitted.0.rows.len())?)?)
}

fn log<'a>(
    pairs: &'a Pairs<'_>,
    (places, runs): &'a (Vec<usize>, Vec<usize>),
    of: &window::Window,
) -> PyResult<Log<'a>> {
    if runs.len() != places.len() {
        return Err(ShapeError::new_err(format!("`pairs` must have {} runs, got {}", places.len(), runs.len())));
    }
    Ok(Log { pairs: slice("pairs", &pairs.0)?, places, runs, n: of.outputs(), m: of.inputs() })
}

fn declared<'a>((kind, known): &'a Noise<'_>, n: usize) -> PyResult<Option<Declared<'a>>> {
    let known = known.as_ref().map(|known| slice("known", known)).transpose()?;
    let fits = known.is_none_or(|known| known.len() == n * n && n > 0);
    match (kind.as_str(), known) {
        ("full", None) => Ok(None),
        ("gaussian", Some(known)) if fits => Ok(Some(Declared::Gaussian(known))),
        ("sub-gaussian", Some(known)) if fits => Ok(Some(Declared::SubGaussian(known))),
        ("bounded", Some(known)) if fits => Ok(Some(Declared::Bounded(known[0].sqrt()))),
        ("scalar", None) => Ok(Some(Declared::Scalar)),
        ("diagonal", None) => Ok(Some(Declared::Diagonal)),
        (other, _) => Err(InputError::new_err(format!("`noise` must fit to its covariance, got '{other}'"))),
    }
}

fn handed(py: Python<'_>, tests: Vec<Test>) -> PyResult<Vec<Tested<'_>>> {
    let mut found = try_room(WHAT, tests.len())?;
    for Test { name, p_value, share, at, each } in tests {
        try_push(WHAT, &mut found, (name, p_value, share, places(py, &at)?, array1(py, each)?))?;
    }
    Ok(found)
}

/// The place of each pair in its piece, and its run.
fn order((_, places, runs): &Pairs<'_>) -> PyResult<(Vec<usize>, Vec<usize>)> {
    Ok((whole_numbers("places", places)?, whole_numbers("runs", runs)?))
}

/// Numbers that are not negative.
fn whole_numbers(name: &str, given: &Places<'_>) -> PyResult<Vec<usize>> {
    let contiguous = |_| ShapeError::new_err(format!("`{name}` must be C-contiguous"));
    let values = given.as_slice().map_err(contiguous)?;
    if values.iter().any(|v| *v < 0) {
        return Err(InputError::new_err(format!("`{name}` must not be negative")));
    }
    Ok(try_collect(WHAT, values.iter().map(|&v| v as usize))?)
}
