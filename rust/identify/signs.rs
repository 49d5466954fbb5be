//! Sign-perturbed sums: how far `Theta` can be from least squares for symmetric noise of any law (Csaji, Campi and Weyer 2015).
//!
//! For a sign vector `a`, `s = sum a e q'` and `K = sum a q q'` with `q = V^(-1/2) z`: while `||S_1|| <= ||S_a||`, `X = (Theta - H)
//! V^(1/2)` has `||X|| <= ||s - X K||`.

use statrs::function::gamma::ln_gamma;

use crate::error::{Error, Result};
use crate::memory::{checked_len, covered, try_room, try_zeros};
use crate::parallel::Stop;
use crate::stream::Key;

use super::levels::smallest;
use super::weighted_sums::{Pairs, Weights, signed_sums};

/// Of `1 - k^2`: below, the pairs with one of the two signs do not show all directions.
const LOST: f64 = 1e-12;

/// `max ||X||_F` over `||X||_F <= ||s - X K||_F` for each of `size` sign vectors, infinite where one bounds nothing.
///
/// By the S-lemma `sqrt(min phi)`, `phi(x) = x ||s||^2 + sum_j x^2 k_j^2 ||s_j||^2 / (x (1 - k_j^2) - 1)` over `x > 1 / min(1 -
/// k_j^2)`, `(k_j, u_j)` the eigenpairs of `K`, `s_j = s u_j`. Any `x` gives a valid radius.
///
/// # Errors
/// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
pub fn sign_radii(pairs: &Pairs<'_>, signs: Weights<'_>, size: usize, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
    let mut radii = try_zeros("the radii of sign vectors", size)?;
    signed_sums(pairs, signs, &mut radii, threads, stop, radius)?;
    Ok(radii)
}

/// `||sum a e q'||_F` for each of `size` sign vectors.
///
/// # Errors
/// As [`sign_radii`].
pub fn sign_statistics(
    pairs: &Pairs<'_>,
    signs: Weights<'_>,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    let mut norms = try_zeros("the sums of sign vectors", size)?;
    signed_sums(pairs, signs, &mut norms, threads, stop, |s, _| Ok(crate::fuse::norm(s.iter().copied())))?;
    Ok(norms)
}

/// Least level: that takes 1 / delta sign vectors.
const SMALLEST: f64 = 1e-5;
/// Fewest sign vectors m, that of ones included.
const SIZE: f64 = 100.0;

/// m and q with `q / m <= delta`, equal where delta has two decimals.
///
/// # Errors
/// [`Error::Value`] for a delta below 1e-5.
pub fn sign_sizes(delta: f64) -> Result<(usize, usize)> {
    if delta.is_nan() || delta < SMALLEST {
        let expected = "at least 1e-05 for noise='symmetric'";
        return Err(Error::Value { name: "delta", expected, found: delta.to_string() });
    }
    let m = (1.0 / delta - 1e-9).ceil().max(SIZE);
    Ok((m as usize, (delta * m + 1e-9).floor() as usize))
}

/// P(one sign vector bounds nothing) for d columns in general position: `2 P(Bin(N, 1/2) < d)`.
#[must_use]
pub fn chance_of_infinity(size: usize, d: usize) -> f64 {
    if 2 * d.saturating_sub(1) >= size {
        return 1.0;
    }
    let pairs = size as f64;
    let log = |k: usize| ln_gamma(pairs + 1.0) - ln_gamma(k as f64 + 1.0) - ln_gamma(pairs - k as f64 + 1.0);
    (2.0 * (0..d).map(|k| (log(k) - pairs * 2f64.ln()).exp()).sum::<f64>()).min(1.0)
}

