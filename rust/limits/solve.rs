//! One problem, and what one problem and many share.

use std::time::Instant;

use super::bounds::Bounds;
use super::certificate::{Certificate, status};
use super::dense::Dense;
use super::orthogonal::Orthogonal;
use super::quadratic::{Method, Quadratic, Status, Until};
use super::search::{Search, good};
use crate::error::{Error, Result, require_finite, sized};
use crate::memory::{checked_len, try_copy, try_filled, try_zeros};

const WHAT: &str = "a control within limits";

/// A control and how far from the best one it can be.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
#[must_use]
pub struct Solution {
    /// `u`, inside the limits.
    pub control: Vec<f64>,
    /// -1 at the lower limit, 1 at the upper one; of a fixed input by the sign of its multiplier.
    pub active: Vec<i8>,
    /// `J'_i` at the lower limit, `-J'_i` at the upper one, at least 0; 0 elsewhere.
    pub multipliers: Vec<f64>,
    /// How the computation ended.
    pub status: Status,
    /// `J(u) - min J` is at most this.
    pub gap: f64,
    /// The largest `<J'(u), u - v>` over the limits.
    pub frank_wolfe: f64,
    /// `||u - u*||_H` is at most this.
    pub distance: f64,
    /// `J(u)`.
    pub objective: f64,
    /// `J(0)`.
    pub at_zero: f64,
    /// Factorizations.
    pub iterations: usize,
    /// What found the control.
    pub method: Method,
}

impl Solution {
    /// Room for `d` inputs.
    pub(super) fn sized(d: usize) -> Result<Self> {
        let (control, multipliers) = (try_zeros(WHAT, d)?, try_zeros(WHAT, d)?);
        Ok(Self { control, active: try_filled(WHAT, 0, d)?, multipliers, ..Self::default() })
    }

    /// A control that is known with its certificate alone.
    pub fn of(control: Vec<f64>, gap: f64, distance: f64, objective: f64) -> Self {
        let (active, multipliers, method) = (Vec::new(), Vec::new(), Method::default());
        let (status, frank_wolfe, at_zero) = (Status::Inaccurate, f64::INFINITY, f64::INFINITY);
        Self {
            control,
            active,
            multipliers,
            status,
            gap,
            frank_wolfe,
            distance,
            objective,
            at_zero,
            iterations: 0,
            method,
        }
    }
}

/// The work of a call of a loop at most.
#[derive(Debug, Clone, Copy)]
pub struct Most {
    /// Factorizations of a matrix, and updates of one.
    pub factorizations: usize,
    /// Operations with numbers.
    pub operations: f64,
    /// Seconds that they take on this machine, by the time of each part as measured.
    pub seconds: f64,
}

/// The median of five times of some work, in seconds: another process may interrupt one or two.
pub(super) fn measured(mut work: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut times = [0.0; 5];
    for time in &mut times {
        let start = Instant::now();
        work()?;
        *time = start.elapsed().as_secs_f64();
    }
    times.sort_by(f64::total_cmp);
    Ok(times[2])
}

