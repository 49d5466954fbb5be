//! Horizons over which the system grows: states, inputs and costates are kept together, and what rounding leaves in
//! each step is carried on by a feedback, not by powers of `A`.
//!
//! For states `x`, inputs `u` within their limits and any costates `p` let `d(k) = A x(k-1) + B u(k-1) - x(k)`,
//! `g(k) = R u(k) + B' p(k+1)` and `e(k) = Q (x(k) - r(k)) + A' p(k+1) - p(k)`. For other inputs `u + v`, whose states
//! are `x + y` with `y(k) = A y(k-1) + B v(k-1) + d(k)`,
//! `J(u + v) = J + 2 p'd + 2 g'v + 2 e'y + ||y||_Q^2 + ||v||_R^2`, exactly. The least over all `v` of what follows
//! `2 p'd`, without the part of `g` that limits balance, is a problem without limits: one recursion bounds it from
//! below. For the inputs `u + clip(-L y)` of who follows the plan it is the sum itself. The difference of the two is
//! the gap.

use super::{Gains, Riccati, Steps, WHAT};
use crate::compensated::Sum;
use crate::error::Result;
use crate::limits::bounds::Bounds;
use crate::limits::certificate::{Certificate, status};
use crate::limits::kernel::solved;
use crate::limits::quadratic::{Method, Quadratic, Status, Until};
use crate::limits::solve::{Solution, checked_rows, checked_warm, or_ended};
use crate::memory::{try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;

/// Most exchanges of limits, and exchanges without fewer violations after which they end.
const PIVOTS: usize = 40;
const PATIENCE: usize = 6;
/// Rounding of an input and of a slope, relative to the largest.
const ROUNDING: f64 = 1e-13;
/// Share of the largest value of a state by which it may be off where inputs alone are said to lead there.
const OPEN: f64 = 1e-7;
/// Share of the terms of the gap that their own rounding can be.
const SURE: f64 = 1e-6;

/// What it takes to follow a plan.
#[derive(Debug, Clone)]
pub struct Followed {
    /// `x(1) .. x(K)` (K, n) under the plan that is followed.
    pub states: Vec<f64>,
    /// `-L` (K, m, n): the inputs are `u(k) - L(k) (x - x(k))` within their limits.
    pub feedback: Vec<f64>,
    /// Steps over which the inputs alone lead to these states.
    pub open_until: usize,
    /// `J` of the inputs alone; infinite where it overflows.
    pub open_objective: f64,
}

/// What rows of limits add: half of their multipliers, for states and for inputs; their slack; the weight of soft ones.
pub(crate) struct Pull<'a> {
    pub(crate) states: &'a [f64],
    pub(crate) inputs: &'a [f64],
    pub(crate) slack: f64,
    pub(crate) soft: Option<f64>,
}

impl Pull<'_> {
    pub(crate) const NONE: Self = Pull { states: &[], inputs: &[], slack: 0.0, soft: None };

    fn state(&self, i: usize) -> f64 {
        self.states.get(i).copied().unwrap_or(0.0)
    }

    fn input(&self, i: usize) -> f64 {
        self.inputs.get(i).copied().unwrap_or(0.0)
    }
}

/// Half gradients of the inputs and what is left of them, and `e` and `d` of the head of this file.
pub(crate) struct Residuals {
    pub(crate) g: Vec<f64>,
    pub(crate) left: Vec<f64>,
    pub(crate) costate: Vec<f64>,
    pub(crate) dynamics: Vec<f64>,
}

/// A plan that is followed, judged.
pub(crate) struct Judged {
    pub(crate) certificate: Certificate,
    pub(crate) g: Vec<f64>,
    /// What `J` is before anything cancels.
    pub(crate) size: f64,
    pub(crate) open_until: usize,
    pub(crate) open_objective: f64,
}

