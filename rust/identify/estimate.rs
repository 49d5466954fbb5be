//! The estimate of a model `Theta = [A B c]` from the triangle of its data, in whatever way it is made.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;

use super::least_squares::{Fitted, WHAT, fit, reduced};
use super::triangle::triangle;

/// Measured pairs as one triangle, and what is known beforehand.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    /// `R` of `[Z Y]`, row by row: states and inputs (and 1), states one step later.
    pub triangle: &'a [f64],
    /// The number of pairs N.
    pub size: usize,
    /// The number of states n.
    pub n: usize,
    /// The number of inputs m.
    pub m: usize,
    /// Whether there is a column of 1 behind them, for an offset c.
    pub offset: bool,
    /// The known entries (n, d) of Theta, NaN where an entry is to be estimated.
    pub known: Option<&'a [f64]>,
}

/// The model of [`Data`], and least squares of its rows.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Estimate {
    /// Theta (n, d), least squares.
    pub model: Vec<f64>,
    /// Least squares of all rows at once, or of each where their known columns differ.
    pub blocks: Vec<Arc<Fitted>>,
    /// The number of states.
    pub n: usize,
    pub(crate) m: usize,
    pub(crate) d: usize,
    /// The number of pairs.
    pub size: usize,
    /// `R` of `[Z Y]`, see [`Data`].
    pub triangle: Vec<f64>,
    pub(super) known: Option<Vec<f64>>,
}

