//! Errors of inputs within limits whose estimates are drawn anew.

use super::errors::measured;
use super::map::{Horizon, REGULAR, WHAT, condense, pushes, seen};
use crate::error::Result;
use crate::limits::batch::single;
use crate::limits::bounds::Bounds;
use crate::limits::dense::Dense;
use crate::limits::linear::{decomposition, times};
use crate::limits::search::Search;
use crate::limits::solve::{Penalty, aim, stacked};
use crate::memory::{checked_len, try_copy, try_extend, try_filled, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::Law;
use crate::simulate::{Average, Exact, PlanEntity, Plans};
use crate::{Key, Scheme, vector};

/// Draws that one thread takes at a time.
const CHUNK: usize = 64;

/// An entity as lines, and the number of realizations and the scheme of an average that every run draws anew.
#[derive(Debug, Clone, Copy)]
pub struct DrawnEntity<'a> {
    /// The lines: of a matrix its columns, or its rows where they are drawn.
    pub lines: &'a [f64],
    /// The length of a line.
    pub length: usize,
    /// None: the values themselves.
    pub drawn: Option<(u64, Scheme)>,
}

impl DrawnEntity<'_> {
    /// What [`Plans`] draws.
    ///
    /// # Errors
    /// As [`Law::new`] and [`Average::new`].
    pub fn estimate(&self) -> Result<PlanEntity> {
        let lines = try_copy(WHAT, self.lines)?;
        Ok(match self.drawn {
            None => PlanEntity::Fixed(lines),
            Some((size, scheme)) => {
                let law = Law::new(lines, self.lines.len() / self.length.max(1), self.length)?;
                PlanEntity::Drawn(Average::new(law, size, scheme)?)
            }
        })
    }

    /// Each line between zeros, and as many lines of zeros: `diag(0, A)` of a matrix.
    fn padded(&self, before: usize, after: usize, above: usize) -> Result<PlanEntity> {
        let length = before + self.length + after;
        let count = above + self.lines.len() / self.length.max(1);
        let mut lines = try_zeros(WHAT, checked_len(WHAT, count, length)?)?;
        for (line, from) in lines.chunks_exact_mut(length).skip(above).zip(self.lines.chunks_exact(self.length)) {
            line[before..before + self.length].copy_from_slice(from);
        }
        DrawnEntity { lines: &lines, length, drawn: self.drawn }.estimate()
    }
}

/// How many runs, their key, and the threads that take them.
#[derive(Debug, Clone, Copy)]
pub struct Runs<'a> {
    /// Runs.
    pub count: usize,
    /// Run s depends on the key and s alone.
    pub key: &'a Key,
    /// At most so many.
    pub threads: usize,
}

/// A dense problem whose map and `y` change from one run to the next.
struct Problem<'a> {
    dense: Dense,
    search: Search,
    rows: usize,
    bounds: Bounds<'a>,
}

impl<'a> Problem<'a> {
    fn new(map: &[f64], r: Penalty<'_>, bounds: Bounds<'a>, d: usize) -> Result<Self> {
        let (dense, rows) = stacked(map, d, r)?;
        Ok(Self { dense, search: Search::new(d)?, rows, bounds })
    }

    fn solve(&mut self, map: &[f64], y: &[f64], u: &mut [f64], stop: &Stop) -> Result<()> {
        self.dense.set_above(map)?;
        aim(&mut self.dense, self.rows, y)?;
        single(&mut self.dense, &mut self.search, self.bounds, u, None, stop)
    }
}

