//! Weights on the simplex for realizations `E_1 .. E_N`: uniform, accumulated and sequential least squares.
//!
//! Accumulated least squares (ALSE) minimises `||sum_i w_i E_i - E*||` over `w >= 0, sum w = 1` in the 2-norm (Frobenius
//! for matrices): by a formula for singleton vectors, and for matrices whose columns have weights of their own
//! ([`closed_form()`]), by a certified solver for everything else ([`alse()`]). Sequential least squares (SLSE) takes one line search per realization ([`slse()`]).
//! The target `E*` is always an argument: a nominal model or a held-out estimate.

mod alse;
mod closed_form;
mod dense;
mod line_search;
mod path;
mod simplex;
mod slse;
mod slse_dense;
mod slse_run;
mod slse_sample;
mod slse_tables;

pub use alse::{Realizations, Settings, Solution, Status, alse, alse_prefixes, second_opinion};
pub use closed_form::{ClosedForm, Gap, closed_form, project_on_simplex};
pub use dense::Dense;
pub use path::{Path, alse_path, uniform_path};
pub use slse::{Sequential, slse, slse_each};
pub use slse_dense::slse_dense;

pub(crate) use line_search::{clipped, step_towards};
pub(crate) use slse_run::Run;
pub(crate) use slse_tables::Apart;

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

/// `||a - b||_2`, without overflow or underflow for any finite input whose result is representable.
pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    norm(a.iter().zip(b).map(|(a, b)| a - b))
}

/// `||v||_2`, in the same way.
pub(crate) fn norm(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let scale = values.clone().fold(0.0f64, |m, v| m.max(v.abs()));
    if scale == 0.0 || !scale.is_finite() {
        return scale;
    }
    let sum: f64 = values.map(|v| (v / scale).powi(2)).sum();
    scale * sum.sqrt()
}

/// The power of two next to `max |v|` (1 for all zeros): dividing by it is exact and keeps squares in range.
pub(crate) fn power_of_two_scale<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    let max = values.into_iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if max == 0.0 { 1.0 } else { max.log2().floor().clamp(-1021.0, 1022.0).exp2() }
}
