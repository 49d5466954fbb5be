//! The nearest point within limits, for one point after another, in memory that is asked for once.
//!
//! The least `(v - f)' W^-1 (v - f)` over `low <= v <= high` and `|v_i - v_(i-m)| <= rate` of inputs is
//! `v = f - W C' mu` with `(C W C') mu = C f - b` over the active rows C. Rounds of block pivoting exchange all rows
//! that are broken or have a multiplier of the wrong sign; where these end without a result, the dual method of
//! Goldfarb and Idnani (1983) exchanges one at a time, with updates of one factor. W may be singular, as only products
//! of rows with it are used: a limit that may be exceeded at the cost `w s^2` is one with `1 / w` added to its diagonal
//! entry.

use super::factor::Factor;
use super::kernel::{add_lines, padded};
use super::quadratic::{Status, Until};
use super::solve::{Most, measured};
use crate::error::Result;
use crate::memory::{checked_len, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::simd::LANES;

const WHAT: &str = "the plans of a loop";

/// Most rounds of block pivoting, and rounds without fewer exchanges after which they end.
const ROUNDS: usize = 15;
const PATIENCE: usize = 4;
/// Rounding of values, relative to the size of their signal, and of multipliers, relative to the largest.
const ROUNDING: f64 = 1e-13;
/// Share of a product with itself below which a row depends on those before it.
const DEPENDENT: f64 = 100.0 * f64::EPSILON;

/// How a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Found,
    /// No point is within the limits, or rounding is too large to tell.
    Stuck,
    Early(Status),
}

#[derive(Debug)]
pub(super) struct Dual {
    /// Inputs of a step, all inputs, and these with the limited states behind them.
    m: usize,
    d: usize,
    size: usize,
    /// W, symmetric, in lines of padded length.
    table: Vec<f64>,
    pub(super) low: Vec<f64>,
    pub(super) high: Vec<f64>,
    /// (m), or empty. The first step has none: its limits are among those of single inputs.
    rate: Vec<f64>,
    /// f and v, padded.
    pub(super) free: Vec<f64>,
    pub(super) v: Vec<f64>,
    /// By row: limits of `v`, then of the rates of inputs. -1 at the lower limit, 1 at the upper one.
    pub(super) side: Vec<i8>,
    /// By row, above 0 at the upper limit; of half the cost.
    pub(super) multipliers: Vec<f64>,
    /// The signal of each entry of v, and the largest |f| of each.
    signal: Vec<usize>,
    units: Vec<f64>,
    /// By row, padded: its value, and below and above which it is broken, its limits with their rounding.
    values: Vec<f64>,
    least: Vec<f64>,
    most: Vec<f64>,
    /// The active rows, with multipliers and what these would be without signs.
    set: Vec<usize>,
    mu: Vec<f64>,
    to: Vec<f64>,
    factor: Factor,
    work: Vec<f64>,
    /// `C' mu`
    weights: Vec<f64>,
    /// `L` below its diagonal row by row, and `D`, of `C W C' = L D L'`, and a row that depends on the others.
    lower: Vec<f64>,
    pivot: Vec<f64>,
    own: Vec<f64>,
    /// Rounds and exchanges of the last search.
    pub(super) count: usize,
    by_factor: bool,
}

fn triangle(i: usize) -> usize {
    i * i.saturating_sub(1) / 2
}

