//! Which window: by Akaike's criterion on the first part of the data, then made longer.

use crate::error::{Error, Result};
use crate::identify::{fit, log_determinant, triangle};
use crate::memory::{try_collect, try_extend, try_room};
use crate::parallel::Stop;

use super::burn::{burn, readings_over_noise};
use super::shape::{Kind, WHAT, Window};

/// What is declared of a window.
#[derive(Debug, Clone, Copy)]
pub enum Past {
    /// The window, and how many of the first pairs are not the model's.
    Known(Window, usize),
    /// So many lags.
    Lags(usize),
    /// The pole of so many filters, of which the first pairs say how long they fill.
    Filters(f64, usize),
    /// The first pairs choose; whether filters are tried beside lags.
    Chosen(bool),
}

/// The windows to choose from.
#[derive(Clone, Copy)]
pub(super) struct Search<'a> {
    /// The number of outputs.
    pub outputs: usize,
    /// The number of inputs.
    pub inputs: usize,
    /// Whether z has a 1.
    pub intercept: bool,
    /// The poles of filters, in (0, 1); lags are always tried.
    pub poles: &'a [f64],
    /// The largest number of filters.
    pub filters: usize,
    /// The largest number of lags.
    pub lags: usize,
    /// The least and the largest delay.
    pub delays: [usize; 2],
    /// Into how many pieces all data are divided, and the median of their lengths.
    pub pieces: [usize; 2],
}

/// The window that was chosen, and its length before it was made longer.
pub(super) struct Choice {
    /// The window, with more filters or lags than the criterion asked for.
    pub window: Window,
    /// The lags or filters that the criterion asked for.
    pub found: usize,
    /// The rows over which windows were compared.
    pub rows: usize,
}

/// Lags or filters of one pole, and how many are tried.
struct Family {
    pole: Option<f64>,
    most: usize,
    fill: usize,
}

/// The least `N log det(S / N) + 2 n_y d` over rows that all windows have, then `ceil(1.5 r) + 1` for r: windows that
/// are too short break every statement, those that are too long only widen it.
///
/// Windows of which more than half of the median piece would only fill the filters are left out, and those with fewer
/// than two rows for each unknown. Where that leaves none, since the longest window leaves too few rows to compare,
/// those that take more than a quarter of the rows to fill are left out as well.
///
/// # Errors
/// [`Error::Value`] where the `pairs` are too few for any window; as [`Window::rows`] and [`fit`].
pub(super) fn choose(pairs: &[f64], first: &[bool], of: Search<'_>, stop: &Stop) -> Result<Choice> {
    let (n, m) = (of.outputs, of.inputs);
    let ratio = readings_over_noise(pairs, first, n, m, of.intercept, stop)?;
    let (rows, half) = (first.len(), of.pieces[1] / 2);
    let quarter = rows / (4 * first.iter().filter(|&&begins| begins).count().max(1));
    for most in [half, half.min(quarter)] {
        if let Some(choice) = least(pairs, first, of, ratio, most, stop)? {
            return Ok(choice);
        }
    }
    // a quarter of the rows fills windows, of the others there are two for each unknown
    let compared = 2 * (2 * n + m + usize::from(of.intercept)) + of.delays[1];
    let needed = compared + compared.div_ceil(3);
    let (expected, found) = if rows < needed {
        let found = format!("{rows} pairs in the first quarter, where the choice of a window needs {needed}");
        ("longer, or the window declared by lags= or filters=", found)
    } else {
        let found = "pieces in the first quarter that are too short to compare windows, or without noise".to_owned();
        ("in longer pieces, or the window declared by lags= or filters=", found)
    };
    Err(Error::Value { name: "data", expected, found })
}

/// The least criterion of all windows that are filled by `half` pairs, if it can be computed for any.
fn least(
    pairs: &[f64],
    first: &[bool],
    of: Search<'_>,
    ratio: f64,
    half: usize,
    stop: &Stop,
) -> Result<Option<Choice>> {
    let (n, m) = (of.outputs, of.inputs);
    let fill = |pole: Option<f64>, count: usize| match pole {
        None => Ok(count.saturating_sub(1)),
        Some(pole) => burn(pole, count, ratio, of.pieces[0], stop),
    };
    let mut families = try_room(WHAT, of.poles.len() + 1)?;
    for pole in std::iter::once(None).chain(of.poles.iter().copied().map(Some)) {
        let mut family = Family { pole, most: 0, fill: 0 };
        for count in 1..=if pole.is_none() { of.lags } else { of.filters } {
            let own = fill(pole, count)?;
            if own > half || fill(pole, longer(count))? + 2 > of.pieces[1] {
                break;
            }
            (family.most, family.fill) = (count, own);
        }
        families.push(family);
    }
    let common = of.delays[1] + families.iter().map(|one| one.fill).max().unwrap_or(0);
    let mut best: Option<(f64, Option<f64>, usize, usize)> = None;
    let mut compared = 0;
    for delay in of.delays[0]..=of.delays[1] {
        for family in families.iter().filter(|one| one.most > 0) {
            stop.check()?;
            let window = Window::new(n, m, Kind::of(family.pole, family.most), delay, of.intercept, family.fill)?;
            let (rows, places) = window.filled_after(common).rows(pairs, first)?;
            compared = places.len();
            let wide = window.length() + n;
            let r = triangle(&rows, wide, 1, stop)?;
            for count in 1..=family.most {
                let d = count * (n + m) + usize::from(of.intercept);
                if compared < 2 * (d + n) {
                    break;
                }
                let inputs = family.most * n;
                let keep = || {
                    let own = (0..count * n).chain(inputs..inputs + count * m);
                    own.chain(family.most * (n + m)..wide)
                };
                let mut some = try_room(WHAT, wide * (d + n))?;
                for row in r.chunks_exact(wide) {
                    try_extend(WHAT, &mut some, keep().map(|j| row[j]))?;
                }
                let f = fit(&some, d + n, d, compared, 1, stop)?;
                let scaled = try_collect(WHAT, f.residual.iter().map(|v| v / compared as f64))?;
                let Some(log_det) = log_determinant(&scaled, n)? else { continue };
                let criterion = compared as f64 * log_det + 2.0 * (n * d) as f64;
                if best.is_none_or(|(lowest, ..)| criterion < lowest) {
                    best = Some((criterion, family.pole, count, delay));
                }
            }
        }
    }
    let Some((_, pole, found, delay)) = best else { return Ok(None) };
    let count = longer(found);
    let kind = Kind::of(pole, count);
    let window = Window::new(n, m, kind, delay, of.intercept, fill(pole, count)?)?;
    Ok(Some(Choice { window, found, rows: compared }))
}

/// `ceil(1.5 r) + 1`.
const fn longer(count: usize) -> usize {
    (3 * count).div_ceil(2) + 1
}
