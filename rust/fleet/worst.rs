//! The least largest miss, by active units: solve for a few, look at all, take those that miss most.

use std::time::{Duration, Instant};

use super::cones::{Limits, Problem};
use super::dual::Dual;
use super::units::{Room, Units, WHAT};
use crate::error::{Error, Result};
use crate::limits::Status;
use crate::memory::{checked_len, try_collect, try_copy, try_extend, try_room, try_zeros};
use crate::parallel::Stop;
use crate::scaled::nearest_power_of_two;
use crate::vector::{dot, norm};

/// Units at the start, and units that are taken in at a time.
const FEW: usize = 5;
/// Units whose miss is below this share of the value are left out again.
const FAR: f64 = 0.9;
/// Of the largest miss at the start: differences below it do not count.
const FLOOR: f64 = 1e-9;
/// Of the largest miss at the start: values below it are no size to scale a problem by.
const SMALLEST: f64 = 1e-4;
/// Gap of an optimal result, relative to the largest miss at the start.
const NEAR: f64 = 1e-6;
/// Or the difference of the squares of value and lower bound in an optimal result, relative to `J(0) + J(u)`.
const OPTIMAL: f64 = 1e-9;

/// The command with the least largest miss.
pub struct Worst {
    /// `u`, inside the limits.
    pub control: Vec<f64>,
    /// The largest miss of all units at `u`.
    pub value: f64,
    /// No command within the limits has a smaller largest miss.
    pub lower_bound: f64,
    /// The units that `control` was solved for; of the first problem, if none gave a better one than 0.
    pub working: Vec<usize>,
    /// What each of them weighs in the dual, sum 1.
    pub shares: Vec<f64>,
    /// How the computation ended.
    pub status: Status,
    /// How often Clarabel was called.
    pub solves: usize,
}

/// Finds `u`, without the units in `skip`; `start` is what a similar problem ended with.
///
/// # Errors
/// [`Error::Shape`], [`Error::Overflow`], [`Error::Memory`], [`Error::Numerical`].
pub fn worst(
    units: &Units<'_>,
    limits: Limits<'_>,
    (skip, start): (&[bool], &[usize]),
    tolerance: f64,
    time: Option<Duration>,
    threads: usize,
    stop: &Stop,
) -> Result<Worst> {
    let d = units.inputs();
    check(units, limits, skip, start)?;
    let deadline = time.and_then(|time| Instant::now().checked_add(time));
    let near_zero = limits.low.iter().zip(limits.high).map(|(&low, &high)| 0.0f64.clamp(low, high));
    let mut u = try_collect(WHAT, near_zero)?;
    let mut misses = look(units, limits, &u, threads, stop)?;
    let value = largest(&misses, skip);
    let (floor, at_zero) = (FLOOR * value, value);
    let mut best = Worst {
        control: try_copy(WHAT, &u)?,
        value,
        lower_bound: 0.0,
        working: try_copy(WHAT, start)?,
        shares: Vec::new(),
        status: Status::Optimal,
        solves: 0,
    };
    let free = try_collect(WHAT, (0..d).filter(|&j| limits.low[j] < limits.high[j]))?;
    let mut working = try_copy(WHAT, start)?;
    if working.is_empty() {
        try_extend(WHAT, &mut working, top(&misses, skip, &[], -1.0)?)?;
    }
    if value == 0.0 || free.is_empty() {
        let most = (0..units.size).filter(|&s| !skip[s] && misses[s] == value).take(1);
        (best.lower_bound, best.working, best.shares) = (value, try_collect(WHAT, most)?, try_copy(WHAT, &[1.0])?);
        return Ok(best);
    }
    let mut chosen = Chosen::new(units)?;
    let mut before = 0.0;
    loop {
        if stop.requested() || deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            best.status = if stop.requested() { Status::Interrupted } else { Status::Limit };
            break;
        }
        chosen.take(units, &working)?;
        // Clarabel's tolerances are of a problem whose value is about 1
        let size = best.value.max(SMALLEST * at_zero);
        let left = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        let problem = Problem {
            maps: &chosen.maps,
            targets: &chosen.targets,
            rows: units.rows(),
            limits,
            free: &free,
            gain: chosen.gain(d),
            unit: nearest_power_of_two(size / chosen.gain(d)),
        };
        let mut proposal = problem.solve(left)?;
        best.solves += 1;
        if !proposal.control.iter().chain(&proposal.vectors).all(|v| v.is_finite()) {
            best.status = Status::Inaccurate;
            break;
        }
        let known = Dual { maps: &chosen.maps, targets: &chosen.targets, rows: units.rows(), limits };
        let (bound, shares) = known.lower_bound(&mut proposal.vectors)?;
        u = proposal.control;
        misses = match look(units, limits, &u, threads, stop) {
            Err(Error::Interrupted) => continue,
            other => other?,
        };
        let most = largest(&misses, skip);
        best.lower_bound = best.lower_bound.max(bound);
        if most < best.value {
            (best.value, best.control) = (most, try_copy(WHAT, &u)?);
            (best.working, best.shares) = (try_copy(WHAT, &working)?, shares);
        } else if best.shares.is_empty() {
            (best.working, best.shares) = (try_copy(WHAT, &working)?, shares);
        }
        if best.value - best.lower_bound <= tolerance * best.value + floor {
            break;
        }
        let more = top(&misses, skip, &working, bound * (1.0 + 1e-3 * tolerance))?;
        if more.is_empty() && best.value.max(SMALLEST * at_zero) < size / 2.0 {
            continue; // once more, in the size of the value
        }
        if more.is_empty() {
            best.status = Status::Inaccurate; // all that matters was solved for: Clarabel gets no nearer
            break;
        }
        if bound > before + tolerance * before {
            working.retain(|&s| misses[s] >= FAR * bound);
        }
        before = before.max(bound);
        try_extend(WHAT, &mut working, more)?;
    }
    // J(u) - J(v) <= value^2 - lower_bound^2
    let square = |x: f64| x * x / at_zero;
    let near = best.value - best.lower_bound <= NEAR * at_zero
        || square(best.value) - square(best.lower_bound) <= OPTIMAL * (at_zero + square(best.value));
    if near && best.status == Status::Inaccurate {
        best.status = Status::Optimal;
    }
    Ok(best)
}