impl Dual {
    /// `table`: W in lines of padded length; `signal`: of each entry of `v`, for rounding.
    pub(super) fn new(table: Vec<f64>, rate: &[f64], (m, d): (usize, usize), signal: Vec<usize>) -> Result<Self> {
        let size = signal.len();
        let rows = size + if rate.is_empty() { 0 } else { d };
        let zeros = |len| try_zeros(WHAT, len);
        let signals = signal.iter().max().map_or(0, |last| last + 1);
        Ok(Self {
            m,
            d,
            size,
            table,
            low: zeros(size)?,
            high: zeros(size)?,
            rate: try_copy(WHAT, rate)?,
            free: zeros(padded(size))?,
            v: zeros(padded(size))?,
            side: try_filled(WHAT, 0, rows)?,
            multipliers: zeros(rows)?,
            signal,
            units: zeros(signals)?,
            values: zeros(padded(rows))?,
            least: zeros(padded(rows))?,
            most: zeros(padded(rows))?,
            set: try_room(WHAT, rows)?,
            mu: zeros(size)?,
            to: zeros(size + 1)?,
            factor: Factor::new(size)?,
            work: zeros(padded(size))?,
            weights: zeros(size)?,
            lower: zeros(checked_len(WHAT, size + 1, size + 1)? / 2)?,
            pivot: zeros(size)?,
            own: zeros(size + 1)?,
            count: 0,
            by_factor: false,
        })
    }

    /// Lines of W.
    pub(super) fn table(&self) -> (&[f64], usize) {
        (&self.table, padded(self.size))
    }

    /// Most exchanges of a search.
    fn exchanges(&self) -> usize {
        4 * self.side.len() + 20
    }

    /// The work of a search at most, with the time of each part as measured now. The search begins anew behind it.
    pub(super) fn most(&mut self) -> Result<Most> {
        let (size, stop) = (self.size as f64, Stop::new());
        let until = Until::new(&stop, None);
        // as many active rows as there are inputs; the time of more grows with the work
        let more = size / self.d as f64;
        let round = measured(|| {
            self.side.fill(0);
            self.side[..self.d].fill(1);
            self.face(until)?;
            self.exchange();
            Ok(())
        })?;
        self.side.fill(0);
        self.side[..self.d].fill(1);
        self.set.clear();
        for row in 0..self.d {
            self.enter(row);
        }
        let exchange = measured(|| {
            self.aim(false);
            self.moved();
            std::hint::black_box((0..self.side.len()).filter(|row| self.broken(*row).is_some()).count());
            if let Some(row) = self.set.first().copied() {
                self.leave(0);
                self.enter(row);
                self.side[row] = 1;
            }
            Ok(())
        })?;
        self.side.fill(0);
        let (rounds, exchanges, rows) = (ROUNDS as f64, self.exchanges() as f64, 8.0 * self.side.len() as f64);
        Ok(Most {
            factorizations: ROUNDS + self.exchanges(),
            // the exchanges begin with a factor of their own
            operations: (rounds + 1.0) * (size * size * (size / 3.0 + 8.0) + rows)
                + exchanges * (12.0 * size * size + rows),
            seconds: rounds * round * more.powi(3) + (exchanges + size) * exchange * more.powi(2),
        })
    }

    /// The entries of a row: one, or one less another.
    #[inline(always)]
    fn row(&self, row: usize) -> (usize, Option<usize>) {
        if row < self.size { (row, None) } else { (row - self.size, Some(row - self.size - self.m)) }
    }

    #[inline(always)]
    fn value(&self, of: &[f64], row: usize) -> f64 {
        let (i, less) = self.row(row);
        less.map_or(of[i], |less| of[i] - of[less])
    }

    #[inline(always)]
    fn product(&self, row: usize, other: usize) -> f64 {
        let (i, less) = self.row(row);
        let ld = padded(self.size);
        let line = self.value(&self.table[i * ld..(i + 1) * ld], other);
        less.map_or(line, |less| line - self.value(&self.table[less * ld..(less + 1) * ld], other))
    }

    #[inline(always)]
    fn limits(&self, row: usize) -> (f64, f64) {
        if row < self.size {
            return (self.low[row], self.high[row]);
        }
        let at = row - self.size;
        let rate = if at < self.m { f64::INFINITY } else { self.rate[at % self.m] };
        (-rate, rate)
    }

    pub(super) fn limit(&self, row: usize) -> f64 {
        let (low, high) = self.limits(row);
        if self.side[row] < 0 { low } else { high }
    }

    fn fixed(&self, row: usize) -> bool {
        row < self.size && self.low[row] == self.high[row]
    }

    pub(super) fn unit(&self, row: usize) -> f64 {
        self.units[self.signal[if row < self.size { row } else { row - self.size }]]
    }

