//! Vectors in twice the precision, and the motion `x(k+1) = A x(k) + B u(k)` of them, with bounds on their rounding.
//!
//! An entry is an unevaluated sum `high + low`; `error` bounds its distance from the exact value. A sum of N products
//! is off by at most `8 (N + 1) u^2 sum |a| |x|`, `u = 2^-53` (each of its N steps rounds three numbers of the size `u`
//! times a partial sum). An error of `TINY` per sum covers products that underflow.

use crate::compensated::{two_product, two_sum};
use crate::error::Result;
use crate::memory::{checked_len, try_copy, try_zeros};
use crate::vector::norm;

const WHAT: &str = "a control in twice the precision";
const UNIT: f64 = 0.5 * f64::EPSILON;
const TINY: f64 = 1e-290;
/// More than the rounding of a norm or of a sum of bounds, of up to `2^40` terms.
pub(super) const UPWARD: f64 = 1.0 + 1e-3;

/// Rows at a time: the additions of one wait for each other.
const ROWS: usize = 4;

/// A vector of pairs.
#[derive(Debug)]
pub(super) struct Pairs {
    pub high: Vec<f64>,
    pub low: Vec<f64>,
    pub error: Vec<f64>,
}

impl Pairs {
    pub fn zeros(len: usize) -> Result<Self> {
        Ok(Self { high: try_zeros(WHAT, len)?, low: try_zeros(WHAT, len)?, error: try_zeros(WHAT, len)? })
    }

    pub fn try_clone(&self) -> Result<Self> {
        let copy = |values: &[f64]| try_copy(WHAT, values);
        Ok(Self { high: copy(&self.high)?, low: copy(&self.low)?, error: copy(&self.error)? })
    }

    /// Exact doubles.
    pub fn exact(values: &[f64]) -> Result<Self> {
        Ok(Self {
            high: try_copy(WHAT, values)?,
            low: try_zeros(WHAT, values.len())?,
            error: try_zeros(WHAT, values.len())?,
        })
    }

    /// The low parts alone.
    pub fn lows(&self) -> Result<Self> {
        Self::exact(&self.low)
    }

    /// Adds a number to an entry; what is lost, `2 u^2` of it, is not counted: for vectors that define themselves.
    pub fn shift(&mut self, by: &[f64]) {
        for ((high, low), by) in self.high.iter_mut().zip(&mut self.low).zip(by) {
            let (s, e) = two_sum(*high, *by);
            (*high, *low) = two_sum(s, e + *low);
        }
    }

    /// `self -= other`, whose rounding is counted.
    pub fn subtract(&mut self, other: &Self) {
        for i in 0..self.high.len() {
            let (s, e) = two_sum(self.high[i], -other.high[i]);
            let rest = e + (self.low[i] - other.low[i]);
            let size = self.high[i].abs() + other.high[i].abs();
            self.error[i] += other.error[i] + 8.0 * UNIT * UNIT * size;
            (self.high[i], self.low[i]) = two_sum(s, rest);
        }
    }

    /// An upper bound of the norm of the exact vector.
    pub fn norm_above(&self) -> f64 {
        self.norm_of_pairs() + UPWARD * norm_scaled(&self.error)
    }

    /// A lower bound of it.
    pub fn norm_below(&self) -> f64 {
        let size = norm_scaled(&self.high) * (1.0 - rounding_of_norm(self.high.len()));
        (size - UPWARD * (norm_scaled(&self.low) + norm_scaled(&self.error))).max(0.0)
    }

    fn norm_of_pairs(&self) -> f64 {
        let size = norm_scaled(&self.high) * (1.0 + rounding_of_norm(self.high.len()));
        size + UPWARD * norm_scaled(&self.low)
    }
}

/// Relative: squares, their sum, root.
fn rounding_of_norm(len: usize) -> f64 {
    (len as f64 + 4.0) * UNIT
}

