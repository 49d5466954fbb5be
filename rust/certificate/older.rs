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
//! `||S_x^-1 (Theta_old - Theta) S||_2 <= eta`, `S_x` that of the states, or `sum_i t_i E_i` with `|t_i| <= 1`; S is then of no
//! meaning, and the lengths of the columns take its place.
//! What it does to a certificate: [`super::difference`].

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{Covariance, spectral_norm, triangle};
use crate::memory::{checked_len, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;

use super::difference::Difference;
use super::pilot::{MainRuns, Pilot, Simulation, Sizes, WHAT, simulated};
use super::plan::Task;
use super::powers::{deviations, in_units, lengths, product, products, transposed_inverse};
use super::reference::{Reference, Shares};

/// Weights that are compared: 1, 1/2, .., 2^-12.
const HALVINGS: i32 = 12;
/// The level that the weight is chosen for.
const LEVEL: f64 = 0.05;

/// What is declared of an older plant.
#[derive(Debug, Clone, Copy)]
pub struct Apart<'a> {
    /// The diagonal of S (d); without meaning where there are directions, as eta.
    pub scale: &'a [f64],
    /// `||S_x^-1 (Theta_old - Theta) S||_2` is at most this.
    pub eta: f64,
    /// `E_1, E_2, ..` one after another (any, n, d), or nothing.
    pub directions: &'a [f64],
}

/// A task fixed without the runs: the start and inputs (K, m) of the pilot's plan for it.
pub type Fixed<'a> = (&'a [f64], &'a [f64]);

