//! Sums over measured pairs with random weights or signs, for many replicates at once: one product of matrices.
//!
//! A pair is a row `(q_t, e_t)`: `q_t = V^(-1/2) z_t` (rank entries) and the residual `e_t` (n entries). Replicate `b` is a
//! function of (key, b) alone.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::{Error, Result};
use crate::memory::{checked_len, room_for_products, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{Key, Lanes, Purpose};

const WHAT: &str = "the replicates of a model";
/// The most replicates that one thread makes at a time.
pub(super) const BLOCK: usize = 64;
/// Replicates whose small systems are solved side by side.
pub(super) const LANES: usize = 8;

/// `N` rows `(q_t, e_t)`.
#[derive(Debug, Clone, Copy)]
pub struct Pairs<'a> {
    pub(super) rows: &'a [f64],
    pub(super) rank: usize,
    pub(super) n: usize,
    /// Pairs of the same run share their weight: the number of the run of each pair, rising from 0 by steps of 0 or 1.
    runs: Option<&'a [u32]>,
}

impl<'a> Pairs<'a> {
    /// # Errors
    /// [`Error::Shape`] unless there are whole rows of `rank + n` entries, and a run for each if `runs` are given;
    /// [`Error::Value`] for runs that are not numbered in order.
    pub fn new(rows: &'a [f64], rank: usize, n: usize, runs: Option<&'a [u32]>) -> Result<Self> {
        if n == 0 || rows.is_empty() || !rows.len().is_multiple_of(rank + n) {
            let (expected, found) = (format!("rows of {rank} + {n} entries"), format!("{} entries", rows.len()));
            return Err(Error::Shape { name: "rows", expected, found });
        }
        let size = rows.len() / (rank + n);
        if let Some(runs) = runs {
            if runs.len() != size {
                let (expected, found) = (format!("one entry for each of {size} pairs"), runs.len().to_string());
                return Err(Error::Shape { name: "runs", expected, found });
            }
            if runs[0] != 0 || runs.windows(2).any(|pair| pair[1].wrapping_sub(pair[0]) > 1) {
                let found = "other numbers".into();
                return Err(Error::Value {
                    name: "runs",
                    expected: "numbered 0, .., 0, 1, .., 1, 2, .. in order",
                    found,
                });
            }
        }
        Ok(Self { rows, rank, n, runs })
    }

    /// How many pairs there are.
    pub fn size(&self) -> usize {
        self.rows.len() / (self.rank + self.n)
    }

    /// How many weights there are: of pairs, or of runs.
    pub fn groups(&self) -> usize {
        self.runs.map_or(self.size(), |runs| runs.last().map_or(0, |last| *last as usize + 1))
    }

    fn features_len(&self, squares: bool) -> usize {
        if squares { self.rank * (self.rank + 1) / 2 + self.rank * self.n } else { self.rank * self.n }
    }

    /// `q_i q_j` (`j <= i`, if asked for) and `q_i e_k`, summed over each of some groups: (groups, features). `next` is the
    /// first pair of these groups, then of those that follow.
    fn features(&self, squares: bool, groups: Range<usize>, next: &mut usize, out: &mut [f64]) {
        let (rank, len) = (self.rank, self.features_len(squares));
        out.fill(0.0);
        for row in self.rows.chunks_exact(rank + self.n).skip(*next) {
            let group = self.runs.map_or(*next, |runs| runs[*next] as usize);
            if group >= groups.end {
                return;
            }
            let (q, e) = row.split_at(rank);
            let mut to = out[(group - groups.start) * len..][..len].iter_mut();
            for (i, a) in q.iter().enumerate() {
                let others = if squares { &q[..=i] } else { &[] };
                others.iter().zip(to.by_ref()).for_each(|(b, to)| *to += a * b);
            }
            for a in q {
                e.iter().zip(to.by_ref()).for_each(|(b, to)| *to += a * b);
            }
            *next += 1;
        }
    }
}

