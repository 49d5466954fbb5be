//! Errors of single estimates.

use crate::control::singular_values;
use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::memory::try_zeros;
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{Key, Purpose};
use crate::tails::Norm;

use super::average::Average;
use super::sizes::CHUNK;

/// `||average - mean||` of every run.
///
/// # Errors
/// As [`Plans::errors`](super::Plans::errors).
pub fn estimate_errors(
    average: &Average,
    kind: Norm,
    runs: usize,
    key: &Key,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    let length = average.law.length();
    let mut errors: Vec<f64> = try_zeros("the simulated errors", runs)?;
    for_each_chunk(errors.chunks_mut(CHUNK).enumerate(), threads, stop, |(chunk, errors)| {
        let mut wrong: Vec<f64> = try_zeros("a simulated estimate", average.law.values().len())?;
        for (at, error) in errors.iter_mut().enumerate() {
            stop.check()?;
            let mut rng = key.stream(Purpose::Plans, chunk * CHUNK + at);
            wrong.iter_mut().zip(average.law.values()).for_each(|(w, v)| *w = -v);
            for (j, wrong) in wrong.chunks_exact_mut(length).enumerate() {
                average.line(j, &mut rng, |i, value| wrong[i] += value)?;
            }
            *error = match kind {
                Norm::One => wrong.iter().map(|w| w.abs()).sum(),
                Norm::Frobenius => norm(wrong.iter().copied()),
                Norm::Spectral => singular_values(&wrong, length)?.first().copied().unwrap_or(0.0),
            };
        }
        Ok(())
    })?;
    if errors.iter().any(|error| !error.is_finite()) {
        return Err(Error::Overflow { what: "a simulated error" });
    }
    Ok(errors)
}
