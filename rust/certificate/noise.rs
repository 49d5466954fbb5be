//! Noise of a run to come that is not in the region.

use crate::error::{Error, Result};
use crate::identify::chi2_upper;

use super::powers::product;

/// Gaussian noise of the run to come, independent of the data.
#[derive(Debug, Clone, Copy)]
pub struct Gaussian<'a> {
    /// A root of the covariance, or of a bound of it (n, n); infinite where there is none.
    pub root: &'a [f64],
    /// The probability that the last state is off by more than what is added for it.
    pub end: f64,
    /// The same of each earlier state; near a reference again of its effect through the error of the model.
    pub before: f64,
}

impl Gaussian<'_> {
    /// `covariance += (power root) (power root)'`: with all earlier powers that of `sum_p A^p w(p)`.
    pub(super) fn add(&self, power: &[f64], n: usize, covariance: &mut [f64]) -> Result<()> {
        let moved = product(power, self.root, n, n, n)?;
        for (i, to) in covariance.chunks_exact_mut(n).enumerate() {
            let row = &moved[i * n..(i + 1) * n];
            let along = moved.chunks_exact(n).map(|other| row.iter().zip(other).map(|(a, b)| a * b).sum::<f64>());
            to.iter_mut().zip(along).for_each(|(to, value)| *to += value);
        }
        Ok(())
    }

    /// Each of n variates of these variances is at most `t` deviations, with `P(|g| > t) = level / n` for one standard
    /// normal g; the level is that of the last state or of an earlier one.
    pub(super) fn of_components(&self, last: bool, variances: &[f64], to: &mut [f64]) -> Result<()> {
        let level = if last { self.end } else { self.before };
        let times = chi2_upper(level / variances.len() as f64, 1.0)?.sqrt();
        for (to, variance) in to.iter_mut().zip(variances) {
            *to += if variance.is_finite() { times * variance.sqrt() } else { f64::INFINITY };
        }
        Ok(())
    }
}

/// What is known of noise to come.
#[derive(Debug, Clone, Copy)]
pub enum ToCome<'a> {
    /// `||root^-1 [w(0) .. w(K-1)]|| <= radius` in the event of the region, `root` (n, n) a root of the covariance.
    Sized {
        /// The bound.
        radius: f64,
        /// The root.
        root: &'a [f64],
    },
    /// Gaussian noise with levels of its own.
    Gaussian(Gaussian<'a>),
}

impl ToCome<'_> {
    pub(super) fn checked(self, n: usize) -> Result<Self> {
        let (Self::Sized { root, .. } | Self::Gaussian(Gaussian { root, .. })) = self;
        if root.len() == n * n {
            return Ok(self);
        }
        let found = root.len().to_string();
        Err(Error::Shape { name: "noise to come", expected: format!("a root of {} entries", n * n), found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::covariance_root;

    #[test]
    fn roots_and_covariances() {
        let s = [4.0, 2.0, 2.0, 1.0]; // singular
        let root = covariance_root(&s, 2).unwrap();
        let square = |i: usize, j: usize| root[2 * i] * root[2 * j] + root[2 * i + 1] * root[2 * j + 1];
        (0..4).for_each(|at| assert!((square(at / 2, at % 2) - s[at]).abs() < 1e-14));
        // each row in its own units, also where they are far apart
        let mixed = covariance_root(&[4e20, 1.0, 1.0, 1e-20], 2).unwrap();
        assert!((mixed[2].hypot(mixed[3]) / 1e-10 - 1.0).abs() < 1e-14);
        let zero = covariance_root(&[0.0, 0.0, 0.0, 9.0], 2).unwrap();
        assert_eq!([zero[0].hypot(zero[1]), zero[2].hypot(zero[3])], [0.0, 3.0]);
        let noise = Gaussian { root: &root, end: 0.1, before: 0.01 };
        let mut covariance = [0.0; 4];
        noise.add(&[1.0, 0.0, 0.0, 1.0], 2, &mut covariance).unwrap();
        noise.add(&[0.0, 1.0, 1.0, 0.0], 2, &mut covariance).unwrap();
        [5.0, 4.0, 4.0, 5.0].iter().zip(&covariance).for_each(|(e, f)| assert!((e - f).abs() < 1e-13));
        let mut found = [1.0; 2];
        noise.of_components(true, &[covariance[0], covariance[3]], &mut found).unwrap();
        // P(|g| > 1.959963984540054) = .05
        found.iter().for_each(|f| assert!((f - 1.0 - 1.959963984540054 * 5f64.sqrt()).abs() < 1e-9));
        noise.of_components(true, &[f64::NAN; 2], &mut found).unwrap();
        assert_eq!(found, [f64::INFINITY; 2]);
    }
}
