//! From active limits that are nearly right to the minimum, without an interior point: with `H_FF` of the free inputs by
//! Riccati's recursion, the rows `C` of held rates and states, and `D` with `1 / (2 soft)` for soft ones, a step is
//! `du = -H_FF^-1 (g + C' dl) / 2` with `(C H_FF^-1 C' / 2 + D) dl = -b - C H_FF^-1 g / 2`, where `b` is missing in the rows.

use super::assembly::{Held, Kind, Multipliers};
use super::search::{EXACT, Search};
use super::task::{Task, WHAT};
use crate::error::Result;
use crate::limits::quadratic::{Method, Quadratic, Status, Until};
use crate::memory::{checked_len, try_copy, try_push, try_room, try_zeros};
use crate::vector::dot;

/// Most sets of active limits, and steps with one set.
const SETS: usize = 10;
const STEPS: usize = 3;
/// Most rows: their matrix is factored for each set.
const MOST: usize = 400;
/// Share of a pivot below which a row depends on those before it.
const DEPENDENT: f64 = 1e-11;

/// One set of active limits, factored.
struct Face {
    rows: Vec<(Kind, usize)>,
    /// `H_FF^-1 C'` and `C`, row by row.
    solved: Vec<f64>,
    rows_of_inputs: Vec<f64>,
    /// Pivots in order, and the lower triangle in this order; dependent rows are left out.
    order: Vec<usize>,
    lower: Vec<f64>,
}

impl Task<'_> {
    /// The held limits that `signs` names: inputs, then rates, then states, each step by step.
    pub(super) fn held(&self, signs: &[i8]) -> Result<Held> {
        let mut held = self.zeros()?;
        let mut rest = signs;
        for (kind, len) in self.kinds() {
            let (own, others) = rest.split_at(len.min(rest.len()));
            rest = others;
            for (i, side) in own.iter().enumerate() {
                let (low, high) = self.limits(kind, i);
                let there = if *side < 0 { low } else { high };
                held[kind as usize][i] = if *side != 0 && there.is_finite() { side.signum() } else { 0 };
            }
            (0..len).filter(|&i| self.fixed(kind, i)).for_each(|i| held[kind as usize][i] = 1);
        }
        Ok(held)
    }

    /// Inputs at the limits that are held.
    fn hold(&self, held: &Held, u: &mut [f64]) {
        for (i, u) in u.iter_mut().enumerate().filter(|(i, _)| held[Kind::Input as usize][*i] != 0) {
            *u = if held[Kind::Input as usize][i] < 0 { self.bounds().low[i] } else { self.bounds().high[i] };
        }
    }

    /// The row of a limit as one of the inputs alone.
    fn of_inputs(&self, kind: Kind, i: usize, c: &mut [f64]) -> Result<()> {
        if kind == Kind::State {
            let mut w = try_zeros(WHAT, self.steps * self.n)?;
            w[i] = 1.0;
            return self.pull(&w, c);
        }
        self.row(kind, i).for_each(|(at, factor)| c[at] = factor);
        Ok(())
    }
}

impl Face {
    /// None where there are too many rows or `H_FF` is singular to rounding.
    fn new(search: &mut Search<'_, '_>, held: &Held, until: Until<'_>) -> Result<Option<Self>> {
        let (task, d) = (search.task, search.fixed.len());
        let mut rows = Vec::new();
        for (kind, len) in task.kinds().into_iter().skip(1) {
            for i in (0..len).filter(|&i| held[kind as usize][i] != 0) {
                try_push(WHAT, &mut rows, (kind, i))?;
            }
        }
        search.iterations += 1;
        if rows.len() > MOST || !search.q.face(&held[Kind::Input as usize], &mut try_zeros(WHAT, d)?, until)? {
            return Ok(None);
        }
        let p = rows.len();
        let mut c = try_zeros(WHAT, checked_len(WHAT, p, d)?)?;
        let mut matrix = try_zeros(WHAT, checked_len(WHAT, p, p)?)?;
        for (&(kind, i), c) in rows.iter().zip(c.chunks_exact_mut(d)) {
            task.of_inputs(kind, i, c)?;
        }
        let mut solved = try_copy(WHAT, &c)?;
        for (r, solved) in solved.chunks_exact_mut(d).enumerate() {
            search.q.correct(solved);
            let soft = task.soft.filter(|_| rows[r].0 == Kind::State);
            for (s, c) in c.chunks_exact(d).enumerate() {
                matrix[r * p + s] = 0.5 * dot(c, solved);
            }
            matrix[r * p + r] += soft.map_or(0.0, |soft| 0.5 / soft);
        }
        let mut face =
            Self { rows, solved, rows_of_inputs: c, order: try_room(WHAT, p)?, lower: try_room(WHAT, p * p)? };
        face.factor(matrix)?;
        Ok(Some(face))
    }