impl Horizon {
    /// `||P_Q (b^ - b)||_Q` for the runs, P_Q onto the range of the map, `b_k = r(k) - A^k x0`; with soft limits of
    /// states `||dc||_W + ||dr||_Q`, `c_k = A^k x0`. `values` are the exact `x0` and `xf`; `rows`: lines of `A` are
    /// rows; `paired`: as in [`Plans`].
    ///
    /// # Errors
    /// As [`Plans::errors`].
    pub fn moved_targets(
        &self,
        [x0, xf, a]: [DrawnEntity<'_>; 3],
        (rows, paired): (bool, bool),
        values: [&[f64]; 2],
        runs: Runs<'_>,
        stop: &Stop,
    ) -> Result<Vec<f64>> {
        let (n, soft) = (self.n, self.task.soft.is_some());
        let range = decomposition(self.map()?, self.steps * self.m)?; // U' of the range of the map
        let goal = self.goal()?;
        let through = |m: &[f64]| times(&range.u, m, self.rows());
        // a problem of twice as many states has x0 and xf apart: (xf, -A x0), or (xf, -x0) where A is exact
        let twice = self.steps > 1 || soft;
        let (plans, basis, scale, y);
        if twice {
            let one = self.steps == 1;
            let mut identity = try_zeros(WHAT, n * n)?;
            identity.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
            let matrix = if one { a } else { DrawnEntity { lines: &identity, length: n, drawn: None } };
            plans = Plans::new(x0.padded(n, 0, 0)?, xf.padded(0, n, 0)?, matrix.padded(n, 0, n)?, rows, paired)?;
            let moved = if one { times(&self.a, values[0], n)? } else { try_copy(WHAT, values[0])? };
            let mut both = try_copy(WHAT, values[1])?;
            try_extend(WHAT, &mut both, moved.iter().map(|v| -v))?;
            y = both;
            if soft {
                let mut above = try_zeros(WHAT, n * n)?;
                try_extend(WHAT, &mut above, identity)?;
                let curved = self.curved_state(if one { &above } else { self.powers()? })?;
                let (first, second) = (beside(&[], &curved, n)?, beside(&goal, &[], n)?);
                // an infinite unit leaves ||dc||_W in the second number
                let mut units = try_filled(WHAT, 1.0, curved.len() / n)?;
                try_extend(WHAT, &mut units, (0..goal.len() / n).map(|_| f64::INFINITY))?;
                let mut all = first;
                try_extend(WHAT, &mut all, second)?;
                (basis, scale) = (all, units);
            } else {
                basis = beside(&through(&goal)?, &through(&self.state()?)?, n)?;
                scale = try_filled(WHAT, 1.0, range.s.len())?;
            }
        } else {
            plans = Plans::new(x0.estimate()?, xf.estimate()?, a.estimate()?, rows, paired)?;
            let mut left = try_copy(WHAT, values[1])?;
            left.iter_mut().zip(times(&self.a, values[0], n)?).for_each(|(xf, x)| *xf -= x);
            (y, basis, scale) = (left, through(&goal)?, try_filled(WHAT, 1.0, range.s.len())?);
        }
        if basis.is_empty() {
            return try_zeros(WHAT, runs.count);
        }
        let exact = Exact::OneStep { basis: &basis, singular_values: &scale, y: &y };
        let found = plans.errors(exact, runs.count, runs.key, runs.threads, stop)?;
        let mut all = try_zeros(WHAT, runs.count)?;
        for (all, pair) in all.iter_mut().zip(found.chunks_exact(2)) {
            let (whole, part) = (pair[0], pair[1]);
            *all = if soft { part + (whole * whole - part * part).max(0.0).sqrt() } else { whole };
        }
        Ok(all)
    }

    /// `F_k` below each other: what `xf` at all steps is multiplied by in y.
    pub(super) fn goal(&self) -> Result<Vec<f64>> {
        let mut all = Vec::new();
        for k in 1..=self.steps {
            try_extend(WHAT, &mut all, self.roots[usize::from(k == self.steps)].iter().copied())?;
        }
        Ok(all)
    }

    /// Sizes of which the rounding of errors is a share: `||M||_F`, `||F A^k||_F` and `||F||_F` over all steps.
    ///
    /// # Errors
    /// As [`Self::powers`].
    pub fn norms(&self) -> Result<[f64; 3]> {
        Ok([vector::norm(self.map()?), vector::norm(&self.state()?), vector::norm(&self.goal()?)])
    }

    /// `||M (u - v)||`, `||u - v||_2` and `J(u) - J(v)` for the runs: v is the best of the exact system, u that of the
    /// estimates which the run draws. With `follows` all references are the `xf` of the run. Without an R of the task
    /// (`auto`) each run has its own, in u and in v.
    ///
    /// # Errors
    /// As [`Plans::errors`] and [`super::super::box_batch`].
    pub fn drawn_errors(
        &self,
        plans: &Plans,
        x0: &[f64],
        (follows, auto): (bool, bool),
        runs: Runs<'_>,
        stop: &Stop,
    ) -> Result<Vec<f64>> {
        let (n, m, steps, d) = (self.n, self.m, self.steps, self.steps * self.m);
        let (map, rows, cost) = (self.map()?, self.rows(), self.cost()?);
        let (mut best_y, free) = (self.target()?, times(&self.state()?, x0, n)?);
        best_y.iter_mut().zip(&free).for_each(|(y, x)| *y -= x);
        let bounds = Bounds::new(&self.task.low, &self.task.high, d)?;
        let zero = try_zeros(WHAT, d)?;
        // with an R of its own each run has sqrt(R) I below the map
        let height = if auto { rows + d } else { rows };
        let (mut wide, mut wide_y) = (try_zeros(WHAT, checked_len(WHAT, height, d)?)?, try_zeros(WHAT, height)?);
        wide[..rows * d].copy_from_slice(map);
        wide_y[..rows].copy_from_slice(&best_y);
        let penalty = if auto { Penalty::Diagonal(&zero) } else { Self::penalty(&cost) };
        let mut best = try_zeros(WHAT, d)?;
        if !auto {
            Problem::new(map, penalty, bounds, d)?.solve(map, &best_y, &mut best, stop)?;
        }
        let mut errors = try_zeros(WHAT, checked_len(WHAT, runs.count, 3)?)?;
        for_each_chunk(errors.chunks_mut(3 * CHUNK).enumerate(), runs.threads, stop, |(chunk, errors)| {
            let drawn = plans.estimates(chunk * CHUNK, errors.len() / 3, runs.key, stop)?;
            let mut problem = Problem::new(&wide, penalty, bounds, d)?;
            let (mut best_wide, mut own) = (try_copy(WHAT, &wide)?, try_copy(WHAT, &wide)?);
            let (mut v, mut u) = (try_copy(WHAT, &best)?, try_zeros(WHAT, d)?);
            let mut y = try_zeros(WHAT, height)?;
            for (errors, drawn) in errors.chunks_exact_mut(3).zip(drawn.chunks_exact(n * (n + 2))) {
                stop.check()?;
                let (start, rest) = drawn.split_at(n);
                let (goal, a) = rest.split_at(n);
                let pushes = pushes(a, &self.b, n, steps)?;
                let seen = [seen(&self.roots[0], &pushes, n, m)?, seen(&self.roots[1], &pushes, n, m)?];
                condense([&seen[0], &seen[1]], m, steps, &mut own[..rows * d]);
                y[..rows].copy_from_slice(&self.aimed(a, start, follows.then_some(goal))?);
                let mut r = (&cost.0[..], cost.1);
                let mut diagonal = Vec::new();
                if auto {
                    let size = vector::dot(&own[..rows * d], &own[..rows * d]);
                    let share = if size == 0.0 { 1.0 } else { REGULAR * size / d as f64 };
                    for map in [&mut best_wide, &mut own] {
                        map[rows * d..].iter_mut().step_by(d + 1).for_each(|v| *v = share.sqrt());
                    }
                    problem.solve(&best_wide, &wide_y, &mut v, stop)?;
                    diagonal = try_filled(WHAT, share, d)?;
                    r = (&diagonal, true);
                }
                problem.solve(&own, &y, &mut u, stop)?;
                errors.copy_from_slice(&measured(map, &best_y, r, &u, &v)?);
                drop(diagonal);
            }
            Ok(())
        })?;
        Ok(errors)
    }

    /// `F_k (r(k) - A^k x0)` of another `A` and `x0`; with `goal` that is the reference of all steps.
    fn aimed(&self, a: &[f64], x0: &[f64], goal: Option<&[f64]>) -> Result<Vec<f64>> {
        let n = self.n;
        let (mut left, mut x) = (try_copy(WHAT, &self.task.reference)?, try_copy(WHAT, x0)?);
        for left in left.chunks_exact_mut(n) {
            x = times(a, &x, n)?;
            if let Some(goal) = goal {
                left.copy_from_slice(goal);
            }
            left.iter_mut().zip(&x).for_each(|(r, x)| *r -= x);
        }
        self.weighted(&left)
    }
}

/// `[a b]`, each (rows, n) or zeros where it is empty.
fn beside(a: &[f64], b: &[f64], n: usize) -> Result<Vec<f64>> {
    let mut all = try_zeros(WHAT, checked_len(WHAT, a.len().max(b.len()), 2)?)?;
    for (i, row) in all.chunks_exact_mut(2 * n).enumerate() {
        for (part, to) in [a, b].into_iter().zip(row.chunks_exact_mut(n)) {
            if !part.is_empty() {
                to.copy_from_slice(&part[i * n..(i + 1) * n]);
            }
        }
    }
    Ok(all)
}
