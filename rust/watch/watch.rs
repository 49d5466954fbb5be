//! The evidence against the region, step by step, and the alarm.

use crate::error::{Error, Result};
use crate::memory::{try_collect, try_zeros};
use crate::window::Window;

use super::bank::{Bank, Bet, Null};
use super::frame::{Frame, WHAT};
use super::laws::{LARGEST, Laws};

/// Largest evidence of a bet.
const MOST: f64 = 1e290;
/// `L` of the learned bets, and the largest shift that they bet on.
const LEARNED: [f64; 2] = [20.0, 200.0];
const SHIFT: f64 = 5.0;
/// Steps in which nothing could have told, to be blind; also those of the mean of what is seen.
const IDLE: f64 = 200.0;
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

/// How a call ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// A pair was looked at, without an alarm since the last [`Watch::clear`].
    Quiet,
    /// There was an alarm since then.
    Alarm,
    /// In the last 200 pairs nothing but louder noise could have told.
    Blind,
    /// No pair could be looked at in this call.
    Skipping,
}

/// What has the most evidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Rang {
    /// A bet, whether it fell, and over how many steps.
    Bet(Bet, bool, usize),
    /// The noise is larger than its bound.
    Noise,
    /// A learned bet: a change of no single entry.
    Mixed,
}

/// An alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alarm {
    /// The call, counted from 1.
    pub call: u64,
    /// The call from which on the evidence grew.
    pub onset: u64,
    /// What has the most evidence.
    pub rang: Rang,
}

/// The least change of a bet that would be seen within so many steps; infinite where none of up to 800 %.
#[derive(Debug, Clone, Copy)]
pub struct Sight {
    /// A gain or a load.
    pub bet: Bet,
    /// In parts of the gain, or in deviations of the noise.
    pub least: f64,
}

/// The counters of a watch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Counts {
    calls: f64,
    /// Pairs since the last restart, and blocks of the once form.
    clock: f64,
    starts: [f64; 3],
    since: f64,
    begun: f64,
    idle: f64,
    skipped: f64,
    alarms: f64,
    alarmed: f64,
    evidence: f64,
}

/// Bets on a region while the plant is in use; no call allocates.
#[derive(Debug)]
pub struct Watch {
    frame: Frame,
    bank: Bank,
    law: Laws,
    null: Null,
    promise: Promise,
    window: Window,
    counts: Counts,
    last: Option<Alarm>,
    /// State of the window, its first reading, z.
    x: Vec<f64>,
    first: Vec<f64>,
    z: Vec<f64>,
    /// Evidence (bets, shifts, 2), and of short and long blocks (bets, small, 2); of the energy; of learned bets.
    single: Vec<f64>,
    short: Vec<f64>,
    long: Vec<f64>,
    energy: Vec<f64>,
    learned: Vec<f64>,
    /// The call at which the evidence was last below that of one start, of all of these.
    onset: Vec<f64>,
    /// Sums of a short block and of a long one (bets, small, 2), `sum phi' g'z W z` (bets, small, any), `sum p^2` (bets), and
    /// `sum (g'z)^2` (bets).
    sums: [Vec<f64>; 2],
    drift: [Vec<f64>; 2],
    squares: [Vec<f64>; 2],
    weights: [Vec<f64>; 2],
    /// Estimates (2, n, own) of `L^-1 (Theta - C) P^(1/2)`.
    estimates: Vec<f64>,
    /// Growth of the evidence by changes (bets, CHANGES): mean of single steps, and of long blocks.
    growth: [Vec<f64>; 2],
    /// Room for one step: e, W z, lengths, `l'e` of the directions, zeta, and the estimate of the mean of e.
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
    pub fn new(
        frame: Frame,
        bank: Bank,
        law: Laws,
        null: Null,
        promise: Promise,
        window: Window,
    ) -> Result<Self> {
        let (n, d) = (frame.n(), frame.width());
        let all = frame.rows.last().map_or(0, |i| i + 1);
        if window.length() != d || window.outputs() < all {
            let (expected, found) = (format!("{d} regressors of {all} readings"), window.length().to_string());
            return Err(Error::Shape { name: "window", expected, found });
        }
        let (name, low, high, value) = match promise {
            Promise::Every(steps) => ("every", 2.0, 1e15, steps),
            Promise::Ever(level) => ("level", 1e-15, 0.5, level),
        };
        if !(low..=high).contains(&value) {
            let expected = "in [2, 1e15] for every, in [1e-15, 0.5] for level";
            return Err(Error::Value { name, expected, found: value.to_string() });
        }
        let zeros = |count: usize| try_zeros::<f64>(WHAT, count);
        let pair = |count: usize| Ok::<_, Error>([zeros(count)?, zeros(count)?]);
        let (bets, any, small) = (bank.bets.len(), frame.white.len() / d, bank.small);
        let [single, short, energy] = [bets * bank.shifts.len() * 2, bets * small * 2, law.shares().len()];
        Ok(Self {
            law,
            null,
            promise,
            window,
            counts: Counts::default(),
            last: None,
            x: zeros(window.states())?,
            first: zeros(window.outputs())?,
            z: zeros(d)?,
            single: zeros(single)?,
            short: zeros(short)?,
            long: zeros(short)?,
            energy: zeros(energy)?,
            learned: zeros(LEARNED.len())?,
            onset: zeros(single + 2 * short + energy + LEARNED.len())?,
            sums: pair(short)?,
            drift: pair(bets * small * any)?,
            squares: pair(bets)?,
            weights: pair(bets)?,
            estimates: zeros(LEARNED.len() * n * d)?,
            growth: pair(bets * CHANGES)?,
            e: zeros(n)?,
            wz: zeros(any)?,
            lengths: zeros(frame.count())?,
            along: zeros(bank.directions.len() / n)?,
            zeta: zeros(d)?,
            mean: zeros(n)?,
            frame,
            bank,
        })
    }

