//! ALSE line by line: the corrected Lemma 4.4, for any target.
//!
//! A realization of a line (a vector, or one column of a matrix with its own weights) has one nonzero entry, so only
//! the total weight `Y_k` of every component matters:
//!
//! `J = g^2 sum_{k seen} (Y_k - tau_k)^2 + sum_{k unseen} t_k^2`, `tau_k = sign(w_k) t_k / g`,
//!
//! and the minimiser is the Euclidean projection of `tau` (on the components seen) onto the simplex. For `t = w` this
//! is a constant upward shift, `Y_k = |w_k| / g + delta / #seen`, with `delta` the probability of the components not
//! seen. (The paper's `Y_k = |w_k|` is not feasible.) Realizations that hit the same component share its total equally.
//! If each line of a matrix has its own weights, `J` is the sum over the lines, which are solved separately.

use std::ops::Range;

use super::simplex::{nonnegative, project};
use super::{Weights, distance, power_of_two_scale};
use crate::error::Result;
use crate::memory::{try_collect, try_extend, try_room, try_zeros};
use crate::parallel::Stop;
use crate::sample::{Index as _, Law, Singletons, with_indices};

const WHAT: &str = "a fit";

/// The solution of the least-squares problem of every line.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct ClosedForm {
    /// One weight per realization and line, realization by realization.
    pub weights: Vec<f64>,
    /// `sum_i w_ij E_i` in line `j`.
    pub estimate: Vec<f64>,
    /// `||estimate - t||_2`.
    pub error: f64,
    /// The squared error.
    pub objective: f64,
    /// The Frank-Wolfe gap of the squared error, recomputed from the data: the sum over the lines.
    pub gap: Gap,
    /// Entries of the target that are not zero and that no realization hits.
    pub unseen: usize,
}

/// Solves `min ||sum_i w_ij E_ij - t_j||_2` for every line `j`, each with weights of its own.
///
/// The target must have as many entries as the law.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop, [`crate::Error::Memory`] if the weights do not fit.
pub fn closed_form(draws: &Singletons, target: &[f64], set: Weights, stop: &Stop) -> Result<ClosedForm> {
    let law = draws.law();
    let (lines, length) = (law.lines(), law.length());
    let counts = draws.counts(stop)?;
    let totals = totals(law, &counts, target, set)?;
    let equal = |(total, &count): (&f64, &u64)| if count > 0 { total / count as f64 } else { 0.0 };
    let share = try_collect(WHAT, totals.iter().zip(&counts).map(equal))?;
    let mut weights = try_zeros("the weights", draws.size() * lines)?;
    let chunk = ((1 << 16) / lines).max(1) * lines; // whole realizations
    with_indices!(&**draws.indices(), indices => {
        for (weights, indices) in weights.chunks_mut(chunk).zip(indices.chunks(chunk)) {
            stop.check()?;
            if lines == 1 {
                weights.iter_mut().zip(indices).for_each(|(w, r)| *w = share[r.get()]);
                continue;
            }
            for (weights, indices) in weights.chunks_mut(lines).zip(indices.chunks(lines)) {
                let shares = share.chunks(length);
                weights.iter_mut().zip(indices).zip(shares).for_each(|((w, r), share)| *w = share[r.get()]);
            }
        }
    });
    let estimate = estimate(law, &totals)?;
    let error = distance(&estimate, target);
    Ok(ClosedForm {
        weights,
        gap: gap(law, &counts, &totals, &estimate, target, set)?,
        objective: error * error,
        error,
        estimate,
        unseen: by_line(law)
            .map(|(g, k)| k.filter(|&k| target[k] != 0.0 && (counts[k] == 0 || g == 0.0)).count())
            .sum(),
    })
}

/// The entries of every line.
fn by_line(law: &Law) -> impl Iterator<Item = (f64, Range<usize>)> {
    let length = law.length();
    law.gamma().iter().enumerate().map(move |(j, &g)| (g, j * length..(j + 1) * length))
}

