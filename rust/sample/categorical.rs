//! The alias table: one index from one 64-bit word, with probabilities that are exact integers.
//!
//! Walker's alias method with Vose's construction on `2^k >= n` cells. The mass of a component is an integer out of
//! `T = 2^k 2^32`, so the construction has no rounding, a zero component has mass zero and can never come out, and the
//! distribution is known exactly: it differs from `|w| / ||w||_1` by at most `1/T` per component plus the rounding of
//! the cumulative sums.

use super::singletons::Index;
use crate::error::Result;
use crate::memory::try_zeros;

/// The coin's range: a cell is split between itself and its alias in units of `2^-32`.
const COIN: u64 = 1 << 32;

const WHAT: &str = "an alias table";

/// Words per block of the portable loop.
const BLOCK: usize = 256;

/// A categorical distribution over the components of one line.
#[derive(Debug, PartialEq)]
pub struct AliasTable {
    mask: u64,
    /// `threshold << 32 | alias`
    cells: Vec<u64>,
}

impl AliasTable {
    /// The table for probabilities proportional to `|weights|`; `None` when they are all zero.
    ///
    /// The weights and their 1-norm must be finite (a [`super::Law`] has checked that).
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn new(weights: &[f64]) -> Result<Option<Self>> {
        let Some(mut cells) = integer_masses(weights)? else { return Ok(None) };
        let count = cells.len();
        // Two stacks in one array: cells below COIN from its front, the others from its back.
        let mut order = try_zeros::<u32>(WHAT, count)?;
        let (mut small, mut large) = (0, 0);
        for (i, &mass) in cells.iter().enumerate() {
            // both stores are allowed; a branch here would be mispredicted half of the time
            order[small] = i as u32;
            order[count - 1 - large] = i as u32;
            small += usize::from(mass < COIN);
            large += usize::from(mass >= COIN);
        }
        // The masses add up to cells * COIN: while a cell is below COIN, another is above.
        while small > 0 && large > 0 {
            let (s, l) = (order[small - 1] as usize, order[count - large] as usize);
            let mass = cells[s];
            cells[s] = mass << 32 | l as u64;
            let rest = cells[l] - (COIN - mass);
            cells[l] = rest;
            // a large cell that has become small takes the place of the one just filled
            order[small - 1] = l as u32;
            small -= usize::from(rest >= COIN);
            large -= usize::from(rest < COIN);
        }
        for &l in &order[count - large..] {
            cells[l as usize] = l.into(); // a full cell is its own alias
        }
        Ok(Some(Self { mask: count as u64 - 1, cells }))
    }

    /// The index for one uniform word: its low bits choose the cell, its high half is the coin.
    #[inline(always)]
    pub fn draw(&self, word: u64) -> u32 {
        let cell = word & self.mask;
        let entry = self.cells[cell as usize];
        // a random bit: a branch would be mispredicted half of the time
        std::hint::select_unpredictable(word >> 32 < entry >> 32, cell as u32, entry as u32)
    }

    /// [`AliasTable::draw`] for every word: `out[i]` is the index of `words[i]`.
    pub(crate) fn draw_all<I: Index>(&self, words: &[u64], out: &mut [I]) {
        #[cfg(target_arch = "x86_64")]
        let done = crate::simd::lookup(&self.cells, words, out, I::new);
        #[cfg(not(target_arch = "x86_64"))]
        let done = 0;
        self.draw_all_portable(&words[done..], &mut out[done..]);
    }

    /// First all loads, then all comparisons: in one loop, the compiler makes branches, or moves that wait for the
    /// loads.
    fn draw_all_portable<I: Index>(&self, words: &[u64], out: &mut [I]) {
        let mut entries = [0u64; BLOCK];
        for (words, out) in words.chunks(BLOCK).zip(out.chunks_mut(BLOCK)) {
            for (entry, &word) in entries.iter_mut().zip(words) {
                *entry = self.cells[(word & self.mask) as usize];
            }
            for ((index, &word), &entry) in out.iter_mut().zip(words).zip(&entries) {
                let keep = ((word >> 32) as u32) < (entry >> 32) as u32;
                *index = I::new(if keep { (word & self.mask) as u32 } else { entry as u32 });
            }
        }
    }

