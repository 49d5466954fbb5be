//! Passes split over samples, with scoped threads; only for passes that take longer than starting a thread.

use std::ops::Range;

use super::problem::SEARCH;
use crate::error::Result;
use crate::memory::{try_collect_all, try_zeros};
use crate::parallel::{Stop, for_each_chunk};

/// Entries per thread below which another thread costs more than it saves.
const WORTH: usize = 400_000;

fn parts(threads: usize, samples: usize, entries: usize) -> usize {
    threads.min(samples.saturating_mul(entries) / WORTH).max(1)
}

/// Fills `out` in chunks, `value(first, chunk)` each; chunks start at multiples of four.
pub(crate) fn fill(
    threads: usize,
    entries: usize,
    out: &mut [f64],
    value: impl Fn(usize, &mut [f64]) + Sync,
) -> Result<()> {
    let parts = parts(threads, out.len(), entries);
    if parts == 1 {
        value(0, out);
        return Ok(());
    }
    let length = out.len().div_ceil(parts).next_multiple_of(4);
    every(out.chunks_mut(length).enumerate(), parts, |(p, chunk)| value(p * length, chunk))
}

/// Adds the contributions of the samples `0..samples` to `out`, with one private copy of `out` per thread, summed in
/// order, so that the result does not depend on timing. Returns the sum of the results of `add`.
pub(crate) fn accumulate<T: Total>(
    threads: usize,
    samples: usize,
    entries: usize,
    out: &mut [f64],
    add: impl Fn(Range<usize>, &mut [f64]) -> T + Sync,
) -> Result<T> {
    let parts = parts(threads, samples, entries);
    if parts == 1 {
        return Ok(add(0..samples, out));
    }
    let length = samples.div_ceil(parts);
    let private = |_| Ok((try_zeros(SEARCH, out.len())?, T::default()));
    let mut results = try_collect_all(SEARCH, (0..parts).map(private))?;
    every(results.iter_mut().enumerate(), parts, |(p, (private, total))| {
        *total = add(p * length..((p + 1) * length).min(samples), private);
    })?;
    let mut total = T::default();
    for (private, part) in results {
        crate::vector::axpy(1.0, &private, out);
        total.add(part);
    }
    Ok(total)
}

/// Works through the chunks; a pass is too short for a check for a stop.
fn every<C: Send>(chunks: impl Iterator<Item = C> + Send, threads: usize, work: impl Fn(C) + Sync) -> Result<()> {
    for_each_chunk(chunks, threads, &Stop::new(), |chunk| {
        work(chunk);
        Ok(())
    })
}

/// The result of one part of an accumulation besides the vector.
pub(crate) trait Total: Default + Send {
    fn add(&mut self, part: Self);
}

impl Total for () {
    fn add(&mut self, (): ()) {}
}

impl Total for f64 {
    fn add(&mut self, part: f64) {
        *self += part;
    }
}
