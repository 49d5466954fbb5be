//! Independent draws into the sample-major index array.

use super::categorical::AliasTable;
use super::law::Law;
use super::singletons::Index;
use crate::error::Result;
use crate::memory::{try_collect, try_collect_all};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{CHUNK, Key, Lanes};

/// Samples per block, so that their part of the output stays in the cache while it is filled line by line.
const BLOCK: usize = 1024;

/// Lines drawn before their indices are written to the samples: one store of a few bytes instead of one per line.
const GROUP: usize = 8;

const WHAT: &str = "the tables of a sampler";

/// The indices of [`GROUP`] lines in [`BLOCK`] samples, line by line.
type Tile<I> = [[I; BLOCK]; GROUP];

/// Fills `out` (`size * lines` indices): index `(i, j)` is draw `i` of line `j`.
pub(super) fn fill<I: Index>(law: &Law, key: &Key, out: &mut [I], threads: usize, stop: &Stop) -> Result<()> {
    let lines = law.lines();
    let table = |j| stop.check().and_then(|()| AliasTable::new(law.line(j)));
    let tables = try_collect_all(WHAT, (0..lines).map(table))?;
    for_each_chunk(out.chunks_mut(CHUNK * lines).enumerate(), threads, stop, |(chunk, out)| {
        // a zero line has no table: its index is 0, where its value is 0
        let begun = tables.iter().enumerate().map(|(j, table)| table.as_ref().map(|t| (t, key.lanes(j, chunk))));
        let mut drawn = try_collect(WHAT, begun)?;
        let mut words = [0u64; BLOCK];
        let mut tile: Tile<I> = [[I::default(); BLOCK]; GROUP];
        for block in out.chunks_mut(BLOCK * lines) {
            if let [line] = &mut drawn[..] {
                draw(line, &mut words, block);
                continue; // without a check for a stop: a chunk of one line is short
            }
            stop.check()?;
            let size = block.len() / lines;
            for (group, drawn) in drawn.chunks_mut(GROUP).enumerate() {
                drawn.iter_mut().zip(&mut tile).for_each(|(line, row)| draw(line, &mut words, &mut row[..size]));
                deal(&tile, drawn.len(), block, lines, GROUP * group);
            }
        }
        Ok(())
    })
}

/// The next indices of one line, at most [`BLOCK`] of them; `words` is room for their words.
fn draw<I: Index>(line: &mut Option<(&AliasTable, Lanes)>, words: &mut [u64; BLOCK], out: &mut [I]) {
    let Some((table, lanes)) = line else { return out.fill(I::default()) };
    let words = &mut words[..out.len()];
    lanes.fill(words);
    table.draw_all(words, out);
}

/// Writes the indices of the `count` lines from `first` on to the samples of `block` (`lines` indices each).
fn deal<I: Index>(tile: &Tile<I>, count: usize, block: &mut [I], lines: usize, first: usize) {
    let samples = block.chunks_exact_mut(lines).map(|sample| &mut sample[first..first + count]);
    if count == GROUP {
        for (at, sample) in (0..BLOCK).zip(samples) {
            // constant length, so that the eight stores become one
            if let Some(sample) = sample.first_chunk_mut::<GROUP>() {
                *sample = std::array::from_fn(|j| tile[j][at]);
            }
        }
    } else {
        for (at, sample) in (0..BLOCK).zip(samples) {
            sample.iter_mut().zip(tile).for_each(|(index, row)| *index = row[at]);
        }
    }
}
