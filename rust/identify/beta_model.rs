//! Roots drawn from bidiagonal matrices, where the exact law is out of reach or several roots are needed at once.
//!
//! The key is fixed and published here: a simulated quantile is the same number in every call and on every machine, for
//! any number of threads.

use rand::rngs::ChaCha8Rng;
use rand_distr::{Beta, ChiSquared, Distribution, StandardNormal};

use crate::error::{Error, Result};
use crate::memory::{try_collect_all, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{Key, Purpose};

use super::symmetric::{Symmetric, tridiagonal_eigenvalues};

/// Of all simulated quantiles.
const KEY: Key = Key(*b"stochens: quantiles of roots, v1");
/// Draws behind a simulated quantile.
pub const DRAWS: usize = 100_000;

const WHAT: &str = "the draws behind a quantile";
const CHUNK: usize = 500;

/// `size` draws of `one(rng, worker)`, each chunk with a stream and a worker of its own.
fn draws<W>(
    line: usize,
    size: usize,
    threads: usize,
    stop: &Stop,
    worker: impl Fn() -> Result<W> + Sync,
    one: impl Fn(&mut ChaCha8Rng, &mut W) -> Result<[f64; 2]> + Sync,
) -> Result<Vec<[f64; 2]>> {
    let mut all = try_zeros::<[f64; 2]>(WHAT, size)?;
    for_each_chunk(all.chunks_mut(CHUNK).enumerate(), threads, stop, |(chunk, out)| {
        let mut rng = KEY.stream(Purpose::Roots, line << 32 | chunk);
        let mut worker = worker()?;
        out.iter_mut().try_for_each(|out| one(&mut rng, &mut worker).map(|pair| *out = pair))
    })?;
    Ok(all)
}

fn refused(error: impl std::fmt::Display) -> Error {
    Error::Numerical(format!("a law of random numbers was refused: {error}"))
}

fn chi_square(degrees: usize) -> Result<ChiSquared<f64>> {
    ChiSquared::new(degrees as f64).map_err(refused)
}

/// Draws of (the largest root, the sum of the roots) of `E_nu^-1 G G'`, `G` (n, d), `nu >= n`.
///
/// `lam = t / (1 - t)`, `t` the eigenvalues of `B B'`, `B` upper bidiagonal with the diagonal
/// `c_p, c_{p-1} s'_{p-1}, .., c_1 s'_1` and above it `-s_p c'_{p-1}, .., -s_2 c'_1`, where
/// `c_k^2 ~ Beta((a + k)/2, (b + k)/2)`, `c'_k^2 ~ Beta(k/2, (a + b + 1 + k)/2)`, `s^2 = 1 - c^2`, `a = d - p`,
/// `b = nu - p` (Edelman and Sutton 2008).
pub(super) fn roots(n: usize, d: usize, nu: usize, size: usize, threads: usize, stop: &Stop) -> Result<Vec<[f64; 2]>> {
    let (p, d, nu) = if n > d { (d, n, nu + d - n) } else { (n, d, nu) };
    let (a, b) = (d - p, nu - p);
    let beta = |x: usize, y: usize| Beta::new(x as f64 / 2.0, y as f64 / 2.0).map_err(refused);
    let diagonal = try_collect_all(WHAT, (1..=p).rev().map(|k| beta(a + k, b + k)))?;
    let above = try_collect_all(WHAT, (1..p).rev().map(|k| beta(k, a + b + 1 + k)))?;
    draws(
        0,
        size,
        threads,
        stop,
        || Ok((try_zeros(WHAT, p)?, try_zeros(WHAT, p)?)),
        |rng, (t, below)| {
            // T = B B' of the squares: row i has its own diagonal and what stands right of it
            let mut other = 0.0; // s^2 of the row before
            for i in 0..p {
                let c2: f64 = diagonal[i].sample(rng);
                let e2: f64 = if i > 0 { above[i - 1].sample(rng) } else { 0.0 };
                let (own, right) = (c2 * (1.0 - e2), other * e2);
                t[i] = own;
                if i > 0 {
                    t[i - 1] += right;
                    below[i - 1] = -(own * right).sqrt();
                }
                other = 1.0 - c2;
            }
            below[p - 1] = 0.0;
            tridiagonal_eigenvalues(t, below)?;
            let (mut largest, mut sum) = (0.0f64, 0.0);
            for t in t.iter().map(|t| t.clamp(0.0, 1.0 - 1e-16)) {
                let root = t / (1.0 - t);
                largest = largest.max(root);
                sum += root;
            }
            Ok([largest, sum])
        },
    )
}

/// Draws of the smallest eigenvalue of `W_n(I, size)`, `N >= n` (first of each pair): of `B B'`, `B` bidiagonal of
/// independent chi of `N, N - 1, ..` degrees on the diagonal and `n - 1, .., 1` beside it (Dumitriu and Edelman 2002).
pub(super) fn smallest_wishart_root(
    n: usize,
    samples: usize,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<[f64; 2]>> {
    let diagonal = try_collect_all(WHAT, (0..n).map(|i| chi_square(samples - i)))?;
    let beside = try_collect_all(WHAT, (1..n).rev().map(chi_square))?;
    draws(
        1,
        size,
        threads,
        stop,
        || Ok((try_zeros(WHAT, n)?, try_zeros(WHAT, n)?)),
        |rng, (t, below)| {
            let mut left = 0.0;
            for i in 0..n {
                let own: f64 = diagonal[i].sample(rng);
                t[i] = own + left;
                if i + 1 < n {
                    left = beside[i].sample(rng);
                    below[i] = (own * left).sqrt();
                }
            }
            below[n - 1] = 0.0;
            tridiagonal_eigenvalues(t, below)?;
            Ok([t.iter().copied().fold(f64::INFINITY, f64::min).max(0.0), 0.0])
        },
    )
}

/// Draws of the largest root of `C^-1/2 G G' C^-1/2`, `G` (n, d), `C` the identity or, for `nu`, diagonal of
/// independent chi2_nu (first of each pair).
pub(super) fn largest_of_gaussian(
    n: usize,
    d: usize,
    nu: Option<usize>,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<[f64; 2]>> {
    let chi2 = nu.map(chi_square).transpose()?;
    let worker = || Ok((try_zeros::<f64>(WHAT, n * d)?, Symmetric::new(n)?));
    draws(2, size, threads, stop, worker, |rng, (g, symmetric)| {
        for row in g.chunks_exact_mut(d) {
            let scale = chi2.as_ref().map_or(1.0, |chi2| 1.0 / chi2.sample(rng).sqrt());
            for entry in row {
                let normal: f64 = StandardNormal.sample(rng);
                *entry = scale * normal;
            }
        }
        for (i, row) in g.chunks_exact(d).enumerate() {
            for (j, other) in g.chunks_exact(d).take(i + 1).enumerate() {
                symmetric.matrix[i * n + j] = row.iter().zip(other).map(|(a, b)| a * b).sum();
            }
        }
        Ok([symmetric.largest()?, 0.0])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_of_the_roots() {
        let stop = Stop::new();
        let drawn = roots(4, 6, 34, DRAWS, 1, &stop).unwrap();
        let mean = drawn.iter().map(|r| r[1]).sum::<f64>() / DRAWS as f64;
        let variance = drawn.iter().map(|r| (r[1] - mean).powi(2)).sum::<f64>() / DRAWS as f64;
        assert!((mean - 24.0 / 29.0).abs() < 4.5 * (variance / DRAWS as f64).sqrt()); // n d / (nu - n - 1)
        assert!(drawn.iter().all(|r| 0.0 < r[0] && r[0] < r[1]));
        assert_eq!(drawn[..1200], roots(4, 6, 34, 1200, 3, &stop).unwrap());
        // det of W_3(I, 7) has the mean 7 * 6 * 5, and its smallest root is below the cube root
        let smallest = smallest_wishart_root(3, 7, 1000, 1, &stop).unwrap();
        assert!(smallest.iter().map(|r| r[0]).sum::<f64>() / 1000.0 < 210f64.cbrt());
    }
}
