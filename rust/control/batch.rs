//! The controls `u^s = B^+ y^s` of all realizations, written into memory of the caller.
//!
//! A singleton `x0^s` picks one column of `A^s`, and that column has one nonzero (columns scheme): `y^s` then has at
//! most two, and `u^s` is the sum of two scaled columns of `B^+`, `O(m)` per realization ([`super::singleton_rows`]).
//! Everything else goes through blocks of dense `y` and one matrix product each ([`super::dense_rows`]).

use super::dense_rows;
use super::realizations::Realized;
use super::singleton_rows::Picks;
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_collect, try_zeros};
use crate::nontemporal::LARGE;
use crate::parallel::{Stop, for_each_chunk};

/// Realizations in one block of work.
const BLOCK: usize = 256;

/// Least bytes of controls in a block that is stored past the caches: every block ends with a fence, which waits for
/// its stores.
const BYTES: usize = 1 << 16;

/// States from which the indices of one realization fill a cache line.
const FAR: usize = 64;

/// Entries of `y` in one block of the general case: 64 KiB, well within a second-level cache.
const ENTRIES: usize = 8192;

/// State of the memory for the results; it decides how they are stored, not their values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Never written before: the system clears its pages through the cache, so the controls are stored there too.
    Fresh,
    /// Written before: controls of singletons (drawn by columns) of 64 or more states, 32 MiB or more, are stored past
    /// the caches.
    Used,
}

impl Realized<'_> {
    /// The controls `B^+ y^s`, one row of `m` per realization. `pinv` is `B^+`, row by row (`m x n`).
    ///
    /// # Errors
    /// [`Error::Memory`] if the controls do not fit, and as for [`Self::controls_into`].
    pub fn controls(&self, pinv: &[f64], m: usize, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
        let mut out = try_zeros("the controls", checked_len("the controls", self.size(), m)?)?;
        self.controls_into(pinv, m, &mut out, Memory::Fresh, threads, stop)?;
        Ok(out)
    }

    /// [`Self::controls`] into `out`, which is overwritten; after an error, a part of it is written.
    ///
    /// # Errors
    /// [`Error::Shape`] if `out` or `pinv` has another length, [`Error::Interrupted`] after a stop, [`Error::Overflow`]
    /// if a control is not finite.
    pub fn controls_into(
        &self,
        pinv: &[f64],
        m: usize,
        out: &mut [f64],
        memory: Memory,
        threads: usize,
        stop: &Stop,
    ) -> Result<()> {
        let n = self.n;
        for (name, found, rows, cols) in [("out", out.len(), self.size(), m), ("pinv", pinv.len(), m, n)] {
            if m == 0 || checked_len("the controls", rows, cols)? != found {
                let expected = format!("{rows} x {cols} entries, at least one");
                return Err(Error::Shape { name, expected, found: found.to_string() });
            }
        }
        // rows of the transpose are the contiguous columns of B^+
        let transposed: Vec<f64> = try_collect("the controls", (0..n * m).map(|k| pinv[(k % m) * n + k / m]))?;
        let picks = Picks::new(self, &transposed, m)?;
        let unbounded = picks.as_ref().is_none_or(|picks| !picks.bound().is_finite());
        // stores past the caches only if no block is read again to look for infinities
        let large = memory == Memory::Used && !unbounded && size_of_val(out) >= LARGE && n >= FAR;
        let rows = match picks {
            Some(_) => BLOCK.max(if large { BYTES / (8 * m) } else { 0 }),
            None => (ENTRIES / n).clamp(16, BLOCK),
        };
        for_each_chunk(out.chunks_mut(rows * m).enumerate(), threads, stop, |(block, out)| {
            let first = block * rows;
            match &picks {
                Some(picks) => picks.controls(first, out, large),
                None => dense_rows::controls(self, first, &transposed, m, out, stop)?,
            }
            // while the block is in the cache; not needed if a bound on all entries is finite
            if unbounded && !all_finite(out) {
                return Err(Error::Overflow { what: "a control" });
            }
            Ok(())
        })
    }
}

/// Without an early return, so that the loop is vectorised.
fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |finite, v| finite & (v.abs() <= f64::MAX))
}
