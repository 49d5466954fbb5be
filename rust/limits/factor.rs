//! Cholesky factor of a symmetric matrix whose size changes from face to face, in memory asked for once, and the
//! products of large matrices.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, MatMut, MatRef, Par};

use super::kernel::{padded, small_product, solved};
use super::quadratic::Until;
use super::tiles::{factored, gram, inverted, mirror};
use crate::error::Result;
use crate::memory::{checked_len, room_for_products, try_zeros};

const WHAT: &str = "a control within limits";

/// Rows up to which one kernel takes the whole matrix, and of a panel above.
const PANEL: usize = 128;
/// Columns of a square between two looks at the clock.
const COLUMNS: usize = 512;

#[derive(Debug, Default)]
pub(crate) struct Factor {
    lower: Vec<f64>,
    inverse: Vec<f64>,
    block: Vec<f64>,
    n: usize,
    ld: usize,
}

impl Factor {
    /// Memory for up to `most` rows.
    pub(crate) fn new(most: usize) -> Result<Self> {
        let ld = padded(most);
        let block = if most > PANEL { PANEL * PANEL } else { 0 };
        let lower = try_zeros(WHAT, checked_len(WHAT, most, ld)?)?;
        Ok(Self { lower, inverse: try_zeros(WHAT, most)?, block: try_zeros(WHAT, block)?, n: 0, ld })
    }

    /// Factors the matrix of `n` rows whose column `j` from the diagonal on is written by `column(j, into)`. False if
    /// it is not positive definite to rounding.
    pub(crate) fn set(
        &mut self,
        n: usize,
        mut column: impl FnMut(usize, &mut [f64]),
        until: Until<'_>,
    ) -> Result<bool> {
        (self.n, self.ld) = (n, padded(n));
        for (j, line) in self.lower.chunks_exact_mut(self.ld.max(1)).take(n).enumerate() {
            column(j, &mut line[j..n]);
            line[n..].fill(0.0);
        }
        if n > PANEL {
            return self.by_panels(until);
        }
        let (lower, inverse) = (&mut self.lower, &mut self.inverse);
        Ok(factored(lower, n, padded(n), inverse))
    }

    fn by_panels(&mut self, until: Until<'_>) -> Result<bool> {
        room_for_products()?;
        let (n, ld) = (self.n, self.ld);
        for start in (0..n).step_by(PANEL) {
            until.check()?;
            let width = PANEL.min(n - start);
            let (done, rest) = self.lower[..n * ld].split_at_mut(start * ld);
            let mut panel =
                MatMut::from_column_major_slice_with_stride_mut(rest, n, width, ld).subrows_mut(start, n - start);
            if start > 0 {
                // A_p <- A_p - L_< L_p<'
                let done = MatRef::from_column_major_slice_with_stride(done, n, start, ld);
                let (below, here) = (done.subrows(start, n - start), done.subrows(start, width));
                matmul(panel.as_mut(), Accum::Add, below, here.transpose(), -1.0, Par::Seq);
            }
            let side = padded(width);
            for j in 0..width {
                for i in 0..side {
                    self.block[j * side + i] = if i >= j && i < width { panel[(i, j)] } else { 0.0 };
                }
            }
            let (block, inverse) = (&mut self.block, &mut self.inverse[start..start + width]);
            if !factored(block, width, side, inverse) {
                return Ok(false);
            }
            for j in 0..width {
                for i in 0..width {
                    panel[(i, j)] = if i == j { 1.0 / self.inverse[start + j] } else { self.block[j * side + i] };
                }
                (0..j).for_each(|i| panel[(i, j)] = 0.0);
            }
            let (diagonal, below) = panel.split_at_row_mut(width);
            solve_lower_triangular_in_place(diagonal.as_ref(), below.transpose_mut(), Par::Seq);
        }
        for (j, line) in self.lower.chunks_exact_mut(ld).take(n).enumerate() {
            line[..=j].fill(0.0);
            line[n..].fill(0.0);
        }
        Ok(true)
    }

