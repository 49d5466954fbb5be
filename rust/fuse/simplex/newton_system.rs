//! The Newton equations of `semismooth`: `(S_J (I - 11^T/K) S_J^T + mu I) dz = F`.
//!
//! Conjugate gradients, preconditioned by the exact diagonal blocks (`Operator::block`) or, if they converge slowly and
//! the dimension allows, by the Cholesky factor of an earlier system.

use super::budget::Budget;
use super::factor::{Factor, LARGEST_FACTOR, factor_cost, solve_cost};
use super::operator::Operator;
use super::problem::SEARCH;
use super::task::Work;
use super::threshold::settle;
use super::triangle::Triangle;
use crate::error::Result;
use crate::memory::{try_copy, try_filled, try_zeros};
use crate::vector::{axpy, dot, norm};

/// Products added to a matrix between two checks of the limits.
const CHUNK: usize = 10_000_000;
/// Typical number of iterations of a solve with the factor of an earlier system.
const STEPS_WITH_FACTOR: f64 = 20.0;

/// Whether one solve has cost more than it would with a factor of `size` rows; `pass` is the cost of one product with
/// the matrix.
pub(crate) fn is_crawling(cost: f64, pass: f64, size: usize) -> bool {
    cost > STEPS_WITH_FACTOR * (pass + solve_cost(size))
}

/// A Cholesky factor of an earlier Newton matrix, and the cost of conjugate gradients since then.
///
/// Near `N = 2 d` the support approaches the dimension, the Newton matrix becomes the square of a square random matrix,
/// and plain conjugate gradients need thousands of iterations. When they have cost as much as a factor, it is computed,
/// and used as preconditioner until its own iterations have cost as much again: in all at most about twice the best
/// choice.
pub(crate) struct Memory {
    factor: Option<Factor>,
    /// Cost of conjugate gradients since the last factor, in units of a factor.
    debt: f64,
    /// The last solve cost more than one with a factor.
    crawling: bool,
    patience: f64,
    /// No factor for supports up to this size: the active set method takes over there.
    spare: usize,
}

impl Memory {
    /// A factor only after `patience` times its cost has been spent, and only for supports above `spare`.
    pub fn new(patience: f64, spare: usize) -> Self {
        Self { factor: None, debt: 0.0, crawling: false, patience, spare }
    }

    /// Cost of a factor and the matrix before it, in indices touched by a pass.
    fn factor_cost(d: usize, k: usize, entries: usize) -> f64 {
        factor_cost(d) + k as f64 * (entries as f64).powi(2)
    }

    fn update(&mut self, sub: &dyn Operator, mu: f64, u: &[f64], budget: &mut Budget, work: &mut Work) -> Result<()> {
        let (d, k) = (sub.dim(), sub.size());
        if !self.crawling || self.debt < self.patience || k <= self.spare || d > LARGEST_FACTOR || k == 0 {
            return Ok(());
        }
        // S S^T - u u^T / K + mu I
        self.debt = 0.0;
        let Some(mut matrix) = Triangle::zeros(d) else { return Ok(()) };
        let chunk = (CHUNK / (sub.entries() * sub.entries())).max(1);
        for first in (0..k).step_by(chunk) {
            sub.add_outer(first..(first + chunk).min(k), &mut matrix)?;
            if budget.poll() {
                return Ok(());
            }
        }
        for (i, &a) in u.iter().enumerate() {
            let line = matrix.row_mut(i);
            axpy(-a / k as f64, u, line);
            line[i] += mu;
        }
        budget.charge(1, Self::factor_cost(d, k, sub.entries()) as usize, 1);
        self.factor = Factor::new(matrix, budget)?;
        work.factors += 1;
        Ok(())
    }

    fn spent(&mut self, sub: &dyn Operator, iterations: usize) {
        let solve = if self.factor.is_some() { solve_cost(sub.dim()) } else { 0.0 };
        let pass = 2.0 * (sub.size() * sub.entries()) as f64;
        let each = pass + solve;
        self.crawling = is_crawling(iterations as f64 * each, pass, sub.dim());
        self.debt += iterations as f64 * each / Self::factor_cost(sub.dim(), sub.size(), sub.entries());
    }
}

/// `(S_J (I - 11^T/K) S_J^T + mu I) dz = F` by preconditioned conjugate gradients.
pub(crate) struct NewtonSystem<'a> {
    sub: &'a dyn Operator,
    mu: f64,
    /// `S_J 1`
    u: Vec<f64>,
}

impl<'a> NewtonSystem<'a> {
    pub fn new(sub: &'a dyn Operator, mu: f64) -> Result<Self> {
        let mut u = try_zeros(SEARCH, sub.dim())?;
        sub.apply(&try_filled(SEARCH, 1.0, sub.size())?, &mut u)?;
        Ok(Self { sub, mu, u })
    }

    /// Until `||residual|| <= accuracy`, in at most `most` iterations.
    pub fn solve(
        &self,
        force: &[f64],
        accuracy: f64,
        most: usize,
        memory: &mut Memory,
        budget: &mut Budget,
        work: &mut Work,
    ) -> Result<Vec<f64>> {
        let (k, d) = (self.sub.size(), self.sub.dim());
        memory.update(self.sub, self.mu, &self.u, budget, work)?;
        let block = if memory.factor.is_none() { Some(self.sub.block(self.mu)?) } else { None };
        let precondition = |r: &[f64], z: &mut [f64]| match (&memory.factor, &block) {
            (Some(factor), _) => {
                z.copy_from_slice(r);
                factor.solve(z);
            }
            (None, Some(block)) => block.solve(r, z),
            (None, None) => z.copy_from_slice(r),
        };
        let mut dz = try_zeros(SEARCH, d)?;
        let mut residual = try_copy(SEARCH, force)?;
        let (mut z, mut h) = (try_zeros(SEARCH, d)?, try_zeros(SEARCH, d)?);
        precondition(&residual, &mut z);
        let mut direction = try_copy(SEARCH, &z)?;
        let mut rz = dot(&residual, &z);
        let before = work.cg;
        for _ in 0..most {
            if norm(&residual) <= accuracy || rz <= 0.0 || budget.charge(2, k, self.sub.entries()) {
                break;
            }
            work.cg += 1;
            // H v = S (S^T v - mean) + mu v = S S^T v - mean u + mu v
            let mean = self.sub.normal(&direction, &mut h)? / k.max(1) as f64;
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
        Ok(dz)
    }
}

/// `w + dw`, `dw` the least-norm change on `support` with sum zero and `S dw = force`; clipped to `w >= 0`.
pub(crate) fn corrected(
    op: &dyn Operator,
    w: &[f64],
    support: &[usize],
    force: &[f64],
    budget: &mut Budget,
) -> Result<Vec<f64>> {
    let sub = op.subset(support)?;
    let mu = 1e-14 * op.squared_norm(0).max(f64::MIN_POSITIVE) * support.len() as f64 / op.dim() as f64;
    let accuracy = 1e-2 * norm(force);
    let system = NewtonSystem::new(&*sub, mu)?;
    let dz = system.solve(force, accuracy, 500, &mut Memory::new(f64::INFINITY, 0), budget, &mut Work::default())?;
    let mut dw = try_zeros(SEARCH, sub.size())?;
    sub.apply_transpose(&dz, &mut dw)?;
    let mean = crate::vector::sum(&dw) / dw.len().max(1) as f64;
    let mut out = try_copy(SEARCH, w)?;
    for (&i, dw) in support.iter().zip(&dw) {
        out[i] = (out[i] + dw - mean).max(0.0);
    }
    settle(&mut out);
    Ok(out)
}
