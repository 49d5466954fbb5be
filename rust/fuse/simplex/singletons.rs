//! Ensembles with one nonzero per line, held as indices: `E_i = sum_j g_j * unit(j, R_ij)`.
//!
//! Sign-free form: the caller flips entry `(j, r)` of the target by the sign the law puts there, so that all nonzeros
//! are `g_j >= 0`. The matrix is stored line by line, entry `k = j * length + r`. Products need no sparse matrix:
//!
//! * `S^T y`: a gather, `(S^T y)_i = sum_j T[j * length + R_ij]` from the table `T = g_j y_jr` multiplied once per
//!   pass;
//! * `S w`: a scatter, `c[j * length + R_ij] += w_i`, multiplied by `g_j` once at the end.

use std::borrow::Cow;
use std::ops::Range;

use super::kernel::{gather, scatter};
use super::operator::{Operator, Precondition, Residual};
use super::parallel;
use super::problem::SEARCH;
use super::triangle::Triangle;
use crate::compensated::{Sum, two_product, two_sum};
use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_extend, try_push, try_room, try_zeros};
use crate::sample::Index;

/// Samples whose indices stay in the first-level cache between the gather and the scatter.
const BLOCK: usize = 32;

/// An ensemble of singletons; `rows` is sample-major, `lines` entries per sample, each below `length`.
#[derive(Clone)]
pub(crate) struct Singletons<'a, I: Index> {
    rows: Cow<'a, [I]>,
    /// Realizations stored in `rows` (the zero realization is not).
    stored: usize,
    length: usize,
    g: &'a [f64],
    zero: bool,
    threads: usize,
    /// `||E_i||^2 = sum_j g_j^2`
    square: f64,
}

impl<'a, I: Index> Singletons<'a, I> {
    /// The caller guarantees `rows.len() = stored * g.len()` and every index `< length`.
    pub fn new(rows: &'a [I], length: usize, g: &'a [f64], zero: bool, threads: usize) -> Self {
        let stored = rows.len() / g.len();
        Self { rows: Cow::Borrowed(rows), stored, length, g, zero, threads, square: crate::vector::dot(g, g) }
    }

    fn row(&self, i: usize) -> &[I] {
        let m = self.g.len();
        &self.rows[i * m..(i + 1) * m]
    }

    /// The indices in line `j` of all stored realizations.
    pub fn line(&self, j: usize) -> Result<Vec<usize>> {
        try_collect(SEARCH, self.rows.iter().skip(j).step_by(self.g.len()).map(|r| r.get()))
    }

    fn premultiplied(&self, y: &[f64]) -> Result<Vec<f64>> {
        // T_jr = g_j y_jr
        let mut table = try_room(SEARCH, y.len())?;
        for (&g, line) in self.g.iter().zip(y.chunks_exact(self.length)) {
            table.extend(line.iter().map(|v| g * v));
        }
        Ok(table)
    }

    fn postmultiply(&self, out: &mut [f64]) {
        for (&g, line) in self.g.iter().zip(out.chunks_exact_mut(self.length)) {
            for v in line {
                *v *= g;
            }
        }
    }

    /// How often each entry is hit.
    pub fn counts(&self) -> Result<Vec<f64>> {
        let mut counts = try_zeros(SEARCH, self.dim())?;
        self.scatter_all(|_| 1.0, &mut counts)?;
        Ok(counts)
    }

    /// `out[k] = sum_{i: R_i hits k} weight(i)`
    fn scatter_all(&self, weight: impl Fn(usize) -> f64 + Sync, out: &mut [f64]) -> Result<()> {
        let m = self.g.len();
        parallel::accumulate(self.threads, self.stored, m, out, |range, out| {
            for i in range {
                let w = weight(i);
                if w != 0.0 {
                    scatter(self.row(i), self.length, w, out);
                }
            }
        })
    }
}

