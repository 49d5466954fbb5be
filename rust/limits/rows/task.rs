//! A problem with limits on states and on changes of inputs: its data checked, states, adjoints, and the clip.

use crate::error::{Error, Result, sized};
use crate::limits::bounds::Bounds;
use crate::limits::riccati::Steps;
use crate::memory::{try_copy, try_filled, try_zeros};

pub(super) const WHAT: &str = "a control with limits on states or rates";

/// Excess of a limit on a state, relative to the size that the state has on the way, up to which the limit is kept.
pub(crate) const KEPT: f64 = 1e-9;
/// Rounding of a step of `rate`, relative.
const SLACK: f64 = 1e-12;
/// Ratio of the sizes of two states from where each is scaled by its own.
const APART: f64 = 1e3;
/// Growth of a state beyond the size it is given by, from where what it does says nothing of the sizes of others.
const GROWN: f64 = 10.0;
/// Rounding of a sum of a value and a rate, relative.
const NEAR: f64 = 8.0 * f64::EPSILON;

/// Limits besides those of single inputs.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rows<'a> {
    /// `|u(k) - u(k-1)| <= rate` (m), and `u(-1)` (m).
    pub rate: Option<(&'a [f64], &'a [f64])>,
    /// Lower and upper limits of `x(1) .. x(K)` (K, n); infinite where there is none.
    pub states: Option<(&'a [f64], &'a [f64])>,
    /// The weight of `||max(0, x - high)||^2 + ||max(0, low - x)||^2`, for limits that may be exceeded.
    pub soft: Option<f64>,
    /// Whether the system grows so much over the steps that inputs alone do not tell where its states are.
    pub grows: bool,
}

impl Rows<'_> {
    /// Refuses what is no limit of `n` states and `m` inputs over so many steps.
    pub(crate) fn check(&self, n: usize, m: usize, steps: usize) -> Result<()> {
        if let Some((rate, previous)) = self.rate {
            sized("rate", rate.len(), m)?;
            sized("previous", previous.len(), m)?;
            crate::error::require_finite("previous", previous)?;
            if let Some(found) = rate.iter().find(|r| r.is_nan() || **r <= 0.0) {
                return Err(Error::Value { name: "rate", expected: "above 0", found: found.to_string() });
            }
        }
        if let Some((below, above)) = self.states {
            sized("state_low", below.len(), steps * n)?;
            sized("state_high", above.len(), steps * n)?;
            for (i, (&l, &h)) in below.iter().zip(above).enumerate() {
                if !(l <= h && l < f64::INFINITY && h > f64::NEG_INFINITY) {
                    let expected = "at most `state_high`, with a number between them";
                    let found = format!("[{l}, {h}] for state {} of step {}", i % n, i / n + 1);
                    return Err(Error::Value { name: "state_low", expected, found });
                }
            }
        }
        match self.soft {
            Some(soft) if !(soft > 0.0 && soft.is_finite()) => {
                Err(Error::Value { name: "soft", expected: "a number above 0", found: soft.to_string() })
            }
            _ => Ok(()),
        }
    }
}

/// The data of a problem. States and inputs are step by step.
pub(super) struct Task<'a> {
    pub(super) h: Steps<'a>,
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) steps: usize,
    /// Of single inputs; both equal where limits and rates leave an input one value, of which `width` is the rounding.
    inputs: (Vec<f64>, Vec<f64>),
    pub(super) width: Vec<f64>,
    pub(super) rate: Option<(&'a [f64], &'a [f64])>,
    /// Empty without limits on states.
    pub(super) low: Vec<f64>,
    pub(super) high: Vec<f64>,
    pub(super) soft: Option<f64>,
    pub(super) grows: bool,
    /// Values from where all later limits can be kept, `l'_k = max(l_k, l'_{k+1} - rate)`,
    /// `h'_k = min(h_k, h'_{k+1} + rate)`, and that can be reached, `l'_k = max(l'_k, l'_{k-1} - rate)`,
    /// `h'_k = min(h'_k, h'_{k-1} + rate)`.
    within: (Vec<f64>, Vec<f64>),
    /// Sizes of each state and of each input, to scale by.
    pub(super) size: (Vec<f64>, Vec<f64>),
}

pub(super) fn largest<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    values.into_iter().filter(|v| v.is_finite()).fold(0.0, |most, v| most.max(v.abs()))
}

/// By how much limits of states are exceeded.
#[derive(Clone, Copy, Default)]
pub(super) struct Excess {
    /// The largest in units of the states, and its value.
    pub(super) units: f64,
    pub(super) value: f64,
    /// The largest beside the size that its state has on the way.
    pub(super) relative: f64,
}

impl Excess {
    /// The largest excess, and whether it is more than rounding.
    pub(super) fn told(self) -> (f64, bool) {
        (self.value, self.relative > KEPT)
    }
}

