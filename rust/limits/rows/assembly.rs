//! The programs of a problem: the best control, the least excess of limits on states, and one set of active limits.
//!
//! Variables are inputs, states, and amounts by which limits on states are exceeded, in units of their sizes.

use super::program::{Point, Program};
use super::task::{Task, WHAT, largest};
use crate::error::Result;
use crate::memory::{try_copy, try_filled, try_push, try_zeros};

/// Limits beyond this, in units of the sizes, are left to the exchange of limits first, as an interior point that
/// begins among them ends early; beyond the second number to the certificate.
pub(super) const FAR: [f64; 2] = [1e3, 1e12];

/// What a limit is for, in the order of all lists of limits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Input,
    Rate,
    State,
}

pub const KINDS: usize = 3;

/// A row of a program: the kind and entry of its limit, 1 at the upper and -1 at the lower side, 0 where both are
/// equal.
pub(super) type Row = (Kind, usize, i8);

/// By kind, `>= 0` at the upper side and `<= 0` at the lower; `J' + inputs + D' rates + G' states = 0` at the minimum.
pub(super) type Multipliers = [Vec<f64>; KINDS];

/// By kind, 1 and -1 for limits that hold with equality at the upper and lower side; soft ones: that are exceeded.
pub(super) type Held = [Vec<i8>; KINDS];

/// What a program looks for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    Best,
    /// The least excess of limits on states.
    Least,
}