    /// One call: readings `y`, nan where one is missing, and the inputs that acted since the last call. True where a pair was
    /// complete, which is then in [`Watch::pair`].
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn step(&mut self, y: &[f64], acted: &[f64]) -> Result<bool> {
        if y.len() != self.window.outputs() || acted.len() != self.window.inputs() {
            let expected = format!("{} readings and {} inputs", self.window.outputs(), self.window.inputs());
            return Err(Error::Shape { name: "y", expected, found: format!("{} and {}", y.len(), acted.len()) });
        }
        self.counts.calls += 1.0;
        let read = y.iter().all(|v| v.is_finite());
        let mut looked = false;
        if self.counts.begun > 0.0 && acted.iter().all(|v| v.is_finite()) && read {
            if self.counts.since == 0.0 {
                self.window.start(&self.first, acted, &mut self.x);
            }
            self.window.regressors(&self.x, acted, 1.0, &mut self.z);
            looked = self.counts.since >= self.window.fill() as f64 && self.bet(y);
            self.window.advance(&mut self.x, y, acted);
            self.counts.since += 1.0;
        } else {
            (self.counts.begun, self.counts.since) = (f64::from(u8::from(read)), 0.0);
            if read {
                self.first.copy_from_slice(y);
            }
        }
        self.counts.skipped = if looked { 0.0 } else { self.counts.skipped + 1.0 };
        Ok(looked)
    }

    /// What of a start counts at this end of a block, the `k`th.
    fn start(&self, k: f64) -> f64 {
        match self.promise {
            Promise::Every(_) => 1.0,
            Promise::Ever(_) => 1.0 / (k * (k + 1.0)),
        }
    }

    /// All bets of a pair; false where none can be made.
    fn bet(&mut self, y: &[f64]) -> bool {
        if !self.frame.residual(&self.z, y, &mut self.e, &mut self.wz, &mut self.lengths) {
            return false;
        }
        let n = self.frame.n();
        for (to, l) in self.along.iter_mut().zip(self.bank.directions.chunks_exact(n)) {
            *to = l.iter().zip(&self.e).map(|(a, b)| a * b).sum();
        }
        self.counts.clock += 1.0;
        self.counts.starts[0] += 1.0;
        let mut active = self.single_steps();
        let (mut ends, clock) = ([true, false, false], self.counts.clock as u64);
        if clock.is_multiple_of(self.bank.blocks.0 as u64) {
            self.counts.starts[1] += 1.0;
            active |= self.end(0);
            ends[1] = true;
        }
        if clock.is_multiple_of(self.bank.long() as u64) {
            self.counts.starts[2] += 1.0;
            active |= self.end(1);
            ends[2] = true;
        }
        active |= self.bet_on_estimates();
        self.bet_on_energy();
        self.counts.idle = if active { 0.0 } else { self.counts.idle + 1.0 };
        self.judge(ends);
        true
    }