/// The weights of pairs or runs.
#[derive(Debug, Clone, Copy)]
pub enum Weights<'a> {
    /// Replicate by replicate.
    Given(&'a [f64]),
    /// How often each is taken when as many are taken at random as there are.
    Counts(&'a Key),
    /// -1 or 1.
    Signs(&'a Key),
}

impl Weights<'_> {
    /// The weights of one replicate.
    fn fill(self, replicate: usize, out: &mut [f64], words: &mut [u64]) {
        let lanes = |key: &Key| key.lanes_for(Purpose::Replicates, replicate, 0);
        match self {
            Self::Given(all) => out.copy_from_slice(&all[replicate * out.len()..(replicate + 1) * out.len()]),
            Self::Counts(key) => {
                let (mut lanes, size) = (lanes(key), out.len());
                out.fill(0.0);
                each_index(&mut lanes, words, size, size, |_, index| out[index] += 1.0);
            }
            Self::Signs(key) => {
                let mut lanes = lanes(key);
                for signs in out.chunks_mut(64 * words.len()) {
                    lanes.fill(words);
                    for (signs, word) in signs.chunks_mut(64).zip(&*words) {
                        let bit = |b| if word >> b & 1 == 1 { -1.0 } else { 1.0 };
                        signs.iter_mut().enumerate().for_each(|(b, sign)| *sign = bit(b));
                    }
                }
            }
        }
    }
}

/// `visit(t, index)` for `count` indices below `below`, each equally likely but for `below / 2^64`.
pub(super) fn each_index(
    lanes: &mut Lanes,
    words: &mut [u64],
    count: usize,
    below: usize,
    mut visit: impl FnMut(usize, usize),
) {
    for start in (0..count).step_by(words.len()) {
        lanes.fill(words);
        for (t, word) in (start..count).zip(&*words) {
            visit(t, ((u128::from(*word) * below as u128) >> 64) as usize);
        }
    }
}

/// Features of all groups where they take little memory; else none, and each block of replicates makes them anew.
pub(super) fn shared_features(pairs: &Pairs<'_>, squares: bool) -> Result<Vec<f64>> {
    const LITTLE: usize = 1 << 23;
    let len = checked_len(WHAT, pairs.groups(), pairs.features_len(squares))?;
    let mut features = try_zeros(WHAT, if len <= LITTLE { len } else { 0 })?;
    if len <= LITTLE {
        pairs.features(squares, 0..pairs.groups(), &mut 0, &mut features);
    }
    Ok(features)
}

/// Replicates in a block: fewer where their weights take much memory.
pub(super) fn block_of(groups: usize) -> usize {
    ((1 << 22) / groups.max(1)).clamp(LANES, BLOCK) / LANES * LANES
}

/// Sums of the features with the weights of a block of replicates, `(features, block)`.
pub(super) struct Summer<'a> {
    pairs: &'a Pairs<'a>,
    squares: bool,
    shared: &'a [f64],
    own: Vec<f64>,
    weights: Weights<'a>,
    block: Vec<f64>,
    words: Vec<u64>,
    sums: Vec<f64>,
}

impl<'a> Summer<'a> {
    /// Groups between two looks whether to stop.
    const STEP: usize = 1 << 12;

    pub(super) fn new(pairs: &'a Pairs<'a>, squares: bool, shared: &'a [f64], weights: Weights<'a>) -> Result<Self> {
        room_for_products()?;
        let (len, groups) = (pairs.features_len(squares), pairs.groups());
        let own = try_zeros(WHAT, if shared.is_empty() { Self::STEP * len } else { 0 })?;
        let block = try_zeros(WHAT, checked_len(WHAT, block_of(groups), groups)?)?;
        let sums = try_zeros(WHAT, checked_len(WHAT, len, block_of(groups))?)?;
        Ok(Self { pairs, squares, shared, own, weights, block, words: try_zeros(WHAT, 512)?, sums })
    }

    /// For `count` replicates from `first` on; zeros for the rest of the block, so that the sums are made in one way.
    pub(super) fn sums(&mut self, first: usize, count: usize, stop: &Stop) -> Result<&[f64]> {
        let (groups, len) = (self.pairs.groups(), self.pairs.features_len(self.squares));
        let (filled, rest) = self.block.split_at_mut(count * groups);
        for (b, weights) in filled.chunks_exact_mut(groups).enumerate() {
            stop.check()?;
            self.weights.fill(first + b, weights, &mut self.words);
        }
        rest.fill(0.0);
        let mut next = 0;
        for start in (0..groups).step_by(Self::STEP) {
            stop.check()?;
            let rows = Self::STEP.min(groups - start);
            let features = if self.shared.is_empty() {
                let own = &mut self.own[..rows * len];
                self.pairs.features(self.squares, start..start + rows, &mut next, own);
                &*own
            } else {
                &self.shared[start * len..(start + rows) * len]
            };
            let features = MatRef::from_row_major_slice(features, rows, len);
            let weights = MatRef::from_row_major_slice(&self.block, block_of(groups), groups).subcols(start, rows);
            let sums = MatMut::from_row_major_slice_mut(&mut self.sums, len, block_of(groups));
            let accum = if start == 0 { Accum::Replace } else { Accum::Add };
            matmul(sums, accum, features.transpose(), weights.transpose(), 1.0, Par::Seq);
        }
        Ok(&self.sums)
    }
}

