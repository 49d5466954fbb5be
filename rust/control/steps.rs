//! The minimum-norm control over several steps.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::pseudoinverse::pseudoinverse;
use crate::error::Result;
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_zeros};

/// `C_K^+ (xf - A^K x0)` with `C_K = [B, A B, ..., A^{K-1} B]`: the controls in the order of its blocks, u(K-1), ...,
/// u(0); and a bound on their rounding error. The matrices are given row by row.
///
/// Rounding: `K theta condition ||u||`, `theta = (2 max(n, m K) + 4) eps`, the backward error of the factors and of the
/// powers of `A` (Wedin, BIT 13 (1973) 217-232).
///
/// # Errors
/// As [`pseudoinverse`](super::pseudoinverse()).
pub(crate) fn steps_control(a: &[f64], b: &[f64], x0: &[f64], xf: &[f64], steps: usize) -> Result<(Vec<f64>, f64)> {
    let what = "a control over several steps";
    let n = x0.len();
    let m = b.len() / n;
    let width = checked_len(what, m, steps)?;
    room_for_products()?;
    let a = MatRef::from_row_major_slice(a, n, n);
    let mut c: Vec<f64> = try_zeros(what, checked_len(what, n, width)?)?;
    let (mut block, mut next) = (try_copy(what, b)?, try_zeros(what, b.len())?);
    let (mut free, mut moved) = (try_copy(what, x0)?, try_zeros(what, n)?);
    for k in 0..steps {
        for (row, block) in c.chunks_exact_mut(width).zip(block.chunks_exact(m)) {
            row[k * m..(k + 1) * m].copy_from_slice(block);
        }
        let product = |x: &[f64], out: &mut [f64], cols| {
            let out = MatMut::from_row_major_slice_mut(out, n, cols);
            matmul(out, Accum::Replace, a, MatRef::from_row_major_slice(x, n, cols), 1.0, Par::Seq);
        };
        product(&free, &mut moved, 1);
        std::mem::swap(&mut free, &mut moved);
        if k + 1 < steps {
            product(&block, &mut next, m);
            std::mem::swap(&mut block, &mut next);
        }
    }
    let factors = pseudoinverse(&c, n, width)?;
    let needed = try_collect(what, xf.iter().zip(&free).map(|(xf, free)| xf - free))?;
    let mut u: Vec<f64> = try_zeros(what, width)?;
    // C^+ y = sum_k v_k <u_k, y> / sigma_k
    let directions = factors.basis.chunks_exact(n).zip(factors.right.chunks_exact(width));
    for ((left, right), sigma) in directions.zip(&factors.singular_values) {
        let size: f64 = left.iter().zip(&needed).map(|(l, y)| l * y).sum::<f64>() / sigma;
        u.iter_mut().zip(right).for_each(|(u, v)| *u += size * v);
    }
    let theta = (2 * n.max(width) + 4) as f64 * f64::EPSILON;
    let size = u.iter().map(|u| u * u).sum::<f64>().sqrt();
    let rounding = if size > 0.0 { steps as f64 * theta * factors.condition * size } else { 0.0 };
    Ok((u, rounding))
}
