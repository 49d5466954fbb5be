//! SLSE for dense realizations: the same line searches, with inner products summed at every step.

use super::line_search::step_towards;
use super::slse::{Sequential, steps_to_weights};
use super::slse_tables::WHAT;
use super::{Dense, distance, power_of_two_scale};
use crate::error::Result;
use crate::memory::{try_collect, try_extend, try_push, try_zeros};
use crate::parallel::Stop;

/// As [`super::slse()`], for realizations without structure; `O(dimension)` per step.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop, [`crate::Error::Memory`] if the weights do not fit.
pub fn slse_dense(
    samples: &Dense<'_>,
    target: &[f64],
    safeguard: bool,
    sizes: &[usize],
    keep_estimates: bool,
    stop: &Stop,
) -> Result<Sequential> {
    let scale = power_of_two_scale(samples.values().iter().chain(target));
    let scaled: Vec<f64> = try_collect(WHAT, target.iter().map(|t| t / scale))?;
    let mut f = try_zeros(WHAT, target.len())?;
    let mut sum: Vec<f64> = try_zeros(WHAT, if safeguard { target.len() } else { 0 })?;
    let mut out = Sequential::default();
    let mut safeguards = if safeguard { try_zeros("the safeguard steps", samples.size())? } else { Vec::new() };
    let mut wanted = sizes.iter().copied().peekable();
    let mut steps: Vec<f64> = try_zeros("the weights", samples.size())?;
    for (i, step) in steps.iter_mut().enumerate() {
        stop.check()?;
        let e = samples.row(i);
        *step = if i == 0 {
            f.iter_mut().zip(e).for_each(|(f, e)| *f = e / scale);
            1.0
        } else {
            step_towards(&mut f, |k| e[k] / scale, &scaled, 1.0)
        };
        if safeguard {
            sum.iter_mut().zip(e).for_each(|(s, e)| *s += e / scale);
            let n = (i + 1) as f64;
            safeguards[i] = step_towards(&mut f, |k| sum[k] / n, &scaled, 1.0);
        }
        if wanted.next_if_eq(&(i + 1)).is_some() {
            try_push(WHAT, &mut out.errors, distance(&f, &scaled) * scale)?;
            if keep_estimates {
                try_extend(WHAT, &mut out.estimates, f.iter().map(|f| f * scale))?;
            }
        }
    }
    f.iter_mut().for_each(|f| *f *= scale);
    out.estimate = f;
    steps_to_weights(&mut steps, &safeguards);
    out.weights = steps;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_general_counterexample() {
        // (1,0), (0,2), (-1,-2) with E* = 0: SLSE^2 = 4/25, while the uniform average is exact.
        let samples = [1.0, 0.0, 0.0, 2.0, -1.0, -2.0];
        let dense = Dense::new(&samples, 3, 2).unwrap();
        let plain = slse_dense(&dense, &[0.0, 0.0], false, &[3], false, &Stop::new()).unwrap();
        assert!((plain.errors[0].powi(2) - 4.0 / 25.0).abs() < 1e-14);
        let safe = slse_dense(&dense, &[0.0, 0.0], true, &[3], false, &Stop::new()).unwrap();
        assert!(safe.errors[0] < 1e-15);
        assert!((safe.weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
    }
}
