//! What a declared difference between two plants adds to the error of their common model.
//!
//! The error is `H - Theta = Sigma^(1/2) Gamma T + (Theta_old - Theta) B`, see [`super::older`]. With `rho` for the norm of Gamma
//! and every share a in (0, 1),
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
use crate::identify::{spectral_norm, triangle};
use crate::memory::{checked_len, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, PartOf, Region};

use super::nuclear::EFFORT;
use super::powers::{Powers, Span, first_order, product, transposed_inverse};
use super::several_steps::norms;
use super::trajectory::states;

const WHAT: &str = "the difference of two plants";
/// For the rounding of B, relative: that of an inverse with a ratio of singular values above 1e-8.
const ROUNDING: f64 = 1e-6;

/// The part of the error that is not noise: `(Theta_old - Theta) B`.
#[derive(Debug, Clone)]
pub(super) struct Difference {
    /// `S^-1 B` (d, d).
    b: Vec<f64>,
    eta: f64,
    /// `E_i B` (n, d); without them anything within eta.
    along: Vec<Vec<f64>>,
}

impl Difference {
    /// `eta`: without room for rounding.
    pub fn new(b: Vec<f64>, eta: f64, along: Vec<Vec<f64>>) -> Self {
        Self { b, eta: eta * (1.0 + ROUNDING), along }
    }

    /// The models `h` (n, d) with `T = t` in the event that Gamma is at most `spectral`, as one part, with a share a that is best
    /// for directions in which noise and difference are as large as on the whole, (1 - a) / a multiplied by `factor`.
    pub fn joined(
        &self,
        (h, t): (&[f64], &[f64]),
        (n, m, d): (usize, usize, usize),
        (spectral, covariance): (f64, &[f64]),
        factor: f64,
    ) -> Result<Region> {
        let whole = |of: &[f64]| norm(of.iter().copied());
        let deviation = spectral_norm(covariance, n, n)?.sqrt();
        let (apart, noise) = (self.eta * whole(t), spectral * deviation * whole(&self.b));
        let ratio = factor * apart / noise; // (1 - a) / a
        let (share, rest) = if self.eta == 0.0 || !(ratio > 0.0 && ratio.is_finite()) {
            (1.0, 0.0)
        } else {
            (1.0 / (1.0 + ratio), ratio / (1.0 + ratio))
        };
        let mut shape = try_collect(WHAT, covariance.iter().map(|v| spectral.powi(2) / share * v))?;
        if rest > 0.0 {
            shape.iter_mut().step_by(n + 1).for_each(|v| *v += self.eta.powi(2) / rest);
        } else if apart > 0.0 && self.b.iter().any(|v| *v != 0.0) {
            return Err(Error::Overflow { what: "the share of the difference of two plants" });
        }
        let rows = t.iter().map(|v| share.sqrt() * v).chain(self.b.iter().map(|v| rest.sqrt() * v));
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
        let region = Region::new(h, n, m, [Arc::new(Part::new(of)?)].into(), Some(frobenius), false)?;
        Ok(region.with_noise(Some(try_copy(WHAT, covariance)?)))
    }

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
            powers.push(&power)?;
            power = product(&a, &power, n, n, n)?;
        }
        let span = Span::new(&c, count, false, stop)?;
        for k in 1..=count {
            sizes[k] = powers.linear(&span, &lengths[..k], (self.eta, f64::INFINITY), EFFORT, f64::INFINITY)?;
        }
        if let Some(last) = first_order(&a, &unit, &c, n, d)?.last() {
            for (to, row) in rows.iter_mut().zip(last.chunks_exact(d * n)) {
                *to = self.eta * norms(row, n)?.1;
            }
        }
        Ok((sizes, rows))
    }
}
