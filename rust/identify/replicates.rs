//! Ensembles of models from one data set: least squares with random weights, signs or residuals, all of them at once.
//!
//! A pair is a row `(q_t, e_t)`: `q_t = V^(-1/2) z_t` (rank entries) and the residual `e_t` (n entries). In these every
//! replicate is small: sums over the pairs are one product of matrices, near the identity where they must be inverted.
//! Replicate `b` is a function of (key, b) alone.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rand_distr::{ChiSquared, Distribution, StandardNormal};

use crate::error::{Error, Result};
use crate::memory::{checked_len, room_for_products, try_collect_all, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{Key, Lanes, Purpose};

const WHAT: &str = "the replicates of a model";
/// Replicates that one thread makes at a time.
const BLOCK: usize = 64;
/// Replicates whose small systems are solved side by side.
const LANES: usize = 8;
/// Of the pivots, which are near 1: below, a replicate has no estimate.
const SINGULAR: f64 = 1e-10;

/// `N` rows `(q_t, e_t)`.
#[derive(Debug, Clone, Copy)]
pub struct Pairs<'a> {
    rows: &'a [f64],
    rank: usize,
    n: usize,
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
fn each_index(lanes: &mut Lanes, words: &mut [u64], count: usize, below: usize, mut visit: impl FnMut(usize, usize)) {
    for start in (0..count).step_by(words.len()) {
        lanes.fill(words);
        for (t, word) in (start..count).zip(&*words) {
            visit(t, ((u128::from(*word) * below as u128) >> 64) as usize);
        }
    }
}

/// Features of all groups where they take little memory; else none, and each block of replicates makes them anew.
fn shared_features(pairs: &Pairs<'_>, squares: bool) -> Result<Vec<f64>> {
    const LITTLE: usize = 1 << 23;
    let len = checked_len(WHAT, pairs.groups(), pairs.features_len(squares))?;
    let mut features = try_zeros(WHAT, if len <= LITTLE { len } else { 0 })?;
    if len <= LITTLE {
        pairs.features(squares, 0..pairs.groups(), &mut 0, &mut features);
    }
    Ok(features)
}

/// Replicates in a block: fewer where their weights take much memory.
fn block_of(groups: usize) -> usize {
    ((1 << 22) / groups.max(1)).clamp(LANES, BLOCK) / LANES * LANES
}

/// Sums of the features with the weights of a block of replicates, `(features, block)`.
struct Summer<'a> {
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

    fn new(pairs: &'a Pairs<'a>, squares: bool, shared: &'a [f64], weights: Weights<'a>) -> Result<Self> {
        room_for_products()?;
        let (len, groups) = (pairs.features_len(squares), pairs.groups());
        let own = try_zeros(WHAT, if shared.is_empty() { Self::STEP * len } else { 0 })?;
        let block = try_zeros(WHAT, checked_len(WHAT, block_of(groups), groups)?)?;
        let sums = try_zeros(WHAT, checked_len(WHAT, len, block_of(groups))?)?;
        Ok(Self { pairs, squares, shared, own, weights, block, words: try_zeros(WHAT, 512)?, sums })
    }

    /// For `count` replicates from `first` on; zeros for the rest of the block, so that the sums are made in one way.
    fn sums(&mut self, first: usize, count: usize, stop: &Stop) -> Result<&[f64]> {
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

fn checked(weights: Weights<'_>, groups: usize, size: usize) -> Result<()> {
    if let Weights::Given(given) = weights
        && given.len() != checked_len(WHAT, size, groups)?
    {
        let (expected, found) = (format!("{size} rows of {groups} entries"), format!("{} entries", given.len()));
        return Err(Error::Shape { name: "weights", expected, found });
    }
    Ok(())
}

/// What becomes a model.
#[derive(Debug, Clone, Copy)]
pub struct Centre<'a> {
    /// The model `H` (n, d).
    pub model: &'a [f64],
    /// `white` (rank, d) with `q = white z`.
    pub white: &'a [f64],
}

impl Centre<'_> {
    fn d(&self, pairs: &Pairs<'_>) -> Result<usize> {
        let d = self.model.len() / pairs.n;
        if self.model.len() != pairs.n * d || self.white.len() != pairs.rank * d {
            return Err(Error::Shape {
                name: "H, white",
                expected: format!("{} rows and {} rows of the same length", pairs.n, pairs.rank),
                found: format!("{} and {} entries", self.model.len(), self.white.len()),
            });
        }
        Ok(d)
    }
}

