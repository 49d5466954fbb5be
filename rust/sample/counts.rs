//! Counts without realizations: all that a uniform average needs.
//!
//! The counts of `N` independent draws of a line are multinomial; conditional binomials give them in `O(length)` for any
//! `N`. Equal in distribution to the counts of a sample, not equal draw by draw.

use rand::Rng;
use rand::distr::Distribution;
use rand_distr::Binomial;

use super::law::Law;
use crate::error::{Error, Result};
use crate::parallel::Stop;
use crate::stream::{Key, Purpose};

/// The largest number of realizations: beyond it, doubles no longer count by one.
const MAX_SIZE: u64 = 1 << 53;

/// One multinomial draw per line: `counts[j * length + i]` realizations out of `size` hit entry `i` of line `j`.
///
/// # Errors
/// [`Error::Value`] if `size` is above `2^53`; [`Error::Interrupted`] after a stop.
pub fn multinomial_counts(law: &Law, size: u64, key: &Key, stop: &Stop) -> Result<Vec<u64>> {
    if size > MAX_SIZE {
        return Err(Error::Value { name: "size", expected: "at most 2^53", found: size.to_string() });
    }
    let mut counts = Vec::with_capacity(law.values().len());
    for j in 0..law.lines() {
        stop.check()?;
        let mut rng = key.stream(Purpose::Counts, j);
        counts.extend(line_counts(law.line(j), law.gamma()[j], size, &mut rng)?);
    }
    Ok(counts)
}

/// One multinomial draw of a line with 1-norm `gamma`: `size` in total, or nothing in a zero line.
pub(crate) fn line_counts(line: &[f64], gamma: f64, size: u64, rng: &mut impl Rng) -> Result<Vec<u64>> {
    let mut counts = vec![0; line.len()];
    deal(&chances(line, gamma), size, rng, |i, count| counts[i] = count)?;
    Ok(counts)
}

/// `|w_i| / (|w_i| + ... + |w_n|)`: the chance of entry `i` for a realization that no entry before it took; 0 in a zero line.
pub(crate) fn chances(line: &[f64], gamma: f64) -> Vec<f64> {
    // tail = (|w_i| + ... + |w_n|) / g: at the last nonzero entry the chance is exactly one
    let mut tail = 0.0;
    let mut chances: Vec<f64> = line
        .iter()
        .rev()
        .map(|w| {
            if *w == 0.0 {
                return 0.0;
            }
            tail += w.abs() / gamma;
            (w.abs() / gamma / tail).min(1.0)
        })
        .collect();
    chances.reverse();
    chances
}

/// Deals `size` realizations out to the entries of a line; `visit(i, count)` sees every entry that got some.
pub(crate) fn deal(chances: &[f64], size: u64, rng: &mut impl Rng, mut visit: impl FnMut(usize, u64)) -> Result<()> {
    let mut left = size;
    for (i, &p) in chances.iter().enumerate().filter(|(_, p)| **p > 0.0) {
        if left == 0 {
            break;
        }
        let binomial = Binomial::new(left, p);
        let count = binomial.map_err(|e| Error::Numerical(format!("binomial({left}, {p}): {e}")))?.sample(rng);
        left -= count;
        if count > 0 {
            visit(i, count);
        }
    }
    Ok(())
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

    #[test]
    fn extreme_probabilities_end_quickly_and_exactly() {
        let law = Law::new(vec![1.0, 3.1444753148558566e-10, 5e-324], 1, 3).unwrap();
        for seed in 0..200 {
            let counts = multinomial_counts(&law, 16_000_000, &Key([seed; 32]), &Stop::new()).unwrap();
            assert_eq!(counts.iter().sum::<u64>(), 16_000_000);
        }
    }
}