    /// Searches from the active limits that `side` names.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] within a large factorization.
    pub(super) fn search(&mut self, until: Until<'_>) -> Result<End> {
        self.count = 0;
        self.units.fill(f64::MIN_POSITIVE);
        for (signal, f) in self.signal.iter().zip(&self.free) {
            self.units[*signal] = self.units[*signal].max(f.abs());
        }
        let (own, rates) = (self.size, self.size + self.m);
        for row in 0..self.side.len() {
            if row < own || row >= rates && row - rates < self.m {
                let ((low, high), unit) = (self.limits(row), self.unit(row));
                self.least[row] = low - ROUNDING * unit.max(low.abs());
                self.most[row] = high + ROUNDING * unit.max(high.abs());
            } else if row >= rates {
                (self.least[row], self.most[row]) = (self.least[row - self.m], self.most[row - self.m]);
            }
            if self.fixed(row) {
                self.side[row] = 1;
            } else if self.side[row] != 0 && !self.limit(row).is_finite() {
                self.side[row] = 0;
            }
        }
        let mut end = self.by_blocks(until)?;
        if end == End::Stuck {
            end = self.one_by_one(until);
        }
        self.named();
        Ok(end)
    }

    /// `mu` and `v` of the active rows; false if these depend on each other.
    fn face(&mut self, until: Until<'_>) -> Result<bool> {
        let (mut set, mut factor) = (std::mem::take(&mut self.set), std::mem::take(&mut self.factor));
        set.clear();
        set.extend(self.side.iter().enumerate().filter(|(_, side)| **side != 0).map(|(row, _)| row));
        let column = |j: usize, to: &mut [f64]| {
            to.iter_mut().zip(&set[j..]).for_each(|(to, row)| *to = self.product(set[j], *row));
        };
        let sound = if set.len() > self.size { Ok(false) } else { factor.set(set.len(), column, until) };
        (self.set, self.factor) = (set, factor);
        self.mu.fill(0.0);
        self.by_factor = sound?;
        if self.by_factor {
            self.count += 1;
            self.correct(false);
        }
        Ok(self.by_factor)
    }

    /// `mu += (C W C')^-1 (C v - b)` with v or f, and v of these multipliers.
    fn correct(&mut self, again: bool) {
        let count = self.set.len();
        self.work.fill(0.0);
        for k in 0..count {
            let of = if again { &self.v } else { &self.free };
            self.work[k] = self.value(of, self.set[k]) - self.limit(self.set[k]);
        }
        self.factor.solve(&mut self.work[..padded(count)]);
        self.mu.iter_mut().zip(&self.work[..count]).for_each(|(mu, more)| *mu += more);
        self.moved();
    }

    /// Once more for the rounding of the factors.
    pub(super) fn again(&mut self) {
        if self.by_factor {
            self.correct(true);
            self.named();
        }
    }

    /// The multipliers by row.
    fn named(&mut self) {
        self.multipliers.fill(0.0);
        for (row, mu) in self.set.iter().zip(&self.mu) {
            self.multipliers[*row] = *mu;
        }
    }

    /// `v = f - W C' mu`
    fn moved(&mut self) {
        self.weights.fill(0.0);
        for k in 0..self.set.len() {
            let (i, less) = self.row(self.set[k]);
            self.weights[i] += self.mu[k];
            if let Some(less) = less {
                self.weights[less] -= self.mu[k];
            }
        }
        self.v.copy_from_slice(&self.free);
        let weights = self.weights.iter().enumerate().filter(|(_, w)| **w != 0.0);
        add_lines(&self.table, padded(self.size), weights.map(|(i, w)| (i, -w)), &mut self.v);
        let (own, rates) = self.values.split_at_mut(self.size);
        own.copy_from_slice(&self.v[..self.size]);
        if !self.rate.is_empty() {
            let changes = self.v[self.m..self.d].iter().zip(&self.v);
            rates[self.m..].iter_mut().zip(changes).for_each(|(to, (v, before))| *to = v - before);
        }
    }

