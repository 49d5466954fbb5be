//! The runs of a log and their pieces.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use super::convert::getters;
use super::error::InputError;
use super::fitted::places;
use super::region::places as counts;
use crate::memory::{try_collect, try_filled};
use crate::table::Pieces;

const WHAT: &str = "the pieces of a log";

type Numbers<'py> = Bound<'py, PyArray1<i64>>;

/// Runs, gaps (pair behind it, steps) one behind the other, and the rows that each run has lost.
#[pyclass(frozen, eq, module = "stochens_rs._core", name = "Pieces")]
#[derive(PartialEq)]
pub(super) struct PyPieces(pub(super) Pieces);

getters! {
    PyPieces {
        lengths<'py>: PyResult<Numbers<'py>> = |own, py| places(py, own.0.lengths());
        lost<'py>: PyResult<Numbers<'py>> = |own, py| places(py, own.0.lost());
    }

    #[new]
    #[pyo3(signature = (lengths, gaps=None, lost=None))]
    fn new(
        lengths: PyReadonlyArray1<'_, i64>,
        gaps: Option<PyReadonlyArray1<'_, i64>>,
        lost: Option<PyReadonlyArray1<'_, i64>>,
    ) -> PyResult<Self> {
        let lengths = counts("lengths", &lengths)?;
        let lost = match lost {
            Some(lost) => counts("lost", &lost)?,
            None => try_filled(WHAT, 0, lengths.len())?,
        };
        let gaps = gaps.map_or(Ok(Vec::new()), |gaps| counts("gaps", &gaps))?;
        let rows = gaps.chunks_exact(2);
        if !rows.remainder().is_empty() {
            return Err(InputError::new_err("`gaps` must be rows of two whole numbers"));
        }
        let rows = try_collect(WHAT, rows.map(|row| [row[0], row[1]]))?;
        Ok(Self(Pieces::new(lengths, rows, lost)?))
    }

    #[staticmethod]
    fn joined(parts: Vec<PyRef<'_, Self>>) -> PyResult<Self> {
        Ok(Self(Pieces::joined(parts.iter().map(|part| &part.0))?))
    }

    #[getter]
    fn gaps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        places(py, self.0.gaps().as_flattened())?.reshape([self.0.gaps().len(), 2])
    }

    fn starts<'py>(&self, py: Python<'py>) -> PyResult<Numbers<'py>> {
        places(py, &self.0.starts()?)
    }

    fn runs<'py>(&self, py: Python<'py>) -> PyResult<Numbers<'py>> {
        places(py, &self.0.runs()?)
    }

    fn places<'py>(&self, py: Python<'py>) -> PyResult<Numbers<'py>> {
        places(py, &self.0.places()?)
    }

    fn skipped<'py>(&self, py: Python<'py>) -> PyResult<Numbers<'py>> {
        places(py, &self.0.skipped()?)
    }

    fn chosen(&self, kept: PyReadonlyArray1<'_, bool>) -> PyResult<Self> {
        let kept = kept.as_slice().map_err(|_| InputError::new_err("`kept` must be C-contiguous"))?;
        Ok(Self(self.0.chosen(kept)?))
    }
}
