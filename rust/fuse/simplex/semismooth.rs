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
//! The generalised Jacobian of `F` is `-(S_J (I - 11^T/K) S_J^T + mu I)`, `J` the support of `w`: a system in `d` unknowns
//! whatever `N` is, solved by conjugate gradients with the count-block preconditioner. Two outer methods use it:
//!
//! * [`direct`]: `c = 1/N` and one tiny `mu`, when `S w = q` is (nearly) solvable and `N >= 1.25 d`;
//! * [`augmented`]: the proximal point method (SSNAL; Li, Sun, Toh, SIAM J. Optim. 28, 2018), `c` the last weights: the safety net.

use super::budget::Budget;
use super::factor::Factor;
use super::ladder::Task;
use super::newton_cg::{Iterate, Work};
use super::operator::{Operator, Precondition};
use super::threshold::{normalise, threshold};
use super::vector::{axpy, dot, min, norm};

/// The problem and its scales, shared by both methods.
pub(crate) struct Setting<'a, O: Operator> {
    pub op: &'a O,
    pub q: &'a [f64],
    /// Absolute tolerance on the gap.
    pub tol: f64,
    /// Dimension the realizations span.
    pub dimension: usize,
    /// Mean of `||E_i||^2`.
    pub gamma: f64,
}

impl<O: Operator> Setting<'_, O> {
    /// `max ||E_i - q||`, bounded: what turns `||F||` into a gap.
    fn reach(&self) -> f64 {
        self.gamma.sqrt() + norm(self.q)
    }

    /// `||F||` below this adds at most a fifth of the tolerance to the gap.
    fn residual_goal(&self) -> f64 {
        0.2 * self.tol / (2.0 * self.reach())
    }

    /// Typical eigenvalue of `S S^T`.
    fn scale(&self) -> f64 {
        self.gamma * self.op.size() as f64 / self.dimension as f64
    }
}

impl<'a, O: Operator> Setting<'a, O> {
    pub fn of(task: &Task<'a, O>) -> Self {
        let gamma = task.gamma.max(f64::MIN_POSITIVE);
        Self { op: task.op, q: &task.relaxed.q, tol: task.tol, dimension: task.relaxed.dimension, gamma }
    }
}

/// The gap of `w` on the simplex, and `<r, E_i>` for all `i`, in plain arithmetic.
pub(crate) fn gap_and_values<O: Operator>(set: &Setting<O>, w: &[f64], budget: &mut Budget) -> (f64, Vec<f64>) {
    let n = set.op.size();
    let mut image = vec![0.0; set.op.dim()];
    set.op.apply(w, &mut image);
    // gap = 2 (<r, S w> - min_i <r, E_i>)
    let r: Vec<f64> = image.iter().zip(set.q).map(|(x, q)| x - q).collect();
    let mut values = vec![0.0; n];
    set.op.apply_transpose(&r, &mut values);
    budget.charge(2, n, set.op.entries());
    (2.0 * (dot(&r, &image) - min(&values)), values)
}

/// Normalises `w` and measures it from scratch.
pub(crate) fn measure<O: Operator>(set: &Setting<O>, mut w: Vec<f64>, budget: &mut Budget) -> Iterate {
    if !normalise(&mut w) {
        return Iterate { weights: vec![1.0 / w.len() as f64; w.len()], gap: f64::INFINITY };
    }
    let (gap, _) = gap_and_values(set, &w, budget);
    Iterate { weights: w, gap }
}

/// `w + dw`, `dw` the least-norm change on `support` with sum zero and `S dw = force`; clipped to `w >= 0`.
pub(crate) fn corrected<O: Operator>(
    op: &O,
    w: &[f64],
    support: &[usize],
    force: &[f64],
    budget: &mut Budget,
) -> Vec<f64> {
    let sub = op.subset(support);
    let mu = 1e-14 * op.squared_norm(0).max(f64::MIN_POSITIVE) * support.len() as f64 / op.dim() as f64;
    let accuracy = 1e-2 * norm(force);
    let system = NewtonSystem::new(&sub, mu);
    let dz = system.solve(force, accuracy, 500, &mut Memory::new(f64::INFINITY), budget, &mut Work::default());
    let mut dw = vec![0.0; sub.size()];
    sub.apply_transpose(&dz, &mut dw);
    let mean = super::vector::sum(&dw) / dw.len().max(1) as f64;
    let mut out = w.to_vec();
    for (&i, dw) in support.iter().zip(&dw) {
        out[i] = (out[i] + dw - mean).max(0.0);
    }
    normalise(&mut out);
    out
}

/// The dual point and everything that belongs to it.
#[derive(Clone)]
struct Point {
    z: Vec<f64>,
    /// `S^T z`
    pull: Vec<f64>,
    w: Vec<f64>,
    /// `S w`
    image: Vec<f64>,
    /// `F = q - S w - mu z`
    force: Vec<f64>,
    phi: f64,
    support: usize,
}

