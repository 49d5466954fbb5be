//! Realizations of a law one after the other, without end: the first ones are those of a sample of any size.

use std::sync::Arc;

use super::categorical::AliasTable;
use super::law::Law;
use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_collect_all, try_zeros};
use crate::stream::{CHUNK, Key, Lanes};

/// Realizations drawn at a time; divides [`CHUNK`] and is a multiple of the lanes.
const BLOCK: usize = 128;

/// Independent realizations in order. Number `i` is realization `i` of `sample(law, N, Scheme::Iid, key, ..)`, `N > i`,
/// so only the position has to be saved.
pub struct Sequence {
    tables: Vec<Option<AliasTable>>,
    key: Key,
    lanes: Vec<Lanes>,
    /// `BLOCK` realizations, `lines` indices each
    block: Vec<u32>,
    lines: usize,
    position: u64,
}

impl std::fmt::Debug for Sequence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { key, lines, position, .. } = self;
        let mut shown = f.debug_struct("Sequence");
        shown.field("key", key).field("lines", lines).field("position", position).finish_non_exhaustive()
    }
}

impl Sequence {
    /// The sequence of `law` under `key`, at realization 0.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn new(law: &Arc<Law>, key: Key) -> Result<Self> {
        const WHAT: &str = "a sequence of realizations";
        let lines = law.lines();
        Ok(Self {
            tables: try_collect_all(WHAT, (0..lines).map(|j| AliasTable::new(law.line(j))))?,
            key,
            lanes: try_collect(WHAT, (0..lines).map(|j| key.lanes(j, 0)))?,
            block: try_zeros(WHAT, checked_len(WHAT, BLOCK, lines)?)?,
            lines,
            position: 0,
        })
    }

    /// The number of the realization that comes next.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The next realization: one index per line, 0 for a line of zeros.
    #[inline]
    pub fn draw(&mut self) -> &[u32] {
        let at = (self.position % BLOCK as u64) as usize;
        if at == 0 {
            self.fill();
        }
        self.position += 1;
        &self.block[at * self.lines..(at + 1) * self.lines]
    }

    /// Goes to realization `position`; skips at most one chunk of words.
    pub fn seek(&mut self, position: u64) {
        let inside = (position % CHUNK as u64) as usize;
        self.position = position - inside as u64;
        for _ in 0..inside.div_ceil(BLOCK) {
            self.fill();
            self.position += BLOCK as u64;
        }
        self.position = position;
    }

    /// The block that starts at `position`.
    fn fill(&mut self) {
        if self.position.is_multiple_of(CHUNK as u64) {
            let chunk = (self.position / CHUNK as u64) as usize;
            self.lanes.iter_mut().enumerate().for_each(|(j, lanes)| *lanes = self.key.lanes(j, chunk));
        }
        let mut words = [0u64; BLOCK];
        for (j, (table, lanes)) in self.tables.iter().zip(&mut self.lanes).enumerate() {
            let Some(table) = table else { continue };
            lanes.fill(&mut words);
            for (index, &word) in self.block[j..].iter_mut().step_by(self.lines).zip(&words) {
                *index = table.draw(word);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Index as _, Indices, with_indices};
    use crate::{Scheme, Stop, sample};

    fn indices(draws: &Indices) -> Vec<u32> {
        with_indices!(draws, v => v.iter().map(|r| r.get() as u32).collect())
    }

    #[test]
    fn equals_a_sample_and_can_begin_anywhere() {
        let law = Arc::new(Law::new(vec![1.0, -2.0, 0.5, 0.0, 0.0, 0.0, 3.0, 0.0, 1.0], 3, 3).unwrap());
        let key = Key([3; 32]);
        let size = CHUNK + 2 * BLOCK + 5;
        let all = indices(sample(&law, size, Scheme::Iid, &key, 1, &Stop::new()).unwrap().indices());
        let mut sequence = Sequence::new(&law, key).unwrap();
        for expected in all.chunks_exact(3) {
            assert_eq!(sequence.draw(), expected);
        }
        for start in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, CHUNK - 1, CHUNK, CHUNK + 1, CHUNK + BLOCK] {
            sequence.seek(start as u64);
            for expected in all[3 * start..].chunks_exact(3).take(BLOCK + 2) {
                assert_eq!(sequence.draw(), expected);
            }
        }
    }
}
