//! Cholesky factor of a symmetric positive definite matrix held as a [`Triangle`].
//!
//! By panels, with the products and small triangular solves of `faer`. The limits are checked between two blocks, since
//! a factor of ten thousand rows takes seconds.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltParams, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Accum, ColMut, ColRef, Par, Spec};

use super::budget::Budget;
use super::problem::SEARCH;
use super::triangle::{PANEL, Triangle};
use crate::error::{Error, Result};
use crate::memory::room_for_products;

/// Rows above which no factor is computed (400 MB of memory).
pub(crate) const LARGEST_FACTOR: usize = 10_000;

/// Cost of a factor of `k` rows, in indices touched by a pass (measured: 0.3 ns each, `k^3 / 3` operations at 40 GF/s).
pub(crate) fn factor_cost(k: usize) -> f64 {
    let k = k as f64;
    k * k * k / 40.0
}

/// Cost of one solve with it, in the same unit: the factor is read twice.
pub(crate) fn solve_cost(k: usize) -> f64 {
    let k = k as f64;
    k * k
}

/// `M = L L^T`
pub(crate) struct Factor {
    lower: Triangle,
}

impl Factor {
    /// Factors `matrix` in place; `None` if a pivot is not positive or a limit is reached.
    pub fn new(mut matrix: Triangle, budget: &mut Budget) -> Result<Option<Self>> {
        room_for_products()?;
        let parameters: Spec<LltParams, f64> = Spec::default();
        let scratch = cholesky_in_place_scratch::<f64>(PANEL, Par::Seq, parameters);
        let bytes = scratch.unaligned_bytes_required() as u128;
        let mut memory = MemBuffer::try_new(scratch).map_err(|_| Error::Memory { what: SEARCH, bytes })?;
        for (p, rows) in matrix.panels().enumerate() {
            let (before, mut panel) = matrix.split(p);
            for q in 0..p {
                if budget.poll() {
                    return Ok(None);
                }
                // A_pq <- (A_pq - sum_{r < q} L_pr L_qr^T) L_qq^{-T}
                let other = before(q);
                let (known, rest) = panel.as_mut().split_at_col_mut(q * PANEL);
                let mut block = rest.subcols_mut(0, PANEL);
                let (left, diagonal) = other.split_at_col(q * PANEL);
                matmul(block.as_mut(), Accum::Add, known.as_ref(), left.transpose(), -1.0, Par::Seq);
                solve_lower_triangular_in_place(diagonal, block.transpose_mut(), Par::Seq);
            }
            // L_pp L_pp^T = A_pp - sum_{r < p} L_pr L_pr^T
            let (known, mut block) = panel.split_at_col_mut(rows.start);
            matmul(block.as_mut(), Accum::Add, known.as_ref(), known.as_ref().transpose(), -1.0, Par::Seq);
            let stack = MemStack::new(&mut memory);
            let done = cholesky_in_place(block.as_mut(), Default::default(), Par::Seq, stack, parameters);
            if done.is_err() || !(0..rows.len()).all(|i| block[(i, i)] > 0.0 && block[(i, i)].is_finite()) {
                return Ok(None);
            }
        }
        Ok(Some(Self { lower: matrix }))
    }

    /// `x <- M^{-1} x`
    pub fn solve(&self, x: &mut [f64]) {
        // L y = x, from the first panel where x is not zero
        let first = x.iter().position(|v| *v != 0.0).unwrap_or(0) / PANEL;
        for (p, rows) in self.lower.panels().enumerate().skip(first) {
            let (left, diagonal) = self.lower.panel(p).split_at_col(rows.start);
            let left = left.subcols(first * PANEL, rows.start - first * PANEL);
            let (known, rest) = x[first * PANEL..].split_at_mut(rows.start - first * PANEL);
            let mut here = ColMut::from_slice_mut(&mut rest[..rows.len()]);
            matmul(here.as_mut().as_mat_mut(), Accum::Add, left, ColRef::from_slice(known).as_mat(), -1.0, Par::Seq);
            solve_lower_triangular_in_place(diagonal, here.as_mat_mut(), Par::Seq);
        }
        // L^T x = y
        for (p, rows) in self.lower.panels().enumerate().rev() {
            let (left, diagonal) = self.lower.panel(p).split_at_col(rows.start);
            let (unknown, rest) = x.split_at_mut(rows.start);
            let mut here = ColMut::from_slice_mut(&mut rest[..rows.len()]);
            solve_upper_triangular_in_place(diagonal.transpose(), here.as_mut().as_mat_mut(), Par::Seq);
            let above = ColMut::from_slice_mut(unknown).as_mat_mut();
            matmul(above, Accum::Add, left.transpose(), here.as_ref().as_mat(), -1.0, Par::Seq);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parallel::Stop;
    use std::time::Duration;

    fn entry(size: usize, i: usize, j: usize) -> f64 {
        if i == j { size as f64 } else { ((i * 7 + j * 13) % 11) as f64 / 11.0 - 0.3 }
    }

    fn matrix(size: usize) -> Triangle {
        let mut matrix = Triangle::zeros(size).unwrap();
        for i in 0..size {
            for (j, v) in matrix.row_mut(i).iter_mut().enumerate() {
                *v = entry(size, i, j);
            }
        }
        matrix
    }

    #[test]
    fn a_random_matrix_is_solved_to_rounding() {
        let stop = Stop::new();
        for size in [1, 2, 5, 127, 128, 129, 257, 301] {
            let x: Vec<f64> = (0..size).map(|i| (i as f64).sin()).collect();
            let mut b: Vec<f64> =
                (0..size).map(|i| (0..size).map(|j| entry(size, i.max(j), i.min(j)) * x[j]).sum()).collect();
            Factor::new(matrix(size), &mut Budget::new(&stop, None, 1, 1)).unwrap().unwrap().solve(&mut b);
            for (b, x) in b.iter().zip(&x) {
                assert!((b - x).abs() < 1e-12, "size {size}: {b} {x}");
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let stop = Stop::new();
        let mut bad = matrix(200);
        bad.row_mut(170)[170] = 0.1;
        assert!(Factor::new(bad, &mut Budget::new(&stop, None, 1, 1)).unwrap().is_none());
    }

    #[test]
    fn a_limit_ends_a_factorization() {
        let stop = Stop::new();
        let mut budget = Budget::new(&stop, Some(Duration::ZERO), 1, 1);
        assert!(Factor::new(matrix(300), &mut budget).unwrap().is_none());
        assert!(budget.exhausted());
    }
}
