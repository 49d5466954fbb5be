//! The evidence against the region, step by step, and the alarm.

use crate::error::{Error, Result};
use crate::memory::{try_collect, try_copy, try_extend, try_zeros};
use crate::vector::{axpy, dot, norm as size};
use crate::window::Window;

use super::bank::{Bank, Null};
use super::frame::{Frame, WHAT};
use super::fresh::Fresh;
use super::laws::{LARGEST, Laws};
use super::recent::Recent;

/// `L` of the learned bets, and the largest shift that they bet on.
pub(super) const LEARNED: [f64; 2] = [20.0, 200.0];
const SHIFT: f64 = 5.0;
/// Steps in which nothing could have told, to be blind; also those of the mean of what is seen.
const IDLE: f64 = 200.0;
/// Least factor of a bet, and largest sums: what is beyond is evidence that is lost, or of no use, and all numbers are
/// finite.
const LEAST: f64 = 1e-300;
const MOST: f64 = 1e290;
/// Relative changes that are looked at by what it sees now: `.02 1.5^k`.
const CHANGES: usize = 16;

/// How often the alarm may be false.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Promise {
    /// The mean number of steps between false alarms, and to the first one, is at least this.
    Every(f64),
    /// The probability of a false alarm ever is at most this.
    Ever(f64),
}

/// What changes from call to call beside the arrays.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Counts {
    /// All calls.
    pub calls: f64,
    /// Pairs since the evidence began; starts of single steps and of both blocks.
    pub pairs: f64,
    /// See `pairs`.
    pub starts: [f64; 3],
    /// Complete readings in a row.
    pub since: f64,
    /// Pairs in a row in which only louder noise could have been seen.
    pub idle: f64,
    /// Calls in a row without a pair.
    pub skipped: f64,
    /// The number of alarms, and whether one was not taken as seen.
    pub alarms: f64,
    /// See `alarms`.
    pub alarmed: f64,
    /// That of the last pair.
    pub evidence: f64,
    /// Of the first alarm since the last was seen: its call, and the place in `evidence`; see [`Watch::onset`].
    pub first: [f64; 2],
}

/// Bets on a region while the plant is in use; no call allocates. Plain arrays.
#[derive(Debug)]
pub struct Watch {
    pub(super) frame: Frame,
    pub(super) bank: Bank,
    pub(super) law: (Laws, Null),
    pub(super) promise: Promise,
    pub(super) window: Window,
    counts: Counts,
    fresh: Fresh,
    /// What an onset is found from.
    pub(super) recent: Recent,
    /// State of the window, its first reading, z.
    x: Vec<f64>,
    first: Vec<f64>,
    z: Vec<f64>,
    /// Evidence: of single steps (bets, shifts, 2), of short and of long blocks (bets, small, 2), of the energy, of
    /// learned bets; where each begins, and `pi b` of each.
    evidence: Vec<f64>,
    pub(super) begins: [usize; 6],
    pub(super) weights: [f64; 5],
    /// Of the short and the long block: sums of logarithms (bets, small, 2), `sum phi' g'z W z` (bets, small, any),
    /// `sum p^2` and `sum (g'z)^2` (bets).
    sums: [Vec<f64>; 2],
    drift: [Vec<f64>; 2],
    squares: [Vec<f64>; 2],
    sizes: [Vec<f64>; 2],
    /// Estimates (2, n, d) of `L^-1 (Theta - C) P^(1/2)`.
    estimates: Vec<f64>,
    /// Growth of the evidence by changes (bets, CHANGES): mean of single steps, and of long blocks.
    growth: [Vec<f64>; 2],
    /// Room for a step: e, W z, lengths, `l'e` of the directions, zeta, and an estimate of the mean of e.
    e: Vec<f64>,
    wz: Vec<f64>,
    lengths: Vec<f64>,
    along: Vec<f64>,
    zeta: Vec<f64>,
    mean: Vec<f64>,
}

