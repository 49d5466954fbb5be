//! Least squares from one triangle: `R` with `R' R = [Z Y]' [Z Y]`, the rows of `Z` being `z = (x, u, 1)`.
//!
//! Everything that a region needs is a function of `R` and the number of pairs. `V = sum z z'` is never formed, since
//! that squares its condition number. Rank is decided on columns of unit length: the statements do not depend on the
//! units of z.

use crate::control::singular;
use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::memory::{checked_len, try_collect, try_copy, try_filled, try_zeros};
use crate::parallel::Stop;

use super::triangle::triangle;

pub(super) const WHAT: &str = "least squares";

/// Times `(d + n) eps` of the lengths: rounding of outcomes, triangle and estimate. The largest error of exact pairs
/// was `1.5 (d + n) eps`, for 12 to 1e5 pairs and ratios down to 1e-12.
pub(crate) const SLACK: f64 = 4.0;

/// Least squares for some rows and columns of Theta, and what its error is measured with.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Fitted {
    /// Rows (n) of Theta.
    pub rows: Vec<usize>,
    /// The columns (d) that are estimated in them.
    pub columns: Vec<usize>,
    /// The number of pairs N.
    pub size: usize,
    /// `H` (n, d), least squares; the smallest one in units of the data where they do not determine it.
    pub model: Vec<f64>,
    /// `S` (n, n), the sum of `e e'` over the residuals.
    pub residual: Vec<f64>,
    /// `white' white = V^+` (rank, d).
    pub white: Vec<f64>,
    /// `root' root = V` (rank, d).
    pub root: Vec<f64>,
    /// `Theta z` is determined only if `missing' z = 0` (d, d - rank).
    pub missing: Vec<f64>,
    /// Smallest over largest singular value of the data with columns of unit length; 0 for rank 0.
    pub ratio: f64,
    /// The triangle of Z (d, d).
    pub regressors: Vec<f64>,
    /// What rounding may change in each row of `H V^(1/2)` and of the residuals (n).
    pub rounding: Vec<f64>,
}

impl Fitted {
    /// The rank of V.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.white.len().checked_div(self.columns.len()).unwrap_or(0)
    }

    /// Degrees of freedom of the residuals.
    #[must_use]
    pub fn degrees(&self) -> usize {
        self.size.saturating_sub(self.rank())
    }

    /// The lengths of the columns of Z, 1 for those of 0.
    pub(crate) fn lengths(&self) -> Result<Vec<f64>> {
        lengths(&self.regressors, self.columns.len(), self.columns.len())
    }

    /// The missing directions, row by row (d - rank, d), combined so that each has an entry of its own: Gauss and
    /// Jordan with pivots. The first entry of each is positive, and what is rounding is 0.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn combinations(&self) -> Result<Vec<f64>> {
        const ROUNDING: f64 = 1e-6;
        let d = self.columns.len();
        let count = self.missing.len().checked_div(d).unwrap_or(0);
        let mut left = try_zeros(WHAT, self.missing.len())?;
        for (q, row) in left.chunks_exact_mut(d.max(1)).enumerate() {
            let column = || self.missing.iter().copied().skip(q).step_by(count);
            let size = norm(column());
            row.iter_mut().zip(column()).for_each(|(to, v)| *to = v / size);
        }
        let mut pivots = try_filled(WHAT, d, count)?;
        for at in 0..count {
            // of equal ones the first, whatever the rounding
            let (mut best, mut largest) = (at * d, -1.0);
            for (place, value) in left.iter().enumerate().skip(at * d) {
                let size = (value.abs() * 1e9).round();
                if size > largest && !pivots[..at].contains(&(place % d)) {
                    (best, largest) = (place, size);
                }
            }
            let (row, column) = (best / d, best % d);
            pivots[at] = column;
            for j in 0..d {
                left.swap(at * d + j, row * d + j);
            }
            let pivot = left[at * d + column];
            left[at * d..(at + 1) * d].iter_mut().for_each(|v| *v /= pivot);
            for other in (0..count).filter(|&other| other != at) {
                let factor = left[other * d + column];
                for j in 0..d {
                    left[other * d + j] -= factor * left[at * d + j];
                }
            }
        }
        let mut order = try_collect(WHAT, 0..count)?;
        order.sort_unstable_by_key(|&at| pivots[at]);
        let mut sorted = try_zeros(WHAT, left.len())?;
        for (to, at) in sorted.chunks_exact_mut(d.max(1)).zip(order) {
            let row = &left[at * d..(at + 1) * d];
            let least = ROUNDING * row.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let sign = row.iter().find(|v| v.abs() > least).map_or(1.0, |v| v.signum());
            to.iter_mut().zip(row).for_each(|(to, v)| *to = if v.abs() < least { 0.0 } else { sign * v });
        }
        Ok(sorted)
    }
}

/// The triangle (width, width) of `rows` (any, width), which may be one already.
pub(super) fn reduced(rows: &[f64], width: usize, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
    let square = rows.len() == checked_len(WHAT, width, width)?;
    if square && (1..width).all(|i| rows[i * width..i * width + i].iter().all(|v| *v == 0.0)) {
        return try_copy(WHAT, rows);
    }
    triangle(rows, width, threads, stop)
}

