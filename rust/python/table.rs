//! Tables in CSV files.

use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyString};

use super::arrays::text as text_of;
use super::convert::array1;
use super::error::InputError;
use super::run::run;
use crate::table::{self, Table};

/// Elementary operations per byte of text, and per cell.
const PER_BYTE: f64 = 10.0;

type Vector<'py> = Bound<'py, PyArray1<f64>>;

/// The cells of a CSV file, of which the text is `text`.
#[pyclass(frozen, module = "stochens_rs._core", name = "Table")]
pub(super) struct PyTable(Table);

#[pymethods]
impl PyTable {
    #[new]
    fn new(py: Python<'_>, path: &str, text: &str, skip: usize) -> PyResult<Self> {
        Ok(Self(run(py, PER_BYTE * text.len() as f64, |_| Table::read(path, text, skip))?))
    }

    #[getter]
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        list(py, self.0.names.iter().map(String::as_str))
    }

    fn line(&self, row: usize) -> PyResult<usize> {
        if row < self.0.rows() {
            Ok(self.0.line(row))
        } else {
            Err(InputError::new_err("`row` must be one of the table"))
        }
    }

    /// A column of numbers, NaN where one is missing.
    fn numbers<'py>(&self, py: Python<'py>, column: usize, whole: bool) -> PyResult<Vector<'py>> {
        self.require(column)?;
        array1(py, run(py, PER_BYTE * self.0.rows() as f64, |_| self.0.numbers(column, whole))?)
    }

    /// The cells of a column.
    fn cells<'py>(&self, py: Python<'py>, column: usize) -> PyResult<Bound<'py, PyList>> {
        self.require(column)?;
        list(py, self.0.column(column))
    }

    /// What to do about a cell that is no number, or no time.
    fn cure(&self, column: usize, cell: &str) -> PyResult<&'static str> {
        self.require(column)?;
        Ok(self.0.cure(column, cell))
    }
}

impl PyTable {
    fn require(&self, column: usize) -> PyResult<()> {
        let columns = self.0.names.len();
        if column < columns { Ok(()) } else { Err(InputError::new_err(format!("`column` must be below {columns}"))) }
    }
}

fn list<'a, 'py>(py: Python<'py>, texts: impl Iterator<Item = &'a str>) -> PyResult<Bound<'py, PyList>> {
    let made: Bound<'py, PyList> = py.get_type::<PyList>().call0()?.cast_into()?;
    texts.map(|one| text_of(py, one)).try_for_each(|one| made.append(one?))?;
    Ok(made)
}

/// Dates and times as texts in seconds since the first, NaN where one is empty; and the first one that is neither.
#[pyfunction]
pub(super) fn instants<'py>(py: Python<'py>, texts: &Bound<'py, PyList>) -> PyResult<(Vector<'py>, Option<usize>)> {
    let joined = PyString::new(py, "\n").call_method1("join", (texts,))?;
    let text: &str = joined.cast::<PyString>()?.to_str()?;
    let (seconds, wrong) = run(py, PER_BYTE * text.len() as f64, |_| table::instants(text.split('\n')))?;
    Ok((array1(py, seconds)?, wrong))
}