/// `||x||` of entries that are large enough to be squared after scaling.
pub(super) fn norm_scaled(x: &[f64]) -> f64 {
    let largest = x.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if largest == 0.0 || largest.is_nan() || largest.is_infinite() {
        return if largest == 0.0 && x.iter().all(|v| !v.is_nan()) { 0.0 } else { f64::INFINITY };
    }
    if (1e-100..1e100).contains(&largest) {
        return norm(x);
    }
    largest * x.iter().map(|v| (v / largest) * (v / largest)).sum::<f64>().sqrt()
}

/// A sum of products in twice the precision, and the sum of their sizes.
#[derive(Clone, Copy, Default)]
struct Sum {
    high: f64,
    low: f64,
    size: f64,
    error: f64,
}

impl Sum {
    #[inline(always)]
    fn add(&mut self, a: f64, high: f64, low: f64, error: f64) {
        let (p, e) = two_product(a, high);
        let (s, t) = two_sum(self.high, p);
        let rest = t + ((e + a * low) + self.low);
        self.high = s + rest;
        self.low = (s - self.high) + rest;
        self.size += p.abs();
        self.error += a.abs() * error;
    }

    #[inline(always)]
    fn bound(&self, terms: usize) -> f64 {
        UPWARD * (self.error + 8.0 * (terms as f64 + 1.0) * UNIT * UNIT * self.size)
            + TINY * f64::from(u8::from(self.size > 0.0))
    }
}

/// A linear system, row by row, and the number of steps: `C_K = [B, A B, ..., A^{K-1} B]`.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// `A`, `n x n`.
    pub a: &'a [f64],
    /// `B`, `n x m`.
    pub b: &'a [f64],
    /// Length of a state.
    pub n: usize,
    /// Number of inputs.
    pub m: usize,
    /// Number of steps K.
    pub steps: usize,
}

impl Motion<'_> {
    /// Columns of `C_K`.
    pub(super) fn width(&self) -> Result<usize> {
        checked_len(WHAT, self.m, self.steps)
    }

    /// `A x + B u` for one of the blocks of a control; without a block `A x`, without `x` `B u`.
    fn step(&self, x: Option<&Pairs>, u: Option<(&Pairs, usize)>) -> Result<Pairs> {
        let (n, m) = (self.n, self.m);
        let mut out = Pairs::zeros(n)?;
        let terms = x.map_or(0, |_| n) + u.map_or(0, |_| m);
        for first in (0..n).step_by(ROWS) {
            let mut sums = [Sum::default(); ROWS];
            if let Some(x) = x {
                add_rows(&self.a[first * n..], x, 0, n, &mut sums);
            }
            if let Some((u, block)) = u {
                add_rows(&self.b[first * m..], u, block * m, m, &mut sums);
            }
            for (i, sum) in (first..n).zip(&sums) {
                (out.high[i], out.low[i], out.error[i]) = (sum.high, sum.low, sum.bound(terms));
            }
        }
        Ok(out)
    }

    /// `A^K x`, and `|| |A| |A^{K-1} x| ||`.
    pub(super) fn free(&self, x: &[f64]) -> Result<(Pairs, Vec<f64>)> {
        let mut state = Pairs::exact(x)?;
        let mut sizes = try_zeros(WHAT, self.n)?;
        for k in 0..self.steps {
            if k + 1 == self.steps {
                for (row, size) in self.a.chunks_exact(self.n).zip(&mut sizes) {
                    *size = row.iter().zip(&state.high).map(|(a, x)| (a * x).abs()).sum::<f64>();
                }
            }
            state = self.step(Some(&state), None)?;
        }
        Ok((state, sizes))
    }

    /// `C_K v` for v in the order of `C_K`: u(K-1), ..., u(0).
    pub(super) fn pushed(&self, v: &Pairs) -> Result<Pairs> {
        let mut state = self.step(None, Some((v, self.steps - 1)))?;
        for block in (0..self.steps - 1).rev() {
            state = self.step(Some(&state), Some((v, block)))?;
        }
        Ok(state)
    }

    /// `C_K^T z`.
    pub(super) fn adjoint(&self, z: &Pairs) -> Result<Pairs> {
        let m = self.m;
        let mut out = Pairs::zeros(self.width()?)?;
        let mut at = z.try_clone()?;
        for block in 0..self.steps {
            let part = transposed(self.b, m, &at)?;
            let range = block * m..(block + 1) * m;
            out.high[range.clone()].copy_from_slice(&part.high);
            out.low[range.clone()].copy_from_slice(&part.low);
            out.error[range].copy_from_slice(&part.error);
            if block + 1 < self.steps {
                at = transposed(self.a, self.n, &at)?;
            }
        }
        Ok(out)
    }
}