fn check(units: &Units<'_>, limits: Limits<'_>, skip: &[bool], start: &[usize]) -> Result<()> {
    let d = units.inputs();
    let lengths = [
        ("low", limits.low.len(), d),
        ("high", limits.high.len(), d),
        ("R", limits.diagonal.len(), d),
        ("R", limits.cost.len(), limits.cost.len() / d * d),
        ("skip", skip.len(), units.size),
    ];
    for (name, found, expected) in lengths {
        if found != expected {
            let (expected, found) = (format!("{expected} entries"), format!("{found} entries"));
            return Err(Error::Shape { name, expected, found });
        }
    }
    if !limits.low.iter().zip(limits.high).all(|(low, high)| low <= high) {
        return Err(Error::Value { name: "low", expected: "at most `high`", found: "more".into() });
    }
    if !limits.diagonal.iter().chain(limits.cost).all(|v| v.is_finite()) || limits.diagonal.iter().any(|v| *v < 0.0) {
        return Err(Error::Value { name: "R", expected: "finite and at least 0", found: "another".into() });
    }
    if start.iter().any(|&s| s >= units.size || skip[s]) || skip.iter().all(|skip| *skip) {
        return Err(Error::Value { name: "start", expected: "units that are not left out", found: "others".into() });
    }
    Ok(())
}

fn look(units: &Units<'_>, limits: Limits<'_>, u: &[f64], threads: usize, stop: &Stop) -> Result<Vec<f64>> {
    let own: f64 = u.iter().zip(limits.diagonal).map(|(u, r)| r * u * u).sum();
    let others: f64 = limits.cost.chunks_exact(u.len()).map(|row| dot(row, u).powi(2)).sum();
    units.misses(u, own + others, threads, stop)
}

fn largest(misses: &[f64], skip: &[bool]) -> f64 {
    misses.iter().zip(skip).filter(|(_, skip)| !**skip).fold(0.0, |most, (miss, _)| most.max(*miss))
}

/// The few units with the largest misses above `least` that are not in `working`.
fn top(misses: &[f64], skip: &[bool], working: &[usize], least: f64) -> Result<Vec<usize>> {
    let mut few: Vec<usize> = try_room(WHAT, FEW + 1)?;
    for (s, &miss) in misses.iter().enumerate() {
        let weakest = few.last().map_or(f64::NEG_INFINITY, |&s| misses[s]);
        if skip[s] || miss <= least || (few.len() == FEW && miss <= weakest) || working.contains(&s) {
            continue;
        }
        let at = few.iter().position(|&other| misses[other] < miss).unwrap_or(few.len());
        few.insert(at, s);
        few.truncate(FEW);
    }
    Ok(few)
}

/// The maps and targets of the units that are solved for.
struct Chosen {
    room: Room,
    maps: Vec<f64>,
    targets: Vec<f64>,
}

impl Chosen {
    fn new(units: &Units<'_>) -> Result<Self> {
        Ok(Self { room: Room::new(units)?, maps: Vec::new(), targets: Vec::new() })
    }

    fn take(&mut self, units: &Units<'_>, working: &[usize]) -> Result<()> {
        let (d, rows) = (units.inputs(), units.rows());
        self.maps = try_zeros(WHAT, checked_len(WHAT, working.len() * rows, d)?)?;
        self.targets = try_zeros(WHAT, working.len() * rows)?;
        let parts = self.maps.chunks_exact_mut(rows * d).zip(self.targets.chunks_exact_mut(rows));
        for (&s, (map, target)) in working.iter().zip(parts) {
            units.map(s, &mut self.room, map, target);
        }
        match self.maps.iter().chain(&self.targets).all(|v| v.is_finite()) {
            true => Ok(()),
            false => Err(Error::Overflow { what: "the map of a unit" }),
        }
    }

    /// The size of the maps, as a power of two.
    fn gain(&self, d: usize) -> f64 {
        let largest = self.maps.chunks_exact(d).map(norm).fold(0.0, f64::max);
        nearest_power_of_two(largest)
    }
}
