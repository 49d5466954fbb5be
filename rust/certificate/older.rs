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
//! `||(Theta_old - Theta) S||_2 <= eta`, or `sum_i t_i E_i` with `|t_i| <= 1` and then `eta = sum_i ||E_i S||`.
//! What it does to a certificate: [`super::difference`].

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{Covariance, spectral_norm, triangle};
use crate::memory::{checked_len, try_collect, try_room, try_zeros};
use crate::parallel::Stop;

use super::difference::Difference;
use super::pilot::{MainRuns, Pilot, Simulation, Sizes, WHAT, simulated};
use super::plan::Task;
use super::powers::{product, transposed_inverse};
use super::reference::{Reference, Shares};

/// Weights that are compared: 1, 1/2, .., 2^-12.
const HALVINGS: i32 = 12;
/// The level that the weight is chosen for.
const LEVEL: f64 = 0.05;

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
        found.difference = Some(Difference::new(b, eta, along));
        Ok(found)
    }

    /// How large the certificate of a task is beside where its plan ends, or the region without one.
    fn size(&self, covariance: &[f64], fixed: Option<Fixed<'_>>, stop: &Stop) -> Result<f64> {
        let known = Covariance::Known(covariance);
        let Some((x0, inputs)) = fixed else {
            let region = self.region(known, LEVEL, false, stop)?;
            if !self.determined() {
                return Ok(f64::INFINITY);
            }
            let part = &region.parts()[0];
            return Ok(part.radius() * spectral_norm(&part.white, part.rank(), self.d)?);
        };
        let steps = inputs.len() / self.m;
        let shares = Shares::new(LEVEL, true, false, steps)?;
        let event = self.event(known, (shares.radii, shares.covariance), true, stop)?;
        let predicted = try_zeros(WHAT, checked_len(WHAT, steps + 1, self.n)?)?;
        let task = Task { x0, rho0: 0.0, xf: &predicted[..self.n], predicted: &predicted };
        let found = self.near(&Reference::new(self, x0, inputs)?, task, inputs, &event, shares, stop)?;
        Ok(if found.target.is_finite() { found.target - found.reach } else { f64::INFINITY })
    }
}
