//! The errors after the first `k` realizations, for several `k`, in one pass over the indices.

use super::closed_form::{Gap, estimate, gap, totals};
use super::{Weights, distance, uniform};
use crate::error::Result;
use crate::memory::{try_extend, try_push, try_zeros};
use crate::parallel::Stop;
use crate::sample::Singletons;

const WHAT: &str = "a path";

/// Results of a fusion after the first `k` realizations, for increasing `k`.
#[derive(Debug, Clone, Default)]
pub struct Path {
    /// `||estimate - target||`.
    pub errors: Vec<f64>,
    /// The gap of the squared error, where the method has one.
    pub gaps: Vec<Gap>,
    /// The estimates, one after the other, when asked for.
    pub estimates: Vec<f64>,
}

/// Calls `visit(k, counts)` with the hits of the first `k` realizations, for every `k` in the increasing `sizes`.
fn with_counts(
    draws: &Singletons,
    sizes: &[usize],
    stop: &Stop,
    mut visit: impl FnMut(usize, &[u64]) -> Result<()>,
) -> Result<()> {
    let mut counts = try_zeros(WHAT, draws.law().values().len())?;
    let mut done = 0;
    for &size in sizes {
        stop.check()?;
        draws.add_counts(done, size, &mut counts, stop)?;
        done = size;
        visit(size, &counts)?;
    }
    Ok(())
}

/// Uniform averages of growing prefixes.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop.
pub fn uniform_path(draws: &Singletons, target: &[f64], sizes: &[usize], keep: bool, stop: &Stop) -> Result<Path> {
    let mut path = Path::default();
    with_counts(draws, sizes, stop, |size, counts| {
        let mean = uniform(draws.law(), counts, size as u64)?;
        try_push(WHAT, &mut path.errors, distance(&mean, target))?;
        if keep {
            try_extend(WHAT, &mut path.estimates, mean)?;
        }
        Ok(())
    })?;
    Ok(path)
}

/// Accumulated least squares of growing prefixes, every line with weights of its own (the closed form).
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop.
pub fn alse_path(
    draws: &Singletons,
    target: &[f64],
    set: Weights,
    sizes: &[usize],
    keep: bool,
    stop: &Stop,
) -> Result<Path> {
    let law = draws.law();
    let mut path = Path::default();
    with_counts(draws, sizes, stop, |_, counts| {
        let totals = totals(law, counts, target, set)?;
        let fit = estimate(law, &totals)?;
        try_push(WHAT, &mut path.errors, distance(&fit, target))?;
        try_push(WHAT, &mut path.gaps, gap(law, counts, &totals, &fit, target, set)?)?;
        if keep {
            try_extend(WHAT, &mut path.estimates, fit)?;
        }
        Ok(())
    })?;
    Ok(path)
}