/// The size of each state: one for all, unless their units are far apart. A state that begins and should end at 0 has
/// the size of its limits, or that which the others give it over the steps without inputs, or in a step.
fn sizes(h: &Steps<'_>, low: &[f64], high: &[f64]) -> Result<Vec<f64>> {
    let n = h.x0.len();
    let common = largest(h.x0.iter().chain(h.reference));
    let common = if common > 0.0 { common } else { largest(low.iter().chain(high)).max(1.0) };
    let of = |values: &[f64], i: usize| largest(values.iter().skip(i).step_by(n));
    let mut own = try_zeros(WHAT, n)?;
    for (i, size) in own.iter_mut().enumerate() {
        *size = largest(&[h.x0[i], of(h.reference, i)]);
        if *size == 0.0 {
            *size = of(low, i).max(of(high, i));
        }
    }
    // what the others make of it over the steps, of which one can be little, until they have grown themselves
    let (mut x, mut next, known) = (try_copy(WHAT, h.x0)?, try_zeros::<f64>(WHAT, n)?, try_copy(WHAT, &own)?);
    for _ in 0..h.reference.len() / n.max(1) {
        for (i, to) in next.iter_mut().enumerate() {
            *to = h.a[i * n..(i + 1) * n].iter().zip(&x).map(|(a, x)| a * x).sum();
        }
        if next.iter().zip(&known).any(|(x, known)| !x.is_finite() || *known > 0.0 && x.abs() > GROWN * known) {
            break;
        }
        for (own, x) in own.iter_mut().zip(&next).zip(&known).filter(|(_, known)| **known == 0.0).map(|(to, _)| to) {
            *own = own.max(x.abs());
        }
        std::mem::swap(&mut x, &mut next);
    }
    for _ in 0..n {
        for i in 0..n {
            if own[i] > 0.0 {
                continue;
            }
            let moved = |(a, x): (&f64, &f64)| (a * x).abs();
            own[i] = h.a[i * n..(i + 1) * n].iter().zip(&own).map(moved).fold(0.0, f64::max);
        }
    }
    let least = own.iter().copied().fold(f64::INFINITY, f64::min);
    if least > 0.0 && largest(&own) > APART * least { Ok(own) } else { try_filled(WHAT, common, n) }
}

/// What rates leave of the inputs; a pair of a lower and an upper side, step by step.
pub(crate) struct Within<'a> {
    pub(crate) rate: &'a [f64],
    /// `u(-1)`
    pub(crate) previous: &'a [f64],
}

type Pair<'a> = (&'a mut [f64], &'a mut [f64]);

impl Within<'_> {
    /// Values from where all later limits can be kept.
    pub(crate) fn look_ahead(&self, (low, high): Pair<'_>) -> Result<()> {
        let (rate, previous, m) = (self.rate, self.previous, self.rate.len());
        let gap = |l: f64, h: f64| l - h > SLACK * (1.0 + l.abs());
        for step in (0..low.len() / m).rev() {
            for (j, rate) in rate.iter().enumerate() {
                let i = step * m + j;
                if let (Some(&l), Some(&h)) = (low.get(i + m), high.get(i + m)) {
                    low[i] = low[i].max(l - rate);
                    high[i] = high[i].min(h + rate);
                }
                if gap(low[i], high[i]) {
                    let found = format!("input {j} of step {step}, where {:.3e} are missing", low[i] - high[i]);
                    return Err(Error::Value { name: "rate", expected: "enough for the limits of all steps", found });
                }
            }
        }
        for i in 0..m.min(low.len()) {
            let off = (low[i] - rate[i] - previous[i]).max(previous[i] - rate[i] - high[i]);
            if off > SLACK * (1.0 + previous[i].abs() + rate[i]) {
                let found = format!("input {i}, which is {off:.3e} too far");
                return Err(Error::Value { name: "previous", expected: "within `rate` of the limits", found });
            }
        }
        Ok(())
    }

    /// The values that can be reached; where it is one, no limit but this is left of the input, with `width` of
    /// rounding.
    pub(crate) fn reach(&self, (low, high): Pair<'_>, inputs: Pair<'_>, width: &mut [f64]) {
        let (rate, previous, m) = (self.rate, self.previous, self.rate.len());
        for (i, (rate, previous)) in (0..low.len()).zip(rate.iter().zip(previous).cycle()) {
            let (l, h) = if i < m { (*previous, *previous) } else { (low[i - m], high[i - m]) };
            low[i] = low[i].max(l - rate);
            high[i] = high[i].min(h + rate);
            if high[i] - low[i] <= SLACK * (1.0 + low[i].abs()) {
                width[i] = (high[i] - low[i]).abs();
                let value = low[i].max(inputs.0[i]).min(inputs.1[i]);
                (low[i], high[i], inputs.0[i], inputs.1[i]) = (value, value, value, value);
            }
        }
    }
}

