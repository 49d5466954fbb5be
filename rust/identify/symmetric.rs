//! Eigenvalues and roots of small symmetric matrices; those that are needed for every draw without memory of their own.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::{Error, Result};
use crate::memory::{checked_len, room_for_products, try_copy, try_zeros};

const WHAT: &str = "the eigenvalues of a symmetric matrix";

/// The eigenvalues of the symmetric tridiagonal matrix with `diagonal` and `below[i]` in row `i + 1`, in no order, in
/// place of `diagonal`; `below`, as long as `diagonal`, is overwritten. QL with implicit shifts (Martin and Wilkinson
/// 1968).
pub(super) fn tridiagonal_eigenvalues(diagonal: &mut [f64], below: &mut [f64]) -> Result<()> {
    tridiagonal_eigenpairs(diagonal, below, &mut [])
}

/// The same; rows of `vectors` take part in the rotations, so that those of I become eigenvectors.
fn tridiagonal_eigenpairs(diagonal: &mut [f64], below: &mut [f64], vectors: &mut [f64]) -> Result<()> {
    const PATIENT: u32 = 30;
    let (n, d, e) = (diagonal.len(), diagonal, below);
    let whole = d.iter().chain(&*e).fold(0.0f64, |m, v| m.max(v.abs()));
    for l in 0..n {
        let mut sweeps = 0;
        loop {
            // next to eigenvalues that are rounding themselves, rounding of the whole matrix is all there is
            let least = if sweeps > PATIENT { f64::EPSILON * whole } else { 0.0 };
            let small = |m: &usize| e[*m].abs() <= least.max(f64::EPSILON * (d[*m].abs() + d[*m + 1].abs()));
            let m = (l..n - 1).find(small).unwrap_or(n - 1);
            if m == l {
                break;
            }
            sweeps += 1;
            if sweeps > 60 {
                return Err(Error::Numerical("the eigenvalues of a small matrix did not converge".into()));
            }
            let g = (d[l + 1] - d[l]) / (2.0 * e[l]);
            let mut g = d[m] - d[l] + e[l] / (g + g.hypot(1.0).copysign(g));
            let (mut s, mut c, mut p) = (1.0, 1.0, 0.0);
            let mut whole = true;
            for i in (l..m).rev() {
                let (f, b) = (s * e[i], c * e[i]);
                let r = (f * f + g * g).sqrt();
                e[i + 1] = r;
                if r == 0.0 {
                    d[i + 1] -= p;
                    e[m] = 0.0;
                    whole = false;
                    break;
                }
                (s, c) = (f / r, g / r);
                g = d[i + 1] - p;
                let r = (d[i] - g) * s + 2.0 * c * b;
                p = s * r;
                d[i + 1] = g + p;
                g = c * r - b;
                if !vectors.is_empty() {
                    let (row, next) = vectors[i * n..(i + 2) * n].split_at_mut(n);
                    for (row, next) in row.iter_mut().zip(next) {
                        (*row, *next) = (c * *row - s * *next, s * *row + c * *next);
                    }
                }
            }
            if whole {
                d[l] -= p;
                e[l] = g;
                e[m] = 0.0;
            }
        }
    }
    Ok(())
}

/// Memory for the eigenvalues of `n x n` matrices.
#[derive(Debug)]
pub(crate) struct Symmetric {
    pub(crate) matrix: Vec<f64>,
    diagonal: Vec<f64>,
    below: Vec<f64>,
}

impl Symmetric {
    pub(crate) fn new(n: usize) -> Result<Self> {
        let zeros = |len| try_zeros(WHAT, len);
        Ok(Self { matrix: zeros(checked_len(WHAT, n, n)?)?, diagonal: zeros(n)?, below: zeros(n)? })
    }

    /// The tridiagonal matrix in place of `matrix`, of which the lower half is read, divided by what is returned.
    fn reduce(&mut self) -> Result<f64> {
        let n = self.diagonal.len();
        let largest = self.matrix.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        if !largest.is_finite() {
            return Err(Error::Overflow { what: "a small symmetric matrix" });
        }
        if largest > 0.0 {
            self.matrix.iter_mut().for_each(|v| *v /= largest);
            tridiagonal(&mut self.matrix, n, &mut self.diagonal, &mut self.below);
        } else {
            self.diagonal.fill(0.0);
            self.below.fill(0.0);
        }
        Ok(largest)
    }

