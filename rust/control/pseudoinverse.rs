//! Singular values, and the Moore-Penrose inverse with its rank and condition.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};

use crate::error::{Error, Result, require_finite};
use crate::fuse::power_of_two_scale;
use crate::memory::{covered, room_for_products, try_zeros};

/// `B^+`, and the rank, condition and singular vectors of `B`.
#[derive(Debug, Clone)]
pub struct Pseudoinverse {
    /// `B^+`, row by row (`cols x rows` of `B`).
    pub matrix: Vec<f64>,
    /// Singular values above the cut-off.
    pub rank: usize,
    /// All singular values, decreasing.
    pub singular_values: Vec<f64>,
    /// The largest over the smallest singular value above the cut-off; infinite for `B = 0`.
    pub condition: f64,
    /// An orthonormal basis of the range of `B`, vector by vector (`rank x rows`): the left singular vectors.
    pub basis: Vec<f64>,
    /// The right singular vectors in the same order (`rank x cols`): `B^+ y = sum_k right_k <basis_k, y> / sigma_k`.
    /// `B` times this is accurate; with `matrix`, rounding is multiplied by the condition.
    pub right: Vec<f64>,
}

/// `B^+` of a `rows x cols` matrix given row by row.
///
/// Singular values up to `eps max(rows, cols) sigma_max` count as zero (the rule of `scipy.linalg.pinv`).
///
/// # Errors
/// [`Error::NonFinite`] for NaN or infinity, [`Error::Numerical`] if the SVD fails on the matrix and on its transpose,
/// [`Error::Memory`].
pub fn pseudoinverse(b: &[f64], rows: usize, cols: usize) -> Result<Pseudoinverse> {
    require_finite("B", b)?;
    room_for_products()?;
    covered("the pseudoinverse of `B`", svd_bytes(rows, cols), || from_svd(b, rows, cols))?
}

#[expect(clippy::disallowed_methods, clippy::disallowed_macros, reason = "called under `covered`")]
fn from_svd(b: &[f64], rows: usize, cols: usize) -> Result<Pseudoinverse> {
    let scale = power_of_two_scale(b);
    let scaled = Mat::from_fn(rows, cols, |i, j| b[i * cols + j] / scale);
    let (u, s, v) = thin_svd(scaled.as_ref())?;
    let largest = s.first().copied().unwrap_or(0.0);
    let cut = f64::EPSILON * rows.max(cols) as f64 * largest;
    let rank = s.iter().filter(|&&sigma| sigma > cut).count();
    // B^+ = sum_{k < rank} v_k u_k^T / sigma_k; the factor 1/scale belongs to the result
    let mut matrix = vec![0.0; rows * cols];
    matmul(
        MatMut::from_row_major_slice_mut(&mut matrix, cols, rows),
        Accum::Replace,
        Mat::from_fn(cols, rank, |i, k| v[(i, k)] / s[k]),
        u.subcols(0, rank).transpose(),
        1.0,
        Par::Seq,
    );
    matrix.iter_mut().for_each(|entry| *entry /= scale);
    if matrix.iter().any(|entry| !entry.is_finite()) {
        let found = format!("a smallest singular value of {:e}", s[rank - 1] * scale);
        return Err(Error::Value { name: "B", expected: "large enough for its pseudoinverse to be finite", found });
    }
    Ok(Pseudoinverse {
        basis: by_vector("the basis of the range of B", &u, rank)?,
        right: by_vector("the right singular vectors of B", &v, rank)?,
        matrix,
        rank,
        condition: if rank > 0 { largest / s[rank - 1] } else { f64::INFINITY },
        singular_values: s.into_iter().map(|sigma| sigma * scale).collect(),
    })
}