pub(super) fn checked(weights: Weights<'_>, groups: usize, size: usize) -> Result<()> {
    if let Weights::Given(given) = weights
        && given.len() != checked_len(WHAT, size, groups)?
    {
        let (expected, found) = (format!("{size} rows of {groups} entries"), format!("{} entries", given.len()));
        return Err(Error::Shape { name: "weights", expected, found });
    }
    Ok(())
}

/// `S = sum a e q'` (n, rank) and `K = sum a q q'` (rank, rank) with signs `a`: `visit` sees them for each of `size` sign
/// vectors, with its place in the result.
pub(super) fn signed_sums<T: Copy + Send>(
    pairs: &Pairs<'_>,
    weights: Weights<'_>,
    out: &mut [T],
    threads: usize,
    stop: &Stop,
    visit: impl Fn(&[f64], &[f64]) -> Result<T> + Sync,
) -> Result<()> {
    let (groups, (rank, n)) = (pairs.groups(), (pairs.rank, pairs.n));
    checked(weights, groups, out.len())?;
    let (shared, width) = (shared_features(pairs, true)?, block_of(groups));
    for_each_chunk(out.chunks_mut(width).enumerate(), threads, stop, |(block, out)| {
        let mut summer = Summer::new(pairs, true, &shared, weights)?;
        let sums = summer.sums(block * width, out.len(), stop)?;
        let (squares, crossed) = sums.split_at(sums.len() - rank * n * width);
        let [mut s, mut k] = [try_zeros(WHAT, n * rank)?, try_zeros(WHAT, rank * rank)?];
        for (b, out) in out.iter_mut().enumerate() {
            stop.check()?;
            let mut square = squares.iter().skip(b).step_by(width);
            for i in 0..rank {
                for (j, value) in (0..=i).zip(square.by_ref()) {
                    (k[i * rank + j], k[j * rank + i]) = (*value, *value);
                }
            }
            let crossed = crossed.iter().skip(b).step_by(width);
            crossed.enumerate().for_each(|(at, value)| s[at % n * rank + at / n] = *value);
            *out = visit(&s, &k)?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_pairs_take_little_memory_and_give_the_same_sums() {
        let rows: Vec<f64> = (0..48_000).map(|i| f64::from(i * 7 % 11) - 5.0).collect();
        let pairs = Pairs::new(&rows, 2, 2, None).unwrap();
        let shared = shared_features(&pairs, true).unwrap();
        let key = Key([1; 32]);
        let weights = Weights::Counts(&key);
        let sums =
            |shared| Summer::new(&pairs, true, shared, weights).unwrap().sums(3, 5, &Stop::new()).unwrap().to_vec();
        assert_eq!(sums(&shared), sums(&[]));
        assert_eq!([1000, 1 << 17, 1 << 30].map(block_of), [64, 32, 8]);
    }

    /// Counts are multinomial, signs fair: means and variances within 4.5 standard deviations.
    #[test]
    fn laws_of_the_weights() {
        let (key, size, draws) = (Key([3; 32]), 1000, 400);
        let (mut out, mut words) = (vec![0.0; size], vec![0; 512]);
        let (mut squares, mut sum) = (0.0, 0.0);
        for b in 0..draws {
            Weights::Counts(&key).fill(b, &mut out, &mut words);
            assert_eq!(out.iter().sum::<f64>(), size as f64);
            squares += out.iter().map(|k| (k - 1.0).powi(2)).sum::<f64>();
            Weights::Signs(&key).fill(b, &mut out, &mut words);
            assert!(out.iter().all(|a| a.abs() == 1.0));
            sum += out.iter().sum::<f64>();
        }
        let count = (draws * size) as f64;
        assert!((squares / count - 0.999).abs() < 4.5 * (3.0 / count).sqrt()); // (k - 1)^2 has variance 3 for Poisson k
        assert!(sum.abs() < 4.5 * count.sqrt());
    }
}
