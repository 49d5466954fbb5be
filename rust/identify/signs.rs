//! Sign-perturbed sums: how far `Theta` can be from least squares for symmetric noise of any law (Csaji, Campi and Weyer 2015).
//!
//! For a sign vector `a`, `s = sum a e q'` and `K = sum a q q'` with `q = V^(-1/2) z`: while `||S_1|| <= ||S_a||`, `X = (Theta - H)
//! V^(1/2)` has `||X|| <= ||s - X K||`.

use crate::error::{Error, Result};
use crate::memory::{covered, try_zeros};
use crate::parallel::Stop;

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
    let found = smallest(at(best.saturating_sub(1)), at((best + 1).min(144)), |log| Ok(phi(log)))?.1;
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
