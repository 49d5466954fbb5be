//! The minimum-norm control over several steps.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, ColMut, MatMut, MatRef, Par, Spec};

use super::pseudoinverse::pseudoinverse;
use crate::error::{Error, Result};
use crate::fuse::power_of_two_scale;
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_zeros};
use crate::vector::dot;

const WHAT: &str = "a control over several steps";

/// `C_K^+ (xf - A^K x0)` with `C_K = [B, A B, ..., A^{K-1} B]`: the controls in the order of its blocks, u(K-1), ...,
/// u(0); and a bound on their rounding error. The matrices are given row by row.
///
/// Rounding: `K theta condition ||u||`, `theta = (2 max(n, m K) + 4) eps`, the backward error of the factors and of the
/// powers of `A` (Wedin, BIT 13 (1973) 217-232).
///
/// # Errors
/// As [`pseudoinverse`](super::pseudoinverse()).
pub(crate) fn steps_control(a: &[f64], b: &[f64], x0: &[f64], xf: &[f64], steps: usize) -> Result<(Vec<f64>, f64)> {
    let what = WHAT;
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
    let needed = try_collect(what, xf.iter().zip(&free).map(|(xf, free)| xf - free))?;
    let (u, condition) = match full_rank(&c, &needed, width)? {
        Some(found) => found,
        None => any_rank(&c, &needed, width)?,
    };
    let theta = (2 * n.max(width) + 4) as f64 * f64::EPSILON;
    let size = u.iter().map(|u| u * u).sum::<f64>().sqrt();
    let rounding = if size > 0.0 { steps as f64 * theta * condition * size } else { 0.0 };
    Ok((u, rounding))
}

/// `C^+ y = sum_k v_k <u_k, y> / sigma_k`, and the condition of `C`.
fn any_rank(c: &[f64], y: &[f64], width: usize) -> Result<(Vec<f64>, f64)> {
    let n = y.len();
    let factors = pseudoinverse(c, n, width)?;
    let mut u: Vec<f64> = try_zeros(WHAT, width)?;
    let directions = factors.basis.chunks_exact(n).zip(factors.right.chunks_exact(width));
    for ((left, right), sigma) in directions.zip(&factors.singular_values) {
        let size = dot(left, y) / sigma;
        u.iter_mut().zip(right).for_each(|(u, v)| *u += size * v);
    }
    Ok((u, factors.condition))
}

/// `C^+ y = C'(CC')^{-1} y` for `C` of full row rank, refined once, and `||C||_F ||L^{-1}||_F`, `LL' = CC'`, which is
/// at least the condition of `C`: a tenth of the time of its singular values. `None` where the error of the refined
/// solution, the square of `width eps condition^2`, could exceed the `width eps condition` of a backward stable one.
fn full_rank(c: &[f64], y: &[f64], width: usize) -> Result<Option<(Vec<f64>, f64)>> {
    let n = y.len();
    let scale = power_of_two_scale(c);
    if width < n || n == 0 || !(scale > 0.0 && scale.is_finite()) {
        return Ok(None);
    }
    let scaled = try_collect(WHAT, c.iter().map(|v| v / scale))?;
    let square = checked_len(WHAT, n, n)?;
    let (mut lower, mut inverse): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, square)?, try_zeros(WHAT, square)?);
    let rows = MatRef::from_row_major_slice(&scaled, n, width);
    let out = MatMut::from_column_major_slice_mut(&mut lower, n, n);
    matmul(out, Accum::Replace, rows, rows.transpose(), 1.0, Par::Seq);
    let size = (0..n).map(|i| lower[i * n + i]).sum::<f64>().sqrt();
    let scratch = cholesky_in_place_scratch::<f64>(n, Par::Seq, Spec::default());
    let bytes = scratch.unaligned_bytes_required() as u128;
    let mut memory = MemBuffer::try_new(scratch).map_err(|_| Error::Memory { what: WHAT, bytes })?;
    let matrix = MatMut::from_column_major_slice_mut(&mut lower, n, n);
    let stack = MemStack::new(&mut memory);
    if cholesky_in_place(matrix, Default::default(), Par::Seq, stack, Spec::default()).is_err() {
        return Ok(None);
    }
    let factor = MatRef::from_column_major_slice(&lower, n, n);
    (0..n).for_each(|i| inverse[i * n + i] = 1.0);
    let columns = MatMut::from_column_major_slice_mut(&mut inverse, n, n);
    solve_lower_triangular_in_place(factor, columns, Par::Seq);
    let condition = size * dot(&inverse, &inverse).sqrt();
    // not a number or infinite after a pivot of zero
    if condition.is_nan() || condition.powi(3) * width as f64 * f64::EPSILON > 1.0 {
        return Ok(None);
    }
    let mut rest = try_copy(WHAT, y)?;
    let mut u: Vec<f64> = try_zeros(WHAT, width)?;
    for _ in 0..2 {
        let mut solved = ColMut::from_slice_mut(&mut rest);
        solve_lower_triangular_in_place(factor, solved.as_mut().as_mat_mut(), Par::Seq);
        solve_upper_triangular_in_place(factor.transpose(), solved.as_mat_mut(), Par::Seq);
        for (row, w) in scaled.chunks_exact(width).zip(&rest) {
            u.iter_mut().zip(row).for_each(|(u, c)| *u += w * c);
        }
        for ((rest, y), row) in rest.iter_mut().zip(y).zip(scaled.chunks_exact(width)) {
            *rest = y - dot(row, &u);
        }
    }
    u.iter_mut().for_each(|u| *u /= scale);
    Ok(Some((u, condition)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `C` with the condition about 10^`power`.
    fn graded(n: usize, width: usize, power: f64) -> Vec<f64> {
        let entry =
            |i: usize, j: usize| if i == j { 2.0 } else { (((i * 7 + j * 13) % 11) as f64 / 11.0 - 0.5) / n as f64 };
        let row = |i: usize| 10f64.powf(-power * i as f64 / (n - 1) as f64);
        (0..n * width).map(|at| 3e20 * row(at / width) * entry(at / width, at % width)).collect()
    }

    #[test]
    fn both_ways_give_one_control_within_the_stated_rounding() {
        for (n, width) in [(2, 2), (3, 7), (20, 40), (40, 40), (70, 200)] {
            for power in [0.0, 1.0, 2.0, 3.0] {
                let c = graded(n, width, power);
                let y: Vec<f64> = (0..n).map(|i| ((i * i) as f64).sin()).collect();
                let (u, condition) = full_rank(&c, &y, width).unwrap().unwrap();
                let (other, least) = any_rank(&c, &y, width).unwrap();
                assert!(least <= condition && condition <= 1.01 * n as f64 * least, "{n} {power}: {condition} {least}");
                let size = dot(&other, &other).sqrt();
                let apart = u.iter().zip(&other).map(|(u, v)| (u - v).powi(2)).sum::<f64>().sqrt();
                assert!(apart <= (2 * width + 4) as f64 * f64::EPSILON * least * size, "{n} {power}: {apart} {size}");
            }
        }
    }

    #[test]
    fn what_is_near_a_lower_rank_is_left_to_the_singular_values() {
        let y = [1.0, 2.0, 3.0];
        assert!(full_rank(&graded(3, 5, 8.0), &y, 5).unwrap().is_none());
        assert!(full_rank(&[0.0; 9], &y, 3).unwrap().is_none());
        assert!(full_rank(&[1.0; 12], &y, 4).unwrap().is_none());
        assert!(full_rank(&[1.0; 6], &y, 2).unwrap().is_none());
    }
}
