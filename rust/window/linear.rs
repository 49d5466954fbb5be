//! A window model as a linear system of its state.

use crate::error::Result;
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_zeros};

use super::shape::{WHAT, Window};

/// `z = J (x; u; 1)`, `x+ = [A B c] (x; u; 1) + G w`, `y+ = Theta z + w`, row by row; c only with an intercept.
#[derive(Debug, Clone)]
pub struct Linear {
    /// J (d, k), `k = states + inputs (+ 1)`.
    pub entering: Vec<f64>,
    /// `[A B c]` (states, k).
    pub matrix: Vec<f64>,
    /// G (states, n_y).
    pub noise: Vec<f64>,
}

impl Window {
    /// The linear system of `theta` (n_y, d).
    ///
    /// # Errors
    /// [`crate::Error::Shape`], [`crate::Error::Memory`].
    pub fn linear<'a>(&self, theta: impl Into<MatrixView<'a>>) -> Result<Linear> {
        let (n, m, d) = (self.states(), self.inputs(), self.length());
        let theta = theta.into().sized("theta", self.outputs(), d)?;
        let k = n + m + usize::from(self.intercept());
        let mut entering = try_zeros(WHAT, checked_len(WHAT, d, k)?)?;
        let mut matrix = try_zeros(WHAT, checked_len(WHAT, n, k)?)?;
        let mut noise = try_zeros(WHAT, checked_len(WHAT, n, self.outputs())?)?;
        let [mut z, mut y] = [try_zeros::<f64>(WHAT, d)?, try_zeros::<f64>(WHAT, self.outputs())?];
        let mut unit = try_zeros(WHAT, n + m + 1)?;
        // all maps are linear: their columns are what unit vectors become
        for j in 0..k {
            unit.fill(0.0);
            unit[j] = 1.0;
            let (x, rest) = unit.split_at_mut(n);
            self.regressors(x, &rest[..m], rest[m], &mut z);
            y.iter_mut().zip(theta.chunks_exact(d)).for_each(|(to, row)| *to = product(row, &z));
            self.advance(x, &y, &rest[..m]);
            entering.iter_mut().skip(j).step_by(k).zip(&z).for_each(|(to, v)| *to = *v);
            matrix.iter_mut().skip(j).step_by(k).zip(&*x).for_each(|(to, v)| *to = *v);
        }
        let none = try_zeros(WHAT, m)?;
        for j in 0..self.outputs() {
            unit.fill(0.0);
            y.fill(0.0);
            y[j] = 1.0;
            self.advance(&mut unit[..n], &y, &none);
            noise.iter_mut().skip(j).step_by(self.outputs()).zip(&unit).for_each(|(to, v)| *to = *v);
        }
        Ok(Linear { entering, matrix, noise })
    }
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