impl<I: Index> Operator for Singletons<'_, I> {
    fn size(&self) -> usize {
        self.stored + usize::from(self.zero)
    }

    fn dim(&self) -> usize {
        self.g.len() * self.length
    }

    fn entries(&self) -> usize {
        self.g.len()
    }

    fn apply(&self, w: &[f64], out: &mut [f64]) -> Result<()> {
        out.fill(0.0);
        self.scatter_all(|i| w[i], out)?;
        self.postmultiply(out);
        Ok(())
    }

    fn apply_transpose(&self, y: &[f64], out: &mut [f64]) -> Result<()> {
        let table = self.premultiplied(y)?;
        let (stored, rest) = out.split_at_mut(self.stored);
        let m = self.g.len();
        parallel::fill(self.threads, m, stored, |first, out| {
            gather(&self.rows[first * m..(first + out.len()) * m], m, self.length, &table, out);
        })?;
        rest.fill(0.0);
        Ok(())
    }

    fn normal(&self, y: &[f64], out: &mut [f64]) -> Result<f64> {
        let table = self.premultiplied(y)?;
        out.fill(0.0);
        let total = parallel::accumulate(self.threads, self.stored, self.g.len(), out, |range, out| {
            let (m, mut total, mut values) = (self.g.len(), 0.0, [0.0; BLOCK]);
            for rows in self.rows[range.start * m..range.end * m].chunks(BLOCK * m) {
                let values = &mut values[..rows.len() / m];
                gather(rows, m, self.length, &table, values);
                for (row, &v) in rows.chunks_exact(m).zip(&*values) {
                    total += v;
                    scatter(row, self.length, v, out);
                }
            }
            total
        })?;
        self.postmultiply(out);
        Ok(total)
    }

    fn subset(&self, keep: &[usize]) -> Result<Box<dyn Operator + '_>> {
        let m = self.g.len();
        let mut rows = try_room(SEARCH, checked_len(SEARCH, keep.len(), m)?)?;
        let mut zero = false;
        for &i in keep {
            if i < self.stored {
                rows.extend_from_slice(self.row(i));
            } else {
                zero = self.zero;
            }
        }
        let stored = rows.len() / m;
        Ok(Box::new(Self { rows: Cow::Owned(rows), stored, zero, ..*self }))
    }

    fn covering(&self, first: usize, copies: f64, counts: &[f64]) -> Result<Vec<usize>> {
        let first = first.min(self.stored);
        let mut keep: Vec<usize> = try_collect(SEARCH, 0..first)?;
        let mut missing: Vec<f64> = try_collect(SEARCH, counts.iter().map(|c| c.min(copies)))?;
        let mut open: f64 = crate::vector::sum(&missing);
        for i in 0..self.stored {
            if open <= 0.0 {
                break;
            }
            let mut useful = false;
            for (r, line) in self.row(i).iter().zip(missing.chunks_exact_mut(self.length)) {
                if line[r.get()] > 0.0 {
                    line[r.get()] -= 1.0;
                    open -= 1.0;
                    useful = true;
                }
            }
            if useful && i >= first {
                try_push(SEARCH, &mut keep, i)?;
            }
        }
        try_extend(SEARCH, &mut keep, self.stored..self.size())?;
        Ok(keep)
    }

    fn gram_row(&self, i: usize, table: &mut [f64], out: &mut [f64]) {
        if i >= self.stored {
            out.fill(0.0);
            return;
        }
        // <E_i, E_k> = sum_j g_j^2 [R_ij = R_kj]: a gather from the table that holds g_j^2 at R_ij
        let m = self.g.len();
        for ((r, line), g) in self.row(i).iter().zip(table.chunks_exact_mut(self.length)).zip(self.g) {
            line[r.get()] = g * g;
        }
        gather(&self.rows[..out.len() * m], m, self.length, table, out);
        for (r, line) in self.row(i).iter().zip(table.chunks_exact_mut(self.length)) {
            line[r.get()] = 0.0;
        }
    }

    fn add_outer(&self, samples: Range<usize>, matrix: &mut Triangle) -> Result<()> {
        // sum_i E_i E_i^T: one sample hits one entry per pair of lines
        let mut places = try_zeros(SEARCH, self.g.len())?;
        for i in samples.start..samples.end.min(self.stored) {
            let row = self.row(i);
            for (j, (place, r)) in places.iter_mut().zip(row).enumerate() {
                *place = j * self.length + r.get();
            }
            for (j, &k) in places.iter().enumerate() {
                let line = matrix.row_mut(k);
                for (&l, h) in places[..=j].iter().zip(self.g) {
                    line[l] += self.g[j] * h;
                }
            }
        }
        Ok(())
    }

    fn squared_norm(&self, i: usize) -> f64 {
        if i < self.stored { self.square } else { 0.0 }
    }

    fn block(&self, mu: f64) -> Result<Box<dyn Precondition>> {
        let made = CountBlock::new(self.counts()?, self.g, self.length, self.size(), self.stored, mu)?;
        Ok(Box::new(made))
    }

    fn residual_compensated(&self, w: &[f64], target: &[f64]) -> Result<Residual> {
        // q_k = sum_{i: R_i hits k} w_i as high + low
        let (mut high, mut low) = (try_zeros(SEARCH, self.dim())?, try_zeros(SEARCH, self.dim())?);
        for (i, &weight) in w.iter().enumerate().take(self.stored) {
            if weight != 0.0 {
                for (j, r) in self.row(i).iter().enumerate() {
                    let k = j * self.length + r.get();
                    let (s, e) = two_sum(high[k], weight);
                    high[k] = s;
                    low[k] += e;
                }
            }
        }
        // r_k = g_j q_k - t_k
        let (mut residual, mut image) = (high, low);
        for (k, &t) in target.iter().enumerate() {
            let g = self.g[k / self.length];
            let (p, e) = two_product(g, residual[k]);
            let rest = e + g * image[k];
            let (s, e) = two_sum(p, -t);
            residual[k] = s + (e + rest);
            image[k] = p + rest;
        }
        Ok(Residual { residual, image })
    }

    fn value_compensated(&self, i: usize, y: &[f64]) -> (f64, f64) {
        let mut sum = Sum::default();
        if i < self.stored {
            for (j, (r, &g)) in self.row(i).iter().zip(self.g).enumerate() {
                sum.add_product(g, y[j * self.length + r.get()]);
            }
        }
        sum.pair()
    }
}

