//! The least largest miss, by active units and limits: solve for a few, look at all, take those that matter most.

use super::chosen::{Chosen, EXACT, Proposal, ROUGH};
use super::dual::Dual;
use super::held::{Forces, Held, broken};
use super::look::look;
use super::missing::least_excess;
use super::units::{Units, WHAT};
use super::within::{Limits, Within};
use crate::error::{Error, Result};
use crate::limits::{Status, Until};
use crate::memory::{try_collect, try_copy, try_extend, try_push, try_room};

/// Units at the start, and units that are taken in at a time; where a program costs little more for each of them.
const FEW: usize = 5;
const MORE: usize = 15;
/// Units whose miss is below this share of the value are left out again.
const FAR: f64 = 0.9;
/// Gap relative to the largest miss that ends the search.
pub(super) const TOLERANCE: f64 = 1e-7;
/// Of the largest miss at the start: differences below it do not count.
pub(super) const FLOOR: f64 = 1e-9;
/// Of the largest miss at the start: values below it are no size to scale a problem by.
const SMALLEST: f64 = 1e-4;
/// Gap of an optimal result, relative to the largest miss at the start.
const NEAR: f64 = 1e-6;
/// Or the difference of the squares of value and lower bound in an optimal result, relative to `J(0) + J(u)`.
const OPTIMAL: f64 = 1e-9;
/// Inputs from which on the first programs are solved roughly, until no unit and no limit is missing.
const LARGE: usize = 100;

/// The command with the least largest miss.
#[non_exhaustive]
#[derive(Debug)]
pub struct Worst {
    /// `u`, inside the limits.
    pub control: Vec<f64>,
    /// The largest miss of all units at `u`.
    pub value: f64,
    /// No command within the limits has a smaller largest miss.
    pub lower_bound: f64,
    /// The units that `control` was solved for; of the first problem, if none gave a better one than 0.
    pub working: Vec<usize>,
    /// What each of them weighs in the dual: as a share of all misses, or of the strongest limit of a state.
    pub shares: Vec<f64>,
    /// The largest excess of a limit of states that cannot be kept; 0 if all can.
    pub missing: f64,
    /// How the computation ended.
    pub status: Status,
}

/// Whether a value with that lower bound is optimal, where 0 costs `at_zero`: `J(u) - J(v) <= value^2 - lower_bound^2`.
pub(super) fn is_optimal(value: f64, lower_bound: f64, at_zero: f64) -> bool {
    let square = |x: f64| x * x / at_zero;
    value - lower_bound <= NEAR * at_zero || square(value) - square(lower_bound) <= OPTIMAL * (at_zero + square(value))
}

/// The units and limits that are solved for.
struct Search<'a> {
    units: &'a Units<'a>,
    within: &'a Within<'a>,
    skip: &'a [bool],
    run: (usize, Until<'a>),
    free: Vec<usize>,
    held: Vec<Held>,
    best: Worst,
    /// The excess of `best`, as far as it is not kept.
    excess: f64,
}