impl Riccati {
    /// The recursion of all inputs that are not fixed.
    pub(crate) fn free(&mut self, fixed: &[i8], until: Until<'_>) -> Result<bool> {
        if !self.whole {
            let zeros = try_zeros(WHAT, fixed.len())?;
            self.whole = self.barrier(fixed, &zeros, until)?;
        }
        Ok(self.whole)
    }

    /// Inputs and states that agree to rounding: `u - L (x' - x)`, clipped, and the states `x'` that follow.
    pub(crate) fn follow(&self, u: &mut [f64], x: &mut [f64], clip: impl Fn(&[f64], usize) -> f64) -> Result<()> {
        let (n, m) = (self.n, self.m);
        let (mut off, mut last, mut next) = (try_zeros(WHAT, n)?, try_copy(WHAT, &self.x0[..n])?, try_zeros(WHAT, n)?);
        for t in 0..self.steps {
            for j in 0..m {
                u[t * m + j] -= self.gain_of(&self.other, t, j, &off);
                u[t * m + j] = clip(u, t * m + j);
            }
            self.step(&last, &u[t * m..(t + 1) * m], &mut next);
            let x = &mut x[t * n..(t + 1) * n];
            off.iter_mut().zip(next.iter().zip(&*x)).for_each(|(off, (now, x))| *off = now - x);
            x.copy_from_slice(&next);
            std::mem::swap(&mut last, &mut next);
        }
        Ok(())
    }

    /// `L_j v` of step `t`.
    fn gain_of(&self, gains: &Gains, t: usize, j: usize, v: &[f64]) -> f64 {
        let line = &gains.gain[(t * self.m + j) * self.ln..][..self.n];
        line.iter().zip(v).map(|(l, v)| l * v).sum()
    }

    /// `A x + B u`
    fn step(&self, x: &[f64], u: &[f64], to: &mut [f64]) {
        for (i, to) in to.iter_mut().enumerate() {
            let of_state: f64 = self.a.line(i).iter().zip(x).map(|(a, x)| a * x).sum();
            *to = of_state + self.b.line(i).iter().zip(u).map(|(b, u)| b * u).sum::<f64>();
        }
    }

    /// The residuals at `u`, `x` with costates that run back with the feedback of the inputs that are not `held`, where
    /// `balanced` says which gradients limits balance: `p(k) = Q (x(k) - r(k)) + A' p(k+1) - L' g(k)`.
    pub(crate) fn residuals(
        &mut self,
        (u, x): (&[f64], &[f64]),
        held: &[i8],
        pull: &Pull<'_>,
        balanced: impl Fn(usize, f64) -> bool,
        until: Until<'_>,
    ) -> Result<Residuals> {
        let (n, m, steps) = (self.n, self.m, self.steps);
        if self.face.held != held || self.stale {
            let mut gains = std::mem::take(&mut self.face);
            let positive = self.recursion(&mut gains, held, None, until);
            self.face = gains;
            self.stale = !matches!(positive, Ok(true));
            positive?;
        }
        // where the face has no gains of its own, those of all inputs will do
        let gains = if self.stale { &self.other } else { &self.face };
        let (zeros, inputs) = (|| try_zeros(WHAT, steps * n), || try_zeros(WHAT, steps * m));
        let mut found = Residuals { g: inputs()?, left: inputs()?, costate: zeros()?, dynamics: zeros()? };
        let (mut p, mut before) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        for t in (0..steps).rev() {
            let at = t * n..(t + 1) * n;
            let (now, reference, q) = (&x[at.clone()], self.reference.line(t), &self.q[usize::from(t + 1 == steps)]);
            // A' p(k+1) - L' g(k) into `before`, then the whole in twice the precision
            for (i, to) in before.iter_mut().enumerate() {
                let mut sum = Sum::default();
                for (k, q) in q.line(i)[..n].iter().enumerate().filter(|(_, q)| **q != 0.0) {
                    sum.add_product(*q, now[k]);
                    sum.add_product(-q, reference[k]);
                }
                sum.add(pull.state(t * n + i));
                if t + 1 < steps {
                    (0..n).for_each(|k| sum.add_product(self.a.line(k)[i], p[k]));
                }
                let whole = sum;
                if t + 1 < steps {
                    for j in 0..m {
                        sum.add(-gains.gain[((t + 1) * m + j) * self.ln + i] * found.left[(t + 1) * m + j]);
                    }
                }
                *to = sum.value();
                let mut rest = whole;
                rest.add(-*to);
                found.costate[t * n + i] = rest.value();
            }
            std::mem::swap(&mut p, &mut before);
            for j in 0..m {
                let mut sum = Sum::default();
                (0..m).for_each(|k| sum.add_product(self.r.line(j)[k], u[t * m + k]));
                (0..n).for_each(|k| sum.add_product(self.b.line(k)[j], p[k]));
                sum.add(pull.input(t * m + j));
                let g = sum.value();
                found.g[t * m + j] = g;
                found.left[t * m + j] = if balanced(t * m + j, g) { 0.0 } else { g };
            }
            let last = if t == 0 { &self.x0[..n] } else { &x[(t - 1) * n..t * n] };
            for (i, x) in now.iter().enumerate() {
                let mut sum = Sum::default();
                (0..n).for_each(|k| sum.add_product(self.a.line(i)[k], last[k]));
                (0..m).for_each(|k| sum.add_product(self.b.line(i)[k], u[t * m + k]));
                sum.add(-x);
                found.dynamics[t * n + i] = sum.value();
            }
        }
        Ok(found)
    }

