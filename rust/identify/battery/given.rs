//! Pairs with what is known of them, and the result of a test.

use crate::error::{Error, Result};
use crate::identify::least_squares::Fitted;
use crate::memory::{checked_len, try_zeros};

pub(super) const WHAT: &str = "the tests of residuals";

/// Pairs, their least squares, and how they follow on each other.
#[derive(Debug, Clone, Copy)]
pub struct Given<'a> {
    /// Rows (z, y) (N, d + n).
    pub rows: &'a [f64],
    /// Least squares of them.
    pub fitted: &'a Fitted,
    /// Combinations of outcomes with independent residuals (n, p).
    pub basis: &'a [f64],
    /// The logged pairs (x, u, x one step later) (any, 2 n + m).
    pub pairs: &'a [f64],
    /// The logged pair of each row (N).
    pub at: &'a [usize],
    /// The place of each logged pair in its piece.
    pub places: &'a [usize],
    /// The run of each row (N), rising.
    pub runs: &'a [usize],
    /// The number of regressors d, of outcomes n and of inputs m.
    pub d: usize,
    /// As above.
    pub n: usize,
    /// As above.
    pub m: usize,
    /// The first place in z of an input.
    pub inputs_at: usize,
    /// Whether the last regressor is 1.
    pub intercept: bool,
    /// How many steps back the first reading and the first input are that are no regressors, and how many inputs are
    /// later than all that are.
    pub beyond: (usize, usize, usize),
    /// More columns in their place (N, any).
    pub extra: Option<&'a [f64]>,
    /// Rows of which alone it is tested whether they have a model of their own.
    pub marked: Option<&'a [bool]>,
}

impl Given<'_> {
    pub(super) fn size(&self) -> usize {
        self.at.len()
    }

    pub(super) fn z(&self, t: usize) -> &[f64] {
        &self.rows[t * (self.d + self.n)..][..self.d]
    }

    pub(super) fn y(&self, t: usize) -> &[f64] {
        &self.rows[t * (self.d + self.n) + self.d..][..self.n]
    }

    pub(super) fn pair(&self, pair: usize) -> &[f64] {
        let width = 2 * self.n + self.m;
        &self.pairs[pair * width..(pair + 1) * width]
    }

    pub(super) fn refuse(&self) -> Result<()> {
        let (size, width) = (self.size(), 2 * self.n + self.m);
        let sound = self.n > 0
            && self.rows.len() == checked_len(WHAT, size, self.d + self.n)?
            && self.pairs.len() == checked_len(WHAT, self.places.len(), width)?
            && self.runs.len() == size
            && self.fitted.rows.len() == self.n
            && self.fitted.columns.len() == self.d
            && self.basis.len().is_multiple_of(self.n)
            && self.inputs_at <= self.d
            && self.at.iter().all(|&pair| pair < self.places.len())
            && self.places.iter().enumerate().all(|(pair, &place)| place <= pair)
            && self.extra.is_none_or(|extra| size > 0 && extra.len().is_multiple_of(size))
            && self.marked.is_none_or(|marked| marked.len() == size);
        if sound {
            return Ok(());
        }
        let found = format!("{} entries of {size} rows", self.rows.len());
        Err(Error::Shape { name: "rows", expected: "rows, pairs and their places that fit together".into(), found })
    }
}

/// The result of one test.
#[derive(Debug, Clone)]
pub struct Test {
    /// What it looks for.
    pub name: &'static str,
    /// The probability of as much in a model without this fault.
    pub p_value: f64,
    /// The share of the variance that is explained, or how far off.
    pub share: f64,
    /// Where: rows, runs, a lag, or a state, as the name asks for.
    pub at: Vec<usize>,
    /// The share of each outcome.
    pub each: Vec<f64>,
}

pub(super) fn zeros(len: usize) -> Result<Vec<f64>> {
    try_zeros(WHAT, len)
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
