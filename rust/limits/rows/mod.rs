//! Many steps with limits on inputs, on their changes and on states: a sparse interior point proposes, one linear system
//! for the active limits corrects, and the certificate is computed from the data. In a loop the active limits of the call
//! before propose, and the interior point is asked where they do not lead to a control that is certified.
//!
//! For any `u` within all limits, multipliers `l >= 0` of its rows `C u <= c`, `e = J'(u) + C' l` and `s = l' (c - C u)`:
//! `J(u) - min J <= s + ||e||^2_{H^-1} / 4` and `||u - u*||_H <= (||e||_{H^-1} + (||e||^2_{H^-1} + 8 s)^(1/2)) / 4`.
//! Proof: `J(v) + l' (C v - c) = J(u) - s + <e, v - u> + ||v - u||_H^2` for all `v`. Limits on states hold to rounding only;
//! the certificate is then for limits that are wider by this rounding. With soft limits `J'` has their weight and `H` has not.

mod assembly;
mod follow;
mod missing;
mod polish;
mod program;
mod task;

#[cfg(test)]
mod tests;

pub use task::Rows;

use assembly::{Aim, FAR, Kind, Multipliers, Row};
use follow::GOOD;
use program::Program;
use task::{Task, WHAT};

use super::bounds::Bounds;
use super::certificate::{Certificate, frank_wolfe};
use super::quadratic::{Method, Quadratic, Status, Until};
use super::riccati::{Horizon, Riccati};
use super::search;
use super::solve::{Solution, checked_warm, or_ended, told};
use crate::error::{Error, Result};
use crate::memory::{try_copy, try_filled, try_zeros};

/// Excess of a limit on states, relative to the size of the states, up to which the limit is kept.
const KEPT: f64 = 1e-9;
/// Limits on states that cannot be met are widened by what is missing, and this share of it, so that there is room.
const ROOM: f64 = 1e-7;
/// Distance of an input from a limit, relative to the size of inputs, up to which the limit is reached.
const REACHED: f64 = 1e-12;
/// Gaps relative to `J` below which another control is as good.
const EXACT: f64 = 1e-14;

/// A control, and what it says about limits that are not of single inputs.
#[derive(Debug, Clone)]
pub struct RowsSolution {
    /// The control, and its certificate; of limits that cannot be met: with these wider by `missing`.
    pub found: Solution,
    /// Multipliers (K m) of `u(k) - u(k-1)`: above 0 at `rate`, below at `-rate`. Empty without rates.
    pub rates: Vec<f64>,
    /// Multipliers (K, n) of the states: above 0 at the upper limit, below at the lower. Empty without limits on states.
    pub states: Vec<f64>,
    /// The least largest excess of limits on states that cannot be met; 0 if they can.
    pub missing: f64,
    /// The largest excess of a limit on states by the control.
    pub excess: f64,
}

/// A control within its limits and rates, judged.
struct Found {
    u: Vec<f64>,
    /// Half the gradient, with the multipliers of the rows.
    g: Vec<f64>,
    rows: Multipliers,
    certificate: Certificate,
    scale: f64,
    excess: f64,
    /// The larger of the gap and the excess, both relative.
    merit: f64,
    method: Method,
}

struct Search<'a, 'b> {
    task: &'a Task<'b>,
    q: &'a mut Riccati,
    /// Inputs with one value only.
    fixed: Vec<i8>,
    regular: Option<bool>,
    best: Option<Found>,
    iterations: usize,
}

impl<'a, 'b> Search<'a, 'b> {
    fn new(task: &'a Task<'b>, q: &'a mut Riccati) -> Result<Self> {
        let mut fixed = try_filled(WHAT, 0, task.steps * task.m)?;
        fixed.iter_mut().enumerate().for_each(|(i, to)| *to = i8::from(task.bounds().fixed(i)));
        Ok(Self { task, q, fixed, regular: None, best: None, iterations: 0 })
    }

