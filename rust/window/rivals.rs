//! Other windows of the same log that predict better than that of a model.

use crate::error::Result;
use crate::identify::{Fitted, fit, log_determinant};
use crate::memory::{try_collect, try_extend};
use crate::parallel::Stop;

use super::log_tests::Log;
use super::{Kind, Window};

const WHAT: &str = "windows of a log";
/// Lags that filters are compared with.
const SHORT: [usize; 3] = [2, 4, 8];
/// The ratio of the errors from which on lags are taken.
const WORSE: f64 = 2.0;
/// The share of the rows whose errors are compared.
const LAST: usize = 4;

/// A window of another kind or delay that is filled after as many pairs and its delay.
fn beside(of: &Window, kind: Kind, delay: usize) -> Result<Window> {
    Window::new(of.outputs(), of.inputs(), kind, delay, of.intercept(), of.fill() - of.delay())
}

/// The rows (z, y) of complete windows, and how many entries of these are of the `first` pairs.
fn parted(log: &Log<'_>, window: &Window, first: usize) -> Result<(Vec<f64>, usize)> {
    let (rows, at) = log.rows(window)?;
    Ok((rows, at.partition_point(|&t| t < first) * (window.length() + log.n)))
}

/// The size of the errors of the last `count` of the first rows by a fit of those before, of all outputs in their
/// units; infinite where nothing is fitted.
fn size(log: &Log<'_>, window: &Window, first: usize, count: usize, stop: &Stop) -> Result<f64> {
    let ((rows, end), n, d) = (parted(log, window, first)?, log.n, window.length());
    let (rows, width) = (&rows[..end], d + n);
    if count <= n || rows.len() / width < count + 2 * d {
        return Ok(f64::INFINITY);
    }
    let (head, tail) = rows.split_at(rows.len() - count * width);
    let fitted = fit(head, width, d, head.len() / width, 1, stop)?;
    let mut errors = Vec::new();
    for row in tail.chunks_exact(width) {
        let off =
            |i: usize| row[d + i] - fitted.model[i * d..(i + 1) * d].iter().zip(row).map(|(a, b)| a * b).sum::<f64>();
        try_extend(WHAT, &mut errors, (0..n).map(off))?;
    }
    let product = |at: usize| errors.chunks_exact(n).map(|row| row[at / n] * row[at % n]).sum::<f64>();
    let square = try_collect(WHAT, (0..n * n).map(|at| product(at) / count as f64))?;
    Ok(log_determinant(&square, n)?.map_or(0.0, |log| (log / (2 * n) as f64).exp()))
}

/// Whether filters, of which the first pairs chose so many, predict the last quarter of these much worse than a few
/// lags.
///
/// Both are fitted to those before. A criterion counts unknowns, while slow filters of a short log follow whatever went
/// on in it.
pub(super) fn overfitted(log: &Log<'_>, window: &Window, chosen: usize, first: usize, stop: &Stop) -> Result<bool> {
    let Some(pole) = window.pole() else { return Ok(false) };
    let own = beside(window, Kind::Filters { pole, count: chosen }, window.delay())?;
    let count = parted(log, &own, first)?.1 / (own.length() + log.n) / LAST;
    let worst = size(log, &own, first, count, stop)?;
    let mut least = f64::INFINITY;
    for lags in SHORT.into_iter().filter(|lags| *lags <= window.fill() - window.delay()) {
        let short = beside(window, Kind::Lags(lags), window.delay())?;
        least = least.min(size(log, &short, first, count, stop)?);
    }
    Ok(WORSE * least < worst && worst < f64::INFINITY)
}