/// The exact set of sign-perturbed sums for independent symmetric noise of any law.
///
/// If the `w_t` are independent, symmetric and independent of all `z_t`, the true Theta makes `S_a = sum a_t e_t(Theta) q_t'`
/// equal in law for all sign vectors a, with `e_t(Theta) = y_t - Theta z_t`: the rank of `||S_1||_F` among m of them is uniform,
/// so that `||S_1||` is not among the q largest with probability `1 - q / m` (Csaji, Campi and Weyer 2015).
#[derive(Debug, Clone, Copy)]
pub struct SignTest<'a> {
    /// The pairs `z` (N, d) and `y` (N, n).
    pub pairs: [&'a [f64]; 2],
    /// Orthonormal columns (N, rank) spanning those of z.
    pub basis: &'a [f64],
    /// d, n and the rank.
    pub sizes: [usize; 3],
    /// m sign vectors, that of ones included, and q.
    pub of: (usize, usize),
    /// That of the m - 1 random ones, which must never be drawn anew for the same data.
    pub key: &'a Key,
}

impl SignTest<'_> {
    /// Whether the set contains `theta` (n, d); ties count as inside, which is safe.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn contains(&self, theta: &[f64], threads: usize, stop: &Stop) -> Result<bool> {
        let (rows, [_, n, rank]) = (self.rows(theta)?, self.sizes);
        let mut sums = try_zeros("the sum of all signs", rank * n)?;
        for row in rows.chunks_exact((rank + n).max(1)) {
            let (q, e) = row.split_at(rank);
            sums.chunks_exact_mut(rank.max(1))
                .zip(e)
                .for_each(|(to, e)| to.iter_mut().zip(q).for_each(|(s, q)| *s += e * q));
        }
        let own = crate::fuse::norm(sums.iter().copied());
        let pairs = Pairs::new(&rows, rank, n, None)?;
        let others = sign_statistics(&pairs, Weights::Signs(self.key), self.of.0 - 1, threads, stop)?;
        Ok(others.iter().filter(|other| **other >= own * (1.0 - 1e-12)).count() >= self.of.1)
    }

    /// Of the ball around least squares `theta` that holds the set, in the Frobenius norm: the q-th largest of the radii of
    /// the sign vectors; infinite where one bounds nothing.
    ///
    /// # Errors
    /// As [`SignTest::contains`].
    pub fn radius(&self, theta: &[f64], threads: usize, stop: &Stop) -> Result<f64> {
        let (rows, [_, n, rank]) = (self.rows(theta)?, self.sizes);
        let pairs = Pairs::new(&rows, rank, n, None)?;
        let mut radii = sign_radii(&pairs, Weights::Signs(self.key), self.of.0 - 1, threads, stop)?;
        radii.sort_unstable_by(|a, b| b.total_cmp(a));
        Ok(radii[self.of.1 - 1])
    }

    /// `(q_t, y_t - Theta z_t)` of all pairs.
    fn rows(&self, theta: &[f64]) -> Result<Vec<f64>> {
        let ([z, y], [d, n, rank], (m, q)) = (self.pairs, self.sizes, self.of);
        let size = y.len().checked_div(n).unwrap_or(0);
        let fits = z.len() == size * d && y.len() == size * n && self.basis.len() == size * rank;
        if !(fits && d > 0 && n > 0 && theta.len() == n * d && (1..m).contains(&q)) {
            let found = format!("{} entries of Theta", theta.len());
            return Err(Error::Shape { name: "Z, Y", expected: format!("{size} rows, and 1 <= q < m"), found });
        }
        let mut rows = try_room("the pairs", checked_len("the pairs", size, rank + n)?)?;
        for (t, (z, y)) in z.chunks_exact(d).zip(y.chunks_exact(n)).enumerate() {
            rows.extend_from_slice(&self.basis[t * rank..(t + 1) * rank]);
            let fitted = |row: &[f64]| row.iter().zip(z).map(|(a, b)| a * b).sum::<f64>();
            rows.extend(y.iter().zip(theta.chunks_exact(d)).map(|(y, row)| y - fitted(row)));
        }
        Ok(rows)
    }
}

