//! Passes split over samples. Scoped threads, so only for passes long enough to pay for starting them.

use std::ops::Range;

/// Entries below which one more thread costs more than it saves.
const WORTH: usize = 400_000;

fn parts(threads: usize, samples: usize, entries: usize) -> usize {
    threads.min(samples.saturating_mul(entries) / WORTH).max(1)
}

/// Fills `out` in chunks, `value(first, chunk)` each; chunks start at multiples of four.
pub(crate) fn fill(threads: usize, entries: usize, out: &mut [f64], value: impl Fn(usize, &mut [f64]) + Sync) {
    let parts = parts(threads, out.len(), entries);
    if parts == 1 {
        value(0, out);
        return;
    }
    let length = out.len().div_ceil(parts).next_multiple_of(4);
    std::thread::scope(|scope| {
        for (p, chunk) in out.chunks_mut(length).enumerate() {
            let value = &value;
            scope.spawn(move || value(p * length, chunk));
        }
    });
}

/// Adds the contributions of the samples `0..samples` to `out`, one private copy of `out` per thread, summed in order: the
/// result does not depend on timing. Returns the sum of what `add` returns.
pub(crate) fn accumulate<T: Total>(
    threads: usize,
    samples: usize,
    entries: usize,
    out: &mut [f64],
    add: impl Fn(Range<usize>, &mut [f64]) -> T + Sync,
) -> T {
    let parts = parts(threads, samples, entries);
    if parts == 1 {
        return add(0..samples, out);
    }
    let length = samples.div_ceil(parts);
    let dim = out.len();
    let mut total = T::default();
    let results = std::thread::scope(|scope| {
        let handles: Vec<_> = (0..parts)
            .map(|p| {
                let (add, range) = (&add, p * length..((p + 1) * length).min(samples));
                scope.spawn(move || {
                    let mut private = vec![0.0; dim];
                    let total = add(range, &mut private);
                    (private, total)
                })
            })
            .collect();
        handles.into_iter().map(std::thread::ScopedJoinHandle::join).collect::<Vec<_>>()
    });
    for result in results {
        match result {
            Ok((private, part)) => {
                super::vector::axpy(1.0, &private, out);
                total.add(part);
            }
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
    total
}

/// What one part of an accumulation returns besides the vector.
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