/// Whether inputs that act so late alone leave smaller residuals than a window, of which these are the estimates.
pub(super) fn later(
    log: &Log<'_>,
    window: &Window,
    delay: usize,
    first: usize,
    plain: &Fitted,
    stop: &Stop,
) -> Result<bool> {
    let late = beside(window, Kind::of(window.pole(), window.count()), delay)?;
    let ((rows, begin), d, n) = (parted(log, &late, first)?, late.length(), log.n);
    let (rows, count) = (&rows[begin..], (rows.len() - begin) / (d + n));
    if count <= d + n {
        return Ok(false);
    }
    let fitted = fit(rows, d + n, d, count, 1, stop)?;
    let of = |f: &Fitted| log_determinant(&try_collect(WHAT, f.residual.iter().map(|v| v / f.size as f64))?, n);
    Ok(of(&fitted)? < of(plain)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `y+ = 0.5 y + u(t - delay) + w`, as pairs.
    fn pairs(delay: usize) -> Vec<f64> {
        let at = |t: usize, k: f64| (k * t as f64 * t as f64 + t as f64).sin();
        let (mut pairs, mut y) = (Vec::new(), 0.0);
        for t in 0..120 {
            let acting = if t >= delay { at(t - delay, 1.7) } else { 0.0 };
            let next = 0.5 * y + acting + 0.1 * at(t, 0.9);
            pairs.extend([y, at(t, 1.7), next]);
            y = next;
        }
        pairs
    }

    fn of<T>(pairs: &[f64], work: impl FnOnce(&Log<'_>) -> T) -> T {
        let places: Vec<usize> = (0..120).collect();
        work(&Log { pairs, places: &places, runs: &[0; 120], n: 1, m: 1 })
    }

    #[test]
    fn the_errors_of_the_last_rows_are_those_of_the_normal_equations() {
        let pairs = pairs(0);
        let window = Window::new(1, 1, Kind::Lags(1), 0, false, 0).unwrap();
        let found = of(&pairs, |log| size(log, &window, 100, 25, &Stop::new()).unwrap());
        let sum = |a: usize, b: usize| pairs.chunks(3).take(75).map(|row| row[a] * row[b]).sum::<f64>();
        let det = sum(0, 0) * sum(1, 1) - sum(0, 1).powi(2);
        let a = (sum(1, 1) * sum(0, 2) - sum(0, 1) * sum(1, 2)) / det;
        let b = (sum(0, 0) * sum(1, 2) - sum(0, 1) * sum(0, 2)) / det;
        let square =
            pairs.chunks(3).skip(75).take(25).map(|row| (row[2] - a * row[0] - b * row[1]).powi(2)).sum::<f64>() / 25.0;
        assert!((found - square.sqrt()).abs() < 1e-12, "{found} {square}");
        let few = of(&pairs, |log| size(log, &window, 100, 1, &Stop::new()).unwrap());
        assert_eq!(few, f64::INFINITY); // as many rows as outputs
    }

    #[test]
    fn slow_filters_of_a_fast_plant_are_worse_than_lags() {
        let filters = |pole| Window::new(1, 1, Kind::Filters { pole, count: 2 }, 0, false, 12).unwrap();
        let worse = |pole| of(&pairs(0), |log| overfitted(log, &filters(pole), 2, 100, &Stop::new()).unwrap());
        assert_eq!([0.95, 0.05].map(worse), [true, false]);
        let lags = Window::new(1, 1, Kind::Lags(2), 0, false, 0).unwrap();
        assert!(!of(&pairs(0), |log| overfitted(log, &lags, 1, 100, &Stop::new()).unwrap()));
    }

    #[test]
    fn a_delay_leaves_less_where_inputs_are_late() {
        let pairs = pairs(3);
        let window = Window::new(1, 1, Kind::Lags(1), 0, false, 0).unwrap();
        let plain = of(&pairs, |log| {
            let rows = log.rows(&window).unwrap().0;
            fit(&rows, 3, 2, 120, 1, &Stop::new()).unwrap()
        });
        let by = |delay| of(&pairs, |log| later(log, &window, delay, 0, &plain, &Stop::new()).unwrap());
        assert_eq!([3, 0, 118].map(by), [true, false, false]);
    }
}
