//! What the mixtures of any design are measured in: fixed before the pairs of the estimate.
//!
//! A supermartingale that starts at 1 after the first N1 pairs may be measured in anything they say: with
//! `P = Z1 Z1' / N1` and `kappa_j` fixed in advance, over the N2 pairs after them, for all of these at once,
//!
//! ```text
//! ||M (V + kappa P)^(-1/2)||^2 <= 2 sigma^2 c,    ld = log det(I + P^-1 V / kappa),    V + kappa P <= (1 + kappa / s_min) V
//! ```
//!
//! with the smallest eigenvalue `s_min` of `P^-1 V`. The pairs of the first part are in P only.

use crate::control::singular;
use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::memory::{checked_len, try_collect, try_extend, try_filled, try_zeros};
use crate::parallel::Stop;

use super::estimate::Estimate;
use super::least_squares::{Fitted, WHAT, fit};
use super::triangle::triangle;

/// `lam` of the mixtures in units of the squared scale of z: fixed before the data, as the event of a region refers to
/// them.
pub const MIXTURES: [f64; 16] = {
    let (mut grid, mut j) = ([0.0625; 16], 1);
    while j < 16 {
        grid[j] = 2.0 * grid[j - 1];
        j += 1;
    }
    grid
};
/// The noise in the prior of the universal region, in units of the squared scale: fixed before the data.
pub const PRIOR_NOISE: f64 = 0.01;
/// `kappa / N2` of the mixtures after a first part; between N/64 and N/4 first pairs, all of them do nearly as well.
const SHARES: [f64; 3] = [1.0 / 6.0, 1.0 / 3.0, 2.0 / 3.0];

/// What the size of z and of the noise is expected to be.
#[derive(Debug, Clone, Copy)]
pub enum Magnitudes<'a> {
    /// As told: sizes (d) of the columns of z, fixed before the data.
    Expected(&'a [f64]),
    /// As in the first part of the data, which the pairs of the estimate come after; their number was fixed beforehand.
    First(&'a Estimate),
}

/// How many of the first of N pairs `rows` (N, width) `= [Z Y]` are to say the size of the others: `max(N / 8, 2 d)`,
/// and twice as many again up to N / 2 while they do not determine all of Z. None for `N < 4 d`.
///
/// The number is a stopping time: it depends on no pair behind it.
///
/// # Errors
/// As [`fit`].
pub fn first_pairs(rows: &[f64], width: usize, d: usize, threads: usize, stop: &Stop) -> Result<Option<usize>> {
    if d == 0 || d >= width || !rows.len().is_multiple_of(width) {
        let found = format!("{} entries in rows of {width}", rows.len());
        return Err(Error::Shape { name: "rows", expected: format!("more than {d} > 0 columns"), found });
    }
    let size = rows.len() / width;
    if size / 4 < d {
        return Ok(None);
    }
    let mut first = (size / 8).max(2 * d);
    let mut done = 0;
    let mut found = Vec::new();
    loop {
        try_extend(WHAT, &mut found, rows[done * width..first * width].iter().copied())?;
        found = triangle(&found, width, threads, stop)?;
        if 2 * first > size / 2 || fit(&found, width, d, first, threads, stop)?.rank() == d {
            return Ok(Some(first));
        }
        (done, first) = (first, 2 * first);
    }
}

/// The units for the rows and columns of one block.
pub(crate) struct Measured {
    /// Z in these units: its triangle times them (d, r).
    pub regressors: Vec<f64>,
    /// `lam` of the mixtures in the squared unit.
    pub lams: Vec<f64>,
    /// The expected sizes (n) of the noise, and psi of the prior of its copsi in them.
    pub sizes: Vec<f64>,
    /// See `sizes`.
    pub psi: f64,
    /// `(H - C) Z` for the expected model C, in `sizes`, by the rows of the triangle (d, n).
    pub fitted: Vec<f64>,
    /// Squared singular values of `regressors`, the largest first.
    pub squares: Vec<f64>,
}

impl Measured {
    /// In the sizes (d) of columns and (n) of rows.
    pub fn expected(f: &Fitted, columns: &[f64], sizes: Vec<f64>) -> Result<Self> {
        let d = columns.len();
        let regressors = try_collect(WHAT, f.regressors.iter().enumerate().map(|(at, v)| v / columns[at % d]))?;
        Self::new(f, regressors, d, try_collect(WHAT, MIXTURES)?, sizes, PRIOR_NOISE, None)
    }

    /// In those of the first part; None where the pairs behind it hold a direction of z that it does not have.
    ///
    /// `white' white = V1^+`, so that `P^+ V` has N1 times the squares of `R2 white'` as eigenvalues.
    pub fn first(f: &Fitted, first: &Fitted) -> Result<Option<Self>> {
        let (d, r) = (f.columns.len(), first.rank());
        let lengths = f.lengths()?;
        let least = f.size.max(d) as f64 * f64::EPSILON;
        for q in 0..d - r {
            let missing = || first.missing.iter().copied().skip(q).step_by(d - r);
            let along =
                f.regressors.chunks_exact(d).map(|row| row.iter().zip(missing()).map(|(z, m)| z * m).sum::<f64>());
            let size = missing().zip(&lengths).map(|(m, length)| m.abs() * length).sum::<f64>();
            if norm(along) > least * size {
                return Ok(None);
            }
        }
        let mut regressors = try_zeros(WHAT, checked_len(WHAT, d, r)?)?;
        for (to, z) in regressors.chunks_exact_mut(r.max(1)).zip(f.regressors.chunks_exact(d)) {
            let each = first.white.chunks_exact(d).map(|white| white.iter().zip(z).map(|(a, b)| a * b).sum::<f64>());
            to.iter_mut().zip(each).for_each(|(to, v)| *to = v);
        }
        let (n, pairs) = (f.rows.len(), f.size as f64 / first.size as f64);
        let degrees = first.degrees().max(1) as f64;
        let deviations = first.residual.iter().step_by(n + 1).map(|v| (v / degrees).sqrt());
        let sizes = try_collect(WHAT, deviations.map(|v| if v > 0.0 { v } else { 1.0 }))?;
        let lams = try_collect(WHAT, SHARES.map(|share| share * pairs))?;
        // the mean of Sigma^-1 is I / sizes^2: with n + 2 degrees of freedom
        Self::new(f, regressors, r, lams, sizes, n as f64 + 2.0, Some(&first.model)).map(Some)
    }

    fn new(
        f: &Fitted,
        regressors: Vec<f64>,
        r: usize,
        lams: Vec<f64>,
        sizes: Vec<f64>,
        psi: f64,
        centre: Option<&[f64]>,
    ) -> Result<Self> {
        let (n, d) = (f.rows.len(), f.columns.len());
        let mut fitted = try_filled(WHAT, 0.0, checked_len(WHAT, d, n)?)?;
        for (to, z) in fitted.chunks_exact_mut(n).zip(f.regressors.chunks_exact(d)) {
            for (k, to) in to.iter_mut().enumerate() {
                let row = |model: &[f64]| model[k * d..(k + 1) * d].iter().zip(z).map(|(a, b)| a * b).sum::<f64>();
                *to = (row(&f.model) - centre.map_or(0.0, row)) / sizes[k];
            }
        }
        let squares = try_collect(WHAT, singular(&regressors, d, r)?.s.into_iter().map(|s| s * s))?;
        Ok(Self { regressors, lams, sizes, psi, fitted, squares })
    }

    /// `log det(I + V / lam)`.
    pub fn ld(&self, lam: f64) -> f64 {
        self.squares.iter().map(|square| (square / lam).ln_1p()).sum()
    }
}
