//! The sets of feasible weights, and uniform ones.

use crate::error::Result;
use crate::sample::Law;

/// The set of feasible weights.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weights {
    /// `w >= 0`, `sum w = 1`.
    Simplex,
    /// `w >= 0`, `sum w <= 1`.
    Subsimplex,
}

/// The uniform average `(1/N) sum_i E_i` of `size` realizations with the given hits per entry.
///
/// # Errors
/// [`crate::Error::Memory`].
pub fn uniform(law: &Law, counts: &[u64], size: u64) -> Result<Vec<f64>> {
    let n = size.max(1) as f64;
    let mut mean = law.atoms()?;
    mean.iter_mut().zip(counts).for_each(|(mean, &count)| *mean *= count as f64 / n);
    Ok(mean)
}
