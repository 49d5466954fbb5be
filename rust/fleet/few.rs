//! The command with the least largest miss from the few units that carry it, after some were left out.

use std::time::{Duration, Instant};

use super::look::look;
use super::mean::gains;
use super::units::{Units, WHAT};
use super::within::{Limits, Within};
use super::worst::{FLOOR, TOLERANCE, Worst, is_optimal, worst};
use crate::error::{Error, Result};
use crate::limits::{Status, Until};
use crate::memory::{try_collect, try_copy, try_extend, try_filled, try_push, try_zeros};
use crate::parallel::Stop;

/// `R`, where none is given: this share of the mean eigenvalue of the largest `G_s'Q G_s`.
const REGULAR: f64 = 1e-8;
/// Units that weigh less in the dual do not carry the command.
const CARRIES: f64 = 1e-6;

/// A command, what it rests on, and how far from the best one it can be.
#[non_exhaustive]
#[derive(Debug)]
pub struct Few {
    /// `u`, inside the limits of inputs and rates.
    pub control: Vec<f64>,
    /// The largest miss of the units that were not left out.
    pub value: f64,
    /// No command within the limits has a smaller one.
    pub lower_bound: f64,
    /// How the computation ended.
    pub status: Status,
    /// The units that alone give the command; all that were not left out where a stop left none.
    pub support: Vec<usize>,
    /// The units that were left out, in their order.
    pub removed: Vec<usize>,
    /// R `(m, m)`, or empty.
    pub r: Vec<f64>,
    /// The unit that R was taken from.
    pub widest: Option<usize>,
    /// By how much limits of states cannot be kept.
    pub missing: f64,
}

/// R `(m, m)`, or empty, and the unit that it was taken from.
type Weight = (Vec<f64>, Option<usize>);

/// A part of the units.
struct Part {
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    x0: Vec<f64>,
}

impl Part {
    fn new(units: &Units<'_>, chosen: &[usize]) -> Result<Self> {
        let rows = |from: &[f64], len: usize| -> Result<Vec<f64>> {
            let mut rows = Vec::new();
            for &s in chosen {
                try_extend(WHAT, &mut rows, from[s * len..][..len].iter().copied())?;
            }
            Ok(rows)
        };
        let (n, m) = (units.n, units.m);
        let one = units.x0.len() == n;
        Ok(Self {
            a: rows(units.a, n * n)?,
            b: rows(units.b, n * m)?,
            c: if units.c.is_empty() { Vec::new() } else { rows(units.c, n)? },
            x0: if one { try_copy(WHAT, units.x0)? } else { rows(units.x0, n)? },
        })
    }

    fn of<'a>(&'a self, units: &Units<'a>) -> Units<'a> {
        let size = self.a.len() / (units.n * units.n);
        Units { a: &self.a, b: &self.b, c: &self.c, x0: &self.x0, size, ..*units }
    }
}

/// What every problem has in common.
struct Fleet<'a> {
    units: &'a Units<'a>,
    limits: Limits<'a>,
    tiny: bool,
    threads: usize,
    stop: &'a Stop,
}

/// Leaves out `discard` units and finds the command, solved for a few units alone; with `tiny` the weight R is that of
/// the largest map. The units left out go one by one, each time the one without which the value falls most; a stop
/// leaves the command that was last found, and the units that it was found without.
///
/// # Errors
/// As [`worst`].
pub fn of_few(
    units: &Units<'_>,
    limits: Limits<'_>,
    (tiny, discard): (bool, usize),
    time: Option<Duration>,
    threads: usize,
    stop: &Stop,
) -> Result<Few> {
    let (began, fleet) = (Instant::now(), Fleet { units, limits, tiny, threads, stop });
    let until = Until::new(stop, time);
    let mut skip = try_filled(WHAT, false, units.size)?;
    let mut removed = Vec::new();
    let (mut r, mut widest) = fleet.weight(units, &skip)?;
    let mut now = worst(units, Limits { r: &r, ..limits }, (&skip, &[]), (threads, until))?;
    while removed.len() < discard && matches!(now.status, Status::Optimal | Status::Inaccurate) {
        match fleet.without_one(&now, &mut skip, (&r, widest), until) {
            Ok((out, weight, next)) => {
                try_push(WHAT, &mut removed, out)?;
                ((r, widest), now) = (weight, next);
            }
            Err(Error::Interrupted) => now.status = until.ended(),
            Err(other) => return Err(other),
        }
    }
    // what a stop cut short may take as long again
    let stopped = matches!(now.status, Status::Limit | Status::Interrupted);
    let again = Until::new(stop, stopped.then(|| began.elapsed().max(Duration::from_millis(1))));
    let few = fleet.carried(now, (&r, widest), &skip, again)?;
    Ok(Few { removed, r, widest, ..few })
}

