//! Sifting: with far more realizations than dimensions, a subset already holds an optimal set of weights.
//!
//! The first `4 d` realizations, and enough others that every entry hit at all is hit in the subset, are solved and
//! certified on all with one gather. The realizations that violate optimality most join the subset, which is solved
//! again. After a few rounds, or if the subset grows to half of all, the caller solves without sifting.

use super::budget::Budget;
use super::problem::SEARCH;
use super::run_sequence::run_sequence;
use super::semismooth::{Setting, gap_and_values};
use super::task::{Found, Task};
use crate::error::Result;
use crate::memory::{try_collect, try_extend, try_zeros};

/// Realizations per dimension from which sifting is faster.
const WORTH: usize = 6;
/// Realizations per dimension in the first subset.
const FIRST: usize = 4;
/// Hits that every entry must have in the subset (or all, if there are fewer).
const COPIES: f64 = 4.0;
const ROUNDS: usize = 8;

/// Weights of all realizations, found on a subset; `None` if sifting does not apply or does not succeed.
pub(crate) fn sift(task: &Task, budget: &mut Budget) -> Result<Option<Found>> {
    let n = task.op.size();
    let dimension = task.relaxed.dimension;
    if n <= WORTH * dimension || n < 100 {
        return Ok(None);
    }
    let mut keep = task.op.covering((FIRST * dimension).max(32), COPIES, &task.relaxed.counts)?;
    let set = Setting::of(task);
    let mut warm: Option<Vec<f64>> = None;
    for _ in 0..ROUNDS {
        if keep.len() > n / 2 || budget.exhausted() {
            return Ok(None);
        }
        let sub = task.op.subset(&keep)?;
        let small = Task { op: &*sub, ..*task };
        let mut found = run_sequence(&small, warm.as_deref(), budget)?;
        let mut weights = try_zeros(SEARCH, n)?;
        for (&i, w) in keep.iter().zip(&found.weights) {
            weights[i] = *w;
        }
        let (gap, values) = gap_and_values(&set, &weights, budget)?;
        if gap <= task.tol {
            found.weights = weights;
            return Ok(Some(found));
        }
        // Worst violators first; <r, E_i> below the smallest value in the subset.
        let level = keep.iter().map(|&i| values[i]).fold(f64::INFINITY, f64::min);
        let mut worse: Vec<usize> = try_collect(SEARCH, (0..n).filter(|&i| values[i] < level))?;
        if worse.is_empty() {
            return Ok(None);
        }
        worse.sort_unstable_by(|&a, &b| values[a].total_cmp(&values[b]).then(a.cmp(&b))); // in place
        worse.truncate(dimension.max(8));
        try_extend(SEARCH, &mut keep, worse)?;
        keep.sort_unstable();
        keep.dedup();
        warm = Some(try_collect(SEARCH, keep.iter().map(|&i| weights[i]))?);
    }
    Ok(None)
}