impl Point {
    fn origin(n: usize, d: usize) -> Self {
        let (zn, zd) = (vec![0.0; n], vec![0.0; d]);
        Self { z: zd.clone(), pull: zn.clone(), w: zn, image: zd.clone(), force: zd, phi: f64::INFINITY, support: n }
    }
}

/// How one inner solve ended.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Ended {
    Converged,
    /// The support is smaller than the dimension: `S w = q` has no solution.
    Infeasible,
    Stuck,
    Limit,
}

/// Rules for one inner solve.
struct Rules<'r> {
    stop: &'r dyn Fn(&Point) -> f64,
    newton: usize,
    cg: usize,
    /// Give up when the support falls below this.
    least_support: usize,
}

struct Inner<'a, 'b, O: Operator> {
    set: &'a Setting<'a, O>,
    center: &'b [f64],
    mu: f64,
    memory: &'b mut Memory,
    scratch: Vec<f64>,
}

impl<O: Operator> Inner<'_, '_, O> {
    /// Completes `point` from its `z` and `pull`.
    fn evaluate(&mut self, point: &mut Point, budget: &mut Budget) {
        let op = self.set.op;
        for ((w, c), a) in point.w.iter_mut().zip(self.center).zip(&point.pull) {
            *w = c + a;
        }
        // w = max(u - theta, 0),  ||w - c||^2 on the way
        let theta = threshold(&point.w, &mut self.scratch);
        let (mut moved, mut support) = (0.0, 0);
        for (w, c) in point.w.iter_mut().zip(self.center) {
            *w = if *w > theta { *w - theta } else { 0.0 };
            support += usize::from(*w > 0.0);
            moved += (*w - c) * (*w - c);
        }
        op.apply(&point.w, &mut point.image);
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
    }

    fn run(&mut self, point: &mut Point, rules: &Rules, budget: &mut Budget, work: &mut Work) -> Ended {
        let op = self.set.op;
        op.apply_transpose(&point.z, &mut point.pull);
        budget.charge(1, op.size(), op.entries());
        self.evaluate(point, budget);
        let mut trial = point.clone();
        let mut short = 0;
        for _ in 0..rules.newton {
            let (force, goal) = (norm(&point.force), (rules.stop)(point));
            if force <= goal {
                return Ended::Converged;
            }
            if budget.exhausted() {
                return Ended::Limit;
            }
            if point.support < rules.least_support {
                return Ended::Infeasible;
            }
            let support: Vec<usize> = (0..op.size()).filter(|&i| point.w[i] > 0.0).collect();
            let sub = op.subset(&support);
            // ||residual|| <= min(0.1, ||F|| / ||r||) ||F||, not below 0.3 of what is asked for
            let r = point.image.iter().zip(self.set.q).map(|(x, q)| (x - q) * (x - q)).sum::<f64>().sqrt();
            let accuracy = (force * (force / r.max(f64::MIN_POSITIVE)).min(0.1)).max(0.3 * goal);
            let system = NewtonSystem::new(&sub, self.mu);
            let dz = system.solve(&point.force, accuracy, rules.cg, self.memory, budget, work);
            work.newton += 1;
            let mut push = vec![0.0; op.size()];
            op.apply_transpose(&dz, &mut push);
            budget.charge(1, op.size(), op.entries());

            // Slope of phi along dz: -<F, dz>. A step that does not pass the minimum on the ray (slope still <= 0) decreases the
            // convex phi for certain, however small the difference of two large values of phi; so does Armijo's rule when it
            // can be trusted.
            let slope = dot(&point.force, &dz);
            let (mut short_of, mut beyond, mut length) = (0.0, f64::INFINITY, 1.0);
            for _ in 0..30 {
                for ((t, z), d) in trial.z.iter_mut().zip(&point.z).zip(&dz) {
                    *t = z + length * d;
                }
                for ((t, a), p) in trial.pull.iter_mut().zip(&point.pull).zip(&push) {
                    *t = a + length * p;
                }
                self.evaluate(&mut trial, budget);
                let remaining = dot(&trial.force, &dz);
                let armijo = trial.phi <= point.phi - 1e-4 * length * slope - 1e-13 * point.phi.abs();
                if remaining >= 0.0 && (remaining <= 0.9 * slope || length == 1.0)
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
                return Ended::Stuck;
            }
        }
        Ended::Stuck
    }
}

/// Entries of one realization above which no factor is computed (64 MB of packed triangle).
const LARGEST_FACTOR: usize = 4000;

