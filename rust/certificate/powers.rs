//! The powers `M_p = A^p S^(1/2)` of a model and the norms of sums over them that bound its error.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::control::pseudoinverse;
use crate::error::Result;
use crate::identify::{Symmetric, spectral_norm, squares, triangle};
use crate::memory::{checked_len, try_collect, try_copy, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::times;

use super::nuclear::WHAT;
use super::nuclear::{Effort, Terms};

/// Row-major `a (n x k)` times `b (k x m)`.
pub(super) fn product(a: &[f64], b: &[f64], n: usize, k: usize, m: usize) -> Result<Vec<f64>> {
    let mut out = try_zeros(WHAT, checked_len(WHAT, n, m)?)?;
    let (a, b) = (MatRef::from_row_major_slice(a, n, k), MatRef::from_row_major_slice(b, k, m));
    matmul(MatMut::from_row_major_slice_mut(&mut out, n, m), Accum::Replace, a, b, 1.0, Par::Seq);
    Ok(out)
}

/// `X Y'` of (rows, cols).
pub(super) fn products([x, y]: [&[f64]; 2], rows: usize) -> Result<Vec<f64>> {
    let cols = x.len() / rows;
    let (x, y) = (MatRef::from_row_major_slice(x, rows, cols), MatRef::from_row_major_slice(y, rows, cols));
    let mut found = try_zeros(WHAT, rows * rows)?;
    let to = MatMut::from_row_major_slice_mut(&mut found, rows, rows);
    matmul(to, Accum::Replace, x, y.transpose(), 1.0, Par::Seq);
    Ok(found)
}

/// The deviations of the n rows of a covariance, 1 for those without noise.
pub(super) fn deviations(covariance: &[f64], n: usize) -> Result<Vec<f64>> {
    try_collect(WHAT, covariance.iter().step_by(n + 1).map(|v| if *v > 0.0 { v.sqrt() } else { 1.0 }))
}

/// Divides rows and columns of a covariance by these units.
pub(super) fn in_units(covariance: &mut [f64], units: &[f64]) {
    for (row, own) in covariance.chunks_exact_mut(units.len()).zip(units) {
        row.iter_mut().zip(units).for_each(|(v, other)| *v /= own * other);
    }
}

/// `(M^-1)'` (d, d) of a matrix with columns of these lengths, and the ratio of the singular values of it with columns
/// of length 1.
pub(super) fn transposed_inverse(matrix: &[f64], units: &[f64], d: usize) -> Result<(Vec<f64>, f64)> {
    let scaled = try_collect(WHAT, matrix.iter().zip(units.iter().cycle()).map(|(v, unit)| v / unit))?;
    let inverse = pseudoinverse(&scaled, d, d)?;
    let mut found = try_zeros(WHAT, checked_len(WHAT, d, d)?)?;
    for (q, to) in found.chunks_exact_mut(d).enumerate() {
        to.iter_mut().zip(units).enumerate().for_each(|(j, (to, unit))| *to = inverse.matrix[j * d + q] / unit);
    }
    Ok((found, if inverse.rank == d { 1.0 / inverse.condition } else { 0.0 }))
}

/// The matrices `M_p`, `p < K`, with what is needed of each.
#[derive(Debug)]
pub(super) struct Powers {
    rows: usize,
    n: usize,
    matrices: Vec<f64>,
    norms: Vec<f64>,
    /// `M_p M_p'`.
    squares: Vec<f64>,
    small: Symmetric,
}

impl Powers {
    pub fn new(rows: usize, n: usize, steps: usize) -> Result<Self> {
        let matrices = try_room(WHAT, checked_len(WHAT, checked_len(WHAT, rows, n)?, steps)?)?;
        let [norms, squares] = [try_room(WHAT, steps)?, try_room(WHAT, checked_len(WHAT, rows * rows, steps)?)?];
        Ok(Self { rows, n, matrices, norms, squares, small: Symmetric::new(rows)? })
    }

    /// The next one; no more than were announced.
    pub fn push(&mut self, matrix: &[f64]) -> Result<()> {
        self.norms.push(spectral_norm(matrix, self.rows, self.n)?);
        squares(MatRef::from_row_major_slice(matrix, self.rows, self.n), &mut self.small.matrix)?;
        self.squares.extend_from_slice(&self.small.matrix);
        self.matrices.extend_from_slice(matrix);
        Ok(())
    }

    /// `M_0, M_1, ..` (rows, n).
    pub fn all(&self) -> impl DoubleEndedIterator<Item = &[f64]> {
        self.matrices.chunks_exact((self.rows * self.n).max(1))
    }

    /// `M_{k-1}, .., M_0`.
    pub fn back(&self, k: usize) -> impl Iterator<Item = &[f64]> {
        let size = self.rows * self.n;
        self.matrices[..k * size].chunks_exact(size.max(1)).rev()
    }

    /// `M_p M_p'` (rows, rows).
    pub fn square(&self, p: usize) -> &[f64] {
        &self.squares[p * self.rows * self.rows..(p + 1) * self.rows * self.rows]
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
                let square = &self.squares[(k - 1 - j) * self.small.matrix.len()..];
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

    /// `lin_k` of `c_0, .., c_{k-1}`, which have these `lengths`, or `enough`; a bound of the largest value over
    /// `||Gamma||_2 <= spectral`, `||Gamma||_F <= frobenius`, the smallest of
    ///
    /// ```text
    /// min(frobenius, spectral sqrt(min(n, r))) || sum_j c_j' (x) M_{k-1-j} ||,    r coordinates of the c_j
    /// spectral wcs(M, ||c_j||)
    /// spectral nuc(T)                                                            see `nuclear`
    /// enough                                                                     known otherwise.
    /// ```
    ///
    /// The first three are not below `spectral || sum_j c_j' (x) M_{k-1-j} ||`.
    pub fn linear(
        &mut self,
        c: &Span,
        lengths: &[f64],
        (spectral, frobenius): (f64, f64),
        effort: Effort,
        enough: f64,
    ) -> Result<f64> {
        let k = lengths.len();
        if enough == 0.0 || !lengths.iter().all(|length| length.is_finite()) {
            return Ok(enough);
        }
        let (c, r) = c.first(k)?;
        let least = self.n.min(r);
        let mut size = 0.0;
        if least > 0 && self.rows > 0 {
            size = self.terms(k, &c, r).frobenius()?;
            if times(spectral, size) >= enough {
                return Ok(enough);
            }
        }
        let crude = enough.min(times(spectral, self.cauchy_schwarz(lengths)?));
        if least == 0 || self.rows == 0 || crude == 0.0 {
            return Ok(crude);
        }
        let found = crude.min(times(frobenius.min(spectral * (least as f64).sqrt()), size));
        // rank one: that is exact already
        if least == 1 || !(spectral.is_finite() && found > spectral * size) {
            return Ok(found);
        }
        Ok(found.min(times(spectral, self.terms(k, &c, r).largest(effort, found / spectral)?)))
    }

    fn terms<'a>(&'a self, k: usize, c: &'a [f64], r: usize) -> Terms<'a> {
        let (rows, n) = (self.rows, self.n);
        Terms { matrices: &self.matrices[..k * rows * n], norms: &self.norms[..k], c, rows, n, r }
    }
}

/// First-order parts of all steps: `sum_{j<k} c_j' (x) M_{k-1-j}` (n, d n) for k = 1..K.
pub(super) fn first_order(a: &[f64], root: &[f64], c: &[f64], n: usize, d: usize) -> Result<Vec<Vec<f64>>> {
    let width = checked_len(WHAT, d, n)?;
    let mut all = try_room(WHAT, c.len() / d)?;
    let mut now = try_zeros(WHAT, checked_len(WHAT, n, width)?)?;
    for c in c.chunks_exact(d) {
        now = product(a, &now, n, n, width)?;
        for (row, root) in now.chunks_exact_mut(width).zip(root.chunks_exact(n)) {
            for (to, c) in row.chunks_exact_mut(n).zip(c) {
                to.iter_mut().zip(root).for_each(|(to, root)| *to += c * root);
            }
        }
        all.push(try_copy(WHAT, &now)?);
    }
    Ok(all)
}

/// A bound of the largest `||sum_j M_{K-1-j} Gamma c_j - sum_j L_{K-1-j} Gamma g_j||` over `||Gamma||_2 <= 1`, for as
/// many `M_p` as `L_p`; infinite if there is no time for it. `c` and `g` are (K, r).
pub(super) fn largest_difference(
    [m, l]: [&Powers; 2],
    [c, g]: [&[f64]; 2],
    effort: Effort,
    enough: f64,
) -> Result<f64> {
    let matrices = try_collect(WHAT, l.matrices.iter().chain(&m.matrices).copied())?;
    let norms = try_collect(WHAT, l.norms.iter().chain(&m.norms).copied())?;
    let (rows, n, r) = (m.rows, m.n, c.len() / m.norms.len().max(1));
    let mut all = try_room(WHAT, c.len() + g.len())?;
    g.chunks_exact(r.max(1)).rev().for_each(|g| all.extend(g.iter().map(|g| -g)));
    c.chunks_exact(r.max(1)).rev().for_each(|c| all.extend_from_slice(c));
    Terms { matrices: &matrices, norms: &norms, c: &all, rows, n, r }.largest(effort, enough)
}

/// Coordinates of `c_0, .., c_{K-1}`, as few as there can be for the first 1, 2, .. of them.
#[derive(Debug)]
pub(super) struct Span {
    /// The vectors themselves, row by row (K, size).
    own: Vec<f64>,
    size: usize,
    /// `Q' c_j` of an orthonormal Q in row `j`, 0 from `j + 1` on (K, K).
    rotated: Vec<f64>,
    steps: usize,
}

impl Span {
    /// Of the rows of `c` (K, rank); with `noise` each has a further coordinate of its own, 1.
    pub fn new(c: &[f64], steps: usize, noise: bool, stop: &Stop) -> Result<Self> {
        let rank = c.len().checked_div(steps).unwrap_or(0);
        let size = rank + if noise { steps } else { 0 };
        let len = checked_len(WHAT, steps, size)?;
        let [mut own, mut columns] = [try_zeros(WHAT, len)?, try_zeros(WHAT, len)?];
        for j in 0..steps {
            let row = &mut own[j * size..(j + 1) * size];
            row[..rank].copy_from_slice(&c[j * rank..(j + 1) * rank]);
            if noise {
                row[rank + j] = 1.0;
            }
            row.iter().enumerate().for_each(|(i, v)| columns[i * steps + j] = *v);
        }
        let mut rotated = try_zeros(WHAT, checked_len(WHAT, steps, steps)?)?;
        if len > 0 {
            let r = triangle(&columns, steps, 1, stop)?;
            (0..r.len()).for_each(|at| rotated[at] = r[at % steps * steps + at / steps]);
        }
        Ok(Self { own, size, rotated, steps })
    }

    /// Those of the first `k`, the last one first, and how many there are of each.
    pub fn first(&self, k: usize) -> Result<(Vec<f64>, usize)> {
        let (values, stride, r) =
            if k < self.size { (&self.rotated, self.steps, k) } else { (&self.own, self.size, self.size) };
        let mut found = try_room(WHAT, checked_len(WHAT, k, r)?)?;
        values[..k * stride].chunks_exact(stride.max(1)).rev().for_each(|row| found.extend_from_slice(&row[..r]));
        Ok((found, r))
    }
}
