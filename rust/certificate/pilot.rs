//! A model by instruments that a pilot model simulates, with the exact law of its error.
//!
//! The pilot `H0` repeats each run on paper: from its measured start, with its inputs or its dither. This gives one
//! `zeta` for each `z = (x, u, 1)`. Let the rows of `Z`, `Y`, `W` be regressors, outcomes and noise, `zeta = Q R` with
//! orthonormal columns of Q. Given pilot, starts and inputs, Q is fixed and `W' Q = Sigma^(1/2) Gamma` with Gamma (n,
//! d) standard normal, hence
//!
//! ```text
//! H = Y' Q T,    T = (Z' Q)^-1,    H - Theta = Sigma^(1/2) Gamma T            exactly
//! ||(H - Theta) z|| <= rho ||Sigma^(1/2)|| ||T z||        for all z at once where ||Gamma|| <= rho.
//! ```
//!
//! An unknown covariance is bounded by the residuals `E = Y - Z H'`, which no direction of Q enters: `Q' E = 0`, and
//! with `tau = ||T Z' (I - Q Q')||`
//!
//! ```text
//! ||E||_F >= sigma (chi_{n (N - d)} - frobenius tau),    E' E >= (sqrt(lam_min W_n(I, N - d)) - spectral tau)^2 Sigma.
//! ```
//!
//! For inputs by any feedback the weights of [`super::spend`] are the rows of Q, after a first part of the log that
//! gives `H0`. Their Gamma is not independent of the residuals. With S and `H_LS` of least squares of the same pairs,
//! `V = Z' Z`, `beta = lam_max(S^-1 (H_LS - H) V (H_LS - H)')`, `b = spectral ||T V^(1/2)||` and a the quantile of
//! `lam_min W_n(I, N)`:
//!
//! ```text
//! Sigma <= S / s,    sqrt(s) = (sqrt(beta b^2 + (1 + beta) (a - b^2)) - sqrt(beta) b) / (1 + beta)    if a > b^2,
//! ```
//!
//! the root of `s + (sqrt(beta s) + b)^2 = a`, since `W W' = S + (H_LS - Theta) V (..)'`,
//! `H_LS - Theta = (H_LS - H) + (H - Theta)`.

use std::sync::Arc;

use faer::{MatMut, MatRef};

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{
    By, Covariance, SLACK, chi2_quantile, chi2_upper, cholesky, fit, level, spectral_norm, triangle, whiten,
};
use crate::matrix::MatrixView;
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, PartOf, Region, times};

use super::powers::{product, transposed_inverse};
use super::spend::spend;

pub(super) const WHAT: &str = "a model by instruments";
/// `Z' Q` with columns of unit length counts as singular below this ratio of singular values: T would have half its
/// digits.
const SINGULAR: f64 = 1e-8;
/// The share of delta for an unknown covariance: fixed, not tuned on data.
pub(super) const COVARIANCE: f64 = 0.12;

/// Measured runs: rows `(x, u, x_next)`, so many for each run, one run after another.
#[derive(Debug, Clone, Copy)]
pub struct MainRuns<'a> {
    /// (N, 2 n + m).
    pub rows: &'a [f64],
    /// Steps of each run, of sum N.
    pub lengths: &'a [usize],
    /// States.
    pub n: usize,
    /// Inputs.
    pub m: usize,
}

/// How the runs are simulated: `u = gain x + dither`, without a `gain` the inputs that were recorded.
#[derive(Debug, Clone, Copy)]
pub struct Simulation<'a> {
    /// The pilot `[A B]` or `[A B c]` (n, d).
    pub model: &'a [f64],
    /// (m, n), and the dither of each pair (N, m).
    pub feedback: Option<(&'a [f64], &'a [f64])>,
}

/// What holds in one event: bounds of the norms of Gamma, and of the covariance.
#[derive(Debug, Clone)]
pub struct Event {
    /// Of `||Gamma||_2`.
    pub spectral: f64,
    /// Of `||Gamma||_F`, or infinity.
    pub frobenius: f64,
    /// Of Sigma, with room for the rounding of H (n, n); infinite where there is none.
    pub covariance: Vec<f64>,
}