    fn by_blocks(&mut self, until: Until<'_>) -> Result<End> {
        let (mut least, mut waits) = (usize::MAX, 0);
        for _ in 0..ROUNDS {
            if !self.face(until)? {
                break;
            }
            let count = self.exchange();
            if count == 0 {
                return Ok(End::Found);
            }
            // after a round at least, so that the next call goes on from another one
            if let Some(early) = until.reached() {
                return Ok(End::Early(early));
            }
            waits = if count < least { 0 } else { waits + 1 };
            least = least.min(count);
            if waits > PATIENCE {
                break;
            }
        }
        Ok(End::Stuck)
    }

    /// Exchanges all rows that are broken or have the wrong sign; how many.
    fn exchange(&mut self) -> usize {
        let mut count = 0;
        let Self { values, least, most, side, .. } = self;
        let limits = least.as_chunks::<LANES>().0.iter().zip(most.as_chunks::<LANES>().0);
        let groups = values.as_chunks::<LANES>().0.iter().zip(limits);
        for ((v, (least, most)), side) in groups.zip(side.chunks_mut(LANES)) {
            let broken = |i: usize| (v[i] > most[i]) | (v[i] < least[i]);
            if !(0..LANES).fold(false, |any, i| any | broken(i)) {
                continue;
            }
            for (i, side) in side.iter_mut().enumerate().filter(|(i, side)| **side == 0 && broken(*i)) {
                *side = if v[i] > most[i] { 1 } else { -1 };
                count += 1;
            }
        }
        let sized = |(row, mu): (&usize, &f64)| mu.abs() * self.unit(*row);
        let most = self.set.iter().zip(&self.mu).map(sized).fold(0.0, f64::max);
        for (row, mu) in self.set.iter().zip(&self.mu) {
            let mu = mu * f64::from(self.side[*row]) * self.unit(*row);
            if mu < -ROUNDING * most && !self.fixed(*row) {
                self.side[*row] = 0;
                count += 1;
            }
        }
        count
    }

    /// The limit that a row is beyond, and by how much.
    fn broken(&self, row: usize) -> Option<(i8, f64)> {
        let ((low, high), v) = (self.limits(row), self.values[row]);
        if v > self.most[row] {
            return Some((1, v - high));
        }
        (v < self.least[row]).then_some((-1, low - v))
    }

    /// A further active row; false if it depends on the others, with `D^-1 L^-1` of its products in `own`.
    fn enter(&mut self, row: usize) -> bool {
        let k = self.set.len();
        let size = self.product(row, row);
        let mut rest = size;
        for i in 0..k {
            let line = &self.lower[triangle(i)..][..i];
            let sum: f64 = line.iter().zip(&self.own).map(|(l, own)| l * own).sum();
            self.own[i] = self.product(row, self.set[i]) - sum;
        }
        for i in 0..k {
            let v = self.own[i] / self.pivot[i];
            rest -= self.own[i] * v;
            self.own[i] = v;
        }
        if k == self.size || rest.is_nan() || rest <= DEPENDENT * size {
            return false;
        }
        self.lower[triangle(k)..][..k].copy_from_slice(&self.own[..k]);
        (self.pivot[k], self.mu[k]) = (rest, 0.0);
        self.set.push(row);
        true
    }

    /// Without the active row k: a positive update of the factors behind it.
    fn leave(&mut self, k: usize) {
        let (last, mut a) = (self.set.len() - 1, self.pivot[k]);
        self.side[self.set[k]] = 0;
        for i in k + 1..=last {
            self.to[i] = self.lower[triangle(i) + k];
        }
        for i in k + 1..=last {
            let (v, before) = (self.to[i], self.pivot[i]);
            let now = before + a * v * v;
            let b = v * a / now;
            a *= before / now;
            self.pivot[i] = now;
            for r in i + 1..=last {
                let l = &mut self.lower[triangle(r) + i];
                self.to[r] -= v * *l;
                *l += b * self.to[r];
            }
        }
        for i in k..last {
            let (to, from) = (triangle(i), triangle(i + 1));
            for j in 0..i {
                self.lower[to + j] = self.lower[from + j + usize::from(j >= k)];
            }
            (self.pivot[i], self.mu[i]) = (self.pivot[i + 1], self.mu[i + 1]);
        }
        self.set.remove(k);
    }

