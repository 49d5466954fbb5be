//! Ensembles of models from one data set: least squares with random weights, signs or residuals, all of them at once.
//!
//! A pair is a row `(q_t, e_t)`: `q_t = V^(-1/2) z_t` (rank entries) and the residual `e_t` (n entries). In these every
//! replicate is small: sums over the pairs ([`super::weighted_sums`]), near the identity where they must be inverted.
//! Replicate `b` is a function of (key, b) alone.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rand_distr::{ChiSquared, Distribution, StandardNormal};

use crate::error::{Error, Result};
use crate::memory::{checked_len, room_for_products, try_collect_all, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::simd::dispatch::widest;
use crate::stream::{Key, Purpose};

use super::side_by_side::{Eight, Eightfold};
use super::weighted_sums::{BLOCK, LANES, Pairs, Summer, Weights, block_of, checked, each_index, shared_features};

const WHAT: &str = "the replicates of a model";

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
    let blocks = (size / width / 4 / threads.max(1)).clamp(1, 16); // that share their memory
    let chunks = models.chunks_mut(blocks * width * n * d).enumerate();
    for_each_chunk(chunks, threads, stop, |(chunk, models)| {
        let mut summer = Summer::new(pairs, solve, &shared, weights)?;
        let (mut lower, mut right) = (try_zeros(WHAT, rank * (rank + 1) / 2)?, try_zeros(WHAT, rank * n)?);
        for (block, models) in models.chunks_mut(width * n * d).enumerate() {
            let sums = summer.sums((chunk * blocks + block) * width, models.len() / (n * d), stop)?;
            let (squares, crossed) = sums.split_at(sums.len() - rank * n * width);
            for (eight, models) in models.chunks_mut(LANES * n * d).enumerate() {
                let load = |to: &mut [Eight], from: &[f64]| {
                    let lines = from.chunks_exact(width).map(|line| &line.as_chunks::<LANES>().0[eight]);
                    to.iter_mut().zip(lines).for_each(|(to, from)| *to = *from);
                };
                load(&mut lower, squares);
                load(&mut right, crossed);
                let squares = solve.then_some(&mut *lower);
                let Centre { model, white } = centre;
                let solved = widest(Eightfold { squares, right: &mut right, model, white, n, models });
                let failed = models.chunks_exact_mut(n * d).zip(solved).filter(|(_, solved)| !solved);
                failed.for_each(|(model, _)| model.fill(f64::NAN));
            }
        }
        Ok(())
    })?;
    Ok(models)
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
}