    /// The eigenvalues of `matrix`, of which the lower half is read and overwritten, in no order.
    pub(crate) fn eigenvalues(&mut self) -> Result<&[f64]> {
        let largest = self.reduce()?;
        tridiagonal_eigenvalues(&mut self.diagonal, &mut self.below)?;
        self.diagonal.iter_mut().for_each(|v| *v *= largest);
        Ok(&self.diagonal)
    }

    /// The same with eigenvectors of length 1, row by row in `vectors` (n, n).
    pub(crate) fn eigenpairs(&mut self, vectors: &mut [f64]) -> Result<&[f64]> {
        let (n, largest) = (self.diagonal.len(), self.reduce()?);
        vectors.fill(0.0);
        (0..n).for_each(|i| vectors[i * (n + 1)] = 1.0);
        tridiagonal_eigenpairs(&mut self.diagonal, &mut self.below, vectors)?;
        self.diagonal.iter_mut().for_each(|v| *v *= largest);
        // back by the reflections I - 2 v v' / ||v||^2 that `tridiagonal` left in the rows
        for i in 2..n {
            let v = &self.matrix[i * n..i * n + i];
            if v[..i - 1].iter().all(|v| *v == 0.0) {
                continue;
            }
            let half = v.iter().map(|v| v * v).sum::<f64>() / 2.0;
            for vector in vectors.chunks_exact_mut(n) {
                let along = v.iter().zip(&*vector).map(|(v, x)| v * x).sum::<f64>() / half;
                vector.iter_mut().zip(v).for_each(|(x, v)| *x -= along * v);
            }
        }
        Ok(&self.diagonal)
    }

    /// The largest eigenvalue of `matrix`, 0 for an empty one.
    pub(crate) fn largest(&mut self) -> Result<f64> {
        Ok(self.eigenvalues()?.iter().copied().reduce(f64::max).unwrap_or(0.0))
    }
}

/// Householder's reduction of the lower half of `a` to `diagonal` and `below[i] = a_{i+1,i}` (Martin, Reinsch and
/// Wilkinson 1968).
fn tridiagonal(a: &mut [f64], n: usize, diagonal: &mut [f64], below: &mut [f64]) {
    for i in (1..n).rev() {
        let (upper, rest) = a.split_at_mut(i * n);
        let row = &mut rest[..i];
        let scale: f64 = row[..i - 1].iter().map(|v| v.abs()).sum();
        if scale == 0.0 {
            below[i] = row[i - 1];
            continue;
        }
        let scale = scale + row[i - 1].abs();
        row.iter_mut().for_each(|v| *v /= scale);
        let squares: f64 = row.iter().map(|v| v * v).sum();
        let f = row[i - 1];
        let g = -squares.sqrt().copysign(f);
        below[i] = scale * g;
        let h = squares - f * g;
        row[i - 1] = f - g;
        // p = A v / h from the lower half, with v = row
        let p = &mut below[..i];
        p.fill(0.0);
        for j in 0..i {
            let line = &upper[j * n..j * n + j + 1];
            let mut sum = line[j] * row[j];
            for k in 0..j {
                sum += line[k] * row[k];
                p[k] += line[k] * row[j];
            }
            p[j] += sum;
        }
        let f: f64 = p
            .iter_mut()
            .zip(&*row)
            .map(|(p, v)| {
                *p /= h;
                *p * v
            })
            .sum();
        let half = f / (h + h);
        p.iter_mut().zip(&*row).for_each(|(p, v)| *p -= half * v);
        for j in 0..i {
            let line = &mut upper[j * n..j * n + j + 1];
            for (k, entry) in line.iter_mut().enumerate() {
                *entry -= row[j] * p[k] + p[j] * row[k];
            }
        }
    }
    diagonal.iter_mut().enumerate().for_each(|(i, d)| *d = a[i * n + i]);
    below.rotate_left(usize::from(n > 0));
    if let Some(last) = below.last_mut() {
        *last = 0.0;
    }
}