    /// The exact probability of every component, as integers that add up to `2^32` times the number of cells.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn masses(&self, n: usize) -> Result<Vec<u64>> {
        let mut mass = try_zeros(WHAT, n)?;
        for (cell, entry) in self.cells.iter().enumerate() {
            let threshold = entry >> 32;
            if threshold > 0 {
                mass[cell] += threshold;
            }
            mass[(entry & (COIN - 1)) as usize] += COIN - threshold;
        }
        Ok(mass)
    }

    #[cfg(test)]
    pub(crate) fn mutate(&mut self, change: impl Fn(usize, u64) -> u64) {
        for (cell, entry) in self.cells.iter_mut().enumerate() {
            *entry = change(cell, *entry);
        }
    }
}

/// `round(T cum_i / cum_n) - round(T cum_{i-1} / cum_n)` with `T` of `2^k >= n` cells: integers with the exact sum `T`,
/// zero for zeros and for the cells beyond `n`.
fn integer_masses(weights: &[f64]) -> Result<Option<Vec<u64>>> {
    let Some(last) = running_sums(weights).last().filter(|&last| last > 0.0) else { return Ok(None) };
    let mut masses = try_zeros(WHAT, weights.len().next_power_of_two())?;
    let total = masses.len() as u64 * COIN;
    let mut below = 0;
    for (mass, c) in masses.iter_mut().zip(running_sums(weights)) {
        // a cast rounds down
        let upper = ((total as f64 * (c / last) + 0.5) as u64).min(total);
        *mass = upper - below;
        below = upper;
    }
    Ok(Some(masses))
}

/// Running sums of the magnitudes, from left to right.
pub(super) fn running_sums(weights: &[f64]) -> impl Iterator<Item = f64> {
    weights.iter().scan(0.0, |sum, w| {
        *sum += w.abs();
        Some(*sum)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masses_are_those_asked_for_and_zeros_have_none() {
        for weights in [
            vec![1.0],
            vec![0.0, 2.0],
            vec![3.0, -1.0, 0.5, 0.0, 2.0],
            vec![1e-300, 1e300, 0.0],
            vec![5e-324, 1e-323],
            (1..=300).map(|i| 1.0 / f64::from(i)).collect(),
        ] {
            let cells = weights.len().next_power_of_two() as u64;
            let wanted = &integer_masses(&weights).unwrap().unwrap()[..weights.len()];
            let table = AliasTable::new(&weights).unwrap().unwrap();
            assert_eq!(table.masses(weights.len()).unwrap(), wanted);
            assert_eq!(wanted.iter().sum::<u64>(), cells * COIN);
            let total: f64 = weights.iter().map(|w| w.abs()).sum();
            for (w, m) in weights.iter().zip(wanted) {
                let p = w.abs() / total;
                assert!((*m as f64 / (cells * COIN) as f64 - p).abs() <= 1e-9 / cells as f64 + 1e-15);
                assert!(*w != 0.0 || *m == 0);
            }
        }
    }

    #[test]
    fn many_words_at_once_give_the_indices_of_one_at_a_time() {
        for n in [1, 2, 3, 10, 16, 17, 100, 256, 257, 1000, 70_000] {
            let weights: Vec<f64> =
                (0..n).map(|i| if i % 5 == 4 { 0.0 } else { 1.0 + (37 * i % 101) as f64 }).collect();
            let table = AliasTable::new(&weights).unwrap().unwrap();
            let mut words = vec![0; 1000];
            crate::stream::Key([n as u8; 32]).lanes(n, 0).fill(&mut words);
            // the coin's edges: equal to a threshold, one below it, and the ends of its range
            for (at, word) in words.iter_mut().enumerate().take(200) {
                let threshold = table.cells[(*word & table.mask) as usize] >> 32;
                let coin = [threshold, threshold.saturating_sub(1), 0, COIN - 1, 1 << 31][at % 5];
                *word = coin << 32 | (*word & (COIN - 1));
            }
            for len in [0, 1, 7, 8, 31, 32, 33, 71, 999, 1000] {
                check::<u32>(&table, &words[..len]);
                if n <= 1 << 16 {
                    check::<u16>(&table, &words[..len]);
                }
                if n <= 1 << 8 {
                    check::<u8>(&table, &words[..len]);
                }
            }
        }
    }

    fn check<I: Index + PartialEq + std::fmt::Debug>(table: &AliasTable, words: &[u64]) {
        let expected: Vec<I> = words.iter().map(|&word| I::new(table.draw(word))).collect();
        let (mut any, mut portable) = (vec![I::default(); words.len()], vec![I::default(); words.len()]);
        table.draw_all(words, &mut any);
        table.draw_all_portable(words, &mut portable);
        assert_eq!(any, expected);
        assert_eq!(portable, expected);
    }

    #[test]
    fn all_zero_has_no_table() {
        assert!(AliasTable::new(&[0.0, -0.0]).unwrap().is_none());
    }
}