    /// `J` of states and inputs that belong together.
    fn cost(&self, u: &[f64], x: &[f64], moved: bool) -> f64 {
        let (n, m) = (self.n, self.m);
        let mut sum = 0.0;
        for t in 0..self.steps {
            let (x, reference, u) = (&x[t * n..(t + 1) * n], self.reference.line(t), &u[t * m..(t + 1) * m]);
            let off = |i: usize| if moved { x[i] } else { x[i] - reference[i] };
            let q = &self.q[usize::from(t + 1 == self.steps)];
            for i in 0..n {
                sum += off(i) * q.line(i)[..n].iter().enumerate().map(|(k, q)| q * off(k)).sum::<f64>();
            }
            for j in 0..m {
                sum += u[j] * self.r.line(j).iter().zip(u).map(|(r, u)| r * u).sum::<f64>();
            }
        }
        sum
    }

    /// The largest that `-2 g'v - 2 e'y - ||y||_Q^2 - ||v||_R^2` can be without limits, by the recursion of the value
    /// `y'P y + 2 s'y` and of its constant.
    fn least(&self, found: &Residuals) -> Result<f64> {
        let (n, m, ln, lm, gains) = (self.n, self.m, self.ln, self.lm, &self.other);
        let (mut s, mut pushed) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        let (mut h, mut solution) = (try_zeros(WHAT, lm)?, try_zeros(WHAT, lm)?);
        let (mut sum, mut size) = (0.0f64, 0.0f64);
        for t in (0..self.steps).rev() {
            let d = &found.dynamics[t * n..(t + 1) * n];
            s.iter_mut().zip(&found.costate[t * n..]).for_each(|(s, e)| *s += e);
            let p = &gains.p[t * n * ln..(t + 1) * n * ln];
            for (i, pushed) in pushed.iter_mut().enumerate() {
                let of_p: f64 = p[i * ln..i * ln + n].iter().zip(d).map(|(p, d)| p * d).sum();
                // d'P d + 2 s'd
                let term: f64 = d[i] * (of_p + 2.0 * s[i]);
                (sum, size) = (sum - term, size + term.abs());
                *pushed = of_p + s[i];
            }
            for (j, h) in h.iter_mut().enumerate().take(m) {
                let held = gains.held[t * m + j] != 0;
                let of_b: f64 = pushed.iter().enumerate().map(|(i, v)| self.b.line(i)[j] * v).sum();
                *h = if held { 0.0 } else { of_b + found.left[t * m + j] };
            }
            solution.copy_from_slice(&h);
            let rows = t * m..(t + 1) * m;
            solved(&gains.lower[rows.start * lm..rows.end * lm], lm, &gains.inverse[rows], &mut solution);
            let gained: f64 = h.iter().zip(&solution).map(|(h, v)| h * v).sum();
            (sum, size) = (sum + gained, size + gained.abs());
            for (i, s) in s.iter_mut().enumerate() {
                let back: f64 = pushed.iter().enumerate().map(|(k, v)| self.a.line(k)[i] * v).sum();
                let fed: f64 = (0..m).map(|j| gains.gain[(t * m + j) * ln + i] * h[j]).sum();
                *s = back - fed;
            }
        }
        Ok(sum + SURE * size)
    }

