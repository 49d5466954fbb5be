//! The stream itself: which slot moves, what moves with it, and what can be read off.

use super::geometry::{Geometry, dot};
use super::products::{Products, Start};
use super::slot::{Slot, norm};
use super::trace::{Entry, on_grid};
use super::variants::Raw;
use crate::error::{Error, Result, checked_len};
use crate::sample::{Law, Sequence};
use crate::stream::Key;

/// What is averaged into the control at each step; see Algorithm 1 of the paper, which can be read in three ways.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// The new realization with the fused values of the other slots: converges.
    Consistent,
    /// The latest realization of every slot, weighted by the steps of the fused values: stops at a wrong control.
    Semi,
    /// The latest realizations throughout: does not converge.
    Literal,
}

/// Which slot moves next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Each with probability 1/3.
    Random,
    /// `x0`, `xf`, `A` in turn.
    RoundRobin,
    /// The one with the largest decrease of its part of the squared error that can be expected at least.
    Gain,
}

/// How a stream works; fixed for its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Config {
    /// What is averaged.
    pub variant: Variant,
    /// Whether every step is followed by a line search towards the mean of all realizations.
    pub safeguard: bool,
    /// Which slot moves.
    pub order: Order,
}

/// The means that are drawn from and fitted to, with one key per slot and one for the choice of slots.
#[derive(Clone)]
pub struct Laws {
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
#[derive(Clone)]
pub struct Stream {
    pub(super) config: Config,
    pub(super) geometry: Geometry,
    pub(super) keys: [Key; 4],
    /// `x0`, `xf`, `A`
    pub(super) slots: [Slot; 3],
    pub(super) choice: Sequence,
    pub(super) start: Start,
    pub(super) products: Products,
    /// the running difference of the variants that do not fuse, otherwise unused
    pub(super) raw: Raw,
    pub(super) steps: u64,
    pub(super) drift: f64,
    pub(super) trace: Vec<Entry>,
    refresh_every: u64,
    /// `||A||_2`, needed for [`Order::Gain`]
    norm_a: f64,
    work: [Vec<f64>; 2],
}

impl Stream {
    /// A stream that has drawn one realization for every slot.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`] or [`Error::Value`] for laws or a `B` that cannot be used.
    pub fn new(geometry: Geometry, laws: Laws, config: Config) -> Result<Self> {
        let mut stream = Self::unstarted(geometry, laws, config)?;
        for slot in &mut stream.slots {
            if config.variant == Variant::Literal {
                slot.replace_next();
            } else {
                slot.fuse_next();
            }
        }
        stream.start.update(&stream.slots[0]);
        stream.products = Products::direct(&stream.slots[2], &stream.start);
        if config.variant != Variant::Consistent {
            stream.raw = Raw::of(&stream.slots);
        }
        stream.record(1.0);
        Ok(stream)
    }

    /// Everything but the first realizations.
    pub(super) fn unstarted(geometry: Geometry, laws: Laws, config: Config) -> Result<Self> {
        let n = geometry.n;
        if config.safeguard && config.variant != Variant::Consistent {
            let expected = "off unless the variant is consistent";
            return Err(Error::Value { name: "safeguard", expected, found: "on".into() });
        }
        if config.order == Order::Gain && config.variant == Variant::Literal {
            let expected = "random or round-robin for the literal variant, which fuses nothing";
            return Err(Error::Value { name: "slots", expected, found: "gain".into() });
        }
        let shapes = [("x0", &laws.x0, n), ("xf", &laws.xf, n), ("A", &laws.a, checked_len("A", n, n)?)];
        for (name, values, len) in shapes {
            if values.len() != len {
                return Err(Error::Shape { name, expected: format!("{len} entries"), found: values.len().to_string() });
            }
        }
        let slot = |values, lines, key: Key| Slot::new(values, lines, n, key, config.safeguard);
        let norm_a = if config.order == Order::Gain { spectral_norm(&laws.a, n)? } else { 0.0 };
        let slots = [slot(laws.x0, 1, laws.keys[0])?, slot(laws.xf, 1, laws.keys[1])?, slot(laws.a, n, laws.keys[2])?];
        // ||Ff - FA F0||_1 <= gf + gA g0 for all means of realizations: nothing overflows later if this does not
        let largest = |k: usize| slots[k].law.gamma().iter().fold(0.0f64, |m, g| m.max(*g));
        let size = largest(1) + largest(2) * largest(0);
        if !(size * 4.0).is_finite() || !geometry.largest_control(size * 4.0).is_finite() {
            return Err(Error::Overflow { what: "`xf - A x0` or the control" });
        }
        let thirds = Law::new(vec![1.0; 3], 1, 3)?;
        Ok(Self {
            config,
            keys: laws.keys,
            choice: Sequence::new(&thirds.into(), laws.keys[3]),
            start: Start::of(&slots[0]),
            products: Products { ff: vec![0.0; n], sums: Vec::new() },
            raw: Raw::none(),
            steps: 0,
            drift: 0.0,
            trace: Vec::new(),
            refresh_every: 16 * n.max(16) as u64,
            norm_a,
            work: [vec![0.0; n], vec![0.0; n]],
            slots,
            geometry,
        })
    }

