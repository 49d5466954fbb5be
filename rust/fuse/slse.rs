//! SLSE for singleton realizations: one exact line search per realization, in `O(lines)`.
//!
//! `t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1)`, `F <- (1 - t) F + t E`, from `F = E_1` (Lemma 4.5 with the
//! recursion on the fused `F`). The *safeguarded* variant follows every step with one more line search, from `F`
//! towards the running mean `U`; with it, the printed inequality SLSE <= uniform holds for every sample path.
//!
//! Each step starts where the last one ended, so one ensemble takes one thread; [`slse_each`] spreads independent
//! ensembles, such as the replicates of an experiment, over threads.

use super::slse_run::Run;
use super::slse_tables::{Apart, Beside, Tables, WHAT};
use super::{distance, norm, power_of_two_scale};
use crate::error::Result;
use crate::memory::{try_collect, try_extend, try_push, try_room, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::{Singletons, with_indices};

/// Bytes of a first-level data cache that processors have at least; it decides the layout of the tables.
const CACHE: usize = 32 << 10;

/// The result of a sequential fusion.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Sequential {
    /// One weight per realization, which add up to one; none for an average, where they are equal.
    pub weights: Vec<f64>,
    /// `F = sum_i w_i E_i` after the last realization.
    pub estimate: Vec<f64>,
    /// `||F - E*||` after the first `k` realizations, for each `k` in `sizes`.
    pub errors: Vec<f64>,
    /// The estimates at the same `k`, one after the other, if requested.
    pub estimates: Vec<f64>,
}

impl Sequential {
    /// Keeps the estimate of a prefix, and its error.
    pub(super) fn record(&mut self, estimate: Vec<f64>, target: &[f64], keep: bool) -> Result<()> {
        try_push(WHAT, &mut self.errors, distance(&estimate, target))?;
        if keep {
            try_extend(WHAT, &mut self.estimates, estimate.iter().copied())?;
        }
        self.estimate = estimate;
        Ok(())
    }
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
    let ask = Ask { draws, target, safeguard, sizes, keep_estimates };
    if 2 * size_of_val(draws.law().values()) <= CACHE { ask.answer::<Apart>(stop) } else { ask.answer::<Beside>(stop) }
}

/// [`slse`] of independent ensembles towards their targets, on up to `threads` threads.
///
/// Every result is that of [`slse`], bit for bit, for any number of threads.
///
/// # Errors
/// As for [`slse`]; the first error ends the others.
pub fn slse_each(
    ensembles: &[(Singletons, &[f64])],
    safeguard: bool,
    sizes: &[usize],
    keep_estimates: bool,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<Sequential>> {
    let mut fits = try_collect(WHAT, ensembles.iter().map(|_| Sequential::default()))?;
    for_each_chunk(fits.iter_mut().zip(ensembles), threads, stop, |(fit, (draws, target))| {
        *fit = slse(draws, target, safeguard, sizes, keep_estimates, stop)?;
        Ok(())
    })?;
    Ok(fits)
}

/// The arguments of [`slse`].
struct Ask<'a> {
    draws: &'a Singletons,
    target: &'a [f64],
    safeguard: bool,
    sizes: &'a [usize],
    keep_estimates: bool,
}

impl Ask<'_> {
    fn answer<T: Tables>(&self, stop: &Stop) -> Result<Sequential> {
        let law = self.draws.law();
        let (lines, length) = (law.lines(), law.length());
        // Entries of the target that no realization can change are left out of the inner products: large ones would
        // cover the others.
        let off = norm(self.entries().filter(|(v, t)| *v == 0.0 && *t != 0.0).map(|(_, t)| t));
        let scale = power_of_two_scale(&[largest(law.gamma(), law.gamma()), largest(self.target, law.values())]);
        let unit = 1.0 / scale; // exact, as the products with it are: powers of two
        let gamma: Vec<f64> = try_collect(WHAT, law.gamma().iter().map(|g| g * unit))?;
        let mut run: Run<T> = Run::new(gamma, length, self.safeguard, self.signed(unit))?;
        // back to the law's signs and units
        let report = |run: &Run<T>, to: &mut Vec<f64>| -> Result<()> {
            for (j, values) in law.values().chunks_exact(length).enumerate() {
                let signed = |(f, v): (f64, &f64)| if *v == 0.0 { 0.0 } else { 1.0_f64.copysign(*v) * f * scale };
                try_extend(WHAT, to, run.line(j).zip(values).map(signed))?;
            }
            Ok(())
        };
        let size = self.draws.size();
        let mut out = Sequential { weights: try_zeros("the weights", size)?, ..Sequential::default() };
        let mut safeguards = if self.safeguard { try_zeros("the safeguard steps", size)? } else { Vec::new() };
        let refresh_every = 16 * length.max(16);
        let check_every = (1 << 18) / lines + 1; // about a millisecond
        let mut wanted = self.sizes.iter().copied().peekable();
        let mut done = 0;
        with_indices!(&**self.draws.indices(), indices => while done < size {
            // up to the next position with something else to do than a step
            let due = |every: usize| done - done % every + every;
            let next = due(refresh_every).min(due(check_every)).min(size);
            let next = wanted.peek().map_or(next, |&k| next.min(k.max(done + 1)));
            let block = &indices[done * lines..next * lines];
            run.advance(block, done, &mut out.weights[done..next], safeguards.get_mut(done..next).unwrap_or_default());
            done = next;
            if done % refresh_every == 0 {
                run.refresh();
            }
            stop.check()?;
            if wanted.next_if_eq(&done).is_some() {
                try_push(WHAT, &mut out.errors, (run.error(self.signed(unit)) * scale).hypot(off))?;
                if self.keep_estimates {
                    report(&run, &mut out.estimates)?;
                }
            }
        });
        out.estimate = try_room(WHAT, law.values().len())?;
        report(&run, &mut out.estimate)?;
        steps_to_weights(&mut out.weights, &safeguards);
        Ok(out)
    }

    /// The entries of the mean and of the target.
    fn entries(&self) -> impl Iterator<Item = (f64, f64)> + Clone {
        self.draws.law().values().iter().copied().zip(self.target.iter().copied())
    }

    /// `unit sign_k t_k`, and 0 off the support.
    fn signed(&self, unit: f64) -> impl Iterator<Item = f64> {
        self.entries().map(move |(v, t)| if v == 0.0 { 0.0 } else { 1.0_f64.copysign(v) * (t * unit) })
    }
}