/// A Cholesky factor of an earlier Newton matrix, and what conjugate gradients have cost since.
///
/// Near `N = 2 d` the support approaches the dimension, the Newton matrix the square of a square random matrix, and plain
/// conjugate gradients need thousands of iterations. When they have cost as much as a factor would, it is computed, and
/// preconditions until its own iterations have cost as much again: at most about twice the best choice in hindsight.
pub(crate) struct Memory {
    factor: Option<Factor>,
    debt: f64,
    patience: f64,
    /// No factor for supports up to this size: the active set method takes over there.
    spare: usize,
}

impl Memory {
    /// Waits until `patience` times the cost of a factor has been spent.
    fn new(patience: f64) -> Self {
        Self { factor: None, debt: 0.0, patience, spare: 0 }
    }

    /// Costs in units of one index touched, measured: a fused pass 1.3 ns per index, a factor `d^3 / 3` flops at 4 GF/s.
    fn factor_cost(d: usize, k: usize, entries: usize) -> f64 {
        let (d, m) = (d as f64, entries as f64);
        0.12 * d * d * d + k as f64 * m * m
    }

    fn update<O: Operator>(&mut self, sub: &O, mu: f64, u: &[f64], budget: &mut Budget, work: &mut Work) {
        let (d, k) = (sub.dim(), sub.size());
        if self.debt < self.patience || k <= self.spare || d > LARGEST_FACTOR || k == 0 {
            return;
        }
        // S S^T - u u^T / K + mu I
        let mut matrix = vec![0.0; d * (d + 1) / 2];
        sub.add_outer(&mut matrix);
        let mut start = 0;
        for (i, &a) in u.iter().enumerate() {
            let line = &mut matrix[start..start + i + 1];
            axpy(-a / k as f64, &u[..=i], line);
            line[i] += mu;
            start += i + 1;
        }
        budget.charge(1, Self::factor_cost(d, k, sub.entries()) as usize, 1);
        self.factor = Factor::new(matrix, d);
        self.debt = 0.0;
        work.factors += 1;
    }

    fn spent<O: Operator>(&mut self, sub: &O, iterations: usize) {
        let d = sub.dim() as f64;
        let solve = if self.factor.is_some() { 1.4 * d * d } else { 0.0 };
        let each = 2.0 * (sub.size() * sub.entries()) as f64 + solve;
        self.debt += iterations as f64 * each / Self::factor_cost(sub.dim(), sub.size(), sub.entries());
    }
}

/// `(S_J (I - 11^T/K) S_J^T + mu I) dz = F` by preconditioned conjugate gradients.
struct NewtonSystem<'a, O: Operator> {
    sub: &'a O,
    mu: f64,
    /// `S_J 1`
    u: Vec<f64>,
}

impl<'a, O: Operator> NewtonSystem<'a, O> {
    fn new(sub: &'a O, mu: f64) -> Self {
        let mut u = vec![0.0; sub.dim()];
        sub.apply(&vec![1.0; sub.size()], &mut u);
        Self { sub, mu, u }
    }

    /// To `||residual|| <= accuracy`, in at most `most` iterations.
    fn solve(
        &self,
        force: &[f64],
        accuracy: f64,
        most: usize,
        memory: &mut Memory,
        budget: &mut Budget,
        work: &mut Work,
    ) -> Vec<f64> {
        let (k, d) = (self.sub.size(), self.sub.dim());
        memory.update(self.sub, self.mu, &self.u, budget, work);
        let block = if memory.factor.is_none() { Some(self.sub.block(self.mu)) } else { None };
        let precondition = |r: &[f64], z: &mut [f64]| match (&memory.factor, &block) {
            (Some(factor), _) => {
                z.copy_from_slice(r);
                factor.solve(z);
            }
            (None, Some(block)) => block.solve(r, z),
            (None, None) => z.copy_from_slice(r),
        };
        let mut dz = vec![0.0; d];
        let mut residual = force.to_vec();
        let (mut z, mut h) = (vec![0.0; d], vec![0.0; d]);
        precondition(&residual, &mut z);
        let mut direction = z.clone();
        let mut rz = dot(&residual, &z);
        let before = work.cg;
        for _ in 0..most {
            if norm(&residual) <= accuracy || rz <= 0.0 || budget.charge(2, k, self.sub.entries()) {
                break;
            }
            work.cg += 1;
            // H v = S (S^T v - mean) + mu v = S S^T v - mean u + mu v
            let mean = self.sub.normal(&direction, &mut h) / k.max(1) as f64;
            let mut curvature = 0.0;
            for ((h, u), v) in h.iter_mut().zip(&self.u).zip(&direction) {
                *h += self.mu * v - mean * u;
                curvature += *h * v;
            }
            if curvature <= 0.0 {
                break;
            }
            let alpha = rz / curvature;
            axpy(alpha, &direction, &mut dz);
            axpy(-alpha, &h, &mut residual);
            precondition(&residual, &mut z);
            let next = dot(&residual, &z);
            let beta = next / rz;
            rz = next;
            for (v, z) in direction.iter_mut().zip(&z) {
                *v = z + beta * *v;
            }
        }
        memory.spent(self.sub, work.cg - before);
        dz
    }
}

