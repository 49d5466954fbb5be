//! From an interior point to the minimum: the active limits are equalities of one linear system, whose right side are
//! the residuals, so that each round gains digits. Limits with the wrong sign and limits that are broken are exchanged.

use super::assembly::{Held, Kind, Multipliers};
use super::search::{EXACT, Search};
use super::task::{Task, WHAT};
use crate::error::Result;
use crate::limits::quadratic::{Method, Status, Until};
use crate::limits::riccati::closed::{Pull, Residuals};
use crate::memory::try_zeros;

/// Most rounds, and rounds without a better control after which no more follow.
const ROUNDS: usize = 12;
const PATIENCE: usize = 3;
/// Rounding of values, relative to their unit, and of multipliers, relative to the largest.
const ROUNDING: f64 = 1e-13;

fn doubled(mut values: Vec<f64>) -> Vec<f64> {
    values.iter_mut().for_each(|v| *v *= 2.0);
    values
}

impl Task<'_> {
    /// `H v = R v + G' Q G v`
    pub(super) fn curved(&self, v: &[f64]) -> Result<Vec<f64>> {
        let len = self.steps * self.n;
        let (mut x, mut w, mut out) = (try_zeros(WHAT, len)?, try_zeros(WHAT, len)?, try_zeros(WHAT, v.len())?);
        let origin = try_zeros(WHAT, self.n)?;
        self.roll_from(&origin, v, &mut x);
        self.weigh(&x, &mut w);
        self.pull(&w, &mut out)?;
        self.add_of_inputs(v, 1.0, &mut out);
        Ok(out)
    }

    /// `out += scale R u`, step by step.
    fn add_of_inputs(&self, u: &[f64], scale: f64, out: &mut [f64]) {
        let m = self.m.max(1);
        for (u, out) in u.chunks_exact(m).zip(out.chunks_exact_mut(m)) {
            for (row, out) in self.h.r.chunks_exact(m).zip(out) {
                *out += scale * row.iter().zip(u).map(|(r, u)| r * u).sum::<f64>();
            }
        }
    }

    /// What soft limits add to `J(0)`.
    pub(super) fn penalty_at_zero(&self, x: &mut [f64]) -> Result<f64> {
        let Some(soft) = self.soft else { return Ok(0.0) };
        self.roll(&try_zeros(WHAT, self.steps * self.m)?, x);
        let limits = self.low.iter().zip(&self.high);
        Ok(soft * x.iter().zip(limits).map(|(x, (l, h))| (x - h).max(l - x).max(0.0).powi(2)).sum::<f64>())
    }

    /// `J' + inputs + D' rates + G' states`; soft limits as parabolas where they are held.
    pub(super) fn residual(&self, u: &[f64], x: &[f64], multipliers: &Multipliers, held: &Held) -> Result<Vec<f64>> {
        let (mut e, mut w) = (try_zeros(WHAT, x.len())?, try_zeros(WHAT, x.len())?);
        e.iter_mut().zip(x.iter().zip(self.h.reference)).for_each(|(e, (x, r))| *e = x - r);
        self.weigh(&e, &mut w);
        for (i, w) in w.iter_mut().enumerate() {
            *w *= 2.0;
            match (self.soft, held[Kind::State as usize].get(i)) {
                (None, Some(_)) => *w += multipliers[Kind::State as usize][i],
                (Some(soft), Some(side @ (1 | -1))) => {
                    *w += 2.0 * soft * (x[i] - if *side < 0 { self.low[i] } else { self.high[i] });
                }
                _ => {}
            }
        }
        let mut g = crate::memory::try_copy(WHAT, &multipliers[Kind::Input as usize])?;
        self.pull(&w, &mut g)?;
        self.pull_rows(multipliers, &mut g);
        self.add_of_inputs(u, 2.0, &mut g);
        Ok(g)
    }

    /// Exchanges limits; whether there was one to exchange.
    pub(super) fn exchange(&self, u: &[f64], x: &[f64], multipliers: &mut Multipliers, held: &mut Held) -> bool {
        let mut changed = false;
        for (kind, len) in self.kinds() {
            let soft = kind == Kind::State && self.soft.is_some();
            let found = &multipliers[kind as usize];
            let most = found.iter().enumerate().fold(0.0f64, |most, (i, v)| most.max(v.abs() * self.unit(kind, i)));
            for i in (0..len).filter(|&i| !self.fixed(kind, i)) {
                let ((low, high), value) = (self.limits(kind, i), self.value(kind, i, u, x));
                let rounding = ROUNDING * self.unit(kind, i).max(value.abs());
                let side = held[kind as usize][i];
                let broken = i8::from(value > high + rounding) - i8::from(value < low - rounding);
                let now = if soft || side == 0 {
                    broken
                } else if multipliers[kind as usize][i] * f64::from(side) * self.unit(kind, i) < -ROUNDING * most {
                    0
                } else {
                    side
                };
                if now == 0 {
                    multipliers[kind as usize][i] = 0.0;
                }
                changed |= now != side;
                held[kind as usize][i] = now;
            }
        }
        changed
    }
}

