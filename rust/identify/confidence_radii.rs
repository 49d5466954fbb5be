//! How large a region must be: the factor of `(Theta - C) V (Theta - C)' <= factor S`.
//!
//! `D = H - Theta` of least squares. Independent design: `D V^(1/2) = Sigma^(1/2) G` and
//! `S = Sigma^(1/2) E Sigma^(1/2)` with G standard normal and E an independent Wishart matrix of nu degrees (Anderson
//! 2003, ch. 8), so that all laws are free of Theta and Sigma. Any design: mixtures of supermartingales over lines,
//! with Ville's inequality, valid for all N at once.

use std::f64::consts::PI;

use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_copy, try_zeros};
use crate::parallel::Stop;

use super::assumed::{Assumed, Covariance, RegionMethod, Wish};
use super::distributions::{chi2_quantile, chi2_upper};
use super::kept::{Law, kept};
use super::least_squares::{Fitted, WHAT, add};
use super::levels::least_squares_level;
use super::quantiles::{
    diagonal_quantile, joint_radii, log_multigamma, roy_quantile, scalar_quantile, smallest_quantile, wishart_quantile,
};
use super::symmetric::{log_determinant, spectral_norm};
use super::triangle::triangle;
use super::units::Measured;

/// The factor and S; the covariance of the noise is at most `noise` in the same event.
#[derive(Debug, Clone)]
pub(crate) struct Radius {
    pub factor: f64,
    pub shape: Vec<f64>,
    pub noise: Option<Vec<f64>>,
}

impl Radius {
    fn of(factor: f64, shape: &[f64]) -> Result<Self> {
        Ok(Self { factor, shape: try_copy(WHAT, shape)?, noise: None })
    }

    /// Around the trace of a matrix (n, n), times I.
    fn of_trace(factor: f64, matrix: &[f64], n: usize) -> Result<Self> {
        let trace: f64 = matrix.iter().step_by(n + 1).sum();
        let mut shape = try_zeros(WHAT, matrix.len())?;
        shape.iter_mut().step_by(n + 1).for_each(|to| *to = trace);
        Ok(Self { factor, shape, noise: None })
    }
}

/// Threads and a stop for what has to be computed.
#[derive(Clone, Copy)]
pub(crate) struct By<'a> {
    pub threads: usize,
    pub stop: &'a Stop,
}

impl By<'_> {
    /// Roy's quantile of the largest root of `E^-1 G G'`, kept.
    pub fn roy(self, n: usize, d: usize, nu: usize, delta: f64) -> Result<f64> {
        let found = || roy_quantile(n, d, nu, delta, self.threads, self.stop);
        self.one(Law::Roy, [n, d, nu], delta, found)
    }

    /// Radii of the spectral and the Frobenius norm of `E^(-1/2) G` in one event, kept.
    pub fn joint(self, n: usize, d: usize, nu: usize, delta: f64) -> Result<(f64, f64)> {
        kept(Law::Joint, [n, d, nu], delta, || joint_radii(n, d, nu, delta, self.threads, self.stop))
    }

    /// The quantile of the largest root of `G G'`, kept; that of its trace where rounding leaves no other.
    pub fn wishart(self, n: usize, d: usize, delta: f64) -> Result<f64> {
        let found = || {
            let largest = wishart_quantile(n, d, delta, self.threads, self.stop)?;
            if largest.is_finite() { Ok(largest) } else { chi2_upper(delta, (n * d) as f64) }
        };
        self.one(Law::Wishart, [n, d, 0], delta, found)
    }

    /// The quantile of the smallest root of `W_n(I, N)`, kept.
    pub fn smallest(self, n: usize, size: usize, delta: f64) -> Result<f64> {
        let found = || smallest_quantile(n, size, delta, self.threads, self.stop);
        self.one(Law::Smallest, [n, size, 0], delta, found)
    }

    fn one(self, law: Law, sizes: [usize; 3], delta: f64, compute: impl FnOnce() -> Result<f64>) -> Result<f64> {
        Ok(kept(law, sizes, delta, || compute().map(|found| (found, 0.0)))?.0)
    }
}