/// One proximal step from the uniform weights with a tiny `mu`.
///
/// At the solution `gap <= 2 mu max_i (w_i - c_i) + 2 reach ||F||`, which fixes `mu` beforehand. `None` if the target turns out
/// to be out of reach (support below the dimension) or the steps become short.
pub(crate) fn direct<O: Operator>(set: &Setting<O>, budget: &mut Budget, work: &mut Work) -> Option<Iterate> {
    let n = set.op.size();
    let center = vec![1.0 / n as f64; n];
    let mut point = Point::origin(n, set.op.dim());
    let least_support = (1.05 * set.dimension as f64) as usize;

    let goal = set.residual_goal();
    let exact = |_: &Point| goal;
    let direct_rules = Rules { stop: &exact, newton: 40, cg: 2000, least_support };

    // A rough solve with a larger mu first: it finds the support cheaply.
    let rough = |p: &Point| 1e-2 * distance(&p.image, set.q);
    let mut memory = Memory::new(2.0);
    let mut inner = Inner { set, center: &center, mu: 1e-6 * set.scale(), memory: &mut memory, scratch: Vec::new() };
    if matches!(
        inner.run(&mut point, &Rules { stop: &rough, ..direct_rules }, budget, work),
        Ended::Infeasible | Ended::Limit
    ) {
        return None;
    }
    inner.mu = set.tol * n as f64 / 40.0;
    let mut best: Option<Iterate> = None;
    for _ in 0..8 {
        let ended = inner.run(&mut point, &direct_rules, budget, work);
        if ended == Ended::Infeasible {
            break;
        }
        let found = measure(set, point.w.clone(), budget);
        let gap = found.gap;
        if best.as_ref().is_none_or(|b| gap < b.gap) {
            best = Some(found);
        }
        if gap <= set.tol || ended == Ended::Limit || ended == Ended::Stuck {
            break;
        }
        inner.mu *= (0.4 * set.tol / gap).clamp(1e-3, 0.5);
    }
    best
}

/// The proximal point method with a decreasing sequence of `mu`; `start` is the first centre.
pub(crate) fn augmented<O: Operator>(
    set: &Setting<O>,
    start: Option<&[f64]>,
    early: bool,
    budget: &mut Budget,
    work: &mut Work,
) -> Iterate {
    let n = set.op.size();
    let mut center = start.map_or_else(|| vec![1.0 / n as f64; n], <[f64]>::to_vec);
    let mut best = measure(set, center.clone(), budget);
    let mut point = Point::origin(n, set.op.dim());
    let mut mu = 3e-2 * set.scale();
    let nearly = (set.dimension + set.dimension / 20 + 2).min(LARGEST_FACTOR);
    let mut memory = Memory { spare: if early { nearly } else { 0 }, ..Memory::new(1.0) };
    for _ in 0..100 {
        if best.gap <= set.tol || budget.exhausted() {
            break;
        }
        let floor = set.residual_goal();
        let stop = |p: &Point| {
            let moved: f64 = p.w.iter().zip(&center).map(|(w, c)| (w - c) * (w - c)).sum();
            (0.3 * distance(&p.image, set.q).min((mu * moved).sqrt())).max(floor)
        };
        let mut inner = Inner { set, center: &center, mu, memory: &mut memory, scratch: Vec::new() };
        let rules = Rules { stop: &stop, newton: 25, cg: 2000, least_support: 0 };
        let before = work.newton;
        let ended = inner.run(&mut point, &rules, budget, work);
        let found = measure(set, point.w.clone(), budget);
        if found.gap < best.gap {
            best = found;
        }
        if ended == Ended::Stuck && norm(&point.force) > 0.5 * distance(&point.image, set.q) {
            // Too far for one proximal step: stay at the centre, with a larger mu.
            mu *= 5.0;
            set.op.apply(&center, &mut point.image);
            for ((z, q), x) in point.z.iter_mut().zip(set.q).zip(&point.image) {
                *z = (q - x) / mu;
            }
            continue;
        }
        center.copy_from_slice(&point.w);
        let shrink = match work.newton - before {
            0..=2 => 0.5,
            3..=12 => 0.75,
            _ => 1.0,
        };
        let next = (shrink * mu).max(1e-13 * set.scale());
        for z in &mut point.z {
            *z *= mu / next;
        }
        mu = next;
        if early && memory.debt > 1.0 && point.support <= nearly {
            best = measure(set, center.clone(), budget);
            break;
        }
    }
    best
}

fn distance(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}
