//! Products, roots, eigenvalues and singular values of the matrices of a problem, row by row.

use crate::control::{Singular, singular};
use crate::error::{Error, Result};
use crate::memory::{covered, try_collect, try_copy};
use crate::scaled;

pub(super) use crate::control::{singular_values, times};

use faer::MatRef;

const WHAT: &str = "a control within limits";

/// `0 x infinity = 0`: nothing to bound.
pub(super) fn product(a: f64, b: f64) -> f64 {
    if a == 0.0 || b == 0.0 { 0.0 } else { a * b }
}

/// `||v||_2`, without overflow or underflow.
pub(super) fn norm(v: &[f64]) -> f64 {
    scaled::norm(v.iter().copied())
}

/// `out += A' v`
pub(super) fn add_transposed(a: &[f64], v: &[f64], out: &mut [f64]) {
    for (row, v) in a.chunks_exact(out.len().max(1)).zip(v) {
        out.iter_mut().zip(row).for_each(|(out, a)| *out += a * v);
    }
}

/// `v' Q v`
pub(super) fn form(q: &[f64], v: &[f64]) -> f64 {
    q.chunks_exact(v.len().max(1)).zip(v).map(|(row, v_i)| v_i * crate::vector::dot(row, v)).sum()
}

fn diagonal(q: &[f64], n: usize) -> bool {
    q.iter().enumerate().all(|(i, v)| *v == 0.0 || i % (n + 1) == 0)
}

/// The diagonal of `Q` where there is nothing else.
pub(super) fn only_diagonal(q: &[f64], n: usize) -> Result<Option<Vec<f64>>> {
    if diagonal(q, n) { try_collect(WHAT, q.iter().step_by(n + 1).copied()).map(Some) } else { Ok(None) }
}

/// `F` (rank, n) with `F'F = Q`, without the rows that are 0; eigenvalues up to `n eps ||Q||` count as 0.
///
/// # Errors
/// [`Error::Numerical`], [`Error::Memory`].
pub fn root(q: &[f64], n: usize) -> Result<Vec<f64>> {
    let mut rows = Vec::new();
    let mut add = |value: f64, vector: &dyn Fn(usize) -> f64| {
        let size = value.sqrt();
        crate::memory::try_extend(WHAT, &mut rows, (0..n).map(|i| size * vector(i)))
    };
    if diagonal(q, n) {
        for (j, value) in q.iter().step_by(n + 1).enumerate().filter(|(_, value)| **value > 0.0) {
            add(*value, &|i| f64::from(u8::from(i == j)))?;
        }
        return Ok(rows);
    }
    let (values, vectors) = eigen(q, n)?;
    let least = n as f64 * f64::EPSILON * values.last().copied().unwrap_or(0.0).max(0.0);
    for (value, vector) in values.iter().zip(vectors.chunks_exact(n)).filter(|(value, _)| **value > least) {
        add(*value, &|i| vector[i])?;
    }
    Ok(rows)
}

/// The least eigenvalue of the symmetric `Q`.
pub(super) fn least_eigenvalue(q: &[f64], n: usize) -> Result<f64> {
    if diagonal(q, n) {
        return Ok(q.iter().step_by(n + 1).fold(f64::INFINITY, |least, v| least.min(*v)));
    }
    Ok(eigen(q, n)?.0.first().copied().unwrap_or(0.0))
}

/// Rising eigenvalues of the symmetric `Q`, and its eigenvectors one by one.
pub(crate) fn eigen(q: &[f64], n: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    let found = covered(WHAT, room(n, n), || decomposed(q, n))??;
    let values = try_copy(WHAT, &found.0)?;
    Ok((values, found.1))
}

#[expect(clippy::disallowed_methods, reason = "called under `covered`")]
fn decomposed(q: &[f64], n: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    let lost = |_| Error::Numerical("the eigenvalues of a weight did not converge".into());
    let found = MatRef::from_row_major_slice(q, n, n).self_adjoint_eigen(faer::Side::Lower).map_err(lost)?;
    let (values, vectors) = (found.S().column_vector(), found.U());
    let entries = (0..n).flat_map(|j| (0..n).map(move |i| vectors[(i, j)]));
    Ok((values.iter().copied().collect(), entries.collect()))
}

/// Bytes of a decomposition of `rows` x `columns`, at most.
fn room(rows: usize, columns: usize) -> u128 {
    let (most, least) = (rows.max(columns) as u128, rows.min(columns) as u128);
    8 * (8 * most * (least + 64) + 64 * (least + 64)) + (1 << 20)
}

/// `||A||_2`
pub(super) fn spectral(a: &[f64], columns: usize) -> Result<f64> {
    if a.len() == 1 || columns == 1 || a.len() == columns {
        return Ok(norm(a));
    }
    Ok(singular_values(a, columns)?.first().copied().unwrap_or(0.0))
}

/// `A = U diag(s) V'` with falling `s > tiny`, `tiny = max(rows, columns) eps s_0`: vectors one by one.
pub(crate) struct Decomposition {
    pub(crate) u: Vec<f64>,
    pub(crate) s: Vec<f64>,
    pub(crate) v: Vec<f64>,
    pub(crate) tiny: f64,
}

/// The decomposition of `A`.
pub(crate) fn decomposition(a: &[f64], columns: usize) -> Result<Decomposition> {
    let rows = a.len().checked_div(columns).unwrap_or(0);
    let Singular { mut u, mut s, mut v } = singular(a, rows, columns)?;
    let tiny = rows.max(columns) as f64 * f64::EPSILON * s.first().copied().unwrap_or(0.0);
    s.retain(|s| *s > tiny);
    u.truncate(s.len() * rows);
    v.truncate(s.len() * columns);
    Ok(Decomposition { u, s, v, tiny })
}
