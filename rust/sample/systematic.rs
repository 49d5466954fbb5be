//! Systematic (stratified) sampling: one uniform offset per line.
//!
//! With `c_i = N (p_1 + ... + p_i)` and one `U ~ U[0, 1)`: `N_i = ceil(c_i - U) - ceil(c_{i-1} - U)`. Every count is
//! `floor(N p_i)` or `ceil(N p_i)`, they add up to `N`, and `E N_i = N p_i`. The realizations are these indices in
//! random order, independently per line, so that pairs of entities stay uncorrelated. Realizations of one sample are
//! dependent: results that need independence do not apply.

use rand::Rng;

use super::categorical::running_sums;
use super::law::Law;
use super::singletons::Index;
use crate::error::Result;
use crate::memory::try_zeros;
use crate::parallel::Stop;
use crate::stream::{Key, Purpose};

const WHAT: &str = "the counts of a systematic sample";

/// The counts of a systematic sample, line by line; a zero line has none.
///
/// # Errors
/// [`crate::Error::Memory`].
pub fn systematic_counts(law: &Law, size: u64, key: &Key) -> Result<Vec<u64>> {
    let mut counts = try_zeros(WHAT, law.values().len())?;
    for (j, counts) in counts.chunks_exact_mut(law.length()).enumerate() {
        let word = key.stream(Purpose::Offset, j).next_u64();
        line_systematic(law.line(j), size, word, |i, count| counts[i] = count);
    }
    Ok(counts)
}

/// Distributes `size` realizations over a line with the offset `U = word / 2^64`; `visit(i, count)` is called for every
/// entry.
pub(crate) fn line_systematic(line: &[f64], size: u64, word: u64, mut visit: impl FnMut(usize, u64)) {
    // 53 bits, as every uniform double in [0, 1)
    let offset = (word >> 11) as f64 * 2f64.powi(-53);
    let last = running_sums(line).last().unwrap_or(0.0);
    if last == 0.0 {
        return;
    }
    let mut below = 0u64;
    for (i, c) in running_sums(line).enumerate() {
        // c = last is exactly N, so that rounding does not change the total
        let c = if c == last { size } else { (size as f64 * (c / last) - offset).ceil() as u64 }.min(size);
        visit(i, c.saturating_sub(below));
        below = below.max(c);
    }
}

/// Realizations written between two checks for a stop; each may be on a new page of memory.
const BLOCK: usize = 1 << 14;

/// Fills `out` with these indices, shuffled per line (Fisher-Yates from the end).
pub(super) fn fill<I: Index>(law: &Law, key: &Key, out: &mut [I], size: usize, stop: &Stop) -> Result<()> {
    let counts = systematic_counts(law, size as u64, key)?;
    let mut order: Vec<I> = try_zeros("the order of a systematic sample", size)?;
    for (j, counts) in counts.chunks_exact(law.length()).enumerate() {
        stop.check()?;
        if law.gamma()[j] == 0.0 {
            for rows in out.chunks_mut(BLOCK * law.lines()) {
                stop.check()?;
                rows.iter_mut().skip(j).step_by(law.lines()).for_each(|to| *to = I::default());
            }
            continue;
        }
        let mut at = 0;
        for (i, &count) in counts.iter().enumerate() {
            let end = at + count as usize;
            for block in order[at..end].chunks_mut(1 << 20) {
                block.fill(I::new(i as u32));
                stop.check()?;
            }
            at = end;
        }
        let mut rng = key.stream(Purpose::Permutation, j);
        for i in (1..size).rev() {
            if i % (1 << 17) == 0 {
                stop.check()?;
            }
            // floor(word (i + 1) / 2^64): uniform on 0..=i up to 2^-64 (i + 1)
            let k = (u128::from(rng.next_u64()) * (i as u128 + 1)) >> 64;
            order.swap(i, k as usize);
        }
        for (rows, order) in out.chunks_mut(BLOCK * law.lines()).zip(order.chunks(BLOCK)) {
            stop.check()?;
            rows.iter_mut().skip(j).step_by(law.lines()).zip(order).for_each(|(to, &from)| *to = from);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_floor_or_ceil_and_add_up() {
        for (seed, size) in [(0, 1), (1, 7), (2, 50), (3, 1000), (4, 1_000_000_000_000)] {
            let w = vec![3.0, -1.0, 0.5, 0.0, 2.0];
            let law = Law::new(w.clone(), 1, 5).unwrap();
            let counts = systematic_counts(&law, size, &Key([seed; 32])).unwrap();
            assert_eq!(counts.iter().sum::<u64>(), size);
            for (w, &count) in w.iter().zip(&counts) {
                let expected = size as f64 * w.abs() / 6.5;
                // The product is rounded once: allow its last bit at a trillion.
                assert!((count as f64 - expected).abs() <= 1.0 + 1e-15 * size as f64, "{count} {expected}");
            }
        }
    }

    #[test]
    fn whole_expectations_are_met_exactly() {
        let law = Law::new(vec![3.0, -1.0, 0.5, 0.0, 2.0], 1, 5).unwrap();
        for seed in 0..20 {
            assert_eq!(systematic_counts(&law, 6500, &Key([seed; 32])).unwrap(), [3000, 1000, 500, 0, 2000]);
        }
    }
}