/// The model `H` and what the law of its error needs.
#[derive(Debug, Clone)]
pub struct Pilot {
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) d: usize,
    pairs: usize,
    /// The pilot (n, d).
    pub(super) model: Vec<f64>,
    /// H (n, d).
    pub(super) h: Vec<f64>,
    /// T (d, d).
    pub(super) t: Vec<f64>,
    /// `(R^-1)'` (d, d).
    pub(super) t0: Vec<f64>,
    /// `Q' Z` (d, d): `T' T = (root' root)^-1`.
    root: Vec<f64>,
    ratio: f64,
    tau: f64,
    /// `E' E` (n, n).
    residual: Vec<f64>,
    /// Rounding of each row of `H (Z' Q)` (n).
    rounding: Vec<f64>,
    /// Of weights after the past: S (n, n), beta and `||T V^(1/2)||`.
    weighted: Option<(Vec<f64>, f64, f64)>,
}

/// The pairs of a log with any feedback: rows `(z, y)` in the order of time, and what the ones before them say.
#[derive(Debug, Clone, Copy)]
pub struct LaterPairs<'a> {
    /// (N, d + n).
    pub rows: &'a [f64],
    /// The model of the first pairs (n, d).
    pub model: &'a [f64],
    /// The triangle of their z, divided by the root of their number (d, d).
    pub root: &'a [f64],
    /// Their number.
    pub before: usize,
    /// The number of inputs.
    pub m: usize,
}

