//! Tests of a model of logged pairs.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, slice};
use super::error::{InputError, ShapeError};
use super::fitted::{PyFitted, places};
use super::run::run;
use crate::identify::{self, Declared, Given, Test};
use crate::memory::{try_collect, try_push, try_room};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Places<'py> = PyReadonlyArray1<'py, i64>;
/// Name, probability, share, where, and the share of each outcome.
type Tested<'py> = (&'static str, f64, f64, Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>);

const WHAT: &str = "the tests of residuals";

/// The tests of least squares `fitted` of the rows (z, y) that belong to the logged `pairs` (x, u, x one step later): for each
/// row its pair and its run, for each pair its place in its piece. `of`: the first place in z of an input, and whether its
/// last entry is 1; `beyond`: how many steps back the first reading and input are that z does not hold, and how many
/// inputs are later than all it holds; `extra` columns in
/// their place; `marked` rows, of which alone it is tested whether they have a model of their own.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
pub(super) fn battery<'py>(
    py: Python<'py>,
    rows: Matrix<'py>,
    fitted: PyRef<'py, PyFitted>,
    basis: Matrix<'py>,
    pairs: Matrix<'py>,
    at: Places<'py>,
    piece: Places<'py>,
    runs: Places<'py>,
    of: (usize, bool),
    beyond: (usize, usize, usize),
    extra: Option<Matrix<'py>>,
    marked: Option<Places<'py>>,
) -> PyResult<Vec<Tested<'py>>> {
    let f = std::sync::Arc::clone(&fitted.0);
    let (n, d, width) = (f.rows.len(), f.columns.len(), pairs.as_array().dim().1);
    let m = width.checked_sub(2 * n).ok_or_else(|| ShapeError::new_err("`pairs` must be rows (x, u, x_next)"))?;
    let (at, places_, runs) = (whole("at", &at)?, whole("piece", &piece)?, whole("runs", &runs)?);
    let marked = marked.as_ref().map(|marked| whole("marked", marked)).transpose()?;
    let marked = marked.map(|marked| try_collect(WHAT, marked.into_iter().map(|v| v != 0))).transpose()?;
    let given = Given {
        rows: slice("rows", &rows)?,
        fitted: &f,
        basis: slice("basis", &basis)?,
        pairs: slice("pairs", &pairs)?,
        at: &at,
        places: &places_,
        runs: &runs,
        d,
        n,
        m,
        inputs_at: of.0,
        intercept: of.1,
        beyond,
        extra: extra.as_ref().map(|extra| slice("extra", extra)).transpose()?,
        marked: marked.as_deref(),
    };
    let cost = (at.len() * (d + n + m) * (4 * d + 20 * m + 40)) as f64;
    given_back(py, run(py, cost, |stop| identify::battery(&given, stop))?)
}

/// Tests of the sum of squares S (n, n) of residuals against what was declared of the noise.
#[pyfunction]
pub(super) fn noise_tests<'py>(
    py: Python<'py>,
    squares: Matrix<'py>,
    size: usize,
    nu: usize,
    declared: &str,
    known: Option<Matrix<'py>>,
) -> PyResult<Vec<Tested<'py>>> {
    let (s, n) = (slice("S", &squares)?, squares.as_array().dim().0);
    let known = known.as_ref().map(|known| slice("known", known)).transpose()?;
    let fits = known.is_none_or(|known| known.len() == n * n && n > 0);
    let declared = match (declared, known) {
        ("gaussian", Some(known)) if fits => Declared::Gaussian(known),
        ("sub-gaussian", Some(known)) if fits => Declared::SubGaussian(known),
        ("bounded", Some(known)) if fits => Declared::Bounded(known[0].sqrt()),
        ("scalar", None) => Declared::Scalar,
        ("diagonal", None) => Declared::Diagonal,
        (other, _) => return Err(InputError::new_err(format!("`declared` must fit to `known`, got '{other}'"))),
    };
    given_back(py, identify::noise_tests(s, n, (size, nu), declared)?)
}

fn given_back(py: Python<'_>, tests: Vec<Test>) -> PyResult<Vec<Tested<'_>>> {
    let mut found = try_room(WHAT, tests.len())?;
    for Test { name, p_value, share, at, each } in tests {
        try_push(WHAT, &mut found, (name, p_value, share, places(py, &at)?, array1(py, each)?))?;
    }
    Ok(found)
}

/// Numbers that are not negative.
fn whole(name: &str, given: &Places<'_>) -> PyResult<Vec<usize>> {
    let contiguous = |_| ShapeError::new_err(format!("`{name}` must be C-contiguous"));
    let values = given.as_slice().map_err(contiguous)?;
    if values.iter().any(|v| *v < 0) {
        return Err(InputError::new_err(format!("`{name}` must not be negative")));
    }
    Ok(try_collect(WHAT, values.iter().map(|&v| v as usize))?)
}
