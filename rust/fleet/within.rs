//! What a command must keep to, and what its inputs cost.

use super::program::Pair;
use super::units::{Units, WHAT};
use crate::error::{Error, Result, require_finite, sized};
use crate::limits::{self, Bounds};
use crate::memory::{try_collect, try_copy, try_extend, try_filled, try_push, try_zeros};
use crate::parallel::Stop;
use crate::vector::{axpy, dot};

/// Rounding of a sum of a value and a rate, relative.
const SLACK: f64 = 1e-12;
/// Limits of states are kept up to this share of the largest of them and of what is wanted.
const KEPT: f64 = 1e-8;
/// Limits that cannot be kept are widened by what is missing, and by this share of it.
const ROOM: f64 = 1e-6;

/// Limits of the command, and the weight of its inputs.
#[derive(Debug, Clone, Copy, Default)]
pub struct Limits<'a> {
    /// Lower limits of the inputs, `d`.
    pub low: &'a [f64],
    /// Upper limits of the inputs, `d`.
    pub high: &'a [f64],
    /// `|u(k) - u(k-1)| <= rate` (m), and `u(-1)` (m).
    pub rate: Option<(&'a [f64], &'a [f64])>,
    /// Lower and upper limits of `x(1) .. x(K)` of every unit, `(steps, n)`.
    pub states: Option<(&'a [f64], &'a [f64])>,
    /// R, `(m, m)`, or empty.
    pub r: &'a [f64],
}

/// The same, checked: `low` and `high` are what limits and rates together leave of every input.
pub(super) struct Within<'a> {
    pub(super) low: Vec<f64>,
    pub(super) high: Vec<f64>,
    pub(super) given: Limits<'a>,
    pub(super) m: usize,
    /// `R = diag(diagonal) + cost'cost` of all steps, with a diagonal as large as that allows: `(d)` and `(rows, d)`.
    pub(super) diagonal: Vec<f64>,
    pub(super) cost: Vec<f64>,
    /// How far a state may be beyond a limit.
    pub(super) kept: f64,
}

impl<'a> Within<'a> {
    pub(super) fn new(units: &Units<'_>, given: Limits<'a>) -> Result<Self> {
        units.checked()?;
        let (d, n, m) = (units.inputs(), units.n, units.m);
        let mut kept = 0.0;
        Bounds::new(given.low, given.high, d)?;
        if let Some((low, high)) = given.states {
            Bounds::new(low, high, units.steps * n)?;
            let sizes = low.iter().chain(high).chain(units.reference).filter(|v| v.is_finite());
            let size = sizes.fold(0.0f64, |most, v| most.max(v.abs()));
            kept = KEPT * if size > 0.0 { size } else { 1.0 };
        }
        if let Some((rate, previous)) = given.rate {
            require_finite("previous", previous)?;
            let right = rate.len() == m && previous.len() == m && rate.iter().all(|r| *r > 0.0);
            if !right {
                return Err(Error::Value { name: "rate", expected: "m numbers above 0", found: "others".into() });
            }
        }
        require_finite("R", given.r)?;
        if !given.r.is_empty() && given.r.len() != m * m {
            let (expected, found) = (format!("{} entries", m * m), format!("{} entries", given.r.len()));
            return Err(Error::Shape { name: "R", expected, found });
        }
        let (diagonal, cost) = split(given.r, m, units.steps)?;
        let (low, high) = (try_copy(WHAT, given.low)?, try_copy(WHAT, given.high)?);
        let mut new = Self { low, high, given, m, diagonal, cost, kept };
        new.reach()?;
        Ok(new)
    }

