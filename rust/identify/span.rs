//! What the residuals of some rows span: rows without a residual, independent combinations, and ties between rows.

use super::least_squares::{Fitted, WHAT};
use super::symmetric::Symmetric;
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_collect, try_copy, try_push, try_zeros};

/// Least eigenvalue of the correlation matrix of residuals that is taken for 0. With a covariance of full rank it is
/// below with a probability of order `(1e-4 n)^2`, as there are more pairs than needed.
const SINGULAR: f64 = 1e-8;
/// Times what rounding may change, below which a residual is 0.
const ROUNDING: f64 = 10.0;
/// Entry of a tie, whose largest one is 1, below which a row has no part in it.
const NO_PART: f64 = 1e-6;

/// What the residuals of some rows span.
#[derive(Debug, Clone)]
pub struct Span {
    /// Rows of which the residual is 0.
    pub zero: Vec<usize>,
    /// Combinations of all outcomes (n, p) with independent residuals.
    pub basis: Vec<f64>,
    /// Rows whose residuals are tied to each other exactly.
    pub tied: Vec<usize>,
    /// Those of them without which the others are independent, of equal ones the last.
    pub last: Vec<usize>,
}

impl Fitted {
    /// What the residuals of these rows span.
    ///
    /// # Errors
    /// [`Error::Value`] for a row that there is not; [`Error::Memory`].
    pub fn span(&self, rows: &[usize]) -> Result<Span> {
        let n = self.rows.len();
        if let Some(row) = rows.iter().find(|&&row| row >= n) {
            return Err(Error::Value { name: "rows", expected: "rows of the model", found: row.to_string() });
        }
        let size = |i: usize| self.residual[i * (n + 1)].sqrt();
        let is_live = |i: &usize| size(*i) > ROUNDING * self.rounding[*i];
        let live = try_collect(WHAT, rows.iter().copied().filter(is_live))?;
        let zero = try_collect(WHAT, rows.iter().copied().filter(|i| !is_live(i)))?;
        let k = live.len();
        let (mut small, mut vectors) = (Symmetric::new(k)?, try_zeros(WHAT, checked_len(WHAT, k, k)?)?);
        for (a, &i) in live.iter().enumerate() {
            for (b, &j) in live.iter().enumerate() {
                small.matrix[a * k + b] = self.residual[i * n + j] / size(i) / size(j);
            }
        }
        let values = if k == 0 { Vec::new() } else { try_copy(WHAT, small.eigenpairs(&mut vectors)?)? };
        let apart = try_collect(WHAT, (0..k).filter(|&a| values[a] > SINGULAR))?;
        let p = apart.len();
        let mut basis = try_zeros(WHAT, checked_len(WHAT, n, p)?)?;
        for (a, &at) in apart.iter().enumerate() {
            live.iter().zip(&vectors[at * k..]).for_each(|(&i, v)| basis[i * p + a] = v / size(i));
        }
        let mut ties = Vec::new();
        for at in (0..k).filter(|a| !apart.contains(a)) {
            try_push(WHAT, &mut ties, try_copy(WHAT, &vectors[at * k..(at + 1) * k])?)?;
        }
        let pivots = reduce(&mut ties)?;
        let takes_part = |a: &usize| ties.iter().any(|tie| tie[*a].abs() > NO_PART);
        let tied = try_collect(WHAT, (0..k).filter(takes_part).map(|a| live[a]))?;
        let mut last = try_collect(WHAT, pivots.into_iter().map(|a| live[a]))?;
        last.sort_unstable();
        Ok(Span { zero, basis, tied, last })
    }
}

/// Gauss and Jordan with pivots: an entry of its own for each tie, of equal ones the last.
fn reduce(ties: &mut [Vec<f64>]) -> Result<Vec<usize>> {
    let mut pivots = Vec::new();
    for k in 0..ties.len() {
        let (mut best, mut row, mut pivot) = (-1.0, k, 0);
        for at in 0..ties[k].len() {
            for (other, tie) in ties.iter().enumerate().skip(k) {
                let size = if pivots.contains(&at) { 0.0 } else { (tie[at].abs() * 1e9).round() };
                if size > best || (size == best && at > pivot) {
                    (best, row, pivot) = (size, other, at);
                }
            }
        }
        ties.swap(k, row);
        let factor = ties[k][pivot];
        ties[k].iter_mut().for_each(|v| *v /= factor);
        let own = try_copy(WHAT, &ties[k])?;
        for tie in ties.iter_mut().enumerate().filter(|(other, _)| *other != k).map(|(_, tie)| tie) {
            let factor = tie[pivot];
            tie.iter_mut().zip(&own).for_each(|(v, own)| *v -= factor * own);
        }
        try_push(WHAT, &mut pivots, pivot)?;
    }
    Ok(pivots)
}
