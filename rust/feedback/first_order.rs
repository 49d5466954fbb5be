//! The first order of one constant member: `e1(k) = sum_j A0^(k-1-j) D G c(j)`, linear in G.

use faer::Mat;

use crate::error::Result;

use super::data::{Matrix, Piece, lost, size_of};
use super::loops::Loop;
use super::member::clipped;
use super::tube::ROUNDING;

/// Of each part.
struct Sum {
    /// D at all rows, and the rank of E.
    root: Matrix,
    rank: usize,
    /// `sum_j (c_j)_i A0^(k-1-j) D`, side by side for all i.
    sum: Matrix,
    /// `sqrt(t)` of its multiplier.
    scale: f64,
}

/// The sums of a run so far.
pub(super) struct FirstOrder<'a> {
    of: &'a Loop,
    sums: Vec<Sum>,
}

impl<'a> FirstOrder<'a> {
    pub fn new(of: &'a Loop) -> Self {
        let (n, mut sums) = (of.data.n, Vec::new());
        for ((piece, e), t) in of.data.pieces.iter().zip(&of.closed.e).zip(&of.closed.t) {
            let (width, rank) = (piece.rows.len(), e.nrows());
            let mut root = Mat::<f64>::zeros(n, width);
            for (i, row) in piece.rows.iter().enumerate() {
                (0..width).for_each(|j| root[(*row, j)] = piece.root[(i, j)]);
            }
            sums.push(Sum { root, rank, sum: Mat::zeros(n, width * rank), scale: t.sqrt() });
        }
        Self { of, sums }
    }

    fn parts(&self) -> impl Iterator<Item = (&'a Piece, &Sum)> {
        self.of.data.pieces.iter().zip(&self.sums)
    }

    /// The supremum of `h'e1(k)`, h (1, n): `max <G, X>` of each part, `X = sum_j D' A0'^(k-1-j) h c_j'`.
    ///
    /// # Errors
    /// [`crate::Error::Numerical`].
    pub fn along(&self, h: &Matrix) -> Result<f64> {
        let mut found = 0.0;
        for (piece, Sum { root, rank, sum, .. }) in self.parts() {
            let (line, width) = (h * sum, root.ncols());
            if *rank == 0 || width == 0 {
                continue;
            }
            let unit = size_of(&line);
            let x = Mat::from_fn(*rank, width, |i, j| line[(0, i * width + j)] / unit);
            found += unit * clipped(&x.singular_values().map_err(lost)?, piece.rho, self.of.data.phi).0;
        }
        Ok(found * (1.0 + ROUNDING))
    }

    /// Of a region of one part: that part, its rank, and the sum, the map from vec(G) to `e1(k)`.
    pub fn single(&self) -> Option<(&'a Piece, usize, &Matrix)> {
        let mut parts = self.parts();
        parts.next().filter(|_| self.sums.len() == 1).map(|(piece, one)| (piece, one.rank, &one.sum))
    }

    /// One step further, with `c` of all parts as `Way::forcing` has it.
    pub fn push(&mut self, c: &[f64]) {
        let (a0, mut at) = (&self.of.closed.a0, 0);
        for Sum { root, rank, sum, scale } in &mut self.sums {
            let (width, mut next) = (root.ncols(), a0 * &*sum);
            for i in 0..*rank {
                for j in 0..width {
                    (0..a0.nrows()).for_each(|a| next[(a, i * width + j)] += c[at + i] * *scale * root[(a, j)]);
                }
            }
            *sum = next;
            at += *rank;
        }
    }
}
