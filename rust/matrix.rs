//! Matrices of the caller, with their sizes.

use std::borrow::Cow;
use std::ops::Range;

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_extend, try_room};

/// A matrix whose entries another object holds, row by row.
///
/// ```
/// use stochens::MatrixView;
/// let theta = MatrixView::new(&[0.9, 0.2, 1.0, -0.1, 0.8, 0.5], 2, 3)?; // [A B], 2 states and an input
/// assert_eq!((theta.columns(0..2)?.shape(), theta.columns(2..3)?.row(1)), ((2, 2), Some(&[0.5][..])));
/// let same: MatrixView<'_> = (&[[0.9, 0.2, 1.0], [-0.1, 0.8, 0.5]]).into();
/// assert_eq!(same.row(0), theta.row(0));
/// assert!(MatrixView::new(&[0.0; 5], 2, 3).is_err());
/// # Ok::<(), stochens::Error>(())
/// ```
#[derive(Debug, Clone, Copy, Default)]
pub struct MatrixView<'a> {
    values: &'a [f64],
    rows: usize,
    columns: usize,
    /// From one row to the next.
    stride: usize,
}

impl<'a> MatrixView<'a> {
    /// # Errors
    /// [`Error::Shape`] if there are not so many values.
    pub fn new(values: &'a [f64], rows: usize, columns: usize) -> Result<Self> {
        if rows.checked_mul(columns) == Some(values.len()) {
            return Ok(Self { values, rows, columns, stride: columns });
        }
        let found = values.len().to_string();
        Err(Error::Shape { name: "values", expected: format!("{rows} x {columns} entries"), found })
    }

    /// The matrix with all of these values, in rows of so many.
    pub(crate) fn of(values: &'a [f64], columns: usize) -> Self {
        Self { values, rows: values.len().checked_div(columns).unwrap_or(0), columns, stride: columns }
    }

    /// Rows and columns.
    #[must_use]
    pub const fn shape(&self) -> (usize, usize) {
        (self.rows, self.columns)
    }

    /// A row; None behind the last one.
    #[must_use]
    pub fn row(&self, at: usize) -> Option<&'a [f64]> {
        let first = self.stride.checked_mul(at).filter(|_| at < self.rows)?;
        self.values.get(first..first + self.columns)
    }

    /// Some of its columns: of `[A B]` those of A.
    ///
    /// # Errors
    /// [`Error::Shape`] if it does not have them.
    pub fn columns(&self, range: Range<usize>) -> Result<Self> {
        if range.start <= range.end && range.end <= self.columns {
            let values = self.values.get(range.start..).unwrap_or_default();
            return Ok(Self { values, columns: range.len(), ..*self });
        }
        let (expected, found) = (format!("columns up to {}", self.columns), format!("{range:?}"));
        Err(Error::Shape { name: "columns", expected, found })
    }

    /// The entries of a matrix that must have this shape, row by row.
    pub(crate) fn sized(self, name: &'static str, rows: usize, columns: usize) -> Result<Cow<'a, [f64]>> {
        if self.shape() != (rows, columns) {
            let found = format!("{} x {}", self.rows, self.columns);
            return Err(Error::Shape { name, expected: format!("{rows} x {columns} entries"), found });
        }
        let len = checked_len("a matrix", rows, columns)?;
        if let Some(values) = self.values.get(..len).filter(|_| self.stride == columns) {
            return Ok(values.into());
        }
        let mut all = try_room("a matrix", len)?;
        (0..rows).try_for_each(|i| try_extend("a matrix", &mut all, self.row(i).into_iter().flatten().copied()))?;
        Ok(all.into())
    }

    /// The same with any number of rows.
    pub(crate) fn wide(self, name: &'static str, columns: usize) -> Result<Cow<'a, [f64]>> {
        if self.columns != columns {
            let found = format!("{} x {}", self.rows, self.columns);
            return Err(Error::Shape { name, expected: format!("any x {columns} entries"), found });
        }
        self.sized(name, self.rows, columns)
    }

    /// The same with any number of columns.
    pub(crate) fn high(self, name: &'static str, rows: usize) -> Result<Cow<'a, [f64]>> {
        if self.rows != rows {
            let found = format!("{} x {}", self.rows, self.columns);
            return Err(Error::Shape { name, expected: format!("{rows} x any entries"), found });
        }
        self.sized(name, rows, self.columns)
    }

    /// The same, all of them finite.
    pub(crate) fn finite(self, name: &'static str, rows: usize, columns: usize) -> Result<Cow<'a, [f64]>> {
        let values = self.sized(name, rows, columns)?;
        require_finite(name, &values)?;
        Ok(values)
    }
}

impl<'a, const C: usize> From<&'a [[f64; C]]> for MatrixView<'a> {
    fn from(rows: &'a [[f64; C]]) -> Self {
        Self { values: rows.as_flattened(), rows: rows.len(), columns: C, stride: C }
    }
}

impl<'a, const R: usize, const C: usize> From<&'a [[f64; C]; R]> for MatrixView<'a> {
    fn from(rows: &'a [[f64; C]; R]) -> Self {
        rows.as_slice().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_seen_in_place_and_copied_where_rows_must_follow_each_other() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let whole = MatrixView::new(&values, 2, 3).unwrap();
        assert!(matches!(whole.sized("A", 2, 3), Ok(Cow::Borrowed(same)) if same == values));
        let part = whole.columns(1..3).unwrap();
        assert_eq!(*part.sized("A", 2, 2).unwrap(), [2.0, 3.0, 5.0, 6.0]);
        assert_eq!(*part.columns(1..2).unwrap().sized("A", 2, 1).unwrap(), [3.0, 6.0]);
        assert!(whole.columns(3..3).unwrap().sized("A", 2, 0).unwrap().is_empty());
        assert_eq!((part.row(1), part.row(2)), (Some(&[5.0, 6.0][..]), None));
    }

    #[test]
    fn other_shapes_are_refused_with_their_sizes() {
        let whole = MatrixView::from(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        let why = whole.sized("K", 3, 2).unwrap_err().to_string();
        assert_eq!(why, "`K` must have 3 x 2 entries, got 2 x 3"); // as many entries
        for range in [0..4, 4..4, usize::MAX..usize::MAX] {
            assert!(whole.columns(range).is_err());
        }
        assert!(MatrixView::new(&[1.0; 6], usize::MAX, 2).is_err() && whole.row(usize::MAX).is_none());
        let none: MatrixView<'_> = MatrixView::from(&[] as &[[f64; 3]; 0]);
        assert!(none.columns(1..2).unwrap().sized("A", 0, 1).unwrap().is_empty());
    }
}
