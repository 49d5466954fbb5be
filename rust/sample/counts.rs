//! Counts without realizations, for uniform averages.
//!
//! The counts of `N` independent draws of a line are multinomial; conditional binomials give them in `O(length)` for
//! any `N`. Equal in distribution to the counts of a sample, not equal draw by draw.

use rand::Rng;
use rand::distr::Distribution;
use rand_distr::{Binomial, Poisson};

use super::law::Law;
use crate::error::{Error, Result};
use crate::memory::{try_collect, try_extend, try_room, try_zeros};
use crate::parallel::Stop;
use crate::stream::{Key, Purpose};

/// Largest number of realizations: doubles represent all integers up to here.
const MAX_SIZE: u64 = 1 << 53;

const WHAT: &str = "the counts of a sample";

/// Below this, `1 - p` may have a relative error above `2^-27`.
const FEW_DIGITS: f64 = 1.0 / (1u64 << 26) as f64;

/// From this number of trials on, rounding of `1 - p` may give `(1 - p)^N` a relative error of `2^-13`.
const MANY: u64 = 1 << 40;

/// One multinomial draw per line: `counts[j * length + i]` realizations out of `size` hit entry `i` of line `j`.
///
/// # Errors
/// [`Error::Value`] if `size` is above `2^53`; [`Error::Interrupted`] after a stop.
pub fn multinomial_counts(law: &Law, size: u64, key: &Key, stop: &Stop) -> Result<Vec<u64>> {
    if size > MAX_SIZE {
        return Err(Error::Value { name: "size", expected: "at most 2^53", found: size.to_string() });
    }
    let mut counts = try_room(WHAT, law.values().len())?;
    for j in 0..law.lines() {
        stop.check()?;
        let mut rng = key.stream(Purpose::Counts, j);
        let line = line_counts(law.line(j), law.gamma()[j], size, &mut rng)?;
        try_extend(WHAT, &mut counts, line)?;
    }
    Ok(counts)
}

/// One multinomial draw of a line with 1-norm `gamma`: `size` in total, or nothing in a zero line.
pub(crate) fn line_counts(line: &[f64], gamma: f64, size: u64, rng: &mut impl Rng) -> Result<Vec<u64>> {
    let mut counts = try_zeros(WHAT, line.len())?;
    deal(&chances(line, gamma)?, size, rng, |i, count| counts[i] = count)?;
    Ok(counts)
}

/// The probabilities of one entry, for a realization that hit no entry before it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Chance {
    /// Of hitting this entry: `|w_i| / (|w_i| + ... + |w_n|)`, 0 in a zero line.
    taken: f64,
    /// Of hitting a later one: `(|w_{i+1}| + ... + |w_n|) / (|w_i| + ... + |w_n|)`, 0 at the last nonzero entry.
    left: f64,
}

/// The probabilities of the entries of a line with 1-norm `gamma`.
pub(crate) fn chances(line: &[f64], gamma: f64) -> Result<Vec<Chance>> {
    // tail = (|w_i| + ... + |w_n|) / g, added from the end: small tails keep all their digits
    let mut rest = 0.0;
    let from_the_end = line.iter().rev().map(|w| {
        if *w == 0.0 {
            return Chance { taken: 0.0, left: 1.0 };
        }
        let tail = rest + w.abs() / gamma;
        let chance = Chance { taken: (w.abs() / gamma / tail).min(1.0), left: rest / tail };
        rest = tail;
        chance
    });
    let mut chances = try_collect(WHAT, from_the_end)?;
    chances.reverse();
    Ok(chances)
}

/// Distributes `size` realizations over the entries of a line; `visit(i, count)` is called for the entries that get
/// some.
pub(crate) fn deal(chances: &[Chance], size: u64, rng: &mut impl Rng, mut visit: impl FnMut(usize, u64)) -> Result<()> {
    let mut left = size;
    for (i, chance) in chances.iter().enumerate().filter(|(_, chance)| chance.taken > 0.0) {
        if left == 0 {
            break;
        }
        // 1 - taken would have few digits or none
        let count = if chance.left < FEW_DIGITS {
            left - binomial(left, chance.left, rng)?
        } else {
            binomial(left, chance.taken, rng)?
        };
        left -= count;
        if count > 0 {
            visit(i, count);
        }
    }
    Ok(())
}

/// Successes in `trials` of probability `p` each.
pub(crate) fn binomial(trials: u64, p: f64, rng: &mut impl Rng) -> Result<u64> {
    let mean = trials as f64 * p;
    if trials >= MANY && mean > 0.0 && mean < 10.0 {
        // `Binomial` inverts the distribution with a rounded 1 - p; the total variation distance to Poisson is at most
        // p < 1e-11
        let law = Poisson::new(mean).map_err(|e| Error::Numerical(format!("poisson({mean}): {e}")))?;
        return Ok((law.sample(rng) as u64).min(trials));
    }
    let law = Binomial::new(trials, p).map_err(|e| Error::Numerical(format!("binomial({trials}, {p}): {e}")))?;
    Ok(law.sample(rng))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_add_up_and_zeros_stay_zero() {
        let law = Law::new(vec![3.0, -1.0, 0.5, 0.0, 2.0, 0.0, 0.0, 0.0], 2, 4).unwrap();
        for size in [0, 1, 10, 1 << 31, 1_000_000_000_000, MAX_SIZE] {
            for seed in 0..50 {
                let counts = multinomial_counts(&law, size, &Key([seed; 32]), &Stop::new()).unwrap();
                assert_eq!(counts[..4].iter().sum::<u64>(), size);
                assert_eq!(counts[3], 0);
                assert_eq!(counts[4], size, "the only nonzero entry gets everything");
            }
        }
    }

    /// `N q` hits are expected where `1 - q` rounds to one: a sum of 2000 counts is normal, `|z| < 5.6` (false alarm
    /// 2e-8). With `1 - p` in place of `q` there are none, or twice as many.
    #[test]
    fn an_entry_too_small_to_change_the_sum_has_its_probability() {
        for (values, q, at) in [
            (vec![1.0, 1e-16], 1e-16, 1),
            (vec![1.0, 0.0, 1.6e-16, 0.0], 1.6e-16, 2),
            (vec![1e-16, 1.0], 1e-16, 0),
            (vec![0.5, 0.5, 1e-16], 1e-16, 2),
        ] {
            let law = Law::new(values.clone(), 1, values.len()).unwrap();
            let mut hits = 0;
            for seed in 0..2000u64 {
                let mut key = [0; 32];
                key[..8].copy_from_slice(&seed.to_le_bytes());
                let counts = multinomial_counts(&law, MAX_SIZE, &Key(key), &Stop::new()).unwrap();
                assert_eq!(counts.iter().sum::<u64>(), MAX_SIZE);
                hits += counts[at];
            }
            let mean = 2000.0 * MAX_SIZE as f64 * q;
            assert!((hits as f64 - mean).abs() < 5.6 * mean.sqrt(), "{values:?}: {hits} hits, {mean} expected");
        }
    }

    #[test]
    fn extreme_probabilities_end_quickly_and_exactly() {
        let law = Law::new(vec![1.0, 3.1444753148558566e-10, 5e-324], 1, 3).unwrap();
        for seed in 0..200 {
            let counts = multinomial_counts(&law, 16_000_000, &Key([seed; 32]), &Stop::new()).unwrap();
            assert_eq!(counts.iter().sum::<u64>(), 16_000_000);
        }
    }
}
