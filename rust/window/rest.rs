//! How far a window model is from rest.

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_zeros};
use crate::vector::dot;

use super::shape::{WHAT, Window};

/// A window in which outputs and inputs were always the same.
#[derive(Debug, Clone)]
pub struct Rest {
    /// Its state.
    pub x: Vec<f64>,
    /// z there.
    pub z: Vec<f64>,
    /// How far the outputs move in the next step.
    pub off: f64,
    /// What of that may be rounding.
    pub rounding: f64,
}

impl Window {
    /// How far the model `theta` (n_y, d) moves where outputs and inputs were always `y` and `u`.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Memory`].
    pub fn rest(&self, theta: &[f64], y: &[f64], u: &[f64]) -> Result<Rest> {
        let (p, d) = (self.outputs(), self.length());
        if theta.len() != checked_len(WHAT, p, d)? || y.len() != p || u.len() != self.inputs() {
            let (expected, found) = (format!("{p} rows of {d}, and {p} outputs"), format!("{} outputs", y.len()));
            return Err(Error::Shape { name: "theta, outputs, inputs", expected, found });
        }
        require_finite("theta", theta)?;
        require_finite("outputs", y)?;
        let (mut x, mut z) = (try_zeros::<f64>(WHAT, self.states())?, try_zeros::<f64>(WHAT, d)?);
        self.start(y, u, &mut x); // filters have the gain 1
        self.regressors(&x, u, 1.0, &mut z);
        let rows = || theta.chunks_exact(d).zip(y);
        let off = rows().map(|(row, y)| (dot(row, &z) - y).powi(2)).sum::<f64>().sqrt();
        let size: f64 = rows().map(|(row, _)| row.iter().zip(&z).map(|(h, z)| (h * z).abs()).sum::<f64>()).sum();
        Ok(Rest { x, z, off, rounding: 1e-12 * size })
    }
}
