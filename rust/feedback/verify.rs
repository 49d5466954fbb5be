//! The proof of an inequality between matrices in floating point.

use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;

use crate::scaled::nearest_power_of_two;

use super::data::{Closed, Matrix, Uncertain, absolute, finite, scaled, stacked, symmetric};

/// Unit roundoff.
const U: f64 = f64::EPSILON / 2.0;

/// `j u / (1 - j u)`: the relative error of j operations.
fn gamma(j: usize) -> f64 {
    let j = j as f64 * U;
    j / (1.0 - j)
}

/// Whether a symmetric matrix minus `shift I` has a Cholesky factor. Plain, row by row: with square roots and divisions
/// of IEEE 754 the result is exact for a matrix whose entries are off by `gamma(n + 1) sqrt(a_ii a_jj)` (Demmel 1989).
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

/// What is claimed of `Y = R R'`: `diag(Y - X - alpha sum_p t_p rho_p^2 S_p, alpha t_p I) - F Y F' / lambda > 0`,
/// `F = [A0; E_1; ..]`, and `Y > 0`, for the uncertainty `by` times as large. It implies `A_G Y A_G' / lambda + X < Y`
/// for all members.
pub(super) struct Claim<'a> {
    /// R (n, n).
    pub root: &'a Matrix,
    pub x: Option<&'a Matrix>,
    pub alpha: f64,
    pub lambda: f64,
    pub by: f64,
}

/// Whether the claim is proved; `false` says nothing.
pub(super) fn verify(data: &Uncertain, closed: &Closed, claim: &Claim<'_>) -> bool {
    let joined = absolute(&data.joined(&closed.k));
    let mut size_blocks = Vec::new();
    size_blocks.push(data.around(&closed.k).1);
    data.pieces.iter().for_each(|piece| size_blocks.push(&absolute(&piece.w) * &joined));
    let n = data.n;
    let f = stacked(std::iter::once(&closed.a0).chain(&closed.e), n);
    let (mut levels, mut forcing) = (Vec::new(), Mat::zeros(n, n));
    for ((piece, e), t) in data.pieces.iter().zip(&closed.e).zip(&closed.t) {
        levels.resize(levels.len() + e.nrows(), claim.alpha * t);
        let rho = claim.by * piece.rho;
        for (i, to) in piece.rows.iter().enumerate() {
            for (j, col) in piece.rows.iter().enumerate() {
                forcing[(*to, *col)] += claim.alpha * t * rho * rho * piece.s[(i, j)];
            }
        }
    }
    holds(&Judged {
        f: &f,
        sizes: &stacked(&size_blocks, n),
        beside: None,
        forcing: &forcing,
        levels: &levels,
        terms: data.region.d,
        claim,
    })
}

/// [`verify`] for a matrix without uncertainty: `A Y A' / lambda + X < Y`.
pub(super) fn verify_alone(a: &Matrix, claim: &Claim<'_>) -> bool {
    let (sizes, forcing) = (absolute(a), Mat::zeros(a.nrows(), a.nrows()));
    holds(&Judged { f: a, sizes: &sizes, beside: None, forcing: &forcing, levels: &[], terms: 1, claim })
}

/// A product with its rounding: `|found - exact| <= off`, entry by entry.
struct Rounded {
    found: Matrix,
    off: Matrix,
}

impl Rounded {
    /// `a b` of so many `terms`, where `sizes` bounds the sums of absolute values of all terms.
    fn new(found: Matrix, sizes: &Matrix, terms: usize) -> Self {
        let off = scaled(sizes, 1.01 * gamma(terms));
        Self { found, off }
    }

    /// `a a'`, and the bound of its error: that of a, and that of sums of so many terms.
    fn squared(&self) -> Self {
        let size = absolute(&self.found);
        let wide = &size + scaled(&self.off, 0.5);
        let one = &self.off * wide.transpose();
        let own = scaled(&(&size * size.transpose()), gamma(self.found.ncols() + 2));
        let off = scaled(&(&one + one.transpose() + own), 1.01);
        Self { found: symmetric(&(&self.found * self.found.transpose())), off }
    }
}

