//! Tests of residuals with exact levels, by simulation: warnings, never a licence for a region.
//!
//! For regressors independent of Gaussian noise, residuals scaled to `sum e e' = I` have a law free of `Theta` and
//! `Sigma`: that of `X - Q Q' X`, `X` standard normal, scaled likewise. The rank of an observed statistic among
//! simulated ones has an exact p-value (Dufour and Khalaf 2002).

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rand_distr::{Distribution, StandardNormal};

use crate::error::{Error, Result};
use crate::memory::{checked_len, room_for_products, try_copy, try_room, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{Key, Purpose};

use super::least_squares::fit;
use super::symmetric::{factored, whiten};

const WHAT: &str = "the residuals";
/// Pairs that one product takes at a time: a stop is seen in between.
const BLOCK: usize = 1 << 13;

/// Regressors as an orthonormal basis, residuals and leverages.
#[derive(Debug, Clone)]
struct Residuals {
    /// `q_t = V^(-1/2) z_t` (N, rank).
    basis: Vec<f64>,
    /// `y_t - H z_t` (N, n), what the projector on the columns of `basis` leaves of `Y`.
    residuals: Vec<f64>,
    /// `h_t = ||q_t||^2` (N).
    leverages: Vec<f64>,
}

/// Residuals and leverages of the rows of `z` (N, d) and `y` (N, n) with `white` (rank, d).
///
/// # Errors
/// [`Error::Shape`], [`Error::Memory`], [`Error::Interrupted`].
fn residuals(z: &[f64], y: &[f64], white: &[f64], (d, n): (usize, usize), stop: &Stop) -> Result<Residuals> {
    let size = z.len().checked_div(d).unwrap_or(0);
    if d == 0 || n == 0 || z.len() != size * d || y.len() != size * n || !white.len().is_multiple_of(d) {
        let (expected, found) = (format!("{size} rows each, white of {d} columns"), format!("{} entries", y.len()));
        return Err(Error::Shape { name: "Z, Y", expected, found });
    }
    room_for_products()?;
    let rank = white.len() / d;
    let mut basis = try_zeros(WHAT, checked_len(WHAT, size, rank)?)?;
    let white = MatRef::from_row_major_slice(white, rank, d);
    for (q, z) in basis.chunks_mut((BLOCK * rank).max(1)).zip(z.chunks(BLOCK * d)) {
        stop.check()?;
        let rows = z.len() / d;
        let z = MatRef::from_row_major_slice(z, rows, d);
        let q = MatMut::from_row_major_slice_mut(q, rows, rank);
        matmul(q, Accum::Replace, z, white.transpose(), 1.0, Par::Seq);
    }
    let mut left = try_copy(WHAT, y)?;
    let mut along = try_zeros(WHAT, rank * n)?;
    for _ in 0..2 {
        project(&basis, &mut left, (rank, n), &mut along, stop)?; // the second time takes what rounding left
    }
    let mut leverages = try_zeros(WHAT, size)?;
    for (h, q) in leverages.iter_mut().zip(basis.chunks_exact(rank.max(1))) {
        *h = q.iter().map(|q| q * q).sum();
    }
    Ok(Residuals { basis, residuals: left, leverages })
}

/// `x <- x - Q Q' x`, `Q` (N, rank), `x` (N, n).
fn project(q: &[f64], x: &mut [f64], (rank, n): (usize, usize), along: &mut [f64], stop: &Stop) -> Result<()> {
    if rank == 0 {
        return Ok(());
    }
    along.fill(0.0);
    for (q, x) in q.chunks(BLOCK * rank).zip(x.chunks(BLOCK * n)) {
        stop.check()?;
        let (q, x) = (matrix(q, rank), matrix(x, n));
        matmul(MatMut::from_row_major_slice_mut(along, rank, n), Accum::Add, q.transpose(), x, 1.0, Par::Seq);
    }
    for (q, x) in q.chunks(BLOCK * rank).zip(x.chunks_mut(BLOCK * n)) {
        stop.check()?;
        let x = MatMut::from_row_major_slice_mut(x, q.len() / rank, n);
        matmul(x, Accum::Add, matrix(q, rank), MatRef::from_row_major_slice(along, rank, n), -1.0, Par::Seq);
    }
    Ok(())
}

fn matrix(values: &[f64], cols: usize) -> MatRef<'_, f64> {
    MatRef::from_row_major_slice(values, values.len() / cols, cols)
}

/// Number of statistics.
pub const STATISTICS: usize = 5;

