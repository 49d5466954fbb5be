//! What limits of states lack that no command keeps: a linear program, and a bound from its multipliers.

use super::chosen::EXACT;
use super::held::{Forces, Held, broken, scaled};
use super::look::look;
use super::program::Program;
use super::units::{Units, WHAT};
use super::within::Within;
use crate::error::Result;
use crate::limits::Until;
use crate::memory::{try_copy, try_extend, try_zeros};
use crate::scaled::nearest_power_of_two;
use crate::vector::norm;

/// Inputs that large, relative to those found, are not asked whether they would keep the limits.
const LARGE: f64 = 1e6;

/// The least largest excess, and whether it is certain that there must be one.
pub(super) struct Missing {
    pub(super) missing: f64,
    pub(super) sure: bool,
}

/// Finds it among the units that are not in `skip`; `held` are limits to begin with.
///
/// For `v >= 0` with sum 1 and any `w >= 0`, `min_u v'(C u - c) + w'(D u - d) <=` every excess.
pub(super) fn least_excess(
    units: &Units<'_>,
    within: &Within<'_>,
    skip: &[bool],
    mut held: Vec<Held>,
    run: (usize, Until<'_>),
) -> Result<Missing> {
    let (free, mut u) = (within.free()?, within.near_zero()?);
    let first = look(units, within, &u, skip, run)?;
    if free.is_empty() {
        return Ok(Missing { missing: first.excess, sure: first.excess > within.kept });
    }
    let (columns, size) = (free.len() + 1, first.excess.max(within.kept));
    let mut least = f64::INFINITY;
    loop {
        run.1.check()?;
        let largest = held.iter().map(|held| norm(&held.map)).fold(0.0, f64::max);
        let unit = nearest_power_of_two(if largest > 0.0 { size / largest } else { 1.0 });
        let limits = scaled(&held, within, &free, unit, 1)?;
        let (mut rows, right) = (try_copy(WHAT, &limits.rows)?, try_copy(WHAT, &limits.right)?);
        for (row, by) in rows.chunks_exact_mut(columns).zip(&limits.by) {
            row[columns - 1] = -size / by;
        }
        let mut linear = try_zeros(WHAT, columns)?;
        linear[columns - 1] = 1.0;
        let pairs = within.pairs(&free, unit)?;
        let program = Program { columns, squares: &[], linear, pairs, rows, right, cones: Vec::new() };
        let point = program.solve(EXACT, run.1)?;
        free.iter().zip(&point.x).for_each(|(&j, v)| u[j] = v * unit);
        within.clip(&mut u);
        let now = look(units, within, &u, skip, run)?;
        let sure = must_be(within, &held, &u, (&point.multipliers, program.pairs.len()), &limits, (unit, size))?;
        let better = now.excess < (1.0 - 1e-9) * least;
        least = least.min(now.excess);
        let reached = (point.x[columns - 1] * size).max(within.kept);
        let more = broken(units, within, (&u, &now.beyond, skip), &held, reached * (1.0 + 1e-6))?;
        if more.is_empty() || !point.merit.is_finite() || !better && sure && least <= reached * (1.0 + 1e-6) {
            return Ok(Missing { missing: least, sure: sure && least > within.kept });
        }
        try_extend(WHAT, &mut held, more)?;
    }
}

/// Whether the multipliers show that some limit must be exceeded.
fn must_be(
    within: &Within<'_>,
    held: &[Held],
    u: &[f64],
    (multipliers, pairs): (&[f64], usize),
    limits: &super::held::Scaled,
    (unit, size): (f64, f64),
) -> Result<bool> {
    let forces = Forces::of(multipliers, pairs, within, limits, unit, size)?;
    let mut g = try_zeros(WHAT, u.len())?;
    let aim = forces.pull(held, within, &mut g);
    let large = LARGE * u.iter().fold(unit, |most, v| most.max(v.abs()));
    let least = g.iter().enumerate().map(|(i, g)| {
        let end = if *g > 0.0 { within.low[i].max(-large) } else { within.high[i].min(large) };
        g * end
    });
    let least: f64 = least.sum();
    Ok(forces.held.iter().any(|force| *force > 0.0) && least - aim > 1e-9 * aim.abs().max(least.abs()))
}
