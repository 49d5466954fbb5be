//! The search for the minimum: what is best so far, and how every control is judged.

use super::assembly::{Kind, Multipliers};
use super::task::{Excess, KEPT, Task, WHAT};
use crate::error::{Error, Result};
use crate::limits::certificate::{Certificate, NOTHING, frank_wolfe};
use crate::limits::quadratic::{Method, Quadratic, Until};
use crate::limits::riccati::Riccati;
use crate::limits::riccati::closed::{Judged, Pull};
use crate::memory::{try_collect, try_copy, try_filled, try_zeros};

/// Distance of an input from a limit, relative to the size of inputs, up to which the limit is reached.
const REACHED: f64 = 1e-12;
/// Gaps relative to `J` below which another control is as good.
pub(super) const EXACT: f64 = 1e-14;
/// The larger of gap and excess, relative to `J(u)` and to the states, from which on nothing else is tried.
pub(super) const GOOD: f64 = 1e-11;

/// A control within its limits and rates, judged.
pub(super) struct Found {
    pub(super) u: Vec<f64>,
    pub(super) x: Vec<f64>,
    /// Where the system grows: steps over which the inputs alone lead to `x`, and their `J`.
    pub(super) open: Option<(usize, f64)>,
    /// Half the gradient, with the multipliers of the rows.
    pub(super) g: Vec<f64>,
    pub(super) rows: Multipliers,
    pub(super) certificate: Certificate,
    pub(super) scale: f64,
    pub(super) excess: Excess,
    /// The larger of the gap and the excess, both relative.
    pub(super) merit: f64,
    pub(super) method: Method,
}

fn halved(values: &[f64]) -> Result<Vec<f64>> {
    try_collect(WHAT, values.iter().map(|v| 0.5 * v))
}

pub(super) struct Search<'a, 'b> {
    pub(super) task: &'a Task<'b>,
    pub(super) q: &'a mut Riccati,
    /// Inputs with one value only.
    pub(super) fixed: Vec<i8>,
    pub(super) regular: Option<bool>,
    pub(super) best: Option<Found>,
    pub(super) iterations: usize,
}

impl<'a, 'b> Search<'a, 'b> {
    pub(super) fn new(task: &'a Task<'b>, q: &'a mut Riccati) -> Result<Self> {
        let mut fixed = try_filled(WHAT, 0, task.steps * task.m)?;
        fixed.iter_mut().enumerate().for_each(|(i, to)| *to = i8::from(task.bounds().fixed(i)));
        Ok(Self { task, q, fixed, regular: None, best: None, iterations: 0 })
    }

    /// Inputs within their limits and rates, and the states to which they lead, or where the system grows to which they
    /// lead with the feedback that keeps them near `x`.
    pub(super) fn settle(&self, u: &mut [f64], x: &mut [f64]) -> Result<()> {
        if self.task.grows {
            return self.q.follow(u, x, |u, i| self.task.clipped(u, i));
        }
        self.task.clip(u);
        self.task.roll(u, x);
        Ok(())
    }

    /// Takes `u`, clipped, and the signs that its multipliers must have; keeps it if it is the best so far. `x`: states
    /// near which it is followed where the system grows.
    pub(super) fn verify(
        &mut self,
        (u, x): (&[f64], &[f64]),
        rows: &Multipliers,
        method: Method,
        until: Until<'_>,
    ) -> Result<()> {
        let task = self.task;
        if u.iter().chain(x).chain(rows[1..].iter().flatten()).any(|v| !v.is_finite()) {
            return Ok(());
        }
        let d = u.len();
        let (mut u, mut g, mut x) = (try_copy(WHAT, u)?, try_zeros(WHAT, d)?, try_copy(WHAT, x)?);
        self.settle(&mut u, &mut x)?;
        let mut objective = if task.grows { 0.0 } else { self.q.slope(&u, &mut g) };
        let (given, mut rows, mut slack) = (rows, Multipliers::default(), 0.0);
        for (to, from) in rows.iter_mut().zip(given).skip(1) {
            *to = try_copy(WHAT, from)?;
        }
        for (kind, _) in task.kinds().into_iter().skip(1) {
            for (i, multiplier) in rows[kind as usize].iter_mut().enumerate() {
                let ((low, high), value) = (task.limits(kind, i), task.value(kind, i, &u, &x));
                if let (Kind::State, Some(soft)) = (kind, task.soft) {
                    let over = (value - high).max(0.0) - (low - value).max(0.0);
                    objective += soft * over * over;
                    *multiplier = 2.0 * soft * over;
                    continue;
                }
                let room = if *multiplier > 0.0 { high - value } else { value - low };
                if room == f64::INFINITY {
                    *multiplier = 0.0;
                }
                if *multiplier != 0.0 {
                    slack += multiplier.abs() * room.max(0.0);
                }
            }
        }
        if !objective.is_finite() {
            return Ok(());
        }
        let excess = if task.hard() { task.excess(&u, &x)? } else { Excess::default() };
        let mut pulled = try_zeros(WHAT, d)?;
        if task.grows {
            task.pull_rows(&rows, &mut pulled);
            let Some(mut found) = self.judged((&u, &x), (&rows, &pulled), slack, until)? else { return Ok(()) };
            found.certificate.objective += objective;
            let (scale, open) = (found.size, Some((found.open_until, found.open_objective + objective)));
            let new = Found {
                u,
                x,
                open,
                g: found.g,
                rows,
                certificate: found.certificate,
                scale,
                excess,
                merit: 0.0,
                method,
            };
            self.keep(new);
            return Ok(());
        }
        task.pull(&rows[Kind::State as usize], &mut pulled)?;
        task.pull_rows(&rows, &mut pulled);
        g.iter_mut().zip(&pulled).for_each(|(g, v)| *g += 0.5 * v);
        slack += g.iter().zip(&task.width).map(|(g, width)| 2.0 * g.abs() * width).sum::<f64>();
        let frank_wolfe = frank_wolfe(task.reachable(), &u, &g) + slack;
        let (squared, near) = self.dual_norm(&u, &g, until)?;
        let all = slack + near;
        let certificate = Certificate {
            objective,
            frank_wolfe,
            gap: frank_wolfe.min(squared + all),
            distance: (frank_wolfe / 2.0).sqrt().min((squared.sqrt() + (squared + 2.0 * all).sqrt()) / 2.0),
        };
        let scale = self.q.scale();
        self.keep(Found { u, x, open: None, g, rows, certificate, scale, excess, merit: 0.0, method });
        Ok(())
    }