    /// `x <- A^{-1} x`; `x` has whole groups.
    pub(crate) fn solve(&self, x: &mut [f64]) {
        solved(&self.lower, self.ld, &self.inverse[..self.n], x);
    }

    /// A lower bound of the condition of `A`: the squared ratio of the largest to the smallest diagonal entry of `L`.
    pub(super) fn condition(&self) -> f64 {
        let range = |(low, high): (f64, f64), v: &f64| (low.min(*v), high.max(*v));
        let (low, high) = self.inverse[..self.n].iter().fold((f64::INFINITY, 0.0), range);
        (high / low).powi(2).max(1.0)
    }

    /// `out = A^{-1}`, in lines of the padded length; `x` is memory of the same size.
    pub(super) fn inverted(&self, x: &mut [f64], out: &mut [f64]) -> Result<()> {
        let (n, ld) = (self.n, self.ld);
        if n <= PANEL {
            inverted(&self.lower, n, ld, &self.inverse[..n], x, out);
            return Ok(());
        }
        room_for_products()?;
        out.copy_from_slice(&self.lower[..n * ld]);
        (0..n).for_each(|j| out[j * ld + j] = 1.0 / self.inverse[j]);
        let lower = MatRef::from_column_major_slice_with_stride(out, n, n, ld);
        invert_lower_triangular(MatMut::from_column_major_slice_with_stride_mut(x, n, n, ld), lower, Par::Seq);
        let lower = MatRef::from_column_major_slice_with_stride(x, n, n, ld);
        let to = MatMut::from_column_major_slice_with_stride_mut(out, n, n, ld);
        let (left, right) = (BlockStructure::TriangularUpper, BlockStructure::TriangularLower);
        triangular::matmul(to, right, Accum::Replace, lower.transpose(), left, lower, right, 1.0, Par::Seq);
        mirror(out, n, ld);
        Ok(())
    }
}

/// `h = rows' rows`, `d` lines of the length `ld` of a row.
pub(crate) fn squared(rows: &[f64], d: usize, ld: usize, h: &mut [f64], until: Until<'_>) -> Result<()> {
    if d <= PANEL {
        gram(rows, d, ld, h);
        return Ok(());
    }
    room_for_products()?;
    let (m, full) =
        (MatRef::from_row_major_slice(rows, rows.len() / ld, ld).subcols(0, d), BlockStructure::Rectangular);
    let (lower, mut to) =
        (BlockStructure::TriangularLower, MatMut::from_column_major_slice_with_stride_mut(h, d, d, ld));
    for start in (0..d).step_by(COLUMNS) {
        until.check()?;
        let width = COLUMNS.min(d - start);
        let (some, below) = (m.subcols(start, width), m.subcols(start + width, d - start - width));
        let (to_some, to_below) = to.as_mut().submatrix_mut(start, start, d - start, width).split_at_row_mut(width);
        triangular::matmul(to_some, lower, Accum::Replace, some.transpose(), full, some, full, 1.0, Par::Seq);
        matmul(to_below, Accum::Replace, below.transpose(), some, 1.0, Par::Seq);
    }
    mirror(h, d, ld);
    Ok(())
}

/// `out = A B`, or `A' B`, in lines of `ld`; `A` in lines of `la` has `inner` columns, or rows.
pub(super) fn product(
    a: &[f64],
    la: usize,
    transposed: bool,
    inner: usize,
    b: &[f64],
    out: &mut [f64],
    ld: usize,
) -> Result<()> {
    let lines = out.len() / ld;
    if inner <= PANEL || lines <= PANEL {
        small_product(a, la, transposed, inner, b, out, ld);
        return Ok(());
    }
    room_for_products()?;
    let a = MatRef::from_row_major_slice(a, a.len() / la, la);
    let a = if transposed { a.submatrix(0, 0, inner, lines).transpose() } else { a.submatrix(0, 0, lines, inner) };
    let b = MatRef::from_row_major_slice(b, b.len() / ld, ld).subrows(0, inner);
    matmul(MatMut::from_row_major_slice_mut(out, lines, ld), Accum::Replace, a, b, 1.0, Par::Seq);
    Ok(())
}