/// `Y`: the total weight of every component of every line, zero where nothing was seen.
pub(super) fn totals(law: &Law, counts: &[u64], target: &[f64], set: Weights) -> Result<Vec<f64>> {
    let signs = law.signs()?;
    let mut totals = try_room(WHAT, counts.len())?;
    for (g, k) in by_line(law) {
        let line = line_totals(g, &signs[k.clone()], &counts[k.clone()], &target[k], set)?;
        try_extend(WHAT, &mut totals, line)?;
    }
    Ok(totals)
}

fn line_totals(g: f64, signs: &[f64], counts: &[u64], target: &[f64], set: Weights) -> Result<Vec<f64>> {
    let size: u64 = counts.iter().sum();
    if g == 0.0 {
        // every realization is zero: all weights are optimal, the uniform ones have the smallest norm
        return try_collect(WHAT, counts.iter().map(|&count| count as f64 / size.max(1) as f64));
    }
    let seen = try_collect(WHAT, (0..counts.len()).filter(|&k| counts[k] > 0))?;
    let tau: Vec<f64> = try_collect(WHAT, seen.iter().map(|&k| (signs[k] * (target[k] / g)).clamp(-1e300, 1e300)))?;
    let clipped: f64 = tau.iter().map(|t| t.max(0.0)).sum();
    let projected = match set {
        Weights::Subsimplex if clipped <= 1.0 => try_collect(WHAT, tau.iter().map(|t| t.max(0.0)))?,
        _ => project_on_simplex(&tau)?,
    };
    let mut totals = try_zeros(WHAT, counts.len())?;
    for (&k, y) in seen.iter().zip(projected) {
        totals[k] = y;
    }
    Ok(totals)
}

/// `sum_i w_ij E_i` from the totals.
pub(super) fn estimate(law: &Law, totals: &[f64]) -> Result<Vec<f64>> {
    let mut sum = law.atoms()?;
    sum.iter_mut().zip(totals).for_each(|(sum, total)| *sum *= total);
    Ok(sum)
}

/// The gap of a squared error, absolute and relative to the squared target (to a squared realization if that is zero).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// `max_v <f'(w), w - v>`; overflows or vanishes where squares of the data do.
    pub absolute: f64,
    /// The same over `||t||^2`, computed in units in which squares are representable.
    pub relative: f64,
}

/// `max_v <f'(w), w - v>` over the vertices `v` of the weight set, `f'_i = 2 <E_i, sum w E - t>`; a sum over the lines,
/// each with its own vertex.
pub(super) fn gap(
    law: &Law,
    counts: &[u64],
    totals: &[f64],
    estimate: &[f64],
    target: &[f64],
    set: Weights,
) -> Result<Gap> {
    let scale = power_of_two_scale(law.gamma().iter().chain(target));
    let atoms = law.atoms()?;
    let gradient = |k: usize| 2.0 * (atoms[k] / scale) * ((estimate[k] - target[k]) / scale);
    let mut gap = 0.0;
    for (_, line) in by_line(law) {
        let mut smallest = if set == Weights::Subsimplex { 0.0 } else { f64::INFINITY };
        let mut at_solution = 0.0;
        for k in line.filter(|&k| counts[k] > 0) {
            smallest = gradient(k).min(smallest);
            at_solution += totals[k] * gradient(k);
        }
        gap += if smallest == f64::INFINITY { 0.0 } else { nonnegative(at_solution - smallest) };
    }
    let square = |values: &[f64]| values.iter().map(|v| (v / scale).powi(2)).sum::<f64>();
    let zero = target.iter().all(|t| *t == 0.0);
    let reference = square(if zero { law.gamma() } else { target });
    Ok(Gap { absolute: gap * scale * scale, relative: if gap > 0.0 { gap / reference } else { 0.0 } })
}