    fn single_steps(&mut self) -> bool {
        let (mut active, add) = (false, self.start(self.counts.starts[0]));
        let (count, small, any) = (self.bank.shifts.len(), self.bank.small, self.wz.len());
        let joint = self.joint();
        for b in 0..self.bank.bets.len() {
            let g = self.z.get(self.bank.column[b]).copied().unwrap_or(1.0);
            let direction = self.bank.direction[b];
            let spreads = self.bank.spreads.iter().skip(direction * self.lengths.len());
            let p = g.abs() * spreads.zip(&self.lengths).map(|(s, h)| s * h).sum::<f64>();
            let (x, v) = (g * self.along[direction], g * g);
            self.squares[0][b] += p * p;
            self.weights[0][b] += v;
            for (k, shift) in self.bank.shifts.iter().enumerate() {
                let s = shift * self.bank.unit[b];
                let a = if v > 0.0 { (s - p / v).max(0.0) } else { 0.0 };
                active |= a > 0.0;
                for (side, x) in [x, -x].into_iter().enumerate() {
                    let at = (b * count + k) * 2 + side;
                    let factor = self.law.factor(a, x, p, v);
                    grow(&mut self.single[at], &mut self.onset[at], factor, add, self.counts.calls);
                    if k < small && !joint {
                        self.sums[0][(b * small + k) * 2 + side] += self.law.factor(s, x, p, v).ln();
                    }
                }
                if let Some((odd, even, slope)) = self.law.block(s, x, v).filter(|_| k < small && joint) {
                    let at = b * small + k;
                    self.sums[0][2 * at] += odd;
                    self.sums[0][2 * at + 1] += even;
                    let drift = &mut self.drift[0][at * any..(at + 1) * any];
                    drift.iter_mut().zip(&self.wz).for_each(|(to, w)| *to += slope * g * w);
                }
            }
            if !matches!(self.bank.bets[b], Bet::Entry(..)) {
                let rate = 1.0 / IDLE;
                for (k, mean) in self.growth[0][b * CHANGES..(b + 1) * CHANGES].iter_mut().enumerate() {
                    *mean += rate * (gained(change(k) * self.bank.whole[b], p, v) - *mean);
                }
            }
        }
        active
    }

    /// Whether a block has one penalty, for a constant system.
    fn joint(&self) -> bool {
        self.null == Null::Constant && self.law != Laws::Symmetric
    }

    /// The end of a short block (0), which goes into the long one, or of a long one (1).
    fn end(&mut self, which: usize) -> bool {
        let (small, any, parts) = (self.bank.small, self.wz.len(), self.lengths.len());
        let add = self.start(self.counts.starts[which + 1]);
        let joint = self.joint();
        let begin = self.single.len() + which * self.short.len();
        let mut active = false;
        for b in 0..self.bank.bets.len() {
            let spreads = &self.bank.spreads[self.bank.direction[b] * parts..][..parts];
            for k in 0..small {
                let (at, s) = (b * small + k, self.bank.shifts[k] * self.bank.unit[b]);
                let drift = &self.drift[which][at * any..(at + 1) * any];
                let mut p = 0.0;
                for (spread, ends) in spreads.iter().zip(self.frame.begins.windows(2)) {
                    p += spread * drift[ends[0]..ends[1]].iter().map(|v| v * v).sum::<f64>().sqrt();
                }
                let (odd, even) = (self.sums[which][2 * at], self.sums[which][2 * at + 1]);
                let lost = even + s * p + self.law.curvature() * s * s * self.squares[which][b];
                active |= joint && s * self.weights[which][b] > 2.0 * p;
                for (side, log) in [(0, odd - lost), (1, -odd - lost)] {
                    let log = if joint { log } else { self.sums[which][2 * at + side] };
                    let evidence = if which == 0 { &mut self.short } else { &mut self.long };
                    let own = 2 * at + side;
                    grow(&mut evidence[own], &mut self.onset[begin + own], log.exp(), add, self.counts.calls);
                }
                if which == 1 && k == 0 && joint && !matches!(self.bank.bets[b], Bet::Entry(..)) {
                    let v = self.weights[which][b];
                    for (k, mean) in self.growth[1][b * CHANGES..(b + 1) * CHANGES].iter_mut().enumerate() {
                        let gained = gained(change(k) * self.bank.whole[b], p, v) / self.bank.long() as f64;
                        *mean += 0.25 * (gained - *mean);
                    }
                }
            }
        }
        for sums in [&mut self.sums, &mut self.drift, &mut self.squares, &mut self.weights] {
            let [short, long] = sums;
            if which == 0 {
                long.iter_mut().zip(&*short).for_each(|(to, v)| *to += v);
                short.fill(0.0);
            } else {
                long.fill(0.0);
            }
        }
        active
    }

