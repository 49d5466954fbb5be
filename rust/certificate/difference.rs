//! What a declared difference between two plants adds to the error of their common model.
//!
//! The error is `H - Theta = Sigma^(1/2) Gamma T + (Theta_old - Theta) B`, see [`super::older`]. With `rho` for the norm of Gamma
//! and every share a in (0, 1),
//!
//! ```text
//! H - Theta = Sigma'^(1/2) U T',    ||U||_2 <= 1
//! Sigma' = rho^2 Sigma / a + M / (1 - a),    T'' T' = a T' T + (1 - a) (S^-1 B)' (S^-1 B),
//! ```
//!
//! by the inequality of Cauchy and Schwarz, with `(Theta_old - Theta) S = M^(1/2) U`, `||U|| <= 1`: `M = eta^2 S_x^2` or, along
//! directions, `sum_i c_i sum_i (E_i S) (E_i S)' / c_i` for any c > 0. For what is linear in the difference its largest value is known:
//! [`Difference::linear`].

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::triangle;
use crate::memory::{checked_len, try_collect, try_copy, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, PartOf, Region};

use super::nuclear::EFFORT;
use super::powers::{Powers, Span, first_order, lengths, product, products, transposed_inverse};
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
    /// `pairs' pairs = Z Z'` of all pairs (d, d).
    pairs: Vec<f64>,
    /// `M` (n, n), diagonal without directions.
    spread: Vec<f64>,
    /// `E_i B` (n, d); without them anything within M.
    along: Vec<Vec<f64>>,
}

impl Difference {
    /// `spread`: without room for rounding.
    pub fn new(b: Vec<f64>, pairs: Vec<f64>, mut spread: Vec<f64>, along: Vec<Vec<f64>>) -> Self {
        spread.iter_mut().for_each(|v| *v *= (1.0 + ROUNDING).powi(2));
        Self { b, pairs, spread, along }
    }

    /// The models `h` (n, d) with `T = t` in the event that Gamma is at most `spectral`, as one part, with a share a that is best
    /// for components of one step in units of the noise, in root mean square over the pairs, (1 - a) / a multiplied by
    /// `factor`.
    pub fn joined(
        &self,
        (h, t): (&[f64], &[f64]),
        (n, m, d): (usize, usize, usize),
        (spectral, covariance): (f64, &[f64]),
        factor: f64,
    ) -> Result<Region> {
        let whole = |of: &[f64]| Ok::<_, Error>(norm(products([of, &self.pairs], d)?.into_iter()));
        let each = covariance.iter().step_by(n + 1).zip(self.spread.iter().step_by(n + 1));
        let apart = norm(each.filter(|(noise, _)| **noise > 0.0).map(|(noise, apart)| (apart / noise).sqrt()));
        let noise = spectral * (n as f64).sqrt();
        let ratio = factor * apart * whole(t)? / (noise * whole(&self.b)?); // (1 - a) / a
        let (share, rest) =
            if ratio > 0.0 && ratio.is_finite() { (1.0 / (1.0 + ratio), ratio / (1.0 + ratio)) } else { (1.0, 0.0) };
        let mut shape = try_collect(WHAT, covariance.iter().map(|v| spectral.powi(2) / share * v))?;
        if rest > 0.0 {
            shape.iter_mut().zip(&self.spread).for_each(|(v, apart)| *v += apart / rest);
        } else if [&self.spread, &self.b].iter().all(|of| of.iter().any(|v| *v != 0.0)) {
            return Err(Error::Overflow { what: "the share of the difference of two plants" });
        }
        let rows = t.iter().map(|v| share.sqrt() * v).chain(self.b.iter().map(|v| rest.sqrt() * v));
        let white = triangle(&try_collect(WHAT, rows)?, d, 1, &Stop::new())?;
        let (root, ratio) = transposed_inverse(&white, &lengths(&white, d)?, d)?;
        let (all, columns) = (try_collect(WHAT, 0..n)?, try_collect(WHAT, 0..d)?);
        let of = PartOf {
            rows: &all,
            columns: &columns,
            white: &white,
            root: &root,
            missing: &[],
            ratio,
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
        let root = try_collect(WHAT, self.spread.iter().map(|v| v.sqrt()))?; // M is diagonal
        let mut power = try_copy(WHAT, &root)?;
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
            sizes[k] = powers.linear(&span, &lengths[..k], (1.0, f64::INFINITY), EFFORT, f64::INFINITY)?;
        }
        if let Some(last) = first_order(&a, &root, &c, n, d)?.last() {
            for (to, row) in rows.iter_mut().zip(last.chunks_exact(d * n)) {
                *to = norms(row, n)?.1;
            }
        }
        Ok((sizes, rows))
    }
}
