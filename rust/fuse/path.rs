//! The errors after the first `k` realizations, for several `k`, in one pass over the indices.

use super::closed_form::{Gap, estimate, gap, totals};
use super::{Dense, Sequential, Weights, distance, power_of_two_scale, uniform};
use crate::error::Result;
use crate::memory::{try_collect, try_extend, try_push, try_zeros};
use crate::parallel::Stop;
use crate::sample::Singletons;

const WHAT: &str = "a path";

/// Results of accumulated least squares after the first `k` realizations, for increasing `k`.
#[derive(Debug, Clone, Default)]
pub struct Path {
    /// `||estimate - target||`.
    pub errors: Vec<f64>,
    /// The gap of the squared error.
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
pub fn uniform_path(
    draws: &Singletons,
    target: &[f64],
    sizes: &[usize],
    keep: bool,
    stop: &Stop,
) -> Result<Sequential> {
    let mut path = Sequential::default();
    with_counts(draws, sizes, stop, |size, counts| {
        path.record(uniform(draws.law(), counts, size as u64)?, target, keep)
    })?;
    Ok(path)
}

/// The same for realizations without structure.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop.
pub fn uniform_dense(
    samples: &Dense<'_>,
    target: &[f64],
    sizes: &[usize],
    keep: bool,
    stop: &Stop,
) -> Result<Sequential> {
    let (mut path, mut done) = (Sequential::default(), 0);
    let scale = power_of_two_scale(samples.values()); // no sum overflows
    let mut sum: Vec<f64> = try_zeros(WHAT, target.len())?;
    for &size in sizes {
        for i in done..size {
            stop.check()?;
            sum.iter_mut().zip(samples.row(i)).for_each(|(sum, e)| *sum += e / scale);
        }
        done = size;
        path.record(try_collect(WHAT, sum.iter().map(|sum| sum / size as f64 * scale))?, target, keep)?;
    }
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