    /// Bets on running estimates of the difference from C, less what the region may be off.
    fn bet_on_estimates(&mut self) -> bool {
        let (n, d) = (self.frame.n(), self.frame.width());
        let add = self.start(self.counts.starts[0]);
        let begin = self.onset.len() - LEARNED.len();
        for (to, row) in self.zeta.iter_mut().zip(self.frame.scaled.chunks_exact(d)) {
            *to = row.iter().zip(&self.z).map(|(a, b)| a * b).sum();
        }
        let size = self.zeta.iter().map(|v| v * v).sum::<f64>();
        let far: f64 = self.frame.norms.iter().zip(&self.lengths).map(|(a, b)| a * b).sum();
        let mut active = false;
        for (q, memory) in LEARNED.iter().enumerate() {
            let estimate = &mut self.estimates[q * n * d..(q + 1) * n * d];
            for (to, row) in self.mean.iter_mut().zip(estimate.chunks_exact(d)) {
                *to = row.iter().zip(&self.zeta).map(|(a, b)| a * b).sum();
            }
            let length = self.mean.iter().map(|v| v * v).sum::<f64>().sqrt();
            let shift = (length - far).clamp(0.0, SHIFT);
            let mut factor = 1.0;
            if shift > 0.0 && length.is_finite() {
                // l'e with the unit vector l of the estimate
                let unit = |v: f64| v / length;
                let x = self.mean.iter().zip(&self.e).map(|(m, e)| unit(*m) * e).sum::<f64>();
                let mut p = 0.0;
                for (reach, h) in self.frame.reach.chunks_exact(n * n).zip(&self.lengths) {
                    let along = |j: usize| (0..n).map(|i| unit(self.mean[i]) * reach[i * n + j]).sum::<f64>();
                    p += super::frame::WIDER * h * (0..n).map(|j| along(j).powi(2)).sum::<f64>().sqrt();
                }
                factor = self.law.factor(shift, x, p, 1.0);
                active = true;
            }
            grow(&mut self.learned[q], &mut self.onset[begin + q], factor, add, self.counts.calls);
            for (i, row) in estimate.chunks_exact_mut(d).enumerate() {
                let gain = (self.e[i] - self.mean[i]) / (memory + size);
                if gain.is_finite() {
                    row.iter_mut().zip(&self.zeta).for_each(|(to, z)| *to += gain * z);
                }
            }
        }
        active
    }

    fn bet_on_energy(&mut self) {
        let far: f64 = self.frame.norms.iter().zip(&self.lengths).map(|(a, b)| a * b).sum();
        let r = (self.e.iter().map(|v| v * v).sum::<f64>().sqrt() - far).max(0.0);
        let add = self.start(self.counts.starts[0]);
        let begin = self.onset.len() - LEARNED.len() - self.energy.len();
        for (k, b) in self.law.shares().iter().enumerate() {
            let factor = self.law.energy(*b, r, self.frame.n()).unwrap_or(1.0);
            grow(&mut self.energy[k], &mut self.onset[begin + k], factor, add, self.counts.calls);
        }
    }

    /// The weight of each of the six parts, and the mean length of their blocks beyond 1.
    fn weights(&self) -> (f64, f64) {
        let weight = 1.0 / if self.energy.is_empty() { 5.0 } else { 6.0 };
        (weight, weight * (self.bank.blocks.0 + self.bank.long() - 2) as f64)
    }

    /// Evidence at which there is an alarm.
    #[must_use]
    pub fn threshold(&self) -> f64 {
        match self.promise {
            Promise::Every(steps) => steps + self.weights().1,
            Promise::Ever(level) => 1.0 / level,
        }
    }

    /// `sum pi b M` over the parts whose block ends, and the alarm.
    fn judge(&mut self, ends: [bool; 3]) {
        let (weight, _) = self.weights();
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
        let block = |steps: usize| if matches!(self.promise, Promise::Every(_)) { steps as f64 } else { 1.0 };
        let mut sum = mean(&self.single) + mean(&self.energy) + self.learned.iter().sum::<f64>();
        if ends[1] {
            sum += block(self.bank.blocks.0) * mean(&self.short);
        }
        if ends[2] {
            sum += block(self.bank.long()) * mean(&self.long);
        }
        self.counts.evidence = weight * sum;
        if self.counts.evidence >= self.threshold() * (1.0 + 1e-9) {
            let (rang, onset) = self.loudest(ends);
            self.last = Some(Alarm { call: self.counts.calls as u64, onset: onset as u64, rang });
            self.counts.alarms += 1.0;
            self.counts.alarmed = 1.0;
            self.restart();
        }
    }

