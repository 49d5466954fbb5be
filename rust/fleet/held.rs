//! Limits of states of single units, of which a few are solved for.

use super::units::{Room, Units, WHAT};
use super::within::Within;
use crate::error::Result;
use crate::memory::{try_collect, try_extend, try_filled, try_push, try_zeros};
use crate::vector::{axpy, dot, norm};

/// Limits that are taken in at a time.
const MOST: usize = 256;

/// `map u <= right`: a limit of entry `at` of `x(1) .. x(K)` of a unit, the upper one for `side` 1, the lower one for
/// -1.
pub(super) struct Held {
    pub(super) unit: usize,
    at: usize,
    side: i8,
    pub(super) map: Vec<f64>,
    pub(super) right: f64,
}

/// Rows of a program `C v <= c`, and what each was divided by.
pub(super) struct Scaled {
    pub(super) rows: Vec<f64>,
    pub(super) right: Vec<f64>,
    pub(super) by: Vec<f64>,
}

/// For each state, step and side the limit of the unit that is farthest beyond it, of those that are not held yet; of
/// these the worst. `beyond` is by how much each unit leaves its limits, and more than `least` is asked for.
pub(super) fn broken(
    units: &Units<'_>,
    within: &Within<'_>,
    (u, beyond, skip): (&[f64], &[f64], &[bool]),
    held: &[Held],
    least: f64,
) -> Result<Vec<Held>> {
    let Some((low, high)) = within.given.states else { return Ok(Vec::new()) };
    let len = low.len();
    let mut most = try_filled(WHAT, (least, usize::MAX), 2 * len)?;
    let mut path = try_zeros(WHAT, len)?;
    for s in (0..units.size).filter(|&s| !skip[s] && beyond[s] > least) {
        units.path(s, u, &mut path);
        for (i, x) in path.iter().enumerate() {
            for (to, over) in [(i, x - high[i]), (len + i, low[i] - x)] {
                if over > most[to].0 && !held.iter().any(|held| (held.unit, held.place(len)) == (s, to)) {
                    most[to] = (over, s);
                }
            }
        }
    }
    let mut order = try_collect(WHAT, (0..2 * len).filter(|&i| most[i].1 != usize::MAX))?;
    order.sort_by(|a, b| most[*b].0.total_cmp(&most[*a].0));
    let (mut room, mut found) = (Room::new(units)?, Vec::new());
    for place in order.into_iter().take(MOST) {
        let side = if place < len { 1 } else { -1 };
        try_push(WHAT, &mut found, Held::new(units, within, (most[place].1, place % len, side), &mut room)?)?;
    }
    Ok(found)
}

impl Held {
    fn new(
        units: &Units<'_>,
        within: &Within<'_>,
        (unit, at, side): (usize, usize, i8),
        room: &mut Room,
    ) -> Result<Self> {
        let (n, mut map) = (units.n, try_zeros(WHAT, units.inputs())?);
        let (mut root, mut target) = (try_zeros(WHAT, n)?, [0.0]);
        root[at % n] = f64::from(side);
        units.states(unit, &root, (at / n, at / n + 1), room, &mut map, &mut target);
        let limit = within.given.states.map_or(0.0, |(low, high)| if side > 0 { high[at] } else { -low[at] });
        Ok(Self { unit, at, side, map, right: limit + target[0] })
    }

    fn place(&self, len: usize) -> usize {
        if self.side > 0 { self.at } else { len + self.at }
    }
}

/// The rows of a program for `u = unit v` with the free inputs v; `more` columns of zeros behind them.
pub(super) fn scaled(held: &[Held], within: &Within<'_>, free: &[usize], unit: f64, more: usize) -> Result<Scaled> {
    let mut new = Scaled { rows: Vec::new(), right: Vec::new(), by: Vec::new() };
    let fixed = |j: usize| within.low[j] == within.high[j];
    for held in held {
        let from = new.rows.len();
        try_extend(WHAT, &mut new.rows, free.iter().map(|&j| held.map[j] * unit))?;
        let size = norm(&new.rows[from..]);
        let by = if size > 0.0 { size } else { 1.0 };
        new.rows[from..].iter_mut().for_each(|v| *v /= by);
        try_extend(WHAT, &mut new.rows, (0..more).map(|_| 0.0))?;
        let taken: f64 = (0..held.map.len()).filter(|&j| fixed(j)).map(|j| held.map[j] * within.low[j]).sum();
        try_push(WHAT, &mut new.right, (held.right - taken) / by)?;
        try_push(WHAT, &mut new.by, by)?;
    }
    Ok(new)
}

/// `g += C'v`, and `v' c` for the limits `C u <= c`.
pub(super) fn pull(held: &[Held], v: &[f64], g: &mut [f64]) -> f64 {
    held.iter().zip(v).fold(0.0, |aim, (held, v)| {
        axpy(*v, &held.map, g);
        aim + v * held.right
    })
}

/// The multipliers of `C u <= c` and of the changes: with those of a negative sign, or none, left out.
pub(super) struct Forces {
    pub(super) held: Vec<f64>,
    pub(super) changes: Vec<f64>,
}

impl Forces {
    pub(super) fn none() -> Self {
        Self { held: Vec::new(), changes: Vec::new() }
    }

    /// Of a program whose pairs and rows are those of `within` and of `scaled`, in its units; `share` is that of its
    /// cost.
    pub(super) fn of(
        multipliers: &[f64],
        pairs: usize,
        within: &Within<'_>,
        scaled: &Scaled,
        unit: f64,
        share: f64,
    ) -> Result<Self> {
        let (mut changes, mut held) = (Vec::new(), Vec::new());
        let of_changes = within.of_changes(&multipliers[..pairs]);
        try_extend(WHAT, &mut changes, of_changes.iter().map(|v| (v * share / unit).max(0.0)))?;
        let of_rows = multipliers[pairs..].iter().zip(&scaled.by);
        try_extend(WHAT, &mut held, of_rows.map(|(v, by)| (v * share / by).max(0.0)))?;
        Ok(Self { held, changes })
    }

    /// `g += C'v + D'w`, and `v'c + w'd`
    pub(super) fn pull(&self, held: &[Held], within: &Within<'_>, g: &mut [f64]) -> f64 {
        pull(held, &self.held, g) + within.pull_changes(&self.changes, g)
    }

    /// `v'(c - C u) + w'(d - D u)`, without what is rounding.
    pub(super) fn slack(&self, held: &[Held], within: &Within<'_>, u: &[f64]) -> Result<f64> {
        let mut slack = 0.0;
        for (held, v) in held.iter().zip(&self.held) {
            slack += v * (held.right - dot(&held.map, u)).max(0.0);
        }
        let mut g = try_zeros(WHAT, u.len())?;
        let aim = within.pull_changes(&self.changes, &mut g);
        Ok(slack + (aim - dot(&g, u)).max(0.0))
    }
}