    /// How far the plan `u`, `x` that is followed is from the best one. `near`: the distance from the limit that
    /// balances a gradient, none where there is none; `room`: how far an input can move, after the moves of those
    /// before.
    pub(crate) fn judge(
        &mut self,
        (u, x): (&[f64], &[f64]),
        held: &[i8],
        pull: &Pull<'_>,
        near: impl Fn(usize, f64) -> Option<f64>,
        room: impl Fn(usize, &[f64]) -> (f64, f64),
        until: Until<'_>,
    ) -> Result<Option<Judged>> {
        let (n, m, steps) = (self.n, self.m, self.steps);
        let found = self.residuals((u, x), held, pull, |i, g| near(i, g).is_some(), until)?;
        let mut slack = pull.slack;
        for (i, g) in found.g.iter().enumerate() {
            slack += near(i, *g).map_or(0.0, |off| 2.0 * g.abs() * off);
        }
        // who follows the plan, and who applies its inputs alone
        let (mut moves, mut off) = (try_zeros(WHAT, steps * m)?, try_zeros(WHAT, steps * n)?);
        let (none, mut open) = (try_zeros(WHAT, steps * m)?, try_zeros(WHAT, steps * n)?);
        let origin = try_zeros(WHAT, n)?;
        for t in 0..steps {
            let (before, after) = off.split_at_mut(t * n);
            let last = if t == 0 { &origin[..] } else { &before[(t - 1) * n..] };
            for j in 0..m {
                let (low, high) = room(t * m + j, &moves);
                moves[t * m + j] = (0.0 - self.gain_of(&self.other, t, j, last)).max(low.min(0.0)).min(high.max(0.0));
            }
            self.step(last, &moves[t * m..(t + 1) * m], &mut after[..n]);
            let (before, now) = open.split_at_mut(t * n);
            let last = if t == 0 { &origin[..] } else { &before[(t - 1) * n..] };
            self.step(last, &none[..m], &mut now[..n]);
            for i in 0..n {
                after[i] += found.dynamics[t * n + i];
                now[i] += found.dynamics[t * n + i];
            }
        }
        let followed = self.excess(&moves, &off, pull, &found);
        let alone = self.excess(&none, &open, pull, &found);
        let objective = self.cost(u, x, false);
        if !objective.is_finite() {
            return Ok(None);
        }
        let mut largest = try_copy(WHAT, &self.x0[..n])?;
        for row in x.chunks_exact(n) {
            largest.iter_mut().zip(row).for_each(|(most, x): (&mut f64, _)| *most = most.abs().max(x.abs()));
        }
        let leads = |row: &[f64]| row.iter().zip(&largest).all(|(off, most)| off.abs() <= OPEN * most.abs());
        let open_until = open.chunks_exact(n).take_while(|row| leads(row)).count();
        // inputs that need no feedback are applied alone
        let more = if open_until == steps { followed.0.max(alone.0) } else { followed.0 };
        let gap =
            more + slack + self.least(&found)? + SURE * (followed.1 + if open_until == steps { alone.1 } else { 0.0 });
        let gap = if gap.is_finite() { gap.max(0.0) } else { f64::INFINITY };
        let open_objective = if alone.0.is_finite() { objective + alone.0 } else { f64::INFINITY };
        let certificate = Certificate { objective, gap, frank_wolfe: gap, distance: gap.sqrt() };
        let size = self.references + self.cost(u, x, true);
        Ok(Some(Judged { certificate, g: found.g, size, open_until, open_objective }))
    }

