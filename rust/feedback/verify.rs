//! The proof of an inequality between matrices in floating point.

use faer::Mat;

use crate::scaled::nearest_power_of_two;

use super::data::{Closed, Matrix, Uncertain, absolute, finite, stacked};

/// Unit roundoff.
const U: f64 = f64::EPSILON / 2.0;

/// `j u / (1 - j u)`: the relative error of j operations.
fn gamma(j: usize) -> f64 {
    let j = j as f64 * U;
    j / (1.0 - j)
}

/// Whether a symmetric matrix minus `shift I` has a Cholesky factor. Plain, row by row: with square roots and divisions of
/// IEEE 754 the result is exact for a matrix whose entries are off by `gamma(n + 1) sqrt(a_ii a_jj)` (Demmel 1989).
fn positive(a: &Matrix, shift: f64) -> bool {
    let n = a.nrows();
    let mut l = Mat::<f64>::zeros(n, n); // columns are contiguous: this is L'
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| l[(k, i)] * l[(k, j)]).sum();
            let rest = a[(i, j)] - if i == j { shift } else { 0.0 } - dot;
            if i > j {
                l[(j, i)] = rest / l[(j, j)];
            } else if rest > 0.0 && rest.is_finite() {
                l[(i, i)] = rest.sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

/// Whether a matrix is positive definite, whose entries are off by at most `error`: in units in which its diagonal is
/// about 1, powers of 2, with the rounding of the factorization (Rump 2006).
fn proved(a: &Matrix, error: impl Fn(usize, usize) -> f64) -> bool {
    let n = a.nrows();
    let mut unit = Vec::new();
    for i in 0..n {
        if !(a[(i, i)] > 0.0 && a[(i, i)].is_finite()) {
            return false;
        }
        unit.push(1.0 / nearest_power_of_two(a[(i, i)].sqrt()));
    }
    let own = Mat::from_fn(n, n, |i, j| unit[i] * a[(i, j)] * unit[j]);
    let row = |i: usize| (0..n).map(|j| unit[i] * error(i, j) * unit[j] + 1e-300).sum::<f64>();
    let formed = 1.01 * (0..n).map(row).fold(0.0, |most: f64, sum| if sum <= most { most } else { sum });
    let sizes: f64 = (0..n).map(|i| own[(i, i)].abs()).sum();
    let factored = 1.01 * gamma(n + 3) / (1.0 - gamma(n + 3)) * sizes + n as f64 * 1e-300;
    (formed + factored).is_finite() && positive(&own, formed + factored)
}

/// What is claimed: `diag(Y - X - alpha sum_p t_p rho_p^2 S_p, alpha t_p I) - F Y F' / lambda > 0`, `F = [A0; E_1; ..]`, and
/// `Y > 0`, for the uncertainty `by` times as large. It implies `A_G Y A_G' / lambda + X < Y` for all members.
pub(super) struct Claim<'a> {
    pub y: &'a Matrix,
    pub x: Option<&'a Matrix>,
    pub alpha: f64,
    pub lambda: f64,
    pub by: f64,
}

/// Whether the claim is proved; `false` says nothing.
pub(super) fn verify(data: &Uncertain, closed: &Closed, claim: &Claim<'_>) -> bool {
    let joined = absolute(&data.joined(&closed.k));
    let sizes = &absolute(&data.a) + &absolute(&data.b) * &absolute(&closed.k);
    let mut size_blocks = Vec::new();
    size_blocks.push(sizes);
    data.pieces.iter().for_each(|piece| size_blocks.push(&absolute(&piece.w) * &joined));
    let n = data.n;
    let f = stacked(std::iter::once(&closed.a0).chain(&closed.e), n);
    let (mut levels, mut forcing) = (Vec::new(), Mat::zeros(n, n));
    for ((piece, e), t) in data.pieces.iter().zip(&closed.e).zip(&closed.t) {
        levels.resize(levels.len() + e.nrows(), claim.alpha * t);
        let rho = claim.by * piece.rho;
        for (i, to) in piece.rows.iter().enumerate() {
            for (j, col) in piece.rows.iter().enumerate() {
                forcing[(*to, *col)] = claim.alpha * t * rho * rho * piece.s[(i, j)];
            }
        }
    }
    holds(&f, &stacked(&size_blocks, n), (&forcing, &levels), data.region.d, claim)
}

/// [`verify`] for a matrix without uncertainty: `A Y A' / lambda + X < Y`.
pub(super) fn verify_alone(a: &Matrix, claim: &Claim<'_>) -> bool {
    holds(a, &absolute(a), (&Mat::zeros(a.nrows(), a.nrows()), &[]), 1, claim)
}

/// `sizes` bounds the sums of absolute values, of so many `terms`, that made each entry of F.
fn holds(f: &Matrix, sizes: &Matrix, (forcing, levels): (&Matrix, &[f64]), terms: usize, claim: &Claim<'_>) -> bool {
    let Claim { y, x, alpha, lambda, .. } = *claim;
    let n = y.nrows();
    let same = |a: &Matrix| finite(a) && (0..n).all(|i| (0..i).all(|j| a[(i, j)] == a[(j, i)]));
    let sound = same(y) && x.is_none_or(same) && same(forcing) && finite(f) && finite(sizes);
    if !(sound
        && levels.iter().all(|v| *v > 0.0 && v.is_finite())
        && alpha > 0.0
        && alpha.is_finite()
        && lambda > 0.0
        && lambda <= 1.0)
    {
        return false;
    }
    let (big, at) = (f.nrows(), |i: usize, j: usize| x.map_or(0.0, |x| x[(i, j)]));
    let (product, product_sizes) = (f * y * f.transpose(), sizes * absolute(y) * sizes.transpose());
    let top = |i: usize, j: usize, whole: bool| match (i < n && j < n, i == j) {
        (true, _) if whole => y[(i, j)].abs() + at(i, j).abs() + forcing[(i, j)].abs(),
        (true, _) => y[(i, j)] - at(i, j) - forcing[(i, j)],
        (false, true) => levels[i - n],
        (false, false) => 0.0,
    };
    let m = Mat::from_fn(big, big, |i, j| top(i, j, false) - 0.5 * (product[(i, j)] + product[(j, i)]) / lambda);
    // two entries of F, and two sums of n
    let (near, far) = (gamma(8), gamma(2 * terms + 2 * n + 16) / lambda);
    proved(&m, |i, j| near * top(i, j, true) + far * product_sizes[(i, j)]) && proved(y, |_, _| 0.0)
}