/// The command of some units alone: a function of these and of nothing else.
///
/// # Errors
/// As [`worst`].
pub fn alone(
    units: &Units<'_>,
    limits: Limits<'_>,
    tiny: bool,
    few: &[usize],
    threads: usize,
    stop: &Stop,
) -> Result<Vec<f64>> {
    if few.iter().any(|&s| s >= units.size) {
        return Err(Error::Value { name: "few", expected: "units", found: "others".into() });
    }
    let fleet = Fleet { units, limits, tiny, threads, stop };
    if few.is_empty() {
        return Within::new(units, limits)?.near_zero();
    }
    Ok(fleet.own(few, Until::new(stop, None))?.control)
}

/// A command that no stop cut short.
fn whole(found: Worst) -> Result<Worst> {
    let stopped = matches!(found.status, Status::Limit | Status::Interrupted);
    if stopped { Err(Error::Interrupted) } else { Ok(found) }
}

/// The units that carry a command, in their order.
fn carrying(found: &Worst) -> Result<Vec<usize>> {
    let weighing = found.working.iter().zip(&found.shares).filter(|(_, share)| **share > CARRIES);
    let mut units = try_collect(WHAT, weighing.map(|(s, _)| *s))?;
    units.sort_unstable();
    Ok(units)
}

impl Fleet<'_> {
    /// `R = 1e-8 max_s tr(G_s'Q G_s) / (K m) I`, and the unit whose map is that large; the given one without `tiny`,
    /// none if no input moves a unit. By the largest, not by the mean: then R is that of one unit.
    fn weight(&self, units: &Units<'_>, skip: &[bool]) -> Result<Weight> {
        if !self.tiny {
            return Ok((try_copy(WHAT, self.limits.r)?, None));
        }
        let (m, gains) = (units.m, gains(units, self.threads, self.stop)?);
        let mut most = (0.0, None);
        for (s, gain) in gains.iter().enumerate().filter(|(s, _)| !skip[*s]) {
            if *gain > most.0 {
                most = (*gain, Some(s));
            }
        }
        let share = REGULAR * most.0 / units.inputs() as f64;
        if share == 0.0 {
            return Ok((Vec::new(), None));
        }
        let mut r = try_zeros(WHAT, m * m)?;
        r.iter_mut().step_by(m + 1).for_each(|r| *r = share);
        Ok((r, most.1))
    }

    /// Leaves out the unit without which the value falls most: that unit, the weight of the others, and their command.
    fn without_one(
        &self,
        now: &Worst,
        skip: &mut [bool],
        (r, widest): (&[f64], Option<usize>),
        until: Until<'_>,
    ) -> Result<(usize, Weight, Worst)> {
        let (mut out, mut start, mut least) = (now.working[0], Vec::new(), f64::INFINITY);
        for i in carrying(now)? {
            // the value among those solved for, without one of them: below that of all the others
            let few = try_collect(WHAT, now.working.iter().copied().filter(|s| *s != i))?;
            if few.is_empty() {
                continue;
            }
            let value = whole(self.alone(&few, r, until)?)?.value;
            if value < least {
                (out, start, least) = (i, few, value);
            }
        }
        skip[out] = true;
        let found = (|| {
            let weight =
                if widest == Some(out) { self.weight(self.units, skip)? } else { (try_copy(WHAT, r)?, widest) };
            let limits = Limits { r: &weight.0, ..self.limits };
            let next = whole(worst(self.units, limits, (skip, &start), (self.threads, until))?)?;
            Ok((out, weight, next))
        })();
        skip[out] = found.is_ok();
        found
    }

    /// The command of some units with the weight `r`.
    fn alone(&self, few: &[usize], r: &[f64], until: Until<'_>) -> Result<Worst> {
        let part = Part::new(self.units, few)?;
        let all = try_collect(WHAT, 0..few.len())?;
        let skip = try_filled(WHAT, false, few.len())?;
        worst(&part.of(self.units), Limits { r, ..self.limits }, (&skip, &all), (self.threads, until))
    }

    /// The command of some units with their own weight.
    fn own(&self, few: &[usize], until: Until<'_>) -> Result<Worst> {
        let part = Part::new(self.units, few)?;
        let (r, _) = self.weight(&part.of(self.units), &try_filled(WHAT, false, few.len())?)?;
        self.alone(few, &r, until)
    }

    /// Solves again for the few units that carry `found`: a function of these and of nothing else.
    ///
    /// They are taken in the order of the fleet, from one start, with the R of these units. The units are chosen
    /// freely: first those with multipliers, then all that the last problem was solved for. Where a stop leaves no
    /// command, or that of the few does not keep the limits of all, `found` is that of all.
    fn carried(
        &self,
        found: Worst,
        (r, widest): (&[f64], Option<usize>),
        skip: &[bool],
        until: Until<'_>,
    ) -> Result<Few> {
        let within = Within::new(self.units, Limits { r, ..self.limits })?;
        let (start, mut status) = (within.near_zero()?, found.status);
        let of_all = |found: Worst, status: Status| -> Result<Few> {
            let support = try_collect(WHAT, (0..self.units.size).filter(|&s| !skip[s]))?;
            Ok(Few::new(found, status, support))
        };
        if status == Status::Infeasible {
            return of_all(found, status);
        }
        let seen = |u: &[f64]| look(self.units, &within, u, skip, (self.threads, until));
        let at_start = match seen(&start) {
            Err(Error::Interrupted) => return of_all(found, until.ended()),
            seen => seen?,
        };
        if found.control == start {
            return Ok(Few::new(found, status, Vec::new())); // the command of no unit
        }
        let mut best: Option<(f64, f64, Vec<f64>, Vec<usize>)> = None;
        for some in [carrying(&found)?, try_copy(WHAT, &found.working)?] {
            let few = self.distinct(some, widest)?;
            if few.is_empty() {
                continue; // nothing weighs in the dual, as where every unit can be brought to its target
            }
            let (alone, now) = match self.own(&few, until).and_then(|alone| Ok((seen(&alone.control)?, alone))) {
                Err(Error::Interrupted) => {
                    status = until.ended();
                    break;
                }
                both => both.map(|(now, alone)| (alone, now))?,
            };
            if matches!(alone.status, Status::Limit | Status::Interrupted) {
                status = alone.status;
                break;
            }
            let excess = within.excess(now.excess);
            if best.as_ref().is_none_or(|best| (excess, now.value) < (best.0, best.1)) {
                best = Some((excess, now.value, alone.control, few));
            }
            if excess == 0.0 && now.value <= found.value + TOLERANCE * found.value + FLOOR * at_start.value {
                break;
            }
        }
        let Some((excess, mut value, mut control, mut support)) = best else {
            return of_all(found, status);
        };
        if excess > 0.0 {
            return of_all(found, status);
        }
        if within.excess(at_start.excess) == 0.0 && value >= at_start.value {
            (value, control, support) = (at_start.value, start, Vec::new());
        }
        let lower_bound = found.lower_bound.min(value);
        if !matches!(status, Status::Limit | Status::Interrupted) {
            let near = is_optimal(value, lower_bound, at_start.value);
            status = if near { Status::Optimal } else { Status::Inaccurate };
        }
        Ok(Few::new(Worst { control, value, lower_bound, ..found }, status, support))
    }

    /// The units and `widest` in their order, the first of each group of equal ones.
    fn distinct(&self, mut some: Vec<usize>, widest: Option<usize>) -> Result<Vec<usize>> {
        try_extend(WHAT, &mut some, widest)?;
        some.sort_unstable();
        some.dedup();
        let mut few: Vec<usize> = Vec::new();
        for s in some {
            if !few.iter().any(|&other| self.units.same(s, other)) {
                try_push(WHAT, &mut few, s)?;
            }
        }
        Ok(few)
    }
}

impl Few {
    fn new(found: Worst, status: Status, support: Vec<usize>) -> Self {
        let Worst { control, value, lower_bound, missing, .. } = found;
        let (removed, r) = (Vec::new(), Vec::new());
        Self { control, value, lower_bound, status, support, removed, r, widest: None, missing }
    }
}