/// The exact factor for z independent of Gaussian noise; `columns`: rank, with noise to come.
///
/// Full: Roy's root of `E^-1 G G'`, for one row the law of F; diagonal and scalar: the root of `G G'` against the
/// diagonal and the trace of S; known: the root of `G G'` alone.
pub(crate) fn independent(
    f: &Fitted,
    covariance: Covariance<'_>,
    columns: usize,
    delta: f64,
    by: By<'_>,
) -> Result<Radius> {
    let (n, nu, By { threads, stop }) = (f.rows.len(), f.degrees(), by);
    if let Covariance::Known(known) = covariance {
        let factor = if columns == 0 { 0.0 } else { by.wishart(n, columns, delta)? };
        return Radius::of(factor, if columns == 0 { &f.residual } else { known });
    }
    if columns == 0 {
        return Radius::of(0.0, &f.residual);
    }
    if nu == 0 {
        let mut unbounded = Radius::of(f64::INFINITY, &f.residual)?;
        unbounded.shape.iter_mut().enumerate().for_each(|(at, v)| *v = f64::from(u8::from(at % (n + 1) == 0)));
        return Ok(unbounded);
    }
    let sizes = [n, columns, nu];
    match covariance {
        Covariance::Scalar if n > 1 => {
            let quantile = || scalar_quantile(n, columns, nu, delta, threads, stop);
            Radius::of_trace(by.one(Law::Scalar, sizes, delta, quantile)?, &f.residual, n)
        }
        Covariance::Diagonal if n > 1 => {
            let quantile = || diagonal_quantile(n, columns, nu, delta, threads, stop);
            let mut found = Radius::of(by.one(Law::Diagonal, sizes, delta, quantile)?, &f.residual)?;
            found.shape.iter_mut().enumerate().filter(|(at, _)| at % (n + 1) > 0).for_each(|(_, v)| *v = 0.0);
            Ok(found)
        }
        _ => Radius::of(by.roy(n, columns, nu, delta)?, &f.residual),
    }
}

/// The factor for any design, in `units` fixed before the pairs; unbounded without them.
///
/// Known noise: the sphere mixture. Unknown Gaussian noise: the same with a lower bound of the covariance, or the
/// marginal likelihood over the largest; [`RegionMethod::Auto`] takes the smaller of both at `delta / 2` each.
pub(crate) fn adaptive(
    f: &Fitted,
    assumed: Assumed<'_>,
    wish: Wish<'_>,
    units: impl FnOnce() -> Result<Option<Measured>>,
    delta: f64,
    by: By<'_>,
) -> Result<Radius> {
    let n = f.rows.len();
    if f.rank() == 0 {
        return Radius::of(0.0, &f.residual);
    }
    let Some(units) = units()? else { return Radius::of(f64::INFINITY, &f.residual) };
    if let Covariance::Known(known) = assumed.covariance {
        return Radius::of(mixture_level(f, &units, delta, assumed.tail)?, known);
    }
    let auto = wish.method == RegionMethod::Auto && assumed.tail == 0.0; // with a tail there is no likelihood
    let share = if auto { delta / 2.0 } else { delta };
    let marginal = |share| Radius::of(universal(f, &units, share)?, &f.residual);
    if wish.method == RegionMethod::Universal && assumed.tail == 0.0 {
        return marginal(share);
    }
    let mixed = unknown_noise(f, assumed, &units, share, wish.anytime, by)?;
    if !auto {
        return Ok(mixed);
    }
    let other = marginal(share)?;
    let size = |one: &Radius| Ok::<_, crate::Error>(one.factor * spectral_norm(&one.shape, n, n)?);
    let smaller = size(&other)? < size(&mixed)?;
    Ok(if smaller { Radius { noise: mixed.noise, ..other } } else { mixed })
}

/// `rho^2` with `||D V^(1/2)||^2 <= rho^2 sigma^2`, from `log det(I + V / lam)` over the mixtures.
///
/// A tail of `sum ||Sigma^(-1/2) r||^2 <= tail^2 N` beside the noise adds `tail sqrt N` to rho.
fn mixture_level(f: &Fitted, units: &Measured, delta: f64, tail: f64) -> Result<f64> {
    let smallest = units.squares[f.rank() - 1];
    let ld = try_collect(WHAT, units.lams.iter().map(|lam| units.ld(*lam)))?;
    let wider = try_collect(WHAT, units.lams.iter().map(|lam| 1.0 + lam / smallest))?;
    let level = least_squares_level(f.rows.len(), &ld, &wider, delta, false)?;
    Ok(if tail > 0.0 { (level.sqrt() + tail * (f.size as f64).sqrt()).powi(2) } else { level })
}

