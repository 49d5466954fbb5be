//! Independent draws into the sample-major index array.

use super::categorical::AliasTable;
use super::law::Law;
use super::singletons::Index;
use crate::error::Result;
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{CHUNK, Key, Lanes};

/// Samples treated line by line before the next ones, so that their part of the output stays in the cache.
const BLOCK: usize = 1024;

/// Fills `out` (`size * lines` indices): index `(i, j)` is draw `i` of line `j`.
pub(super) fn fill<I: Index>(law: &Law, key: &Key, out: &mut [I], threads: usize, stop: &Stop) -> Result<()> {
    let lines = law.lines();
    let tables: Vec<_> =
        (0..lines).map(|j| stop.check().map(|()| AliasTable::new(law.line(j)))).collect::<Result<_>>()?;
    for_each_chunk(out.chunks_mut(CHUNK * lines).enumerate(), threads, stop, |(chunk, out)| {
        // A zero line has no table: its index stays 0, where its value is 0.
        let mut drawn: Vec<(usize, &AliasTable, Lanes)> = tables
            .iter()
            .enumerate()
            .filter_map(|(j, table)| table.as_ref().map(|table| (j, table, key.lanes(j, chunk))))
            .collect();
        let mut words = [0u64; BLOCK];
        for block in out.chunks_mut(BLOCK * lines) {
            stop.check()?;
            let words = &mut words[..block.len() / lines];
            for (j, table, lanes) in &mut drawn {
                lanes.fill(words);
                if lines == 1 {
                    for (index, &word) in block.iter_mut().zip(words.iter()) {
                        *index = I::new(table.draw(word));
                    }
                } else {
                    for (sample, &word) in block.chunks_exact_mut(lines).zip(words.iter()) {
                        sample[*j] = I::new(table.draw(word));
                    }
                }
            }
        }
        Ok(())
    })
}
