//! The plans of a loop with limits of rates and states: no call allocates, starts a thread or factors more than is
//! foreseen.
//!
//! Inputs and limited states are one vector, `v = f - W C' mu` with `f = F x0 + g`, for which [`Dual`] finds the active
//! limits. What it finds is brought within the limits of inputs and rates, and judged by the states that it leads to
//! and their costates, as in `rows`: with multipliers `l` of rates and states, `e` the part of the half gradient that
//! no limit of an input balances and `s = l' (c - C u)`, `J(u) - min J <= s + e' H^-1 e`.

#![allow(clippy::needless_range_loop, reason = "formulas with indices")]

use super::map::{Horizon, WHAT};
use crate::error::{Error, Result, sized};
use crate::limits::bounds::Bounds;
use crate::limits::certificate::{Certificate, NOTHING, frank_wolfe, status};
use crate::limits::dual::{Dual, End};
use crate::limits::kernel::{Work, add_lines, add_rows, combined, dot, kernel, padded, widest};
use crate::limits::linear::least_eigenvalue;
use crate::limits::quadratic::{Method, Status, Until};
use crate::limits::rows::{KEPT, Within, clipped};
use crate::limits::solve::{Most, Solution, measured};
use crate::memory::{checked_len, try_filled, try_room, try_zeros};

/// Inputs and limited states up to which there is a table of their products.
const MOST: usize = 1500;
/// A gap relative to `J(u)` from which on nothing else is tried, and a bound of it that is not made sharper.
const GOOD: f64 = 1e-11;
const ENOUGH: f64 = 1e-13;
/// Plans of a call that are judged, at most, that without inputs among them.
const JUDGED: usize = 5;
/// Distance of an input from a limit, relative to its size, up to which the limit is reached.
const REACHED: f64 = 1e-12;

/// Matrices in padded lines: columns of A and B, rows of A, weights, and the offset.
#[derive(Debug)]
struct Lines {
    columns: [Vec<f64>; 2],
    rows: Vec<f64>,
    weights: [Vec<f64>; 2],
    reference: Vec<f64>,
    offset: Vec<f64>,
    none: Vec<f64>,
    /// How far the reference is from that of the map; empty where it is not.
    ahead: Vec<f64>,
}

fn lines(values: &[f64], rows: usize, columns: usize, transposed: bool) -> Result<Vec<f64>> {
    let (count, length) = if transposed { (columns, rows) } else { (rows, columns) };
    let mut all = try_zeros(WHAT, checked_len(WHAT, count, padded(length))?)?;
    for (i, line) in all.chunks_exact_mut(padded(length).max(1)).enumerate() {
        let at = |j: usize| if transposed { values[j * columns + i] } else { values[i * columns + j] };
        line.iter_mut().take(length).enumerate().for_each(|(j, to)| *to = at(j));
    }
    Ok(all)
}

kernel! {
    /// `x(1) .. x(K)` behind `x(0)`, which is there.
    fn rolled<'a>(columns: &'a [Vec<f64>; 2], offset: &'a [f64], u: &'a [f64], x: &'a mut [f64]) -> () {
        let (ld, [a, b]) = (offset.len(), columns);
        let (n, m) = (a.len() / ld, b.len() / ld);
        for (k, u) in u.chunks_exact(m).enumerate() {
            let (before, after) = x.split_at_mut((k + 1) * ld);
            let to = &mut after[..ld];
            to.copy_from_slice(offset);
            add_rows(a, &before[k * ld..][..n], 1, to, 0);
            add_rows(b, u, 1, to, 0);
        }
    }
}

kernel! {
    /// `w = Q_k (x(k) - r(k))` of all steps; the sum of `(x - r)' w`.
    fn weighted<'a>(
        weights: &'a [Vec<f64>; 2], reference: &'a [f64], x: &'a [f64], ld: usize, off: &'a mut [f64], w: &'a mut [f64],
    ) -> f64 {
        let mut sum = 0.0;
        let steps = w.len() / ld;
        for (k, ((w, x), r)) in w.chunks_exact_mut(ld).zip(x.chunks_exact(ld)).zip(reference.chunks_exact(ld)).enumerate() {
            for (off, (x, r)) in off.iter_mut().zip(x.iter().zip(r)) {
                *off = x - r;
            }
            w.fill(0.0);
            let q = &weights[usize::from(k + 1 == steps)];
            add_rows(q, &off[..q.len() / ld], 1, w, 0);
            sum += dot(off, w);
        }
        sum
    }
}

