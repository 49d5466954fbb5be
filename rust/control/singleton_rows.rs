//! Controls of singletons: `u^s = Q[f] + w P[r]`, with `P` the columns of `B^+` and `Q` those scaled by the atoms of `xf`.
//!
//! A block is done in two passes: which rows and what factor (a few scattered bytes of the indices each, all of them on
//! their way at once), then the sums, which are bound by how fast `u` can be stored.

use super::realizations::{Entity, Realized};
use crate::sample::{Index, Singletons, with_indices};

/// What every control of singletons is made of.
pub(super) struct Picks<'a> {
    x0: &'a Singletons,
    a: &'a Singletons,
    /// which row of `goals`; the only one where `xf` is exact
    xf: Option<&'a Singletons>,
    /// atoms of `x0` and of `A`
    start: &'a [f64],
    matrix: &'a [f64],
    /// `B^+ xf` for each value of `xf`
    goals: Vec<f64>,
    /// columns of `B^+`
    columns: &'a [f64],
    n: usize,
    m: usize,
}

/// `u^s = goals[goal] + factor columns[column]`
#[derive(Clone, Copy, Default)]
struct Pick {
    goal: usize,
    column: usize,
    factor: f64,
}

impl<'a> Picks<'a> {
    /// None where `x0` or `A` has other realizations than singletons (of the columns), or `xf` is dense.
    pub(super) fn new(realized: &'a Realized<'_>, columns: &'a [f64], m: usize) -> Option<Self> {
        let (Entity::Singletons { draws: x0, rows: false }, Entity::Singletons { draws: a, rows: false }) =
            (&realized.x0, &realized.a)
        else {
            return None;
        };
        let (xf, goals) = match &realized.xf {
            Entity::Dense(_) => return None,
            Entity::Exact(goal) => (None, combine_rows(columns, m, goal)),
            Entity::Singletons { draws, .. } => {
                let rows = columns.chunks_exact(m).zip(&realized.atoms[1]);
                (Some(draws), rows.flat_map(|(row, atom)| row.iter().map(move |p| atom * p)).collect())
            }
        };
        let (start, matrix) = (&realized.atoms[0][..], &realized.atoms[2][..]);
        Some(Self { x0, a, xf, start, matrix, goals, columns, n: realized.n, m })
    }

    /// A bound on the entries of all controls: where it is finite, so are they.
    pub(super) fn bound(&self) -> f64 {
        // f64::max would pass over NaN
        let largest = |values: &[f64]| values.iter().fold(0.0_f64, |m, v| if v.abs() <= m { m } else { v.abs() });
        largest(&self.goals) + largest(self.start) * largest(self.matrix) * largest(self.columns)
    }

    /// The controls of the realizations from `first` on, as many as `out` has rows for.
    pub(super) fn controls(&self, first: usize, out: &mut [f64]) {
        let mut picks = [Pick::default(); super::batch::BLOCK];
        let picks = &mut picks[..out.len() / self.m];
        with_indices!(&**self.x0.indices(), x0 => with_indices!(&**self.a.indices(), a => {
            let lines = a[first * self.n..].chunks_exact(self.n);
            for ((pick, i), line) in picks.iter_mut().zip(&x0[first..]).zip(lines) {
                let (i, r) = (i.get(), line[i.get()].get());
                // minus column i of A^s, which has its one nonzero in row r, times x0_i
                *pick = Pick { goal: 0, column: r, factor: -self.start[i] * self.matrix[i * self.n + r] };
            }
        }));
        if let Some(xf) = self.xf {
            with_indices!(&**xf.indices(), xf => {
                picks.iter_mut().zip(&xf[first..]).for_each(|(pick, i)| pick.goal = i.get());
            });
        }
        macro_rules! by_width {
            ($($width:literal)*) => {
                match self.m {
                    $($width => self.sums::<$width>(picks, out),)*
                    _ => self.wide_sums(picks, out),
                }
            };
        }
        by_width!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16);
    }

    /// The sums, with the number of inputs known to the compiler.
    fn sums<const M: usize>(&self, picks: &[Pick], out: &mut [f64]) {
        let (goals, columns) = (self.goals.as_chunks::<M>().0, self.columns.as_chunks::<M>().0);
        for (u, pick) in out.as_chunks_mut::<M>().0.iter_mut().zip(picks) {
            let (goal, column) = (&goals[pick.goal], &columns[pick.column]);
            for j in 0..M {
                u[j] = goal[j] + pick.factor * column[j];
            }
        }
    }

    /// The same for many inputs.
    fn wide_sums(&self, picks: &[Pick], out: &mut [f64]) {
        let m = self.m;
        for (u, pick) in out.chunks_exact_mut(m).zip(picks) {
            let (goal, column) = (&self.goals[pick.goal * m..][..m], &self.columns[pick.column * m..][..m]);
            for ((u, q), p) in u.iter_mut().zip(goal).zip(column) {
                *u = q + pick.factor * p;
            }
        }
    }
}

/// `sum_i v_i P[i]`
fn combine_rows(rows: &[f64], m: usize, v: &[f64]) -> Vec<f64> {
    let mut sum = vec![0.0; m];
    for (row, v) in rows.chunks_exact(m).zip(v) {
        sum.iter_mut().zip(row).for_each(|(s, p)| *s += v * p);
    }
    sum
}