impl Watch {
    /// A watch with this bank over a window; `frame` is of its regressors.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`], [`Error::Memory`].
    pub fn new(frame: Frame, bank: Bank, law: (Laws, Null), promise: Promise, window: Window) -> Result<Self> {
        let (n, d) = frame.sizes;
        if (window.outputs(), window.length()) != (frame.outputs, d) {
            let (expected, found) =
                (format!("{} readings, {d} regressors", frame.outputs), window.length().to_string());
            return Err(Error::Shape { name: "window", expected, found });
        }
        let sound = match promise {
            Promise::Every(steps) => (2.0..=1e15).contains(&steps),
            Promise::Ever(level) => (1e-15..=0.5).contains(&level),
        };
        if !sound {
            let expected = "from 2 to 1e15 steps between false alarms, or a probability from 1e-15 to 0.5";
            return Err(Error::Value { name: "promise", expected, found: format!("{promise:?}") });
        }
        let zeros = |count: usize| try_zeros::<f64>(WHAT, count);
        let pair = |count: usize| Ok::<_, Error>([zeros(count)?, zeros(count)?]);
        let (bets, any, energy) = (bank.column.len(), frame.white.len() / d, law.0.shares().len());
        let small = bets * bank.small;
        let counts = [0, 2 * bets * bank.shifts.len(), 2 * small, 2 * small, energy, LEARNED.len()];
        let mut begins = counts;
        (1..6).for_each(|part| begins[part] += begins[part - 1]);
        // equal parts of the learned bets and all others but an energy without bets
        let part = 1.0 / if energy == 0 { 5.0 } else { 6.0 };
        let mut weights = [1.0, 2.0, 3.0, 4.0, 5.0].map(|at| part / counts[at as usize].max(1) as f64);
        weights[4] = part;
        if let Promise::Every(_) = promise {
            (0..2).for_each(|k| weights[k + 1] *= bank.blocks[k] as f64);
        }
        Ok(Self {
            law,
            promise,
            window,
            counts: Counts::default(),
            fresh: Fresh::new(&frame, None)?,
            recent: Recent::new(window.outputs() + window.inputs())?,
            x: zeros(window.states())?,
            first: zeros(window.outputs())?,
            z: zeros(d)?,
            evidence: zeros(begins[5])?,
            begins,
            weights,
            sums: pair(2 * small)?,
            drift: pair(small * any)?,
            squares: pair(bets)?,
            sizes: pair(bets)?,
            estimates: zeros(LEARNED.len() * n * d)?,
            growth: pair(bets * CHANGES)?,
            e: zeros(n)?,
            wz: zeros(any)?,
            lengths: zeros(frame.norms.len())?,
            along: zeros(bank.directions.len() / n)?,
            zeta: zeros(d)?,
            mean: zeros(n)?,
            frame,
            bank,
        })
    }