/// `size` models `H + (sum k e q')(sum k q q')^-1 white` with weights `k`: least squares with pair `t` taken `k_t` times
/// (`solve`), or `H + (sum k e q') white`: of the outcomes `H z_t + k_t e_t` (wild). NaN where a replicate has no estimate.
///
/// # Errors
/// [`Error::Shape`], [`Error::Memory`], [`Error::Interrupted`].
pub fn weighted_models(
    pairs: &Pairs<'_>,
    centre: Centre<'_>,
    weights: Weights<'_>,
    solve: bool,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    let (d, groups, (rank, n)) = (centre.d(pairs)?, pairs.groups(), (pairs.rank, pairs.n));
    checked(weights, groups, size)?;
    let (shared, width) = (shared_features(pairs, solve)?, block_of(groups));
    let mut models = try_zeros(WHAT, checked_len(WHAT, size, n * d)?)?;
    for_each_chunk(models.chunks_mut(width * n * d).enumerate(), threads, stop, |(block, models)| {
        let mut summer = Summer::new(pairs, solve, &shared, weights)?;
        let sums = summer.sums(block * width, models.len() / (n * d), stop)?;
        let (squares, crossed) = sums.split_at(sums.len() - rank * n * width);
        let (mut lower, mut right) = (try_zeros(WHAT, squares.len() / width)?, try_zeros(WHAT, rank * n)?);
        for (eight, models) in models.chunks_mut(LANES * n * d).enumerate() {
            let load = |to: &mut [[f64; LANES]], from: &[f64]| {
                let lines = from.chunks_exact(width).map(|line| &line.as_chunks::<LANES>().0[eight]);
                to.iter_mut().zip(lines).for_each(|(to, from)| *to = *from);
            };
            load(&mut lower, squares);
            load(&mut right, crossed);
            let mut solved = [true; LANES];
            let work = || {
                if solve {
                    solved = factor(&mut lower, rank);
                    substitute(&lower, rank, n, &mut right);
                }
                write_models(&right, centre, n, d, models);
            };
            #[cfg(target_arch = "x86_64")]
            crate::wide::widest(work);
            #[cfg(not(target_arch = "x86_64"))]
            work();
            let failed = models.chunks_exact_mut(n * d).zip(solved).filter(|(_, solved)| !solved);
            failed.for_each(|(model, _)| model.fill(f64::NAN));
        }
        Ok(())
    })?;
    Ok(models)
}

/// `L` of `L L'` in place of the lower half, packed by rows, of eight matrices; which of them have no small pivot.
#[inline(always)]
fn factor(a: &mut [[f64; LANES]], rank: usize) -> [bool; LANES] {
    let mut sound = [true; LANES];
    for i in 0..rank {
        let (done, row) = a.split_at_mut(i * (i + 1) / 2);
        for j in 0..=i {
            let other = &done[(j * (j + 1) / 2).min(done.len())..];
            let mut value = row[j];
            for k in 0..j {
                let b = if j < i { other[k] } else { row[k] };
                for l in 0..LANES {
                    value[l] -= row[k][l] * b[l];
                }
            }
            for l in 0..LANES {
                row[j][l] = if j < i {
                    value[l] * other[j][l]
                } else {
                    sound[l] &= value[l] >= SINGULAR;
                    1.0 / value[l].sqrt() // the reciprocal, which is what is needed
                };
            }
        }
    }
    sound
}

