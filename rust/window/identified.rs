//! A model from a log: its window, its estimates, and the tests of the log.

use std::borrow::Cow;
use std::sync::Arc;

use super::far_cells::far_cells;
use super::log_tests::{Declarations, LEVEL, Log, log_tests, put};
use super::order::Past;
use super::past::window;
use super::rivals::{later, overfitted};
use super::{Kind, Window};
use crate::Key;
use crate::error::{Error, Result};
use crate::identify::{Data, Estimate, Fitted, STATISTICS, Test, first_pairs, fit, residual_checks, triangle};
use crate::memory::try_push;
use crate::parallel::Stop;

/// How residuals are tested: by so many data sets from a key, of at most so many normal variates.
pub type Simulated = (usize, Key, f64);

/// What is found of a log.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Identified {
    /// From what the model predicts: one lag for states.
    pub window: Window,
    /// The lags or filters that the first pairs asked for.
    pub found: Option<usize>,
    /// How many of the first pairs are not the model's.
    pub first: usize,
    /// Whether z is expected to be of size 1, since the pairs are too few to say more.
    pub unit: bool,
    /// The number of its pairs.
    pub size: usize,
    /// From all of its pairs.
    pub estimate: Arc<Estimate>,
    /// From the pairs that say the size of the others, and from these.
    pub parts: Option<[Arc<Estimate>; 2]>,
    /// Least squares without regard to known entries.
    pub plain: Arc<Fitted>,
    /// The tests of the log.
    pub tests: Vec<Test>,
    /// Whether inputs that act as late as the test "dead time" says, and not earlier, leave smaller residuals.
    pub later: bool,
    /// Of the residuals, see [`residual_checks`].
    pub checks: Option<[[f64; STATISTICS]; 2]>,
}

impl Identified {
    /// The model of a log, or what else is found of a model whose triangle is `made` already; `known` entries as in
    /// [`Data`].
    ///
    /// # Errors
    /// [`Error::Value`] for pairs that are too few for a window, or to choose one; [`Error::Overflow`] for their
    /// squares; and those of [`Estimate::new`] and [`residual_checks`].
    pub fn new(
        of: &Declarations<'_>,
        known: Option<&[f64]>,
        made: Option<&[f64]>,
        simulated: Option<Simulated>,
        threads: usize,
        stop: &Stop,
    ) -> Result<Self> {
        let (log, (window, found, mut first)) = (of.log, window(of, stop)?);
        let (n, d, offset) = (log.n, window.length(), window.intercept());
        let width = d + n;
        let plain = window.count() == 1 && window.fill() == 0 && window.pole().is_none() && !offset;
        let (rows, at) = if plain {
            (Cow::Borrowed(log.pairs), Vec::new())
        } else {
            let (rows, at) = log.rows(&window)?;
            (Cow::Owned(rows), at)
        };
        // the rows of the pairs before this one
        let before = |pair: usize| if plain { pair } else { at.partition_point(|&t| t < pair) };
        let mut sized = of.scaled;
        if of.windowed && !sized && !of.piloted && !matches!(of.past, Past::Known(..)) {
            match first_pairs(&rows, width, d, threads, stop)? {
                None => sized = true,
                Some(asked) if asked > before(first) => first = if plain { asked } else { at[asked] },
                Some(_) => {}
            }
        }
        if let Some(chosen) = found
            && overfitted(&log, &window, chosen, first, stop)?
        {
            let of = Declarations { past: Past::Chosen(false), ..*of };
            return Self::new(&of, known, made, simulated, threads, stop);
        }
        let (head, own) = rows.split_at(before(first) * width);
        if own.is_empty() {
            return Err(window.too_long(log.places, first));
        }
        if !own.iter().map(|v| v * v).sum::<f64>().is_finite() {
            return Err(Error::Overflow { what: "the sum of squares of the data" });
        }
        let size = own.len() / width;
        let estimated = |triangle: &[f64], size| {
            let m = d - n - usize::from(offset);
            Estimate::new(Data { triangle, size, n, m, offset, known }, stop).map(Arc::new)
        };
        let of_rows = |rows: &[f64]| estimated(&triangle(rows, width, threads, stop)?, rows.len() / width);
        let estimate = made.map_or_else(|| of_rows(own), |made| estimated(made, size))?;
        let parts = if sized || of.exact || of.piloted || (of.windowed && head.is_empty()) {
            None
        } else if of.windowed {
            Some([of_rows(head)?, Arc::clone(&estimate)])
        } else if let Some(count) = first_pairs(own, width, d, threads, stop)? {
            let (head, rest) = own.split_at(count * width);
            Some([of_rows(head)?, of_rows(rest)?])
        } else {
            None
        };
        let plain = match known {
            None => Arc::clone(&estimate.blocks[0]),
            Some(_) => Arc::new(fit(&estimate.triangle, width, d, size, 1, stop)?),
        };
        let checks = match simulated {
            Some((draws, key, most)) if (draws * size * n) as f64 <= most => {
                residual_checks(own, width, d, of.tested, draws, &key, threads, stop)?
            }
            _ => None,
        };
        let mut tests = log_tests(of, &window, first, &plain, stop)?;
        if of.windowed && tests.iter().all(|test| test.name != "spikes") {
            spikes(of, &window, first, &mut tests, (threads, stop))?;
        }
        if let Some(test) = far_cells(&of.whole.unwrap_or(log))? {
            put(&mut tests, test)?;
        }
        let late = tests.iter().find(|test| test.name == "dead time" && test.p_value <= LEVEL);
        let later = match late.and_then(|test| test.at.first()).filter(|lag| of.read && **lag >= window.delay()) {
            Some(lag) => later(&log, &window, *lag, first, &plain, stop)?,
            None => false,
        };
        let unit = sized && !of.scaled;
        Ok(Self { window, found, first, unit, size, estimate, parts, plain, tests, later, checks })
    }
}

/// Spikes that the tests of the fit do not see: those of the first part, which tells the window and the scale, and
/// those that filters remember, by a model of lags.
fn spikes(
    of: &Declarations<'_>,
    window: &Window,
    first: usize,
    found: &mut Vec<Test>,
    (threads, stop): (usize, &Stop),
) -> Result<()> {
    let (Log { n, m, .. }, mut own, mut end) = (of.log, *window, first);
    if window.pole().is_some() {
        own = Window::new(n, m, Kind::Lags(3), window.delay(), window.intercept(), 0)?;
        end = of.log.places.len();
    }
    let Log { pairs, places, runs, .. } = of.log;
    let log = Log { pairs: &pairs[..end * (2 * n + m)], places: &places[..end], runs: &runs[..end], n, m };
    let ((rows, at), d) = (log.rows(&own)?, own.length());
    if at.len() < 3 * d {
        return Ok(());
    }
    let fitted = fit(&triangle(&rows, d + n, threads, stop)?, d + n, d, at.len(), threads, stop)?;
    let of = Declarations { log, whole: None, piloted: false, ..*of };
    if let Some(test) = log_tests(&of, &own, 0, &fitted, stop)?.into_iter().find(|test| test.name == "spikes") {
        found.retain(|test| test.name != "wrap");
        try_push("the tests of a log", found, test)?;
    }
    Ok(())
}