/// Gaussian noise of one covariance: `rho^2` at `delta / 2`, and as much for the covariance.
///
/// Full: `S >= (a - rho^2) Sigma`, a the quantile of the smallest root of `W_n(I, N)`; scalar:
/// `tr S >= (chi^2_{nN} - min(n, rank) rho^2) sigma^2`: the covariance is at most S over that. `anytime` shares by
/// `1 / (N (N + 1))`.
fn unknown_noise(
    f: &Fitted,
    assumed: Assumed<'_>,
    units: &Measured,
    delta: f64,
    anytime: bool,
    by: By<'_>,
) -> Result<Radius> {
    let (n, size) = (f.rows.len(), f.size as f64);
    let share = delta / 2.0 / if anytime { size * (size + 1.0) } else { 1.0 };
    let rho2 = mixture_level(f, units, delta / 2.0, assumed.tail)?;
    // ||e + r|| >= ||e|| - tail sqrt N, in units of the noise
    let less = |a: f64| (a.sqrt() - assumed.tail * size.sqrt()).max(0.0).powi(2);
    let less = |a: f64| if assumed.tail > 0.0 { less(a) } else { a };
    let (left, mut found) = if matches!(assumed.covariance, Covariance::Scalar) {
        let left = less(chi2_quantile(share, n as f64 * size)?) - n.min(f.rank()) as f64 * rho2;
        (left, Radius::of_trace(f64::INFINITY, &f.residual, n)?)
    } else {
        let left = less(by.smallest(n, f.size, share)?) - rho2;
        (left, Radius::of(f64::INFINITY, &f.residual)?)
    };
    if left > 0.0 {
        found.factor = rho2 / left;
        found.noise = Some(try_collect(WHAT, found.shape.iter().map(|v| v / left))?);
    }
    Ok(found)
}

/// `det(I + S^-1 D V D') <= rho`: marginal over largest likelihood; `rho - 1` is the factor.
///
/// Prior `Theta ~ N(C, Sigma x I)` and `Sigma ~ IW(psi I, n + 2)` in the units (Wasserman, Ramdas and Balakrishnan
/// 2020). The region is valid for any prior.
fn universal(f: &Fitted, units: &Measured, delta: f64) -> Result<f64> {
    let (n, d, pairs) = (f.rows.len(), f.columns.len(), f.size as f64);
    if f.degrees() < n {
        return Ok(f64::INFINITY);
    }
    let (prior, psi) = (n as f64 + 2.0, units.psi);
    let mut s = try_copy(WHAT, &f.residual)?;
    s.iter_mut().enumerate().for_each(|(at, v)| *v = *v / units.sizes[at / n] / units.sizes[at % n]);
    let Some(log_s) = log_determinant(&s, n)? else { return Ok(f64::INFINITY) };
    // the triangle of [R11, R11 (H - C)'; I, 0]: below it what ridge leaves of the fitted part
    let r = units.regressors.len() / d;
    let mut rows = try_zeros(WHAT, checked_len(WHAT, d + r, r + n)?)?;
    for (i, row) in rows.chunks_exact_mut(r + n).enumerate() {
        if i >= d {
            row[i - d] = 1.0;
            continue;
        }
        row[..r].copy_from_slice(&units.regressors[i * r..(i + 1) * r]);
        row[r..].copy_from_slice(&units.fitted[i * n..(i + 1) * n]);
    }
    let below = triangle(&rows, r + n, 1, &Stop::new())?;
    for row in below.chunks_exact(r + n).skip(r) {
        s.chunks_exact_mut(n).zip(&row[r..]).for_each(|(to, v)| add(to, *v, &row[r..]));
    }
    s.iter_mut().step_by(n + 1).for_each(|v| *v += psi);
    let Some(log_psi) = log_determinant(&s, n)? else { return Ok(f64::INFINITY) };
    let ld = units.ld(1.0);
    let sides = n as f64;
    let log_marginal = -sides * pairs / 2.0 * PI.ln() - sides / 2.0 * ld + prior * sides / 2.0 * psi.ln()
        - (prior + pairs) / 2.0 * log_psi
        + log_multigamma((prior + pairs) / 2.0, n)
        - log_multigamma(prior / 2.0, n);
    let log_rho = -2.0 / pairs * (log_marginal + delta.ln() + sides * pairs / 2.0 * (1.0 + (2.0 * PI).ln()));
    Ok((log_rho + sides * pairs.ln() - log_s).exp_m1())
}