impl Search<'_, '_> {
    pub(super) fn polish(
        &mut self,
        (mut u, mut x): (Vec<f64>, Vec<f64>),
        mut multipliers: Multipliers,
        mut held: Held,
        until: Until<'_>,
    ) -> Result<Option<Status>> {
        let task = self.task;
        for (kind, len) in task.kinds() {
            (0..len).filter(|&i| held[kind as usize][i] == 0).for_each(|i| multipliers[kind as usize][i] = 0.0);
        }
        let mut waits = 0;
        for _ in 0..ROUNDS {
            if let Some(early) = until.reached() {
                return Ok(Some(early));
            }
            let face = if task.grows {
                let found = self.unrolled((&u, &x), &multipliers, &held, until)?;
                task.face(&held, (&u, &x), &doubled(found.left), (&doubled(found.costate), &found.dynamics))?
            } else {
                task.roll(&u, &mut x);
                task.face(&held, (&u, &x), &task.residual(&u, &x, &multipliers, &held)?, (&[], &[]))?
            };
            let Some((program, rows, unit)) = face else { break };
            let point = program.solve(until)?;
            self.iterations += point.iterations;
            if point.timed_out {
                return Ok(Some(Status::Limit));
            }
            if point.z.iter().chain(&point.multipliers).any(|v| !v.is_finite()) {
                break;
            }
            let of_inputs = u.iter_mut().zip(&point.z).enumerate();
            of_inputs.for_each(|(i, (u, z))| *u += unit * task.unit(Kind::Input, i) * z);
            let of_states = x.iter_mut().zip(&point.z[u.len()..]).enumerate();
            of_states.for_each(|(i, (x, z))| *x += unit * task.unit(Kind::State, i) * z);
            for (&(kind, i, _), z) in rows.iter().zip(&point.multipliers[task.steps * task.n..]) {
                multipliers[kind as usize][i] += unit * task.scale() / task.unit(kind, i) * z;
            }
            if !task.grows {
                task.roll(&u, &mut x);
            }
            let before = self.best.as_ref().map_or(f64::INFINITY, |best| best.merit);
            self.judge_signed((&u, &x), &multipliers, &held, until)?;
            let now = self.best.as_ref().map_or(f64::INFINITY, |best| best.merit);
            let changed = task.exchange(&u, &x, &mut multipliers, &mut held);
            waits = if now < 0.5 * before { 0 } else { waits + 1 };
            if !changed && now <= EXACT || waits >= PATIENCE {
                break;
            }
        }
        Ok(None)
    }

    /// What is left of the gradients with all multipliers, and of the steps, where the system grows.
    fn unrolled(
        &mut self,
        (u, x): (&[f64], &[f64]),
        multipliers: &Multipliers,
        held: &Held,
        until: Until<'_>,
    ) -> Result<Residuals> {
        let task = self.task;
        let mut states = try_zeros(WHAT, x.len())?;
        for (i, (to, side)) in states.iter_mut().zip(&held[Kind::State as usize]).enumerate() {
            *to = match (task.soft, side) {
                (None, _) => 0.5 * multipliers[Kind::State as usize][i],
                (Some(soft), 1 | -1) => soft * (x[i] - if *side < 0 { task.low[i] } else { task.high[i] }),
                _ => 0.0,
            };
        }
        let mut inputs = crate::memory::try_copy(WHAT, &multipliers[Kind::Input as usize])?;
        task.pull_rows(multipliers, &mut inputs);
        inputs.iter_mut().for_each(|v| *v *= 0.5);
        let pull = Pull { states: &states, inputs: &inputs, slack: 0.0, soft: task.soft };
        self.q.residuals((u, x), &held[Kind::Input as usize], &pull, |_, _| false, until)
    }

    /// Judges `u` without multipliers of the wrong sign.
    pub(super) fn judge_signed(
        &mut self,
        plan: (&[f64], &[f64]),
        multipliers: &Multipliers,
        held: &Held,
        until: Until<'_>,
    ) -> Result<()> {
        let task = self.task;
        let mut signed = task.zeros()?;
        for (kind, len) in task.kinds().into_iter().skip(1) {
            for i in 0..len {
                let v = multipliers[kind as usize][i];
                signed[kind as usize][i] =
                    if task.fixed(kind, i) || v * f64::from(held[kind as usize][i]) > 0.0 { v } else { 0.0 };
            }
        }
        self.verify(plan, &signed, Method::Refinement, until)
    }
}
