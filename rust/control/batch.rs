//! The controls `u^s = B^+ y^s` of all realizations, into memory that the caller brought.
//!
//! A singleton `x0^s` picks one column of `A^s`, and that column has one nonzero (columns scheme): `y^s` then has at most
//! two, and `u^s` is the sum of two scaled columns of `B^+`, `O(m)` per realization ([`super::singleton_rows`]).
//! Everything else goes through blocks of dense `y` and one matrix product each ([`super::dense_rows`]).

use super::dense_rows;
use super::realizations::Realized;
use super::singleton_rows::Picks;
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_collect, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::past_caches::LARGE;

/// Realizations treated together.
const BLOCK: usize = 256;

/// Bytes of controls that go past the caches together, at least: every block waits until its stores have left.
const BYTES: usize = 1 << 16;

/// Entries of `y` treated together in the general case: well within a second-level cache, and no new pages per block.
const ENTRIES: usize = 8192;

/// What results are written to. The controls are the same; the way there is not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// Never written before: the system is about to clear its pages, in the cache, and the controls go there too.
    Fresh,
    /// Used before: controls of singletons (of the columns) go past the caches if they are 32 MiB or more.
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

    /// [`Self::controls`] into `out`, whose entries are overwritten; after an error it holds a part of them.
    ///
    /// # Errors
    /// [`Error::Shape`] if `out` or `pinv` has another length, [`Error::Interrupted`] after a stop, [`Error::Overflow`]
    /// if a control is no finite number.
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
        // a block that is looked at again had better stay in the cache
        let large = memory == Memory::Used && !unbounded && size_of_val(out) >= LARGE;
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
            // while the block is in the cache, and only where no bound on the factors excludes it
            if unbounded && !all_finite(out) {
                return Err(Error::Overflow { what: "a control" });
            }
            Ok(())
        })
    }
}

/// Without a way out in the middle, so that it is compiled to vector instructions.
fn all_finite(values: &[f64]) -> bool {
    values.iter().fold(true, |finite, v| finite & (v.abs() <= f64::MAX))
}
