//! The inverse of the matrix of a horizon, by Riccati's recursion, for controllers without linear algebra.
//!
//! ```text
//! J(u) = (u - f)'H (u - f) + constant,    f = F x0 + g
//! ```
//!
//! `-H^-1 q` minimises `u'H u + 2 q'u`: the best inputs of the horizon from 0 with a linear cost q. So all columns of `H^-1`,
//! F and g are roll-outs of one feedback, whose rounding does not grow with the powers of A.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use super::map::{Horizon, WHAT};
use crate::error::{Error, Result};
use crate::memory::{checked_len, covered, room_for_products, try_collect, try_room};

type Matrix = Mat<f64>;

/// What a horizon is without its limits; matrices row by row.
#[derive(Debug)]
pub struct Condensed {
    /// The lower triangle of `H^-1`.
    pub inverse: Vec<f64>,
    /// F (K m, n).
    pub map: Vec<f64>,
    /// g (K m).
    pub offset: Vec<f64>,
}

/// P of the state behind a step, the feedback of the step, the closed loop, and `(R + B'PB)^-1`.
struct Step {
    p: Matrix,
    feedback: Matrix,
    closed: Matrix,
    inverse: Matrix,
}

impl Horizon {
    /// The same inputs, condensed; limits of states are not in it.
    ///
    /// # Errors
    /// [`Error::Numerical`] where an input has no weight at some step, [`Error::Memory`].
    pub fn condensed(&self) -> Result<Condensed> {
        let (n, m, steps) = (self.n, self.m, self.steps);
        let (d, wide) = (steps * m, steps * m + n + 1);
        let bytes = 8 * (checked_len(WHAT, d + 8 * n, wide)? as u128 + (steps * (n + m + 4) * (n + m + 4)) as u128);
        room_for_products()?;
        let u = covered(WHAT, 4 * bytes, || self.rolled_out(d, wide))??;
        let mut inverse = try_room(WHAT, checked_len(WHAT, d, d + 1)? / 2)?;
        (0..d).for_each(|i| (0..=i).for_each(|j| inverse.push(-0.5 * (u[(i, j)] + u[(j, i)]))));
        let map = try_collect(WHAT, (0..d * n).map(|at| u[(at / n, d + at % n)]))?;
        let offset = try_collect(WHAT, (0..d).map(|i| u[(i, d + n)]))?;
        if inverse.iter().chain(&map).chain(&offset).any(|v| !v.is_finite()) {
            return Err(Error::Numerical("the plans of this loop overflow".into()));
        }
        Ok(Condensed { inverse, map, offset })
    }

    /// The best inputs (K m) for each unit vector q, each unit vector x0, and the reference with the offset.
    fn rolled_out(&self, d: usize, wide: usize) -> Result<Matrix> {
        let (n, m) = (self.n, self.m);
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
            // u = K x - (R + B'PB)^-1 (B'p + q), p with P c and the reference; then p = (A + BK)'p + K'q
            let mut q = Mat::<f64>::zeros(m, wide);
            (0..m).for_each(|j| q[(j, k * m + j)] = 1.0);
            forward.push(&step.inverse * (b.transpose() * &rest + &q) * -1.0);
            rest = step.closed.transpose() * rest + step.feedback.transpose() * q;
        }
        forward.reverse();
        let mut x = Mat::<f64>::zeros(n, wide);
        (0..n).for_each(|i| x[(i, d + i)] = 1.0);
        let mut all = Mat::<f64>::zeros(d, wide);
        for (k, (step, own)) in steps.iter().zip(&forward).enumerate() {
            let u = &step.feedback * &x + own;
            x = &a * x + &b * &u;
            (0..n).for_each(|i| x[(i, wide - 1)] += c[(i, 0)]);
            (0..m).for_each(|j| (0..wide).for_each(|i| all[(k * m + j, i)] = u[(j, i)]));
        }
        Ok(all)
    }
}