    /// `J(u + v) - J - 2 p'd` for moves `v` and states that are off by `y`, and the size of its terms.
    fn excess(&self, v: &[f64], y: &[f64], pull: &Pull<'_>, found: &Residuals) -> (f64, f64) {
        let (mut sum, mut size) = (self.cost(v, y, true), 0.0);
        for (i, v) in v.iter().enumerate() {
            let term = 2.0 * (found.g[i] - pull.input(i)) * v;
            (sum, size) = (sum + term, size + term.abs());
        }
        for (i, y) in y.iter().enumerate() {
            let of_rows = if pull.soft.is_some() { 0.0 } else { pull.state(i) };
            let term = 2.0 * (found.costate[i] - of_rows) * y;
            let beyond = pull.soft.map_or(0.0, |soft| soft * y * y);
            (sum, size) = (sum + term + beyond, size + term.abs());
        }
        (sum, size)
    }

    /// What it takes to follow the plan with these states.
    pub(crate) fn followed(&self, states: Vec<f64>, open: (usize, f64)) -> Result<Followed> {
        let (n, ln) = (self.n, self.ln);
        let mut feedback = try_room(WHAT, self.steps * self.m * n)?;
        self.other.gain.chunks_exact(ln).for_each(|line| feedback.extend(line[..n].iter().map(|l| 0.0 - l)));
        Ok(Followed { states, feedback, open_until: open.0, open_objective: open.1 })
    }

    /// Exchanges limits on the faces that they leave; whether none was left to exchange.
    fn exchanged(
        &mut self,
        bounds: Bounds<'_>,
        (fixed, held): (&[i8], &mut [i8]),
        u: &mut [f64],
        count: &mut usize,
        until: Until<'_>,
    ) -> Result<Option<Status>> {
        let (m, mut least, mut waits) = (self.m, usize::MAX, 0);
        for _ in 0..PIVOTS {
            if let Some(early) = until.reached() {
                return Ok(Some(early));
            }
            for (i, u) in u.iter_mut().enumerate() {
                if let Some(limit) = bounds.at(i, held[i]) {
                    *u = if fixed[i] != 0 { bounds.clip(i, 0.0) } else { limit + 0.0 };
                }
            }
            *count += 1;
            self.stale = true;
            if !self.face(held, u, until)? {
                return Ok(None);
            }
            self.stale = false;
            let x = std::mem::take(&mut self.path);
            let found = self.residuals((u, &x), held, &Pull::NONE, |i, _| held[i] != 0, until);
            self.path = x;
            let found = found?;
            let mut sizes = try_filled(WHAT, (0.0f64, 0.0f64), m)?;
            for (i, (u, g)) in u.iter().zip(&found.g).enumerate() {
                let size = &mut sizes[i % m];
                size.0 = size.0.max(u.abs());
                size.1 = size.1.max(g.abs()).max(self.r.line(i % m)[i % m] * u.abs());
            }
            let mut wrong = 0;
            for i in (0..u.len()).filter(|&i| fixed[i] == 0) {
                let (near, flat) = (ROUNDING * sizes[i % m].0, ROUNDING * sizes[i % m].1);
                let now = match held[i] {
                    0 if u[i] < bounds.low[i] - near => -1,
                    0 if u[i] > bounds.high[i] + near => 1,
                    -1 if found.g[i] < -flat => 0,
                    1 if found.g[i] > flat => 0,
                    same => same,
                };
                wrong += usize::from(now != held[i]);
                held[i] = now;
            }
            if wrong == 0 {
                return Ok(None);
            }
            if wrong < least {
                (least, waits) = (wrong, 0);
            } else {
                waits += 1;
            }
            if waits >= PATIENCE {
                return Ok(None);
            }
        }
        Ok(None)
    }
}

