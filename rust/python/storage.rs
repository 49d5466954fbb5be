//! State files: named one-dimensional arrays to and from the disk.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{PyArrayDescrMethods, PyReadonlyArray1, PyUntypedArray, PyUntypedArrayMethods, dtype};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList, PyString};

use super::arrays::{bytes as bytes_of, mapping, text};
use super::convert::array1;
use super::error::{InputTypeError, ShapeError};
use super::run::run;
use crate::Error;
use crate::memory::{covered, try_room};
use crate::storage::{self, Container, Lock, Section, Values};

/// Elementary operations per byte, roughly: two hashes and the disk.
const PER_BYTE: f64 = 20.0;

const SECTIONS: &str = "the sections";
/// Most bytes that `rust-numpy` takes to note a borrowed array: an entry of each of two tables, which double, and its
/// key.
const PER_BORROW: u128 = 1024;

/// An array that can be a section.
pub(super) enum Array<'py> {
    Bytes(PyReadonlyArray1<'py, u8>),
    Integers(PyReadonlyArray1<'py, u64>),
    Reals(PyReadonlyArray1<'py, f64>),
}

/// Chosen by the element type. Trying one type after the other would make NumPy format error messages in Python code,
/// where signal handlers run and their exceptions would be lost.
impl<'py> FromPyObject<'_, 'py> for Array<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let py = object.py();
        if let Some(array) = object.cast::<PyUntypedArray>().ok().filter(|array| array.ndim() == 1) {
            let found = array.dtype();
            if found.is_equiv_to(&dtype::<u8>(py)) {
                return Ok(Self::Bytes(object.extract()?));
            } else if found.is_equiv_to(&dtype::<u64>(py)) {
                return Ok(Self::Integers(object.extract()?));
            } else if found.is_equiv_to(&dtype::<f64>(py)) {
                return Ok(Self::Reals(object.extract()?));
            }
        }
        Err(InputTypeError::new_err("`sections` must be one-dimensional arrays of uint8, uint64 or float64"))
    }
}

/// The sections of a state: a list of names and arrays.
pub(super) struct Given<'py>(Vec<(Bound<'py, PyString>, Array<'py>)>);

impl<'py> FromPyObject<'_, 'py> for Given<'py> {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let list = object.cast::<PyList>()?;
        let mut given = try_room(SECTIONS, list.len())?;
        // the table of borrowed arrays grows with each, and aborts where it cannot
        covered(SECTIONS, PER_BORROW * list.len() as u128, || {
            list.iter().try_for_each(|pair| pair.extract().map(|pair| given.push(pair)))
        })??;
        Ok(Self(given))
    }
}

/// A writer's lock on the state file at `path`, held until `release`, until this object is freed, or until the process
/// ends.
#[pyclass(frozen, weakref, module = "stochens_rs._core")]
pub(super) struct StateLock(Mutex<Option<Lock>>);

#[pymethods]
impl StateLock {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        Ok(Self(Mutex::new(Some(storage::lock(&path)?))))
    }

    /// Releases the lock. In a forked child, only the child's copy of it; if a save was running at the fork, nothing.
    fn release(&self) {
        if let Ok(mut held) = self.0.try_lock() {
            held.take();
        }
    }
}

/// Saves `sections` as the next generation of the state file at `path`; returns its number. `held`: a lock on that
/// file.
#[pyfunction]
#[pyo3(signature = (path, kind, sections, held=None))]
pub(super) fn storage_save(
    py: Python<'_>,
    path: PathBuf,
    kind: &str,
    sections: Given<'_>,
    held: Option<&Bound<'_, StateLock>>,
) -> PyResult<u64> {
    let (sections, bytes) = checked(&sections)?;
    let held = held.map(Bound::get);
    run(py, PER_BYTE * bytes, |stop| match held {
        None => storage::save(&path, kind, &sections, stop),
        Some(held) => {
            let lock = held.0.lock().unwrap_or_else(PoisonError::into_inner);
            let lock = lock.as_ref().ok_or_else(|| Error::Locked { path: path.clone() })?;
            storage::save_held(lock, &path, kind, &sections, stop)
        }
    })
}

/// The sections as the core takes them, and their bytes.
fn checked<'a>(Given(given): &'a Given<'_>) -> PyResult<(Vec<Section<'a>>, f64)> {
    let mut sections = try_room("the sections", given.len())?;
    for (name, array) in given {
        sections.push(Section { name: name.to_str()?.into(), values: values(array)? });
    }
    let bytes: usize = sections
        .iter()
        .map(|section: &Section<'_>| match &section.values {
            Values::Bytes(values) => values.len(),
            Values::Integers(values) => values.len() * 8,
            Values::Reals(values) => values.len() * 8,
        })
        .sum();
    Ok((sections, bytes as f64))
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
    let bytes = std::fs::metadata(&path).map_or(0, |metadata| metadata.len());
    let loaded = run(py, PER_BYTE * bytes as f64, |stop| storage::load(&path, kind, stop))?;
    let (generation, sections) = arrays(py, loaded.container)?;
    Ok((generation, sections, loaded.recovered.map(|why| why.to_string())))
}

/// The bytes of a state file with these contents.
#[pyfunction]
pub(super) fn storage_encode<'py>(
    py: Python<'py>,
    kind: &str,
    generation: u64,
    sections: Given<'_>,
) -> PyResult<Bound<'py, PyBytes>> {
    let (sections, bytes) = checked(&sections)?;
    let encoded = run(py, PER_BYTE * bytes, |stop| storage::encode(kind, generation, &sections, stop))?;
    bytes_of(py, &encoded)
}

/// The contents of a state file of this `kind` with these bytes: `(generation, sections)`; `source` is its name in
/// messages.
#[pyfunction]
pub(super) fn storage_decode<'py>(
    py: Python<'py>,
    source: PathBuf,
    bytes: &[u8],
    kind: &str,
) -> PyResult<(u64, Bound<'py, PyDict>)> {
    let found = run(py, PER_BYTE * bytes.len() as f64, |stop| storage::decode(&source, bytes, kind, stop))?;
    arrays(py, found)
}

/// The values of a section.
pub(super) fn array_of<'py>(py: Python<'py>, values: Values<'static>) -> PyResult<Bound<'py, PyAny>> {
    Ok(match values {
        Values::Bytes(values) => array1(py, values.into_owned())?.into_any(),
        Values::Integers(values) => array1(py, values.into_owned())?.into_any(),
        Values::Reals(values) => array1(py, values.into_owned())?.into_any(),
    })
}

/// Generation and arrays, by their names.
fn arrays(py: Python<'_>, found: Container) -> PyResult<(u64, Bound<'_, PyDict>)> {
    let sections = mapping(py)?;
    for section in found.sections {
        sections.set_item(text(py, &section.name)?, array_of(py, section.values)?)?;
    }
    Ok((found.generation, sections))
}
