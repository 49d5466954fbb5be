//! Ensembles given as dense samples: `rows` is `N x D`, one realization per row.

use std::borrow::Cow;
use std::ops::Range;

use super::operator::{Operator, Precondition, Residual};
use super::parallel;
use super::problem::SEARCH;
use super::triangle::Triangle;
use crate::compensated::{Sum, dot as compensated_dot, two_product, two_sum};
use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_room, try_zeros};
use crate::vector::{axpy, dot};

/// A dense ensemble, possibly with the zero realization appended.
#[derive(Clone)]
pub(crate) struct Dense<'a> {
    rows: Cow<'a, [f64]>,
    stored: usize,
    dim: usize,
    zero: bool,
    threads: usize,
}

impl<'a> Dense<'a> {
    /// The caller guarantees `rows.len() = N * dim`.
    pub fn new(rows: impl Into<Cow<'a, [f64]>>, dim: usize, zero: bool, threads: usize) -> Self {
        let rows = rows.into();
        let stored = rows.len() / dim;
        Self { rows, stored, dim, zero, threads }
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.rows[i * self.dim..(i + 1) * self.dim]
    }
}

impl Operator for Dense<'_> {
    fn size(&self) -> usize {
        self.stored + usize::from(self.zero)
    }

    fn dim(&self) -> usize {
        self.dim
    }

    fn entries(&self) -> usize {
        self.dim
    }

    fn apply(&self, w: &[f64], out: &mut [f64]) -> Result<()> {
        out.fill(0.0);
        parallel::accumulate(self.threads, self.stored, self.dim, out, |range, out| {
            for i in range {
                if w[i] != 0.0 {
                    axpy(w[i], self.row(i), out);
                }
            }
        })
    }

    fn apply_transpose(&self, y: &[f64], out: &mut [f64]) -> Result<()> {
        let (stored, rest) = out.split_at_mut(self.stored);
        parallel::fill(self.threads, self.dim, stored, |first, out| {
            for (i, out) in out.iter_mut().enumerate() {
                *out = dot(self.row(first + i), y);
            }
        })?;
        rest.fill(0.0);
        Ok(())
    }

    fn normal(&self, y: &[f64], out: &mut [f64]) -> Result<f64> {
        out.fill(0.0);
        parallel::accumulate(self.threads, self.stored, self.dim, out, |range, out| {
            let mut total = 0.0;
            for i in range {
                let v = dot(self.row(i), y);
                total += v;
                axpy(v, self.row(i), out);
            }
            total
        })
    }

    fn subset(&self, keep: &[usize]) -> Result<Box<dyn Operator + '_>> {
        let mut rows = try_room(SEARCH, checked_len(SEARCH, keep.len(), self.dim)?)?;
        let mut zero = false;
        for &i in keep {
            if i < self.stored {
                rows.extend_from_slice(self.row(i));
            } else {
                zero = self.zero;
            }
        }
        let stored = rows.len() / self.dim;
        Ok(Box::new(Self { rows: Cow::Owned(rows), stored, dim: self.dim, zero, threads: self.threads }))
    }

    fn covering(&self, first: usize, _copies: f64, _counts: &[f64]) -> Result<Vec<usize>> {
        try_collect(SEARCH, (0..first.min(self.stored)).chain(self.stored..self.size()))
    }

    fn gram_row(&self, i: usize, _table: &mut [f64], out: &mut [f64]) {
        for (k, out) in out.iter_mut().enumerate() {
            *out = if i < self.stored { dot(self.row(i), self.row(k)) } else { 0.0 };
        }
    }

    fn add_outer(&self, samples: Range<usize>, matrix: &mut Triangle) -> Result<()> {
        for i in samples.start..samples.end.min(self.stored) {
            let row = self.row(i);
            for (k, &v) in row.iter().enumerate() {
                axpy(v, &row[..=k], matrix.row_mut(k));
            }
        }
        Ok(())
    }

    fn squared_norm(&self, i: usize) -> f64 {
        if i < self.stored { dot(self.row(i), self.row(i)) } else { 0.0 }
    }

    fn block(&self, mu: f64) -> Result<Box<dyn Precondition>> {
        // D_k = sum_i (E_ik - mean_k)^2 + mu
        let size = self.size() as f64;
        let (mut squares, mut sums): (Vec<f64>, Vec<f64>) =
            (try_zeros(SEARCH, self.dim)?, try_zeros(SEARCH, self.dim)?);
        for i in 0..self.stored {
            for ((s, m), v) in squares.iter_mut().zip(&mut sums).zip(self.row(i)) {
                *s += v * v;
                *m += v;
            }
        }
        let largest = squares.iter().fold(0.0_f64, |a, &b| a.max(b));
        for (s, m) in squares.iter_mut().zip(&sums) {
            *s = 1.0 / ((*s - m * m / size).max(1e-12 * largest) + mu);
        }
        Ok(Box::new(Jacobi { inverse: squares }))
    }

    fn residual_compensated(&self, w: &[f64], target: &[f64]) -> Result<Residual> {
        let (mut high, mut low) = (try_zeros(SEARCH, self.dim)?, try_zeros(SEARCH, self.dim)?);
        for (i, &weight) in w.iter().enumerate().take(self.stored) {
            if weight != 0.0 {
                for ((h, l), &v) in high.iter_mut().zip(&mut low).zip(self.row(i)) {
                    let (p, e) = two_product(weight, v);
                    let (s, f) = two_sum(*h, p);
                    *h = s;
                    *l += e + f;
                }
            }
        }
        let (mut residual, mut image) = (high, low);
        for ((r, x), &t) in residual.iter_mut().zip(&mut image).zip(target) {
            let rest = *x;
            let p = *r;
            let (s, e) = two_sum(p, -t);
            *r = s + (e + rest);
            *x = p + rest;
        }
        Ok(Residual { residual, image })
    }

    fn value_compensated(&self, i: usize, y: &[f64]) -> (f64, f64) {
        if i < self.stored { compensated_dot(self.row(i), y) } else { Sum::default().pair() }
    }
}

/// Diagonal preconditioner: the centred second moments of the samples.
pub(crate) struct Jacobi {
    inverse: Vec<f64>,
}

impl Precondition for Jacobi {
    fn solve(&self, r: &[f64], out: &mut [f64]) {
        for ((z, r), d) in out.iter_mut().zip(r).zip(&self.inverse) {
            *z = d * r;
        }
    }
}