fn radius(s: &[f64], k: &[f64]) -> Result<f64> {
    let rank = k.len().isqrt();
    if s.iter().all(|v| *v == 0.0) {
        return Ok(0.0);
    }
    let bytes = 64 * (rank as u128 + 64) * (rank as u128 + 64);
    // k_j, and ||s u_j||^2
    let pairs = covered("the eigenvectors of a sum of signs", bytes, || eigenpairs(s, k, rank))??;
    let free = || pairs.iter().map(|(k, _)| (1.0 - k) * (1.0 + k));
    let least = free().fold(f64::INFINITY, f64::min);
    if least <= LOST {
        return Ok(f64::INFINITY);
    }
    let (lowest, total) = (1.0 / least, pairs.iter().map(|(_, size)| size).sum::<f64>());
    let phi = |log_excess: f64| {
        let excess = log_excess.exp();
        let x = lowest + excess;
        // x (1 - k^2) - 1 = (x - lowest)(1 - k^2) + (lowest (1 - k^2) - 1), without cancellation
        let below = free().map(|free| excess * free + (lowest * free - 1.0).max(0.0));
        let sum: f64 = pairs.iter().zip(below).map(|((k, size), below)| x * x * k * k * size / below).sum();
        x * total + sum
    };
    // convex: the best of a coarse grid, then golden sections around it
    let at = |i: usize| lowest.ln() - 36.0 + 0.5 * i as f64;
    let best = (0..145).min_by(|&i, &j| phi(at(i)).total_cmp(&phi(at(j)))).unwrap_or(0);
    let found = smallest(at(best.saturating_sub(1)), at((best + 1).min(144)), |log| Ok(phi(log)))?;
    Ok(found.sqrt())
}

#[expect(clippy::disallowed_methods, reason = "called under `covered`")]
fn eigenpairs(s: &[f64], k: &[f64], rank: usize) -> Result<Vec<(f64, f64)>> {
    let matrix = faer::MatRef::from_row_major_slice(k, rank, rank);
    let lost = |_| Error::Numerical("the eigenvalues of a sum of signs did not converge".into());
    let found = matrix.self_adjoint_eigen(faer::Side::Lower).map_err(lost)?;
    let (values, vectors) = (found.S().column_vector(), found.U());
    let along = |j: usize| -> f64 {
        let product = |row: &[f64]| (0..rank).map(|i| row[i] * vectors[(i, j)]).sum::<f64>();
        s.chunks_exact(rank).map(|row| product(row).powi(2)).sum()
    };
    Ok((0..rank).map(|j| (values[j], along(j))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_sign_vectors_of_four_pairs() {
        let (z, y): ([f64; 4], [f64; 4]) = ([1.0, 2.0, -1.0, 3.0], [1.0, 3.0, -1.0, 2.0]);
        let size = z.iter().map(|z| z * z).sum::<f64>().sqrt();
        let rows: Vec<f64> = z.iter().zip(y).flat_map(|(z, y)| [z / size, y - 14.0 / 15.0 * z]).collect();
        let pairs = Pairs::new(&rows, 1, 1, None).unwrap();
        let sign = |i: usize, t: usize| if t > 0 && i >> (3 - t) & 1 == 1 { -1.0 } else { 1.0 };
        let signs: Vec<f64> = (0..8).flat_map(|i| (0..4).map(move |t| sign(i, t))).collect();
        let found = sign_radii(&pairs, Weights::Given(&signs), 8, 1, &Stop::new()).unwrap();
        let expected = [
            f64::INFINITY,
            1.549193338483,
            0.258198889747,
            1.807392228230,
            2.194690562851,
            0.258198889747,
            1.807392228230,
            0.258198889747,
        ];
        for (found, expected) in found.iter().zip(expected).skip(1) {
            assert!((found - expected).abs() < 2e-11, "{found} is not {expected}");
        }
        let own = sign_statistics(&pairs, Weights::Given(&signs[..4]), 1, 1, &Stop::new()).unwrap();
        assert!(own[0] < 1e-15 && found[0] == f64::INFINITY); // all signs equal: the residuals themselves
        assert!((radius(&[1.3], &[0.4]).unwrap() - 1.3 / 0.6).abs() < 1e-12);
    }
}