impl Task<'_> {
    /// A number for each limit, by kind.
    pub(super) fn zeros<T: Copy + Default>(&self) -> Result<[Vec<T>; KINDS]> {
        let mut all: [Vec<T>; KINDS] = Default::default();
        for (kind, len) in self.kinds() {
            all[kind as usize] = try_filled(WHAT, T::default(), len)?;
        }
        Ok(all)
    }

    pub(super) fn limits(&self, kind: Kind, i: usize) -> (f64, f64) {
        match (kind, self.rate) {
            (Kind::Input, _) => (self.bounds().low[i], self.bounds().high[i]),
            (Kind::State, _) => (self.low[i], self.high[i]),
            (Kind::Rate, Some((rate, _))) if !self.idle(i) => (-rate[i % self.m], rate[i % self.m]),
            (Kind::Rate, _) => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    /// The row of a limit: places among inputs and states, and their factors.
    pub(super) fn row(&self, kind: Kind, i: usize) -> impl Iterator<Item = (usize, f64)> + use<> {
        let at = if kind == Kind::State { self.steps * self.m + i } else { i };
        let before = (kind == Kind::Rate && i >= self.m).then(|| (i - self.m, -1.0));
        std::iter::once((at, 1.0)).chain(before)
    }

    /// What a row is compared with besides its limits: `u(-1)`.
    fn start(&self, kind: Kind, i: usize) -> f64 {
        if kind == Kind::Rate && i < self.m { self.before(&[], i) } else { 0.0 }
    }

    /// What a limit is for.
    pub(super) fn value(&self, kind: Kind, i: usize, u: &[f64], x: &[f64]) -> f64 {
        let entry = |(at, factor)| factor * u.get(at).unwrap_or_else(|| &x[at - u.len()]);
        self.row(kind, i).map(entry).sum::<f64>() - self.start(kind, i)
    }

    /// `g += C' v` of the rows `C` of inputs.
    pub(super) fn pull_rows(&self, v: &Multipliers, g: &mut [f64]) {
        for (kind, _) in self.kinds().into_iter().filter(|(kind, _)| !matches!(kind, Kind::Input | Kind::State)) {
            for (i, v) in v[kind as usize].iter().enumerate() {
                self.row(kind, i).for_each(|(at, factor)| g[at] += factor * v);
            }
        }
    }

    /// The size of what a limit is for.
    pub(super) fn unit(&self, kind: Kind, i: usize) -> f64 {
        if kind == Kind::State { self.size.0[i % self.n] } else { self.size.1[i % self.m] }
    }

    /// All kinds, and how many limits each has.
    pub(super) fn kinds(&self) -> [(Kind, usize); KINDS] {
        let d = self.steps * self.m;
        let changes = if self.rate.is_some() { d } else { 0 };
        [(Kind::Input, d), (Kind::Rate, changes), (Kind::State, self.low.len())]
    }

    /// Both limits are one number, which must hold.
    pub(super) fn fixed(&self, kind: Kind, i: usize) -> bool {
        let (low, high) = self.limits(kind, i);
        low == high && (kind != Kind::State || self.soft.is_none())
    }

    /// The size of `J`, to scale by.
    pub(super) fn scale(&self) -> f64 {
        let (state, input, n) = (&self.size.0, &self.size.1, self.n);
        let weighed = self.h.stage.iter().zip(self.h.terminal).enumerate();
        let of_states = weighed
            .fold(0.0f64, |most, (i, (q, last))| most.max(q.abs().max(last.abs()) * state[i / n] * state[i % n]));
        let of_inputs = input.iter().enumerate().fold(0.0f64, |v, (j, u)| v.max(self.h.r[j * self.m + j] * u * u));
        if of_states > 0.0 {
            of_states
        } else if of_inputs > 0.0 {
            of_inputs
        } else {
            1.0
        }
    }

    /// `J` less its linear part, and the steps; `start`: with the state before the first one.
    fn program(&self, more: usize, weighed: bool, start: bool) -> Result<Program> {
        let (n, m, steps) = (self.n, self.m, self.steps);
        let (state, input, d) = (&self.size.0, &self.size.1, steps * m);
        let shared = 2 * n + m + if self.low.is_empty() { 0 } else { 2 * n };
        let mut program = Program::new(d + steps * n + more, (steps, 2 * (shared + 1)))?;
        if weighed {
            let scale = 2.0 / self.scale();
            let mut r = try_copy(WHAT, self.h.r)?;
            r.iter_mut().enumerate().for_each(|(i, r)| *r *= input[i / m] * input[i % m]);
            let mut weights = [try_copy(WHAT, self.h.stage)?, try_copy(WHAT, self.h.terminal)?];
            for q in &mut weights {
                q.iter_mut().enumerate().for_each(|(i, q)| *q *= state[i / n] * state[i % n]);
            }
            for t in 0..steps {
                program.weigh(t * m, &r, m, scale)?;
                program.weigh(d + t * n, &weights[usize::from(t + 1 == steps)], n, scale)?;
            }
        }
        for t in 0..steps {
            for i in 0..n {
                let (a, b) = (&self.h.a[i * n..(i + 1) * n], &self.h.b[i * m..(i + 1) * m]);
                let mut right = 0.0;
                let row = program.right.len();
                if t > 0 {
                    for (j, a) in a.iter().enumerate() {
                        program.entry(row, d + (t - 1) * n + j, -a * state[j] / state[i])?;
                    }
                } else if start {
                    right = a.iter().zip(self.h.x0).map(|(a, x)| a * x).sum::<f64>() / state[i];
                }
                for (j, b) in b.iter().enumerate() {
                    program.entry(row, t * m + j, -b * input[j] / state[i])?;
                }
                program.row(&[(d + t * n + i, 1.0)], right, true)?;
            }
        }
        Ok(program)
    }

    /// `side value (- amount) <= right`, in units.
    fn limit(
        &self,
        to: &mut Program,
        (kind, i, side): Row,
        right: f64,
        amount: Option<usize>,
        equal: bool,
    ) -> Result<()> {
        let (sign, row, d) = (if side < 0 { -1.0 } else { 1.0 }, to.right.len(), self.steps * self.m);
        for (at, factor) in self.row(kind, i) {
            let unit = if at < d { self.size.1[at % self.m] } else { self.size.0[(at - d) % self.n] };
            to.entry(row, at, sign * factor * unit / self.unit(kind, i))?;
        }
        if let Some(amount) = amount {
            to.entry(row, amount, -1.0)?;
        }
        to.row(&[], right / self.unit(kind, i), equal)
    }

    /// The whole problem but for limits beyond `far`, and the rows after those of the steps.
    pub(super) fn whole(&self, aim: Aim, far: f64) -> Result<(Program, Vec<Row>)> {
        let mut rows: Vec<Row> = Vec::new();
        for (kind, len) in self.kinds() {
            for i in (0..len).filter(|&i| self.fixed(kind, i) && !(kind == Kind::State && aim == Aim::Least)) {
                try_push(WHAT, &mut rows, (kind, i, 0))?;
            }
        }
        let equal = rows.len();
        for (kind, len) in self.kinds() {
            for i in (0..len).filter(|&i| !self.fixed(kind, i) || kind == Kind::State && aim == Aim::Least) {
                let (low, high) = self.limits(kind, i);
                for (side, limit) in [(1, high), (-1, low)] {
                    if limit.abs() <= far * self.unit(kind, i) {
                        try_push(WHAT, &mut rows, (kind, i, side))?;
                    }
                }
            }
        }
        let of_states = rows.iter().filter(|row| row.0 == Kind::State).count();
        let (variables, soft) = (self.steps * (self.n + self.m), self.soft.filter(|_| aim == Aim::Best));
        let more = if aim == Aim::Least {
            1
        } else if soft.is_some() {
            of_states
        } else {
            0
        };
        let mut program = self.program(more, aim == Aim::Best, true)?;
        let mut amount = variables;
        for (number, &(kind, i, side)) in rows.iter().enumerate() {
            let (low, high) = self.limits(kind, i);
            let right = if side < 0 { -low } else { high } + f64::from(side) * self.start(kind, i);
            let exceeded = (kind == Kind::State && more > 0).then_some(amount);
            self.limit(&mut program, (kind, i, side), right, exceeded, number < equal)?;
            if let (Some(soft), Some(at)) = (soft, exceeded) {
                program.weigh(at, &[soft], 1, 2.0 * self.unit(kind, i).powi(2) / self.scale())?;
                amount += 1;
            }
        }
        if aim == Aim::Least {
            program.linear[variables] = 1.0;
            program.row(&[(variables, -1.0)], 0.0, false)?;
            return Ok((program, rows));
        }
        let scale = self.scale();
        let of_states = &mut program.linear[self.steps * self.m..variables];
        self.weigh(self.h.reference, of_states);
        of_states.iter_mut().enumerate().for_each(|(i, q)| *q *= -2.0 * self.unit(Kind::State, i) / scale);
        Ok((program, rows))
    }

    /// `w = Q_k e(k)`, step by step.
    pub(super) fn weigh(&self, e: &[f64], w: &mut [f64]) {
        let n = self.n.max(1);
        for (t, (e, w)) in e.chunks_exact(n).zip(w.chunks_exact_mut(n)).enumerate() {
            let q = if t + 1 == self.steps { self.h.terminal } else { self.h.stage };
            for (row, w) in q.chunks_exact(n).zip(w) {
                *w = row.iter().zip(e).map(|(q, e)| q * e).sum();
            }
        }
    }

    /// Inputs, states, multipliers, and the limits whose multiplier is larger than the distance from them.
    pub(super) fn read(
        &self,
        point: &Point,
        rows: &[Row],
        aim: Aim,
    ) -> Result<(Vec<f64>, Vec<f64>, Multipliers, Held)> {
        let (mut u, mut x) = (try_zeros(WHAT, self.steps * self.m)?, try_zeros(WHAT, self.steps * self.n)?);
        u.iter_mut().zip(&point.z).enumerate().for_each(|(i, (u, z))| *u = z * self.unit(Kind::Input, i));
        let of_states = x.iter_mut().zip(&point.z[u.len()..]).enumerate();
        of_states.for_each(|(i, (x, z))| *x = z * self.unit(Kind::State, i));
        let (mut found, mut held) = (self.zeros()?, self.zeros()?);
        let scale = if aim == Aim::Least { largest(&self.size.0) } else { self.scale() };
        let skipped = self.steps * self.n;
        for (&(kind, i, side), (z, s)) in rows.iter().zip(point.multipliers.iter().zip(&point.slacks).skip(skipped)) {
            let sign = if side < 0 { -1.0 } else { 1.0 };
            found[kind as usize][i] += sign * z * scale / self.unit(kind, i);
            if side == 0 || z > s {
                held[kind as usize][i] = if side == 0 { 1 } else { side };
            }
        }
        Ok((u, x, found, held))
    }

    /// The step to the minimum where the held limits are equalities, from the residuals at `u`: `g` is the gradient
    /// with all multipliers; of states, and of their dynamics, what is not in it. The rows after those of the steps,
    /// and the unit of the solution; none if nothing is left to do.
    pub(super) fn face(
        &self,
        held: &Held,
        (u, x): (&[f64], &[f64]),
        g: &[f64],
        (of_states, dynamics): (&[f64], &[f64]),
    ) -> Result<Option<(Program, Vec<Row>, f64)>> {
        let mut program = self.program(0, true, false)?;
        let (mut rows, d): (Vec<Row>, _) = (Vec::new(), self.steps * self.m);
        for (kind, _) in self.kinds() {
            for (i, &side) in held[kind as usize].iter().enumerate() {
                if side == 0 {
                    continue;
                }
                if let (Kind::State, Some(soft)) = (kind, self.soft) {
                    program.weigh(d + i, &[soft], 1, 2.0 * self.unit(kind, i).powi(2) / self.scale())?;
                    continue;
                }
                let (low, high) = self.limits(kind, i);
                let right = if side < 0 { low } else { high } - self.value(kind, i, u, x);
                self.limit(&mut program, (kind, i, 0), right, None, true)?;
                try_push(WHAT, &mut rows, (kind, i, 0))?;
            }
        }
        let scale = self.scale();
        let of_inputs = program.linear.iter_mut().zip(g).enumerate();
        of_inputs.for_each(|(i, (q, g))| *q = g * self.unit(Kind::Input, i) / scale);
        for (i, (e, off)) in of_states.iter().zip(dynamics).enumerate() {
            program.linear[d + i] = e * self.unit(Kind::State, i) / scale;
            program.right[i] = off / self.unit(Kind::State, i);
        }
        let unit = largest(program.linear.iter().chain(&program.right));
        if unit == 0.0 {
            return Ok(None);
        }
        program.linear.iter_mut().chain(&mut program.right).for_each(|v| *v /= unit);
        Ok(Some((program, rows, unit)))
    }
}