/// The five statistics of residuals `e` (N, n), which are scaled to `sum e e' = I` in place; large where an assumption
/// fails.
///
/// `sum_{j=1..5} ||C_j||_F^2` and `||C_1||_F^2`, `C_j = sum e_t e_{t-j}'`; the kurtosis `sum ||e_t||^4` (Mardia 1970);
/// `|corr(||e_t||^2, h_t)|` with the leverage; `||sum_{t <= N/2} e_t q_t'||_F^2`, since the whole sum is 0.
fn statistics(e: &mut [f64], found: &Residuals, (rank, n): (usize, usize), square: &mut [f64]) -> Result<[f64; 5]> {
    let size = e.len() / n;
    // e_t <- L^-1 e_t, L L' = sum e e'
    let to = MatMut::from_row_major_slice_mut(square, n, n);
    matmul(to, Accum::Replace, matrix(e, n).transpose(), matrix(e, n), 1.0, Par::Seq);
    if !factored(square, n) {
        return Err(Error::Numerical("the residuals do not span the outcomes: no test of them".into()));
    }
    whiten(matrix(square, n), MatMut::from_row_major_slice_mut(e, size, n).transpose_mut());
    let mut lags = [0.0; 5];
    for (j, lag) in (1..).zip(&mut lags).take(size.saturating_sub(1)) {
        let (later, earlier) = (matrix(&e[j * n..], n), matrix(&e[..(size - j) * n], n));
        let to = MatMut::from_row_major_slice_mut(square, n, n);
        matmul(to, Accum::Replace, later.transpose(), earlier, 1.0, Par::Seq);
        *lag = square.iter().map(|v| v * v).sum();
    }
    let sizes = || e.chunks_exact(n).map(|e| e.iter().map(|v| v * v).sum::<f64>());
    let kurtosis: f64 = sizes().map(|s| s * s).sum();
    let mean_size = sizes().sum::<f64>() / size as f64;
    let mean_leverage = found.leverages.iter().sum::<f64>() / size as f64;
    let (mut both, mut of_sizes, mut of_leverages) = (0.0, 0.0, 0.0);
    for (s, h) in sizes().zip(&found.leverages) {
        let (s, h) = (s - mean_size, h - mean_leverage);
        both += s * h;
        of_sizes += s * s;
        of_leverages += h * h;
    }
    let spread = f64::sqrt(of_sizes * of_leverages);
    let tilt = if spread > 1e-12 { both.abs() / spread } else { 0.0 };
    let half = size / 2;
    let mut change = 0.0;
    if rank > 0 {
        let mut sums = try_zeros(WHAT, n * rank)?;
        let (e, q) = (matrix(&e[..half * n], n), matrix(&found.basis[..half * rank], rank));
        matmul(MatMut::from_row_major_slice_mut(&mut sums, n, rank), Accum::Replace, e.transpose(), q, 1.0, Par::Seq);
        change = sums.iter().map(|v| v * v).sum();
    }
    Ok([lags.iter().sum(), lags[0], kurtosis, tilt, change])
}

/// Tests of least squares of the rows (z, y) (N, width) on the first d columns, with p-values by simulation, and how
/// far off each statistic is in standard deviations; None with too few pairs for a test.
///
/// Of the outcomes `tested`, and where their residuals are tied to each other, of as many combinations as are not: the
/// statistics are those of any basis.
///
/// # Errors
/// As `fit` and [`super::Fitted::span`].
#[expect(clippy::too_many_arguments, reason = "what is tested, and how it is simulated")]
pub fn residual_checks(
    rows: &[f64],
    width: usize,
    d: usize,
    tested: &[usize],
    draws: usize,
    key: &Key,
    threads: usize,
    stop: &Stop,
) -> Result<Option<[[f64; STATISTICS]; 2]>> {
    let size = rows.len().checked_div(width).unwrap_or(0);
    let f = fit(rows, width, d, size, threads, stop)?;
    let (n, basis) = (width - d, f.span(tested)?.basis);
    let p = basis.len() / n;
    if f.rank() == 0 || p == 0 || f.degrees() < n || size < 4 {
        return Ok(None);
    }
    let (mut z, mut y) = (try_room(WHAT, checked_len(WHAT, size, d)?)?, try_zeros(WHAT, checked_len(WHAT, size, p)?)?);
    for (row, y) in rows.chunks_exact(width).zip(y.chunks_exact_mut(p)) {
        z.extend_from_slice(&row[..d]);
        for (value, combination) in row[d..].iter().zip(basis.chunks_exact(p)) {
            y.iter_mut().zip(combination).for_each(|(to, v)| *to += value * v);
        }
    }
    let found = residuals(&z, &y, &f.white, (d, p), stop)?;
    residual_p_values(&found, p, draws, key, threads, stop).map(Some)
}

