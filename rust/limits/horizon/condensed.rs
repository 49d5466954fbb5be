//! The inverse of the matrix of a horizon, by Riccati's recursion, for controllers without linear algebra.
//!
//! ```text
//! J(u) = (u - f)'H (u - f) + constant,    f = F x0 + g
//! ```
//!
//! `-H^-1 q` minimises `u'H u + 2 q'u`: the best inputs of the horizon from 0 with a linear cost q. So all columns of
//! `H^-1`, F and g are roll-outs of one feedback, whose rounding does not grow with the powers of A.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use super::map::{Horizon, WHAT};
use crate::error::{Error, Result};
use crate::memory::{checked_len, covered, room_for_products, try_collect, try_push, try_room};

type Matrix = Mat<f64>;

/// What a horizon is without its limits, for its inputs and the states that have limits; matrices row by row.
#[derive(Debug)]
pub struct Condensed {
    /// The lower triangle of `H^-1`, of `C H^-1 C'` with states, `C = [I; G]`. Of states whose limits are soft with
    /// weight w, `1 / w` is added to the diagonal: what is beyond a limit is then one more variable.
    pub inverse: Vec<f64>,
    /// F (K m + states, n).
    pub map: Vec<f64>,
    /// g (K m + states).
    pub offset: Vec<f64>,
}

/// P of the state behind a step, the feedback of the step, the closed loop, and `(R + B'PB)^-1`.
struct Step {
    p: Matrix,
    feedback: Matrix,
    closed: Matrix,
    inverse: Matrix,
}

/// The best inputs and the states behind all steps: (K m, wide) and (K n, wide).
type Ways = (Matrix, Matrix);

impl Horizon {
    /// The entries of `x(1) .. x(K)` that have a limit.
    pub(super) fn limited(&self) -> Result<Vec<usize>> {
        let mut states = Vec::new();
        if let Some((low, high)) = &self.task.states {
            for i in (0..low.len()).filter(|i| low[*i].is_finite() || high[*i].is_finite()) {
                try_push(WHAT, &mut states, i)?;
            }
        }
        Ok(states)
    }

    /// The same inputs, condensed, and the states that have limits behind them.
    ///
    /// # Errors
    /// [`Error::Numerical`] where an input has no weight at some step, [`Error::Memory`].
    pub fn condensed(&self) -> Result<Condensed> {
        let states = &self.limited()?[..];
        let (n, m, steps) = (self.n, self.m, self.steps);
        let (d, more) = (steps * m, steps * n);
        let (size, wide) = (d + states.len(), d + states.len() + n + 1);
        // columns are padded to whole lines of the cache
        let kept = checked_len(WHAT, if states.is_empty() { d + 8 } else { d + more + 16 }, wide)?;
        let small = (n + 8) * (wide + 8) + steps * (n + m + 8) * (n + m + 8);
        let bytes = 8 * (kept as u128 + 8 * small as u128);
        room_for_products()?;
        let (u, x) = covered(WHAT, 2 * bytes, || self.rolled_out(states, wide))??;
        let at = |i: usize, j: usize| if i < d { u[(i, j)] } else { x[(states[i - d], j)] };
        let mut inverse = try_room(WHAT, checked_len(WHAT, size, size + 1)? / 2)?;
        (0..size).for_each(|i| (0..=i).for_each(|j| inverse.push(-0.5 * (at(i, j) + at(j, i)))));
        let slack = self.task.soft.map_or(0.0, |soft| 1.0 / soft);
        (d..size).for_each(|i| inverse[i * (i + 3) / 2] += slack);
        let map = try_collect(WHAT, (0..size * n).map(|e| at(e / n, size + e % n)))?;
        let offset = try_collect(WHAT, (0..size).map(|i| at(i, size + n)))?;
        if inverse.iter().chain(&map).chain(&offset).any(|v| !v.is_finite()) {
            return Err(Error::Numerical("the plans of this loop overflow".into()));
        }
        Ok(Condensed { inverse, map, offset })
    }

    /// The best inputs for each unit vector q of inputs and of these states, each unit vector x0, and the reference
    /// with the offset.
    fn rolled_out(&self, states: &[usize], wide: usize) -> Result<Ways> {
        let (n, m, d) = (self.n, self.m, self.steps * self.m);
        let of = |values: &[f64], rows, cols| MatRef::from_row_major_slice(values, rows, cols).to_owned();
        let (a, b, r) = (of(&self.a, n, n), of(&self.b, n, m), of(&self.r, m, m));
        let (stage, terminal) = (of(&self.task.stage, n, n), of(&self.task.terminal, n, n));
        let c = self.c.as_ref().map_or_else(|| Mat::zeros(n, 1), |c| of(c, n, 1));
        let mut p = terminal.clone();
        let mut steps = Vec::new();
        for _ in 0..self.steps {
            let pb = &p * &b;
            let root = (&r + b.transpose() * &pb).llt(Side::Lower);
            let root = root.map_err(|_| Error::Numerical("an input has no weight: give `R`, > 0".into()))?;
            let feedback = root.solve(pb.transpose() * &a) * -1.0;
            let closed = &a + &b * &feedback;
            // of x(k), k >= 1: in front of the first step there is no weight of states, and none is used
            let before = &stage + closed.transpose() * &p * &closed + feedback.transpose() * &r * &feedback;
            let inverse = root.solve(Mat::<f64>::identity(m, m));
            steps.push(Step { p, feedback, closed, inverse });
            p = (&before + before.transpose()) * 0.5;
        }
        steps.reverse(); // the last one was first
        // costates of all columns, backwards: x'Px + 2 p'x
        let mut rest = Mat::<f64>::zeros(n, wide);
        let mut forward = Vec::new();
        for k in (0..self.steps).rev() {
            let step = &steps[k];
            let weight = if k + 1 == self.steps { &terminal } else { &stage };
            let wanted = of(&self.task.reference[k * n..(k + 1) * n], n, 1);
            let own = &step.p * &c - weight * wanted;
            (0..n).for_each(|i| rest[(i, wide - 1)] += own[(i, 0)]);
            let here = states.iter().enumerate().filter(|(_, at)| **at / n == k);
            here.for_each(|(i, at)| rest[(at % n, d + i)] += 1.0);
            // u = K x - (R + B'PB)^-1 (B'p + q), p with P c and the reference; then p = (A + BK)'p + K'q
            let mut q = Mat::<f64>::zeros(m, wide);
            (0..m).for_each(|j| q[(j, k * m + j)] = 1.0);
            forward.push(&step.inverse * (b.transpose() * &rest + &q) * -1.0);
            rest = step.closed.transpose() * rest + step.feedback.transpose() * q;
        }
        forward.reverse();
        let mut x = Mat::<f64>::zeros(n, wide);
        (0..n).for_each(|i| x[(i, wide - 1 - n + i)] = 1.0);
        let mut all = Mat::<f64>::zeros(d, wide);
        let mut ways = Mat::<f64>::zeros(if states.is_empty() { 0 } else { self.steps * n }, wide);
        for (k, (step, own)) in steps.iter().zip(&forward).enumerate() {
            let u = &step.feedback * &x + own;
            x = &a * x + &b * &u;
            (0..n).for_each(|i| x[(i, wide - 1)] += c[(i, 0)]);
            (0..m).for_each(|j| (0..wide).for_each(|i| all[(k * m + j, i)] = u[(j, i)]));
            if !states.is_empty() {
                (0..n).for_each(|j| (0..wide).for_each(|i| ways[(k * n + j, i)] = x[(j, i)]));
            }
        }
        Ok((all, ways))
    }
}