impl Pilot {
    /// The model of the newer runs and of the older ones, with their weight: 0, without the older ones, or `2^-i`, whichever the
    /// pilot expects to give the smallest certificate of the `fixed` task, or without one the smallest bound of one step in root
    /// mean square over all pairs, with states in deviations of their noise: the units do not matter.
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
        let fits = apart.scale.len() == d && directions == Some(0) && covariance.len() == n * n;
        if !fits || older.n != n || older.m != of.m {
            let expected =
                format!("a scale of {d} entries, matrices {n} x {d}, a covariance, and runs of the same sizes");
            return Err(Error::Shape { name: "apart", expected, found: "others".into() });
        }
        let [newer, older] = [simulated(newer, simulation, d, stop)?, simulated(older, simulation, d, stop)?];
        let of = Sizes { pairs: (newer.len() + older.len()) / width, ..of };
        let [newer, older] = [triangle(&newer, width, threads, stop)?, triangle(&older, width, threads, stop)?];
        let both = [newer.as_slice(), older.as_slice()];
        let weight = match weight {
            Some(weight) => weight,
            None => Self::chosen(both, of, model, apart, (covariance, fixed), stop)?,
        };
        Ok((Self::weighted(both, weight, of, model, apart, &deviations(covariance, n)?, stop)?, weight))
    }

    /// The weight from the triangles of both plants, with states in deviations of their noise.
    fn chosen(
        both: [&[f64]; 2],
        of: Sizes,
        model: &[f64],
        apart: Apart<'_>,
        (covariance, fixed): (&[f64], Option<Fixed<'_>>),
        stop: &Stop,
    ) -> Result<f64> {
        let (n, d, width) = (of.n, of.d, of.width());
        let own = deviations(covariance, n)?;
        let mut units = try_filled(WHAT, 1.0, d)?;
        units[..n].copy_from_slice(&own);
        let divided = |v: &[f64]| try_collect(WHAT, v.iter().zip(&units).map(|(v, unit)| v / unit));
        let within = |theta: &[f64]| {
            let each = theta.iter().zip(units.iter().cycle()).enumerate();
            try_collect(WHAT, each.map(|(at, (v, unit))| v * unit / own[at / d % n]))
        };
        let (model, directions, scale) = (within(model)?, within(apart.directions)?, divided(apart.scale)?);
        let apart = Apart { scale: &scale, directions: &directions, ..apart };
        let mut correlation = try_copy(WHAT, covariance)?;
        in_units(&mut correlation, &own);
        let start = fixed.map(|(x0, _)| divided(x0)).transpose()?;
        let fixed = start.as_deref().zip(fixed.map(|(_, inputs)| inputs));
        // what the pilot expects of the runs: z = zeta and y = H0 zeta
        let expected = |r: &[f64]| -> Result<Vec<f64>> {
            let mut rows = try_room(WHAT, checked_len(WHAT, d, width)?)?;
            for row in r.chunks_exact(width).take(d) {
                let zeta = divided(&row[..d])?;
                rows.extend_from_slice(&zeta);
                rows.extend_from_slice(&zeta);
                rows.extend(product(&model, &zeta, n, d, 1)?);
            }
            Ok(rows)
        };
        let [new, old] = [expected(both[0])?, expected(both[1])?];
        let one = try_filled(WHAT, 1.0, n)?;
        let (mut best, mut least) = (0.0, f64::INFINITY);
        for weight in std::iter::once(0.0).chain((0..=HALVINGS).map(|i| 0.5f64.powi(i))) {
            let found = Self::weighted([&new, &old], weight, of, &model, apart, &one, stop)?;
            let size = match fixed {
                Some(fixed) => found.size(&correlation, fixed, stop)?,
                None => found.mean_square(&correlation, [&new, &old], stop)?,
            };
            if size < least {
                (best, least) = (weight, size);
            }
        }
        Ok(best)
    }

    /// From rows `(zeta, z, y)` of both plants, or what has the same products; with the deviations of the noise.
    fn weighted(
        [newer, older]: [&[f64]; 2],
        weight: f64,
        of: Sizes,
        model: &[f64],
        apart: Apart<'_>,
        deviations: &[f64],
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
        (found.t0, _) = transposed_inverse(&plain, &lengths(&plain, d)?, d)?;
        let mut b = product(&outer, &found.t, d, d, d)?;
        let mut along = try_room(WHAT, apart.directions.len() / (n * d))?;
        let mut spread = try_zeros(WHAT, n * n)?;
        let mut scale = try_copy(WHAT, apart.scale)?;
        if apart.directions.is_empty() {
            spread.iter_mut().step_by(n + 1).zip(&scale).for_each(|(v, s)| *v = (apart.eta * s).powi(2));
        } else {
            scale.copy_from_slice(&lengths(&r, width)?[d..2 * d]);
        }
        let mut sum = 0.0; // of c_i = ||E_i S|| in deviations of the noise
        for direction in apart.directions.chunks_exact(n * d) {
            let scaled = try_collect(WHAT, direction.iter().zip(scale.iter().cycle()).map(|(e, s)| e * s))?;
            let whitened = try_collect(WHAT, scaled.iter().enumerate().map(|(at, v)| v / deviations[at / d]))?;
            let size = spectral_norm(&whitened, n, d)?;
            if size > 0.0 {
                let square = products([&scaled, &scaled], n)?;
                spread.iter_mut().zip(square).for_each(|(to, v)| *to += v / size);
            }
            sum += size;
            along.push(product(direction, &b, n, d, d)?);
        }
        if !along.is_empty() {
            spread.iter_mut().for_each(|v| *v *= sum);
        }
        b.chunks_exact_mut(d).zip(&scale).for_each(|(row, s)| row.iter_mut().for_each(|v| *v /= s));
        let all = r.chunks_exact(width).flat_map(|row| &row[d..2 * d]).copied();
        let pairs = triangle(&try_collect(WHAT, all)?, d, 1, stop)?;
        found.difference = Some(Difference::new(b, pairs, spread, along));
        Ok(found)
    }

    /// Bounds of the components of one step in root mean square over them and the pairs of these rows `(zeta, ..)`, but for a
    /// factor.
    fn mean_square(&self, covariance: &[f64], pairs: [&[f64]; 2], stop: &Stop) -> Result<f64> {
        if !self.determined() {
            return Ok(f64::INFINITY);
        }
        let region = self.region(Covariance::Known(covariance), LEVEL, false, stop)?;
        let part = &region.parts()[0];
        let each = pairs.into_iter().flat_map(|rows| rows.chunks_exact(2 * self.d + self.n));
        Ok(norm(part.deviations().iter().copied()) * norm(each.map(|row| part.length(&row[..self.d]))))
    }

    /// How large the certificate of a task is beside where its plan ends.
    fn size(&self, covariance: &[f64], (x0, inputs): Fixed<'_>, stop: &Stop) -> Result<f64> {
        let known = Covariance::Known(covariance);
        let steps = inputs.len() / self.m;
        let shares = Shares::new(LEVEL, true, false, steps)?;
        let event = self.event(known, (shares.radii, shares.covariance), true, stop)?;
        let predicted = try_zeros(WHAT, checked_len(WHAT, steps + 1, self.n)?)?;
        let task = Task { x0, rho0: 0.0, xf: &predicted[..self.n], predicted: &predicted };
        let found = self.near(&Reference::new(self, x0, inputs)?, task, inputs, &event, shares, stop)?;
        Ok(if found.target.is_finite() { found.target - found.reach } else { f64::INFINITY })
    }
}
