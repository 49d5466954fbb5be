//! Runs of an older plant, of which the difference from the newer one is declared.
//!
//! With the pilot's regressors `zeta`, the runs z, y of both plants and a weight q of the older pairs,
//!
//! ```text
//! N = Z1 zeta1' + q Z2 zeta2',    H = (Y1 zeta1' + q Y2 zeta2') N^-1,    R' R = zeta1 zeta1' + q^2 zeta2 zeta2'
//! H - Theta = Sigma^(1/2) Gamma T + (Theta_old - Theta) B,    T = R N^-1,    B = q Z2 zeta2' N^-1
//! ```
//!
//! with Gamma standard normal: the noises are independent, of one covariance, and all else in the first term is fixed without
//! them. It is the model of [`Pilot`] with the instruments of the older pairs multiplied by q. The difference is anything with
//! `||(Theta_old - Theta) S||_2 <= eta`, or `sum_i t_i E_i` with `|t_i| <= 1` and then `eta = sum_i ||E_i S||`. With `rho` for
//! the norm of Gamma and every share a in (0, 1),
//!
//! ```text
//! H - Theta = Sigma'^(1/2) U T',    ||U||_2 <= 1
//! Sigma' = rho^2 Sigma / a + eta^2 I / (1 - a),    T'' T' = a T' T + (1 - a) (S^-1 B)' (S^-1 B),
//! ```
//!
//! by the inequality of Cauchy and Schwarz. For what is linear in the difference its largest value is known:
//! [`Difference::linear`].

use std::sync::Arc;

use crate::control::pseudoinverse;
use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{Covariance, spectral_norm, triangle};
use crate::memory::{checked_len, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, PartOf, Region};

use super::near::EFFORT;
use super::pilot::{Event, MainRuns, Pilot, Simulation, Sizes, WHAT, simulated, transposed_inverse};
use super::plan::Task;
use super::powers::{Powers, Span, first_order, product};
use super::reference::{Reference, Shares};
use super::several_steps::norms;
use super::trajectory::states;

/// Weights that are compared: 1, 1/2, .., 2^-12.
const HALVINGS: i32 = 12;
/// The level that the weight is chosen for.
const LEVEL: f64 = 0.05;
/// For the rounding of B, relative: that of an inverse with a ratio of singular values above 1e-8.
const ROUNDING: f64 = 1e-6;

/// What is declared of an older plant.
#[derive(Debug, Clone, Copy)]
pub struct Apart<'a> {
    /// The diagonal of S (d).
    pub scale: &'a [f64],
    /// `||(Theta_old - Theta) S||_2` is at most this; without meaning where there are directions.
    pub eta: f64,
    /// `E_1, E_2, ..` one after another (any, n, d), or nothing.
    pub directions: &'a [f64],
}

/// The part of the error that is not noise: `(Theta_old - Theta) B`.
#[derive(Debug, Clone)]
pub(super) struct Difference {
    /// `S^-1 B` (d, d).
    b: Vec<f64>,
    eta: f64,
    /// `E_i B` (n, d); without them anything within eta.
    along: Vec<Vec<f64>>,
}

/// A task fixed without the runs: the start and inputs (K, m) of the pilot's plan for it.
pub type Fixed<'a> = (&'a [f64], &'a [f64]);

