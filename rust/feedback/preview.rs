//! What targets to come add to the inputs of a gain.

use faer::Mat;
use faer::linalg::solvers::Solve;

use crate::error::{Error, Result};
use crate::matrix::MatrixView;
use crate::memory::{covered, room_for_products};
use crate::parallel::Stop;

use super::data::{Matrix, WHAT, entries, matrix};
use super::gains::least_squares;
use super::loops::bytes;

/// A system `x+ = A x + B u + w` whose next readings are `C x + D u` and a constant, the weights Q and R of readings
/// and inputs, and its gain K, each row by row.
#[derive(Debug, Clone, Copy)]
#[allow(missing_docs, reason = "see above")]
pub struct Preview<'a> {
    pub a: &'a [f64],
    pub b: &'a [f64],
    pub c: &'a [f64],
    pub d: &'a [f64],
    pub q: &'a [f64],
    pub r: &'a [f64],
    pub k: &'a [f64],
}

impl Preview<'_> {
    /// `v_k` (h, m) and the way `x*` (h, n) from `start` with `u = K (x - x°) + u° + v`, about points `x°`, `u°` at
    /// rest or on a slope; w is what else acts.
    ///
    /// It is the least of `sum_k |y*_{k+1} - y°_{k+1}|_Q^2 + |u*_k - u°_k|_R^2`. The cost of a gain that weighs
    /// `u - u°` more leaves the target at each bend: `u°` jumps there, and the states behind the readings cannot.
    ///
    /// # Errors
    /// As of [`least_squares`].
    pub fn inputs(&self, [points, inputs, w]: [&[f64]; 3], start: &[f64], stop: &Stop) -> Result<(Vec<f64>, Vec<f64>)> {
        let n = start.len();
        let (m, p, h) = (self.b.len() / n.max(1), self.c.len() / n.max(1), points.len() / n.max(1));
        let sizes = [self.a.len(), self.d.len(), self.q.len(), self.r.len(), self.k.len(), inputs.len(), w.len()];
        if m == 0 || sizes != [n * n, p * m, p * p, m * m, m * n, h * m, h * n] {
            let expected = format!("the sizes of {n} states, {m} inputs, {p} readings and {h} steps");
            return Err(Error::Shape { name: "path", expected, found: format!("{sizes:?}") });
        }
        room_for_products()?;
        covered(WHAT, bytes(n, n + m) + 64 * (h as u128) * (n + m) as u128, || {
            let (a, b, c, d) = (matrix(self.a, n, n), matrix(self.b, n, m), matrix(self.c, p, n), matrix(self.d, p, m));
            let (q, r, k) = (matrix(self.q, p, p), matrix(self.r, m, m), matrix(self.k, m, n));
            let weight = d.transpose() * &q * &d + &r;
            // the cost of u + N x has no cross term
            let cross = weight.partial_piv_lu().solve(d.transpose() * &q * &c);
            let left = &c - &d * &cross;
            let states = left.transpose() * &q * &left + cross.transpose() * &r * &cross;
            let free = entries(&(&a - &b * &cross));
            let (states, costs, of) = (entries(&states), entries(&weight), MatrixView::of);
            let found = least_squares(of(&free, n), of(self.b, m), of(&states, n), of(&costs, m), stop)?;
            let s = matrix(&found.cost.unwrap_or_default(), n, n);
            let own = matrix(&found.gain, m, n) - cross;
            let per = -((&weight + b.transpose() * &s * &b).partial_piv_lu().solve(b.transpose()));
            let columns = |of: &[f64], rows: usize| Mat::from_fn(rows, h, |i, j| of[j * rows + i]);
            let (x, u, w) = (columns(points, n), columns(inputs, m), columns(w, n));
            let next = Mat::from_fn(n, h, |i, j| x[(i, (j + 1).min(h - 1))]);
            let lacks = &a * &x + &b * &u + &w - next;
            let closed = (&a + &b * &own).transpose().to_owned();
            let (mut ahead, mut after) = (Matrix::zeros(m, h), Matrix::zeros(n, 1));
            for j in (0..h).rev() {
                after = &closed * after + &s * lacks.subcols(j, 1);
                ahead.subcols_mut(j, 1).copy_from(&per * &after);
            }
            let (mut way, mut acts) = (Matrix::zeros(n, h), Matrix::zeros(m, h));
            let mut now = Mat::from_fn(n, 1, |i, _| start[i]);
            for j in 0..h {
                way.subcols_mut(j, 1).copy_from(&now);
                let act = u.subcols(j, 1) + &own * (&now - x.subcols(j, 1)) + ahead.subcols(j, 1);
                now = &a * &now + &b * &act + w.subcols(j, 1);
                acts.subcols_mut(j, 1).copy_from(&act);
            }
            let more = acts - u - k * (&way - x);
            Ok((entries(&more.transpose().to_owned()), entries(&way.transpose().to_owned())))
        })?
    }
}
