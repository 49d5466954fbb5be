//! The plan of a pilot for a task that was fixed before the noise of the data, and the shares of a level: see [`super::near`].

use crate::error::{Error, Result};
use crate::memory::{checked_len, try_filled, try_room};

use super::pilot::{COVARIANCE, Pilot, WHAT};
use super::powers::product;

/// How a level delta is shared.
#[derive(Debug, Clone, Copy)]
pub struct Shares {
    /// Norms of Gamma.
    pub radii: f64,
    /// An unknown covariance.
    pub covariance: f64,
    /// `||F||`.
    pub reference: f64,
    /// All `b_j` together.
    pub between: f64,
    /// Noise to come: half for its drift, half for its part of all `b_j`.
    pub noise: f64,
}

impl Shares {
    /// Fixed constants, not tuned on data. One step needs no `b_j`.
    ///
    /// # Errors
    /// [`Error::Value`] for a `delta` outside (0, 1).
    pub fn new(delta: f64, known: bool, noise: bool, steps: usize) -> Result<Self> {
        crate::identify::level("delta", delta)?;
        let covariance = if known { 0.0 } else { COVARIANCE };
        let [radii, mut reference, mut between, noise] =
            if noise { [0.1, 0.74, 0.06, 0.1] } else { [0.12, 0.8, 0.08, 0.0] };
        if steps < 2 {
            (reference, between) = (reference + between, 0.0);
        }
        let of = |share: f64| share * (1.0 - covariance) * delta;
        let [radii, reference, between, noise] = [radii, reference, between, noise].map(of);
        Ok(Self { radii, covariance: covariance * delta, reference, between, noise })
    }
}

/// What is fixed before the data: the pilot's plan for a task.
#[derive(Debug, Clone)]
pub struct Reference {
    /// `g_j` (K, d).
    pub(super) g: Vec<f64>,
}

impl Reference {
    /// From the start and the inputs (K, m) of that plan.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Overflow`], [`Error::Memory`].
    pub fn new(pilot: &Pilot, x0: &[f64], inputs: &[f64]) -> Result<Self> {
        let (n, m, d) = (pilot.n, pilot.m, pilot.d);
        if x0.len() != n || inputs.is_empty() || !inputs.len().is_multiple_of(m) {
            let found = format!("{} and {} entries", x0.len(), inputs.len());
            return Err(Error::Shape { name: "reference", expected: format!("{n} entries and rows of {m}"), found });
        }
        let mut g = try_room(WHAT, checked_len(WHAT, inputs.len() / m, d)?)?;
        let mut z = try_filled(WHAT, 1.0, d)?;
        z[..n].copy_from_slice(x0);
        for u in inputs.chunks_exact(m) {
            z[n..n + m].copy_from_slice(u);
            g.extend(product(&pilot.t0, &z, d, d, 1)?);
            let next = product(&pilot.model, &z, n, d, 1)?;
            z[..n].copy_from_slice(&next);
        }
        if !g.iter().all(|v| v.is_finite()) {
            return Err(Error::Overflow { what: "the reference plan of the pilot" });
        }
        Ok(Self { g })
    }
}
