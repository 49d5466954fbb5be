//! Results as arrays and bytes. Where memory runs out there is an exception, not a panic.

use std::ffi::c_void;
use std::ptr::null_mut;

use numpy::ndarray::{Dim, Dimension, IntoDimension};
use numpy::npyffi::{NPY_ARRAY_WRITEABLE, NpyTypes, PY_ARRAY_API, get_type_object, npy_intp};
use numpy::{Complex64, Element, PyArray, PyArrayDescrMethods};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyString};

use super::error::ShapeError;

/// The memory of an array: its base object.
#[pyclass(frozen, module = "stochens_rs._core")]
struct Memory {
    _values: Values,
}

/// Values of any type that arrays have.
#[expect(dead_code, reason = "kept until the array is freed")]
pub(super) enum Values {
    Bytes(Vec<u8>),
    Signs(Vec<i8>),
    Counts(Vec<i64>),
    Integers(Vec<u64>),
    Reals(Vec<f64>),
    Complexes(Vec<Complex64>),
}

macro_rules! values {
    ($($kind:ident: $element:ty),*) => { $(
        impl From<Vec<$element>> for Values {
            fn from(values: Vec<$element>) -> Self {
                Self::$kind(values)
            }
        }
    )* };
}
values!(Bytes: u8, Signs: i8, Counts: i64, Integers: u64, Reals: f64, Complexes: Complex64);

/// An array of this shape that takes over the values, row by row.
pub(super) fn array<T, const N: usize>(
    py: Python<'_>,
    values: Vec<T>,
    shape: [usize; N],
) -> PyResult<Bound<'_, PyArray<T, Dim<[usize; N]>>>>
where
    T: Element,
    Values: From<Vec<T>>,
    [usize; N]: IntoDimension<Dim = Dim<[usize; N]>>,
    Dim<[usize; N]>: Dimension,
{
    if shape.iter().try_fold(1, |all: usize, &one| all.checked_mul(one)) != Some(values.len()) {
        return Err(ShapeError::new_err(format!("a result of {} entries does not have shape {shape:?}", values.len())));
    }
    let data = values.as_ptr();
    let base = Bound::new(py, Memory { _values: values.into() })?.into_any();
    // SAFETY: `data` points to as many values as the shape has, which `base` keeps where they are until it is freed; no
    // other array shares them.
    #[allow(unsafe_code, reason = "taking over memory without a copy")]
    unsafe {
        over(data, shape, base, true)
    }
}

/// An array over memory that `base` owns.
///
/// # Safety
/// `data` must point to as many values as the shape has, row by row, for as long as `base` lives; nothing else may
/// change them, or read them if the array is `writeable`.
#[allow(unsafe_code, reason = "NumPy's own interface is the one that reports a lack of memory")]
pub(super) unsafe fn over<T, const N: usize>(
    data: *const T,
    shape: [usize; N],
    base: Bound<'_, PyAny>,
    writeable: bool,
) -> PyResult<Bound<'_, PyArray<T, Dim<[usize; N]>>>>
where
    T: Element,
    Dim<[usize; N]>: Dimension,
{
    let py = base.py();
    let mut lengths = shape.map(|length| length as npy_intp);
    let flags = if writeable { NPY_ARRAY_WRITEABLE } else { 0 };
    let (strides, none) = (null_mut(), null_mut());
    // SAFETY: the type is that of arrays, the reference to the element type is given away, there are N lengths, and
    // NumPy derives the strides.
    unsafe {
        let class = get_type_object(py, NpyTypes::PyArray_Type);
        let element = T::get_dtype(py).into_dtype_ptr();
        let (lengths, data) = (lengths.as_mut_ptr(), data.cast_mut().cast::<c_void>());
        let made = PY_ARRAY_API.PyArray_NewFromDescr(py, class, element, N as i32, lengths, strides, data, flags, none);
        let array = Bound::from_owned_ptr_or_err(py, made)?;
        // the reference to the base is given away, also if this fails
        if PY_ARRAY_API.PyArray_SetBaseObject(py, array.as_ptr().cast(), base.into_ptr()) < 0 {
            return Err(PyErr::fetch(py));
        }
        Ok(array.cast_into_unchecked())
    }
}

/// Bytes for Python.
pub(super) fn bytes<'py>(py: Python<'py>, from: &[u8]) -> PyResult<Bound<'py, PyBytes>> {
    PyBytes::new_with(py, from.len(), |to| {
        to.copy_from_slice(from);
        Ok(())
    })
}

/// A text for Python.
pub(super) fn text<'py>(py: Python<'py>, from: &str) -> PyResult<Bound<'py, PyString>> {
    PyString::from_bytes(py, from.as_bytes())
}

/// An empty mapping for Python.
pub(super) fn mapping(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    Ok(py.get_type::<PyDict>().call0()?.cast_into()?)
}