    /// Inputs from where all later limits can be kept, and that can be reached.
    fn reach(&mut self) -> Result<()> {
        let Some((rate, previous)) = self.given.rate else { return Ok(()) };
        let (m, low, high) = (self.m, &mut self.low, &mut self.high);
        for i in (m..low.len()).rev() {
            low[i - m] = low[i - m].max(low[i] - rate[i % m]);
            high[i - m] = high[i - m].min(high[i] + rate[i % m]);
        }
        for i in 0..low.len() {
            let (l, h) = if i < m { (previous[i], previous[i]) } else { (low[i - m], high[i - m]) };
            low[i] = low[i].max(l - rate[i % m]);
            high[i] = high[i].min(h + rate[i % m]);
            let rounding = SLACK * (1.0 + low[i].abs());
            if low[i] - high[i] > rounding {
                let found = format!("input {} of step {}, where {:.3e} are missing", i % m, i / m, low[i] - high[i]);
                return Err(Error::Value { name: "rate", expected: "enough for the limits of all steps", found });
            }
            if high[i] - low[i] <= rounding {
                let value = low[i].max(self.given.low[i]).min(self.given.high[i]);
                (low[i], high[i]) = (value, value);
            }
        }
        Ok(())
    }

    /// Brings inputs inside their limits, and changes within the rate, one step after another.
    pub(super) fn clip(&self, u: &mut [f64]) {
        for i in 0..u.len() {
            if let Some((rate, previous)) = self.given.rate {
                let last = if i < self.m { previous[i] } else { u[i - self.m] };
                u[i] = u[i].max(last - rate[i % self.m]).min(last + rate[i % self.m]);
            }
            u[i] = u[i].max(self.low[i]).min(self.high[i]).max(self.given.low[i]).min(self.given.high[i]) + 0.0;
        }
    }

    /// The inputs closest to 0, step by step.
    pub(super) fn near_zero(&self) -> Result<Vec<f64>> {
        let mut u = try_zeros(WHAT, self.low.len())?;
        self.clip(&mut u);
        Ok(u)
    }

    pub(super) fn bounds(&self) -> Bounds<'_> {
        Bounds { low: &self.low, high: &self.high }
    }

    /// An excess that is more than rounding, else 0.
    pub(super) fn excess(&self, found: f64) -> f64 {
        if found > self.kept { found } else { 0.0 }
    }

    /// Limits of states that are wider by what is missing, with room inside.
    pub(super) fn wider(&self, missing: f64) -> Result<(Vec<f64>, Vec<f64>)> {
        let more = missing + self.kept.max(ROOM * missing);
        let (low, high) = self.given.states.unwrap_or((&[], &[]));
        Ok((try_collect(WHAT, low.iter().map(|v| v - more))?, try_collect(WHAT, high.iter().map(|v| v + more))?))
    }

    /// The inputs that have more than one value.
    pub(super) fn free(&self) -> Result<Vec<usize>> {
        try_collect(WHAT, (0..self.low.len()).filter(|&j| self.low[j] < self.high[j]))
    }

    /// `||u||_R^2`
    pub(super) fn beside(&self, u: &[f64]) -> f64 {
        let own: f64 = u.iter().zip(&self.diagonal).map(|(u, r)| r * u * u).sum();
        self.cost.chunks_exact(u.len()).fold(own, |sum, row| sum + dot(row, u).powi(2))
    }

    /// `R` of all steps for the free inputs, and `R u` of the fixed ones.
    pub(super) fn weight(&self, free: &[usize]) -> Result<(Vec<f64>, Vec<f64>)> {
        let d = self.low.len();
        let (mut r, mut fixed) = (try_zeros(WHAT, free.len() * free.len())?, try_copy(WHAT, &self.low)?);
        free.iter().for_each(|&j| fixed[j] = 0.0);
        let (mut column, mut of_fixed) = (try_zeros(WHAT, d)?, try_zeros(WHAT, free.len())?);
        for (k, &j) in free.iter().enumerate() {
            column.fill(0.0);
            column[j] = self.diagonal[j];
            for row in self.cost.chunks_exact(d).filter(|row| row[j] != 0.0) {
                axpy(row[j], row, &mut column);
            }
            of_fixed[k] = dot(&column, &fixed);
            for (to, &i) in r[k * free.len()..].iter_mut().zip(free) {
                *to = column[i];
            }
        }
        Ok((r, of_fixed))
    }

    /// Limits of free inputs and of their changes, for `u = unit v`, of which each is `at` an entry of `free`.
    pub(super) fn pairs(&self, free: &[usize], unit: f64) -> Result<Vec<Pair>> {
        let (mut pairs, mut at) = (Vec::new(), try_filled(WHAT, usize::MAX, self.low.len())?);
        for (k, &j) in free.iter().enumerate() {
            at[j] = k;
            for (by, limit) in [(1.0, self.high[j]), (-1.0, self.low[j])] {
                if limit.is_finite() {
                    try_push(WHAT, &mut pairs, Pair { at: [k, k], by: [by, 0.0], right: by * limit / unit })?;
                }
            }
        }
        for (j, by) in self.changes() {
            let (now, before) = (at[j], at[j - self.m]);
            let of_fixed = |j: usize| if at[j] == usize::MAX { self.low[j] } else { 0.0 };
            let right = (self.rate(j) - by * (of_fixed(j) - of_fixed(j - self.m))) / unit;
            let (here, there) = (usize::from(now != usize::MAX), usize::from(before != usize::MAX));
            let by = [by * here as f64, -by * there as f64];
            let one = if here > 0 { now } else { before };
            let two = if there > 0 { before } else { now };
            let pair = if here + there > 0 { [one, two] } else { [0, 0] };
            try_push(WHAT, &mut pairs, Pair { at: pair, by, right: if here + there > 0 { right } else { 1.0 } })?;
        }
        Ok(pairs)
    }

    /// Changes with a limit that is no limit of a single input: the entry, and the sign.
    fn changes(&self) -> impl Iterator<Item = (usize, f64)> {
        let (from, to) = if self.given.rate.is_some() { (self.m, self.low.len()) } else { (0, 0) };
        (from..to).flat_map(|j| [(j, 1.0), (j, -1.0)])
    }

    fn rate(&self, j: usize) -> f64 {
        self.given.rate.map_or(f64::INFINITY, |(rate, _)| rate[j % self.m])
    }

    /// The multipliers of the changes among those of [`Within::pairs`]: these are the last ones.
    pub(super) fn of_changes<'b>(&self, pairs: &'b [f64]) -> &'b [f64] {
        &pairs[pairs.len() - self.changes().count()..]
    }

    /// `g += D'v`, and `v' c` for the changes `D u <= c`.
    pub(super) fn pull_changes(&self, v: &[f64], g: &mut [f64]) -> f64 {
        let mut aim = 0.0;
        for ((j, by), v) in self.changes().zip(v) {
            g[j] += by * v;
            g[j - self.m] -= by * v;
            aim += v * self.rate(j);
        }
        aim
    }
}

