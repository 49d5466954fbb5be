//! A region of the coefficients `Theta` of `y+ = Theta z`, as one of the linear system in which they are.

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result};
use crate::matrix::MatrixView;
use crate::memory::{room_for_products, try_collect, try_filled, try_room};

use super::models::Region;
use super::part::{Part, PartOf, WHAT, directions};

/// `x+ = matrix (x; u; 1) + noise w`, where `Theta` acts on `z = entering (x; u; 1)` and w is the error of `Theta z`.
#[derive(Debug, Clone, Copy)]
pub struct Entering<'a> {
    /// The number of inputs.
    pub m: usize,
    /// `[A B c]` (n, k) at the centre.
    pub matrix: &'a [f64],
    /// J (d, k).
    pub entering: &'a [f64],
    /// G (n, p).
    pub noise: &'a [f64],
}

impl Entering<'_> {
    /// n and k, for p rows and d columns of Theta.
    pub(crate) fn sizes(&self, p: usize, d: usize) -> Result<(usize, usize)> {
        let n = self.noise.len() / p;
        let k = self.matrix.len() / n.max(1);
        if n > 0 && k > n && self.noise.len() == n * p && self.matrix.len() == n * k && self.entering.len() == d * k {
            return Ok((n, k));
        }
        let found = format!("{}, {}, {}", self.matrix.len(), self.entering.len(), self.noise.len());
        let expected = format!("{n} x {k}, {d} x {k} and {n} x {p} entries");
        Err(Error::Shape { name: "matrix, entering, noise", expected, found })
    }
}

fn rows_of(values: &[f64], cols: usize) -> MatRef<'_, f64> {
    MatRef::from_row_major_slice(values, values.len() / cols.max(1), cols)
}

fn listed(a: &Mat<f64>) -> Result<Vec<f64>> {
    try_collect(WHAT, (0..a.nrows() * a.ncols()).map(|at| a[(at / a.ncols(), at % a.ncols())]))
}

impl Region {
    /// The region of `[A B c]`: `{matrix + G Delta J}` for the `Delta` of this one, which must be of one part of all
    /// rows and columns.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`] for a J whose rows are not independent, [`Error::Memory`].
    pub fn entered(&self, of: Entering<'_>) -> Result<Self> {
        let (p, d) = (self.n, self.d);
        let (n, k) = of.sizes(p, d)?;
        let all = |places: &[usize], size: usize| places.iter().copied().eq(0..size);
        let part = match self.parts.as_slice() {
            [part] if all(&part.rows, p) && all(&part.columns, d) => part,
            _ => {
                let found = format!("{} parts", self.parts.len());
                return Err(Error::Shape { name: "parts", expected: "one, of all rows and columns".into(), found });
            }
        };
        room_for_products()?;
        let (j, g) = (rows_of(of.entering, k), rows_of(of.noise, p));
        let entering = (0..n).filter(|i| (0..p).any(|q| g[(*i, q)] != 0.0));
        let rows = try_collect(WHAT, entering)?;
        let own = Mat::from_fn(rows.len(), p, |i, q| g[(rows[i], q)]);
        let shape = &own * rows_of(&part.shape, p) * own.transpose();
        let shape = Mat::from_fn(rows.len(), rows.len(), |i, q| 0.5 * (shape[(i, q)] + shape[(q, i)]));
        // Delta J root' = Delta V^(1/2) for the root J'(J J')^-1
        let square = (j * j.transpose()).llt(Side::Lower);
        let square = square.map_err(|_| Error::Numerical("the rows of J depend on each other".into()))?;
        let root = (square.solve(rows_of(&part.root, d).transpose()).transpose() * j).to_owned();
        let columns = try_collect(WHAT, (0..k).filter(|q| (0..d).any(|i| j[(i, *q)] != 0.0)))?;
        let kept = |a: Mat<f64>| listed(&Mat::from_fn(a.nrows(), columns.len(), |i, q| a[(i, columns[q])]));
        let across = MatRef::from_row_major_slice(&part.missing, d, part.missing.len() / d);
        let missing = j.transpose() * across;
        let missing = listed(&Mat::from_fn(columns.len(), across.ncols(), |i, q| missing[(columns[i], q)]))?;
        let white = kept(rows_of(&part.white, d) * j)?;
        let moved = Part::new(PartOf {
            rows: &rows,
            columns: &columns,
            white: MatrixView::of(&white, columns.len()),
            root: MatrixView::of(&kept(root)?, columns.len()),
            missing: directions(&missing, columns.len()),
            ratio: part.ratio,
            shape: MatrixView::of(&listed(&shape)?, rows.len()),
            factor: part.factor,
        })?;
        let mut parts = try_room(WHAT, 1)?;
        parts.push(Arc::new(moved));
        let region = Self::new(MatrixView::of(of.matrix, k), of.m, parts, self.frobenius, self.future)?;
        let noise = match self.noise() {
            Some(noise) if noise.iter().all(|v| v.is_finite()) => {
                Some(listed(&(g * rows_of(noise, p) * g.transpose()))?)
            }
            Some(_) => Some(try_filled(WHAT, f64::INFINITY, n * n)?),
            None => None,
        };
        region.with_noise(noise)
    }
}