/// Singular values of a matrix given row by row, falling; none of an empty one.
///
/// # Errors
/// [`Error::Numerical`], [`Error::Memory`].
pub(crate) fn singular_values(a: &[f64], columns: usize) -> Result<Vec<f64>> {
    let rows = a.len().checked_div(columns).unwrap_or(0);
    if rows == 0 {
        return Ok(Vec::new());
    }
    let scale = power_of_two_scale(a);
    // copies of the matrix, and blocks of reflections
    let bytes = 64 * (rows as u128 + 64) * (columns as u128 + 64) + (1 << 20);
    room_for_products()?;
    let found = covered("singular values", bytes, || {
        Mat::from_fn(rows, columns, |i, j| a[i * columns + j] / scale).singular_values()
    })?;
    let mut values = found.map_err(|_| Error::Numerical("the singular values of a matrix did not converge".into()))?;
    values.iter_mut().for_each(|value| *value *= scale);
    Ok(values)
}

/// `||Q||_2` of a symmetric matrix given row by row, 0 of an empty one.
///
/// # Errors
/// [`Error::Numerical`], [`Error::Memory`].
pub(crate) fn symmetric_norm(q: &[f64], n: usize) -> Result<f64> {
    if n == 0 {
        return Ok(0.0);
    }
    let scale = power_of_two_scale(q);
    room_for_products()?;
    let found = covered("the norm of a symmetric matrix", svd_bytes(n, n), || {
        Mat::from_fn(n, n, |i, j| q[i * n + j] / scale).self_adjoint_eigenvalues(Side::Lower)
    })?;
    let values = found.map_err(|_| Error::Numerical("the eigenvalues of a matrix did not converge".into()))?;
    Ok(scale * values.iter().fold(0.0f64, |m, v| m.max(v.abs())))
}

/// The first `rank` columns, one after the other.
fn by_vector(what: &'static str, columns: &Mat<f64>, rank: usize) -> Result<Vec<f64>> {
    let length = columns.nrows();
    let mut out = try_zeros(what, rank * length)?;
    for (k, vector) in out.chunks_exact_mut(length).enumerate() {
        vector.iter_mut().enumerate().for_each(|(j, entry)| *entry = columns[(j, k)]);
    }
    Ok(out)
}

/// `M = sum_k s_k u_k v_k'`, `s` decreasing; `u` and `v` vector by vector.
#[derive(Debug)]
pub(crate) struct Singular {
    pub u: Vec<f64>,
    pub s: Vec<f64>,
    pub v: Vec<f64>,
}

/// The singular values and vectors of a small `rows x cols` matrix, given row by row.
///
/// # Errors
/// [`Error::Overflow`] for entries that are not finite, [`Error::Numerical`] if it fails, [`Error::Memory`].
pub(crate) fn singular(m: &[f64], rows: usize, cols: usize) -> Result<Singular> {
    const WHAT: &str = "the singular value decomposition of a matrix";
    if !m.iter().all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: WHAT });
    }
    let (least, scale) = (rows.min(cols), power_of_two_scale(m));
    if least == 0 {
        return Ok(Singular { u: Vec::new(), s: Vec::new(), v: Vec::new() });
    }
    room_for_products()?;
    covered(WHAT, svd_bytes(rows, cols), || {
        let (u, mut s, v) = thin_svd(Mat::from_fn(rows, cols, |i, j| m[i * cols + j] / scale).as_ref())?;
        s.iter_mut().for_each(|s| *s *= scale);
        Ok(Singular { u: by_vector(WHAT, &u, least)?, s, v: by_vector(WHAT, &v, least)? })
    })?
}

/// Bytes for copies of the matrix, its factors, the bidiagonal matrix, and blocks of reflections.
fn svd_bytes(rows: usize, cols: usize) -> u128 {
    let (large, small) = (rows.max(cols) as u128, rows.min(cols) as u128);
    8 * (8 * (large + 64) * (small + 8) + 8 * (small + 8) * (small + 8)) + (1 << 16)
}

type Factors = (Mat<f64>, Vec<f64>, Mat<f64>);