kernel! {
    /// `g += G' w` by costates; `p` are two lines.
    fn pulled<'a>(rows: &'a [f64], b: &'a [f64], w: &'a [f64], p: &'a mut [f64], g: &'a mut [f64]) -> () {
        let ld = p.len() / 2;
        let (n, m) = (rows.len() / ld, b.len() / ld);
        let (mut p, mut next) = p.split_at_mut(ld);
        p.fill(0.0);
        for (w, g) in w.chunks_exact(ld).zip(g.chunks_exact_mut(m)).rev() {
            next.copy_from_slice(w);
            add_rows(rows, &p[..n], 1, next, 0);
            std::mem::swap(&mut p, &mut next);
            for (g, b) in g.iter_mut().zip(b.chunks_exact(ld)) {
                *g += dot(b, p);
            }
        }
    }
}

/// A plan within the limits of inputs and rates, judged.
#[derive(Debug, Default)]
struct Judged {
    u: Vec<f64>,
    /// Half the gradient, with the multipliers of rates and states.
    g: Vec<f64>,
    certificate: Certificate,
    /// The largest excess of a hard limit of a state beside its size.
    excess: f64,
}

impl Judged {
    fn better(&self, other: &Self) -> bool {
        let (own, its) = (self.excess.max(KEPT), other.excess.max(KEPT));
        own < its || own == its && self.certificate.objective <= other.certificate.objective
    }
}

#[derive(Debug)]
pub(super) struct Pivoting {
    dual: Dual,
    lines: Lines,
    /// The columns of `(F, g)` in padded lines, and what they are multiplied by, `(x0, 1)`.
    map: Vec<f64>,
    start: Vec<f64>,
    /// The limited entries of `x(1) .. x(K)`.
    states: Vec<usize>,
    /// The least eigenvalue of R.
    least: f64,
    /// By kind, as it is saved; whether there was a call before.
    signs: Vec<i8>,
    begun: bool,
    /// What limits and rates together leave of each input.
    reach: (Vec<f64>, Vec<f64>),
    now: Judged,
    best: Judged,
    last: Vec<f64>,
    /// `x(0) .. x(K)`, weighted states, a line, two lines of costates, and two vectors of inputs.
    x: Vec<f64>,
    w: Vec<f64>,
    off: Vec<f64>,
    p: Vec<f64>,
    e: Vec<f64>,
    v: Vec<f64>,
    residual: Vec<f64>,
    sizes: Vec<f64>,
    /// Rounding of an input of which limits and rates leave one value.
    width: Vec<f64>,
}

