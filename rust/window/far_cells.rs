//! Cells of a log that are far from all others of their column: codes of a missing value, or errors of reading.
//!
//! The tests of residuals do not see them: one such cell spoils their scale, and the rows that fill windows have none.

use crate::error::Result;
use crate::identify::Test;
use crate::memory::{try_collect, try_extend};

use super::log_tests::Log;

const WHAT: &str = "cells of a log";
/// How far a cell is from the median, over the farthest of the others: of codes, and of readings.
const CODE: f64 = 2.0;
const READING: f64 = 10.0;
/// One of so many cells of a column may be far.
const ONE_OF: usize = 100;

/// What stands for a missing value: 999 to 99999999 with both signs, the ends of whole numbers, and 1e30.
fn code(v: f64) -> bool {
    (3..9).any(|k| v.abs() == 10_f64.powi(k) - 1.0) || [32767.0, -32768.0, 65535.0, 1e30].contains(&v)
}

fn median(values: impl Iterator<Item = f64>) -> Result<f64> {
    let mut sorted = try_collect(WHAT, values)?;
    sorted.sort_unstable_by(f64::total_cmp);
    let half = sorted.len() / 2;
    Ok(if sorted.len() % 2 == 1 { sorted[half] } else { 0.5 * (sorted[half - 1] + sorted[half]) })
}

/// The pairs of these cells as the test "spikes", with the column of each; None where there are none.
pub(super) fn far_cells(log: &Log<'_>) -> Result<Option<Test>> {
    let (n, m, size) = (log.n, log.m, log.size());
    let (mut found, mut pulses) = (Vec::new(), false);
    for j in (0..if size > 1 { n + m } else { 0 }).rev() {
        // inputs first: a reading may follow a pulse
        let cell = |t: usize| log.pairs[t * (2 * n + m) + j];
        let middle = median((0..size).map(cell))?;
        let away = |t: usize| (cell(t) - middle).abs();
        let mut largest = try_collect(WHAT, (0..size).map(away))?;
        largest.sort_unstable_by(|a, b| b.total_cmp(a));
        for pair in largest[..(1 + (size / ONE_OF).max(1)).min(size)].windows(2) {
            let at = try_collect(WHAT, (0..size).filter(|t| away(*t) >= pair[0]))?;
            let coded = code(cell(at[0])) && at.iter().all(|t| cell(*t) == cell(at[0]));
            if pair[0] <= if coded { CODE } else { READING } * pair[1] {
                continue;
            }
            let begins = at.iter().any(|t| log.places[*t] == 0) || pair[1] == 0.0;
            if coded || (j < n && !begins && !pulses) {
                try_extend(WHAT, &mut found, at.into_iter().map(|t| (t, j)))?;
            }
            pulses |= j >= n;
            break;
        }
    }
    found.sort_unstable();
    let share = found.len() as f64 / size as f64;
    let at = try_collect(WHAT, found.iter().map(|(t, _)| *t))?;
    let each = try_collect(WHAT, found.iter().map(|(_, j)| *j as f64))?;
    Ok((!at.is_empty()).then_some(Test { name: "spikes", p_value: 0.0, share, at, each }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of one reading and one input, 50 pairs.
    fn found(cells: &[(usize, usize, f64)]) -> Option<(Vec<usize>, Vec<f64>)> {
        let places: Vec<usize> = (0..50).collect();
        let mut pairs: Vec<f64> = (0..150).map(|at| ((at * at + at) as f64).sin()).collect();
        cells.iter().for_each(|(t, j, v)| pairs[3 * t + j] = *v);
        let log = Log { pairs: &pairs, places: &places, runs: &[0; 50], n: 1, m: 1 };
        far_cells(&log).unwrap().map(|test| (test.at, test.each))
    }

    #[test]
    fn codes_and_readings_but_no_pulses() {
        assert_eq!(found(&[]), None);
        assert_eq!(found(&[(7, 0, 999.0)]), Some((vec![7], vec![0.0])));
        assert_eq!(found(&[(7, 0, 50.0)]), Some((vec![7], vec![0.0])));
        assert_eq!(found(&[(7, 0, 5.0)]), None); // not far
        assert_eq!(found(&[(0, 0, 50.0)]), None); // where a piece begins
        assert_eq!(found(&[(7, 1, 50.0)]), None); // a pulse of an input
        assert_eq!(found(&[(7, 1, 50.0), (9, 0, 50.0)]), None); // and what follows it
        assert_eq!(found(&[(7, 1, -999.0), (9, 0, 999.0)]), Some((vec![7, 9], vec![1.0, 0.0])));
        assert_eq!(found(&[(7, 0, 999.0), (9, 0, 1500.0)]), None); // two of fifty
    }
}