/// `U, S, V` with `B = U S V^T`; the transpose is tried where the iteration does not converge.
#[expect(clippy::disallowed_methods, reason = "called under `covered`")]
fn thin_svd(b: MatRef<'_, f64>) -> Result<Factors> {
    let factors = |m: MatRef<'_, f64>| {
        let svd = m.thin_svd().ok()?;
        let s: Vec<f64> = svd.S().column_vector().iter().copied().collect();
        let (u, v) = (svd.U().to_owned(), svd.V().to_owned());
        // refuses a wrong SVD: ||B||_F^2 = sum sigma^2
        let squares: f64 = s.iter().map(|s| s * s).sum();
        let agrees = (squares - m.squared_norm_l2()).abs() <= 1e-10 * squares.max(f64::MIN_POSITIVE);
        agrees.then_some((u, s, v))
    };
    factors(b)
        .or_else(|| factors(b.transpose()).map(|(u, s, v)| (v, s, u)))
        .ok_or_else(|| Error::Numerical("the singular value decomposition of a matrix did not converge".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn product(a: &[f64], b: &[f64], n: usize, k: usize, m: usize) -> Vec<f64> {
        let mut c = vec![0.0; n * m];
        for i in 0..n {
            for l in 0..k {
                for j in 0..m {
                    c[i * m + j] += a[i * k + l] * b[l * m + j];
                }
            }
        }
        c
    }

    fn close(a: &[f64], b: &[f64], tol: f64) -> bool {
        let scale = b.iter().fold(1e-300f64, |m, v| m.max(v.abs()));
        a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tol * scale)
    }

    #[test]
    fn penrose_identities_and_rank() {
        let ones: Vec<f64> = vec![1.0; 15];
        let cases: [(&[f64], usize, usize, usize); 6] = [
            (&[2.0], 1, 1, 1),
            (&ones, 3, 5, 1),
            (&[1.0, 2.0, 2.0, 2.0, -1.0, -1.0, 2.0, 1.0, -1.0], 3, 3, 3),
            (&[1.0, 0.0, 0.0, 1.0, 1.0, 1.0], 3, 2, 2),
            (&[0.0, 0.0], 1, 2, 0),
            (&[1e300, 0.0, 0.0, 1e290], 2, 2, 2),
        ];
        for (b, n, m, rank) in cases {
            let p = pseudoinverse(b, n, m).unwrap();
            assert_eq!(p.rank, rank);
            let bp = product(b, &p.matrix, n, m, n);
            let pb = product(&p.matrix, b, m, n, m);
            assert!(close(&product(&bp, b, n, n, m), b, 1e-13));
            assert!(close(&product(&pb, &p.matrix, m, m, n), &p.matrix, 1e-13));
            // the basis is orthonormal and spans the range: B B^+ = sum_k q_k q_k^T
            let q = |k: usize, i: usize| p.basis[k * n + i];
            for i in 0..n {
                for j in 0..n {
                    assert!((bp[i * n + j] - bp[j * n + i]).abs() < 1e-13);
                    let sum: f64 = (0..rank).map(|k| q(k, i) * q(k, j)).sum();
                    assert!((bp[i * n + j] - sum).abs() < 1e-13);
                }
            }
            // B = sum_k sigma_k q_k r_k^T
            for (i, j) in (0..n).flat_map(|i| (0..m).map(move |j| (i, j))) {
                let sum: f64 = (0..rank).map(|k| p.singular_values[k] * q(k, i) * p.right[k * m + j]).sum();
                assert!((sum - b[i * m + j]).abs() <= 1e-13 * p.singular_values[0]);
            }
            for (k, l) in (0..rank).flat_map(|k| (0..rank).map(move |l| (k, l))) {
                let sum: f64 = (0..n).map(|i| q(k, i) * q(l, i)).sum();
                assert!((sum - f64::from(u8::from(k == l))).abs() < 1e-13);
            }
        }
    }
}
