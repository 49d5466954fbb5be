//! Semismooth Newton in the space of the entries: many realizations per dimension.
//!
//! One inner problem, a proximal step with centre `c` and parameter `mu` on the simplex `D`:
//!
//! ```text
//! min_{w in D}  1/(2 mu) ||S w - q||^2 + 1/2 ||w - c||^2,      dual: z = (q - S w) / mu,   w = P_D(c + S^T z),
//! F(z) = q - S P_D(c + S^T z) - mu z = 0,                      -F is the gradient of the convex function
//! phi(z) = <z, S w> - 1/2 ||w - c||^2 - <q, z> + mu/2 ||z||^2.
//! ```
//!
//! The generalised Jacobian of `F` is `-(S_J (I - 11^T/K) S_J^T + mu I)`, `J` the support of `w`: a system in `d`
//! unknowns for any `N` (`newton_system`). The outer methods that choose `c` and `mu` are in `proximal`.

use super::budget::Budget;
use super::newton_system::{Memory, NewtonSystem};
use super::operator::Operator;
use super::problem::SEARCH;
use super::task::Task;
use super::task::{Iterate, Work};
use super::threshold::{normalise, threshold};
use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_filled, try_zeros};
use crate::vector::{dot, min, norm};

/// The problem and its scales, shared by both methods.
pub(crate) struct Setting<'a> {
    pub op: &'a dyn Operator,
    pub q: &'a [f64],
    /// Absolute tolerance on the gap.
    pub tol: f64,
    /// Dimension the realizations span.
    pub dimension: usize,
    /// Mean of `||E_i||^2`.
    pub gamma: f64,
}

impl Setting<'_> {
    /// Upper bound on `max ||E_i - q||`, the factor from `||F||` to the gap.
    pub fn reach(&self) -> f64 {
        self.gamma.sqrt() + norm(self.q)
    }

    /// `||F||` below this adds at most a fifth of the tolerance to the gap.
    pub fn residual_goal(&self) -> f64 {
        0.2 * self.tol / (2.0 * self.reach())
    }

    /// Typical eigenvalue of `S S^T`.
    pub fn scale(&self) -> f64 {
        self.gamma * self.op.size() as f64 / self.dimension as f64
    }
}

impl<'a> Setting<'a> {
    pub fn of(task: &Task<'a>) -> Self {
        let gamma = task.gamma.max(f64::MIN_POSITIVE);
        Self { op: task.op, q: &task.relaxed.q, tol: task.tol, dimension: task.relaxed.dimension, gamma }
    }
}

/// The gap of `w` on the simplex, and `<r, E_i>` for all `i`, in plain arithmetic.
pub(crate) fn gap_and_values(set: &Setting, w: &[f64], budget: &mut Budget) -> Result<(f64, Vec<f64>)> {
    let n = set.op.size();
    let mut image = try_zeros(SEARCH, set.op.dim())?;
    set.op.apply(w, &mut image)?;
    // gap = 2 (<r, S w> - min_i <r, E_i>)
    let r: Vec<f64> = try_collect(SEARCH, image.iter().zip(set.q).map(|(x, q)| x - q))?;
    let mut values = try_zeros(SEARCH, n)?;
    set.op.apply_transpose(&r, &mut values)?;
    budget.charge(2, n, set.op.entries());
    Ok((2.0 * (dot(&r, &image) - min(&values)), values))
}

/// Normalises `w`, and computes its gap from the data.
pub(crate) fn measure(set: &Setting, mut w: Vec<f64>, budget: &mut Budget) -> Result<Iterate> {
    if !normalise(&mut w) {
        return Ok(Iterate { weights: try_filled(SEARCH, 1.0 / w.len() as f64, w.len())?, gap: f64::INFINITY });
    }
    let (gap, _) = gap_and_values(set, &w, budget)?;
    Ok(Iterate { weights: w, gap })
}

/// The dual point and the quantities that depend on it.
pub(crate) struct Point {
    pub z: Vec<f64>,
    /// `S^T z`
    pull: Vec<f64>,
    pub w: Vec<f64>,
    /// `S w`
    pub image: Vec<f64>,
    /// `F = q - S w - mu z`
    pub force: Vec<f64>,
    phi: f64,
    pub support: usize,
}

impl Point {
    pub fn origin(n: usize, d: usize) -> Result<Self> {
        let (z, image, force) = (try_zeros(SEARCH, d)?, try_zeros(SEARCH, d)?, try_zeros(SEARCH, d)?);
        let (pull, w) = (try_zeros(SEARCH, n)?, try_zeros(SEARCH, n)?);
        Ok(Self { z, pull, w, image, force, phi: f64::INFINITY, support: n })
    }

    fn copy(&self) -> Result<Self> {
        let [z, pull, w] = [try_copy(SEARCH, &self.z)?, try_copy(SEARCH, &self.pull)?, try_copy(SEARCH, &self.w)?];
        Ok(Self { z, pull, w, image: try_copy(SEARCH, &self.image)?, force: try_copy(SEARCH, &self.force)?, ..*self })
    }
}

/// How one inner solve ended.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ended {
    Converged,
    /// The support is smaller than the dimension: `S w = q` has no solution.
    Infeasible,
    Stuck,
    Limit,
}