impl Pilot {
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`] where the pilot's simulation or a square of the data
    /// leaves the range of doubles, [`Error::Memory`], [`Error::Interrupted`].
    pub fn new(runs: MainRuns<'_>, simulation: Simulation<'_>, threads: usize, stop: &Stop) -> Result<Self> {
        room_for_products()?;
        let (n, m, model) = (runs.n, runs.m, simulation.model);
        let d = model.len().checked_div(n).unwrap_or(0);
        let rows = simulated(runs, simulation, d, stop)?;
        Self::of_instruments(rows, model, (n, m, d), threads, stop)
    }

    /// Of pairs with any feedback: the rows of Q are weights of the past.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`] for too few pairs or first pairs that determine nothing, [`Error::Overflow`],
    /// [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn after(of: LaterPairs<'_>, threads: usize, stop: &Stop) -> Result<Self> {
        room_for_products()?;
        let d = of.root.len().isqrt();
        let n = of.model.len().checked_div(d).unwrap_or(0);
        let fits = n > 0 && of.model.len() == n * d && of.root.len() == d * d && (d == n + of.m || d == n + of.m + 1);
        if !fits || !of.rows.len().is_multiple_of(d + n) {
            let found = format!("{} and {} entries", of.rows.len(), of.root.len());
            let expected = "rows (z, y), a model (n, d) and a triangle (d, d)".into();
            return Err(Error::Shape { name: "pairs", expected, found });
        }
        let count = of.rows.len() / (d + n);
        let mut z = try_room(WHAT, checked_len(WHAT, count, d)?)?;
        of.rows.chunks_exact(d + n).for_each(|row| z.extend_from_slice(&row[..d]));
        let weights = spend(&z, of.root, of.before, d, stop)?;
        let mut rows = try_room(WHAT, checked_len(WHAT, count, 2 * d + n)?)?;
        for (q, row) in weights.chunks_exact(d).zip(of.rows.chunks_exact(d + n)) {
            rows.extend_from_slice(q);
            rows.extend_from_slice(row);
        }
        let mut made = Self::of_instruments(rows, of.model, (n, of.m, d), threads, stop)?;
        // the forecast of T: N^(-1/2) root'^-1
        let units = try_filled(WHAT, 1.0, d)?;
        let scaled = try_collect(WHAT, of.root.iter().map(|v| v * (count as f64).sqrt()))?;
        made.t0 = transposed_inverse(&scaled, &units, d)?.0;
        let plain = fit(&triangle(of.rows, d + n, threads, stop)?, d + n, d, count, threads, stop)?;
        let apart = try_collect(WHAT, plain.model.iter().zip(&made.h).map(|(a, b)| a - b))?;
        let (rank, white) = (plain.root.len() / d, &plain.root);
        // M V^(1/2)
        let times_root = |of: &[f64]| -> Result<Vec<f64>> {
            let mut found = try_zeros(WHAT, checked_len(WHAT, of.len() / d, rank)?)?;
            for (to, row) in found.chunks_exact_mut(rank.max(1)).zip(of.chunks_exact(d)) {
                let each = white.chunks_exact(d).map(|v| v.iter().zip(row).map(|(a, b)| a * b).sum::<f64>());
                to.iter_mut().zip(each).for_each(|(to, v)| *to = v);
            }
            Ok(found)
        };
        let mut along = times_root(&apart)?;
        let beta = match cholesky(&plain.residual, n)? {
            Some(lower) => {
                let to = MatMut::from_row_major_slice_mut(&mut along, n, rank);
                whiten(MatRef::from_row_major_slice(&lower, n, n), to);
                spectral_norm(&along, n, rank)?.powi(2)
            }
            None => f64::INFINITY,
        };
        let seen = times_root(&made.t)?;
        let tau = if made.determined() && rank == d { spectral_norm(&seen, d, rank)? } else { f64::INFINITY };
        made.weighted = Some((try_copy(WHAT, &plain.residual)?, beta, tau));
        Ok(made)
    }

    fn of_instruments(
        rows: Vec<f64>,
        model: &[f64],
        (n, m, d): (usize, usize, usize),
        threads: usize,
        stop: &Stop,
    ) -> Result<Self> {
        let width = 2 * d + n;
        let (r, pairs) = (triangle(&rows, width, threads, stop)?, rows.len() / width);
        drop(rows);
        let block = |from: usize, to: usize, left: usize, right: usize| -> Result<Vec<f64>> {
            let mut found = try_room(WHAT, checked_len(WHAT, to - from, right - left)?)?;
            (from..to).for_each(|i| found.extend_from_slice(&r[i * width + left..i * width + right]));
            Ok(found)
        };
        let columns = try_collect(WHAT, (0..width).map(|j| norm(r.iter().skip(j).step_by(width).copied())))?;
        let units = try_collect(WHAT, columns.iter().map(|size| if *size > 0.0 { *size } else { 1.0 }))?;
        // root = Q' Z = M D with the lengths D of the columns of Z: T = (M^-1)' D^-1
        let (root, outcomes) = (block(0, d, d, 2 * d)?, block(0, d, 2 * d, 2 * d + n)?);
        let (t, ratio) = transposed_inverse(&root, &units[d..2 * d], d)?;
        let (t0, _) = transposed_inverse(&block(0, d, 0, d)?, &units[..d], d)?;
        // H' = root^-1 Q' Y, with one step of refinement
        let mut h = try_zeros(WHAT, checked_len(WHAT, n, d)?)?;
        for _ in 0..2 {
            let mut left = try_copy(WHAT, &outcomes)?;
            for (left, root) in left.chunks_exact_mut(n).zip(root.chunks_exact(d)) {
                let fitted = h.chunks_exact(d).map(|h| h.iter().zip(root).map(|(a, b)| a * b).sum::<f64>());
                left.iter_mut().zip(fitted).for_each(|(to, fitted)| *to -= fitted);
            }
            for (left, t) in left.chunks_exact(n).zip(t.chunks_exact(d)) {
                for (h, left) in h.chunks_exact_mut(d).zip(left) {
                    h.iter_mut().zip(t).for_each(|(h, t)| *h += left * t);
                }
            }
        }
        let eps = SLACK * width as f64 * f64::EPSILON;
        let size = |(h, y): (&[f64], &f64)| y + h.iter().zip(&columns[d..]).map(|(h, z)| h.abs() * z).sum::<f64>();
        let rounding = try_collect(WHAT, h.chunks_exact(d).zip(&columns[2 * d..]).map(|of| eps * size(of)))?;
        // (I - Q Q') (Y - Z H') has the triangle [C - B H'], [B C] the rows of R below d
        let mut residual = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
        let mut e = try_zeros(WHAT, n)?;
        for row in r.chunks_exact(width).skip(d) {
            let (z, y) = row[d..].split_at(d);
            for ((e, y), h) in e.iter_mut().zip(y).zip(h.chunks_exact(d)) {
                *e = y - h.iter().zip(z).map(|(h, z)| h * z).sum::<f64>();
            }
            for (to, a) in residual.chunks_exact_mut(n).zip(&e) {
                to.iter_mut().zip(&e).for_each(|(to, b)| *to += a * b);
            }
        }
        let outside = block(d, 2 * d, d, 2 * d)?; // the triangle of (I - Q Q') Z
        let mut seen = try_zeros(WHAT, checked_len(WHAT, d, d)?)?;
        for (to, t) in seen.chunks_exact_mut(d).zip(t.chunks_exact(d)) {
            let along = outside.chunks_exact(d).map(|z| z.iter().zip(t).map(|(z, t)| z * t).sum::<f64>());
            to.iter_mut().zip(along).for_each(|(to, value)| *to = value);
        }
        let tau = if ratio > SINGULAR { spectral_norm(&seen, d, d)? } else { f64::INFINITY };
        let model = try_copy(WHAT, model)?;
        Ok(Self { n, m, d, pairs, model, h, t, t0, root, ratio, tau, residual, rounding, weighted: None })
    }

    /// `H` (n, d).
    #[must_use]
    pub fn centre(&self) -> &[f64] {
        &self.h
    }

    /// `T` (d, d) with `H - Theta = Sigma^(1/2) Gamma T`.
    #[must_use]
    pub fn white(&self) -> &[f64] {
        &self.t
    }

    /// Whether the instruments determine the model.
    #[must_use]
    pub fn determined(&self) -> bool {
        self.ratio > SINGULAR
    }

    /// The event of probability `1 - radii - noise`: norms of Gamma, each at half of `radii` or, without the one of
    /// Frobenius, the other at all of it; and of an unknown covariance. A known one may be a bound that holds for each
    /// step.
    ///
    /// # Errors
    /// [`Error::Value`] for levels outside (0, 1), [`Error::Shape`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn event(
        &self,
        covariance: Covariance<'_>,
        (radii, noise): (f64, f64),
        both: bool,
        stop: &Stop,
    ) -> Result<Event> {
        let (n, d, by) = (self.n, self.d, By { threads: 1, stop });
        let mut spectral = by.wishart(n, d, if both { radii / 2.0 } else { radii })?.sqrt();
        let mut frobenius =
            if both { chi2_upper(radii / 2.0, (n * d) as f64)?.sqrt() } else { spectral * (n.min(d) as f64).sqrt() };
        if !self.determined() {
            (spectral, frobenius) = (f64::INFINITY, f64::INFINITY);
        }
        let found = match covariance {
            Covariance::Known(known) if known.len() == n * n => try_copy(WHAT, known)?,
            Covariance::Known(known) => {
                let (expected, found) = (format!("{n} x {n} entries"), known.len().to_string());
                return Err(Error::Shape { name: "covariance", expected, found });
            }
            unknown => self.bound(unknown, (spectral, frobenius), noise, by)?,
        };
        Ok(Event { spectral, frobenius, covariance: self.widened(found) })
    }

    /// The bound of an unknown covariance, each of n deviations of a diagonal one at its share of `delta`. It is
    /// infinite where the bracket is below .1, so that rounding of E is multiplied by 10 at most.
    fn bound(
        &self,
        kind: Covariance<'_>,
        (spectral, frobenius): (f64, f64),
        delta: f64,
        by: By<'_>,
    ) -> Result<Vec<f64>> {
        let (n, free) = (self.n, self.pairs.saturating_sub(self.d));
        if let Some((residual, beta, tau)) = &self.weighted {
            let (a, b) = (by.smallest(n, self.pairs, delta)?, times(spectral, *tau));
            let left = beta * b * b + (1.0 + beta) * (a - b * b);
            let root = (left.max(0.0).sqrt() - beta.sqrt() * b) / (1.0 + beta);
            let sound = a > b * b && root > 0.0 && root.is_finite();
            let by = if sound { (1.0 + f64::EPSILON.sqrt()) / root.powi(2) } else { f64::INFINITY };
            return if sound {
                try_collect(WHAT, residual.iter().map(|s| s * by))
            } else {
                try_filled(WHAT, f64::INFINITY, n * n)
            };
        }
        let room = |least: f64, radius: f64| {
            let room = least.sqrt() - times(radius, self.tau);
            if free > 0 && room > 0.1 { room.powi(2) } else { 0.0 }
        };
        let trace: f64 = self.residual.iter().step_by(n + 1).sum();
        let mut found = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
        match kind {
            Covariance::Scalar => {
                let room = room(chi2_quantile(delta, (n * free) as f64)?, frobenius);
                (0..n).for_each(|i| found[i * (n + 1)] = trace / room);
            }
            Covariance::Diagonal => {
                let room = room(chi2_quantile(delta / n as f64, free as f64)?, spectral);
                (0..n).for_each(|i| found[i * (n + 1)] = self.residual[i * (n + 1)] / room);
            }
            _ => {
                let least = if free < n { 0.0 } else { by.smallest(n, free, delta)? };
                let room = room(least, spectral);
                found.iter_mut().zip(&self.residual).for_each(|(to, s)| *to = s / room);
            }
        }
        if found.iter().all(|v| v.is_finite()) { Ok(found) } else { try_filled(WHAT, f64::INFINITY, n * n) }
    }

    /// A covariance with room for rounding: `(1 + 2 t) S + 36 n / t^2 diag(a^2)`, a the rounding of the rows of
    /// `H (Z' Q)`.
    ///
    /// With a row-wise error `|Err_i| <= a_i`, `H - Theta = (S^(1/2) Gamma + Err) T = S'^(1/2) Gamma' T`, where
    /// `||Gamma'|| <= rho / sqrt(1 + t) + sqrt(n) / sqrt(36 n / t^2) <= rho` in both norms for every `rho >= 1 / 2`,
    /// and t <= 1. The quantile of a part `sum M Gamma g` of the error grows in the same way by more than
    /// `sum M Err g`. The second t is for the rounding of residuals. It holds for every t: the terms of the largest row
    /// are made equal.
    fn widened(&self, mut covariance: Vec<f64>) -> Vec<f64> {
        let n = self.n;
        let share = |i: usize| match covariance[i * (n + 1)] {
            s if s > 0.0 => self.rounding[i] / s.sqrt(),
            _ => 0.0,
        };
        let largest = (0..n).map(share).fold(0.0, f64::max);
        let t = (36.0 * n as f64 * largest * largest).cbrt().clamp(1e-4, 1e-2);
        covariance.iter_mut().for_each(|v| *v *= 1.0 + 2.0 * t);
        for (i, a) in self.rounding.iter().enumerate() {
            covariance[i * (n + 1)] += 36.0 * n as f64 * (a / t).powi(2);
        }
        covariance
    }

    /// The models that contain the true one with probability `1 - delta`, of which a part of .12 is for an unknown
    /// covariance; with a bound of the norm of Frobenius too if `both`.
    ///
    /// # Errors
    /// As [`Pilot::event`].
    pub fn region(&self, covariance: Covariance<'_>, delta: f64, both: bool, stop: &Stop) -> Result<Region> {
        let noise = if matches!(covariance, Covariance::Known(_)) { 0.0 } else { COVARIANCE * delta };
        level("delta", delta)?;
        self.within(&self.event(covariance, (delta - noise, noise), both, stop)?)
    }

    /// The models of an event.
    pub(super) fn within(&self, event: &Event) -> Result<Region> {
        let (n, d) = (self.n, self.d);
        let [rows, columns] = [try_collect(WHAT, 0..n)?, try_collect(WHAT, 0..d)?];
        let known = event.covariance.iter().all(|v| v.is_finite());
        let mut shape = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
        let mut factor = f64::INFINITY;
        if known && self.determined() {
            shape.copy_from_slice(&event.covariance);
            factor = event.spectral.powi(2);
        } else {
            shape.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
        }
        let (white, root, shape) =
            (MatrixView::of(&self.t, d), MatrixView::of(&self.root, d), MatrixView::of(&shape, n));
        let (missing, ratio) = (None, self.ratio);
        let of = PartOf { rows: &rows, columns: &columns, white, root, missing, ratio, shape, factor };
        let region = Region::new(
            MatrixView::of(&self.h, d),
            self.m,
            [Arc::new(Part::new(of)?)].into(),
            Some(event.frobenius),
            false,
        )?;
        region.with_noise(if known { Some(try_copy(WHAT, &event.covariance)?) } else { None })
    }
}