/// `M M'`.
pub(crate) fn squares(m: MatRef<'_, f64>, to: &mut [f64]) -> Result<()> {
    room_for_products()?;
    let to = MatMut::from_row_major_slice_mut(to, m.nrows(), m.nrows());
    matmul(to, Accum::Replace, m, m.transpose(), 1.0, Par::Seq);
    Ok(())
}

/// `||M||_2` of a `rows x cols` matrix, from the largest eigenvalue of `M M'` or `M' M`.
pub(crate) fn spectral_norm(m: &[f64], rows: usize, cols: usize) -> Result<f64> {
    if rows == 0 || cols == 0 {
        return Ok(0.0);
    }
    let scale = crate::fuse::power_of_two_scale(m);
    let mut scaled = try_copy(WHAT, m)?;
    scaled.iter_mut().for_each(|v| *v /= scale);
    let mut gram = Symmetric::new(rows.min(cols))?;
    let whole = MatRef::from_row_major_slice(&scaled, rows, cols);
    squares(if rows <= cols { whole } else { whole.transpose() }, &mut gram.matrix)?;
    Ok(scale * gram.largest()?.max(0.0).sqrt())
}

/// A root of a covariance (n, n): `root root' = S`, by the eigenvalues of `D^-1 S D^-1`, `D^2` the diagonal of S. So
/// the rounding of each row is relative to its own size, whatever the units of the others are.
pub(crate) fn covariance_root(covariance: &[f64], n: usize) -> Result<Vec<f64>> {
    let mut small = Symmetric::new(n)?;
    let mut sizes = try_zeros::<f64>(WHAT, n)?;
    sizes.iter_mut().enumerate().for_each(|(i, to)| *to = covariance[i * (n + 1)].max(0.0).sqrt());
    let inverse = |i: usize| if sizes[i] > 0.0 { 1.0 / sizes[i] } else { 0.0 };
    for (at, to) in small.matrix.iter_mut().enumerate() {
        *to = covariance[at] * inverse(at / n) * inverse(at % n);
    }
    let square = checked_len(WHAT, n, n)?;
    let [mut vectors, mut root] = [try_zeros(WHAT, square)?, try_zeros(WHAT, square)?];
    let values = small.eigenpairs(&mut vectors)?;
    for (q, (vector, value)) in vectors.chunks_exact(n).zip(values).enumerate() {
        let size = value.max(0.0).sqrt();
        vector.iter().zip(&sizes).enumerate().for_each(|(i, (v, own))| root[i * n + q] = v * size * own);
    }
    Ok(root)
}

/// Lower triangle L (n, n) with `L L'` = `matrix`, of which the lower half is read; None where it is not positive
/// definite.
pub(crate) fn cholesky(matrix: &[f64], n: usize) -> Result<Option<Vec<f64>>> {
    let mut l = try_zeros::<f64>(WHAT, checked_len(WHAT, n, n)?)?;
    (0..n).for_each(|i| l[i * n..=i * (n + 1)].copy_from_slice(&matrix[i * n..=i * (n + 1)]));
    Ok(factored(&mut l, n).then_some(l))
}

/// The same in place of the lower half; false where it is not positive definite.
pub(super) fn factored(matrix: &mut [f64], n: usize) -> bool {
    (0..n).all(|i| {
        let (done, row) = matrix.split_at_mut(i * n);
        for j in 0..=i {
            let other = if j < i { &done[j * n..(j + 1) * n] } else { &row[..n] };
            let left = row[j] - row[..j].iter().zip(other).map(|(a, b)| a * b).sum::<f64>();
            row[j] = if j < i { left / done[j * (n + 1)] } else { left.sqrt() };
        }
        row[i] > 0.0
    })
}

/// `log det` of a symmetric matrix (n, n); None where it is not positive definite.
pub(crate) fn log_determinant(matrix: &[f64], n: usize) -> Result<Option<f64>> {
    Ok(cholesky(matrix, n)?.map(|l| 2.0 * l.iter().step_by(n + 1).map(|v| v.ln()).sum::<f64>()))
}