    fn loudest(&self, ends: [bool; 3]) -> (Rang, f64) {
        let (blocks, small) = (self.bank.blocks, self.bank.small);
        let lists: [(&[f64], usize, f64, usize); 5] = [
            (&self.single, self.bank.shifts.len(), 1.0, 1),
            (&self.short, small, blocks.0 as f64 * f64::from(u8::from(ends[1])), blocks.0),
            (&self.long, small, self.bank.long() as f64 * f64::from(u8::from(ends[2])), self.bank.long()),
            (&self.energy, 0, 1.0, 1),
            (&self.learned, 0, 1.0, 1),
        ];
        let (mut best, mut found, mut place) = (f64::NEG_INFINITY, (Rang::Mixed, 0.0), 0);
        for (part, (list, shifts, factor, steps)) in lists.into_iter().enumerate() {
            // learned bets are parts of their own
            let share = factor / if part == 4 { 1.0 } else { list.len().max(1) as f64 };
            for (at, value) in list.iter().enumerate() {
                if value * share > best {
                    best = value * share;
                    let rang = match part {
                        3 => Rang::Noise,
                        4 => Rang::Mixed,
                        _ => Rang::Bet(self.bank.bets[at / (2 * shifts)], at % 2 == 1, steps),
                    };
                    found = (rang, self.onset[place + at] + 1.0);
                }
            }
            place += list.len();
        }
        found
    }

    /// Begins the evidence anew; the starts of the once form go on.
    fn restart(&mut self) {
        for list in [&mut self.single, &mut self.short, &mut self.long, &mut self.energy, &mut self.learned] {
            list.fill(0.0);
        }
        for [short, long] in [&mut self.sums, &mut self.drift, &mut self.squares, &mut self.weights] {
            short.fill(0.0);
            long.fill(0.0);
        }
        self.onset.fill(self.counts.calls);
        self.counts.clock = 0.0;
    }

    /// Takes an alarm as seen: [`Watch::state`] is quiet until the next one.
    pub fn clear(&mut self) {
        self.counts.alarmed = 0.0;
    }

    /// How the last call ended.
    #[must_use]
    pub fn state(&self) -> State {
        match self.counts {
            Counts { alarmed, .. } if alarmed > 0.0 => State::Alarm,
            Counts { skipped, .. } if skipped > 0.0 || self.counts.calls == 0.0 => State::Skipping,
            Counts { idle, .. } if idle >= IDLE => State::Blind,
            _ => State::Quiet,
        }
    }

    /// z and the residual e of the last pair, in units of the noise.
    #[must_use]
    pub fn pair(&self) -> (&[f64], &[f64]) {
        (&self.z, &self.e)
    }

    /// The evidence of single steps, short and long blocks, the energy and learned bets, from all starts.
    #[must_use]
    pub fn evidence(&self) -> [&[f64]; 5] {
        [&self.single, &self.short, &self.long, &self.energy, &self.learned]
    }

    /// What the region and the noise are measured in.
    #[must_use]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The evidence of the last pair, calls, and alarms.
    #[must_use]
    pub fn counts(&self) -> (f64, u64, u64) {
        (self.counts.evidence, self.counts.calls as u64, self.counts.alarms as u64)
    }

    /// The last alarm.
    #[must_use]
    pub fn last(&self) -> Option<Alarm> {
        self.last
    }