    /// `L L'` of the matrix, rows with the largest pivots first.
    fn factor(&mut self, mut matrix: Vec<f64>) -> Result<()> {
        let p = self.rows.len();
        let mut least = try_room(WHAT, p)?;
        least.extend((0..p).map(|i| DEPENDENT * matrix[i * p + i]));
        let share = |matrix: &[f64], i: usize| matrix[i * p + i] / least[i].max(f64::MIN_POSITIVE);
        for _ in 0..p {
            let open = (0..p).filter(|i| !self.order.contains(i));
            let Some(next) = open.max_by(|&i, &j| share(&matrix, i).total_cmp(&share(&matrix, j))) else { break };
            let pivot = matrix[next * p + next];
            if pivot.is_nan() || pivot <= least[next] {
                break;
            }
            let root = pivot.sqrt();
            // column k of L, which stays in the rows of the matrix that are taken; the rest is reduced
            let mut column = try_zeros(WHAT, p)?;
            for i in 0..p {
                column[i] = matrix[i * p + next] / root;
            }
            for i in (0..p).filter(|i| !self.order.contains(i)) {
                for j in 0..p {
                    matrix[i * p + j] -= column[i] * column[j];
                }
            }
            self.order.push(next);
            self.lower.extend_from_slice(&column);
        }
        Ok(())
    }

    /// `x <- (matrix)^-1 x` on the rows that are independent, 0 on the others.
    fn solve(&self, x: &mut [f64]) {
        let (p, count) = (self.rows.len(), self.order.len());
        let at = |k: usize, i: usize| self.lower[k * p + i];
        for k in 0..count {
            let own = self.order[k];
            x[own] /= at(k, own);
            for &i in &self.order[k + 1..] {
                x[i] -= at(k, i) * x[own];
            }
        }
        for k in (0..count).rev() {
            let own = self.order[k];
            let sum: f64 = self.order[k + 1..].iter().map(|&i| at(k, i) * x[i]).sum();
            x[own] = (x[own] - sum) / at(k, own);
        }
        for i in (0..p).filter(|i| !self.order.contains(i)) {
            x[i] = 0.0;
        }
    }

    /// The step from `u`, which is at the limits that are held, and from `multipliers`; `g` is the gradient with them.
    fn step(
        &self,
        search: &mut Search<'_, '_>,
        held: &Held,
        (u, x, g): (&mut [f64], &[f64], &mut [f64]),
        multipliers: &mut Multipliers,
    ) -> Result<()> {
        let (task, d) = (search.task, u.len());
        search.q.correct(g);
        let mut change = try_zeros(WHAT, self.rows.len())?;
        for (to, (&(kind, i), c)) in change.iter_mut().zip(self.rows.iter().zip(self.rows_of_inputs.chunks_exact(d))) {
            // soft limits: what is missing is in g
            let missing = if kind == Kind::State && task.soft.is_some() {
                0.0
            } else {
                let (low, high) = task.limits(kind, i);
                (if held[kind as usize][i] < 0 { low } else { high }) - task.value(kind, i, u, x)
            };
            *to = -missing - 0.5 * dot(c, g);
        }
        self.solve(&mut change);
        u.iter_mut().zip(&*g).for_each(|(u, g)| *u -= 0.5 * g);
        for ((solved, change), &(kind, i)) in self.solved.chunks_exact(d).zip(&change).zip(&self.rows) {
            u.iter_mut().zip(solved).for_each(|(u, v)| *u -= 0.5 * change * v);
            if kind != Kind::State || task.soft.is_none() {
                multipliers[kind as usize][i] += change;
            }
        }
        Ok(())
    }
}

impl Search<'_, '_> {
    /// Exchanges limits from those that are held on, until the control is judged good, or there is no hope of it.
    pub(super) fn follow(&mut self, held: &mut Held, until: Until<'_>) -> Result<Option<Status>> {
        let task = self.task;
        let (mut u, mut multipliers) = (try_zeros(WHAT, self.fixed.len())?, task.zeros()?);
        let mut x = try_zeros(WHAT, task.steps * task.n)?;
        for count in 0..=SETS {
            // of the last set what it led to, within the limits
            let early = until.reached();
            if early.is_some() || count == SETS {
                if count > 0 && self.best.is_none() {
                    self.verify((&u, &x), &task.zeros()?, Method::Pivoting, until)?;
                }
                return Ok(early);
            }
            let Some(face) = Face::new(self, held, until)? else { break };
            let (mut changed, mut before) = (false, f64::INFINITY);
            for _ in 0..STEPS {
                task.hold(held, &mut u);
                task.roll(&u, &mut x);
                let mut g = task.residual(&u, &x, &multipliers, held)?;
                face.step(self, held, (&mut u, &x, &mut g), &mut multipliers)?;
                if u.iter().any(|v| !v.is_finite()) {
                    return Ok(None);
                }
                task.roll(&u, &mut x);
                // the multipliers of held inputs: what is left of the gradient there
                multipliers[Kind::Input as usize].fill(0.0);
                let left = task.residual(&u, &x, &multipliers, held)?;
                for (i, v) in left.iter().enumerate().filter(|(i, _)| held[Kind::Input as usize][*i] != 0) {
                    multipliers[Kind::Input as usize][i] = -v;
                }
                changed = task.exchange(&u, &x, &mut multipliers, held);
                if changed {
                    break;
                }
                self.judge_signed((&u, &x), &multipliers, held, until)?;
                let now = self.best.as_ref().map_or(f64::INFINITY, |best| best.merit);
                if now <= EXACT || now > 0.5 * before {
                    break;
                }
                before = now;
            }
            if !changed {
                break;
            }
        }
        Ok(None)
    }
}
