//! The plan of a pilot for a task that was fixed before the noise of the data, and the shares of a level: see
//! [`super::near`].

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
    /// Without noise: what is not of first order by a weighted small gain, and of second order.
    pub later: f64,
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
        let [radii, mut reference, mut between, mut later, noise] =
            if noise { [0.1, 0.74, 0.06, 0.0, 0.1] } else { [0.12, 0.8, 0.04, 0.04, 0.0] };
        if steps < 2 {
            (reference, between, later) = (reference + between + later, 0.0, 0.0);
        }
        Ok(Self { radii, covariance: 0.0, reference, between, later, noise }.of(delta, known))
    }

    /// The same for outputs of a plan that is followed, where noise is apart.
    ///
    /// # Errors
    /// As [`Shares::new`].
    pub fn followed(delta: f64, known: bool, noise: bool) -> Result<Self> {
        crate::identify::level("delta", delta)?;
        let [radii, reference, later, noise] = if noise { [0.1, 0.38, 0.08, 0.44] } else { [0.1, 0.8, 0.1, 0.0] };
        Ok(Self { radii, covariance: 0.0, reference, between: 0.0, later, noise }.of(delta, known))
    }

    fn of(self, delta: f64, known: bool) -> Self {
        let covariance = if known { 0.0 } else { COVARIANCE };
        let of = |share: f64| share * (1.0 - covariance) * delta;
        let [radii, reference, between, later, noise] =
            [self.radii, self.reference, self.between, self.later, self.noise].map(of);
        Self { radii, covariance: covariance * delta, reference, between, later, noise }
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
