//! The law of a singleton realization: independent lines with their 1-norms and atoms.

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_collect};

/// Largest number of entries in a line: cell and coin of the alias table share one 64-bit word.
const MAX_LENGTH: usize = 1 << 31;

/// The lines of a vector (one), or of a matrix (its columns, or its rows), each a distribution over its entries.
///
/// Entry `i` of line `j` is stored at `j * length + i` in every array of this crate that belongs to a law.
#[derive(Debug, Clone, PartialEq)]
pub struct Law {
    lines: usize,
    length: usize,
    values: Vec<f64>,
    gamma: Vec<f64>,
}

impl Law {
    /// The law whose realizations have mean `values` (`lines * length` entries, line by line).
    ///
    /// # Errors
    /// [`Error::Shape`] if the length does not fit, [`Error::NonFinite`] for NaN, infinities, or a 1-norm that
    /// overflows.
    pub fn new(values: Vec<f64>, lines: usize, length: usize) -> Result<Self> {
        if lines == 0 || length == 0 || length > MAX_LENGTH || checked_len("a law", lines, length)? != values.len() {
            return Err(Error::Shape {
                name: "values",
                expected: format!("{lines} lines of {length} entries (1 to 2^31)"),
                found: format!("{} entries", values.len()),
            });
        }
        require_finite("values", &values)?;
        // g_j = ||line j||_1
        let norm = |line: &[f64]| line.iter().map(|v| v.abs()).sum();
        let gamma: Vec<f64> = try_collect("a law", values.chunks_exact(length).map(norm))?;
        if let Some(index) = gamma.iter().position(|g| !g.is_finite()) {
            return Err(Error::NonFinite { name: "values", what: "1-norm", index: index * length });
        }
        Ok(Self { lines, length, values, gamma })
    }

    /// How many independent indices a realization has.
    pub fn lines(&self) -> usize {
        self.lines
    }

    /// How many entries a line has.
    pub fn length(&self) -> usize {
        self.length
    }

    /// The mean, line by line.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// `g_j`, the 1-norm of each line.
    pub fn gamma(&self) -> &[f64] {
        &self.gamma
    }

    /// Line `j` of the mean.
    pub fn line(&self, j: usize) -> &[f64] {
        &self.values[j * self.length..(j + 1) * self.length]
    }

    /// The sign of every entry: `1`, `-1`, or `0` off the support.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn signs(&self) -> Result<Vec<f64>> {
        try_collect("the signs", self.values.iter().map(|&v| if v == 0.0 { 0.0 } else { v.signum() }))
    }

    /// The value `g_j sign(w_i)` a realization has where it hits entry `(j, i)`; 0 off the support.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn atoms(&self) -> Result<Vec<f64>> {
        let mut atoms = self.signs()?;
        for (line, g) in atoms.chunks_exact_mut(self.length).zip(&self.gamma) {
            line.iter_mut().for_each(|a| *a *= g);
        }
        Ok(atoms)
    }

    /// `sum_j g_j^2`, the squared Frobenius norm that every realization has.
    pub fn squared_norm(&self) -> f64 {
        self.gamma.iter().map(|g| g * g).sum()
    }
}