    /// Keeps what was judged if it is the best so far.
    fn keep(&mut self, mut new: Found) {
        let (found, relative) = (&mut new.certificate, new.excess.relative);
        if relative > KEPT {
            (found.gap, found.distance, found.frank_wolfe) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
        } else {
            found.at_least_nothing(new.scale);
        }
        // "good" is a hundredth of "optimal"
        let size = (found.objective + NOTHING * new.scale).max(f64::MIN_POSITIVE);
        new.merit = (found.gap / size).max(relative);
        let merit = new.merit;
        let better = self.best.as_ref().is_none_or(|best| {
            let unknown = merit == f64::INFINITY && best.merit == f64::INFINITY;
            merit <= best.merit.max(EXACT) && !unknown || unknown && new.excess.units <= best.excess.units
        });
        if better {
            self.best = Some(new);
        }
    }

    /// The certificate of a plan that is followed.
    fn judged(
        &mut self,
        (u, x): (&[f64], &[f64]),
        (rows, pulled): (&Multipliers, &[f64]),
        slack: f64,
        until: Until<'_>,
    ) -> Result<Option<Judged>> {
        let (task, mut held) = (self.task, try_copy(WHAT, &self.fixed)?);
        let (states, inputs) = (halved(&rows[Kind::State as usize])?, halved(pulled)?);
        let pull = Pull { states: &states, inputs: &inputs, slack, soft: task.soft };
        // the distance of an input from the limit that a gradient presses it against
        let off = |i: usize, g: f64| {
            let reach = task.reachable();
            let off = (u[i] - if g > 0.0 { reach.low[i] } else { reach.high[i] }).abs();
            let reached = off <= REACHED * u[i].abs().max(task.unit(Kind::Input, i));
            (self.fixed[i] != 0 || reached).then_some(if self.fixed[i] != 0 { task.width[i] } else { off })
        };
        for (i, held) in held.iter_mut().enumerate() {
            *held = i8::from(*held != 0 || off(i, 1.0).is_some() || off(i, -1.0).is_some());
        }
        self.q.judge((u, x), &held, &pull, off, |i, moves| task.room(u, moves, i), until)
    }

    /// An upper bound of `e' H^{-1} e`, `e` the part of `g` that no limit of an input balances, with the error of the
    /// solution `v` in it: for `r = e - H v` it is `e'v + v'r + r' H^{-1} r`. And `s` of limits that are reached up to
    /// rounding.
    fn dual_norm(&mut self, u: &[f64], g: &[f64], until: Until<'_>) -> Result<(f64, f64)> {
        let (task, d, mut near) = (self.task, u.len(), 0.0);
        let mut e = try_copy(WHAT, g)?;
        for (i, e) in e.iter_mut().enumerate() {
            let limit = if *e > 0.0 { task.reachable().low[i] } else { task.reachable().high[i] };
            let off = (u[i] - limit).abs();
            if self.fixed[i] != 0 || off <= REACHED * u[i].abs().max(task.unit(Kind::Input, i)) {
                near += if self.fixed[i] != 0 { 0.0 } else { 2.0 * e.abs() * off };
                *e = 0.0;
            }
        }
        if e.iter().all(|e| *e == 0.0) {
            return Ok((0.0, near));
        }
        if self.regular.is_none() {
            self.regular = match self.q.barrier(&self.fixed, &try_zeros(WHAT, d)?, until) {
                Err(Error::Interrupted) => None, // no time for its factors: the other bound is left
                found => Some(found?),
            };
        }
        if self.regular != Some(true) {
            return Ok((f64::INFINITY, near));
        }
        let mut v = try_copy(WHAT, &e)?;
        self.q.newton(&mut v);
        // r = e - H v
        let mut r = task.curved(&v)?;
        for (i, r) in r.iter_mut().enumerate() {
            *r = if self.fixed[i] == 0 { e[i] - *r } else { 0.0 };
        }
        let mut w = try_copy(WHAT, &r)?;
        self.q.newton(&mut w);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (main, first, second) = (dot(&e, &v), dot(&v, &r).abs(), dot(&r, &w).abs());
        // where the correction is not small the factors are not those of H
        let sound = main.is_finite() && second <= 0.1 * main;
        Ok((if sound { main + first + 2.0 * second } else { f64::INFINITY }, near))
    }
}
