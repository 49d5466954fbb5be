//! NumPy arrays to slices and back. The package's gate has made them C-contiguous doubles.

use numpy::{Element, PyArray1, PyArray2, PyReadonlyArray, PyReadonlyArray2, PyUntypedArrayMethods, ndarray};
use pyo3::prelude::*;
use pyo3::types::PyList;

use super::arrays::{Values, array};
use super::error::{InputError, ShapeError};
use crate::Key;
use crate::fuse::Fusion;
use crate::matrix::MatrixView;
use crate::memory::{try_copy, try_push, try_room};

/// A read-only view of a contiguous array of doubles.
pub(super) fn slice<'a, D: ndarray::Dimension>(
    name: &str,
    array: &'a PyReadonlyArray<'_, f64, D>,
) -> PyResult<&'a [f64]> {
    // `as_slice` alone takes the order of Fortran as well
    let rows_first = array.is_c_contiguous().then(|| array.as_slice().ok()).flatten();
    rows_first.ok_or_else(|| ShapeError::new_err(format!("`{name}` must be C-contiguous")))
}

/// The same of a matrix, with its sizes.
pub(super) fn view<'a>(name: &str, array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<MatrixView<'a>> {
    let (rows, columns) = array.as_array().dim();
    Ok(MatrixView::new(slice(name, array)?, rows, columns)?)
}

/// Whole numbers, and rows of numbers, by their names.
pub(super) type Tables<'py> = (Vec<(&'static str, usize)>, Vec<(&'static str, Bound<'py, PyArray1<f64>>)>);

/// The tables of a controller in C.
pub(super) fn named<'py>(
    py: Python<'py>,
    sizes: Vec<(&'static str, usize)>,
    tables: Vec<(&'static str, Vec<f64>)>,
) -> PyResult<Tables<'py>> {
    let mut made = Vec::new();
    for (name, values) in tables {
        try_push("the tables of a controller", &mut made, (name, array1(py, values)?))?;
    }
    Ok((sizes, made))
}

/// 32 bytes as a key.
pub(super) fn key(bytes: &[u8]) -> PyResult<Key> {
    let found = bytes.len();
    bytes.try_into().map(Key).map_err(|_| InputError::new_err(format!("`key` must have 32 bytes, got {found}")))
}

/// A `rows x cols` array from its entries.
pub(super) fn array2(py: Python<'_>, values: Vec<f64>, rows: usize, cols: usize) -> PyResult<Bound<'_, PyArray2<f64>>> {
    array(py, values, [rows, cols])
}

/// A one-dimensional array.
pub(super) fn array1<T>(py: Python<'_>, values: Vec<T>) -> PyResult<Bound<'_, PyArray1<T>>>
where
    T: Element,
    Values: From<Vec<T>>,
{
    let length = values.len();
    array(py, values, [length])
}

/// A fusing method by its name.
pub(super) fn method(name: &str) -> PyResult<Fusion> {
    let found = Fusion::NAMED.into_iter().find(|(known, _)| *known == name);
    found.map(|(_, method)| method).ok_or_else(|| {
        let known = Fusion::NAMED.map(|(known, _)| format!("'{known}'")).join(", ");
        InputError::new_err(format!("`method` must be one of {known}, got '{name}'"))
    })
}

/// A target's entries, checked against the number of entries of a realization.
pub(super) fn target<'a>(array: &'a PyReadonlyArray2<'_, f64>, len: usize) -> PyResult<&'a [f64]> {
    let values = slice("target", array)?;
    if values.len() != len {
        return Err(ShapeError::new_err(format!("`target` must have {len} entries, got {}", values.len())));
    }
    Ok(values)
}

/// Strictly increasing prefix sizes between 1 and `max`.
pub(super) fn sizes(sizes: &Bound<'_, PyList>, max: usize) -> PyResult<Vec<usize>> {
    let mut given = try_room("the sizes", sizes.len())?;
    for size in sizes {
        given.push(size.extract()?);
    }
    let sizes: Vec<usize> = given;
    let rising = sizes.windows(2).all(|pair| pair[0] < pair[1]);
    if !rising || sizes.first() == Some(&0) || sizes.last().is_some_and(|&last| last > max) {
        return Err(InputError::new_err(format!("`sizes` must increase strictly from at least 1 to at most {max}")));
    }
    Ok(sizes)
}

/// The law of `values`, one line per row.
pub(super) fn law(values: &PyReadonlyArray2<'_, f64>) -> PyResult<crate::Law> {
    let (lines, length) = values.as_array().dim();
    Ok(crate::Law::new(try_copy("a law", slice("target", values)?)?, lines, length)?)
}

/// `#[pymethods]` of a class: attributes `name: type = |own| expression;`, then its other methods.
macro_rules! getters {
    ($class:ident {
        $($(#[$about:meta])* $name:ident $(<$life:lifetime>)?: $kind:ty = |$own:ident $(, $py:ident)?| $value:expr;)*
    } $($rest:tt)*) => {
        #[pymethods]
        impl $class {
            $($(#[$about])*
            #[getter]
            fn $name $(<$life>)? (&self $(, $py: Python<$life>)?) -> $kind {
                let $own = self;
                $value
            })*

            $($rest)*
        }
    };
}

pub(super) use getters;