/// `X <- L^-1 X`, of L the lower half.
pub(crate) fn whiten(l: MatRef<'_, f64>, mut x: MatMut<'_, f64>) {
    for mut x in x.as_mut().col_iter_mut() {
        for i in 0..l.nrows() {
            let done = (0..i).map(|k| l[(i, k)] * x[k]).sum::<f64>();
            x[i] = (x[i] - done) / l[(i, i)];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_of_known_matrices() {
        // second differences: 2 - 2 cos(k pi / (n + 1))
        for n in [1usize, 2, 5, 30] {
            let (mut d, mut e) = (vec![2.0; n], vec![-1.0; n]);
            tridiagonal_eigenvalues(&mut d, &mut e).unwrap();
            d.sort_by(f64::total_cmp);
            for (k, found) in d.iter().enumerate() {
                let expected = 2.0 - 2.0 * ((k + 1) as f64 * std::f64::consts::PI / (n + 1) as f64).cos();
                assert!((found - expected).abs() < 1e-14 * 4.0);
            }
        }
        // u u' + I
        let n = 6;
        let mut s = Symmetric::new(n).unwrap();
        for i in 0..n {
            for j in 0..n {
                s.matrix[i * n + j] = (i * j) as f64 + f64::from(u8::from(i == j));
            }
        }
        let mut found = s.eigenvalues().unwrap().to_vec();
        found.sort_by(f64::total_cmp);
        assert!((found[5] - 56.0).abs() < 1e-13 && found[..5].iter().all(|v| (v - 1.0).abs() < 1e-13));
    }

    #[test]
    fn eigenvectors_give_the_matrix_back() {
        for n in [1usize, 2, 3, 7, 20] {
            let entry =
                |i: usize, j: usize| ((i.min(j) * 7 + i.max(j) * 3) as f64).sin() * f64::from(u8::from(i / 3 == j / 3));
            let mut s = Symmetric::new(n).unwrap();
            (0..n * n).for_each(|at| s.matrix[at] = entry(at / n, at % n));
            let mut vectors = vec![0.0; n * n];
            let values = s.eigenpairs(&mut vectors).unwrap();
            for i in 0..n {
                for j in 0..n {
                    let sum = |f: &dyn Fn(usize) -> f64| {
                        (0..n).map(|q| f(q) * vectors[q * n + i] * vectors[q * n + j]).sum::<f64>()
                    };
                    assert!((sum(&|q| values[q]) - entry(i, j)).abs() < 1e-13, "{n} {i} {j}");
                    assert!((sum(&|_| 1.0) - f64::from(u8::from(i == j))).abs() < 1e-13);
                }
            }
        }
    }

    /// Eigenvalues that are 0 but for rounding, many at once.
    #[test]
    fn matrices_of_low_rank() {
        let n = 40;
        let entry = |i: usize, q: usize| ((i * i * (q + 3) + 7 * i + q) as f64 * 0.37).cos();
        for rank in 0..6 {
            let mut s = Symmetric::new(n).unwrap();
            for at in 0..n * n {
                s.matrix[at] = (0..rank).map(|q| entry(at / n, q) * entry(at % n, q)).sum();
            }
            let trace: f64 = (0..n).map(|i| s.matrix[i * (n + 1)]).sum();
            let given = s.matrix.clone();
            let mut vectors = vec![0.0; n * n];
            let values = s.eigenpairs(&mut vectors).unwrap();
            assert!(values.iter().filter(|v| v.abs() > 1e-13 * trace).count() <= rank);
            assert!((values.iter().sum::<f64>() - trace).abs() <= 1e-13 * trace);
            for at in 0..n * n {
                let found: f64 = (0..n).map(|q| values[q] * vectors[q * n + at / n] * vectors[q * n + at % n]).sum();
                assert!((found - given[at]).abs() <= 1e-13 * trace.max(1.0));
            }
        }
    }

    #[test]
    fn norms() {
        let m = [3.0, 0.0, 4.0, 0.0, 0.0, 0.0];
        assert!((spectral_norm(&m, 2, 3).unwrap() - 5.0).abs() < 1e-15);
        assert!((spectral_norm(&m, 3, 2).unwrap() - 5.0).abs() < 1e-14);
        assert!((spectral_norm(&[3e200, 4e200], 2, 1).unwrap() - 5e200).abs() < 1e186);
        assert_eq!(spectral_norm(&[0.0; 4], 2, 2).unwrap(), 0.0);
    }
}
