//! One `M` for many problems. Threads take fixed chunks, so results do not depend on their number.

use super::bounds::Bounds;
use super::dense::Dense;
use super::quadratic::Until;
use super::search::Search;
use super::solve::{Penalty, aim, checked_rows, find, stacked};
use super::tables::tables;
use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::{Stop, for_each_chunk};

const WHAT: &str = "the controls within limits";

/// Problems that one thread takes at a time.
const CHUNK: usize = 1024;

/// Controls row by row, and the gap of each if asked for.
pub type Batch = (Vec<f64>, Option<Vec<f64>>);

/// The least `||M u - y||^2 + u' R u` within `bounds` for each of the `size` rows of `y`.
///
/// # Errors
/// As [`super::box_control`], and [`Error::Interrupted`].
#[expect(clippy::too_many_arguments, reason = "one call, named in the package")]
pub fn box_batch(
    m: &[f64],
    y: &[f64],
    size: usize,
    r: Penalty<'_>,
    bounds: Bounds<'_>,
    gaps: bool,
    threads: usize,
    stop: &Stop,
) -> Result<Batch> {
    let d = bounds.low.len();
    let (mut dense, rows) = stacked(m, d, r)?;
    checked_rows("y", y.len(), size, rows)?;
    dense.invert(Until::new(stop, None))?;
    let table = tables(&mut dense, bounds, rows, stop)?;
    let dense = &dense;
    let work = |first: usize, u: &mut [f64], mut gaps: Option<&mut [f64]>| {
        let y = &y[first * rows..(first + u.len() / d) * rows];
        require_finite("y", y)?;
        let missing = match &table {
            Some(table) if rows > 0 => table.solve(y, u, gaps.as_deref_mut()),
            _ => {
                u.fill(f64::NAN);
                u.len()
            }
        };
        if missing == 0 {
            return Ok(());
        }
        let (mut dense, mut search) = (dense.try_clone()?, Search::new(d)?);
        for (i, u) in u.chunks_exact_mut(d).enumerate().filter(|(_, u)| u[0].is_nan()) {
            stop.check()?;
            aim(&mut dense, rows, &y[i * rows..(i + 1) * rows])?;
            single(&mut dense, &mut search, bounds, u, gaps.as_deref_mut().map(|gaps| &mut gaps[i]), stop)?;
        }
        Ok(())
    };
    let mut u = try_zeros(WHAT, checked_len(WHAT, size, d)?)?;
    let mut all = if gaps { Some(try_zeros(WHAT, size)?) } else { None };
    let mut slots = all.as_mut().map(|gaps: &mut Vec<f64>| gaps.chunks_mut(CHUNK));
    let chunks = u.chunks_mut(CHUNK * d).enumerate().map(move |(c, u)| (c, u, slots.as_mut().and_then(Iterator::next)));
    for_each_chunk(chunks, threads, stop, |(c, u, gaps)| work(c * CHUNK, u, gaps))?;
    Ok((u, all))
}

pub(super) fn single(
    dense: &mut Dense,
    search: &mut Search,
    bounds: Bounds<'_>,
    u: &mut [f64],
    gap: Option<&mut f64>,
    stop: &Stop,
) -> Result<()> {
    let (early, found) = find(dense, search, bounds, None, Until::new(stop, None))?;
    if early.is_some() {
        return Err(Error::Interrupted);
    }
    u.copy_from_slice(&search.u);
    if let Some(gap) = gap {
        *gap = found.gap;
    }
    Ok(())
}