/// `(L L')^-1` times the columns of `right` (rank, n).
#[inline(always)]
fn substitute(lower: &[[f64; LANES]], rank: usize, n: usize, right: &mut [[f64; LANES]]) {
    let entry = |i: usize, j: usize| &lower[i * (i + 1) / 2 + j];
    for i in 0..rank {
        let (done, row) = right.split_at_mut(i * n);
        for (k, value) in row[..n].iter_mut().enumerate() {
            for j in 0..i {
                let (a, b) = (entry(i, j), &done[j * n + k]);
                for l in 0..LANES {
                    value[l] -= a[l] * b[l];
                }
            }
            value.iter_mut().zip(entry(i, i)).for_each(|(value, pivot)| *value *= pivot);
        }
    }
    for i in (0..rank).rev() {
        let (row, below) = right[i * n..].split_at_mut(n);
        for (k, value) in row.iter_mut().enumerate() {
            for j in i + 1..rank {
                let (a, b) = (entry(j, i), &below[(j - i - 1) * n + k]);
                for l in 0..LANES {
                    value[l] -= a[l] * b[l];
                }
            }
            value.iter_mut().zip(entry(i, i)).for_each(|(value, pivot)| *value *= pivot);
        }
    }
}

/// `H + right' white` of each of eight, one after the other.
#[inline(always)]
fn write_models(right: &[[f64; LANES]], centre: Centre<'_>, n: usize, d: usize, models: &mut [f64]) {
    for i in 0..n {
        for c in 0..d {
            let mut value = [centre.model[i * d + c]; LANES];
            for (row, white) in right.chunks_exact(n).zip(centre.white.chunks_exact(d)) {
                for l in 0..LANES {
                    value[l] += row[i][l] * white[c];
                }
            }
            models.chunks_exact_mut(n * d).zip(value).for_each(|(model, value)| model[i * d + c] = value);
        }
    }
}

/// `size` models of the outcomes `H z_t + e*_t`, `e*_t` taken at random from all residuals: `H + (sum e*_t q_t') white`.
///
/// # Errors
/// As [`weighted_models`].
pub fn residual_models(
    pairs: &Pairs<'_>,
    centre: Centre<'_>,
    key: &Key,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    let (d, samples, (rank, n)) = (centre.d(pairs)?, pairs.size(), (pairs.rank, pairs.n));
    let width = rank + n;
    let mut models = try_zeros(WHAT, checked_len(WHAT, size, n * d)?)?;
    for_each_chunk(models.chunks_mut(BLOCK * n * d).enumerate(), threads, stop, |(block, models)| {
        room_for_products()?;
        let mut drawn = try_zeros(WHAT, samples * n)?;
        let mut words = try_zeros(WHAT, 512)?;
        let mut sums = try_zeros(WHAT, n * rank)?;
        for (b, model) in models.chunks_exact_mut(n * d).enumerate() {
            stop.check()?;
            let mut lanes = key.lanes_for(Purpose::Replicates, block * BLOCK + b, 0);
            each_index(&mut lanes, &mut words, samples, samples, |t, index| {
                let row = &pairs.rows[index * width + rank..(index + 1) * width];
                drawn[t * n..(t + 1) * n].copy_from_slice(row);
            });
            let q = MatRef::from_row_major_slice(pairs.rows, samples, width).subcols(0, rank);
            let e = MatRef::from_row_major_slice(&drawn, samples, n);
            let to = MatMut::from_row_major_slice_mut(&mut sums, n, rank);
            matmul(to, Accum::Replace, e.transpose(), q, 1.0, Par::Seq);
            write_model(&sums, centre, d, model);
        }
        Ok(())
    })?;
    Ok(models)
}

