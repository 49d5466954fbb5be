//! State files: named one-dimensional arrays to and from the disk.

use std::path::PathBuf;

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::error::ShapeError;
use super::run::run;
use crate::memory::try_room;
use crate::storage::{self, Section, Tag, Values};

/// Elementary operations per byte: hashing, twice, and the disk.
const PER_BYTE: f64 = 20.0;

/// An array that can be a section.
#[derive(FromPyObject)]
pub(super) enum Array<'py> {
    Bytes(PyReadonlyArray1<'py, u8>),
    Integers(PyReadonlyArray1<'py, u64>),
    Reals(PyReadonlyArray1<'py, f64>),
}

/// Saves `sections` as the next generation of the state file at `path`; returns its number.
#[pyfunction]
pub(super) fn storage_save(
    py: Python<'_>,
    path: PathBuf,
    kind: &str,
    sections: Vec<(String, Array<'_>)>,
) -> PyResult<u64> {
    let kind = Tag::new(kind)?;
    let mut checked = try_room("the sections", sections.len())?;
    for (name, array) in &sections {
        checked.push(Section { tag: Tag::new(name)?, values: values(array)? });
    }
    let sections: Vec<Section<'_>> = checked;
    let bytes: usize = sections
        .iter()
        .map(|section| match &section.values {
            Values::Bytes(values) => values.len(),
            Values::Integers(values) => values.len() * 8,
            Values::Reals(values) => values.len() * 8,
        })
        .sum();
    run(py, PER_BYTE * bytes as f64, |stop| storage::save(&path, kind, &sections, stop))
}

fn values<'a>(array: &'a Array<'_>) -> PyResult<Values<'a>> {
    let contiguous = |_| ShapeError::new_err("`sections` must be C-contiguous");
    Ok(match array {
        Array::Bytes(values) => Values::Bytes(values.as_slice().map_err(contiguous)?.into()),
        Array::Integers(values) => Values::Integers(values.as_slice().map_err(contiguous)?.into()),
        Array::Reals(values) => Values::Reals(values.as_slice().map_err(contiguous)?.into()),
    })
}

/// The state of this `kind` at `path`: `(generation, sections, why the previous generation stands in)`.
#[pyfunction]
pub(super) fn storage_load<'py>(
    py: Python<'py>,
    path: PathBuf,
    kind: &str,
) -> PyResult<(u64, Bound<'py, PyDict>, Option<String>)> {
    let kind = Tag::new(kind)?;
    let bytes = std::fs::metadata(&path).map_or(0, |metadata| metadata.len());
    let loaded = run(py, PER_BYTE * bytes as f64, |stop| storage::load(&path, kind, stop))?;
    let sections = PyDict::new(py);
    for section in loaded.container.sections {
        let name = section.tag.to_string();
        match section.values {
            Values::Bytes(values) => sections.set_item(name, PyArray1::from_vec(py, values.into_owned()))?,
            Values::Integers(values) => sections.set_item(name, PyArray1::from_vec(py, values.into_owned()))?,
            Values::Reals(values) => sections.set_item(name, PyArray1::from_vec(py, values.into_owned()))?,
        }
    }
    Ok((loaded.container.generation, sections, loaded.recovered.map(|why| why.to_string())))
}