impl Pilot {
    /// The model of the newer runs and of the older ones, with their weight: 0, without the older ones, or `2^-i`, whichever the
    /// pilot expects to give the smallest certificate of the `fixed` task, or without one the smallest region.
    ///
    /// The choice does not depend on the noise of any of the runs, so each certificate holds at its whole level. A `weight` that
    /// is given was fixed in the same way.
    ///
    /// # Errors
    /// As [`Pilot::new`].
    pub fn with_older(
        [newer, older]: [MainRuns<'_>; 2],
        model: &[f64],
        apart: Apart<'_>,
        covariance: &[f64],
        (fixed, weight): (Option<Fixed<'_>>, Option<f64>),
        threads: usize,
        stop: &Stop,
    ) -> Result<(Self, f64)> {
        let simulation = Simulation { model, feedback: None };
        let of = Sizes::new(newer, simulation);
        let (n, d, width) = (of.n, of.d, of.width());
        let directions = apart.directions.len().checked_rem(n * d);
        if apart.scale.len() != d || directions != Some(0) || older.n != n || older.m != of.m {
            let expected = format!("a scale of {d} entries, matrices {n} x {d}, and runs of the same sizes");
            return Err(Error::Shape { name: "apart", expected, found: "others".into() });
        }
        let [newer, older] = [simulated(newer, simulation, d, stop)?, simulated(older, simulation, d, stop)?];
        let of = Sizes { pairs: (newer.len() + older.len()) / width, ..of };
        let [newer, older] = [triangle(&newer, width, threads, stop)?, triangle(&older, width, threads, stop)?];
        if let Some(weight) = weight {
            return Ok((Self::weighted([&newer, &older], weight, of, model, apart, stop)?, weight));
        }
        // what the pilot expects of the runs: z = zeta and y = H0 zeta
        let expected = |r: &[f64]| -> Result<Vec<f64>> {
            let mut rows = try_room(WHAT, checked_len(WHAT, d, width)?)?;
            for row in r.chunks_exact(width).take(d) {
                rows.extend_from_slice(&row[..d]);
                rows.extend_from_slice(&row[..d]);
                rows.extend(product(model, &row[..d], n, d, 1)?);
            }
            Ok(rows)
        };
        let [new, old] = [expected(&newer)?, expected(&older)?];
        let (mut best, mut least) = (0.0, f64::INFINITY);
        for weight in std::iter::once(0.0).chain((0..=HALVINGS).map(|i| 0.5f64.powi(i))) {
            let found = Self::weighted([&new, &old], weight, of, model, apart, stop)?.size(covariance, fixed, stop)?;
            if found < least {
                (best, least) = (weight, found);
            }
        }
        Ok((Self::weighted([&newer, &older], best, of, model, apart, stop)?, best))
    }

    /// From rows `(zeta, z, y)` of both plants, or what has the same products.
    fn weighted(
        [newer, older]: [&[f64]; 2],
        weight: f64,
        of: Sizes,
        model: &[f64],
        apart: Apart<'_>,
        stop: &Stop,
    ) -> Result<Self> {
        let (n, d, own) = (of.n, of.d, of.width());
        if weight == 0.0 {
            return Self::from_triangle(&triangle(newer, own, 1, stop)?, own, of, model);
        }
        // rows (zeta, z, y, 0, 0) and (q zeta, z, y, zeta, z)
        let width = own + 2 * d;
        let mut rows = try_zeros(WHAT, checked_len(WHAT, (newer.len() + older.len()) / own, width)?)?;
        for (to, row) in rows.chunks_exact_mut(width).zip(newer.chunks_exact(own).chain(older.chunks_exact(own))) {
            to[..own].copy_from_slice(row);
        }
        for row in rows.chunks_exact_mut(width).skip(newer.len() / own) {
            row.copy_within(..2 * d, own);
            row[..d].iter_mut().for_each(|v| *v *= weight);
        }
        let r = triangle(&rows, width, 1, stop)?;
        let mut found = Self::from_triangle(&r, width, of, model)?;
        if !found.determined() {
            return Ok(found);
        }
        // Q' zeta of all pairs without weights: (zeta1 zeta1' + q zeta2 zeta2')^-1 = .. and Q' Z2
        let [mut plain, mut outer] = [try_zeros(WHAT, d * d)?, try_zeros(WHAT, d * d)?];
        for (i, row) in r.chunks_exact(width).take(d).enumerate() {
            for j in 0..d {
                plain[i * d + j] = row[j] + (1.0 - weight) * row[own + j];
                outer[j * d + i] = row[own + d + j]; // Z2 Q
            }
        }
        let units = try_collect(
            WHAT,
            (0..d).map(|j| match norm(plain.iter().skip(j).step_by(d).copied()) {
                0.0 => 1.0,
                size => size,
            }),
        )?;
        (found.t0, _) = transposed_inverse(&plain, &units, d)?;
        let mut b = product(&outer, &found.t, d, d, d)?;
        let mut along = try_room(WHAT, apart.directions.len() / (n * d))?;
        let mut eta = if apart.directions.is_empty() { apart.eta } else { 0.0 };
        for direction in apart.directions.chunks_exact(n * d) {
            let scaled = try_collect(WHAT, direction.iter().zip(apart.scale.iter().cycle()).map(|(e, s)| e * s))?;
            eta += spectral_norm(&scaled, n, d)?;
            along.push(product(direction, &b, n, d, d)?);
        }
        for (row, s) in b.chunks_exact_mut(d).zip(apart.scale) {
            row.iter_mut().for_each(|v| *v /= s);
        }
        found.difference = Some(Difference { b, eta: eta * (1.0 + ROUNDING), along });
        Ok(found)
    }

    /// How large the certificate of a task is beside where its plan ends, or the region without one.
    fn size(&self, covariance: &[f64], fixed: Option<Fixed<'_>>, stop: &Stop) -> Result<f64> {
        let known = Covariance::Known(covariance);
        let Some((x0, inputs)) = fixed else {
            let region = self.region(known, LEVEL, false, stop)?;
            let size =
                |part: &Arc<Part>| Ok::<_, Error>(part.radius() * spectral_norm(&part.white, part.rank(), self.d)?);
            return if self.determined() { size(&region.parts()[0]) } else { Ok(f64::INFINITY) };
        };
        let steps = inputs.len() / self.m;
        let shares = Shares::new(LEVEL, true, false, steps)?;
        let event = self.event(known, (shares.radii, shares.covariance), true, stop)?;
        let predicted = try_zeros(WHAT, checked_len(WHAT, steps + 1, self.n)?)?;
        let task = Task { x0, rho0: 0.0, xf: &predicted[..self.n], predicted: &predicted };
        let found = self.near(&Reference::new(self, x0, inputs)?, task, inputs, &event, shares, stop)?;
        Ok(if found.target.is_finite() { found.target - found.reach } else { f64::INFINITY })
    }

    /// The models of an event as one part, with a share a that is best for directions in which noise and difference are as large
    /// as on the whole, (1 - a) / a multiplied by `factor`.
    pub(super) fn joined(&self, difference: &Difference, event: &Event, factor: f64) -> Result<Region> {
        let (n, d) = (self.n, self.d);
        let whole = |of: &[f64]| norm(of.iter().copied());
        let deviation = spectral_norm(&event.covariance, n, n)?.sqrt();
        let (apart, noise) = (difference.eta * whole(&self.t), event.spectral * deviation * whole(&difference.b));
        let ratio = factor * apart / noise; // (1 - a) / a
        let (share, rest) = if difference.eta == 0.0 || !(ratio > 0.0 && ratio.is_finite()) {
            (1.0, 0.0)
        } else {
            (1.0 / (1.0 + ratio), ratio / (1.0 + ratio))
        };
        let mut shape = try_collect(WHAT, event.covariance.iter().map(|v| event.spectral.powi(2) / share * v))?;
        if rest > 0.0 {
            shape.iter_mut().step_by(n + 1).for_each(|v| *v += difference.eta.powi(2) / rest);
        } else if difference.eta > 0.0 && noise > 0.0 {
            return Err(Error::Overflow { what: "the share of the difference of two plants" });
        }
        let rows = self.t.iter().map(|v| share.sqrt() * v).chain(difference.b.iter().map(|v| rest.sqrt() * v));
        let white = triangle(&try_collect(WHAT, rows)?, d, 1, &Stop::new())?;
        let units = try_filled(WHAT, 1.0, d)?;
        let root = transposed_inverse(&white, &units, d)?.0;
        let (all, columns) = (try_collect(WHAT, 0..n)?, try_collect(WHAT, 0..d)?);
        let of = PartOf {
            rows: &all,
            columns: &columns,
            white: &white,
            root: &root,
            missing: &[],
            ratio: 1.0 / pseudoinverse(&white, d, d)?.condition,
            shape: &shape,
            factor: 1.0,
        };
        let frobenius = (n.min(d) as f64).sqrt();
        let region = Region::new(&self.h, n, self.m, [Arc::new(Part::new(of)?)].into(), Some(frobenius), false)?;
        Ok(region.with_noise(Some(try_copy(WHAT, &event.covariance)?)))
    }
}

impl Difference {
    /// The largest `||sum_{j<k} A^(k-1-j) (Theta_old - Theta) B z(j)||`, k = 0..K, and of each row of the last one (n), along
    /// the states of a model (n, d) from x0 under `inputs`.
    pub fn linear(&self, region: &Region, x0: &[f64], inputs: &[f64], stop: &Stop) -> Result<(Vec<f64>, Vec<f64>)> {
        let (n, d, count) = (region.n, region.d, inputs.len() / region.m);
        let at = states(region, x0, inputs)?;
        let z = |j: usize| region.regressor(&at[j * n..(j + 1) * n], &inputs[j * region.m..(j + 1) * region.m]);
        let mut a = try_room(WHAT, n * n)?;
        region.centre.chunks_exact(d).for_each(|row| a.extend_from_slice(&row[..n]));
        let [mut sizes, mut rows] = [try_zeros(WHAT, count + 1)?, try_zeros(WHAT, n)?];
        if !self.along.is_empty() {
            for direction in &self.along {
                let mut error = try_zeros(WHAT, n)?;
                for j in 0..count {
                    error = product(&a, &error, n, n, 1)?;
                    error.iter_mut().zip(product(direction, &z(j)?, n, d, 1)?).for_each(|(to, v)| *to += v);
                    sizes[j + 1] += (1.0 + ROUNDING) * norm(error.iter().copied());
                }
                rows.iter_mut().zip(&error).for_each(|(to, v)| *to += (1.0 + ROUNDING) * v.abs());
            }
            return Ok((sizes, rows));
        }
        let mut power = try_zeros(WHAT, n * n)?;
        (0..n).for_each(|i| power[i * (n + 1)] = 1.0);
        let unit = try_copy(WHAT, &power)?;
        let [mut c, mut lengths] = [try_room(WHAT, checked_len(WHAT, count, d)?)?, try_room(WHAT, count)?];
        let mut powers = Powers::new(n, n, count)?;
        for j in 0..count {
            let seen = product(&self.b, &z(j)?, d, d, 1)?;
            lengths.push(norm(seen.iter().copied()));
            c.extend(seen);
            powers.push(try_copy(WHAT, &power)?)?;
            power = product(&a, &power, n, n, n)?;
        }
        let span = Span::new(&c, count, false, stop)?;
        for k in 1..=count {
            sizes[k] = powers.linear(&span, &lengths[..k], (self.eta, f64::INFINITY), EFFORT)?;
        }
        if let Some(last) = first_order(&a, &unit, &c, n, d)?.last() {
            for (to, row) in rows.iter_mut().zip(last.chunks_exact(d * n)) {
                *to = self.eta * norms(row, n)?.1;
            }
        }
        Ok((sizes, rows))
    }
}