/// `diag(Y - X - forcing, levels) - F Y F' / lambda - G G' > 0`, and `Y > 0`, of a claim about `Y`.
pub(super) struct Judged<'a> {
    pub f: &'a Matrix,
    /// Bounds of the sums of absolute values, of so many `terms`, that made each entry of F and G.
    pub sizes: &'a Matrix,
    /// G with its `sizes`; its first rows are those of `Y`, as of F.
    pub beside: Option<(&'a Matrix, &'a Matrix)>,
    pub forcing: &'a Matrix,
    pub levels: &'a [f64],
    pub terms: usize,
    pub claim: &'a Claim<'a>,
}

/// The matrix is judged as `diag(L, I) (..) diag(L', I)` with L near the inverse of R, which is positive definite only
/// if the matrix is: in it all is of size 1 however near to each other the states are, and rounding counts for
/// `|L| |R|` times as much, not for the square of that.
pub(super) fn holds(of: &Judged<'_>) -> bool {
    let Judged { f, sizes, beside, forcing, levels, terms, claim } = *of;
    let Claim { root, x, alpha, lambda, .. } = *claim;
    let n = root.nrows();
    let same = |a: &Matrix| finite(a) && (0..n).all(|i| (0..i).all(|j| a[(i, j)] == a[(j, i)]));
    let sound = finite(root)
        && x.is_none_or(same)
        && same(forcing)
        && finite(f)
        && finite(sizes)
        && beside.is_none_or(|(g, sizes)| finite(g) && finite(sizes));
    if !(sound
        && levels.iter().all(|v| *v > 0.0 && v.is_finite())
        && alpha > 0.0
        && alpha.is_finite()
        && lambda > 0.0
        && lambda <= 1.0)
    {
        return false;
    }
    let back = root.partial_piv_lu().inverse();
    // no product underflows that counts
    if !(finite(&back) && root.norm_max() < 1e150 && back.norm_max() < 1e150) {
        return false;
    }
    let (around, away) = (absolute(root), absolute(&back));
    // L R, and F R with L in front of its first rows
    let unit = Rounded::new(&back * root, &(&away * &around), n + 2).squared();
    let (moved, moved_sizes) = (f * root, sizes * &around);
    let rows = |a: &Matrix, own: &Matrix| {
        stacked([&(own * a.subrows(0, n)), &a.subrows(n, a.nrows() - n).to_owned()], a.ncols())
    };
    let whole = Rounded::new(rows(&moved, &back), &rows(&moved_sizes, &away), 2 * terms + 2 * n + 16).squared();
    let more =
        beside.map(|(g, sizes)| Rounded::new(rows(g, &back), &rows(sizes, &away), 2 * terms + 2 * n + 16).squared());
    let given = x.map_or_else(|| forcing.clone(), |x| x + forcing);
    let given_sizes = x.map_or_else(|| absolute(forcing), |x| absolute(x) + absolute(forcing));
    let given = Rounded::new(
        symmetric(&(&back * given * back.transpose())),
        &(&away * given_sizes * away.transpose()),
        2 * n + 16,
    );
    let entry = |i: usize, j: usize| {
        let (top, off) = match (i < n && j < n, i == j) {
            (true, _) => (unit.found[(i, j)] - given.found[(i, j)], unit.off[(i, j)] + given.off[(i, j)]),
            (false, true) => (levels[i - n], 0.0),
            (false, false) => (0.0, 0.0),
        };
        let (added, added_off) = more.as_ref().map_or((0.0, 0.0), |more| (more.found[(i, j)], more.off[(i, j)]));
        let (product, rest) = (whole.found[(i, j)] / lambda + added, whole.off[(i, j)] / lambda + added_off);
        (top - product, off + rest + gamma(8) * (top.abs() + (product - added).abs() + added.abs()))
    };
    let m = Mat::from_fn(f.nrows(), f.nrows(), |i, j| entry(i, j).0);
    proved(&m, |i, j| entry(i, j).1) && proved(&unit.found, |i, j| unit.off[(i, j)])
}