/// The exact diagonal blocks of `S (I - 11^T/K) S^T + mu I`, one per line.
///
/// Within line `j` two realizations overlap only if they hit the same entry, so `S_j S_j^T = g_j^2 diag(c)` with the
/// counts `c`: the block is `D - u u^T / K`, `D = g_j^2 c + mu`, `u = g_j c`, inverted by Sherman and Morrison in
/// `O(length)`.
pub(crate) struct CountBlock {
    /// `1 / D`
    inverse: Vec<f64>,
    /// `u / D`
    scaled: Vec<f64>,
    /// `1 / (K - u^T D^{-1} u)`, one per line
    pivot: Vec<f64>,
    length: usize,
}

impl CountBlock {
    fn new(counts: Vec<f64>, g: &[f64], length: usize, size: usize, stored: usize, mu: f64) -> Result<Self> {
        let mut inverse = counts;
        let mut scaled = try_zeros(SEARCH, inverse.len())?;
        let mut pivot = try_room(SEARCH, g.len())?;
        let (size, empty) = (size as f64, (size - stored) as f64);
        for (j, &g) in g.iter().enumerate() {
            let line = j * length..(j + 1) * length;
            // K - sum u^2/D = (K - sum c) + sum c mu / D, without the cancellation
            let mut pivot_j = empty;
            for (d, s) in inverse[line.clone()].iter_mut().zip(&mut scaled[line]) {
                let c = *d;
                *d = 1.0 / (g * g * c + mu);
                *s = g * c * *d;
                pivot_j += c * mu * *d;
            }
            pivot.push(1.0 / pivot_j.max(1e-8 * size));
        }
        Ok(Self { inverse, scaled, pivot, length })
    }
}

impl Precondition for CountBlock {
    fn solve(&self, r: &[f64], out: &mut [f64]) {
        for (j, &pivot) in self.pivot.iter().enumerate() {
            let line = j * self.length..(j + 1) * self.length;
            let (r, out) = (&r[line.clone()], &mut out[line.clone()]);
            let (inverse, scaled) = (&self.inverse[line.clone()], &self.scaled[line]);
            // z = D^{-1} r + D^{-1} u (u^T D^{-1} r) / (K - u^T D^{-1} u)
            let shift = crate::vector::dot(scaled, r) * pivot;
            for (((z, r), d), s) in out.iter_mut().zip(r).zip(inverse).zip(scaled) {
                *z = d * r + shift * s;
            }
        }
    }
}