/// `(1 + #{simulated >= observed}) / (draws + 1)` for each statistic of the residuals of `n` outcomes, and how many
/// standard deviations of the simulated ones it is above their mean (0 where they are all equal); NaN for
/// `N - rank < n`.
///
/// # Errors
/// [`Error::Numerical`] for residuals that are dependent, [`Error::Memory`], [`Error::Interrupted`].
fn residual_p_values(
    found: &Residuals,
    n: usize,
    draws: usize,
    key: &Key,
    threads: usize,
    stop: &Stop,
) -> Result<[[f64; STATISTICS]; 2]> {
    let size = found.leverages.len();
    let rank = found.basis.len().checked_div(size).unwrap_or(0);
    if size < rank + n {
        return Ok([[f64::NAN; STATISTICS]; 2]);
    }
    room_for_products()?;
    let mut square = try_zeros(WHAT, n * n)?;
    let observed = statistics(&mut try_copy(WHAT, &found.residuals)?, found, (rank, n), &mut square)?;
    let mut drawn = try_zeros(WHAT, checked_len(WHAT, draws, STATISTICS)?)?;
    for_each_chunk(drawn.chunks_mut(8 * STATISTICS).enumerate(), threads, stop, |(chunk, drawn)| {
        room_for_products()?;
        let (mut x, mut square) = (try_zeros(WHAT, size * n)?, try_zeros(WHAT, n * n)?);
        let mut along = try_zeros(WHAT, rank * n)?;
        for (draw, drawn) in drawn.chunks_exact_mut(STATISTICS).enumerate() {
            let mut rng = key.stream(Purpose::Replicates, 8 * chunk + draw);
            x.fill_with(|| StandardNormal.sample(&mut rng));
            project(&found.basis, &mut x, (rank, n), &mut along, stop)?;
            drawn.copy_from_slice(&statistics(&mut x, found, (rank, n), &mut square)?);
        }
        Ok(())
    })?;
    let all = |i: usize| drawn.iter().skip(i).step_by(STATISTICS);
    let p_value = |i: usize| {
        let larger = all(i).filter(|&&s| s >= observed[i] * (1.0 - 1e-12)).count();
        (1.0 + larger as f64) / (draws as f64 + 1.0)
    };
    let distance = |i: usize| {
        let mean = all(i).sum::<f64>() / draws as f64;
        let variance = all(i).map(|s| (s - mean).powi(2)).sum::<f64>() / draws as f64;
        if variance > 0.0 { (observed[i] - mean) / variance.sqrt() } else { 0.0 }
    };
    Ok([std::array::from_fn(p_value), std::array::from_fn(distance)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case() -> Residuals {
        // one regressor of ones: residuals are what the mean leaves
        let z = [1.0; 6];
        let y = [1.0, 2.0, 4.0, 7.0, 11.0, 17.0];
        residuals(&z, &y, &[6f64.sqrt().recip()], (1, 1), &Stop::new()).unwrap()
    }

    #[test]
    fn residuals_and_leverages() {
        let found = case();
        for (e, y) in found.residuals.iter().zip([-6.0, -5.0, -3.0, 0.0, 4.0, 10.0]) {
            assert!((e - y).abs() < 1e-14);
        }
        assert!(found.leverages.iter().all(|h| (h - 1.0 / 6.0).abs() < 1e-15));
    }

    #[test]
    fn statistics_by_hand_and_p_values_in_their_range() {
        let found = case();
        let s = statistics(&mut found.residuals.clone(), &found, (1, 1), &mut [0.0]).unwrap();
        let e = [-6.0, -5.0, -3.0, 0.0, 4.0, 10.0f64];
        let squares: f64 = e.iter().map(|e| e * e).sum();
        let lag = |j: usize| (e[j..].iter().zip(&e).map(|(a, b)| a * b).sum::<f64>() / squares).powi(2);
        let expected = [
            (1..6).map(lag).sum(),
            lag(1),
            e.iter().map(|e| e.powi(4)).sum::<f64>() / squares.powi(2),
            0.0,
            (14.0f64).powi(2) / squares / 6.0,
        ];
        for (found, expected) in s.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-14, "{found} is not {expected}");
        }
        let p = |threads| residual_p_values(&found, 1, 199, &Key([1; 32]), threads, &Stop::new()).unwrap();
        assert_eq!(p(1), p(3));
        let [p, distances] = p(1);
        assert!(p.iter().all(|p| (0.005..=1.0).contains(p)) && p[3] == 1.0 && distances[3] == 0.0);
        // a statistic above all simulated ones is above their mean, and one that none is below is not
        assert!(p.iter().zip(distances).all(|(&p, distance)| distance.is_finite() && (p > 0.005 || distance > 0.0)));
        assert!(residual_p_values(&found, 6, 9, &Key([1; 32]), 1, &Stop::new()).unwrap()[0][0].is_nan());
    }
}