/// Least squares of all rows of Theta from `rows` (any, width) `= [Z Y]`, or their triangle, of `size` pairs with `d`
/// columns in Z; of any rank.
///
/// `R11 = U diag(s) Q' D` with the column lengths D: `H' = D^-1 Q_r s_r^-1 U_r' R12` and
/// `S = R22' R22 + R12' (I - U_r U_r') R12`, where the second term is what a lower rank leaves.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`], [`Error::Numerical`], [`Error::Memory`],
/// [`Error::Interrupted`].
pub fn fit(rows: &[f64], width: usize, d: usize, size: usize, threads: usize, stop: &Stop) -> Result<Fitted> {
    if d >= width || !rows.len().is_multiple_of(width) {
        let found = format!("{} entries in rows of {width}", rows.len());
        return Err(Error::Shape { name: "rows", expected: format!("more than {d} columns"), found });
    }
    let (r, n) = (reduced(rows, width, threads, stop)?, width - d);
    let top = || r.chunks_exact(width).take(d);
    let regressors = try_collect(WHAT, (0..d * d).map(|at| r[at / d * width + at % d]))?;
    let lengths = lengths(&regressors, d, d)?;
    let scaled = try_collect(WHAT, regressors.iter().enumerate().map(|(at, v)| v / lengths[at % d]))?;
    let found = singular(&scaled, d, d)?;
    let (rank, mut missing) = null_space(&found.v, &found.s, d, size.max(d) as f64 * f64::EPSILON)?;
    missing.iter_mut().enumerate().for_each(|(at, v)| *v /= lengths[at / (d - rank)]);
    let entries = || (0..rank * d).map(|at| (found.v[at], found.s[at / d], lengths[at % d]));
    let white = try_collect(WHAT, entries().map(|(v, s, length)| v / s / length))?;
    let root = try_collect(WHAT, entries().map(|(v, s, length)| s * v * length))?;
    let mut residual = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
    // U_r' R12 (rank, n), and what it leaves of R12
    let mut along = try_zeros(WHAT, checked_len(WHAT, rank, n)?)?;
    for (along, u) in along.chunks_exact_mut(n).zip(found.u.chunks_exact(d.max(1))) {
        top().zip(u).for_each(|(row, u)| add(along, *u, &row[d..]));
    }
    for (t, row) in r.chunks_exact(width).enumerate() {
        stop.check()?;
        let mut left = try_copy(WHAT, &row[d..])?;
        if t < d {
            along.chunks_exact(n).enumerate().for_each(|(k, along)| add(&mut left, -found.u[k * d + t], along));
        }
        residual.chunks_exact_mut(n).zip(&left).for_each(|(to, e)| add(to, *e, &left));
    }
    let mut model = try_zeros(WHAT, checked_len(WHAT, n, d)?)?;
    for (along, white) in along.chunks_exact(n).zip(white.chunks_exact(d.max(1))) {
        model.chunks_exact_mut(d.max(1)).zip(along).for_each(|(to, a)| add(to, *a, white));
    }
    let rounding = (0..n).map(|i| {
        let fitted: f64 = (0..d).map(|j| model[i * d + j].abs() * lengths[j]).sum();
        SLACK * width as f64 * f64::EPSILON * (norm(r.iter().copied().skip(d + i).step_by(width)) + fitted)
    });
    let rounding = try_collect(WHAT, rounding)?;
    let ratio = if rank > 0 { found.s[rank - 1] / found.s[0] } else { 0.0 };
    let [rows, columns] = [try_collect(WHAT, 0..n)?, try_collect(WHAT, 0..d)?];
    Ok(Fitted { rows, columns, size, model, residual, white, root, missing, ratio, regressors, rounding })
}

/// `to += factor values`.
pub(super) fn add(to: &mut [f64], factor: f64, values: &[f64]) {
    to.iter_mut().zip(values).for_each(|(to, v)| *to += factor * v);
}

/// The lengths of the first `count` columns of rows of `width`; 1 for those of 0.
pub(crate) fn lengths(rows: &[f64], width: usize, count: usize) -> Result<Vec<f64>> {
    let length = |j| norm(rows.iter().copied().skip(j).step_by(width));
    try_collect(WHAT, (0..count).map(length).map(|size| if size == 0.0 { 1.0 } else { size }))
}

/// The rank of `M = U diag(s) Q'` and an orthonormal basis of its null space as columns (d, d - rank), from the rows of
/// Q'.
///
/// Singular values up to `share s_1` are taken for rounding, and so is a row w of the basis with
/// `||w|| <= share s_1 ||q / s||`, q the other entries of its row i: with the a in the range of M' with `a_i = 1` and
/// the smallest `||M a|| = 1 / ||q / s||`, row i of `basis - a w` is 0, and these columns span the null space of a
/// matrix within `||M a|| ||w|| <= share s_1` of M.
pub(crate) fn null_space(vectors: &[f64], s: &[f64], d: usize, share: f64) -> Result<(usize, Vec<f64>)> {
    let least = share * s.first().copied().unwrap_or(0.0);
    let rank = s.iter().filter(|s| **s > least).count();
    let count = d - rank;
    let mut basis = try_zeros(WHAT, checked_len(WHAT, d, count)?)?;
    for (i, row) in basis.chunks_exact_mut(count.max(1)).enumerate() {
        row.iter_mut().enumerate().for_each(|(q, to)| *to = vectors[(rank + q) * d + i]);
        if norm(row.iter().copied()) <= least * norm((0..rank).map(|k| vectors[k * d + i] / s[k])) {
            row.fill(0.0);
        }
    }
    Ok((rank, basis))
}
