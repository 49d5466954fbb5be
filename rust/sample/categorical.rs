//! The alias table: one index from one 64-bit word, with probabilities that are exact integers.
//!
//! Walker's alias method with Vose's construction on `2^k >= n` cells. The mass of a component is an integer out of
//! `T = 2^k 2^32`, so the construction has no rounding, a zero component has mass zero and can never come out, and the
//! distribution is known exactly: it differs from `|w| / ||w||_1` by at most `1/T` per component plus the rounding of the
//! cumulative sums.

/// The coin's range: a cell is split between itself and its alias in units of `2^-32`.
const COIN: u64 = 1 << 32;

/// A categorical distribution over the components of one line.
#[derive(Debug, Clone, PartialEq)]
pub struct AliasTable {
    mask: u64,
    /// `threshold << 32 | alias`
    cells: Vec<u64>,
}

impl AliasTable {
    /// The table for probabilities proportional to `|weights|`; `None` when they are all zero.
    ///
    /// The weights must be finite and their sum of magnitudes too (a [`super::Law`] has checked that).
    pub fn new(weights: &[f64]) -> Option<Self> {
        let cells = weights.len().next_power_of_two();
        let mut mass = integer_masses(weights, cells as u64 * COIN)?;
        mass.resize(cells, 0);
        let mut table = vec![0u64; cells];
        let (mut small, mut large): (Vec<usize>, Vec<usize>) = (0..cells).partition(|&i| mass[i] < COIN);
        // The masses add up to cells * COIN: while a cell is below COIN, another is above.
        while let (Some(s), Some(&l)) = (small.pop(), large.last()) {
            table[s] = mass[s] << 32 | l as u64;
            mass[l] -= COIN - mass[s];
            if mass[l] < COIN {
                large.pop();
                small.push(l);
            }
        }
        for l in large {
            table[l] = l as u64; // a full cell is its own alias, whatever the coin says
        }
        Some(Self { mask: cells as u64 - 1, cells: table })
    }

    /// The index for one uniform word: its low bits choose the cell, its high half is the coin.
    #[inline(always)]
    pub fn draw(&self, word: u64) -> u32 {
        let cell = word & self.mask;
        let entry = self.cells[cell as usize];
        // a coin: the branch predictor would lose half of the tosses
        std::hint::select_unpredictable(word >> 32 < entry >> 32, cell as u32, entry as u32)
    }

    /// The exact probability of every component, as integers that add up to `2^32` times the number of cells.
    pub fn masses(&self, n: usize) -> Vec<u64> {
        let mut mass = vec![0u64; n];
        for (cell, entry) in self.cells.iter().enumerate() {
            let threshold = entry >> 32;
            if threshold > 0 {
                mass[cell] += threshold;
            }
            mass[(entry & (COIN - 1)) as usize] += COIN - threshold;
        }
        mass
    }

    #[cfg(test)]
    pub(crate) fn mutate(&mut self, change: impl Fn(usize, u64) -> u64) {
        for (cell, entry) in self.cells.iter_mut().enumerate() {
            *entry = change(cell, *entry);
        }
    }
}

/// `round(T cum_i / cum_n) - round(T cum_{i-1} / cum_n)`: integer masses with the exact sum `T`, zero for zeros.
fn integer_masses(weights: &[f64], total: u64) -> Option<Vec<u64>> {
    let cumulative = cumulative(weights);
    let last = *cumulative.last().filter(|&&last| last > 0.0)?;
    let mut previous = 0;
    let round = |c: f64| (total as f64 * (c / last) + 0.5).floor() as u64;
    Some(
        cumulative
            .iter()
            .map(|&c| {
                let below = previous;
                previous = round(c).min(total);
                previous - below
            })
            .collect(),
    )
}

/// Running sums of the magnitudes, from left to right.
pub(super) fn cumulative(weights: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    weights
        .iter()
        .map(|w| {
            sum += w.abs();
            sum
        })
        .collect()
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
            let wanted = integer_masses(&weights, cells * COIN).unwrap();
            let table = AliasTable::new(&weights).unwrap();
            assert_eq!(table.masses(weights.len()), wanted);
            assert_eq!(wanted.iter().sum::<u64>(), cells * COIN);
            let total: f64 = weights.iter().map(|w| w.abs()).sum();
            for (w, m) in weights.iter().zip(&wanted) {
                let p = w.abs() / total;
                assert!((*m as f64 / (cells * COIN) as f64 - p).abs() <= 1e-9 / cells as f64 + 1e-15);
                assert!(*w != 0.0 || *m == 0);
            }
        }
    }

    #[test]
    fn all_zero_has_no_table() {
        assert!(AliasTable::new(&[0.0, -0.0]).is_none());
    }
}