    /// One call: readings `y`, nan where one is missing, and the inputs that acted since the last call. After an alarm
    /// all pairs are taken into the fresh set.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn step(&mut self, y: &[f64], acted: &[f64]) -> Result<()> {
        if (y.len(), acted.len()) != (self.window.outputs(), self.window.inputs()) {
            let expected = format!("{} readings and {} inputs", self.window.outputs(), self.window.inputs());
            return Err(Error::Shape { name: "y", expected, found: format!("{} and {}", y.len(), acted.len()) });
        }
        self.counts.calls += 1.0;
        self.counts.skipped += 1.0;
        if self.counts.alarmed == 0.0 {
            self.recent.push(y.iter().chain(acted).copied());
        }
        let read = y.iter().all(|v| v.is_finite());
        if self.counts.since > 0.0 && read && acted.iter().all(|v| v.is_finite()) {
            if self.counts.since == 1.0 {
                self.window.start(&self.first, acted, &mut self.x);
            }
            self.window.regressors(&self.x, acted, 1.0, &mut self.z);
            if self.counts.since > self.window.fill() as f64 {
                self.pair(y);
            }
            self.window.advance(&mut self.x, y, acted);
            self.counts.since += 1.0;
        } else if read {
            self.first.copy_from_slice(y);
            self.counts.since = 1.0;
        } else {
            self.counts.since = 0.0;
        }
        Ok(())
    }

    /// All bets of a pair, if z is determined.
    fn pair(&mut self, y: &[f64]) {
        if !self.frame.residual(&self.z, y, &mut self.e, &mut self.wz, &mut self.lengths) {
            return;
        }
        self.counts.skipped = 0.0;
        if self.counts.alarmed > 0.0 {
            self.fresh.add(&self.frame, &self.z, &self.e);
        }
        let (n, mut ends) = (self.e.len(), [true, false, false, true, true]);
        for (to, l) in self.along.iter_mut().zip(self.bank.directions.chunks_exact(n)) {
            *to = dot(l, &self.e);
        }
        self.counts.pairs += 1.0;
        self.counts.starts[0] += 1.0;
        let mut active = self.single_steps() | self.learned();
        for k in 0..2 {
            if (self.counts.pairs as u64).is_multiple_of(self.bank.blocks[k] as u64) {
                self.counts.starts[k + 1] += 1.0;
                active |= self.end(k);
                ends[k + 1] = true;
            }
        }
        let r = (size(&self.e) - dot(&self.frame.norms, &self.lengths)).max(0.0);
        for (k, b) in self.law.0.shares().iter().enumerate() {
            self.grow(self.begins[3] + k, 0, self.law.0.energy(*b, r, n));
        }
        self.counts.idle = if active { 0.0 } else { self.counts.idle + 1.0 };
        self.judge(ends);
    }

    /// `M <- e (M + what starts)`: 1, or of the once form `1 / (k (k + 1))` at the kth end of a block.
    fn grow(&mut self, at: usize, block: usize, factor: f64) {
        let k = self.counts.starts[block];
        let add = if let Promise::Every(_) = self.promise { 1.0 } else { 1.0 / (k * (k + 1.0)) };
        let factor = if factor.is_nan() { 0.0 } else { factor.min(LARGEST) }; // what overflows counts for nothing
        self.evidence[at] = (factor * (self.evidence[at] + add)).min(1e290);
    }

    /// Whether a block has one penalty, for a constant system.
    pub(super) fn joint(&self) -> bool {
        self.law.1 == Null::Constant && self.law.0 != Laws::Symmetric
    }

    /// Bets on this pair alone, and what blocks add up.
    fn single_steps(&mut self) -> bool {
        let (law, joint, small, any) = (self.law.0, self.joint(), self.bank.small, self.wz.len());
        let mut active = false;
        for b in 0..self.bank.column.len() {
            let g = self.z.get(self.bank.column[b]).copied().unwrap_or(1.0);
            let (parts, direction) = (self.lengths.len(), self.bank.direction[b]);
            let p = g.abs() * dot(&self.bank.spreads[direction * parts..(direction + 1) * parts], &self.lengths);
            let (x, v) = (g * self.along[direction], g * g);
            self.squares[0][b] += (p * p).min(MOST);
            self.sizes[0][b] += v;
            for k in 0..self.bank.shifts.len() {
                let s = self.bank.shifts[k] * self.bank.unit[b];
                let a = if v > 0.0 { (s - p / v).max(0.0) } else { 0.0 };
                active |= a > 0.0;
                for (side, x) in [x, -x].into_iter().enumerate() {
                    self.grow((b * self.bank.shifts.len() + k) * 2 + side, 0, law.factor(a, x, p, v));
                    if k < small && !joint {
                        self.sums[0][(b * small + k) * 2 + side] += law.factor(s, x, p, v).max(LEAST).ln();
                    }
                }
                if k < small && joint {
                    let (at, [odd, even, slope]) = (b * small + k, law.block(s, x, v));
                    self.sums[0][2 * at] += odd;
                    self.sums[0][2 * at + 1] += even;
                    axpy(slope * g, &self.wz, &mut self.drift[0][at * any..(at + 1) * any]);
                }
            }
            self.seen(b, 0, p, v, 1.0, 1.0 / IDLE);
        }
        active
    }

    /// The end of a short block (0), which goes into the long one, or of a long one (1).
    fn end(&mut self, which: usize) -> bool {
        let (small, any, parts, joint) = (self.bank.small, self.wz.len(), self.lengths.len(), self.joint());
        let mut active = false;
        for at in 0..self.bank.column.len() * small {
            let (b, s) = (at / small, self.bank.shifts[at % small] * self.bank.unit[at / small]);
            let drift = |p: usize| size(&self.drift[which][at * any..][self.frame.begins[p]..self.frame.begins[p + 1]]);
            let spreads = &self.bank.spreads[self.bank.direction[b] * parts..][..parts];
            let p: f64 = super::frame::WIDER * (0..parts).map(|p| spreads[p] * drift(p)).sum::<f64>();
            let [mut one, mut other] = [self.sums[which][2 * at], self.sums[which][2 * at + 1]];
            if joint {
                let lost = other + s * p + self.law.0.curvature() * s * s * self.squares[which][b];
                (one, other) = (one - lost, -one - lost);
                active |= s * self.sizes[which][b] > 2.0 * p;
            }
            self.grow(self.begins[which + 1] + 2 * at, which + 1, one.exp());
            self.grow(self.begins[which + 1] + 2 * at + 1, which + 1, other.exp());
            if which == 1 && joint && at % small == 0 {
                self.seen(b, 1, p, self.sizes[1][b], self.bank.blocks[1] as f64, 0.25);
            }
        }
        for [short, long] in [&mut self.sums, &mut self.drift, &mut self.squares, &mut self.sizes] {
            if which == 0 {
                axpy(1.0, short, long);
                short.fill(0.0);
            } else {
                long.fill(0.0);
            }
        }
        active
    }

    /// The mean growth `(s - p / v)_+^2 v / 2` of the evidence under each change of a gain or a load.
    fn seen(&mut self, b: usize, which: usize, p: f64, v: f64, steps: f64, rate: f64) {
        let whole = self.bank.whole[b];
        if whole > 0.0 && v > 0.0 {
            for (k, mean) in self.growth[which][b * CHANGES..(b + 1) * CHANGES].iter_mut().enumerate() {
                let growth = 0.5 * v * (change(k) * whole - p / v).max(0.0).powi(2) / steps;
                *mean += rate * (growth.min(MOST) - *mean);
            }
        }
    }

    /// Bets on running estimates of the difference from C, less what the region may be off.
    fn learned(&mut self) -> bool {
        let (n, d) = self.frame.sizes;
        self.zeta.iter_mut().zip(self.frame.scaled.chunks_exact(d)).for_each(|(to, row)| *to = dot(row, &self.z));
        let mut active = false;
        for (q, memory) in LEARNED.iter().enumerate() {
            let rows = self.estimates[q * n * d..].chunks_exact(d);
            self.mean.iter_mut().zip(rows).for_each(|(to, row)| *to = dot(row, &self.zeta));
            let shift = (size(&self.mean) - dot(&self.frame.norms, &self.lengths)).clamp(0.0, SHIFT);
            let mut factor = 1.0;
            if shift > 0.0 {
                let parts = self.lengths.iter().enumerate();
                let p: f64 = parts.map(|(p, length)| self.frame.spread(p, &self.mean) * length).sum();
                let l = 1.0 / size(&self.mean);
                factor = self.law.0.factor(shift, l * dot(&self.mean, &self.e), l * p, 1.0);
                active = true;
            }
            self.grow(self.begins[4] + q, 0, factor);
            let gain = 1.0 / (memory + dot(&self.zeta, &self.zeta));
            for (i, row) in self.estimates[q * n * d..].chunks_exact_mut(d).take(n).enumerate() {
                let rate = gain * (self.e[i] - self.mean[i]);
                axpy(if rate.is_finite() { rate } else { 0.0 }, &self.zeta, row);
            }
        }
        active
    }

    /// `sum pi b M` over the parts whose block ends, and the alarm.
    fn judge(&mut self, ends: [bool; 5]) {
        let (mut sum, mut best, mut place) = (0.0, 0.0, 0);
        for part in (0..5).filter(|part| ends[*part]) {
            for at in self.begins[part]..self.begins[part + 1] {
                let own = self.weights[part] * self.evidence[at];
                sum += own;
                if own > best {
                    (best, place) = (own, at);
                }
            }
        }
        self.counts.evidence = sum;
        if sum >= self.threshold() * (1.0 + 1e-9) {
            if self.counts.alarmed == 0.0 {
                self.counts.first = [self.counts.calls, place as f64];
            }
            self.counts.alarms += 1.0;
            self.counts.alarmed = 1.0;
            self.counts.pairs = 0.0; // the starts of the once form go on
            self.evidence.fill(0.0);
            for sums in [&mut self.sums, &mut self.drift, &mut self.squares, &mut self.sizes] {
                sums.iter_mut().for_each(|sums| sums.fill(0.0));
            }
        }
    }

    /// Evidence at which there is an alarm.
    #[must_use]
    pub fn threshold(&self) -> f64 {
        match self.promise {
            // sum pi (b - 1): both blocks have the weight of a learned bet
            Promise::Every(steps) => steps + self.weights[4] * (self.bank.blocks[0] + self.bank.blocks[1] - 2) as f64,
            Promise::Ever(level) => 1.0 / level,
        }
    }

    /// How the last call ended.
    #[must_use]
    pub fn status(&self) -> &'static str {
        match self.counts {
            Counts { alarmed, .. } if alarmed > 0.0 => "alarm",
            Counts { skipped, calls, .. } if skipped > 0.0 || calls == 0.0 => "skipping",
            Counts { idle, .. } if idle >= IDLE => "blind",
            _ => "quiet",
        }
    }

    /// Takes an alarm as seen: quiet until the next one, and the pairs after it are forgotten.
    pub fn clear(&mut self) {
        self.counts.alarmed = 0.0;
        self.fresh.clear();
        self.recent.clear();
    }

    /// What changes from call to call beside the arrays.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// What the region and the noise are measured in, and the pairs after an alarm.
    pub fn after(&mut self) -> (&Frame, &mut Fresh) {
        (&self.frame, &mut self.fresh)
    }

    /// What a place in the evidence is of: part, direction and column of the bet, and whether it fell.
    #[must_use]
    pub fn bet(&self, place: usize) -> (usize, usize, usize, bool) {
        let part = (0..5).rev().find(|part| place >= self.begins[*part]).unwrap_or(0);
        let wide = 2 * if part == 0 { self.bank.shifts.len() } else { self.bank.small };
        let b = (place - self.begins[part]) / wide;
        let of = |list: &[usize]| list.get(b).copied().unwrap_or(0);
        (part, self.reading(of(&self.bank.direction)), of(&self.bank.column), place % 2 == 1)
    }

    /// The reading of a direction; their number for those of gains.
    fn reading(&self, direction: usize) -> usize {
        self.frame.rows.get(direction).copied().unwrap_or(self.frame.outputs)
    }

    /// Direction, column, and the least change of each gain, in parts of it, and load, in deviations, that would be
    /// seen within so many `steps`, by the growth of the evidence in the last 200 pairs: a rule, not a bound.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn sights(&self, steps: f64) -> Result<Vec<(usize, usize, f64)>> {
        let wanted = (self.threshold().ln() + 7.0) / steps;
        let seen = |b: usize, k: usize| self.growth.iter().any(|means| means[b * CHANGES + k] >= wanted);
        let least = |b: usize| (0..CHANGES).find(|k| seen(b, *k)).map_or(f64::INFINITY, change);
        let places = (0..self.bank.whole.len()).filter(|b| self.bank.whole[*b] > 0.0);
        try_collect(WHAT, places.map(|b| (self.reading(self.bank.direction[b]), self.bank.column[b], least(b))))
    }

    /// The evidence of each bet.
    #[must_use]
    pub fn evidence(&self) -> (&[f64], [usize; 6]) {
        (&self.evidence, self.begins)
    }

    fn lists(&mut self) -> impl Iterator<Item = &mut Vec<f64>> {
        let own = [&mut self.x, &mut self.first, &mut self.evidence, &mut self.estimates];
        let pairs = [&mut self.sums, &mut self.drift, &mut self.squares, &mut self.sizes, &mut self.growth];
        own.into_iter().chain(pairs.into_iter().flatten()).chain([self.fresh.triangle()])
    }

    /// All that changes from call to call, to go on from bit by bit.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn numbers(&mut self) -> Result<Vec<f64>> {
        let c = self.counts;
        let counts = [c.calls, c.pairs, c.since, c.idle, c.skipped, c.alarms, c.alarmed, c.evidence];
        let sizes = [self.fresh.size(), self.recent.len() as f64];
        let mut found = try_collect(WHAT, counts.into_iter().chain(c.starts).chain(c.first).chain(sizes))?;
        for list in self.lists() {
            try_extend(WHAT, &mut found, list.iter().copied())?;
        }
        for row in self.recent.iter() {
            try_extend(WHAT, &mut found, row.iter().copied())?;
        }
        Ok(found)
    }

    /// Undoes [`Watch::numbers`].
    ///
    /// # Errors
    /// [`Error::Shape`] for numbers of another watch.
    pub fn resume(&mut self, numbers: &[f64]) -> Result<()> {
        let own = 15 + self.lists().map(|list| list.len()).sum::<usize>();
        let wide = self.window.outputs() + self.window.inputs();
        let more = numbers.get(14).map_or(0, |calls| *calls as usize).saturating_mul(wide);
        let sound = numbers.len() == own.saturating_add(more) && numbers[..own].iter().all(|v| v.is_finite());
        let Some((counts, mut rest)) = numbers.split_first_chunk::<15>().filter(|_| sound) else {
            let found = numbers.len().to_string();
            return Err(Error::Shape { name: "state", expected: format!("{own} finite numbers"), found });
        };
        let [calls, pairs, since, idle, skipped, alarms, alarmed, evidence, a, b, c, d, e, size, _] = *counts;
        let (starts, first) = ([a, b, c], [d, e]);
        self.counts = Counts { calls, pairs, starts, since, idle, skipped, alarms, alarmed, evidence, first };
        for list in self.lists() {
            let (own, after) = rest.split_at(list.len());
            *list = try_copy(WHAT, own)?;
            rest = after;
        }
        self.recent.clear();
        rest.chunks_exact(wide).for_each(|row| self.recent.push(row.iter().copied()));
        self.fresh.resume(size);
        Ok(())
    }
}

fn change(k: usize) -> f64 {
    0.02 * 1.5_f64.powi(k as i32)
}