/// `max |v_k|` over the entries with `support_k != 0`, as eight independent maxima, so that none waits for the one
/// before.
fn largest(values: &[f64], support: &[f64]) -> f64 {
    let larger = |most: f64, v: f64, s: f64| {
        let v = if s == 0.0 { 0.0 } else { v.abs() };
        if v > most { v } else { most }
    };
    let ((eights, rest), (supports, support_rest)) = (values.as_chunks::<8>(), support.as_chunks::<8>());
    let mut lanes = [0.0_f64; 8];
    for (values, support) in eights.iter().zip(supports) {
        for k in 0..8 {
            lanes[k] = larger(lanes[k], values[k], support[k]);
        }
    }
    let most = lanes.into_iter().fold(0.0, f64::max);
    rest.iter().zip(support_rest).fold(most, |most, (v, s)| larger(most, *v, *s))
}

/// Turns the steps `t_k` (in place) and `s_k` into weights: `w_k = C_k (1 - s_k) t_k + sum_{i >= k} C_i s_i / i` with
/// `C_k = prod_{i > k} (1 - s_i)(1 - t_i)`.
pub(super) fn steps_to_weights(steps: &mut [f64], safeguards: &[f64]) {
    let mut carried = 1.0;
    if safeguards.is_empty() {
        for step in steps.iter_mut().rev() {
            let t = *step;
            *step = carried * t;
            carried *= 1.0 - t;
        }
        return;
    }
    let mut from_means = 0.0;
    for (k, (step, s)) in steps.iter_mut().zip(safeguards).enumerate().rev() {
        let t = *step;
        from_means += carried * s / (k + 1) as f64;
        *step = from_means + carried * (1.0 - s) * t;
        carried *= (1.0 - s) * (1.0 - t);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::distance;
    use crate::sample::{Index, Indices, Law};
    use crate::{Key, Scheme, sample};
    use std::sync::Arc;

    fn run(w: &[f64], lines: usize, length: usize, indices: &[u8], safeguard: bool) -> Sequential {
        let law = Arc::new(Law::new(w.to_vec(), lines, length).unwrap());
        let size = indices.len() / lines;
        let draws = Singletons::new(law, Indices::U8(indices.to_vec()), size).unwrap();
        slse(&draws, w, safeguard, &[size], false, &Stop::new()).unwrap()
    }

    /// The exact counterexamples to SLSE <= uniform for every sample path.
    #[test]
    fn exact_cases() {
        let squared = |s: Sequential| s.errors[0] * s.errors[0];
        assert!((squared(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 0, 1, 2], false)) - 3.0 / 98.0).abs() < 1e-14);
        assert!((squared(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 1, 2, 0], false)) - 75.0 / 7154.0).abs() < 1e-14);
        // A = [[1, 1], [2, 2]], columns (1, 2) and (1, 2); realizations (1,1), (0,1), (1,0)
        let matrix = [1.0, 2.0, 1.0, 2.0];
        assert!((squared(run(&matrix, 2, 2, &[1, 1, 0, 1, 1, 0], false)) - 0.2).abs() < 1e-14);
        // uniform weights are exact on both: the safeguard reaches zero error
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

    /// A compensated sum (Neumaier).
    fn compensated(terms: impl Iterator<Item = f64>) -> f64 {
        let (mut sum, mut lost) = (0.0_f64, 0.0);
        for term in terms {
            let next = sum + term;
            lost += if sum.abs() >= term.abs() { (sum - next) + term } else { (term - next) + sum };
            sum = next;
        }
        sum + lost
    }

    /// The error after `10^6` steps against a compensated norm of `sum_i w_i E_i - E*`, summed from weights and
    /// indices.
    #[test]
    fn the_reported_error_is_accurate_after_a_million_steps() {
        for (lines, length) in [(1, 10), (5, 8), (2, 1100)] {
            let size = if length > 1000 { 200_000 } else { 1_000_000 };
            let entry =
                |k: usize| (1.0 + (k as f64 * 0.754_877).fract()) * if k.is_multiple_of(3) { -1.0 } else { 1.0 };
            let w: Vec<f64> = (0..lines * length).map(entry).collect();
            let law = Arc::new(Law::new(w.clone(), lines, length).unwrap());
            let draws = sample(&law, size, Scheme::Iid, &Key([6; 32]), 1, &Stop::new()).unwrap();
            // a target that no fusion reaches, so that the error stays well above rounding
            let target: Vec<f64> = w.iter().enumerate().map(|(k, w)| w * (1.0 + 1e-3 * (k % 7) as f64)).collect();
            for safeguard in [false, true] {
                let fit = slse(&draws, &target, safeguard, &[size / 2, size], false, &Stop::new()).unwrap();
                let mut terms = vec![Vec::new(); lines * length];
                with_indices!(&**draws.indices(), indices => {
                    for (sample, weight) in indices.chunks_exact(lines).zip(&fit.weights) {
                        sample.iter().enumerate().for_each(|(j, r)| terms[j * length + r.get()].push(*weight));
                    }
                });
                let atoms = law.atoms().unwrap();
                let squares = terms
                    .into_iter()
                    .enumerate()
                    .map(|(k, weights)| (atoms[k] * compensated(weights.into_iter()) - target[k]).powi(2));
                let direct = compensated(squares).sqrt();
                let relative = (fit.errors[1] - direct).abs() / direct;
                assert!(relative < 1e-10, "{lines} x {length}, safeguard {safeguard}: off by {relative:e}");
            }
        }
    }

    /// Both layouts of the tables give the same steps, bit for bit.
    #[test]
    fn the_layout_of_the_tables_changes_nothing() {
        let w: Vec<f64> = (1..=35).map(|i| f64::from(i % 9 - 4)).collect();
        let law = Arc::new(Law::new(w.clone(), 5, 7).unwrap());
        let draws = sample(&law, 3000, Scheme::Iid, &Key([7; 32]), 1, &Stop::new()).unwrap();
        for safeguard in [false, true] {
            let ask = Ask { draws: &draws, target: &w, safeguard, sizes: &[1, 2, 999, 3000], keep_estimates: true };
            let (apart, beside) =
                (ask.answer::<Apart>(&Stop::new()).unwrap(), ask.answer::<Beside>(&Stop::new()).unwrap());
            assert_eq!(apart.weights, beside.weights);
            assert_eq!(apart.errors, beside.errors);
            assert_eq!(apart.estimates, beside.estimates);
        }
    }

    /// `F = E` if all realizations are equal: every step but the first is exactly zero.
    #[test]
    fn equal_realizations_take_no_step() {
        let mut w = vec![0.0; 49];
        (0..7).for_each(|i| w[8 * i] = 0.1 + i as f64 / 3.0);
        let fit = run(&w, 7, 7, &[0, 1, 2, 3, 4, 5, 6].repeat(50), false);
        assert_eq!(fit.weights[0], 1.0);
        assert!(fit.weights[1..].iter().all(|&t| t == 0.0));
        assert!(fit.errors[0] < 1e-15);
    }

    #[test]
    fn replicates_do_not_depend_on_threads() {
        let w: Vec<f64> = (1..=12).map(|i| f64::from(i) - 4.5).collect();
        let law = Arc::new(Law::new(w.clone(), 3, 4).unwrap());
        let draw = |seed| sample(&law, 500, Scheme::Iid, &Key([seed; 32]), 1, &Stop::new()).unwrap();
        let ensembles: Vec<(Singletons, &[f64])> = (0..9).map(|seed| (draw(seed), &w[..])).collect();
        let each = |threads| slse_each(&ensembles, true, &[10, 500], true, threads, &Stop::new()).unwrap();
        let one = each(1);
        for (fits, (draws, target)) in one.iter().zip(&ensembles) {
            let alone = slse(draws, target, true, &[10, 500], true, &Stop::new()).unwrap();
            assert_eq!((&fits.errors, &fits.weights), (&alone.errors, &alone.weights));
        }
        for threads in [2, 5] {
            for (a, b) in each(threads).iter().zip(&one) {
                assert_eq!((&a.errors, &a.weights, &a.estimates), (&b.errors, &b.weights, &b.estimates));
            }
        }
        let stop = Stop::new();
        stop.request();
        assert!(slse_each(&ensembles, true, &[500], false, 2, &stop).is_err());
    }
}