/// Limits of one inner solve.
pub(crate) struct Rules<'r> {
    pub stop: &'r dyn Fn(&Point) -> f64,
    pub newton: usize,
    pub cg: usize,
    /// Give up when the support falls below this.
    pub least_support: usize,
}

/// A proximal step in progress.
pub(crate) struct Inner<'a, 'b> {
    pub set: &'a Setting<'a>,
    pub center: &'b [f64],
    pub mu: f64,
    pub memory: &'b mut Memory,
    /// Scratch space of one number per realization.
    pub scratch: Vec<f64>,
}

impl Inner<'_, '_> {
    /// Updates the rest of `point` from its `z` and `pull`.
    fn evaluate(&mut self, point: &mut Point, budget: &mut Budget) -> Result<()> {
        let op = self.set.op;
        for ((w, c), a) in point.w.iter_mut().zip(self.center).zip(&point.pull) {
            *w = c + a;
        }
        // w = max(u - theta, 0), with ||w - c||^2
        let theta = threshold(&point.w, &mut self.scratch);
        let (mut moved, mut support) = (0.0, 0);
        for (w, c) in point.w.iter_mut().zip(self.center) {
            *w = if *w > theta { *w - theta } else { 0.0 };
            support += usize::from(*w > 0.0);
            moved += (*w - c) * (*w - c);
        }
        op.apply(&point.w, &mut point.image)?;
        budget.charge(1, support, op.entries());
        let (mut zx, mut zq, mut zz) = (0.0, 0.0, 0.0);
        for (((f, x), q), z) in point.force.iter_mut().zip(&point.image).zip(self.set.q).zip(&point.z) {
            *f = q - x - self.mu * z;
            zx += z * x;
            zq += z * q;
            zz += z * z;
        }
        point.phi = zx - 0.5 * moved - zq + 0.5 * self.mu * zz;
        point.support = support;
        Ok(())
    }

    pub fn run(&mut self, point: &mut Point, rules: &Rules, budget: &mut Budget, work: &mut Work) -> Result<Ended> {
        let op = self.set.op;
        op.apply_transpose(&point.z, &mut point.pull)?;
        budget.charge(1, op.size(), op.entries());
        self.evaluate(point, budget)?;
        let mut trial = point.copy()?;
        let mut short = 0;
        for _ in 0..rules.newton {
            let (force, goal) = (norm(&point.force), (rules.stop)(point));
            if force <= goal {
                return Ok(Ended::Converged);
            }
            if budget.exhausted() {
                return Ok(Ended::Limit);
            }
            if point.support < rules.least_support {
                return Ok(Ended::Infeasible);
            }
            let support: Vec<usize> = try_collect(SEARCH, (0..op.size()).filter(|&i| point.w[i] > 0.0))?;
            let sub = op.subset(&support)?;
            // ||residual|| <= min(0.1, ||F|| / ||r||) ||F||, not below 0.3 of what is asked for
            let r = point.image.iter().zip(self.set.q).map(|(x, q)| (x - q) * (x - q)).sum::<f64>().sqrt();
            let accuracy = (force * (force / r.max(f64::MIN_POSITIVE)).min(0.1)).max(0.3 * goal);
            let system = NewtonSystem::new(&*sub, self.mu)?;
            let dz = system.solve(&point.force, accuracy, rules.cg, self.memory, budget, work)?;
            work.newton += 1;
            let mut push = try_zeros(SEARCH, op.size())?;
            op.apply_transpose(&dz, &mut push)?;
            budget.charge(1, op.size(), op.entries());

            // Slope of phi along dz: -<F, dz>. A step that does not pass the minimum on the ray (slope still <= 0) is
            // certain to decrease the convex phi, even if rounding hides the difference of two large values of phi.
            // Otherwise Armijo's rule, if rounding is small enough for it.
            let slope = dot(&point.force, &dz);
            let (mut short_of, mut beyond, mut length) = (0.0, f64::INFINITY, 1.0);
            for _ in 0..30 {
                for ((t, z), d) in trial.z.iter_mut().zip(&point.z).zip(&dz) {
                    *t = z + length * d;
                }
                for ((t, a), p) in trial.pull.iter_mut().zip(&point.pull).zip(&push) {
                    *t = a + length * p;
                }
                self.evaluate(&mut trial, budget)?;
                let remaining = dot(&trial.force, &dz);
                let armijo = trial.phi <= point.phi - 1e-4 * length * slope - 1e-13 * point.phi.abs();
                if budget.exhausted()
                    || remaining >= 0.0 && (remaining <= 0.9 * slope || length == 1.0)
                    || armijo
                    || norm(&trial.force) <= 0.5 * force
                {
                    break;
                }
                if remaining >= 0.0 {
                    short_of = length;
                } else {
                    beyond = length;
                }
                length = if short_of > 0.0 { 0.5 * (short_of + beyond) } else { 0.3 * beyond };
            }
            std::mem::swap(point, &mut trial);
            short = if length < 0.2 { short + 1 } else { 0 };
            if short >= 3 && rules.least_support > 0 {
                return Ok(Ended::Stuck);
            }
        }
        Ok(Ended::Stuck)
    }
}

/// `||x - y||`
pub(crate) fn distance(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}
