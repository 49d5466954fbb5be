//! Kernels for wider registers than the baseline wheel may assume, and their selection at run time.
//!
//! They do the same integer operations as the portable loops of [`crate::stream`] and [`crate::sample::AliasTable`], so
//! words and indices are the same on every processor; and the same products and sums, in the same order, as
//! [`crate::control`]. Tests in these modules compare them.

use std::arch::is_x86_feature_detected;

use super::{LANES, avx2, avx512};

/// Fills `steps` and returns true, or returns false where the processor has no AVX2.
pub(crate) fn fill(state: &mut [[u64; LANES]; 4], steps: &mut [[u64; LANES]]) -> bool {
    if is_x86_feature_detected!("avx512f") {
        // SAFETY: the processor has the instructions.
        unsafe { avx512::fill(state, steps) };
    } else if is_x86_feature_detected!("avx2") {
        // SAFETY: as above.
        unsafe { avx2::fill(state, steps) };
    } else {
        return false;
    }
    true
}

/// One index per word, from a table of `2^k` cells `threshold << 32 | alias`; returns how many are done: none without
/// AVX2, otherwise all but fewer than eight.
pub(crate) fn lookup<I: Copy>(cells: &[u64], words: &[u64], out: &mut [I], index: impl Fn(u32) -> I + Copy) -> usize {
    if !is_x86_feature_detected!("avx2") {
        return 0;
    }
    let done = if cells.len() <= avx512::IN_REGISTERS && is_x86_feature_detected!("avx512f") {
        // SAFETY: the processor has the instructions.
        unsafe { avx512::lookup_in_registers(cells, words, out, index) }
    } else if cells.len() <= avx2::IN_REGISTERS {
        // SAFETY: as above.
        unsafe { avx2::lookup_in_registers(cells, words, out, index) }
    } else {
        0
    };
    // SAFETY: as above.
    done + unsafe { avx2::lookup(cells, &words[done..], &mut out[done..], index) }
}

/// `y -= A x` for rows of `4 (FOURS - 1) < n <= 4 FOURS` entries, four rows at a time; returns how many are done: none
/// without AVX2, otherwise all but fewer than four. `x` is laid out as the entries of a row are read: groups of four,
/// then the last four, with zeros for those that are also in a group.
#[inline(always)]
pub(crate) fn subtract_short<const FOURS: usize>(a: &[f64], n: usize, x: &[[f64; 4]; FOURS], y: &mut [f64]) -> usize {
    if !is_x86_feature_detected!("avx2") {
        return 0;
    }
    // SAFETY: the processor has the instructions.
    unsafe { avx2::subtract_short(a, n, x, y) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Key;

    /// The AVX2 kernels are called by name, since a processor with AVX-512 would use others.
    #[test]
    fn every_width_gives_the_same_words_and_indices() {
        if !is_x86_feature_detected!("avx2") {
            return; // the portable loops have their own tests
        }
        let mut lanes = Key([5; 32]).lanes(0, 0);
        let state: [[u64; LANES]; 4] = std::array::from_fn(|_| lanes.step());
        let (mut wide, mut other) = (state, state);
        let (mut steps, mut others) = ([[0; LANES]; 64], [[0; LANES]; 64]);
        assert!(fill(&mut wide, &mut steps));
        // SAFETY: the processor has the instructions.
        unsafe { avx2::fill(&mut other, &mut others) };
        assert_eq!((wide, steps), (other, others));

        let words = steps.as_flattened();
        for bits in [0, 1, 3, 4, 5, 6, 9] {
            let cells: Vec<u64> =
                (0..1u64 << bits).map(|c| words[c as usize] >> 32 << 32 | (c * 7 % (1 << bits))).collect();
            let expected: Vec<u16> = words
                .iter()
                .map(|&word| {
                    let cell = word & (cells.len() as u64 - 1);
                    let entry = cells[cell as usize];
                    if word >> 32 < entry >> 32 { cell as u16 } else { entry as u16 }
                })
                .collect();
            let mut out = vec![0u16; words.len()];
            assert_eq!(lookup(&cells, words, &mut out, |i| i as u16), words.len());
            assert_eq!(out, expected);
            let mut out = vec![0u16; words.len()];
            // SAFETY: as above.
            assert_eq!(unsafe { avx2::lookup(&cells, words, &mut out, |i| i as u16) }, words.len());
            assert_eq!(out, expected);
            if cells.len() <= avx2::IN_REGISTERS {
                let mut out = vec![0u16; words.len()];
                // SAFETY: as above.
                assert_eq!(unsafe { avx2::lookup_in_registers(&cells, words, &mut out, |i| i as u16) }, words.len());
                assert_eq!(out, expected);
            }
        }
    }
}