    /// Takes `u`, clipped, and the signs that its multipliers must have; keeps it if it is the best so far.
    fn judge(&mut self, u: &[f64], rows: &Multipliers, method: Method, until: Until<'_>) -> Result<()> {
        let task = self.task;
        if u.iter().chain(&rows.rates).chain(&rows.states).any(|v| !v.is_finite()) {
            return Ok(());
        }
        let d = u.len();
        let (mut u, mut g, mut x) = (try_copy(WHAT, u)?, try_zeros(WHAT, d)?, try_zeros(WHAT, task.steps * task.n)?);
        task.clip(&mut u);
        task.roll(&u, &mut x);
        let mut objective = self.q.slope(&u, &mut g);
        let (mut rows, mut slack) = (
            Multipliers {
                inputs: Vec::new(),
                rates: try_copy(WHAT, &rows.rates)?,
                states: try_copy(WHAT, &rows.states)?,
            },
            0.0,
        );
        for (kind, len) in task.kinds().into_iter().skip(1) {
            for i in 0..len {
                let (low, high) = task.limits(kind, i);
                let (value, multiplier) = (task.value(kind, i, &u, &x), &mut rows.of(kind)[i]);
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
        if !task.low.is_empty() {
            task.pull(&rows.states, &mut pulled)?;
        }
        task.pull_changes(&rows.rates, &mut pulled);
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

    /// Proposes and corrects, until there is nothing to gain.
    fn run(&mut self, until: Until<'_>) -> Result<Option<Status>> {
        if let Some(early) = until.reached() {
            return Ok(Some(early));
        }
        let mut count = usize::MAX;
        for far in FAR {
            if self.best.as_ref().is_some_and(|best| best.merit <= GOOD) {
                break;
            }
            let (program, rows) = self.task.whole(Aim::Best, far)?;
            if count == rows.len() {
                break;
            }
            count = rows.len();
            if let Some(early) = self.propose(program, &rows, until)? {
                return Ok(Some(early));
            }
        }
        Ok(None)
    }

    fn propose(&mut self, program: Program, rows: &[Row], until: Until<'_>) -> Result<Option<Status>> {
        let point = program.solve(until)?;
        self.iterations += point.iterations;
        let (u, multipliers, held) = self.task.read(&point, rows, Aim::Best)?;
        self.judge(&u, &multipliers, Method::Interior, until)?;
        if point.timed_out {
            return Ok(Some(Status::Limit));
        }
        if u.iter().chain(&multipliers.inputs).any(|v| !v.is_finite()) {
            return Ok(None);
        }
        self.polish(u, multipliers, held, until)
    }

    /// The same, with a stop as a status. A solver that fails leaves what there is.
    fn try_run(&mut self, until: Until<'_>) -> Result<Option<Status>> {
        match self.run(until) {
            Err(Error::Numerical(_)) => Ok(None),
            other => or_ended(other, until),
        }
    }
}

/// The best inputs of a horizon within `bounds` (K m), step by step, and within `rows`. `warm`: signs of the limits that are
/// probably reached, of inputs, then of rates and of states where there are such limits.
///
/// # Errors
/// As [`super::horizon_control`], and [`Error::Value`] for `rate`, `previous`, `state_low` and `soft`.
pub fn rows_control(
    horizon: &Horizon<'_>,
    bounds: Bounds<'_>,
    rows: Rows<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
) -> Result<RowsSolution> {
    let mut q = Riccati::new(horizon)?;
    let task = Task::new(*horizon, bounds, rows)?;
    let none = Multipliers::zeros(&task)?;
    let mut search = Search::new(&task, &mut q)?;
    let mut early = None;
    if let Some(warm) = warm {
        checked_warm(Some(warm), task.kinds().iter().map(|(_, len)| len).sum())?;
        let mut held = task.held(warm)?;
        early = or_ended(search.follow(&mut held, until), until)?;
    }
    if search.best.as_ref().is_none_or(|best| best.merit > GOOD) {
        search.judge(&none.inputs, &none, Method::Interior, until)?;
        if early.is_none() {
            early = search.try_run(until)?;
        }
    }
    let mut missing = 0.0;
    let unmet = early.is_none()
        && task.hard()
        && search.best.as_ref().is_some_and(|best| best.excess > 0.0 && best.merit > KEPT);
    let mut widened = None;
    if unmet {
        match search.least(until) {
            Ok((u, amount, sure)) => {
                search.judge(&u, &none, Method::Interior, until)?;
                if sure && amount > 0.0 {
                    missing = amount;
                    widened = Some((task.widened(amount * (1.0 + ROOM))?, u));
                }
            }
            Err(Error::Interrupted) => early = Some(until.ended()),
            Err(Error::Numerical(_)) => {}
            Err(other) => return Err(other),
        }
    }
    let Search { mut best, mut iterations, .. } = search;
    if let Some((wider, u)) = &widened {
        let mut search = Search::new(wider, &mut q)?;
        search.judge(u, &none, Method::Interior, until)?;
        early = search.try_run(until)?;
        iterations += search.iterations;
        best = search.best;
    }
    let Some(best) = best else {
        return Err(Error::Overflow { what: "the cost of a control within its limits" });
    };
    let mut x = try_zeros(WHAT, task.steps * task.n)?;
    task.roll(&best.u, &mut x);
    let excess = if task.hard() { task.excess(&x).0 } else { 0.0 };
    let zero = q.zero + task.penalty_at_zero(&mut x)?;
    let mut all = search::Search::new(0)?;
    (all.u, all.g, all.factorizations, all.method) = (best.u, best.g, iterations, best.method);
    let mut found = told(&all, bounds, (early, best.certificate), (zero, best.scale))?;
    if widened.is_some() {
        found.status = early.unwrap_or(Status::Infeasible);
    }
    Ok(RowsSolution { found, rates: best.rows.rates, states: best.rows.states, missing, excess })
}
