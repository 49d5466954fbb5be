//! The command with the least mean of the squared misses: `J(u) = mean_s ||G_s u - b_s||_Q^2 + ||u||_R^2`.

use std::time::Duration;

use super::mean::{moments, slope, triangle};
use super::units::{Units, WHAT};
use crate::error::{Error, Result};
use crate::limits::{self, Bounds, Decomposition, Penalty, Status, Until};
use crate::memory::{checked_len, try_collect, try_extend, try_filled, try_zeros};
use crate::parallel::Stop;
use crate::vector::{axpy, dot, norm};

/// Eigenvalues of `H + R` below this share of the largest are better had without squares.
const SQUARED: f64 = 1e-10;
/// Gap of an optimal command, relative to `J(0) + J(u)`.
const GOOD: f64 = 1e-9;
/// Corrections by the gradient from the residuals of all units.
const ROUNDS: usize = 4;

/// A command and how far from the best one it can be.
pub struct LeastMean {
    /// `u`, inside the limits.
    pub control: Vec<f64>,
    /// `J(u)^(1/2)`
    pub value: f64,
    /// No command within the limits has a smaller one.
    pub lower_bound: f64,
    /// How the computation ended.
    pub status: Status,
}

/// `J` by all units: `H + R = V diag(half^2) V'` without what is rounding, V vector by vector in `along`.
struct Mean<'a> {
    units: &'a Units<'a>,
    bounds: Bounds<'a>,
    r: &'a [f64],
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

/// Finds it by the moments; where `H + R` is ill-conditioned, by an orthogonal triangle of all rows. `r` (m, m) is the weight
/// of one input, or empty.
///
/// # Errors
/// [`Error::Overflow`], [`Error::Memory`], [`Error::Numerical`], [`Error::Interrupted`] before there is a command.
pub fn least_mean(
    units: &Units<'_>,
    bounds: Bounds<'_>,
    r: &[f64],
    time: Option<Duration>,
    threads: usize,
    stop: &Stop,
) -> Result<LeastMean> {
    let (d, until) = (units.inputs(), Until::new(stop, time));
    let mean = Mean::new(units, bounds, r, threads, stop)?;
    let (map, mut status) = (mean.map()?, Status::Optimal);
    let mut u = try_collect(WHAT, (0..d).map(|i| bounds.clip(i, 0.0)))?;
    let mut now = mean.at(&u)?;
    for _ in 0..ROUNDS {
        // the least of the quadratic that has this gradient at u
        let aim = mean.half.iter().zip(mean.along.chunks_exact(d));
        let y = try_collect(WHAT, aim.map(|(half, v)| half * dot(v, &u) - dot(v, &now.slope) / half))?;
        let y = if y.is_empty() { try_zeros(WHAT, 1)? } else { y };
        let zero = try_zeros(WHAT, d)?;
        let found = limits::box_control(&map, &y, Penalty::Diagonal(&zero), bounds, None, until)?;
        status = found.status;
        let next = match mean.at(&found.control) {
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
        if stopped || now.gap <= f64::EPSILON * (mean.at_zero + now.square) {
            break;
        }
    }
    if matches!(status, Status::Optimal | Status::Inaccurate) {
        let good = now.gap <= GOOD * (mean.at_zero + now.square);
        status = if good { Status::Optimal } else { Status::Inaccurate };
    }
    let lower_bound = (now.square - now.gap).max(0.0).sqrt();
    Ok(LeastMean { control: u, value: now.square.sqrt(), lower_bound, status })
}

impl<'a> Mean<'a> {
    fn new(units: &'a Units<'a>, bounds: Bounds<'a>, r: &'a [f64], threads: usize, stop: &'a Stop) -> Result<Self> {
        let (d, m) = (units.inputs(), units.m);
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
        Ok(Self { units, bounds, r, half, along, at_zero: found.constant, threads, stop })
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

    fn at(&self, u: &[f64]) -> Result<Value> {
        let (d, m) = (u.len(), self.units.m);
        let (mut square, mut g) = slope(self.units, u, self.threads, self.stop)?;
        for (g, u) in g.chunks_exact_mut(m).zip(u.chunks_exact(m)) {
            for (g, (u_i, row)) in g.iter_mut().zip(u.iter().zip(self.r.chunks_exact(m))) {
                let weighed = dot(row, u);
                *g += weighed;
                square += u_i * weighed;
            }
        }
        // J(u) - J(v) <= <J'(u), u - v> for all v within the limits
        let mut wolfe = 0.0_f64;
        // J(u) - min J <= e'(H + R)^-1 e, e the part of J' / 2 that no limit balances
        let mut e = try_filled(WHAT, 0.0, d)?;
        for (i, (&g, &u)) in g.iter().zip(u).enumerate().filter(|(_, (g, _))| **g != 0.0) {
            let (low, high) = (self.bounds.low[i], self.bounds.high[i]);
            wolfe += 2.0 * (g * (u - low)).max(g * (u - high));
            if !((u == low && g > 0.0) || (u == high && g < 0.0)) {
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
        Ok(Value { square, gap: wolfe.min(newton).max(0.0), slope: g })
    }
}

/// Rows whose squares are `H + R`.
fn without_squares(units: &Units<'_>, r: &[f64], stop: &Stop) -> Result<Vec<f64>> {
    let (d, m) = (units.inputs(), units.m);
    let share = (units.size as f64).sqrt().recip();
    let mut rows = Vec::new();
    for row in triangle(units, stop)?.chunks_exact(d + 1) {
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
