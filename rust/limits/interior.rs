//! Mehrotra's interior point between the limits: it cannot cycle, and every iterate is inside.
//!
//! With slacks `s`, multipliers `z >= 0` of the finite limits and half gradients `g = z_low - z_high` at the solution,
//! one step solves `(H + z_l/s_l + z_h/s_h) du = -g + (sigma mu - c_l)/s_l - (sigma mu - c_h)/s_h` twice: for
//! `sigma = c = 0`, then with the second-order terms `c` of this step (Nocedal and Wright 2006, 16.6).

use super::bounds::Bounds;
use super::quadratic::{Quadratic, Status, Until};
use crate::error::Result;
use crate::memory::try_zeros;

const WHAT: &str = "a control within limits";

/// Most factorizations.
pub(super) const MOST: usize = 25;
/// Share of the way to the next limit.
const SHORT: f64 = 0.995;

/// One side of the limits: slack, multiplier and its change; a slack of infinity where there is no limit.
#[derive(Debug, Default)]
struct Side {
    slack: Vec<f64>,
    z: Vec<f64>,
    dz: Vec<f64>,
    /// +1 for the lower side: the slack grows with `u`.
    sign: f64,
}

impl Side {
    fn new(d: usize, sign: f64) -> Result<Self> {
        Ok(Self { slack: try_zeros(WHAT, d)?, z: try_zeros(WHAT, d)?, dz: try_zeros(WHAT, d)?, sign })
    }

    fn there(&self, i: usize) -> bool {
        self.slack[i].is_finite()
    }

    /// `dz` of the step `du`, for the products `target - c`.
    fn change(&mut self, du: &[f64], target: f64, second_order: bool, affine: &[f64]) {
        for (i, du) in du.iter().enumerate() {
            if self.there(i) {
                let c = if second_order { self.sign * affine[i] * self.dz[i] } else { 0.0 };
                self.dz[i] = (target - c - self.z[i] * self.sign * du) / self.slack[i] - self.z[i];
            }
        }
    }

    /// The longest step that leaves slacks and multipliers at least 0.
    fn reach(&self, du: &[f64]) -> f64 {
        let mut longest = f64::INFINITY;
        for i in (0..du.len()).filter(|&i| self.there(i)) {
            let ds = self.sign * du[i];
            if ds < 0.0 {
                longest = longest.min(-self.slack[i] / ds);
            }
            if self.dz[i] < 0.0 {
                longest = longest.min(-self.z[i] / self.dz[i]);
            }
        }
        longest
    }

    /// `sum s z` after a step of length `t`.
    fn products(&self, du: &[f64], t: f64) -> f64 {
        let after = |i: usize| (self.slack[i] + t * self.sign * du[i]) * (self.z[i] + t * self.dz[i]);
        (0..du.len()).filter(|&i| self.there(i)).map(after).sum()
    }