/// The best inputs of a horizon over which the system grows, as [`super::horizon_control`], and how to follow them.
/// None where the weights leave an input without any: then nothing is known of how far they are from the best.
///
/// # Errors
/// As [`super::horizon_control`].
pub fn followed_control(
    horizon: &Steps<'_>,
    bounds: Bounds<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
) -> Result<Option<(Solution, Followed)>> {
    let mut q = Riccati::growing(horizon)?;
    let d = q.size();
    checked_rows("low", bounds.low.len(), 1, d)?;
    checked_warm(warm, d)?;
    let (mut fixed, mut held, mut u) = (try_filled(WHAT, 0, d)?, try_filled(WHAT, 0, d)?, try_zeros(WHAT, d)?);
    for i in 0..d {
        (fixed[i], u[i]) = (i8::from(bounds.fixed(i)), bounds.clip(i, 0.0));
    }
    match q.free(&fixed, until) {
        Ok(true) => {}
        _ => return Ok(None),
    }
    q.guess(bounds, &fixed, &mut u, until)?;
    for (i, held) in held.iter_mut().enumerate() {
        let warm = warm.map(|warm| if bounds.at(i, warm[i]).is_some_and(f64::is_finite) { warm[i] } else { 0 });
        *held = if fixed[i] != 0 { 1 } else { warm.unwrap_or_else(|| bounds.reached(i, u[i], 0.0)) };
    }
    let mut count = 0;
    let early = or_ended(q.exchanged(bounds, (&fixed, &mut held), &mut u, &mut count, until), until)?;
    // inputs within their limits, those that are held exactly there, and the states that follow
    let mut x = try_copy(WHAT, &q.path)?;
    q.follow(&mut u, &mut x, |u, i| match bounds.at(i, held[i]) {
        Some(limit) if fixed[i] == 0 => limit + 0.0,
        _ => bounds.clip(i, u[i]),
    })?;
    for (i, held) in held.iter_mut().enumerate() {
        *held = if fixed[i] != 0 { 1 } else { bounds.reached(i, u[i], 0.0) };
    }
    let near = |i: usize, g: f64| {
        let at = bounds.reached(i, u[i], g);
        (fixed[i] != 0 || at < 0 && g >= 0.0 || at > 0 && g <= 0.0).then_some(0.0)
    };
    let room = |i: usize, _: &[f64]| (bounds.low[i] - u[i], bounds.high[i] - u[i]);
    let Some(judged) = q.judge((&u, &x), &held, &Pull::NONE, near, room, Until::new(&Stop::new(), None))? else {
        return Ok(None);
    };
    let mut multipliers = try_zeros(WHAT, d)?;
    for (i, g) in judged.g.iter().enumerate() {
        held[i] = bounds.reached(i, u[i], *g);
        multipliers[i] = (-2.0 * f64::from(held[i]) * g).max(0.0) + 0.0;
    }
    let found = judged.certificate;
    let solution = Solution {
        control: u,
        active: held,
        multipliers,
        status: status(early, &found, judged.size),
        gap: found.gap,
        frank_wolfe: found.gap,
        distance: found.distance,
        objective: found.objective,
        at_zero: q.zero,
        iterations: count,
        method: Method::Pivoting,
    };
    let followed = q.followed(x, (judged.open_until, judged.open_objective))?;
    Ok(Some((solution, followed)))
}