/// `H + deviation white`, `deviation` (n, rank).
fn write_model(deviation: &[f64], centre: Centre<'_>, d: usize, model: &mut [f64]) {
    model.copy_from_slice(centre.model);
    let rank = centre.white.len() / d;
    for (row, deviation) in model.chunks_exact_mut(d).zip(deviation.chunks_exact(rank.max(1))) {
        for (factor, white) in deviation.iter().zip(centre.white.chunks_exact(d)) {
            row.iter_mut().zip(white).for_each(|(to, white)| *to += factor * white);
        }
    }
}

/// `size` draws of `H + S^(1/2) E^(-1/2) G V^(-1/2)`, `G` standard normal, `E ~ W_n(I, nu)` by Bartlett's triangle,
/// `root root' = S` (n, n).
///
/// # Errors
/// [`Error::Shape`]; [`Error::Value`] for `nu < n`; as [`weighted_models`].
pub fn region_draws(
    centre: Centre<'_>,
    root: &[f64],
    nu: usize,
    key: &Key,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    let n = root.len().isqrt();
    let d = centre.model.len().checked_div(n).unwrap_or(0);
    if n == 0 || n * n != root.len() || n * d != centre.model.len() || d == 0 || !centre.white.len().is_multiple_of(d) {
        let (expected, found) = ("n x n entries, where H is n x d and white rank x d", root.len());
        return Err(Error::Shape { name: "root", expected: expected.into(), found: format!("{found} entries") });
    }
    if nu < n {
        return Err(Error::Value { name: "nu", expected: "at least the number of rows", found: nu.to_string() });
    }
    let refused = |_| Error::Numerical("a chi-square law was refused".into());
    let chi2 = try_collect_all(WHAT, (0..n).map(|i| ChiSquared::new((nu - i) as f64).map_err(refused)))?;
    let rank = centre.white.len() / d;
    let mut models = try_zeros(WHAT, checked_len(WHAT, size, n * d)?)?;
    for_each_chunk(models.chunks_mut(BLOCK * n * d).enumerate(), threads, stop, |(block, models)| {
        let [mut t, mut g, mut deviation] =
            [try_zeros(WHAT, n * n)?, try_zeros(WHAT, n * rank)?, try_zeros(WHAT, n * rank)?];
        for (b, model) in models.chunks_exact_mut(n * d).enumerate() {
            let mut rng = key.stream(Purpose::Replicates, block * BLOCK + b);
            for i in 0..n {
                t[i * n..i * n + i].fill_with(|| StandardNormal.sample(&mut rng));
                t[i * n + i] = chi2[i].sample(&mut rng).sqrt();
            }
            g.fill_with(|| StandardNormal.sample(&mut rng));
            // E = T T': T' X = G
            for i in (0..n).rev() {
                let (row, below) = g[i * rank..].split_at_mut(rank);
                for (j, known) in below.chunks_exact(rank.max(1)).enumerate() {
                    let factor = t[(i + 1 + j) * n + i];
                    row.iter_mut().zip(known).for_each(|(value, known)| *value -= factor * known);
                }
                row.iter_mut().for_each(|value| *value /= t[i * n + i]);
            }
            deviation.fill(0.0);
            for (to, root) in deviation.chunks_exact_mut(rank.max(1)).zip(root.chunks_exact(n)) {
                for (factor, from) in root.iter().zip(g.chunks_exact(rank.max(1))) {
                    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
                }
            }
            write_model(&deviation, centre, d, model);
        }
        Ok(())
    })?;
    Ok(models)
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

    /// Pairs with `rank` 2 and `n` 2 whose `q` are orthonormal, and their model and root.
    const Q: [[f64; 2]; 4] = [[0.5, 0.5], [0.5, -0.5], [0.5, 0.5], [0.5, -0.5]];
    const E: [[f64; 2]; 4] = [[1.0, 0.1], [-2.0, 0.3], [-1.0, -0.1], [2.0, -0.3]];
    const MODEL: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
    const WHITE: [f64; 4] = [2.0, 0.0, 0.0, 4.0];

    fn rows() -> Vec<f64> {
        Q.iter().zip(E).flat_map(|(q, e)| [q[0], q[1], e[0], e[1]]).collect()
    }

    fn centre() -> Centre<'static> {
        Centre { model: &MODEL, white: &WHITE }
    }

    #[test]
    fn weights_as_given() {
        let (rows, stop) = (rows(), Stop::new());
        let pairs = Pairs::new(&rows, 2, 2, None).unwrap();
        let models = |weights: &[f64], solve| {
            let size = weights.len() / pairs.groups();
            weighted_models(&pairs, centre(), Weights::Given(weights), solve, size, 1, &stop).unwrap()
        };
        assert_eq!(models(&[1.0; 8], true), [MODEL, MODEL].concat());
        // pairs 0 and 1 twice: sum k q q' = I again, sum k e q' = 2 (e_0 q_0' + e_1 q_1')
        let s = [[1.0 - 2.0, 1.0 + 2.0], [0.1 + 0.3, 0.1 - 0.3]];
        let expected = [1.0 + 2.0 * s[0][0], 2.0 + 4.0 * s[0][1], 3.0 + 2.0 * s[1][0], 4.0 + 4.0 * s[1][1]];
        for (found, expected) in models(&[2.0, 2.0, 0.0, 0.0], true).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-14);
        }
        assert_eq!(models(&[2.0, 2.0, 0.0, 0.0], false), models(&[2.0, 2.0, 0.0, 0.0], true));
        // one direction only
        let few = models(&[[3.0, 0.0, 1.0, 0.0], [1.0; 4]].concat(), true);
        assert!(few[..4].iter().all(|v| v.is_nan()) && few[4..] == MODEL);
        // whole runs
        let runs = Pairs::new(&rows, 2, 2, Some(&[0, 0, 1, 1])).unwrap();
        let found = weighted_models(&runs, centre(), Weights::Given(&[2.0, 0.0]), true, 1, 1, &stop).unwrap();
        assert_eq!(found, models(&[2.0, 2.0, 0.0, 0.0], true));
        assert!(Pairs::new(&rows, 2, 2, Some(&[0, 2, 2, 2])).is_err());
    }

    #[test]
    fn many_pairs_take_little_memory_and_give_the_same_sums() {
        let rows = rows().repeat(3000);
        let pairs = Pairs::new(&rows, 2, 2, None).unwrap();
        let shared = shared_features(&pairs, true).unwrap();
        let key = Key([1; 32]);
        let weights = Weights::Counts(&key);
        let sums =
            |shared| Summer::new(&pairs, true, shared, weights).unwrap().sums(3, 5, &Stop::new()).unwrap().to_vec();
        assert_eq!(sums(&shared), sums(&[]));
        assert_eq!([1000, 1 << 17, 1 << 30].map(block_of), [64, 32, 8]);
    }

    #[test]
    fn replicates_depend_on_their_number_alone() {
        let (rows, stop, key) = (rows(), Stop::new(), Key([7; 32]));
        let pairs = Pairs::new(&rows, 2, 2, None).unwrap();
        for weights in [Weights::Counts(&key), Weights::Signs(&key)] {
            let solve = matches!(weights, Weights::Counts(_));
            let many = weighted_models(&pairs, centre(), weights, solve, 200, 3, &stop).unwrap();
            let few = weighted_models(&pairs, centre(), weights, solve, 70, 1, &stop).unwrap();
            assert!(few.iter().zip(&many).all(|(a, b)| a == b || a.is_nan() && b.is_nan()));
        }
        let many = residual_models(&pairs, centre(), &key, 200, 3, &stop).unwrap();
        assert_eq!(many[..280], residual_models(&pairs, centre(), &key, 70, 1, &stop).unwrap());
        let draws = region_draws(centre(), &[1.0, 0.0, 0.5, 1.0], 9, &key, 200, 3, &stop).unwrap();
        assert_eq!(draws[..280], region_draws(centre(), &[1.0, 0.0, 0.5, 1.0], 9, &key, 70, 1, &stop).unwrap());
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