    /// One step: chooses a slot, draws its next realization, moves. Returns the step size `t`.
    pub fn step(&mut self) -> f64 {
        let slot = self.next_slot();
        let t = match self.config.variant {
            Variant::Consistent => self.fused_step(slot),
            Variant::Semi => {
                let t = self.slots[slot].fuse_next().t;
                if slot == 0 {
                    self.start.update(&self.slots[0]);
                }
                self.raw.average(t, &self.slots);
                t
            }
            Variant::Literal => {
                let t = self.slots[slot].replace_next();
                self.raw.average(t, &self.slots);
                t
            }
        };
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

    /// One step from the squared error `d^2` leads to at most `V d^2 / (V + d^2)` in the mean, so the decrease is at least
    /// `d^4 / (V + d^2)`; an error of `x0`, `xf`, `A` reaches the state times `||A||`, 1, `||F0||`.
    fn gainful_slot(&self) -> usize {
        let [x0, xf, a] = &self.slots;
        let f0 = norm(&self.start.f) * x0.scale;
        let gain = |slot: &Slot, factor: f64| {
            let d2 = slot.run.state.er.max(0.0);
            let reached = (factor * slot.scale).powi(2) * d2;
            if d2 > 0.0 { reached * (d2 / (slot.variance() + d2)) } else { 0.0 }
        };
        let gains = [gain(x0, self.norm_a), gain(xf, 1.0), gain(a, f0)];
        if !gains.iter().any(|g| *g > 0.0 && g.is_finite()) {
            return (self.steps % 3) as usize; // nothing to gain, or not to be told in doubles
        }
        [1, 2].into_iter().fold(0, |best, k| if gains[k] > gains[best] { k } else { best })
    }

    /// Recomputes from the entries what is otherwise carried along, and notes how far that had drifted, relative to
    /// `||FA|| ||F0||` (Frobenius).
    fn refresh(&mut self) {
        if self.config.variant == Variant::Literal {
            return;
        }
        self.slots.iter_mut().for_each(Slot::refresh);
        self.start.update(&self.slots[0]);
        if self.config.variant != Variant::Consistent {
            return;
        }
        let fresh = Products::direct(&self.slots[2], &self.start);
        let size = self.slots[2].run.state.ff().max(0.0).sqrt() * norm(&self.start.f);
        let off: Vec<f64> = fresh.ff.iter().zip(&self.products.ff).map(|(a, b)| a - b).collect();
        if size > 0.0 {
            self.drift = self.drift.max(norm(&off) / size);
        }
        self.products = fresh;
    }

    pub(super) fn literal(&self) -> bool {
        self.config.variant == Variant::Literal
    }

    /// Whether the control is the one that the estimates give, `v = B^+ (Ff - FA F0)`.
    pub fn consistent(&self) -> bool {
        self.config.variant == Variant::Consistent
    }

    fn record(&mut self, size: f64) {
        let (certificate, error) = self.certificate();
        self.trace.push(Entry { step: self.steps, certificate, error, size });
    }

    /// `z` with `v = B^+ z`: `Ff - FA F0`, or the running mean of the raw differences.
    pub fn difference(&self) -> Vec<f64> {
        let [x0, xf, a] = &self.slots;
        let (goal, free) = if self.consistent() {
            (xf.estimate(false), &self.products.ff)
        } else {
            (self.raw.goal.clone(), &self.raw.free)
        };
        goal.iter().zip(free).map(|(f, y)| f * xf.scale - y * x0.scale * a.scale).collect()
    }

    /// The control `v`.
    ///
    /// # Errors
    /// [`Error::Overflow`] if it is not representable.
    pub fn control(&self) -> Result<Vec<f64>> {
        self.geometry.control(&self.difference())
    }

    /// `||F - E*||` for `x0`, `xf`, `A`, from the entries.
    pub fn residuals(&self) -> [f64; 3] {
        let literal = self.literal();
        [0, 1, 2].map(|k| self.slots[k].inner_products(literal).0.sqrt() * self.slots[k].scale)
    }

    /// `||FA - A|| ||F0||`, from the numbers that every step carries along.
    pub(super) fn matrix_part(&self) -> f64 {
        let a = &self.slots[2];
        a.run.state.er.max(0.0).sqrt() * a.scale * (norm(&self.start.f) * self.slots[0].scale)
    }

    /// A bound on `||B (v - v*)||`, and that number itself, in `O(n^2)`. The bound is
    /// `||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||`, NaN for the variants whose control is not the one that their
    /// estimates give; the number is `||P [(Ff - FA F0) - (xf - A x0)]||`, from differences that do not cancel.
    pub fn certificate(&self) -> (f64, f64) {
        let [x0, xf, a] = &self.slots;
        let n = self.geometry.n;
        if !self.consistent() {
            let mut off = self.difference();
            for (column, x) in a.law.values().chunks_exact(n).zip(x0.law.values()) {
                off.iter_mut().zip(column).for_each(|(off, a)| *off += a * x);
            }
            off.iter_mut().zip(xf.law.values()).for_each(|(off, f)| *off -= f);
            return (f64::NAN, self.geometry.projected_norm(&off));
        }
        let (mut start, mut moved) = (vec![0.0; n], vec![0.0; n]);
        x0.visit(false, |_, line, off| {
            start.copy_from_slice(line);
            moved.copy_from_slice(off);
        });
        // (Ff - xf) - A (F0 - x0), and (FA - A) F0
        let (mut apart, mut matrix, mut er) = (vec![0.0; n], vec![0.0; n], 0.0);
        a.visit(false, |j, _, off| {
            er += dot(off, off);
            let (f, d) = (start[j], moved[j]);
            matrix.iter_mut().zip(off).for_each(|(y, off)| *y += off * f);
            apart.iter_mut().zip(&a.law.values()[j * n..(j + 1) * n]).for_each(|(y, a)| *y -= a * d);
        });
        xf.visit(false, |_, _, off| {
            apart.iter_mut().zip(off).for_each(|(y, off)| *y = *y * x0.scale + off * xf.scale);
        });
        let bound = self.geometry.projected_norm(&apart) + er.sqrt() * a.scale * (norm(&start) * x0.scale);
        apart.iter_mut().zip(&matrix).for_each(|(y, off)| *y -= off * a.scale * x0.scale);
        (bound, self.geometry.projected_norm(&apart))
    }

    /// The estimates of `x0`, `xf`, `A` (column by column).
    pub fn estimates(&self) -> [Vec<f64>; 3] {
        let literal = self.literal();
        [0, 1, 2].map(|k| {
            let mut values = self.slots[k].estimate(literal);
            values.iter_mut().for_each(|v| *v *= self.slots[k].scale);
            values
        })
    }

    /// Realizations used so far, for `x0`, `xf`, `A`.
    pub fn counts(&self) -> [u64; 3] {
        [0, 1, 2].map(|k| self.slots[k].count())
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The largest relative drift of `FA F0` that was found and repaired.
    pub fn drift(&self) -> f64 {
        self.drift
    }

    /// What was written down on the way.
    pub fn trace(&self) -> &[Entry] {
        &self.trace
    }

    /// States.
    pub fn n(&self) -> usize {
        self.geometry.n
    }

    /// How the stream works.
    pub fn config(&self) -> Config {
        self.config
    }
}

fn spectral_norm(a: &[f64], n: usize) -> Result<f64> {
    let scale = crate::fuse::power_of_two_scale(a);
    let matrix = faer::Mat::from_fn(n, n, |i, j| a[j * n + i] / scale);
    let sigma = matrix
        .singular_values()
        .map_err(|_| Error::Numerical("the singular values of `A` did not converge".into()))?;
    Ok(sigma.first().copied().unwrap_or(0.0) * scale)
}
