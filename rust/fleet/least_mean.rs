//! The command with the least mean of the squared misses: `J(u) = mean_s ||G_s u - b_s||_Q^2 + ||u||_R^2`.

use std::time::Duration;

use super::chosen::EXACT;
use super::held::{Forces, Held, broken, scaled};
use super::look::look;
use super::mean::{moments, moments_root, slope};
use super::missing::least_excess;
use super::program::Program;
use super::units::{Units, WHAT};
use super::within::{Limits, Within};
use crate::error::{Error, Result};
use crate::limits::{self, Bounds, Decomposition, Penalty, Status, Until};
use crate::memory::{checked_len, try_collect, try_copy, try_extend, try_filled, try_zeros};
use crate::parallel::Stop;
use crate::scaled::nearest_power_of_two;
use crate::vector::{axpy, dot, norm};

/// Eigenvalues of `H + R` below this share of the largest are better had without squares.
const SQUARED: f64 = 1e-10;
/// Gap of an optimal command, relative to `J(0) + J(u)`.
const GOOD: f64 = 1e-9;
/// A program that was left this far from its constraints has none that can be kept, unless it is shown otherwise.
const UNMET: f64 = 1e-4;
/// Distance of an input from a limit, relative to the largest input, up to which the limit balances its slope.
const REACHED: f64 = 1e-6;
/// Corrections by the gradient from the residuals of all units.
const ROUNDS: usize = 4;

/// A command and how far from the best one it can be.
#[non_exhaustive]
#[derive(Debug)]
pub struct LeastMean {
    /// `u`, inside the limits.
    pub control: Vec<f64>,
    /// `J(u)^(1/2)`
    pub value: f64,
    /// No command within the limits has a smaller one.
    pub lower_bound: f64,
    /// By how much limits of states cannot be kept.
    pub missing: f64,
    /// How the computation ended.
    pub status: Status,
}

/// `J` by all units: `H + R = V diag(half^2) V'` without what is rounding, V vector by vector in `along`.
struct Mean<'a> {
    units: &'a Units<'a>,
    within: &'a Within<'a>,
    bounds: Bounds<'a>,
    r: &'a [f64],
    /// `H + R`
    h: Vec<f64>,
    half: Vec<f64>,
    along: Vec<f64>,
    at_zero: f64,
    threads: usize,
    stop: &'a Stop,
}

/// `J(u)`, a bound of `J(u) - min J`, and half its gradient.
struct Value {
    square: f64,
    gap: f64,
    slope: Vec<f64>,
}

/// Finds it by the moments; where `H + R` is ill-conditioned, by an orthogonal triangle of all rows. Limits of states
/// are taken in as they are broken.
///
/// # Errors
/// [`Error::Overflow`], [`Error::Memory`], [`Error::Numerical`], [`Error::Interrupted`] before there is a command.
pub fn least_mean(
    units: &Units<'_>,
    limits: Limits<'_>,
    time: Option<Duration>,
    threads: usize,
    stop: &Stop,
) -> Result<LeastMean> {
    let until = Until::new(stop, time);
    let within = Within::new(units, limits)?;
    let mean = Mean::new(units, &within, threads, stop)?;
    if limits.rate.is_none() && limits.states.is_none() {
        return mean.in_a_box(until);
    }
    let (found, held) = mean.within_rows(until)?;
    if found.status != Status::Infeasible {
        return Ok(found);
    }
    let skip = try_filled(WHAT, false, units.size)?;
    let missing = match least_excess(units, &within, &skip, held, (threads, until)) {
        Err(Error::Interrupted) => return Ok(LeastMean { status: until.ended(), ..found }),
        missing => missing?,
    };
    if !missing.sure {
        return Ok(LeastMean { status: Status::Inaccurate, ..found });
    }
    // the best command within limits that are wider by what is missing
    let wider = within.wider(missing.missing)?;
    let within = Within::new(units, Limits { states: Some((&wider.0, &wider.1)), ..limits })?;
    let mean = Mean { within: &within, bounds: within.bounds(), ..mean };
    let (found, _) = mean.within_rows(until)?;
    let ended = matches!(found.status, Status::Limit | Status::Interrupted);
    let status = if ended { found.status } else { Status::Infeasible };
    Ok(LeastMean { missing: missing.missing, status, ..found })
}