/// `R`: its diagonal, or all of it.
#[derive(Debug, Clone, Copy)]
pub enum Penalty<'a> {
    /// `d` entries.
    Diagonal(&'a [f64]),
    /// `d x d`, symmetric.
    Full(&'a [f64]),
}

impl Penalty<'_> {
    /// Its diagonal and `rows` of a root of the rest: `R = diag + rows' rows`. By pivoted Cholesky.
    pub(super) fn split(self, name: &'static str, d: usize) -> Result<(Vec<f64>, Vec<f64>)> {
        let (values, len) = match self {
            Self::Diagonal(values) => (values, d),
            Self::Full(values) => (values, checked_len(WHAT, d, d)?),
        };
        sized(name, values.len(), len)?;
        require_finite(name, values)?;
        let indefinite =
            |v: f64| Error::Value { name, expected: "positive semidefinite", found: format!("a pivot of {v:e}") };
        if matches!(self, Self::Diagonal(_)) {
            return match values.iter().find(|v| **v < 0.0) {
                Some(v) => Err(indefinite(*v)),
                None => Ok((try_copy(WHAT, values)?, Vec::new())),
            };
        }
        let (mut left, mut rows) = (try_copy(WHAT, values)?, try_zeros(WHAT, len)?);
        let most = (0..d).fold(0.0f64, |m, i| m.max(values[i * d + i].abs()));
        let rounding = 4.0 * f64::EPSILON * d as f64 * most;
        for row in rows.chunks_exact_mut(d.max(1)) {
            let Some(p) = (0..d).max_by(|&i, &j| left[i * d + i].total_cmp(&left[j * d + j])) else { break };
            let pivot = left[p * d + p];
            if pivot <= rounding {
                break;
            }
            let root = pivot.sqrt();
            (0..d).for_each(|i| row[i] = left[p * d + i] / root);
            for i in 0..d {
                (0..d).for_each(|j| left[i * d + j] -= row[i] * row[j]);
            }
        }
        match left.iter().find(|v| v.abs() > 1e3 * rounding) {
            Some(v) => Err(indefinite(-v.abs())),
            None => Ok((try_zeros(WHAT, d)?, rows)),
        }
    }
}

/// Searches, once more with orthogonal factors where the gap is not small, and says what was found.
pub(super) fn find(
    dense: &mut Dense,
    search: &mut Search,
    bounds: Bounds<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
) -> Result<(Option<Status>, Certificate)> {
    let mut early = or_ended(search.run(dense, bounds, warm, until), until)?;
    if !search.certificate.objective.is_finite() {
        search.give_up(dense, bounds);
    }
    let mut found = search.certificate;
    if early.is_none() && !good(&found, dense.scale()) {
        let mut again = Search::new(dense.d)?;
        early = or_ended(refined(dense, &mut again, bounds, &search.held, until), until)?;
        if again.certificate.gap < found.gap {
            found = again.certificate;
            (search.u, search.g) = (again.u, again.g);
            search.method = Method::Refinement;
        }
        search.factorizations += again.factorizations;
    }
    Ok((early, found))
}

/// The same with orthogonal factors.
fn refined(
    dense: &Dense,
    search: &mut Search,
    bounds: Bounds<'_>,
    held: &[i8],
    until: Until<'_>,
) -> Result<Option<Status>> {
    let mut exact = Orthogonal::new(dense, until)?;
    let early = or_ended(search.run(&mut exact, bounds, Some(held), until), until);
    if exact.damped() && search.certificate.objective.is_finite() {
        let of = (&*search.u, &mut *search.g);
        search.certificate = exact.certified(bounds, &search.fixed, of, until)?;
    }
    early
}

/// A stop as a status.
pub(super) fn or_ended(found: Result<Option<Status>>, until: Until<'_>) -> Result<Option<Status>> {
    match found {
        Err(Error::Interrupted) => Ok(Some(until.ended())),
        other => other,
    }
}

/// The result of a search.
pub(super) fn told(
    search: &Search,
    bounds: Bounds<'_>,
    ended: (Option<Status>, Certificate),
    scales: (f64, f64),
) -> Result<Solution> {
    let mut to = Solution::sized(search.u.len())?;
    tell(search, bounds, ended, scales, &mut to);
    Ok(to)
}

/// The same into what is there.
pub(super) fn tell(
    search: &Search,
    bounds: Bounds<'_>,
    (early, found): (Option<Status>, Certificate),
    (at_zero, scale): (f64, f64),
    to: &mut Solution,
) {
    to.control.copy_from_slice(&search.u);
    for (i, (u, g)) in search.u.iter().zip(&search.g).enumerate() {
        to.active[i] = bounds.reached(i, *u, *g);
        to.multipliers[i] = (-2.0 * f64::from(to.active[i]) * g).max(0.0) + 0.0;
    }
    to.status = status(early, &found, scale);
    (to.gap, to.frank_wolfe, to.distance, to.objective) =
        (found.gap, found.frank_wolfe, found.distance, found.objective);
    (to.at_zero, to.iterations, to.method) = (at_zero, search.factorizations, search.method);
}

