//! SLSE for singleton realizations: one exact line search per realization, in `O(lines)`.
//!
//! `t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1)`, `F <- (1 - t) F + t E`, from `F = E_1` (math: Lemma 4.5, with the
//! recursion on the fused `F`). The *safeguarded* variant follows every step with one more line search, from `F` towards
//! the running mean `U`; that makes the printed inequality SLSE <= uniform true for every sample path.
//!
//! The step itself is in [`super::greedy`]; its inner products are recomputed from `F` every `16 length` steps, so that the
//! reported error keeps its relative accuracy however small it becomes.

use super::greedy::Run;
use super::{distance, power_of_two_scale};
use crate::error::{Result, try_zeros};
use crate::parallel::Stop;
use crate::sample::{Singletons, with_indices};

/// What a sequential fusion leaves behind.
#[derive(Debug, Clone, Default)]
pub struct Sequential {
    /// One weight per realization; they add up to one.
    pub weights: Vec<f64>,
    /// `F = sum_i w_i E_i` after the last realization.
    pub estimate: Vec<f64>,
    /// `||F - E*||` after the first `k` realizations, for each `k` asked for.
    pub errors: Vec<f64>,
    /// The estimates at the same places, one after the other, when asked for.
    pub estimates: Vec<f64>,
}

/// Fuses the realizations one after the other towards `target`, recording the error after the first `k` for each `k` in
/// the increasing `sizes`.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop, [`crate::Error::Memory`] if the weights do not fit.
pub fn slse(
    draws: &Singletons,
    target: &[f64],
    safeguard: bool,
    sizes: &[usize],
    keep_estimates: bool,
    stop: &Stop,
) -> Result<Sequential> {
    let law = draws.law();
    let (lines, length) = (law.lines(), law.length());
    let signs = law.signs();
    let on_support = |k: usize| signs[k] != 0.0;
    // What no realization can change stays out of every inner product: a large part there would drown the rest.
    let split = |on: bool| -> Vec<f64> {
        target.iter().enumerate().map(|(k, &t)| if on_support(k) == on { t } else { 0.0 }).collect()
    };
    let reachable = split(true);
    let off = distance(&split(false), &vec![0.0; target.len()]);
    let scale = power_of_two_scale(law.gamma().iter().chain(&reachable));
    let gamma: Vec<f64> = law.gamma().iter().map(|g| g / scale).collect();
    let scaled: Vec<f64> = reachable.iter().map(|t| t / scale).collect();
    let magnitudes: Vec<f64> = scaled.iter().zip(&signs).map(|(t, sign)| sign * t).collect();
    let mut run = Run::new(gamma, &magnitudes, safeguard);
    let size = draws.size();
    let mut out = Sequential { weights: try_zeros("the weights", size)?, ..Sequential::default() };
    let mut safeguards = if safeguard { try_zeros("the safeguard steps", size)? } else { Vec::new() };
    let mut wanted = sizes.iter().copied().peekable();
    let estimate = |run: &Run| -> Vec<f64> {
        (0..scaled.len())
            .map(|k| {
                if on_support(k) && run.gamma[k / length] > 0.0 { signs[k] * run.f(k / length, k) * scale } else { 0.0 }
            })
            .collect()
    };
    let refresh_every = 16 * length.max(16);
    let check_every = (1 << 18) / lines + 1; // about a millisecond
    with_indices!(&**draws.indices(), indices => {
        for (i, sample) in indices.chunks_exact(lines).take(size).enumerate() {
            let (t, s) = run.step(sample, i + 1);
            out.weights[i] = t;
            if safeguard {
                safeguards[i] = s;
            }
            if (i + 1) % refresh_every == 0 {
                run.refresh();
            }
            if (i + 1) % check_every == 0 {
                stop.check()?;
            }
            if wanted.next_if_eq(&(i + 1)).is_some() {
                out.errors.push((run.direct().0.max(0.0).sqrt() * scale).hypot(off));
                stop.check()?;
                if keep_estimates {
                    out.estimates.extend(estimate(&run));
                }
            }
        }
    });
    out.estimate = estimate(&run);
    steps_to_weights(&mut out.weights, &safeguards);
    Ok(out)
}

/// Turns the steps `t_k` (in place) and `s_k` into weights: `w_k = C_k (1 - s_k) t_k + sum_{i >= k} C_i s_i / i` with
/// `C_k = prod_{i > k} (1 - s_i)(1 - t_i)`.
pub(super) fn steps_to_weights(steps: &mut [f64], safeguards: &[f64]) {
    let (mut carried, mut from_means) = (1.0, 0.0);
    for k in (0..steps.len()).rev() {
        let (t, s) = (steps[k], safeguards.get(k).copied().unwrap_or(0.0));
        from_means += carried * s / (k + 1) as f64;
        steps[k] = from_means + carried * (1.0 - s) * t;
        carried *= (1.0 - s) * (1.0 - t);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Indices, Law};
    use crate::{Key, Scheme, sample};
    use std::sync::Arc;

    fn run(w: &[f64], lines: usize, length: usize, indices: &[u8], safeguard: bool) -> Sequential {
        let law = Arc::new(Law::new(w.to_vec(), lines, length).unwrap());
        let size = indices.len() / lines;
        let draws = Singletons::new(law, Indices::U8(indices.to_vec().into()), size).unwrap();
        slse(&draws, w, safeguard, &[size], false, &Stop::new()).unwrap()
    }

    /// The exact rationals that refute SLSE <= uniform path by path.
    #[test]
    fn exact_cases() {
        let squared = |s: Sequential| s.errors[0] * s.errors[0];
        assert!((squared(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 0, 1, 2], false)) - 3.0 / 98.0).abs() < 1e-14);
        assert!((squared(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 1, 2, 0], false)) - 75.0 / 7154.0).abs() < 1e-14);
        // A = [[1, 1], [2, 2]], columns (1, 2) and (1, 2); realizations (1,1), (0,1), (1,0)
        let matrix = [1.0, 2.0, 1.0, 2.0];
        assert!((squared(run(&matrix, 2, 2, &[1, 1, 0, 1, 1, 0], false)) - 0.2).abs() < 1e-14);
        // uniform weights are exact on both: the safeguard finds that
        assert!(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 0, 1, 2], true).errors[0] < 1e-15);
    }

    #[test]
    fn estimate_weights_and_error_agree_over_a_long_run() {
        let w: Vec<f64> = (1..=12).map(|i| f64::from(i) * if i % 3 == 0 { -1.0 } else { 1.0 }).collect();
        let law = Arc::new(Law::new(w.clone(), 3, 4).unwrap());
        let draws = sample(&law, 20_000, Scheme::Iid, &Key([5; 32]), 1, &Stop::new()).unwrap();
        for safeguard in [false, true] {
            let fit = slse(&draws, &w, safeguard, &[20_000], false, &Stop::new()).unwrap();
            assert!((fit.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(distance(&fit.estimate, &draws.combine(&fit.weights, &Stop::new()).unwrap()) < 1e-11);
            assert!((fit.errors[0] - distance(&fit.estimate, &w)).abs() <= 1e-12 * fit.errors[0] + 1e-300);
        }
    }
}
