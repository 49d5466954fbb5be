//! The plan of a pilot for a task that was fixed before the noise of the data, and the shares of a level: see [`super::near`].

use crate::control::pseudoinverse;
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_collect, try_filled, try_room, try_zeros};

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
    /// The least inputs that lead the pilot from x0 to xf in so many steps, or as near as they can.
    ///
    /// # Errors
    /// As [`Reference::new`].
    pub fn of_task(pilot: &Pilot, x0: &[f64], xf: &[f64], steps: usize) -> Result<Self> {
        let (n, m, d) = (pilot.n, pilot.m, pilot.d);
        let none = try_zeros(WHAT, checked_len(WHAT, steps, m)?)?;
        let free = Self::states(pilot, x0, &none)?;
        if xf.len() != n {
            let found = format!("{} entries", xf.len());
            return Err(Error::Shape { name: "reference", expected: format!("a target of {n} entries"), found });
        }
        let wanted = try_collect(WHAT, xf.iter().zip(&free[steps * d..]).map(|(xf, x)| xf - x))?;
        // [A^(K-1) B .. B], from the right
        let cols = steps * m;
        let mut pushes = try_zeros(WHAT, checked_len(WHAT, n, cols)?)?;
        let [mut a, mut push] = [try_room(WHAT, n * n)?, try_room(WHAT, n * m)?];
        for row in pilot.model.chunks_exact(d) {
            a.extend_from_slice(&row[..n]);
            push.extend_from_slice(&row[n..n + m]);
        }
        for k in (0..steps).rev() {
            for (to, from) in pushes.chunks_exact_mut(cols).zip(push.chunks_exact(m)) {
                to[k * m..(k + 1) * m].copy_from_slice(from);
            }
            push = product(&a, &push, n, n, m)?;
        }
        let inputs = product(&pseudoinverse(&pushes, n, cols)?.matrix, &wanted, cols, n, 1)?;
        Self::new(pilot, x0, &inputs)
    }

    /// The rows `z(k)`, k = 0..K, of the pilot; the last has inputs of 0.
    fn states(pilot: &Pilot, x0: &[f64], inputs: &[f64]) -> Result<Vec<f64>> {
        let (n, m, d) = (pilot.n, pilot.m, pilot.d);
        if x0.len() != n || inputs.is_empty() || !inputs.len().is_multiple_of(m) {
            let found = format!("{} and {} entries", x0.len(), inputs.len());
            return Err(Error::Shape { name: "reference", expected: format!("{n} entries and rows of {m}"), found });
        }
        let steps = inputs.len() / m;
        let mut rows = try_filled(WHAT, 1.0, checked_len(WHAT, steps + 1, d)?)?;
        rows[..n].copy_from_slice(x0);
        for k in 0..steps {
            let (z, next) = rows[k * d..(k + 2) * d].split_at_mut(d);
            z[n..n + m].copy_from_slice(&inputs[k * m..(k + 1) * m]);
            next[..n].copy_from_slice(&product(&pilot.model, z, n, d, 1)?);
            next[n..n + m].fill(0.0);
        }
        if !rows.iter().all(|v| v.is_finite()) {
            return Err(Error::Overflow { what: "the reference plan of the pilot" });
        }
        Ok(rows)
    }

    /// From the start and the inputs (K, m) of that plan.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Overflow`], [`Error::Memory`].
    pub fn new(pilot: &Pilot, x0: &[f64], inputs: &[f64]) -> Result<Self> {
        let (d, mut rows) = (pilot.d, Self::states(pilot, x0, inputs)?);
        rows.truncate(rows.len() - d);
        let mut g = try_room(WHAT, rows.len())?;
        for z in rows.chunks_exact(d) {
            g.extend(product(&pilot.t0, z, d, d, 1)?);
        }
        Ok(Self { g })
    }

    /// How many steps it has.
    #[must_use]
    pub fn steps(&self, pilot: &Pilot) -> usize {
        self.g.len() / pilot.d
    }
}
