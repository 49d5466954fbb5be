//! Where a control leads models that are drawn by the law of the estimate: how it may miss, of which nothing is
//! certified.

use crate::error::{Error, Result, require_finite};
use crate::identify::EstimateLaw;
use crate::memory::{checked_len, try_copy, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::scaled::distance;
use crate::stream::Key;
use crate::window::Window;

const WHAT: &str = "the misses of drawn models";
/// Draws of one piece of work.
const CHUNK: usize = 64;

/// A control and its target.
#[derive(Debug, Clone, Copy)]
pub struct PlannedRun<'a> {
    /// The initial state (n).
    pub x0: &'a [f64],
    /// `u(0), .., u(K-1)`, each with m entries.
    pub inputs: &'a [f64],
    /// The number of inputs.
    pub m: usize,
    /// The target (n); or of each of the last outputs one.
    pub target: &'a [f64],
    /// Whether the noise of the run acts, of the same draw as the model.
    pub noise: bool,
    /// For models of n outputs, what they see: `x0` is the contents of this window.
    pub window: Option<Window>,
    /// With a gain K (m rows) the input in step k is `u(k) + K (x(k) - xh(k))`, xh the centre without noise.
    pub gain: Option<&'a [f64]>,
}

/// `||x(K) - target||` of `size` drawn models, each of its own run; infinite where a run overflows. Of models of
/// outputs it is that of the last outputs together, as many as the window has lags or filters.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Memory`], [`Error::Interrupted`].
pub fn drawn_misses(
    law: &EstimateLaw<'_>,
    aim: PlannedRun<'_>,
    key: &Key,
    size: usize,
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    let (n, d, PlannedRun { x0, inputs, m, target, noise, window, gain }) = (law.n(), law.d(), aim);
    let (fits, held) = match &window {
        None => (d.wrapping_sub(n + m) <= 1, n),
        Some(window) => ((window.outputs(), window.inputs(), window.length()) == (n, m, d), window.states()),
    };
    let steps = inputs.len() / m.max(1);
    let last = steps.saturating_sub(window.map_or(1, |one| one.count()));
    let aimed = target.len() == n || target.len() == (steps - last) * n;
    if m == 0 || !fits || x0.len() != held || !aimed || !inputs.len().is_multiple_of(m) {
        let expected = format!("inputs of {m}, states of {n} entries in a model with rows of {d}");
        let found = format!("{}, {} and {} entries", inputs.len(), x0.len(), target.len());
        return Err(Error::Shape { name: "inputs, x0, xf", expected, found });
    }
    let gain = gain.unwrap_or(&[]);
    if !gain.is_empty() && gain.len() != checked_len(WHAT, m, held)? {
        let expected = format!("{m} rows of {held}");
        return Err(Error::Shape { name: "gain", expected, found: format!("{} entries", gain.len()) });
    }
    for (name, values) in [("x0", x0), ("inputs", inputs), ("xf", target), ("gain", gain)] {
        require_finite(name, values)?;
    }
    // one step of a model from x, with the noise of the step: (x, its last outputs)
    let step = |model: &[f64], noise: &[f64], x: &mut [f64], u: &[f64], z: &mut [f64], next: &mut [f64]| {
        match &window {
            Some(window) => window.regressors(x, u, 1.0, z),
            None => z.iter_mut().zip(x.iter().chain(u).chain(&[1.0])).for_each(|(to, v)| *to = *v),
        }
        for (i, (to, row)) in next.iter_mut().zip(model.chunks_exact(d)).enumerate() {
            let noise = noise.get(i).copied().unwrap_or(0.0);
            *to = row.iter().zip(&*z).map(|(a, z)| a * z).sum::<f64>() + noise;
        }
        match &window {
            Some(window) => window.advance(x, next, u),
            None => x.copy_from_slice(next),
        }
    };
    let mut path = try_zeros(WHAT, if gain.is_empty() { 0 } else { checked_len(WHAT, steps, held)? })?;
    let (mut x, mut next, mut z) = (try_copy(WHAT, x0)?, try_zeros(WHAT, n)?, try_zeros(WHAT, d)?);
    for (xh, u) in path.chunks_exact_mut(held).zip(inputs.chunks_exact(m)) {
        xh.copy_from_slice(&x);
        step(law.centre(), &[], &mut x, u, &mut z, &mut next);
    }
    let noises = if noise { steps } else { 0 };
    let mut misses = try_zeros(WHAT, size)?;
    for_each_chunk(misses.chunks_mut(CHUNK).enumerate(), threads, stop, |(chunk, misses)| {
        let (mut drawing, mut model) = (law.drawing(noises)?, try_zeros(WHAT, checked_len(WHAT, n, d)?)?);
        let mut w = try_zeros(WHAT, checked_len(WHAT, noises, n)?)?;
        let (mut x, mut next, mut z) = (try_zeros(WHAT, held)?, try_zeros(WHAT, n)?, try_zeros(WHAT, d)?);
        let mut u = try_zeros(WHAT, m)?;
        for (b, miss) in misses.iter_mut().enumerate() {
            stop.check()?;
            law.draw(key, chunk * CHUNK + b, &mut drawing, &mut model, &mut w);
            x.copy_from_slice(x0);
            *miss = if steps == 0 && window.is_none() { distance(&x, target) } else { 0.0 };
            for (k, planned) in inputs.chunks_exact(m).enumerate() {
                u.copy_from_slice(planned);
                if let Some(xh) = path.chunks_exact(held).nth(k) {
                    for (to, row) in u.iter_mut().zip(gain.chunks_exact(held)) {
                        *to += row.iter().zip(&x).zip(xh).map(|((k, x), xh)| k * (x - xh)).sum::<f64>();
                    }
                }
                let acts = w.get(k * n..(k + 1) * n).unwrap_or(&[]);
                step(&model, acts, &mut x, &u, &mut z, &mut next);
                if k >= last {
                    let at = (k - last) * n % target.len();
                    let off = distance(&next, &target[at..at + n]);
                    *miss = if miss.is_nan() { *miss } else { miss.hypot(off) };
                }
            }
            if miss.is_nan() {
                *miss = f64::INFINITY;
            }
        }
        Ok(())
    })?;
    Ok(misses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::{Centre, NoiseLaw};

    #[test]
    fn misses_are_those_of_the_models() {
        // x+ = a x + u + c, only a is uncertain
        let centre = Centre { model: &[0.5, 1.0, 2.0], white: &[0.1, 0.0, 0.0] };
        let law = EstimateLaw::new(centre, &[4.0], NoiseLaw::Known).unwrap();
        let (key, stop) = (Key([3; 32]), Stop::new());
        let aim = PlannedRun {
            x0: &[1.0],
            inputs: &[3.0, -1.0],
            m: 1,
            target: &[0.25],
            noise: false,
            window: None,
            gain: None,
        };
        let found = drawn_misses(&law, aim, &key, 130, 2, &stop).unwrap();
        let models = law.models(&key, 130, 1, &stop).unwrap();
        for (miss, model) in found.iter().zip(models.chunks_exact(3)) {
            assert_eq!(model[1..], [1.0, 2.0]);
            let expected = (model[0] * (model[0] + 5.0) + 1.0 - 0.25).abs();
            assert!((miss - expected).abs() < 1e-13 * (1.0 + expected));
        }
        // followed: u(1) = -1 + k (a - 0.5), as x(1) = 1 a + 5 and the centre is at 5.5
        let gain = Some(&[-0.4][..]);
        let followed = drawn_misses(&law, PlannedRun { gain, ..aim }, &key, 130, 2, &stop).unwrap();
        for (miss, model) in followed.iter().zip(models.chunks_exact(3)) {
            let a = model[0];
            let expected = (a * (a + 5.0) + 1.0 - 0.4 * (a - 0.5) - 0.25).abs();
            assert!((miss - expected).abs() < 1e-13 * (1.0 + expected));
        }
        // the variance of the noise is 4 (1 + a^2) more
        let many = |noise| drawn_misses(&law, PlannedRun { noise, ..aim }, &key, 4000, 2, &stop).unwrap();
        let square = |values: Vec<f64>| values.iter().map(|v| v * v).sum::<f64>() / 4000.0;
        let more = square(many(true)) - square(many(false));
        assert!((more / (4.0 * 1.25) - 1.0).abs() < 0.3, "{more}");
    }

    #[test]
    fn what_overflows_is_infinite_and_wrong_shapes_are_errors() {
        let centre = Centre { model: &[1e200, 1.0], white: &[1.0, 0.0] };
        let law = EstimateLaw::new(centre, &[1.0], NoiseLaw::Known).unwrap();
        let (key, stop) = (Key([3; 32]), Stop::new());
        let aim =
            PlannedRun { x0: &[1.0], inputs: &[0.0; 4], m: 1, target: &[0.0], noise: true, window: None, gain: None };
        assert_eq!(drawn_misses(&law, aim, &key, 2, 1, &stop).unwrap(), [f64::INFINITY; 2]);
        for wrong in [
            PlannedRun { x0: &[], ..aim },
            PlannedRun { m: 0, ..aim },
            PlannedRun { gain: Some(&[1.0; 3]), ..aim },
            PlannedRun { m: 2, ..aim },
            PlannedRun { target: &[0.0; 2], ..aim },
            PlannedRun { x0: &[f64::NAN], ..aim },
        ] {
            assert!(drawn_misses(&law, wrong, &key, 2, 1, &stop).is_err());
        }
        stop.request();
        assert_eq!(drawn_misses(&law, aim, &key, 2, 1, &stop), Err(Error::Interrupted));
    }
}