impl Estimate {
    /// From pairs of `x+ = A x + B u + w`: states (N, n), inputs (N, m), and the states one step later (N, n).
    /// [`Estimate::new`] takes data that come as a triangle, known entries, and an offset.
    ///
    /// # Errors
    /// As [`Estimate::new`].
    pub fn from_pairs<'a>(
        x: impl Into<MatrixView<'a>>,
        u: impl Into<MatrixView<'a>>,
        next: impl Into<MatrixView<'a>>,
        threads: usize,
        stop: &Stop,
    ) -> Result<Self> {
        let (x, u, next) = (x.into(), u.into(), next.into());
        let ((size, n), m) = (x.shape(), u.shape().1);
        let (x, u, next) = (x.sized("x", size, n)?, u.sized("u", size, m)?, next.sized("next", size, n)?);
        let width = 2 * n + m;
        let mut rows = try_room(WHAT, checked_len(WHAT, size, width)?)?;
        for k in 0..size {
            [(&x, n), (&u, m), (&next, n)].iter().for_each(|(of, d)| rows.extend_from_slice(&of[k * d..(k + 1) * d]));
        }
        let triangle = triangle(&rows, width, threads, stop)?;
        Self::new(Data { triangle: &triangle, size, n, m, offset: false, known: None }, stop)
    }

    /// Theta (n, d): `[A B]`, with the offset behind it if there is one.
    #[must_use]
    pub fn theta(&self) -> MatrixView<'_> {
        MatrixView::of(&self.model, self.d)
    }

    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`], [`Error::Numerical`], [`Error::Memory`],
    /// [`Error::Interrupted`].
    pub fn new(of: Data<'_>, stop: &Stop) -> Result<Self> {
        let Data { n, m, size, .. } = of;
        let d = n + m + usize::from(of.offset);
        let (width, entries) = (d + n, checked_len(WHAT, n, d)?);
        let shaped = |name, values: &[f64], expected: usize| {
            let found = values.len().to_string();
            let wrong = || Error::Shape { name, expected: format!("{expected} entries"), found };
            if values.len() == expected { Ok(()) } else { Err(wrong()) }
        };
        shaped("triangle", of.triangle, checked_len(WHAT, width, width)?)?;
        of.known.map_or(Ok(()), |known| shaped("known", known, entries))?;
        if n == 0 || m == 0 {
            let (expected, found) = ("at least one state and one input".into(), format!("n={n}, m={m}"));
            return Err(Error::Shape { name: "triangle", expected, found });
        }
        let triangle = reduced(of.triangle, width, 1, stop)?;
        let known = of.known.map(|known| try_copy(WHAT, known)).transpose()?;
        let mut made = Self { model: Vec::new(), blocks: Vec::new(), n, m, d, triangle, known, size };
        made.blocks = made.least_squares(false, stop)?;
        made.model = made.assembled()?;
        Ok(made)
    }

    /// Least squares for all rows at once, or row by row.
    ///
    /// # Errors
    /// As [`Estimate::new`].
    pub fn least_squares(&self, by_rows: bool, stop: &Stop) -> Result<Vec<Arc<Fitted>>> {
        let (n, d, width) = (self.n, self.d, self.d + self.n);
        let free = |i: usize, j: usize| self.known.as_ref().is_none_or(|known| known[i * d + j].is_nan());
        let alike = (1..n).all(|i| (0..d).all(|j| free(i, j) == free(0, j)));
        if self.known.is_none() && !by_rows {
            return Ok(Vec::from([Arc::new(fit(&self.triangle, width, d, self.size, 1, stop)?)]));
        }
        let together = alike && !by_rows;
        let sets = if together { 1 } else { n };
        let mut found = try_room(WHAT, sets)?;
        for set in 0..sets {
            let rows = try_collect(WHAT, if together { 0..n } else { set..set + 1 })?;
            let columns = try_collect(WHAT, (0..d).filter(|j| free(set, *j)))?;
            found.push(Arc::new(self.restricted(rows, columns, stop)?));
        }
        Ok(found)
    }

    /// Least squares of `[Z_columns, (Y - Z known')_rows]`, which is `[Z Y]` times a matrix: that of the triangle is
    /// enough.
    fn restricted(&self, rows: Vec<usize>, columns: Vec<usize>, stop: &Stop) -> Result<Fitted> {
        let (d, narrow) = (self.d, columns.len() + rows.len());
        let mut some = try_room(WHAT, checked_len(WHAT, self.d + self.n, narrow)?)?;
        for row in self.triangle.chunks_exact(self.d + self.n) {
            some.extend(columns.iter().map(|&j| row[j]));
            some.extend(rows.iter().map(|&i| {
                let known = self.known.iter().flat_map(|known| &known[i * d..(i + 1) * d]);
                let told = known.zip(row).filter(|(known, _)| !known.is_nan()).map(|(known, z)| known * z);
                row[d + i] - told.sum::<f64>()
            }));
        }
        let triangle = triangle(&some, narrow, 1, stop)?;
        let found = fit(&triangle, narrow, columns.len(), self.size, 1, stop)?;
        Ok(Fitted { rows, columns, ..found })
    }

    /// Theta from its blocks and the known entries.
    fn assembled(&self) -> Result<Vec<f64>> {
        let mut model = match &self.known {
            Some(known) => try_copy(WHAT, known)?,
            None => try_zeros(WHAT, self.n * self.d)?,
        };
        for block in &self.blocks {
            for (i, row) in block.rows.iter().zip(block.model.chunks_exact(block.columns.len().max(1))) {
                block.columns.iter().zip(row).for_each(|(j, v)| model[i * self.d + j] = *v);
            }
        }
        Ok(model)
    }

    /// The estimate from so many pairs, `times` as many, if data go on like those so far.
    ///
    /// # Errors
    /// As [`Estimate::new`].
    pub fn after(&self, size: usize, times: f64, stop: &Stop) -> Result<Self> {
        let triangle = &try_collect(WHAT, self.triangle.iter().map(|v| v * times.sqrt()))?;
        let Self { n, m, .. } = *self;
        Self::new(Data { triangle, size, n, m, offset: self.d > n + m, known: self.known.as_deref() }, stop)
    }

    /// How many directions of `z` the data determine, the least over the rows.
    #[must_use]
    pub fn rank(&self) -> usize {
        let missing = self.blocks.iter().map(|block| block.columns.len() - block.rank()).max();
        self.d - missing.unwrap_or(0)
    }

    /// `S / nu` of the residuals (n, n), 0 between blocks; None if there are no more pairs than unknowns.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn covariance(&self) -> Result<Option<Vec<f64>>> {
        let n = self.n;
        let mut found = try_filled(WHAT, 0.0, n * n)?;
        for block in &self.blocks {
            if block.degrees() == 0 {
                return Ok(None);
            }
            let (degrees, count) = (block.degrees() as f64, block.rows.len());
            for (at, value) in block.residual.iter().enumerate() {
                found[block.rows[at / count] * n + block.rows[at % count]] = value / degrees;
            }
        }
        Ok(Some(found))
    }
}