/// An input inside its limits, and within the rate of the one `before`.
pub(crate) fn clipped(
    value: f64,
    before: Option<(f64, f64)>,
    (low, high): (f64, f64),
    (below, above): (f64, f64),
) -> f64 {
    let value = before.map_or(value, |(last, rate)| value.max(last - rate).min(last + rate));
    // where rounding leaves nothing, the limits are kept, and the rate to rounding
    let clipped = value.max(low).min(high).max(below).min(above) + 0.0;
    let near = |limit: f64| limit.is_finite() && (clipped - limit).abs() <= NEAR * limit.abs();
    if near(below) {
        below
    } else if near(above) {
        above
    } else {
        clipped
    }
}

impl<'a> Task<'a> {
    /// `h` has been checked.
    pub(super) fn new(h: Steps<'a>, bounds: Bounds<'a>, rows: Rows<'a>) -> Result<Self> {
        let n = h.x0.len();
        let (m, steps) = (h.b.len() / n.max(1), h.reference.len() / n.max(1));
        sized("low", bounds.low.len(), steps * m)?;
        rows.check(n, m, steps)?;
        let (below, above) = rows.states.unwrap_or((&[], &[]));
        let (low, high) = (try_copy(WHAT, below)?, try_copy(WHAT, above)?);
        let state = sizes(&h, &low, &high)?;
        // each input in the unit in which it moves a state by its size, or its reach if that is less
        let mut input = try_zeros(WHAT, m)?;
        for (j, input) in input.iter_mut().enumerate() {
            let gains = h.b.iter().skip(j).step_by(m).zip(&state).filter(|(b, _)| **b != 0.0);
            let least = gains.map(|(b, state)| state / b.abs()).fold(f64::INFINITY, f64::min);
            *input = if least.is_finite() && least > 0.0 { least } else { 1.0 };
        }
        let copied = || Ok((try_copy(WHAT, bounds.low)?, try_copy(WHAT, bounds.high)?));
        let (inputs, within) = (copied()?, copied()?);
        let width = try_zeros(WHAT, steps * m)?;
        let (rate, soft, grows) = (rows.rate, rows.soft, rows.grows);
        let mut new =
            Self { h, n, m, steps, inputs, width, rate, low, high, soft, grows, within, size: (state, input) };
        if let Some((rate, previous)) = new.rate {
            let of_rates = Within { rate, previous };
            of_rates.look_ahead((&mut new.within.0, &mut new.within.1))?;
            let inputs = (&mut new.inputs.0[..], &mut new.inputs.1[..]);
            of_rates.reach((&mut new.within.0, &mut new.within.1), inputs, &mut new.width);
        }
        for (j, unit) in new.size.1.iter_mut().enumerate() {
            let sides = [&new.within.0, &new.within.1].map(|side| side.iter().skip(j).step_by(m));
            let reach = sides.into_iter().flatten().fold(0.0f64, |reach, v| reach.max(v.abs()));
            if reach > 0.0 {
                *unit = unit.min(reach);
            }
        }
        Ok(new)
    }