/// The miss of every unit at `u` (K, m), without what the inputs cost, and by how much its states leave their limits;
/// nothing where that is rounding.
///
/// # Errors
/// [`Error::Shape`], and as [`Units::misses`].
pub fn misses(
    units: &Units<'_>,
    limits: Limits<'_>,
    u: &[f64],
    threads: usize,
    stop: &Stop,
) -> Result<(Vec<f64>, Vec<f64>)> {
    let within = Within::new(units, limits)?;
    sized("u", u.len(), units.inputs())?;
    let (found, mut excess) = units.misses(u, 0.0, limits.states, threads, stop)?;
    excess.iter_mut().for_each(|v| *v = within.excess(*v));
    Ok((found, excess))
}

/// `r` and `F` with `R = diag(r) + F'F` of all steps.
fn split(r: &[f64], m: usize, steps: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    let d = steps * m;
    if r.is_empty() {
        return Ok((try_zeros(WHAT, d)?, Vec::new()));
    }
    let diagonal = |i: usize| r[i % m * (m + 1)];
    if r.iter().enumerate().all(|(i, v)| *v == 0.0 || i % (m + 1) == 0) {
        return Ok((try_collect(WHAT, (0..d).map(diagonal))?, Vec::new()));
    }
    let values = limits::eigen(r, m)?.0;
    let rounding = m as f64 * f64::EPSILON * values[m - 1];
    let least = if values[0] > rounding { values[0] } else { 0.0 };
    let mut rest = try_copy(WHAT, r)?;
    rest.iter_mut().step_by(m + 1).for_each(|v| *v -= least);
    let (root, mut cost) = (limits::root(&rest, m)?, Vec::new());
    for k in 0..steps {
        for row in root.chunks_exact(m) {
            try_extend(WHAT, &mut cost, (0..d).map(|i| if i / m == k { row[i % m] } else { 0.0 }))?;
        }
    }
    Ok((try_filled(WHAT, least, d)?, cost))
}