/// Finds `u`, without the units in `skip`; `start` is what a similar problem ended with.
///
/// # Errors
/// [`Error::Shape`], [`Error::Value`], [`Error::Overflow`], [`Error::Memory`], [`Error::Numerical`].
pub fn worst(
    units: &Units<'_>,
    limits: Limits<'_>,
    (skip, start): (&[bool], &[usize]),
    run: (usize, Until<'_>),
) -> Result<Worst> {
    if skip.len() != units.size || start.iter().any(|&s| s >= units.size || skip[s]) || skip.iter().all(|skip| *skip) {
        return Err(Error::Value { name: "start", expected: "units that are not left out", found: "others".into() });
    }
    let within = Within::new(units, limits)?;
    let mut search = Search::new(units, &within, skip, run)?;
    search.ended(start)?;
    if search.best.status != Status::Infeasible {
        return Ok(search.best);
    }
    let found = match least_excess(units, &within, skip, search.held, run) {
        Err(Error::Interrupted) => return Ok(Worst { status: run.1.ended(), ..search.best }),
        found => found?,
    };
    if !found.sure {
        return Ok(Worst { status: Status::Inaccurate, ..search.best });
    }
    // the best command within limits that are wider by what is missing
    let wider = within.wider(found.missing)?;
    let within = Within { given: Limits { states: Some((&wider.0, &wider.1)), ..limits }, ..within };
    let mut search = Search::new(units, &within, skip, run)?;
    search.ended(start)?;
    if !matches!(search.best.status, Status::Limit | Status::Interrupted) {
        search.best.status = Status::Infeasible;
    }
    Ok(Worst { missing: found.missing, ..search.best })
}

impl<'a> Search<'a> {
    fn new(units: &'a Units<'a>, within: &'a Within<'a>, skip: &'a [bool], run: (usize, Until<'a>)) -> Result<Self> {
        let best = Worst {
            control: within.near_zero()?,
            value: f64::INFINITY,
            lower_bound: 0.0,
            working: Vec::new(),
            shares: Vec::new(),
            missing: 0.0,
            status: Status::Optimal,
        };
        let (free, held) = (within.free()?, Vec::new());
        Ok(Self { units, within, skip, run, free, held, best, excess: f64::INFINITY })
    }

    /// The search, with a stop as a status.
    fn ended(&mut self, start: &[usize]) -> Result<()> {
        match self.run(start) {
            Err(Error::Interrupted) if self.best.value.is_finite() => self.best.status = self.run.1.ended(),
            other => return other,
        }
        Ok(())
    }

    fn run(&mut self, start: &[usize]) -> Result<()> {
        let (units, within, skip, until) = (self.units, self.within, self.skip, self.run.1);
        let now = look(units, within, &self.best.control, skip, self.run)?;
        let at_zero = now.value;
        (self.best.value, self.excess) = (at_zero, within.excess(now.excess));
        let large = self.free.len() > LARGE;
        let (most, mut working) = (if large { MORE } else { FEW }, try_copy(WHAT, start)?);
        if working.is_empty() {
            try_extend(WHAT, &mut working, top(most, &now.misses, skip, &[], -1.0)?)?;
        }
        self.best.working = try_copy(WHAT, &working)?;
        self.held = broken(units, within, (&self.best.control, &now.beyond, skip), &[], within.kept)?;
        if self.free.is_empty() || at_zero == 0.0 && self.held.is_empty() {
            let most = (0..units.size).filter(|&s| !skip[s] && now.misses[s] == at_zero).take(1);
            self.best.working = try_collect(WHAT, most)?;
            (self.best.lower_bound, self.best.shares) = (at_zero, try_copy(WHAT, &[1.0])?);
            self.best.status = if self.held.is_empty() { Status::Optimal } else { Status::Infeasible };
            return Ok(());
        }
        let mut chosen = Chosen::new(units, try_copy(WHAT, &self.free)?)?;
        let rough = large && working.len() < units.size;
        let (mut tolerance, mut before) = (if rough { ROUGH } else { EXACT }, 0.0);
        loop {
            until.check()?;
            chosen.take(units, &working, until)?;
            // tolerances are of a problem whose value is about 1
            let size = self.best.value.max(SMALLEST * at_zero);
            let found = chosen.propose(within, &self.held, if size > 0.0 { size } else { 1.0 }, tolerance, until)?;
            let Some(Proposal { control, mut vectors, forces }) = found else {
                self.best.status = if self.held.is_empty() { Status::Inaccurate } else { Status::Infeasible };
                break;
            };
            let (maps, targets) = chosen.stacked()?;
            let known = Dual { maps: &maps, targets: &targets, rows: units.rows(), within, held: &self.held };
            let (bound, shares) = known.lower_bound(&mut vectors, &forces)?;
            let now = look(units, within, &control, skip, self.run)?;
            let more = top(most, &now.misses, skip, &working, bound * (1.0 + 1e-3 * TOLERANCE))?;
            let limits = broken(units, within, (&control, &now.beyond, skip), &self.held, within.kept)?;
            self.best.lower_bound = self.best.lower_bound.max(bound);
            let excess = within.excess(now.excess);
            let better = (excess, now.value) < (self.excess, self.best.value);
            if better {
                (self.excess, self.best.value, self.best.control) = (excess, now.value, control);
            }
            if better || self.best.shares.is_empty() {
                (self.best.working, self.best.shares) = carrying(&working, shares, &self.held, &forces)?;
            }
            let close = TOLERANCE * self.best.value + FLOOR * at_zero;
            if self.excess == 0.0 && self.best.value - self.best.lower_bound <= close {
                break;
            }
            if more.is_empty() && limits.is_empty() {
                if tolerance > EXACT {
                    tolerance = EXACT;
                    continue;
                }
                if self.best.value.max(SMALLEST * at_zero) < size / 2.0 {
                    continue; // once more, in the size of the value
                }
                // all that matters was solved for: rounding lets it no nearer, or the limits of states cannot be kept
                self.best.status = if self.excess > 0.0 { Status::Infeasible } else { Status::Inaccurate };
                break;
            }
            if bound > before + TOLERANCE * before {
                working.retain(|&s| now.misses[s] >= FAR * bound);
            }
            before = before.max(bound);
            try_extend(WHAT, &mut working, more)?;
            try_extend(WHAT, &mut self.held, limits)?;
        }
        let near = self.excess == 0.0 && is_optimal(self.best.value, self.best.lower_bound, at_zero);
        if near && self.best.status == Status::Inaccurate {
            self.best.status = Status::Optimal;
        }
        Ok(())
    }
}

/// The units that were solved for and those whose limits are held, and what each weighs in the dual.
fn carrying(working: &[usize], mut shares: Vec<f64>, held: &[Held], forces: &Forces) -> Result<(Vec<usize>, Vec<f64>)> {
    let mut units = try_copy(WHAT, working)?;
    let most = forces.held.iter().fold(0.0f64, |most, v| most.max(*v));
    for (held, force) in held.iter().zip(&forces.held) {
        let share = if most > 0.0 { force / most } else { 0.0 };
        match units.iter().position(|&s| s == held.unit) {
            Some(at) => shares[at] = shares[at].max(share),
            None => {
                try_push(WHAT, &mut units, held.unit)?;
                try_push(WHAT, &mut shares, share)?;
            }
        }
    }
    Ok((units, shares))
}

/// The few units with the largest misses above `least` that are not in `working`.
fn top(most: usize, misses: &[f64], skip: &[bool], working: &[usize], least: f64) -> Result<Vec<usize>> {
    let mut few: Vec<usize> = try_room(WHAT, most + 1)?;
    for (s, &miss) in misses.iter().enumerate() {
        let weakest = few.last().map_or(f64::NEG_INFINITY, |&s| misses[s]);
        if skip[s] || miss <= least || (few.len() == most && miss <= weakest) || working.contains(&s) {
            continue;
        }
        let at = few.iter().position(|&other| misses[other] < miss).unwrap_or(few.len());
        few.insert(at, s);
        few.truncate(most);
    }
    Ok(few)
}
