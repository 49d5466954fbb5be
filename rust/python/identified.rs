//! Models from logs.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::{array1, getters, key, slice};
use super::error::{InputError, ShapeError};
use super::estimate::PyEstimate;
use super::fitted::{PyFitted, copied, places};
use super::pieces::PyPieces;
use super::run::{UNTIL_STOPPED, run};
use super::window::PyWindow;
use crate::identify::{Declared, Test};
use crate::memory::{try_copy, try_push, try_room};
use crate::window::{self, Declarations, Identified, Log, Past};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
/// Pairs (x, u, x one step later), and their runs.
type Pairs<'py> = (Matrix<'py>, Bound<'py, PyPieces>);
/// The kind of noise or covariance, and the known covariance.
type Noise<'py> = (String, Option<Matrix<'py>>);
/// Name, probability, share, where, and the share of each outcome.
type Tested<'py> = (&'static str, f64, f64, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);
/// Probabilities, and how far off statistics are.
type Checks<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

const WHAT: &str = "a model from a log";

/// A window with the number of pairs before its model, filters, whether filters are tried, or lags.
#[derive(FromPyObject)]
pub(super) enum GivenPast<'py> {
    Known(Bound<'py, PyWindow>, usize),
    Filters(f64, usize),
    Chosen(bool),
    Lags(usize),
}

/// A model from a log: its window, its estimates, and the tests of the log.
#[pyclass(frozen, module = "stochens_rs._core", name = "Identified")]
pub(super) struct PyIdentified(Identified);

getters! {
    PyIdentified {
        window: PyWindow = |own| PyWindow(own.0.window);
        found: Option<usize> = |own| own.0.found;
        first: usize = |own| own.0.first;
        unit: bool = |own| own.0.unit;
        size: usize = |own| own.0.size;
        estimate: PyEstimate = |own| PyEstimate(Arc::clone(&own.0.estimate));
        parts: Option<[PyEstimate; 2]> = |own| own.0.parts.clone().map(|parts| parts.map(PyEstimate));
        plain: PyFitted = |own| PyFitted(Arc::clone(&own.0.plain));
        later: bool = |own| own.0.later;
        tests<'py>: PyResult<Vec<Tested<'py>>> = |own, py| handed(py, &own.0.tests);
    }

    #[getter]
    fn triangle<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let width = self.0.estimate.triangle.len().isqrt();
        copied(py, &self.0.estimate.triangle, width, width)
    }

    #[getter]
    fn checks<'py>(&self, py: Python<'py>) -> PyResult<Option<Checks<'py>>> {
        self.0.checks.map(|[p, off]| Ok((array1(py, p.into())?, array1(py, off.into())?))).transpose()
    }
}

/// A model from the log of `pairs` of n states and m inputs, which are the last ones of the runs `whole` if these are
/// given. `about`: the least and largest delay; whether there is a 1, whether outputs are read, whether z is a window,
/// whether its size was expected, whether the error has an exact law, and whether starts are declared to be independent
/// of all noise. `simulated`: how many data sets the residuals are tested by, a key, and the most numbers that are
/// drawn.
#[pyfunction]
#[pyo3(signature = (pairs, whole, sizes, past, about, known, tested, noise, threads, triangle=None, simulated=None))]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn identify(
    py: Python<'_>,
    pairs: Pairs<'_>,
    whole: Option<Pairs<'_>>,
    sizes: [usize; 2],
    past: GivenPast<'_>,
    about: ([usize; 2], [bool; 6]),
    known: Option<Matrix<'_>>,
    tested: Vec<usize>,
    noise: Noise<'_>,
    threads: usize,
    triangle: Option<Matrix<'_>>,
    simulated: Option<(usize, Vec<u8>, f64)>,
) -> PyResult<PyIdentified> {
    let (delays, [intercept, read, windowed, scaled, exact, piloted]) = about;
    let orders = order(&pairs)?;
    let whole_orders = whole.as_ref().map(order).transpose()?;
    let log = log(&pairs, &orders, sizes)?;
    let of = Declarations {
        log,
        whole: match (&whole, &whole_orders) {
            (Some(pairs), Some(orders)) => Some(self::log(pairs, orders, sizes)?),
            _ => None,
        },
        past: match past {
            GivenPast::Known(window, first) => Past::Known(window.get().0, first),
            GivenPast::Filters(pole, count) => Past::Filters(pole, count),
            GivenPast::Chosen(filters) => Past::Chosen(filters),
            GivenPast::Lags(count) => Past::Lags(count),
        },
        delays,
        intercept,
        read,
        windowed,
        scaled,
        exact,
        piloted,
        tested: &tested,
        noise: declared(&noise, log.n)?,
    };
    let known = known.as_ref().map(|known| slice("known", known)).transpose()?;
    let triangle = triangle.as_ref().map(|triangle| slice("triangle", triangle)).transpose()?;
    let simulated = simulated.map(|(draws, bytes, most)| Ok::<_, PyErr>((draws, key(&bytes)?, most))).transpose()?;
    Ok(PyIdentified(run(py, UNTIL_STOPPED, |stop| Identified::new(&of, known, triangle, simulated, threads, stop))?))
}

/// Tests of what was declared of the noise, from the residuals of some rows.
#[pyfunction]
pub(super) fn noise_tests<'py>(
    py: Python<'py>,
    fitted: &PyFitted,
    tested: Vec<usize>,
    noise: Noise<'py>,
) -> PyResult<Vec<Tested<'py>>> {
    handed(py, &window::declared_tests(&fitted.0, &tested, declared(&noise, fitted.0.rows.len())?)?)
}

/// The place of each pair in its piece, and its run.
fn order((_, pieces): &Pairs<'_>) -> PyResult<(Vec<usize>, Vec<usize>)> {
    let pieces = &pieces.get().0;
    Ok((pieces.places()?, pieces.runs()?))
}

fn log<'a>(
    (pairs, _): &'a Pairs<'_>,
    (places, runs): &'a (Vec<usize>, Vec<usize>),
    [n, m]: [usize; 2],
) -> PyResult<Log<'a>> {
    if pairs.shape() != [places.len(), 2 * n + m] {
        let found = pairs.shape();
        return Err(ShapeError::new_err(format!("`pairs` must be those of the runs, got {found:?} with n={n} m={m}")));
    }
    Ok(Log { pairs: slice("pairs", pairs)?, places, runs, n, m })
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

fn handed<'py>(py: Python<'py>, tests: &[Test]) -> PyResult<Vec<Tested<'py>>> {
    let mut found = try_room(WHAT, tests.len())?;
    for Test { name, p_value, share, at, each } in tests {
        try_push(WHAT, &mut found, (*name, *p_value, *share, places(py, at)?, array1(py, try_copy(WHAT, each)?)?))?;
    }
    Ok(found)
}
