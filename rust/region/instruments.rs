//! Regions for states measured with error, by instruments (Anderson and Rubin 1949).
//!
//! `e_t = y_t - Theta z_t` holds the noise of both readings, and the instruments zeta_t are independent of all noise. On a run
//! `e_t = w_t + v_{t+1} - A v_t`, so only every second pair may be used: then the e_t are independent.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::identify::{By, Estimate, Projected, SLACK, Symmetric, add, backward, cholesky, forward, lengths};
use crate::memory::{checked_len, try_collect, try_copy, try_zeros};

use super::models::Region;
use super::part::{Part, PartOf, WHAT};

/// In place of a variance that is not positive; its inverse is finite.
const TINY: f64 = 1e-300;

impl Region {
    /// `{E P E' <= q E (I - P) E'}`, q Roy's quantile of (n, r, N - r).
    ///
    /// At the truth both sides are Wishart matrices of r and N - r degrees. With `Q = P - q (I - P)`, `V = Z' Q Z` and
    /// `C = Y' Q Z V^-1`, completing the square gives `S = C V C' - Y' Q Y`.
    pub(super) fn by_instruments(found: &Projected, estimate: &Estimate, delta: f64, by: By<'_>) -> Result<Self> {
        let (n, d) = (estimate.n, estimate.d);
        let q = if found.rank >= d { by.roy(n, found.rank, found.size - found.rank, delta)? } else { f64::INFINITY };
        let bounded = if q.is_finite() { completed(found, (n, d), q, delta)? } else { None };
        let (rows, columns) = (try_collect(WHAT, 0..n)?, try_collect(WHAT, 0..d)?);
        let (centre, white, root, shape, factor) = match bounded {
            Some(Completed { centre, white, root, shape }) => (centre, white, root, shape, 1.0),
            None => {
                let model = try_copy(WHAT, &estimate.model)?;
                (model, identity(d)?, identity(d)?, identity(n)?, f64::INFINITY)
            }
        };
        let (white, root) = (&white[..], &root[..]);
        let of =
            PartOf { rows: &rows, columns: &columns, white, root, missing: &[], ratio: 1.0, shape: &shape, factor };
        Self::new(&centre, n, estimate.m, Vec::from([Arc::new(Part::new(of)?)]), None, false)
    }
}

struct Completed {
    centre: Vec<f64>,
    white: Vec<f64>,
    root: Vec<f64>,
    shape: Vec<f64>,
}

/// The square completed; None where V is not positive definite, so that nothing is bounded.
fn completed(found: &Projected, (n, d): (usize, usize), q: f64, delta: f64) -> Result<Option<Completed>> {
    let width = d + n;
    let sizes = lengths(&found.inside, width, d)?;
    // [Z Y]' Q [Z Y], in units in which the columns of P Z have length 1
    let mut form = try_zeros::<f64>(WHAT, checked_len(WHAT, width, width)?)?;
    let mut terms = try_zeros::<f64>(WHAT, n)?;
    let mut scaled = try_zeros::<f64>(WHAT, width)?;
    for (rows, sign) in [(&found.inside, 1.0), (&found.outside, -q)] {
        for row in rows.chunks_exact(width) {
            for (j, (to, v)) in scaled.iter_mut().zip(row).enumerate() {
                *to = v / sizes.get(j).copied().unwrap_or(1.0);
            }
            form.chunks_exact_mut(width).zip(&scaled).for_each(|(to, v)| add(to, sign * v, &scaled));
            terms.iter_mut().zip(&scaled[d..]).for_each(|(to, v)| *to += sign.abs() * v * v);
        }
    }
    let mut v = Symmetric::new(d)?;
    v.matrix.chunks_exact_mut(d).zip(form.chunks_exact(width)).for_each(|(to, row)| to.copy_from_slice(&row[..d]));
    let form_of_z = try_copy(WHAT, &v.matrix)?;
    let least = v.eigenvalues()?.iter().copied().fold(f64::INFINITY, f64::min);
    if least.is_nan() || least <= 1e-12 * d as f64 {
        return Ok(None);
    }
    let Some(lower) = cholesky(&form_of_z, d)? else { return Ok(None) };
    let mut centre = try_zeros::<f64>(WHAT, checked_len(WHAT, n, d)?)?;
    for (c, row) in centre.chunks_exact_mut(d).zip(form.chunks_exact(width).skip(d)) {
        c.copy_from_slice(&row[..d]);
        forward(&lower, d, c);
        backward(&lower, d, c);
    }
    // L' c of each row, so that C V C' = (L' C')' (L' C'); and the sizes of what is added up
    let mut shape = try_zeros::<f64>(WHAT, checked_len(WHAT, n, n)?)?;
    for i in 0..n {
        let c = |i: usize| &centre[i * d..(i + 1) * d];
        let times = |j: usize, a: &dyn Fn(f64) -> f64| -> f64 {
            let row =
                |k: usize| form_of_z[k * d..(k + 1) * d].iter().zip(c(j)).map(|(v, c)| a(*v) * a(*c)).sum::<f64>();
            c(i).iter().enumerate().map(|(k, c)| a(*c) * row(k)).sum()
        };
        for j in 0..n {
            shape[i * n + j] = times(j, &|v| v) - form[(d + i) * width + d + j];
        }
        terms[i] += times(i, &f64::abs);
    }
    // widened by the rounding of these differences, which noise of few sources leaves alone
    let rounding = n as f64 * SLACK * width as f64 * f64::EPSILON;
    shape.iter_mut().step_by(n + 1).zip(&terms).for_each(|(v, term)| *v += rounding * term);
    let deviation = |i: usize| shape[i * (n + 1)].max(TINY).sqrt();
    let mut correlations = Symmetric::new(n)?;
    for (at, to) in correlations.matrix.iter_mut().enumerate() {
        *to = shape[at] / deviation(at / n) / deviation(at % n);
    }
    let least = correlations.eigenvalues()?.iter().copied().fold(f64::INFINITY, f64::min);
    if least < -SLACK * n as f64 * f64::EPSILON {
        let found = format!(
            "some with which no model explains these data (delta={delta}): an instrument depends on the noise, or the \
             noise is not white or not Gaussian"
        );
        return Err(Error::Value { name: "instruments", expected: "independent of the noise", found });
    }
    // V = L L' / D^2: root = L' D, white = L^-1 D^-1
    let (mut white, mut root) = (identity(d)?, try_zeros(WHAT, d * d)?);
    for k in 0..d {
        let mut column = try_zeros(WHAT, d)?;
        column[k] = 1.0;
        forward(&lower, d, &mut column);
        for i in 0..d {
            white[i * d + k] = column[i] / sizes[k];
            root[i * d + k] = lower[k * d + i] * sizes[k];
        }
    }
    centre.iter_mut().enumerate().for_each(|(at, c)| *c /= sizes[at % d]);
    Ok(Some(Completed { centre, white, root, shape }))
}

fn identity(n: usize) -> Result<Vec<f64>> {
    let mut found = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
    found.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
    Ok(found)
}
