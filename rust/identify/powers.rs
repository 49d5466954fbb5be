//! The powers `M_p = A^p S^(1/2)` of a model and the norms of sums over them that bound its error.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::Result;
use crate::memory::{checked_len, try_room, try_zeros};

use super::symmetric::{Symmetric, spectral_norm};

const WHAT: &str = "a certificate of several steps";

/// Row-major `a (n x k)` times `b (k x m)`.
pub(super) fn product(a: &[f64], b: &[f64], n: usize, k: usize, m: usize) -> Result<Vec<f64>> {
    let mut out = try_zeros(WHAT, checked_len(WHAT, n, m)?)?;
    let (a, b) = (MatRef::from_row_major_slice(a, n, k), MatRef::from_row_major_slice(b, k, m));
    matmul(MatMut::from_row_major_slice_mut(&mut out, n, m), Accum::Replace, a, b, 1.0, Par::Seq);
    Ok(out)
}

/// The largest singular value of a `rows x cols` matrix with few rows, from the product with its transpose.
fn wide_norm(m: &[f64], rows: usize, cols: usize, small: &mut Symmetric) -> Result<f64> {
    let scale = crate::fuse::power_of_two_scale(m);
    let matrix = MatRef::from_row_major_slice(m, rows, cols);
    let gram = MatMut::from_row_major_slice_mut(&mut small.matrix, rows, rows);
    matmul(gram, Accum::Replace, matrix, matrix.transpose(), 1.0 / scale / scale, Par::Seq);
    Ok(scale * small.largest()?.max(0.0).sqrt())
}

/// `a b`, where 0 times infinity is 0: nothing to bound.
pub(super) fn times(a: f64, b: f64) -> f64 {
    if a == 0.0 || b == 0.0 { 0.0 } else { a * b }
}

/// The matrices `M_p`, `p < K`, with what is needed of each.
pub(super) struct Powers {
    rows: usize,
    n: usize,
    pub matrices: Vec<Vec<f64>>,
    norms: Vec<f64>,
    /// `M_p M_p'`.
    squares: Vec<Vec<f64>>,
    small: Symmetric,
}

impl Powers {
    pub fn new(rows: usize, n: usize, steps: usize) -> Result<Self> {
        let [matrices, squares] = [try_room(WHAT, steps)?, try_room(WHAT, steps)?];
        Ok(Self { rows, n, matrices, norms: try_room(WHAT, steps)?, squares, small: Symmetric::new(rows)? })
    }

    pub fn push(&mut self, matrix: Vec<f64>) -> Result<()> {
        self.norms.push(spectral_norm(&matrix, self.rows, self.n)?);
        let mut square = try_zeros(WHAT, self.rows * self.rows)?;
        let m = MatRef::from_row_major_slice(&matrix, self.rows, self.n);
        let to = MatMut::from_row_major_slice_mut(&mut square, self.rows, self.rows);
        matmul(to, Accum::Replace, m, m.transpose(), 1.0, Par::Seq);
        self.squares.push(square);
        self.matrices.push(matrix);
        Ok(())
    }

    /// Above `||sum_j M_{k-1-j} y_j||` for all `||y_j|| <= sizes_j`, and at most `sum_j sizes_j ||M_{k-1-j}||`:
    ///
    /// `sqrt(lam_max(sum_j (c_j / ||M_j||) M_j M_j') sum_j c_j ||M_j||)`, terms that are 0 left out.
    pub fn cauchy_schwarz(&mut self, sizes: &[f64]) -> Result<f64> {
        let k = sizes.len();
        self.small.matrix.fill(0.0);
        let mut sum = 0.0;
        for (j, size) in sizes.iter().enumerate() {
            let norm = self.norms[k - 1 - j];
            let term = times(*size, norm);
            if term > 0.0 {
                let square = &self.squares[k - 1 - j];
                self.small.matrix.iter_mut().zip(square).for_each(|(g, s)| *g += size / norm * s);
                sum += term;
            }
        }
        match sum {
            0.0 => Ok(0.0),
            sum if sum.is_finite() => Ok((self.small.largest()?.max(0.0) * sum).sqrt()),
            _ => Ok(f64::INFINITY),
        }
    }

    /// `lin_k`, from the `c_j`, their lengths (with noise), and the bounds.
    pub fn linear(
        &mut self,
        c: &[Vec<f64>],
        lengths: &[f64],
        (spectral, frobenius): (f64, f64),
        noise: bool,
    ) -> Result<f64> {
        if !lengths.iter().all(|length| length.is_finite()) {
            return Ok(f64::INFINITY);
        }
        let (k, (rows, n)) = (c.len(), (self.rows, self.n));
        let crude = times(spectral, self.cauchy_schwarz(lengths)?);
        if frobenius == f64::INFINITY {
            return Ok(crude);
        }
        // [sum_j c_j' (x) M_{k-1-j}, and the M themselves for the noise]: exact for all Gamma at once
        let rank = c.first().map_or(0, Vec::len);
        let cols = (rank + if noise { k } else { 0 }) * n;
        let mut total = try_zeros(WHAT, checked_len(WHAT, rows, cols)?)?;
        for (j, c) in c.iter().enumerate() {
            let matrix = &self.matrices[k - 1 - j];
            for (to, from) in total.chunks_exact_mut(cols.max(1)).zip(matrix.chunks_exact(n)) {
                for (to, c) in to.chunks_exact_mut(n).zip(c) {
                    to.iter_mut().zip(from).for_each(|(to, from)| *to += c * from);
                }
                if noise {
                    to[(rank + j) * n..(rank + j + 1) * n].copy_from_slice(from);
                }
            }
        }
        let exact = if cols == 0 { 0.0 } else { wide_norm(&total, rows, cols, &mut self.small)? };
        Ok(times(frobenius, exact).min(crude))
    }
}
