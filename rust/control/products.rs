//! Products of matrices, row by row.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::Result;
use crate::memory::{checked_len, room_for_products, try_zeros};

const WHAT: &str = "the product of matrices";

/// Rows from which a product is left to `faer`.
const BLOCKED: usize = 16;

/// `A B` (rows, columns) of `A` (rows, inner).
pub(crate) fn times(a: &[f64], b: &[f64], inner: usize) -> Result<Vec<f64>> {
    let (rows, columns) = (a.len().checked_div(inner).unwrap_or(0), b.len().checked_div(inner).unwrap_or(0));
    let mut out = try_zeros(WHAT, checked_len(WHAT, rows, columns)?)?;
    if rows.min(inner).min(columns) >= BLOCKED {
        room_for_products()?;
        let to = MatMut::from_row_major_slice_mut(&mut out, rows, columns);
        let (a, b) = (MatRef::from_row_major_slice(a, rows, inner), MatRef::from_row_major_slice(b, inner, columns));
        matmul(to, Accum::Replace, a, b, 1.0, Par::Seq);
        return Ok(out);
    }
    if inner > 0 && columns > 0 {
        for (a, out) in a.chunks_exact(inner).zip(out.chunks_exact_mut(columns)) {
            for (a, b) in a.iter().zip(b.chunks_exact(columns)) {
                out.iter_mut().zip(b).for_each(|(out, b)| *out += a * b);
            }
        }
    }
    Ok(out)
}

/// `A'` of `A` with so many columns.
pub(crate) fn transposed(a: &[f64], columns: usize) -> Result<Vec<f64>> {
    let rows = a.len().checked_div(columns).unwrap_or(0);
    let mut out = try_zeros(WHAT, a.len())?;
    for (i, row) in a.chunks_exact(columns.max(1)).enumerate() {
        out.iter_mut().skip(i).step_by(rows).zip(row).for_each(|(to, v)| *to = *v);
    }
    Ok(out)
}