    fn go(&mut self, du: &[f64], t: f64) {
        for (i, du) in du.iter().enumerate() {
            if self.there(i) {
                self.slack[i] += t * self.sign * du;
                self.z[i] += t * self.dz[i];
            }
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct Interior {
    sides: [Side; 2],
    diagonal: Vec<f64>,
    affine: Vec<f64>,
    step: Vec<f64>,
}

impl Interior {
    pub(super) fn new(d: usize) -> Result<Self> {
        let zeros = || try_zeros(WHAT, d);
        Ok(Self {
            sides: [Side::new(d, 1.0)?, Side::new(d, -1.0)?],
            diagonal: zeros()?,
            affine: zeros()?,
            step: zeros()?,
        })
    }

    /// Moves `u` to the solution as far as it goes, then names in `held` the limits that it has reached; inputs held
    /// before stay. Returns the number of factorizations, and why it ended early.
    pub(super) fn run(
        &mut self,
        q: &mut impl Quadratic,
        bounds: Bounds<'_>,
        (u, g, held): (&mut [f64], &mut [f64], &mut [i8]),
        until: Until<'_>,
    ) -> Result<(usize, Option<Status>)> {
        let d = q.size();
        if self.step.len() != d {
            *self = Self::new(d)?;
        }
        let objective = q.slope(u, g);
        // where there is one limit, as far inside as moves J by 1e-6 of its size
        let near = 1e-3 * (q.scale() + objective).sqrt();
        let count = self.start((bounds, near), u, (g, q.curvature()), held);
        let mut objective = if count > 0 { q.slope(u, g) } else { objective };
        for done in 0..MOST {
            if let Some(status) = until.reached() {
                return Ok((done, Some(status)));
            }
            if !self.factor(q, held, until)? {
                self.snap(q.curvature(), held);
                return Ok((done, None));
            }
            let products: f64 = self.sides.iter().map(|side| side.products(&self.step, 0.0)).sum();
            self.direction(q, g, 0.0, false);
            let reach = self.reach().min(1.0);
            let after: f64 = self.sides.iter().map(|side| side.products(&self.step, reach)).sum();
            if count > 0 {
                let mu = products / count as f64;
                let centring = (after / products).powi(3).clamp(0.0, 1.0);
                self.affine.copy_from_slice(&self.step);
                self.direction(q, g, centring * mu, true);
            }
            let t = (SHORT * self.reach()).min(1.0);
            for side in &mut self.sides {
                side.go(&self.step, t);
            }
            for (i, u) in u.iter_mut().enumerate().filter(|(i, _)| held[*i] == 0) {
                *u = bounds.clip(i, *u + t * self.step[i]);
            }
            objective = q.slope(u, g).min(objective);
            let left: f64 = self.sides.iter_mut().map(|side| side.products(&self.step, 0.0)).sum();
            if left <= 1e-16 * (q.scale() + objective) && t > 0.9 || t < 1e-10 || !left.is_finite() {
                self.snap(q.curvature(), held);
                return Ok((done + 1, None));
            }
        }
        self.snap(q.curvature(), held);
        Ok((MOST, None))
    }

    /// Slacks and multipliers for a start near `u`, which is moved inside; the number of finite limits.
    fn start(
        &mut self,
        (bounds, near): (Bounds<'_>, f64),
        u: &mut [f64],
        (g, curvature): (&[f64], &[f64]),
        held: &[i8],
    ) -> usize {
        let (mut count, d) = (0, u.len());
        let free = |i: &usize| held[*i] == 0;
        // in units of the inputs in which H has a diagonal of 1
        let total = (0..d).filter(free).map(|i| g[i].abs() / curvature[i].sqrt()).sum::<f64>();
        let size = total / (0..d).filter(free).count().max(1) as f64;
        self.step.fill(0.0);
        for i in 0..d {
            let width = bounds.high[i] - bounds.low[i];
            let [low, high] = &mut self.sides;
            low.slack[i] = f64::INFINITY;
            high.slack[i] = f64::INFINITY;
            if held[i] != 0 {
                continue;
            }
            let inside = (near / curvature[i].sqrt()).max(f64::MIN_POSITIVE);
            if width.is_finite() {
                // slacks of their own: near a limit u - low has lost its digits
                let part = ((u[i] - bounds.low[i]) / width).clamp(0.1, 0.9);
                (low.slack[i], high.slack[i]) = (part * width, (1.0 - part) * width);
                u[i] = bounds.clip(i, bounds.low[i] + low.slack[i]);
            } else if bounds.low[i].is_finite() {
                low.slack[i] = (u[i] - bounds.low[i]).max(inside);
                u[i] = bounds.low[i] + low.slack[i];
            } else if bounds.high[i].is_finite() {
                high.slack[i] = (bounds.high[i] - u[i]).max(inside);
                u[i] = bounds.high[i] - high.slack[i];
            }
            for side in [low, high] {
                if side.there(i) {
                    count += 1;
                    side.z[i] = (side.sign * g[i]).max(0.0) + 0.1 * size * curvature[i].sqrt() + f64::MIN_POSITIVE;
                }
            }
        }
        count
    }

    /// Factors `H + z/s`; where that is singular to rounding, with a little more.
    fn factor(&mut self, q: &mut impl Quadratic, held: &[i8], until: Until<'_>) -> Result<bool> {
        self.diagonal.fill(0.0);
        for side in &self.sides {
            for i in (0..held.len()).filter(|&i| side.there(i)) {
                self.diagonal[i] += side.z[i] / side.slack[i];
            }
        }
        for more in [0.0, 1e-14, 1e-11] {
            self.diagonal.iter_mut().zip(q.curvature()).for_each(|(v, h)| *v += more * h);
            if q.barrier(held, &self.diagonal, until)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The step towards products of `target`, with the second-order terms of the affine step.
    fn direction(&mut self, q: &mut impl Quadratic, g: &[f64], target: f64, second_order: bool) {
        self.step.iter_mut().zip(g).for_each(|(v, g)| *v = -g);
        for side in &self.sides {
            for i in (0..g.len()).filter(|&i| side.there(i)) {
                let c = if second_order { side.sign * self.affine[i] * side.dz[i] } else { 0.0 };
                self.step[i] += side.sign * (target - c) / side.slack[i];
            }
        }
        q.newton(&mut self.step);
        for side in &mut self.sides {
            side.change(&self.step, target, second_order, &self.affine);
        }
    }

    fn reach(&self) -> f64 {
        self.sides.iter().map(|side| side.reach(&self.step)).fold(f64::INFINITY, f64::min)
    }

    /// A limit is reached where its multiplier is larger than its slack, in the units of `g`.
    fn snap(&self, curvature: &[f64], held: &mut [i8]) {
        for (i, held) in held.iter_mut().enumerate() {
            for side in &self.sides {
                if side.there(i) && side.z[i] > curvature[i] * side.slack[i] {
                    *held = -(side.sign as i8);
                }
            }
        }
    }
}