/// The Euclidean projection on `{y >= 0, sum y = 1}`.
///
/// # Errors
/// [`crate::Error::Memory`].
pub fn project_on_simplex(tau: &[f64]) -> Result<Vec<f64>> {
    let mut y: Vec<f64> = try_collect(WHAT, tau.iter().copied())?;
    project(&mut y)?;
    Ok(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Indices, Law};
    use std::sync::Arc;

    fn draws(w: &[f64], indices: &[u8]) -> Singletons {
        let law = Arc::new(Law::new(w.to_vec(), 1, w.len()).unwrap());
        Singletons::new(law, Indices::U8(indices.to_vec()), indices.len()).unwrap()
    }

    #[test]
    fn the_papers_weights_are_corrected() {
        // w = (3, 4), both seen: the paper's alpha = |w_k| sums to 7; the solution is |w_k| / gamma.
        let fit = closed_form(&draws(&[3.0, 4.0], &[0, 1]), &[3.0, 4.0], Weights::Simplex, &Stop::new()).unwrap();
        assert!((fit.weights[0] - 3.0 / 7.0).abs() < 1e-15 && fit.error < 1e-15);
        // w = (1, 1), one realization: the simplex minimum is 2, the sub-simplex minimum 1.
        let one = draws(&[1.0, 1.0], &[0]);
        assert!(
            (closed_form(&one, &[1.0, 1.0], Weights::Simplex, &Stop::new()).unwrap().objective - 2.0).abs() < 1e-15
        );
        assert!(
            (closed_form(&one, &[1.0, 1.0], Weights::Subsimplex, &Stop::new()).unwrap().objective - 1.0).abs() < 1e-15
        );
    }

    #[test]
    fn a_target_of_the_wrong_sign_gets_no_weight() {
        let fit =
            closed_form(&draws(&[3.0, 4.0, -1.0], &[0, 1, 2, 2]), &[-3.0, 4.0, -1.0], Weights::Simplex, &Stop::new())
                .unwrap();
        assert_eq!(fit.weights[0], 0.0);
        assert!(fit.gap.relative < 1e-14);
    }

    #[test]
    fn the_zero_vector_is_met_by_uniform_weights() {
        let fit = closed_form(&draws(&[0.0, 0.0], &[0, 0, 0, 0]), &[0.0, 0.0], Weights::Simplex, &Stop::new()).unwrap();
        assert_eq!(fit.weights, [0.25; 4]);
        assert_eq!((fit.error, fit.gap.absolute), (0.0, 0.0));
    }

    #[test]
    fn every_line_of_a_matrix_is_solved_by_itself() {
        // columns (3, 4) and (1, 1): the first seen whole, the second in its first entry only
        let law = Arc::new(Law::new(vec![3.0, 4.0, 1.0, 1.0], 2, 2).unwrap());
        let both = Singletons::new(law, Indices::U8(vec![0, 0, 1, 0]), 2).unwrap();
        let target = [3.0, 4.0, 1.0, 1.0];
        let fit = closed_form(&both, &target, Weights::Simplex, &Stop::new()).unwrap();
        let first = closed_form(&draws(&[3.0, 4.0], &[0, 1]), &target[..2], Weights::Simplex, &Stop::new()).unwrap();
        let second = closed_form(&draws(&[1.0, 1.0], &[0, 0]), &target[2..], Weights::Simplex, &Stop::new()).unwrap();
        assert_eq!(fit.weights, [first.weights[0], second.weights[0], first.weights[1], second.weights[1]]);
        assert!((fit.objective - first.objective - second.objective).abs() < 1e-15);
        assert_eq!((fit.unseen, first.unseen, second.unseen), (1, 0, 1));
        assert!(fit.gap.relative < 1e-15);
    }

    #[test]
    fn projection_of_huge_and_equal_values() {
        assert_eq!(project_on_simplex(&[1e300, 0.0]).unwrap(), [1.0, 0.0]);
        assert_eq!(project_on_simplex(&[7.0, 7.0]).unwrap(), [0.5, 0.5]);
        assert_eq!(project_on_simplex(&[-5.0]).unwrap(), [1.0]);
    }
}
