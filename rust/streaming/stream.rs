//! The stream: the choice of the slot, and the update of its estimate and of all that depends on it.

use super::estimator::Estimator;
use super::geometry::{Geometry, scaled_norm};
use super::products::{Products, Start};
use super::trace::{Entry, on_grid};
use crate::control::singular_values;
use crate::error::{Error, Result, sized};
use crate::memory::{checked_len, try_filled, try_room, try_zeros};
use crate::named::named;
use crate::sample::{Law, Sequence};
use crate::stream::Key;
use crate::vector::norm;

/// The choice of the next slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Each with probability 1/3.
    Random,
    /// `x0`, `xf`, `A` in turn.
    RoundRobin,
    /// The one with the largest guaranteed decrease of the mean squared error of the state.
    Gain,
}

named!(Order { Random => "random", RoundRobin => "round-robin", Gain => "gain" });

/// Options of a stream; they never change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// Whether every step is followed by a line search towards the mean of all realizations.
    pub safeguard: bool,
    /// Which slot moves.
    pub order: Order,
}

/// The means that are drawn from and fitted to, one key per slot, and one key for the choice of slots.
#[derive(Debug, Clone)]
pub struct StreamLaws {
    /// `x0`, `n` entries.
    pub x0: Vec<f64>,
    /// `xf`, `n` entries.
    pub xf: Vec<f64>,
    /// `A`, column by column.
    pub a: Vec<f64>,
    /// Keys of `x0`, `xf`, `A` and of the choice.
    pub keys: [Key; 4],
}

/// The sequential algorithm on its own realizations.
pub struct Stream {
    pub(super) config: Config,
    pub(super) geometry: Geometry,
    pub(super) keys: [Key; 4],
    /// `x0`, `xf`, `A`
    pub(super) slots: [Estimator; 3],
    pub(super) choice: Sequence,
    pub(super) start: Start,
    pub(super) products: Products,
    pub(super) steps: u64,
    pub(super) drift: f64,
    pub(super) trace: Vec<Entry>,
    refresh_every: u64,
    /// `||A||_F`
    pub(super) size_a: f64,
    /// `||A||_2`, needed for [`Order::Gain`]
    norm_a: f64,
    work: [Vec<f64>; 2],
    room: Room,
}

impl std::fmt::Debug for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { config, geometry, choice, steps, .. } = self;
        let mut shown = f.debug_struct("Stream");
        shown.field("config", config).field("size", &geometry.size()).field("choice", choice);
        shown.field("steps", steps).finish_non_exhaustive()
    }
}

const WHAT: &str = "a stream";

/// Most entries of a trace: steps `0..=16`, and eight per octave up to `2^64`.
const MOST_ENTRIES: usize = 17 + 8 * 60;

/// Scratch space of refreshes and certificates, allocated beforehand so that no step fails halfway.
pub(super) struct Room {
    lines: Lines,
    fresh: Products,
}

/// Vectors as long as a state.
pub(super) type Lines = [Vec<f64>; 6];

impl Room {
    fn new(n: usize, x0: &Estimator) -> Result<Self> {
        Ok(Self { lines: Self::lines(n)?, fresh: Products::none(n, x0)? })
    }

    pub(super) fn lines(n: usize) -> Result<Lines> {
        let mut lines = Lines::default();
        for line in &mut lines {
            *line = try_zeros(WHAT, n)?;
        }
        Ok(lines)
    }
}

impl Stream {
    /// A stream that has drawn one realization for every slot.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`] or [`Error::Value`] for laws or a `B` that cannot be
    /// used.
    pub fn new(geometry: Geometry, laws: StreamLaws, config: Config) -> Result<Self> {
        let mut stream = Self::unstarted(geometry, laws, config)?;
        for slot in &mut stream.slots {
            slot.fuse_next();
        }
        stream.start.update(&stream.slots[0]);
        stream.products = Products::direct(&stream.slots[2], &stream.start)?;
        stream.record(1.0);
        Ok(stream)
    }

