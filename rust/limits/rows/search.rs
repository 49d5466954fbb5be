//! The search for the minimum: what is best so far, and how every control is judged.

use super::assembly::{Kind, Multipliers};
use super::task::{Task, WHAT};
use crate::error::{Error, Result};
use crate::limits::certificate::{Certificate, frank_wolfe};
use crate::limits::quadratic::{Method, Quadratic, Until};
use crate::limits::riccati::Riccati;
use crate::memory::{try_copy, try_filled, try_zeros};

/// Excess of a limit on states, relative to the size of the states, up to which the limit is kept.
pub(super) const KEPT: f64 = 1e-9;
/// Distance of an input from a limit, relative to the size of inputs, up to which the limit is reached.
const REACHED: f64 = 1e-12;
/// Gaps relative to `J` below which another control is as good.
pub(super) const EXACT: f64 = 1e-14;
/// The larger of gap and excess, both relative, from which on nothing else is tried: hundred times better than "optimal".
pub(super) const GOOD: f64 = 1e-11;

/// A control within its limits and rates, judged.
pub(super) struct Found {
    pub(super) u: Vec<f64>,
    /// Half the gradient, with the multipliers of the rows.
    pub(super) g: Vec<f64>,
    pub(super) rows: Multipliers,
    pub(super) certificate: Certificate,
    pub(super) scale: f64,
    pub(super) excess: f64,
    /// The larger of the gap and the excess, both relative.
    pub(super) merit: f64,
    pub(super) method: Method,
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

    /// Takes `u`, clipped, and the signs that its multipliers must have; keeps it if it is the best so far.
    pub(super) fn verify(&mut self, u: &[f64], rows: &Multipliers, method: Method, until: Until<'_>) -> Result<()> {
        let task = self.task;
        if u.iter().chain(rows[1..].iter().flatten()).any(|v| !v.is_finite()) {
            return Ok(());
        }
        let d = u.len();
        let (mut u, mut g, mut x) = (try_copy(WHAT, u)?, try_zeros(WHAT, d)?, try_zeros(WHAT, task.steps * task.n)?);
        task.clip(&mut u);
        task.roll(&u, &mut x);
        let mut objective = self.q.slope(&u, &mut g);
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
        let mut pulled = try_zeros(WHAT, d)?;
        task.pull(&rows[Kind::State as usize], &mut pulled)?;
        task.pull_rows(&rows, &mut pulled);
        g.iter_mut().zip(&pulled).for_each(|(g, v)| *g += 0.5 * v);
        slack += g.iter().zip(&task.width).map(|(g, width)| 2.0 * g.abs() * width).sum::<f64>();
        let frank_wolfe = frank_wolfe(task.reachable(), &u, &g) + slack;
        let (squared, near) = self.dual_norm(&u, &g, until)?;
        let all = slack + near;
        let (excess, relative) = if task.hard() { task.excess(&x) } else { (0.0, 0.0) };
        let mut certificate = Certificate {
            objective,
            frank_wolfe,
            gap: frank_wolfe.min(squared + all),
            distance: (frank_wolfe / 2.0).sqrt().min((squared.sqrt() + (squared + 2.0 * all).sqrt()) / 2.0),
        };
        if relative > KEPT {
            (certificate.gap, certificate.distance, certificate.frank_wolfe) =
                (f64::INFINITY, f64::INFINITY, f64::INFINITY);
        }
        let scale = self.q.scale();
        let size = (scale + objective).max(f64::MIN_POSITIVE);
        let merit = (certificate.gap / size).max(relative);
        let better = self.best.as_ref().is_none_or(|best| {
            let unknown = merit == f64::INFINITY && best.merit == f64::INFINITY;
            merit <= best.merit.max(EXACT) && !unknown || unknown && excess <= best.excess
        });
        if better {
            self.best = Some(Found { u, g, rows, certificate, scale, excess, merit, method });
        }
        Ok(())
    }

    /// An upper bound of `e' H^{-1} e`, `e` the part of `g` that no limit of an input balances, with the error of the
    /// solution `v` in it: for `r = e - H v` it is `e'v + v'r + r' H^{-1} r`. And `s` of limits that are reached up to rounding.
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