impl<'a> Mean<'a> {
    fn new(units: &'a Units<'a>, within: &'a Within<'a>, threads: usize, stop: &'a Stop) -> Result<Self> {
        let (d, m, r) = (units.inputs(), units.m, within.given.r);
        let found = moments(units, threads, stop)?;
        let mut h = found.h;
        for (k, row) in r.chunks_exact(m).cycle().take(if r.is_empty() { 0 } else { d }).enumerate() {
            axpy(1.0, row, &mut h[k * d + k / m * m..][..m]);
        }
        let (values, mut along) = limits::eigen(&h, d)?;
        let mut half = try_collect(WHAT, values.iter().map(|value| value.max(0.0).sqrt()))?;
        if values[0] <= SQUARED * values[d - 1] {
            let rows = without_squares(units, r, stop)?;
            Decomposition { s: half, v: along, .. } = limits::decomposition(&rows, d)?;
        }
        let least = d as f64 * f64::EPSILON * half.iter().fold(1e-300, |most: f64, v| most.max(*v));
        let mut kept = 0;
        for k in 0..half.len() {
            if half[k] > least {
                along.copy_within(k * d..(k + 1) * d, kept * d);
                half[kept] = half[k];
                kept += 1;
            }
        }
        half.truncate(kept);
        along.truncate(kept * d);
        let bounds = within.bounds();
        Ok(Self { units, within, bounds, r, h, half, along, at_zero: found.constant, threads, stop })
    }

    /// Limits of single inputs.
    fn in_a_box(&self, until: Until<'_>) -> Result<LeastMean> {
        let (d, none) = (self.units.inputs(), Forces::none());
        let (map, mut status) = (self.map()?, Status::Optimal);
        let mut u = self.within.near_zero()?;
        let mut now = self.at(&u, &[], &none)?;
        for _ in 0..ROUNDS {
            // the least of the quadratic that has this gradient at u
            let aim = self.half.iter().zip(self.along.chunks_exact(d));
            let y = try_collect(WHAT, aim.map(|(half, v)| half * dot(v, &u) - dot(v, &now.slope) / half))?;
            let y = if y.is_empty() { try_zeros(WHAT, 1)? } else { y };
            let zero = try_zeros(WHAT, d)?;
            let found = limits::box_control(&map, &y, Penalty::Diagonal(&zero), self.bounds, None, until)?;
            status = found.status;
            let next = match self.at(&found.control, &[], &none) {
                Err(Error::Interrupted) => {
                    status = Status::Interrupted;
                    break;
                }
                next => next?,
            };
            if !(next.gap < now.gap || next.square < now.square) {
                break;
            }
            (u, now) = (found.control, next);
            let stopped = matches!(status, Status::Limit | Status::Interrupted);
            if stopped || now.gap <= f64::EPSILON * (self.at_zero + now.square) {
                break;
            }
        }
        if matches!(status, Status::Optimal | Status::Inaccurate) {
            let good = now.gap <= GOOD * (self.at_zero + now.square);
            status = if good { Status::Optimal } else { Status::Inaccurate };
        }
        let lower_bound = (now.square - now.gap).max(0.0).sqrt();
        Ok(LeastMean { control: u, value: now.square.sqrt(), lower_bound, missing: 0.0, status })
    }