    /// The least gain or load that would be seen within so many `steps`, by the growth of the evidence in the last 200 pairs: a
    /// rule, not a bound.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn sights(&self, steps: f64) -> Result<Vec<Sight>> {
        let wanted = (self.threshold().ln() + 7.0) / steps;
        let seen = |b: usize, k: usize| self.growth.iter().any(|means| means[b * CHANGES + k] >= wanted);
        let places = (0..self.bank.bets.len()).filter(|b| !matches!(self.bank.bets[*b], Bet::Entry(..)));
        let least = |b: usize| (0..CHANGES).find(|k| seen(b, *k)).map_or(f64::INFINITY, change);
        try_collect(WHAT, places.map(|b| Sight { bet: self.bank.bets[b], least: least(b) }))
    }

    fn lists(&mut self) -> impl Iterator<Item = &mut Vec<f64>> {
        let parts = [&mut self.sums, &mut self.drift, &mut self.squares, &mut self.weights, &mut self.growth];
        let own = [&mut self.x, &mut self.first, &mut self.z, &mut self.single, &mut self.short, &mut self.long];
        let last = [&mut self.energy, &mut self.learned, &mut self.onset, &mut self.estimates, &mut self.e];
        own.into_iter().chain(last).chain(parts.into_iter().flatten())
    }

    /// All that changes from call to call, to go on from bit by bit.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn numbers(&mut self) -> Result<Vec<f64>> {
        let Counts { calls, clock, starts: [one, short, long], since, begun, idle, skipped, alarms, alarmed, evidence } =
            self.counts;
        let counts = [calls, clock, one, short, long, since, begun, idle, skipped, alarms, alarmed, evidence];
        let last = self.last.map_or([0.0; 6], Alarm::numbers);
        let lists = self.lists().flat_map(|list| list.iter().copied());
        try_collect(WHAT, counts.into_iter().chain(last).chain(lists))
    }

    /// Undoes [`Watch::numbers`].
    ///
    /// # Errors
    /// [`Error::Shape`] for numbers of another watch.
    pub fn resume(&mut self, numbers: &[f64]) -> Result<()> {
        let own = 18 + self.lists().map(|list| list.len()).sum::<usize>();
        if numbers.len() != own || numbers.iter().any(|v| v.is_nan()) {
            let found = numbers.len().to_string();
            return Err(Error::Shape { name: "state", expected: format!("{own} numbers"), found });
        }
        let (counts, rest) = numbers.split_at(12);
        let (last, mut rest) = rest.split_at(6);
        if let [calls, clock, one, short, long, since, begun, idle, skipped, alarms, alarmed, evidence] = *counts {
            let starts = [one, short, long];
            self.counts = Counts { calls, clock, starts, since, begun, idle, skipped, alarms, alarmed, evidence };
        }
        self.last = Alarm::of(last);
        for list in self.lists() {
            let (own, after) = rest.split_at(list.len());
            list.copy_from_slice(own);
            rest = after;
        }
        Ok(())
    }
}

impl Alarm {
    fn numbers(self) -> [f64; 6] {
        let (kind, one, other, fell, steps) = match self.rang {
            Rang::Bet(Bet::Entry(i, j), fell, steps) => (1.0, i, j, fell, steps),
            Rang::Bet(Bet::Load(i), fell, steps) => (2.0, i, 0, fell, steps),
            Rang::Bet(Bet::Gain(j), fell, steps) => (3.0, j, 0, fell, steps),
            Rang::Noise => (4.0, 0, 0, false, 0),
            Rang::Mixed => (5.0, 0, 0, false, 0),
        };
        let side = if fell { -(steps as f64) } else { steps as f64 };
        [kind, one as f64, other as f64, side, self.call as f64, self.onset as f64]
    }

    fn of(numbers: &[f64]) -> Option<Self> {
        let &[kind, one, other, side, call, onset] = numbers else { return None };
        let (one, other) = (one as usize, other as usize);
        let bet = |of: Bet| Rang::Bet(of, side < 0.0, side.abs() as usize);
        let rang = match kind as u8 {
            1 => bet(Bet::Entry(one, other)),
            2 => bet(Bet::Load(one)),
            3 => bet(Bet::Gain(one)),
            4 => Rang::Noise,
            5 => Rang::Mixed,
            _ => return None,
        };
        Some(Self { call: call as u64, onset: onset as u64, rang })
    }
}

/// `M <- e (M + what starts)`.
fn grow(evidence: &mut f64, onset: &mut f64, factor: f64, add: f64, call: f64) {
    let factor = if factor.is_nan() { 0.0 } else { factor.min(LARGEST) }; // what overflows counts for nothing
    *evidence = (factor * (*evidence + add)).min(MOST);
    if *evidence <= add {
        *onset = call;
    }
}

/// The mean growth of the evidence under the shift s: `(s - p / v)_+^2 v / 2`.
fn gained(s: f64, p: f64, v: f64) -> f64 {
    if v > 0.0 { 0.5 * v * (s - p / v).max(0.0).powi(2) } else { 0.0 }
}

fn change(k: usize) -> f64 {
    0.02 * 1.5_f64.powi(k as i32)
}
