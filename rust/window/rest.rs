//! How far a window model is from rest.

use crate::error::{Result, require_finite, sized};
use crate::matrix::MatrixView;
use crate::memory::try_zeros;
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
    /// [`crate::Error::Shape`], [`crate::Error::NonFinite`], [`crate::Error::Memory`].
    pub fn rest<'a>(&self, theta: impl Into<MatrixView<'a>>, y: &[f64], u: &[f64]) -> Result<Rest> {
        let (p, d) = (self.outputs(), self.length());
        let theta = theta.into().finite("theta", p, d)?;
        sized("outputs", y.len(), p)?;
        sized("inputs", u.len(), self.inputs())?;
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