impl Pivoting {
    /// None where a table of products would be too large, or does not exist to rounding.
    pub(super) fn new(h: &Horizon) -> Result<Option<Self>> {
        let (n, m, steps, d) = (h.n, h.m, h.steps, h.steps * h.m);
        let states = h.limited()?;
        let size = d + states.len();
        if h.boxed() && !h.steep || h.grows || size > MOST {
            return Ok(None);
        }
        let made = match h.condensed() {
            Err(Error::Numerical(_)) => return Ok(None),
            made => made?,
        };
        let ld = padded(size);
        let mut table = try_zeros(WHAT, checked_len(WHAT, size, ld)?)?;
        for (i, j) in (0..size).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            let value = made.inverse[i * (i + 1) / 2 + j];
            (table[i * ld + j], table[j * ld + i]) = (value, value);
        }
        let mut map = try_zeros(WHAT, checked_len(WHAT, n + 1, ld)?)?;
        for i in 0..size {
            (0..n).for_each(|j| map[j * ld + i] = made.map[i * n + j]);
            map[n * ld + i] = made.offset[i];
        }
        let mut signal = try_room(WHAT, size)?;
        signal.extend((0..d).map(|i| i % m));
        signal.extend(states.iter().map(|i| m + i % n));
        let rate = h.task.rate.as_ref().map_or(&[][..], |(rate, _)| rate);
        let none = try_zeros(WHAT, checked_len(WHAT, steps, padded(n))?)?;
        let mut offset = try_zeros(WHAT, padded(n))?;
        offset.iter_mut().zip(h.c.iter().flatten()).for_each(|(to, c)| *to = *c);
        let zeros = |len| try_zeros(WHAT, len);
        let judged = || Ok(Judged { u: zeros(d)?, g: zeros(d)?, ..Judged::default() });
        Ok(Some(Self {
            dual: Dual::new(table, rate, (m, d), signal)?,
            lines: Lines {
                columns: [lines(&h.a, n, n, true)?, lines(&h.b, n, m, true)?],
                rows: lines(&h.a, n, n, false)?,
                weights: [lines(&h.task.stage, n, n, true)?, lines(&h.task.terminal, n, n, true)?],
                reference: lines(&h.task.reference, steps, n, false)?,
                offset,
                none,
                ahead: Vec::new(),
            },
            map,
            start: zeros(n + 1)?,
            states,
            least: least_eigenvalue(&h.r, m)?,
            signs: try_filled(WHAT, 0, h.signs())?,
            begun: false,
            reach: (zeros(d)?, zeros(d)?),
            now: judged()?,
            best: judged()?,
            last: zeros(d)?,
            x: zeros(checked_len(WHAT, steps + 1, padded(n))?)?,
            w: zeros(checked_len(WHAT, steps, padded(n))?)?,
            off: zeros(padded(n))?,
            p: zeros(2 * padded(n))?,
            e: zeros(ld)?,
            v: zeros(ld)?,
            residual: zeros(d)?,
            sizes: zeros(n)?,
            width: zeros(d)?,
        }))
    }

    /// The signs of the active limits, by kind; none before the first call.
    pub(super) fn signs(&self) -> Option<&[i8]> {
        self.begun.then_some(&self.signs)
    }

    /// Begins at these, or anew; the last plan is forgotten.
    pub(super) fn resume(&mut self, signs: Option<&[i8]>) {
        self.signs.fill(0);
        self.signs.iter_mut().zip(signs.unwrap_or_default()).for_each(|(to, from)| *to = *from);
        self.begun = signs.is_some();
        self.last.fill(f64::NAN);
    }

    /// From now on plans follow `reference` (K, n) in place of `first`, that of the map.
    pub(super) fn toward(&mut self, reference: &[f64], first: &[f64], n: usize) -> Result<()> {
        let ld = padded(n);
        if self.lines.ahead.is_empty() {
            self.lines.ahead = try_zeros(WHAT, self.lines.reference.len())?;
        }
        for (k, (r, first)) in reference.chunks_exact(n).zip(first.chunks_exact(n)).enumerate() {
            for (i, (r, first)) in r.iter().zip(first).enumerate() {
                (self.lines.reference[k * ld + i], self.lines.ahead[k * ld + i]) = (*r, r - first);
            }
        }
        Ok(())
    }

    /// What another way has found, to begin the next call at.
    pub(super) fn follow(&mut self, u: &[f64], signs: impl Iterator<Item = i8>) {
        self.signs.iter_mut().zip(signs).for_each(|(to, from)| *to = from);
        self.begun = true;
        self.last.copy_from_slice(u);
    }

    /// The best plan from `x0`, begun at the active limits of the call before, a step later. A call that ends early has
    /// the best of what it came to, the last plan a step later, and the best inputs without limits, cut to the limits;
    /// the next one goes on from its limits.
    pub(super) fn solve(&mut self, h: &Horizon, x0: &[f64], until: Until<'_>, to: &mut Solution) -> Result<bool> {
        let (n, m, d) = (h.n, h.m, h.steps * h.m);
        sized("x", x0.len(), n)?;
        self.start[..n].copy_from_slice(x0);
        self.start[n] = 1.0;
        combined(&self.map, &self.start, &mut self.dual.free);
        if !self.lines.ahead.is_empty() {
            // H^-1 G' Q (r - reference)
            let Self { lines, w, off, p, residual, e, .. } = &mut *self;
            weighted(&lines.weights, &lines.none, &lines.ahead, padded(n), off, w);
            residual.fill(0.0);
            pulled(&lines.rows, &lines.columns[1], w, p, residual);
            e[..d].copy_from_slice(residual);
            self.solved();
            self.dual.free.iter_mut().zip(&self.v).for_each(|(free, v)| *free += v);
        }
        if self.dual.free.iter().any(|v| !v.is_finite()) {
            return Err(Error::Overflow { what: "the best inputs without limits" });
        }
        self.limit(h)?;
        self.begin(h);
        let end = match self.dual.search(until) {
            Err(Error::Interrupted) => End::Early(until.ended()),
            end => end?,
        };
        self.best.certificate = Certificate::default();
        self.best.excess = f64::INFINITY;
        // J(0)
        self.now.u.fill(0.0);
        let mut zero = self.states_of(h, false);
        if let (Some(soft), Some((low, high))) = (h.task.soft, &h.task.states) {
            let over = |at: &usize| self.beyond(h, *at, low, high).powi(2);
            zero += soft * self.states.iter().map(over).sum::<f64>();
        }
        self.take();
        self.judge(h, zero)?;
        if end == End::Found && !self.good(zero) {
            self.dual.again();
            self.take();
            self.judge(h, zero)?;
        }
        if let End::Early(_) = end {
            self.now.u.copy_from_slice(&self.last);
            self.now.u.copy_within(m.min(d).., 0);
            if self.now.u.iter().all(|u| u.is_finite()) {
                self.judge(h, zero)?;
            }
            self.now.u.copy_from_slice(&self.dual.free[..d]);
            self.judge(h, zero)?;
        }
        self.save(h);
        let best = &self.best;
        if !best.certificate.objective.is_finite() {
            return Err(Error::Overflow { what: "the cost of a control within its limits" });
        }
        self.last.copy_from_slice(&best.u);
        let bounds = Bounds { low: &h.task.low, high: &h.task.high };
        for (i, (u, g)) in best.u.iter().zip(&best.g).enumerate() {
            to.active[i] = bounds.reached(i, *u, *g);
            to.multipliers[i] = (-2.0 * f64::from(to.active[i]) * g).max(0.0) + 0.0;
        }
        to.control.copy_from_slice(&best.u);
        let early = if let End::Early(status) = end { Some(status) } else { None };
        to.status = status(early, &best.certificate, zero);
        if early.is_none() && best.excess > KEPT {
            to.status = Status::Undecided;
        }
        let found = &best.certificate;
        (to.gap, to.frank_wolfe, to.distance, to.objective) =
            (found.gap, found.frank_wolfe, found.distance, found.objective);
        (to.at_zero, to.iterations, to.method) = (zero, self.dual.count, Method::Pivoting);
        Ok(early.is_some() || to.status == Status::Optimal)
    }

    /// The work of a call at most: of the search, and of plans that are judged.
    pub(super) fn most(&mut self, h: &Horizon) -> Result<Most> {
        let mut most = self.dual.most()?;
        let (d, n, m) = (h.steps * h.m, h.n, h.m);
        let seconds = measured(|| {
            self.states_of(h, false);
            self.size_states(h);
            self.e[..d].fill(1.0);
            self.solved();
            self.solved();
            self.states_of(h, true);
            let Self { lines, w, p, residual, .. } = &mut *self;
            pulled(&lines.rows, &lines.columns[1], w, p, residual);
            pulled(&lines.rows, &lines.columns[1], w, p, residual);
            Ok(())
        })?;
        let judged = (h.steps * (10 * n * n + 8 * n * m + 4 * m * m)) as f64 + 4.0 * (d * d) as f64;
        most.operations += (JUDGED as f64) * judged + 2.0 * ((d + self.states.len()) * (n + 1)) as f64;
        most.seconds += 1.5 * (JUDGED as f64) * seconds;
        Ok(most)
    }

    fn good(&self, zero: f64) -> bool {
        self.best.certificate.gap <= GOOD * (self.best.certificate.objective + NOTHING * zero)
            && self.best.excess <= KEPT
    }

    /// The limits of this call; those of the first rates are limits of inputs.
    fn limit(&mut self, h: &Horizon) -> Result<()> {
        let (m, d) = (h.m, h.steps * h.m);
        let Self { dual, reach, width, states, .. } = self;
        for (side, task) in [(&mut dual.low, &h.task.low), (&mut dual.high, &h.task.high)] {
            side[..d].copy_from_slice(task);
        }
        if let Some((low, high)) = &h.task.states {
            for (k, at) in states.iter().enumerate() {
                (dual.low[d + k], dual.high[d + k]) = (low[*at], high[*at]);
            }
        }
        reach.0.copy_from_slice(&h.task.low);
        reach.1.copy_from_slice(&h.task.high);
        if let Some((rate, previous)) = &h.task.rate {
            let within = Within { rate, previous };
            within.look_ahead((&mut reach.0, &mut reach.1))?;
            width.fill(0.0);
            let (low, high) = (&mut dual.low[..d], &mut dual.high[..d]);
            within.reach((&mut reach.0, &mut reach.1), (low, high), width);
            for i in 0..m {
                dual.low[i] = dual.low[i].max(previous[i] - rate[i]);
                dual.high[i] = dual.high[i].min(previous[i] + rate[i]);
            }
        }
        Ok(())
    }

    /// The active limits of the last call, a step later; the last step once more.
    fn begin(&mut self, h: &Horizon) {
        let (n, m, d, size) = (h.n, h.m, h.steps * h.m, self.dual.low.len());
        let of_rates = if h.task.rate.is_some() { d } else { 0 };
        for i in 0..d {
            let next = if i + m < d { i + m } else { i };
            self.dual.side[i] = self.signs[next];
            if of_rates > 0 {
                self.dual.side[size + i] = self.signs[d + next];
                if i < m && self.dual.side[i] == 0 {
                    self.dual.side[i] = self.signs[d + next];
                }
            }
        }
        for (k, at) in self.states.iter().enumerate() {
            let next = if at + n < h.steps * n { at + n } else { *at };
            self.dual.side[d + k] = self.signs[d + of_rates + next];
        }
    }

    /// What the next call begins with.
    fn save(&mut self, h: &Horizon) {
        let (m, d, size) = (h.m, h.steps * h.m, self.dual.low.len());
        let rated = h.task.rate.is_some();
        for i in 0..d {
            let side = self.dual.side[i];
            let (own, used) = if side < 0 { (&h.task.low, &self.dual.low) } else { (&h.task.high, &self.dual.high) };
            let by_rate = rated && i < m && own[i] != used[i];
            self.signs[i] = if by_rate { 0 } else { side };
            if rated {
                self.signs[d + i] = if by_rate { side } else { self.dual.side[size + i] };
            }
        }
        let first = if rated { 2 * d } else { d };
        for (k, at) in self.states.iter().enumerate() {
            self.signs[first + at] = self.dual.side[d + k];
        }
        self.begun = true;
    }

    /// The inputs that were found, active limits exactly.
    fn take(&mut self) {
        for (i, u) in self.now.u.iter_mut().enumerate() {
            *u = if self.dual.side[i] == 0 { self.dual.v[i] } else { self.dual.limit(i) };
        }
    }

    /// How far a state, of `x(1) .. x(K)`, is above its upper limit, or below its lower one with a minus.
    fn beyond(&self, h: &Horizon, at: usize, low: &[f64], high: &[f64]) -> f64 {
        let x = self.x[(1 + at / h.n) * padded(h.n) + at % h.n];
        (x - high[at]).max(0.0) - (low[at] - x).max(0.0)
    }

    /// The states of `now.u`, their weights, and what they cost; `moved`: from 0, without offset and reference.
    fn states_of(&mut self, h: &Horizon, moved: bool) -> f64 {
        let (n, ld) = (h.n, padded(h.n));
        let Self { lines, x, w, off, start, now, v, .. } = self;
        let reference = if moved { &lines.none } else { &lines.reference };
        let (offset, u) = if moved { (&lines.none[..ld], &v[..now.u.len()]) } else { (&lines.offset[..], &now.u[..]) };
        x[..ld].fill(0.0);
        if !moved {
            x[..n].copy_from_slice(&start[..n]);
        }
        rolled(&lines.columns, offset, u, x);
        weighted(&lines.weights, reference, &x[ld..], ld, off, w)
    }

    /// `g += R u`, and `u' R u`.
    fn add_inputs(h: &Horizon, u: &[f64], g: &mut [f64]) -> f64 {
        let mut sum = 0.0;
        for (u, g) in u.chunks_exact(h.m).zip(g.chunks_exact_mut(h.m)) {
            for ((row, g), one) in h.r.chunks_exact(h.m).zip(g).zip(u) {
                let of = row.iter().zip(u).map(|(r, u)| r * u).sum::<f64>();
                *g += of;
                sum += one * of;
            }
        }
        sum
    }

    /// Brings `now.u` within its limits and judges it; the better of it and the best stays.
    fn judge(&mut self, h: &Horizon, zero: f64) -> Result<()> {
        let (n, m, d, size) = (h.n, h.m, h.steps * h.m, self.dual.low.len());
        let rates = h.task.rate.as_ref();
        for (k, j) in (0..h.steps).flat_map(|k| (0..m).map(move |j| (k * m, j))) {
            let (i, u) = (k + j, &mut self.now.u);
            let before = rates.map(|(rate, previous)| (if k == 0 { previous[j] } else { u[i - m] }, rate[j]));
            let within = (self.reach.0[i], self.reach.1[i]);
            u[i] = clipped(u[i], before, within, (h.task.low[i], h.task.high[i]));
        }
        let mut objective = self.states_of(h, false);
        let (mut slack, mut excess) = (0.0, 0.0f64);
        if let Some((low, high)) = &h.task.states {
            if h.task.soft.is_none() {
                self.size_states(h);
            }
            for k in 0..self.states.len() {
                let at = self.states[k];
                let over = self.beyond(h, at, low, high);
                let weight = &mut self.w[(at / n) * padded(n) + at % n];
                if let Some(soft) = h.task.soft {
                    objective += soft * over * over;
                    *weight += soft * over;
                    continue;
                }
                let mu = self.dual.multipliers[d + k];
                let limit = if mu > 0.0 { high[at] } else { low[at] };
                if over != 0.0 {
                    let limit = if over > 0.0 { high[at] } else { low[at] };
                    excess = excess.max(over.abs() / self.sizes[at % n].max(limit.abs()));
                }
                if mu != 0.0 && limit.is_finite() {
                    let room = (limit - self.x[(1 + at / n) * padded(n) + at % n]) * mu.signum();
                    slack += 2.0 * mu.abs() * room.max(0.0);
                    *weight += mu;
                }
            }
        }
        let Self { lines, w, p, now, dual, .. } = self;
        now.g.fill(0.0);
        pulled(&lines.rows, &lines.columns[1], w, p, &mut now.g);
        objective += Self::add_inputs(h, &now.u, &mut now.g);
        if let Some((rate, _)) = rates {
            for (i, mu) in dual.multipliers[size..].iter().enumerate().filter(|(_, mu)| **mu != 0.0) {
                let change = now.u[i] - now.u[i - m];
                now.g[i] += mu;
                now.g[i - m] -= mu;
                slack += 2.0 * mu.abs() * (rate[i % m] - mu.signum() * change).max(0.0);
            }
        }
        let now = &mut self.now;
        now.excess = excess;
        now.certificate = Certificate { objective, ..Certificate::default() };
        if !objective.is_finite() {
            return Ok(());
        }
        slack += self.now.g.iter().zip(&self.width).map(|(g, width)| 2.0 * g.abs() * width).sum::<f64>();
        let gap = frank_wolfe(Bounds { low: &self.reach.0, high: &self.reach.1 }, &self.now.u, &self.now.g) + slack;
        let (squared, near) = self.dual_norm(h, zero);
        let found = &mut self.now.certificate;
        let all = slack + near;
        found.frank_wolfe = gap;
        found.gap = gap.min(squared + all);
        found.distance = (gap / 2.0).sqrt().min((squared.sqrt() + (squared + 2.0 * all).sqrt()) / 2.0);
        if excess > KEPT {
            (found.gap, found.distance, found.frank_wolfe) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
        } else {
            found.at_least_nothing(zero);
        }
        if self.now.better(&self.best) {
            std::mem::swap(&mut self.now, &mut self.best);
        }
        Ok(())
    }

    /// The largest size that each state has on the way, of the terms that add up to it.
    fn size_states(&mut self, h: &Horizon) {
        let (n, ld) = (h.n, padded(h.n));
        self.sizes.fill(f64::MIN_POSITIVE);
        for (k, u) in self.now.u.chunks_exact(h.m).enumerate() {
            let (last, now) = (&self.x[k * ld..(k + 1) * ld], &self.x[(k + 1) * ld..]);
            for (i, size) in self.sizes.iter_mut().enumerate() {
                let of_state = h.a[i * n..(i + 1) * n].iter().zip(last).map(|(a, x)| (a * x).abs());
                let of_input = h.b[i * h.m..(i + 1) * h.m].iter().zip(u).map(|(b, u)| (b * u).abs());
                *size = of_state.chain(of_input).fold(size.max(now[i].abs()), f64::max);
            }
        }
    }

    /// An upper bound of `e' H^-1 e`, `e` the part of `g` that no limit of an input balances, with the error of the
    /// table in it: for `v ~ H^-1 e` and `r = e - H v` it is `e'v + v'r + r' H^-1 r`. And `s` of limits that are
    /// reached to rounding.
    fn dual_norm(&mut self, h: &Horizon, zero: f64) -> (f64, f64) {
        let d = h.steps * h.m;
        let (mut near, mut sum) = (0.0, 0.0);
        for i in 0..d {
            let (u, g) = (self.now.u[i], self.now.g[i]);
            let off = (u - if g > 0.0 { self.reach.0[i] } else { self.reach.1[i] }).abs();
            let single = self.reach.0[i] == self.reach.1[i];
            let reached = single || off <= REACHED * u.abs().max(self.dual.unit(i));
            near += if reached && !single { 2.0 * g.abs() * off } else { 0.0 };
            self.e[i] = if reached { 0.0 } else { g };
            sum += self.e[i] * self.e[i];
        }
        // H >= R
        if sum <= ENOUGH * self.least * (self.now.certificate.objective + NOTHING * zero) {
            return (if sum > 0.0 { sum / self.least } else { 0.0 }, near);
        }
        self.solved();
        let main: f64 = self.e[..d].iter().zip(&self.v).map(|(e, v)| e * v).sum();
        self.states_of(h, true);
        let Self { lines, w, p, v, e, residual, reach, .. } = self;
        residual.fill(0.0);
        pulled(&lines.rows, &lines.columns[1], w, p, residual);
        Self::add_inputs(h, &v[..d], residual);
        let mut first = 0.0;
        for i in 0..d {
            let single = reach.0[i] == reach.1[i];
            residual[i] = if single { 0.0 } else { e[i] - residual[i] };
            first += residual[i] * v[i];
        }
        e[..d].copy_from_slice(residual);
        self.solved();
        let second = self.e[..d].iter().zip(&self.v).map(|(e, v)| e * v).sum::<f64>().abs();
        // where the correction is not small the table is not that of H
        let sound = main.is_finite() && second <= 0.1 * main;
        (if sound { main + first.abs() + 2.0 * second } else { f64::INFINITY }, near)
    }

    /// `v = H^-1 e`
    fn solved(&mut self) {
        let (table, ld) = self.dual.table();
        self.v.fill(0.0);
        let entries = self.e.iter().enumerate().filter(|(_, e)| **e != 0.0);
        add_lines(table, ld, entries.map(|(i, e)| (i, *e)), &mut self.v);
    }
}