/// Adds to every sum the product of one of the next rows with the `count` entries of `x` from `from` on.
fn add_rows(rows: &[f64], x: &Pairs, from: usize, count: usize, sums: &mut [Sum; ROWS]) {
    if let Some(rows) = rows.get(..ROWS * count) {
        for j in 0..count {
            let (high, low, error) = (x.high[from + j], x.low[from + j], x.error[from + j]);
            for (k, sum) in sums.iter_mut().enumerate() {
                sum.add(rows[k * count + j], high, low, error);
            }
        }
        return;
    }
    for (row, sum) in rows.chunks_exact(count).zip(sums) {
        for (j, a) in row.iter().enumerate() {
            sum.add(*a, x.high[from + j], x.low[from + j], x.error[from + j]);
        }
    }
}

/// `M^T z` for M row by row.
fn transposed(rows: &[f64], cols: usize, z: &Pairs) -> Result<Pairs> {
    let mut out = Pairs::zeros(cols)?;
    let mut sums: Vec<f64> = try_zeros(WHAT, cols)?;
    for (i, row) in rows.chunks_exact(cols).enumerate() {
        for (j, a) in row.iter().enumerate() {
            let mut sum = Sum { high: out.high[j], low: out.low[j], size: sums[j], error: out.error[j] };
            sum.add(*a, z.high[i], z.low[i], z.error[i]);
            (out.high[j], out.low[j], sums[j], out.error[j]) = (sum.high, sum.low, sum.size, sum.error);
        }
    }
    let terms = z.high.len();
    for (j, size) in sums.into_iter().enumerate() {
        out.error[j] = Sum { high: 0.0, low: 0.0, size, error: out.error[j] }.bound(terms);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_that_cancels_keeps_its_digits() {
        // A x = 1e17 + 1 - 1e17 = 1; C_2 v = A B v(0) + B v(1)
        let motion = Motion { a: &[1e17, 1.0, 0.0, 0.0], b: &[1.0, 0.0], n: 2, m: 1, steps: 2 };
        let (free, sizes) = motion.free(&[1.0, -1e17]).unwrap();
        assert_eq!((free.high[0], free.high[1]), (0.0, 0.0));
        assert!(sizes[1] == 0.0 && free.error[0] < 1e5);
        let v = Pairs { high: vec![1.0, 1.0], low: vec![1e-20, 0.0], error: vec![0.0; 2] };
        let x = motion.pushed(&v).unwrap();
        assert_eq!((x.high[0], x.low[0], x.high[1]), (1e17, 1.0, 0.0));
        let g = motion.adjoint(&Pairs::exact(&[1.0, 0.0]).unwrap()).unwrap();
        assert_eq!(g.high, [1.0, 1e17]);
    }

    #[test]
    fn norms_are_bounds() {
        let pairs = Pairs { high: vec![3.0, 4.0], low: vec![1e-17, 0.0], error: vec![0.0, 1e-3] };
        assert!(pairs.norm_below() <= 5.0 - 1e-3 && pairs.norm_above() >= 5.0 + 1e-3);
        assert_eq!(norm_scaled(&[3e-200, 4e-200]), 5e-200);
        assert!(norm_scaled(&[f64::NAN]).is_infinite());
    }
}
