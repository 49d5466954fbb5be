//! Checks every proposal: feasible weights, with error and gap recomputed from the realizations.

use super::realizations::Realizations;
use super::solution::{CertifiedWeights, Proposal, Settings};
use crate::error::Result;
use crate::fuse::simplex::{self, WeightStatus};
use crate::fuse::{Weights, distance, power_of_two_scale};
use crate::memory::try_collect;
use crate::parallel::Stop;

/// Makes `weights` feasible and certifies them.
///
/// With `r = S w - E*` and `f' = 2 S^T r`, the gap is `<f', w> - min_i f'_i` on the simplex; on the sub-simplex the
/// origin is a vertex too. By convexity `f(w) - min f <= gap`.
pub(super) fn verify(
    realizations: &impl Realizations,
    proposal: Proposal,
    target: &[f64],
    settings: &Settings,
    stop: &Stop,
) -> Result<CertifiedWeights> {
    let Settings { set, tol, .. } = *settings;
    let Proposal { mut weights, solver, iterations } = proposal;
    make_feasible(&mut weights, set);
    let estimate = realizations.combine(&weights, stop)?;
    // scaled by a power of two near the realizations' norm: exact, and squares neither overflow nor vanish
    let norm = realizations.norm();
    let scale = power_of_two_scale(target.iter().chain([&norm]));
    let residual: Vec<f64> = try_collect("a residual", estimate.iter().zip(target).map(|(s, t)| (s - t) / scale))?;
    let gradient = realizations.correlate(&residual)?; // in units of scale: f' / 2 = S^T r
    let vertex = if set == Weights::Subsimplex { 0.0 } else { f64::INFINITY };
    let smallest = gradient.iter().fold(vertex, |m, g| m.min(g / scale));
    let at_solution: f64 = gradient.iter().zip(&weights).map(|(g, w)| g / scale * w).sum();
    // r and its products are rounded: eps (||r|| (entries + 2) + 4 size) in units of scale, for a realization of that
    // size
    let size = norm / scale;
    let far = residual.iter().fold(0.0, |far: f64, r| far.hypot(*r));
    let rounding = f64::EPSILON * size * (far * (target.len() + 2) as f64 + 4.0 * size);
    let gap = simplex::nonnegative(2.0 * (at_solution - smallest + rounding));
    let squared_target: f64 = target.iter().map(|t| (t / scale).powi(2)).sum();
    let zero = target.iter().all(|t| *t == 0.0);
    let reference = if zero { (norm / scale).powi(2) } else { squared_target };
    let error = distance(&estimate, target);
    Ok(CertifiedWeights {
        error,
        weights,
        gap: gap * scale * scale,
        lower_bound: scale * ((error / scale).powi(2) - gap).max(0.0).sqrt(),
        unseen: 0,
        exact: false,
        estimate,
        status: if gap <= tol * reference { WeightStatus::Optimal } else { WeightStatus::OptimalInaccurate },
        solver,
        iterations,
    })
}

/// Clips below at zero and divides by the sum (on the sub-simplex only if it is above one); NaN becomes zero.
fn make_feasible(weights: &mut [f64], set: Weights) {
    weights.iter_mut().for_each(|w| *w = if *w > 0.0 { *w } else { 0.0 });
    let sum: f64 = weights.iter().sum();
    if !(sum > 0.0 && sum.is_finite()) {
        if set == Weights::Simplex {
            let n = weights.len() as f64;
            weights.fill(1.0 / n);
        } else {
            weights.fill(0.0);
        }
    } else if set == Weights::Simplex || sum > 1.0 {
        weights.iter_mut().for_each(|w| *w /= sum);
    }
}
