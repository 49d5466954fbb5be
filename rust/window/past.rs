//! The window of a model: as declared, or chosen by the first part of its log.

use crate::error::{Error, Result};
use crate::memory::{try_collect, try_push};
use crate::parallel::Stop;

use super::burn::{burn, readings_over_noise};
use super::log_tests::{Declarations, Log};
use super::order::{Past, Search, choose};
use super::shape::{Kind, WHAT, Window};

/// Of filters that are tried.
const POLES: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 0.9];
/// The most filters and lags that are tried.
const MOST: (usize, usize) = (6, 12);
/// Lags or filters of which two rows for each unknown are enough for a choice.
const COMPARED: usize = 3;
/// The first quarter of the pairs chooses.
const SHARE: usize = 4;
/// Filters that use up more than a quarter of the median piece give way to lags.
const FILLED: usize = 4;

/// A window, the count that the first pairs asked for before it was made longer, and the number of these pairs.
pub(super) type Found = (Window, Option<usize>, usize);

/// The window of a log.
pub(super) fn window(of: &Declarations<'_>, stop: &Stop) -> Result<Found> {
    let Declarations { log, past, delays, intercept, read, .. } = *of;
    let (n, m) = (log.n, log.m);
    let (share, poles) = match past {
        Past::Known(window, first) => return Ok((window, None, first)),
        Past::Lags(count) => {
            return Ok((Window::new(n, m, Kind::Lags(count), delays[0], intercept, 0)?, None, 0));
        }
        Past::Filters(..) => (2 * SHARE, &[][..]),
        Past::Chosen(filters) => (SHARE, if filters { &POLES[..] } else { &[] }),
    };
    let first = log.size().div_ceil(share);
    let pairs = &log.pairs[..first * (2 * n + m)];
    let begins = try_collect(WHAT, log.places[..first].iter().map(|&place| place == 0))?;
    let pieces = pieces(&log)?;
    if let Past::Filters(pole, count) = past {
        let ratio = readings_over_noise(pairs, &begins, n, m, intercept, stop)?;
        let fill = burn(pole, count, ratio, pieces.len(), stop)?;
        return Ok((Window::new(n, m, Kind::Filters { pole, count }, delays[0], intercept, fill)?, None, first));
    }
    let median = (pieces[(pieces.len() - 1) / 2] + pieces[pieces.len() / 2]) / 2;
    let (filters, lags) = if read { MOST } else { (0, 1) };
    let pieces = [pieces.len(), median];
    let all = Search { outputs: n, inputs: m, intercept, poles, filters, lags, delays, pieces };
    let mut choice = choose(pairs, &begins, all, stop)?;
    if !read {
        let states = Window::new(n, m, Kind::Lags(1), choice.window.delay(), intercept, 0)?;
        return Ok((states, None, first)); // they say all of the past but the inputs under way
    }
    if choice.window.pole().is_some() && FILLED * (choice.window.fill() - choice.window.delay()) > median {
        choice = choose(pairs, &begins, Search { poles: &[], ..all }, stop)?;
    }
    // two rows for each unknown of a longer window, or nothing says that a short one is enough
    let needed = 2 * (COMPARED.min(choice.found + 1) * (n + m) + usize::from(intercept) + n);
    if choice.rows < needed {
        let more = SHARE * (first + needed - choice.rows);
        let found = format!("{} pairs, and needs {more} to choose one", log.size());
        return Err(Error::Value { name: "data", expected: "longer, or Window(lags=) declared", found });
    }
    Ok((choice.window, Some(choice.found), first))
}

/// The lengths of the pieces of a log, rising.
fn pieces(log: &Log<'_>) -> Result<Vec<usize>> {
    let mut found = Vec::new();
    for &place in log.places {
        match found.last_mut() {
            Some(length) if place > 0 => *length = place + 1,
            _ => try_push(WHAT, &mut found, 1)?,
        }
    }
    found.sort_unstable();
    Ok(found)
}

impl Window {
    /// Why no pair behind the `first` ones has a complete window, pairs being at these places of their pieces.
    #[must_use]
    pub fn too_long(&self, places: &[usize], first: usize) -> Error {
        let longest = places.iter().max().map_or(0, |place| place + 1);
        let kind = if self.pole().is_none() { "lags" } else { "filters" };
        let mut found = format!("at most {longest}, {} of which fill {} {kind}", self.fill(), self.count());
        if longest > self.fill() {
            found += &format!(", and none left behind the first {first} pairs");
        }
        Error::Value { name: "data", expected: "in pieces of more pairs than a window needs", found }
    }
}