/// `M`, checked against `d`, with the rows of a root of `R` below; the number of its own rows.
pub(super) fn stacked(m: &[f64], d: usize, r: Penalty<'_>) -> Result<(Dense, usize)> {
    if d == 0 || !m.len().is_multiple_of(d) {
        let found = format!("{} entries", m.len());
        return Err(Error::Shape { name: "M", expected: format!("rows of {d} entries, at least one"), found });
    }
    let rows = m.len() / d;
    let (diagonal, root) = r.split("R", d)?;
    let mut dense = Dense::again(rows + root.len() / d, d)?;
    if root.is_empty() {
        dense.set(m, &diagonal)?;
    } else {
        let mut all = try_zeros(WHAT, m.len() + root.len())?;
        let (above, below) = all.split_at_mut(m.len());
        above.copy_from_slice(m);
        below.copy_from_slice(&root);
        dense.set(&all, &diagonal)?;
    }
    Ok((dense, rows))
}

/// `size` rows of `rows` entries.
pub(super) fn checked_rows(name: &'static str, len: usize, size: usize, rows: usize) -> Result<()> {
    if size.checked_mul(rows) == Some(len) {
        return Ok(());
    }
    Err(Error::Shape { name, expected: format!("{size} rows of {rows} entries"), found: format!("{len} entries") })
}

/// `y` with zeros for the root of `R`.
pub(super) fn aim(dense: &mut Dense, rows: usize, y: &[f64]) -> Result<()> {
    if y.len() != rows {
        let found = format!("{} entries", y.len());
        return Err(Error::Shape { name: "y", expected: format!("{rows} entries, one per row of `M`"), found });
    }
    if dense.y.len() == rows {
        return dense.aim(y);
    }
    let mut all = try_zeros(WHAT, dense.y.len())?;
    all[..rows].copy_from_slice(y);
    dense.aim(&all)
}

pub(super) fn checked_warm(warm: Option<&[i8]>, d: usize) -> Result<()> {
    sized("warm", warm.map_or(d, <[i8]>::len), d)?;
    match warm.into_iter().flatten().find(|sign| sign.abs() > 1) {
        Some(found) => Err(Error::Value { name: "warm", expected: "-1, 0 or 1", found: found.to_string() }),
        None => Ok(()),
    }
}

/// The limits that the last call of a loop has reached, and those at which the next one begins, some inputs later.
#[derive(Debug)]
pub(super) struct Warm {
    last: Vec<i8>,
    next: Vec<i8>,
    begun: bool,
}

impl Warm {
    pub(super) fn new(d: usize) -> Result<Self> {
        Ok(Self { last: try_filled(WHAT, 0, d)?, next: try_filled(WHAT, 0, d)?, begun: false })
    }

    pub(super) fn later(&mut self, shift: usize) -> Option<&[i8]> {
        self.next.copy_from_slice(&self.last);
        self.next.copy_within(shift.min(self.last.len()).., 0);
        self.begun.then_some(&self.next)
    }

    pub(super) fn reached(&mut self, signs: &[i8]) {
        self.last.copy_from_slice(signs);
        self.begun = true;
    }

    pub(super) fn last(&self) -> Option<&[i8]> {
        self.begun.then_some(&self.last)
    }

    pub(super) fn resume(&mut self, signs: Option<&[i8]>) -> Result<()> {
        checked_warm(signs, self.last.len())?;
        self.begun = false;
        signs.into_iter().for_each(|signs| self.reached(signs));
        Ok(())
    }
}

/// The least `||M u - y||^2 + u' R u` within `bounds`, from the limits that `warm` names.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`], [`Error::Value`] for `R`, [`Error::Memory`].
pub fn box_control(
    m: &[f64],
    y: &[f64],
    r: Penalty<'_>,
    bounds: Bounds<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
) -> Result<Solution> {
    let d = bounds.low.len();
    checked_warm(warm, d)?;
    let (mut dense, rows) = stacked(m, d, r)?;
    aim(&mut dense, rows, y)?;
    let mut search = Search::new(d)?;
    let found = find(&mut dense, &mut search, bounds, warm, until)?;
    let told = told(&search, bounds, found, (dense.scale(), dense.scale()));
    dense.keep();
    told
}
