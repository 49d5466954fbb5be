//! How many rows fill the filters of a window.

use crate::error::{Error, Result};
use crate::identify::fit;
use crate::memory::{try_filled, try_zeros};
use crate::parallel::Stop;

use super::shape::{Kind, LARGEST, WHAT, Window};

/// The least b with `P(Bin(b, 1 - a) < r) ratio <= sqrt((1 - a^2) / pieces)`, `ratio` the range of the readings over
/// the deviation of the noise: what the start values leave in all pieces together is then about one deviation.
///
/// # Errors
/// [`Error::Value`] for a pole outside (0, 1), a ratio that is negative or not finite, or b > `LARGEST`;
/// [`Error::Interrupted`].
pub(super) fn burn(pole: f64, count: usize, ratio: f64, pieces: usize, stop: &Stop) -> Result<usize> {
    if !(pole > 0.0 && pole < 1.0 && ratio >= 0.0 && ratio.is_finite()) {
        let found = format!("{pole} and {ratio}");
        return Err(Error::Value { name: "pole", expected: "in (0, 1), with a finite ratio", found });
    }
    let most = ((1.0 - pole * pole) / pieces.max(1) as f64).sqrt();
    let slow = || {
        let expected = "a pole and a number of filters that at most 65536 rows fill: a smaller pole, or fewer";
        Error::Value { name: "filters", expected, found: format!("({pole}, {count})") }
    };
    // the median of Bin(b, 1 - a) is below b (1 - a) + 1: a chance of at least 1/2 is left
    if LARGEST as f64 * (1.0 - pole) + 2.0 <= count as f64 && 0.5 * ratio > most {
        return Err(slow());
    }
    // P(Bin(b, 1 - a) = k) for k < r
    let mut chances = try_zeros::<f64>(WHAT, count.max(1))?;
    chances[0] = 1.0;
    let mut b = 0;
    while chances.iter().take(b + 1).sum::<f64>() * ratio > most {
        stop.check()?;
        if b == LARGEST {
            return Err(slow());
        }
        for k in (0..chances.len().min(b + 2)).rev() {
            let before = if k > 0 { chances[k - 1] } else { 0.0 };
            chances[k] = pole * chances[k] + (1.0 - pole) * before;
        }
        b += 1;
    }
    Ok(b)
}

/// The largest range of a reading over the deviation of its noise, in the `pairs` (y, u, y one step later), `first` as
/// in [`Window::rows`]; the noise is that of a model of lags.
///
/// # Errors
/// As [`fit`].
pub(super) fn readings_over_noise(
    pairs: &[f64],
    first: &[bool],
    outputs: usize,
    inputs: usize,
    intercept: bool,
    stop: &Stop,
) -> Result<f64> {
    const LAGS: usize = 6;
    let width = 2 * outputs + inputs;
    let mut ends = try_filled(WHAT, [f64::INFINITY, f64::NEG_INFINITY], outputs)?;
    for pair in pairs.chunks_exact(width.max(1)) {
        for (i, [least, most]) in ends.iter_mut().enumerate() {
            for read in [pair[i], pair[outputs + inputs + i]] {
                (*least, *most) = (least.min(read), most.max(read));
            }
        }
    }
    for lags in (1..=LAGS).rev() {
        let window = Window::new(outputs, inputs, Kind::Lags(lags), 0, intercept, 0)?;
        let (rows, filled) = window.rows(pairs, first)?;
        let d = window.length();
        if filled.len() < 3 * d && lags > 1 {
            continue;
        }
        let f = fit(&rows, d + outputs, d, filled.len(), 1, stop)?;
        let degrees = f.degrees().max(1) as f64;
        // noise below rounding counts as rounding
        let deviation = |i: usize| f.residual[i * (outputs + 1)].sqrt().max(f.rounding[i]) / degrees.sqrt();
        let ratios = ends.iter().enumerate().map(|(i, [least, most])| (most - least) / deviation(i));
        return Ok(ratios.filter(|ratio| ratio.is_finite()).fold(0.0, f64::max));
    }
    Ok(0.0)
}
