//! Realizations without structure: rows of an `N x dimension` array.

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_collect, try_zeros};

/// A borrowed sample of `size` realizations with `dim` entries each, one after the other.
#[derive(Debug, Clone, Copy)]
pub struct Dense<'a> {
    values: &'a [f64],
    size: usize,
    dim: usize,
}

impl<'a> Dense<'a> {
    /// # Errors
    /// [`Error::Shape`] if the length is not `size * dim` or one of them is zero, [`Error::NonFinite`] for NaN,
    /// infinity.
    pub fn new(values: &'a [f64], size: usize, dim: usize) -> Result<Self> {
        if size == 0 || dim == 0 || checked_len("the samples", size, dim)? != values.len() {
            return Err(Error::Shape {
                name: "samples",
                expected: format!("{size} x {dim} entries, at least one"),
                found: format!("{} entries", values.len()),
            });
        }
        require_finite("samples", values)?;
        Ok(Self { values, size, dim })
    }

    /// [`Self::new`] without the check for NaN and infinity, for a caller that has made it.
    ///
    /// # Errors
    /// [`Error::Shape`] if the length is not `size * dim` or one of them is zero.
    #[cfg(feature = "python")]
    pub(crate) fn of_finite(values: &'a [f64], size: usize, dim: usize) -> Result<Self> {
        let first = Self::new(values.get(..dim).unwrap_or_default(), 1, dim)?;
        if size == 0 || checked_len("the samples", size, dim)? != values.len() {
            return Self::new(values, size, dim); // fails with the message
        }
        Ok(Self { values, size, ..first })
    }

    /// How many realizations there are.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Entries of a realization.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// All entries.
    pub fn values(&self) -> &'a [f64] {
        self.values
    }

    /// Realization `i`.
    pub fn row(&self, i: usize) -> &'a [f64] {
        &self.values[i * self.dim..(i + 1) * self.dim]
    }

    /// The first `size` realizations.
    #[must_use]
    pub fn prefix(&self, size: usize) -> Self {
        let size = size.min(self.size);
        Self { values: &self.values[..size * self.dim], size, dim: self.dim }
    }

    /// `sum_i w_i E_i`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn combine(&self, weights: &[f64]) -> Result<Vec<f64>> {
        let mut sum = try_zeros("a combination", self.dim)?;
        for (i, &w) in weights.iter().enumerate().take(self.size) {
            sum.iter_mut().zip(self.row(i)).for_each(|(s, e)| *s += w * e);
        }
        Ok(sum)
    }

    /// `<r, E_i>` for every realization.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn correlate(&self, r: &[f64]) -> Result<Vec<f64>> {
        let product = |i| self.row(i).iter().zip(r).map(|(e, r)| e * r).sum();
        try_collect("the inner products", (0..self.size).map(product))
    }
}
