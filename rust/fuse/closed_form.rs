//! ALSE for one line (a vector): the corrected Lemma 4.4, for any target.
//!
//! Realizations of a vector lie on the coordinate axes, so only the total weight `Y_k` of every component matters:
//!
//! `J = g^2 sum_{k seen} (Y_k - tau_k)^2 + sum_{k unseen} t_k^2`, `tau_k = sign(w_k) t_k / g`,
//!
//! and the minimiser is the Euclidean projection of `tau` (on the components seen) onto the simplex. With `t = w` it is a
//! constant upward shift, `Y_k = |w_k| / g + delta / #seen`, where `delta` is the probability of what was not seen; the
//! paper's `Y_k = |w_k|` is feasible in neither set. A total is split equally among the realizations that share it.

use super::simplex::project;
use super::{Weights, distance, power_of_two_scale};
use crate::error::{Result, try_zeros};
use crate::parallel::Stop;
use crate::sample::{Index as _, Law, Singletons, with_indices};

/// The solution of the least-squares problem for one line.
#[derive(Debug, Clone)]
pub struct ClosedForm {
    /// One weight per realization.
    pub weights: Vec<f64>,
    /// `sum_i w_i E_i`.
    pub estimate: Vec<f64>,
    /// `||sum_i w_i E_i - t||_2`.
    pub error: f64,
    /// The squared error.
    pub objective: f64,
    /// The Frank-Wolfe gap of the squared error, recomputed from the data.
    pub gap: Gap,
}

/// Solves `min ||sum_i w_i E_i - target||_2` for realizations of a vector.
///
/// The law must have one line, and the target as many entries as that.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop, [`crate::Error::Memory`] if the weights do not fit.
pub fn closed_form(draws: &Singletons, target: &[f64], set: Weights, stop: &Stop) -> Result<ClosedForm> {
    let law = draws.law();
    let counts = draws.counts(stop)?;
    let totals = totals(law, &counts, target, set);
    let share: Vec<f64> =
        totals.iter().zip(&counts).map(|(total, &count)| if count > 0 { total / count as f64 } else { 0.0 }).collect();
    let mut weights = try_zeros("the weights", draws.size())?;
    with_indices!(&**draws.indices(), indices => {
        for (weights, indices) in weights.chunks_mut(1 << 16).zip(indices.chunks(1 << 16)) {
            stop.check()?;
            weights.iter_mut().zip(indices).for_each(|(w, r)| *w = share[r.get()]);
        }
    });
    let estimate = estimate(law, &totals);
    let error = distance(&estimate, target);
    Ok(ClosedForm {
        weights,
        gap: gap(law, &counts, &totals, &estimate, target, set),
        objective: error * error,
        error,
        estimate,
    })
}

/// `Y`: the total weight of every component, zero where nothing was seen.
pub(super) fn totals(law: &Law, counts: &[u64], target: &[f64], set: Weights) -> Vec<f64> {
    let g = law.gamma()[0];
    let size: u64 = counts.iter().sum();
    if g == 0.0 {
        // every realization is zero: any weights do, the uniform ones are the smallest
        return counts.iter().map(|&count| count as f64 / size.max(1) as f64).collect();
    }
    let seen: Vec<usize> = (0..counts.len()).filter(|&k| counts[k] > 0).collect();
    let signs = law.signs();
    let tau: Vec<f64> = seen.iter().map(|&k| (signs[k] * (target[k] / g)).clamp(-1e300, 1e300)).collect();
    let clipped: f64 = tau.iter().map(|t| t.max(0.0)).sum();
    let projected = match set {
        Weights::Subsimplex if clipped <= 1.0 => tau.iter().map(|t| t.max(0.0)).collect(),
        _ => project_on_simplex(&tau),
    };
    let mut totals = vec![0.0; counts.len()];
    for (&k, y) in seen.iter().zip(projected) {
        totals[k] = y;
    }
    totals
}

/// `sum_i w_i E_i` from the totals.
pub(super) fn estimate(law: &Law, totals: &[f64]) -> Vec<f64> {
    law.atoms().iter().zip(totals).map(|(atom, total)| atom * total).collect()
}

/// The gap of a squared error, absolute and relative to the squared target (to a squared realization if that is zero).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// `max_v <f'(w), w - v>`; overflows or vanishes where squares of the data do.
    pub absolute: f64,
    /// The same over `||t||^2`, computed in units in which squares are representable.
    pub relative: f64,
}

/// `max_v <f'(w), w - v>` over the vertices `v` of the weight set, `f'_i = 2 <E_i, sum w E - t>`.
pub(super) fn gap(law: &Law, counts: &[u64], totals: &[f64], estimate: &[f64], target: &[f64], set: Weights) -> Gap {
    let scale = power_of_two_scale(law.gamma().iter().chain(target));
    let atoms = law.atoms();
    let seen = (0..counts.len()).filter(|&k| counts[k] > 0);
    let gradient = |k: usize| 2.0 * (atoms[k] / scale) * ((estimate[k] - target[k]) / scale);
    let mut smallest = if set == Weights::Subsimplex { 0.0 } else { f64::INFINITY };
    let mut at_solution = 0.0;
    for k in seen {
        smallest = gradient(k).min(smallest);
        at_solution += totals[k] * gradient(k);
    }
    let gap = if smallest == f64::INFINITY { 0.0 } else { (at_solution - smallest).max(0.0) };
    let squared_target: f64 = target.iter().map(|t| (t / scale).powi(2)).sum();
    let squared_atom = (law.gamma()[0] / scale).powi(2);
    let reference = if squared_target > 0.0 { squared_target } else { squared_atom };
    Gap { absolute: gap * scale * scale, relative: if gap > 0.0 { gap / reference } else { 0.0 } }
}

/// The Euclidean projection on `{y >= 0, sum y = 1}`.
pub fn project_on_simplex(tau: &[f64]) -> Vec<f64> {
    // a common shift changes nothing: with the largest at zero, no rounding of a large tau can swallow the 1
    let largest = tau.iter().fold(f64::NEG_INFINITY, |m, t| m.max(*t));
    let mut y: Vec<f64> = tau.iter().map(|t| t - largest).collect();
    project(&mut y);
    y
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
    fn projection_of_huge_and_equal_values() {
        assert_eq!(project_on_simplex(&[1e300, 0.0]), [1.0, 0.0]);
        assert_eq!(project_on_simplex(&[7.0, 7.0]), [0.5, 0.5]);
        assert_eq!(project_on_simplex(&[-5.0]), [1.0]);
    }
}