/// The rows `(zeta, z, y)` (N, 2 d + n) of all pairs.
fn simulated(runs: MainRuns<'_>, simulation: Simulation<'_>, d: usize, stop: &Stop) -> Result<Vec<f64>> {
    let (n, m, model) = (runs.n, runs.m, simulation.model);
    let (taken, width) = (2 * n + m, 2 * d + n);
    let pairs = runs.lengths.iter().try_fold(0usize, |sum, length| sum.checked_add(*length)).unwrap_or(0);
    let fits = n > 0 && m > 0 && model.len() == n * d && (d == n + m || d == n + m + 1);
    let fed = simulation.feedback.is_none_or(|(gain, dither)| gain.len() == m * n && dither.len() == pairs * m);
    if !fits || !fed || pairs == 0 || runs.rows.len() != checked_len(WHAT, pairs, taken)? {
        let found = format!("{} and {} entries", runs.rows.len(), model.len());
        let expected = "rows (x, u, x_next) for all steps, a model (n, d), and a gain and a dither that fit".into();
        return Err(Error::Shape { name: "runs", expected, found });
    }
    let mut rows = try_filled(WHAT, 1.0, checked_len(WHAT, pairs, width)?)?; // the 1 of an offset stays
    let mut x = try_zeros(WHAT, n)?;
    let mut at = 0;
    for length in runs.lengths {
        stop.check()?;
        x.copy_from_slice(&runs.rows[at * taken..at * taken + n]);
        for t in at..at + length {
            let given = &runs.rows[t * taken..(t + 1) * taken];
            let (zeta, rest) = rows[t * width..(t + 1) * width].split_at_mut(d);
            rest[..n + m].copy_from_slice(&given[..n + m]);
            rest[d..].copy_from_slice(&given[n + m..]);
            zeta[..n].copy_from_slice(&x);
            match simulation.feedback {
                None => zeta[n..n + m].copy_from_slice(&given[n..n + m]),
                Some((gain, dither)) => {
                    let each = gain.chunks_exact(n).zip(&dither[t * m..(t + 1) * m]);
                    for (to, (gain, v)) in zeta[n..n + m].iter_mut().zip(each) {
                        *to = v + gain.iter().zip(&x).map(|(k, x)| k * x).sum::<f64>();
                    }
                }
            }
            x.copy_from_slice(&product(model, zeta, n, d, 1)?);
            if !zeta.iter().all(|v| v.is_finite()) {
                return Err(Error::Overflow { what: "a run that the pilot model simulates" });
            }
        }
        at += length;
    }
    Ok(rows)
}
