//! Many steps with limits on inputs, on their changes and on states: a sparse interior point proposes, one linear
//! system for the active limits corrects, and the certificate is computed from the data.
//!
//! For any `u` within all limits, multipliers `l >= 0` of its rows `C u <= c`, `e = J'(u) + C' l` and
//! `s = l' (c - C u)`: `J(u) - min J <= s + ||e||^2_{H^-1} / 4` and
//! `||u - u*||_H <= (||e||_{H^-1} + (||e||^2_{H^-1} + 8 s)^(1/2)) / 4`. Proof:
//! `J(v) + l' (C v - c) = J(u) - s + <e, v - u> + ||v - u||_H^2` for all `v`. Limits on states hold to rounding only;
//! the certificate is then for limits that are wider by this rounding. With soft limits `J'` has their weight and `H`
//! has not.

mod assembly;
mod missing;
mod polish;
mod program;
mod search;
mod task;

#[cfg(test)]
mod tests;

pub use assembly::KINDS;
pub use task::Rows;
pub(super) use task::{KEPT, Within, clipped};

use assembly::{Aim, FAR, Kind, Row};
use program::Program;
use search::{GOOD, Search};
use task::{Task, WHAT};

use super::bounds::Bounds;
use super::quadratic::{Method, Status, Until};
use super::riccati::closed::Followed;
use super::riccati::{Riccati, Steps};
use super::solve::{Solution, or_ended, told};
use crate::error::{Error, Result};
use crate::memory::{try_copy, try_zeros};

/// Limits on states that cannot be met are widened by what is missing, and this share of it, so that there is room.
const ROOM: f64 = 1e-7;

const SINGULAR: &str = "an input has no weight at some step, and the system grows: give R > 0";

/// A control, and what it says about limits that are not of single inputs.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
#[must_use]
pub struct RowsSolution {
    /// The control, and its certificate; of limits that cannot be met: with these wider by `missing`.
    pub found: Solution,
    /// Nothing, and multipliers of `u(k) - u(k-1)` (K m) and of the states (K, n), above 0 at the upper limit, below at
    /// the lower; empty without such limits.
    pub rows: [Vec<f64>; KINDS],
    /// The least largest excess of limits on states that cannot be met; 0 if they can.
    pub missing: f64,
    /// The largest excess of a limit on states by the control.
    pub excess: f64,
    /// How to follow the control, where the system grows.
    pub followed: Option<Followed>,
}

impl Search<'_, '_> {
    /// Proposes and corrects, until there is nothing to gain.
    fn run(&mut self, until: Until<'_>) -> Result<Option<Status>> {
        if let Some(early) = until.reached() {
            return Ok(Some(early));
        }
        let mut count = usize::MAX;
        for far in FAR {
            if self.best.as_ref().is_some_and(|best| best.merit <= GOOD) {
                break;
            }
            let (program, rows) = self.task.whole(Aim::Best, far)?;
            if count == rows.len() {
                break;
            }
            count = rows.len();
            if let Some(early) = self.propose(program, &rows, until)? {
                return Ok(Some(early));
            }
        }
        Ok(None)
    }

    fn propose(&mut self, program: Program, rows: &[Row], until: Until<'_>) -> Result<Option<Status>> {
        let point = program.solve(until)?;
        self.iterations += point.iterations;
        let (u, x, multipliers, held) = self.task.read(&point, rows, Aim::Best)?;
        self.verify((&u, &x), &multipliers, Method::Interior, until)?;
        if point.timed_out {
            return Ok(Some(Status::Limit));
        }
        if u.iter().chain(&multipliers[Kind::Input as usize]).any(|v| !v.is_finite()) {
            return Ok(None);
        }
        self.polish((u, x), multipliers, held, until)
    }

    /// The same, with a stop as a status. A solver that fails leaves what there is.
    fn try_run(&mut self, until: Until<'_>) -> Result<Option<Status>> {
        match self.run(until) {
            Err(Error::Numerical(_)) => Ok(None),
            other => or_ended(other, until),
        }
    }
}

/// The best inputs of a horizon within `bounds` (K m), step by step, and within `rows`.
///
/// # Errors
/// As [`super::horizon_control`], and [`Error::Value`] for `rate`, `previous`, `state_low` and `soft`.
pub fn rows_control(horizon: &Steps<'_>, bounds: Bounds<'_>, rows: Rows<'_>, until: Until<'_>) -> Result<RowsSolution> {
    let first = found(horizon, bounds, rows, until)?;
    if rows.grows || first.found.status != Status::Inaccurate {
        return Ok(first);
    }
    match found(horizon, bounds, Rows { grows: true, ..rows }, until) {
        Ok(again) if again.found.gap < first.found.gap => Ok(again),
        Ok(_) | Err(Error::Numerical(_) | Error::Interrupted) => Ok(first),
        Err(other) => Err(other),
    }
}

/// The same, in one of both ways.
fn found(horizon: &Steps<'_>, bounds: Bounds<'_>, rows: Rows<'_>, until: Until<'_>) -> Result<RowsSolution> {
    let mut q = if rows.grows { Riccati::growing(horizon)? } else { Riccati::new(horizon)? };
    let task = Task::new(*horizon, bounds, rows)?;
    let none = task.zeros()?;
    let origin = try_zeros(WHAT, task.steps * task.n)?;
    let mut search = Search::new(&task, &mut q)?;
    if rows.grows && !search.q.free(&search.fixed, until)? {
        return Err(Error::Numerical(SINGULAR.into()));
    }
    search.verify((&none[Kind::Input as usize], &origin), &none, Method::Interior, until)?;
    let mut early = search.try_run(until)?;
    let mut missing = 0.0;
    let unmet = early.is_none()
        && task.hard()
        && search.best.as_ref().is_some_and(|best| best.excess.units > 0.0 && best.merit > KEPT);
    let mut widened = None;
    if unmet {
        match search.least(until) {
            Ok((u, x, amount, sure)) => {
                search.verify((&u, &x), &none, Method::Interior, until)?;
                if sure && amount.units > 0.0 {
                    missing = amount.value;
                    widened = Some((task.widened(amount.units * (1.0 + ROOM))?, u, x));
                }
            }
            Err(Error::Interrupted) => early = Some(until.ended()),
            Err(Error::Numerical(_)) => {}
            Err(other) => return Err(other),
        }
    }
    let Search { mut best, mut iterations, .. } = search;
    if let Some((wider, u, x)) = &widened {
        let mut search = Search::new(wider, &mut q)?;
        search.verify((u, x), &none, Method::Interior, until)?;
        early = search.try_run(until)?;
        iterations += search.iterations;
        best = search.best;
    }
    let Some(best) = best else {
        return Err(Error::Overflow { what: "the cost of a control within its limits" });
    };
    let (excess, broken) = if task.hard() { task.excess(&best.u, &best.x)?.told() } else { (0.0, false) };
    let followed = best.open.map(|open| q.followed(try_copy(WHAT, &best.x)?, open)).transpose()?;
    let zero = q.zero + task.penalty_at_zero(&mut try_zeros(WHAT, best.x.len())?)?;
    let mut all = super::search::Search::new(0)?;
    (all.u, all.g, all.factorizations, all.method) = (best.u, best.g, iterations, best.method);
    let mut found = told(&all, bounds, (early, best.certificate), (zero, best.scale))?;
    if widened.is_some() {
        found.status = early.unwrap_or(Status::Infeasible);
    } else if broken && early.is_none() {
        found.status = Status::Undecided;
        missing = excess;
    }
    Ok(RowsSolution { found, rows: best.rows, missing, excess, followed })
}