    /// Rates, and limits of states as they are broken. And those that were taken in.
    fn within_rows(&self, until: Until<'_>) -> Result<(LeastMean, Vec<Held>)> {
        let (units, within, d) = (self.units, self.within, self.units.inputs());
        let run = (self.threads, until);
        let skip = try_filled(WHAT, false, units.size)?;
        let (free, mut u) = (within.free()?, within.near_zero()?);
        let first = look(units, within, &u, &skip, run)?;
        let mut held = broken(units, within, (&u, &first.beyond, &skip), &[], within.kept)?;
        let mut now = self.at(&u, &[], &Forces::none())?;
        let mut excess = within.excess(first.excess);
        let mut best = LeastMean {
            control: try_copy(WHAT, &u)?,
            value: now.square.sqrt(),
            lower_bound: (now.square - now.gap).max(0.0).sqrt(),
            missing: 0.0,
            status: Status::Inaccurate,
        };
        let scale = now.square.max(f64::MIN_POSITIVE);
        let largest = free.iter().fold(0.0f64, |most, &j| most.max(self.h[j * d + j]));
        let unit = nearest_power_of_two(if largest > 0.0 { (scale / largest).sqrt() } else { 1.0 });
        let share = scale / unit / unit;
        if free.is_empty() {
            best.status = if held.is_empty() { Status::Optimal } else { Status::Infeasible };
            return Ok((best, held));
        }
        let mut squares = try_zeros(WHAT, checked_len(WHAT, free.len(), free.len())?)?;
        for (line, &i) in squares.chunks_exact_mut(free.len()).zip(&free) {
            line.iter_mut().zip(&free).for_each(|(to, &j)| *to = self.h[i * d + j] / share);
        }
        let mut waits = 0;
        loop {
            if let Some(ended) = until.reached() {
                best.status = ended;
                return Ok((best, held));
            }
            // the least of the quadratic that has this gradient at u
            let mut linear = try_collect(WHAT, free.iter().map(|&j| now.slope[j] * unit / scale))?;
            for (to, row) in linear.iter_mut().zip(squares.chunks_exact(free.len())) {
                *to -= row.iter().zip(&free).map(|(h, &j)| h * u[j] / unit).sum::<f64>();
            }
            let limits = scaled(&held, within, &free, unit, 0)?;
            let program = Program {
                columns: free.len(),
                squares: &squares,
                linear,
                pairs: within.pairs(&free, unit)?,
                rows: try_copy(WHAT, &limits.rows)?,
                right: try_copy(WHAT, &limits.right)?,
                cones: Vec::new(),
            };
            let point = match program.solve(EXACT, until) {
                Err(Error::Interrupted) => continue,
                point => point?,
            };
            if point.merit > UNMET || point.merit.is_nan() {
                best.status = if held.is_empty() { Status::Inaccurate } else { Status::Infeasible };
                return Ok((best, held));
            }
            free.iter().zip(&point.x).for_each(|(&j, v)| u[j] = v * unit);
            within.clip(&mut u);
            let forces = Forces::of(&point.multipliers, program.pairs.len(), within, &limits, unit, scale)?;
            let seen = look(units, within, &u, &skip, run).and_then(|seen| Ok((seen, self.at(&u, &held, &forces)?)));
            let seen = match seen {
                Err(Error::Interrupted) => continue,
                both => {
                    let (seen, value) = both?;
                    now = value;
                    seen
                }
            };
            let beyond = within.excess(seen.excess);
            best.lower_bound = best.lower_bound.max((now.square - now.gap).max(0.0).sqrt());
            if (beyond, now.square) < (excess, best.value * best.value) {
                (excess, best.value, best.control) = (beyond, now.square.sqrt(), try_copy(WHAT, &u)?);
            }
            let (square, lower) = (best.value * best.value, best.lower_bound * best.lower_bound);
            let good = excess == 0.0 && square - lower <= GOOD * (self.at_zero + square);
            let more = broken(units, within, (&u, &seen.beyond, &skip), &held, within.kept)?;
            waits = if more.is_empty() { waits + 1 } else { 0 };
            if good || waits >= ROUNDS {
                best.status = match (good, excess > 0.0) {
                    (true, _) => Status::Optimal,
                    (_, true) => Status::Infeasible, // unless it is shown otherwise
                    _ => Status::Inaccurate,
                };
                return Ok((best, held));
            }
            try_extend(WHAT, &mut held, more)?;
        }
    }

