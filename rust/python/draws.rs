//! Singleton realizations as a Python object that shares its indices with NumPy.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::arrays::{array, over};
use super::convert::{array1, array2, getters, key, law, slice};
use super::error::{InputError, ShapeError};
use super::run::run;
use crate::memory::{checked_len, try_collect, try_copy};
use crate::sample::{Indices, multinomial_counts, sample, systematic_counts, with_indices};
use crate::{Scheme, Singletons};

/// Realizations of a law as indices, `size x lines`; immutable.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct Draws {
    pub(super) inner: Singletons,
}

pub(super) fn scheme(name: &str) -> PyResult<Scheme> {
    match name {
        "iid" => Ok(Scheme::Iid),
        "systematic" => Ok(Scheme::Systematic),
        other => Err(InputError::new_err(format!("`scheme` must be 'iid' or 'systematic', got '{other}'"))),
    }
}

getters! {
    Draws {
        /// Number of realizations.
        size: usize = |own| own.inner.size();
        /// Independent indices of a realization.
        lines: usize = |own| own.inner.law().lines();
        /// Entries of a line.
        length: usize = |own| own.inner.law().length();
        /// Bytes of the indices of these realizations.
        nbytes: usize = |own| own.inner.size() * own.inner.law().lines() * own.inner.indices().width();
    }

    /// Draws `size` realizations with mean `values` (lines, length).
    #[staticmethod]
    fn sample(
        py: Python<'_>,
        values: PyReadonlyArray2<'_, f64>,
        size: usize,
        scheme: &str,
        key: &[u8],
        threads: usize,
    ) -> PyResult<Self> {
        let (law, scheme, key) = (Arc::new(law(&values)?), self::scheme(scheme)?, self::key(key)?);
        // the draws, and one alias table per line
        let cost = 2.0 * size as f64 * law.lines() as f64 + 30.0 * law.values().len() as f64;
        let inner = run(py, cost, |stop| sample(&law, size, scheme, &key, threads, stop))?;
        Ok(Self { inner })
    }

    /// Realizations with given indices (size, lines) of the law with mean `values` (lines, length).
    #[staticmethod]
    fn from_indices(values: PyReadonlyArray2<'_, f64>, indices: PyReadonlyArray2<'_, u32>) -> PyResult<Self> {
        let law = law(&values)?;
        let (size, lines) = indices.as_array().dim();
        if lines != law.lines() {
            return Err(ShapeError::new_err(format!("`indices` must have {} columns, got {lines}", law.lines())));
        }
        let mut narrow = Indices::zeros(law.length(), checked_len("the indices", size, lines)?)?;
        let given = indices.as_array();
        if let Some(found) = given.iter().find(|&&r| r as usize >= law.length()) {
            return Err(InputError::new_err(format!("`indices` must be below {}, got {found}", law.length())));
        }
        with_indices!(&mut narrow, out => {
            use crate::sample::Index as _;
            for (to, &from) in out.iter_mut().zip(given.iter()) {
                *to = crate::sample::Index::new(from);
                debug_assert_eq!(to.get(), from as usize);
            }
        });
        Ok(Self { inner: Singletons::new(law.into(), narrow, size)? })
    }

    /// The mean of the law (lines, length).
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array2(py, try_copy("the values", self.inner.law().values())?, self.lines(), self.length())
    }

    /// The value of a realization where it hits an entry (lines, length); zero off the support.
    fn atoms<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array2(py, self.inner.law().atoms()?, self.lines(), self.length())
    }

    /// The 1-norm of every line.
    fn gamma<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        array1(py, try_copy("the 1-norms", self.inner.law().gamma())?)
    }

    /// The indices (size, lines), a read-only view that keeps this object alive.
    fn indices<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let this = slf.get();
        let shape = (this.size(), this.lines());
        with_indices!(&**this.inner.indices(), indices => {
            let values = &indices[..shape.0 * shape.1];
            // SAFETY: the values lie in the `Arc<Indices>` that `slf` owns. `slf` is the array's base object, so it
            // lives as long; the class is frozen and nothing mutates or reallocates the indices; NumPy may not write.
            #[allow(unsafe_code, reason = "sharing the indices with NumPy without a copy")]
            let array = unsafe { over(values.as_ptr(), shape.into(), slf.clone().into_any(), false)? };
            Ok(array.into_any())
        })
    }

    /// The first `size` realizations, sharing the indices.
    fn prefix(&self, size: usize) -> Self {
        Self { inner: self.inner.prefix(size) }
    }

    /// Hits of every entry (lines, length).
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i64>>> {
        let cost = self.inner.size() as f64 * self.lines() as f64;
        let counts = run(py, cost, |stop| self.inner.counts(stop))?;
        counts_array(py, counts, self.lines(), self.length())
    }

    /// `sum_i w_i E_i` (lines, length).
    fn combine<'py>(
        &self,
        py: Python<'py>,
        weights: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let weights = slice("weights", &weights)?;
        if weights.len() != self.size() {
            return Err(ShapeError::new_err(format!(
                "`weights` must have {} entries, got {}",
                self.size(),
                weights.len()
            )));
        }
        let cost = self.inner.size() as f64 * self.lines() as f64;
        let sum = run(py, cost, |stop| self.inner.combine(weights, stop))?;
        array2(py, sum, self.lines(), self.length())
    }
}

fn counts_array(py: Python<'_>, counts: Vec<u64>, lines: usize, length: usize) -> PyResult<Bound<'_, PyArray2<i64>>> {
    // at most 2^53 realizations: every count fits
    let counts: Vec<i64> = try_collect("the counts", counts.into_iter().map(|c| c as i64))?;
    array(py, counts, [lines, length])
}

/// Hits of every entry (lines, length) in `size` realizations that are not drawn one by one.
#[pyfunction]
pub(super) fn sample_counts<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f64>,
    size: u64,
    scheme: &str,
    key: &[u8],
) -> PyResult<Bound<'py, PyArray2<i64>>> {
    let (law, scheme, key) = (law(&values)?, self::scheme(scheme)?, self::key(key)?);
    let counts = run(py, 200.0 * law.values().len() as f64, |stop| match scheme {
        Scheme::Iid => multinomial_counts(&law, size, &key, stop),
        Scheme::Systematic => systematic_counts(&law, size, &key),
    })?;
    counts_array(py, counts, law.lines(), law.length())
}