    /// `L' x = x` in `to`.
    fn back(&mut self) {
        for i in (1..self.set.len()).rev() {
            let x = self.to[i];
            let line = &self.lower[triangle(i)..][..i];
            self.to.iter_mut().zip(line).for_each(|(to, l)| *to -= l * x);
        }
    }

    /// `to = (C W C')^-1 (C v - b)`, with v or f.
    fn aim(&mut self, again: bool) {
        for i in 0..self.set.len() {
            let of = if again { &self.v } else { &self.free };
            let x = self.value(of, self.set[i]) - self.limit(self.set[i]);
            let line = &self.lower[triangle(i)..][..i];
            self.to[i] = x - line.iter().zip(&self.to).map(|(l, to)| l * to).sum::<f64>();
        }
        let count = self.set.len();
        self.to.iter_mut().zip(&self.pivot).take(count).for_each(|(to, pivot)| *to /= pivot);
        self.back();
    }

    /// The active row that leaves first on the way of the multipliers to `to`, or by `-turn to`, and how far that is.
    fn first(&self, most: f64, turn: i8) -> Option<(usize, f64)> {
        let (mut at, mut far) = (None, most);
        for (i, row) in self.set.iter().enumerate() {
            let by = if turn == 0 { self.to[i] - self.mu[i] } else { -f64::from(turn) * self.to[i] };
            let end = f64::from(self.side[*row]) * if turn == 0 { self.to[i] } else { by };
            if self.fixed(*row) || end >= 0.0 {
                continue;
            }
            let t = (-self.mu[i] / by).max(0.0);
            if t < far {
                (at, far) = (Some(i), t);
            }
        }
        at.map(|at| (at, far))
    }

    fn one_by_one(&mut self, until: Until<'_>) -> End {
        self.by_factor = false;
        self.set.clear();
        for row in 0..self.side.len() {
            if self.side[row] != 0 && !self.enter(row) {
                self.side[row] = 0;
            }
        }
        for _ in 0..self.exchanges() {
            if let Some(early) = until.reached() {
                return End::Early(early);
            }
            self.count += 1;
            self.aim(false);
            let first = self.first(1.0, 0);
            let far = first.map_or(1.0, |(_, far)| far);
            self.mu.iter_mut().zip(&self.to).take(self.set.len()).for_each(|(mu, to)| *mu += far * (to - *mu));
            if let Some((at, _)) = first {
                self.leave(at);
                continue;
            }
            self.moved();
            let beyond = (0..self.side.len()).filter(|row| self.side[*row] == 0);
            let beyond = beyond.filter_map(|row| self.broken(row).map(|(side, off)| (row, side, off / self.unit(row))));
            let Some((row, side, _)) = beyond.max_by(|one, other| one.2.total_cmp(&other.2)) else {
                self.aim(true);
                self.mu.iter_mut().zip(&self.to).take(self.set.len()).for_each(|(mu, to)| *mu += to);
                self.moved();
                return End::Found;
            };
            self.side[row] = side;
            // a row that is a sum of active ones: their multipliers move along it until one of them leaves
            let mut far = 0.0;
            while !self.enter(row) {
                let count = self.set.len();
                self.to[..count].copy_from_slice(&self.own[..count]);
                self.back();
                let Some((at, t)) = self.first(f64::INFINITY, side) else {
                    self.side[row] = 0;
                    return End::Stuck; // no room within the limits, but for rounding
                };
                let by = f64::from(side) * t;
                self.mu.iter_mut().zip(&self.to).take(count).for_each(|(mu, to)| *mu -= by * to);
                far += t;
                self.leave(at);
            }
            let last = self.set.len() - 1;
            self.mu[last] = far * f64::from(side);
        }
        End::Stuck
    }
}
