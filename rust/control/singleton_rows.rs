//! Controls of singletons: `u^s = Q[f] + w P[r]`, with `P` the columns of `B^+` and `Q` those scaled by the atoms of `xf`.
//!
//! One pass of additions: bound by how fast the indices of `A` come and `u` can be stored. (Asking for the indices ahead of
//! time, and collecting the factors of a block first, were slower.)

use super::realizations::{Entity, Realized};
use crate::sample::{Index, Indices};

/// What every control of singletons is made of.
pub(super) struct Picks<'a> {
    x0: &'a Indices,
    a: &'a Indices,
    /// which row of `goals`
    xf: &'a Indices,
    /// minus the entry of `x0` times that of `A`, for every index of both
    factors: Vec<f64>,
    /// `B^+ xf` for each value of `xf`
    goals: Vec<f64>,
    /// columns of `B^+`
    columns: &'a [f64],
    n: usize,
    m: usize,
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
            // any index will do: all rows are the same
            Entity::Exact(goal) => (x0, combine_rows(columns, m, goal).repeat(realized.n)),
            Entity::Singletons { draws, .. } => {
                let rows = columns.chunks_exact(m).zip(&realized.atoms[1]);
                (draws, rows.flat_map(|(row, atom)| row.iter().map(move |p| atom * p)).collect())
            }
        };
        // column i of A^s has its one nonzero in row r
        let n = realized.n;
        let columns_of_a = realized.atoms[2].chunks_exact(n).zip(&realized.atoms[0]);
        let factors = columns_of_a.flat_map(|(column, x)| column.iter().map(move |a| -x * a)).collect();
        Some(Self { x0: x0.indices(), a: a.indices(), xf: xf.indices(), factors, goals, columns, n, m })
    }

    /// A bound on the entries of all controls: where it is finite, so are they.
    pub(super) fn bound(&self) -> f64 {
        // f64::max would pass over NaN
        let largest = |values: &[f64]| values.iter().fold(0.0_f64, |m, v| if v.abs() <= m { m } else { v.abs() });
        largest(&self.goals) + largest(&self.factors) * largest(self.columns)
    }

    /// The controls of the realizations from `first` on, as many as `out` has rows for.
    pub(super) fn controls(&self, first: usize, out: &mut [f64]) {
        // lines of one length have indices of one width
        match (self.x0, self.xf, self.a) {
            (Indices::U8(x0), Indices::U8(xf), Indices::U8(a)) => self.rows(first, x0, xf, a, out),
            (Indices::U16(x0), Indices::U16(xf), Indices::U16(a)) => self.rows(first, x0, xf, a, out),
            (Indices::U32(x0), Indices::U32(xf), Indices::U32(a)) => self.rows(first, x0, xf, a, out),
            _ => unreachable!("x0, xf and the columns of A have the same length"),
        }
    }

    fn rows<I: Index>(&self, first: usize, x0: &[I], xf: &[I], a: &[I], out: &mut [f64]) {
        let (x0, xf, a) = (&x0[first..], &xf[first..], &a[first * self.n..]);
        macro_rules! by_width {
            ($($width:literal)*) => {
                match self.m {
                    $($width => self.sums::<I, $width>(x0, xf, a, out),)*
                    _ => self.wide_sums(x0, xf, a, out),
                }
            };
        }
        by_width!(1 2 3 4 5 6 7 8 9 10 11 12 16);
    }

    /// The sums, with the number of inputs known to the compiler.
    fn sums<I: Index, const M: usize>(&self, x0: &[I], xf: &[I], a: &[I], out: &mut [f64]) {
        let (goals, columns, n) = (self.goals.as_chunks::<M>().0, self.columns.as_chunks::<M>().0, self.n);
        let indices = x0.iter().zip(xf).zip(a.chunks_exact(n));
        for (u, ((i, f), line)) in out.as_chunks_mut::<M>().0.iter_mut().zip(indices) {
            let r = line[i.get()].get();
            let factor = self.factors[i.get() * n + r];
            let (goal, column) = (&goals[f.get()], &columns[r]);
            for j in 0..M {
                u[j] = goal[j] + factor * column[j];
            }
        }
    }

    /// The same for any number.
    fn wide_sums<I: Index>(&self, x0: &[I], xf: &[I], a: &[I], out: &mut [f64]) {
        let (m, n) = (self.m, self.n);
        let indices = x0.iter().zip(xf).zip(a.chunks_exact(n));
        for (u, ((i, f), line)) in out.chunks_exact_mut(m).zip(indices) {
            let r = line[i.get()].get();
            let factor = self.factors[i.get() * n + r];
            let (goal, column) = (&self.goals[f.get() * m..][..m], &self.columns[r * m..][..m]);
            for ((u, q), p) in u.iter_mut().zip(goal).zip(column) {
                *u = q + factor * p;
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