    /// `diag(half) V'`, where inputs that move no unit to rounding have columns 0; one row of zeros for an empty one.
    fn map(&self) -> Result<Vec<f64>> {
        let d = self.units.inputs();
        let mut map = try_zeros(WHAT, checked_len(WHAT, self.half.len().max(1), d)?)?;
        for (row, (half, v)) in map.chunks_exact_mut(d).zip(self.half.iter().zip(self.along.chunks_exact(d))) {
            axpy(*half, v, row);
        }
        let size = |j: usize| map.iter().skip(j).step_by(d).map(|v| v * v).sum::<f64>().sqrt();
        let sizes = try_collect(WHAT, (0..d).map(size))?;
        let least = d as f64 * f64::EPSILON * sizes.iter().fold(0.0, |most: f64, v| most.max(*v));
        for row in map.chunks_exact_mut(d) {
            row.iter_mut().zip(&sizes).filter(|(_, size)| **size <= least).for_each(|(v, _)| *v = 0.0);
        }
        Ok(map)
    }

    /// With the forces `l` of limits `C u <= c`: `J(u) - J(v) <= -<J'(u) + C'l, v - u> + l'(c - C u)` for all v within
    /// them.
    fn at(&self, u: &[f64], held: &[Held], forces: &Forces) -> Result<Value> {
        let (d, m) = (u.len(), self.units.m);
        let (mut square, mut g) = slope(self.units, u, self.threads, self.stop)?;
        for (g, u) in g.chunks_exact_mut(m).zip(u.chunks_exact(m)) {
            for (g, (u_i, row)) in g.iter_mut().zip(u.iter().zip(self.r.chunks_exact(m))) {
                let weighed = dot(row, u);
                *g += weighed;
                square += u_i * weighed;
            }
        }
        let slope = try_copy(WHAT, &g)?;
        forces.pull(held, self.within, &mut g);
        let slack = 2.0 * forces.slack(held, self.within, u)?;
        // J(u) - J(v) <= <J'(u), u - v> for all v within the limits
        let (mut wolfe, mut near) = (0.0_f64, 0.0_f64);
        let size = REACHED * u.iter().fold(0.0f64, |most, u| most.max(u.abs()));
        // J(u) - min J <= e'(H + R)^-1 e, e the part of J' / 2 that no limit balances
        let mut e = try_filled(WHAT, 0.0, d)?;
        for (i, (&g, &u)) in g.iter().zip(u).enumerate().filter(|(_, (g, _))| **g != 0.0) {
            let (low, high) = (self.bounds.low[i], self.bounds.high[i]);
            wolfe += 2.0 * (g * (u - low)).max(g * (u - high));
            let off = if g > 0.0 { u - low } else { high - u };
            if off <= size {
                near += 2.0 * g.abs() * off;
            } else {
                e[i] = g;
            }
        }
        let largest = self.half.iter().fold(0.0, |most: f64, v| most.max(*v));
        let rounding = d as f64 * f64::EPSILON * largest * (self.at_zero.sqrt() + largest * norm(u));
        let mut newton = 0.0;
        let inside = try_collect(WHAT, self.along.chunks_exact(d).map(|v| dot(v, &e)))?;
        for (inside, (half, v)) in inside.iter().zip(self.half.iter().zip(self.along.chunks_exact(d))) {
            newton += (inside / half).powi(2);
            axpy(-inside, v, &mut e);
        }
        let newton = if norm(&e) <= rounding { newton } else { f64::INFINITY };
        Ok(Value { square, gap: slack + wolfe.min(newton + near).max(0.0), slope })
    }
}

/// Rows whose squares are `H + R`.
fn without_squares(units: &Units<'_>, r: &[f64], stop: &Stop) -> Result<Vec<f64>> {
    let (d, m) = (units.inputs(), units.m);
    let share = (units.size as f64).sqrt().recip();
    let mut rows = Vec::new();
    for row in moments_root(units, stop)?.chunks_exact(d + 1) {
        try_extend(WHAT, &mut rows, row[..d].iter().map(|v| v * share))?;
    }
    let root = if r.is_empty() { Vec::new() } else { limits::root(r, m)? };
    for k in 0..units.steps {
        for row in root.chunks_exact(m) {
            let at = |i: usize| if i / m == k { row[i % m] } else { 0.0 };
            try_extend(WHAT, &mut rows, (0..d).map(at))?;
        }
    }
    Ok(rows)
}