    /// The stream before its first realizations.
    pub(super) fn unstarted(geometry: Geometry, laws: StreamLaws, config: Config) -> Result<Self> {
        let n = geometry.n;
        let shapes = [("x0", &laws.x0, n), ("xf", &laws.xf, n), ("A", &laws.a, checked_len("A", n, n)?)];
        for (name, values, len) in shapes {
            sized(name, values.len(), len)?;
        }
        let slot = |values, lines, key: Key| Estimator::new(values, lines, n, key, config.safeguard);
        let size_a = scaled_norm(&laws.a);
        let norm_a = if config.order == Order::Gain {
            singular_values(&laws.a, n)?.first().copied().unwrap_or(0.0)
        } else {
            0.0
        };
        let slots = [slot(laws.x0, 1, laws.keys[0])?, slot(laws.xf, 1, laws.keys[1])?, slot(laws.a, n, laws.keys[2])?];
        // ||Ff - FA F0||_1 <= gf + gA g0 for all means of realizations: if this is finite, nothing overflows later
        let largest = |k: usize| slots[k].law.gamma().iter().fold(0.0f64, |m, g| m.max(*g));
        let size = largest(1) + largest(2) * largest(0);
        if !(size * 4.0).is_finite() || !geometry.largest_control(size * 4.0).is_finite() {
            return Err(Error::Overflow { what: "`xf - A x0` or the control" });
        }
        let thirds = Law::new(try_filled("a law", 1.0, 3)?, 1, 3)?;
        Ok(Self {
            config,
            keys: laws.keys,
            choice: Sequence::new(&thirds.into(), laws.keys[3])?,
            start: Start::of(&slots[0])?,
            products: Products::none(n, &slots[0])?,
            steps: 0,
            drift: 0.0,
            trace: try_room(WHAT, MOST_ENTRIES)?,
            refresh_every: 16 * n.max(16) as u64,
            size_a,
            norm_a,
            work: [try_zeros(WHAT, n)?, try_zeros(WHAT, n)?],
            room: Room::new(n, &slots[0])?,
            slots,
            geometry,
        })
    }

    /// One step: chooses a slot, draws its next realization, moves. Returns the step size `t`.
    pub fn step(&mut self) -> f64 {
        let slot = self.next_slot();
        let t = self.fused_step(slot);
        self.steps += 1;
        if self.steps.is_multiple_of(self.refresh_every) {
            self.refresh();
        }
        if on_grid(self.steps) {
            self.record(t);
        }
        t
    }

    fn fused_step(&mut self, slot: usize) -> f64 {
        let by = self.slots[slot].fuse_next();
        match slot {
            0 => {
                let [x0, _, a] = &self.slots;
                let (i, value) = (x0.raw[0] as usize, x0.raw_value(0));
                self.products.move_start(a, i, value, by, &mut self.work);
                self.start.update(x0);
            }
            1 => {}
            _ => self.products.move_matrix(&self.slots[2], &self.start, by, &mut self.work),
        }
        by.t
    }

    fn next_slot(&mut self) -> usize {
        match self.config.order {
            Order::Random => self.choice.draw()[0] as usize,
            Order::RoundRobin => (self.steps % 3) as usize,
            Order::Gain => self.gainful_slot(),
        }
    }

    /// One step from the squared error `d^2` gives at most `V d^2 / (V + d^2)` in the mean, so the decrease is at least
    /// `d^4 / (V + d^2)`. An error of `x0`, `xf`, `A` changes the state by at most `||A||`, 1, `||F0||` times as much.
    fn gainful_slot(&self) -> usize {
        let [x0, xf, a] = &self.slots;
        let f0 = norm(&self.start.f) * x0.scale;
        let gain = |slot: &Estimator, factor: f64| {
            let d2 = slot.run.state.er.max(0.0);
            let reached = (factor * slot.scale).powi(2) * d2;
            if d2 > 0.0 { reached * (d2 / (slot.variance + d2)) } else { 0.0 }
        };
        let gains = [gain(x0, self.norm_a), gain(xf, 1.0), gain(a, f0)];
        if !gains.iter().any(|g| *g > 0.0 && g.is_finite()) {
            return (self.steps % 3) as usize; // no gain that doubles can represent
        }
        [1, 2].into_iter().fold(0, |best, k| if gains[k] > gains[best] { k } else { best })
    }

    /// Recomputes from the entries the numbers that steps update, and records their largest error, relative to
    /// `||FA|| ||F0||` (Frobenius).
    fn refresh(&mut self) {
        let Room { lines: [line, off, ..], fresh } = &mut self.room;
        self.slots.iter_mut().for_each(|slot| slot.run.refresh());
        self.start.update(&self.slots[0]);
        fresh.sum_up(&self.slots[2], &self.start, line);
        let size = self.slots[2].run.state.ff.max(0.0).sqrt() * norm(&self.start.f);
        off.iter_mut().zip(&fresh.ff).zip(&self.products.ff).for_each(|((off, a), b)| *off = a - b);
        if size > 0.0 {
            self.drift = self.drift.max(norm(off) / size);
        }
        std::mem::swap(&mut self.products, fresh);
    }

    fn record(&mut self, size: f64) {
        let mut lines = std::mem::take(&mut self.room.lines);
        let (certificate, error) = self.certificate_in(&mut lines);
        self.room.lines = lines;
        self.trace.push(Entry { step: self.steps, certificate, error, size });
    }
}

#[cfg(test)]
pub(super) mod tests;