    pub(super) fn bounds(&self) -> Bounds<'_> {
        Bounds { low: &self.inputs.0, high: &self.inputs.1 }
    }

    /// What limits and rates together leave of each input.
    pub(super) fn reachable(&self) -> Bounds<'_> {
        Bounds { low: &self.within.0, high: &self.within.1 }
    }

    /// Whether the limits of inputs leave nothing of the limit of a change.
    pub(super) fn idle(&self, i: usize) -> bool {
        let bounds = self.bounds();
        bounds.fixed(i) && (i < self.m || bounds.fixed(i - self.m))
    }

    pub(super) fn hard(&self) -> bool {
        self.soft.is_none() && !self.low.is_empty()
    }

    /// `u(k-1)` of the entry `i` of `u`.
    pub(super) fn before(&self, u: &[f64], i: usize) -> f64 {
        match self.rate {
            Some((_, previous)) if i < self.m => previous[i],
            _ => u[i - self.m],
        }
    }

    /// Brings inputs inside their limits, and changes within the rate, one step after another.
    pub(super) fn clip(&self, u: &mut [f64]) {
        for i in 0..u.len() {
            u[i] = self.clipped(u, i);
        }
    }

    /// The input `i` inside its limits, and within the rate of the one before.
    pub(super) fn clipped(&self, u: &[f64], i: usize) -> f64 {
        let before = self.rate.map(|(rate, _)| (self.before(u, i), rate[i % self.m]));
        clipped(u[i], before, (self.within.0[i], self.within.1[i]), (self.inputs.0[i], self.inputs.1[i]))
    }

    /// How far the input `i` can move from `u` where those before have moved by `moves`.
    pub(super) fn room(&self, u: &[f64], moves: &[f64], i: usize) -> (f64, f64) {
        let (mut low, mut high) = (self.within.0[i] - u[i], self.within.1[i] - u[i]);
        if let Some((rate, _)) = self.rate {
            let (change, rate) = (u[i] - self.before(u, i), rate[i % self.m]);
            let moved = if i < self.m { 0.0 } else { moves[i - self.m] };
            (low, high) = (low.max(moved - rate - change), high.min(moved + rate - change));
        }
        (low, high)
    }

    /// `x(1) .. x(K)`
    pub(super) fn roll(&self, u: &[f64], x: &mut [f64]) {
        self.roll_from(self.h.x0, u, x);
    }

    pub(super) fn roll_from(&self, start: &[f64], u: &[f64], x: &mut [f64]) {
        let (n, m) = (self.n, self.m);
        for t in 0..self.steps {
            let (before, after) = x.split_at_mut(t * n);
            let last = if t == 0 { start } else { &before[(t - 1) * n..] };
            for (i, to) in after[..n].iter_mut().enumerate() {
                let of_state: f64 = self.h.a[i * n..(i + 1) * n].iter().zip(last).map(|(a, x)| a * x).sum();
                let of_input: f64 = self.h.b[i * m..(i + 1) * m].iter().zip(&u[t * m..]).map(|(b, u)| b * u).sum();
                *to = of_state + of_input;
            }
        }
    }

    /// `g += G' w`: what weights of the states are for the inputs, by costates `p(k) = A' p(k+1) + w(k)`.
    pub(super) fn pull(&self, w: &[f64], g: &mut [f64]) -> Result<()> {
        let (n, m) = (self.n, self.m);
        if w.is_empty() {
            return Ok(());
        }
        let (mut p, mut next) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        for t in (0..self.steps).rev() {
            next.copy_from_slice(&w[t * n..(t + 1) * n]);
            for (row, p) in self.h.a.chunks_exact(n.max(1)).zip(&p) {
                row.iter().zip(&mut next).for_each(|(a, to)| *to += a * p);
            }
            std::mem::swap(&mut p, &mut next);
            for (row, p) in self.h.b.chunks_exact(m.max(1)).zip(&p) {
                row.iter().zip(&mut g[t * m..(t + 1) * m]).for_each(|(b, to)| *to += b * p);
            }
        }
        Ok(())
    }

    /// The excess of the limit of a state that is largest relative to the size of the state, and that.
    pub(super) fn excess(&self, u: &[f64], x: &[f64]) -> Result<Excess> {
        let (n, m) = (self.n.max(1), self.m.max(1));
        // of a state with the terms that add up to it
        let mut size = try_filled(WHAT, f64::MIN_POSITIVE, self.n)?;
        for (t, (now, u)) in x.chunks_exact(n).zip(u.chunks_exact(m)).enumerate() {
            let last = if t == 0 { self.h.x0 } else { &x[(t - 1) * n..t * n] };
            for (i, size) in size.iter_mut().enumerate() {
                let of_state = self.h.a[i * n..(i + 1) * n].iter().zip(last).map(|(a, x)| (a * x).abs());
                let of_input = self.h.b[i * m..(i + 1) * m].iter().zip(u).map(|(b, u)| (b * u).abs());
                *size = of_state.chain(of_input).fold(size.max(now[i].abs()), f64::max);
            }
        }
        let mut most = Excess::default();
        for (i, ((x, l), h)) in x.iter().zip(&self.low).zip(&self.high).enumerate() {
            let (over, limit) = if x > h { (x - h, h.abs()) } else { (l - x, l.abs()) };
            if over > 0.0 {
                most.relative = most.relative.max(over / size[i % n].max(limit));
                if over / self.size.0[i % n] > most.units {
                    (most.units, most.value) = (over / self.size.0[i % n], over);
                }
            }
        }
        Ok(most)
    }

    /// The same with limits on states that are wider by `more` units of each.
    pub(super) fn widened(&self, more: f64) -> Result<Self> {
        let mut new = Self {
            h: self.h,
            low: try_copy(WHAT, &self.low)?,
            high: try_copy(WHAT, &self.high)?,
            inputs: (try_copy(WHAT, &self.inputs.0)?, try_copy(WHAT, &self.inputs.1)?),
            width: try_copy(WHAT, &self.width)?,
            within: (try_copy(WHAT, &self.within.0)?, try_copy(WHAT, &self.within.1)?),
            size: (try_copy(WHAT, &self.size.0)?, try_copy(WHAT, &self.size.1)?),
            ..*self
        };
        let n = self.n.max(1);
        new.low.iter_mut().enumerate().for_each(|(i, l)| *l -= more * self.size.0[i % n]);
        new.high.iter_mut().enumerate().for_each(|(i, h)| *h += more * self.size.0[i % n]);
        Ok(new)
    }
}
