//! Controls of singletons: `u^s = Q[f] + w P[r]`, with `P` the columns of `B^+` and `Q` those scaled by the atoms of
//! `xf`.
//!
//! One pass of additions, limited by reading the indices of `A` and storing `u`. (Collecting the factors of a block
//! first was slower.)

use super::realizations::{Entity, Realized};
use crate::error::Result;
use crate::memory::{try_copy, try_zeros};
use crate::nontemporal::{Through, Writer, past};
use crate::sample::{Index, Indices};

/// Prefetch distance in realizations: the controls computed during one load from memory, with some margin.
const AHEAD: usize = 64;

const WHAT: &str = "the tables of the controls";

/// The tables that every control of singletons is computed from.
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
    /// None if `x0` or `A` has realizations other than singletons (by columns), or `xf` is dense.
    pub(super) fn new(realized: &'a Realized<'_>, columns: &'a [f64], m: usize) -> Result<Option<Self>> {
        let (Entity::Singletons { draws: x0, rows: false }, Entity::Singletons { draws: a, rows: false }) =
            (&realized.x0, &realized.a)
        else {
            return Ok(None);
        };
        let (xf, goals) = match &realized.xf {
            Entity::Dense(_) => return Ok(None),
            // any index will do: all rows are equal
            Entity::Exact(goal) => {
                let mut goals = try_zeros(WHAT, columns.len())?;
                let (first, others) = goals.split_at_mut(m);
                combine_rows(columns, goal, first);
                others.chunks_exact_mut(m).for_each(|other| other.copy_from_slice(first));
                (x0, goals)
            }
            Entity::Singletons { draws, .. } => {
                let mut goals = try_copy(WHAT, columns)?;
                let rows = goals.chunks_exact_mut(m).zip(&realized.atoms[1]);
                rows.for_each(|(row, atom)| row.iter_mut().for_each(|p| *p *= atom));
                (draws, goals)
            }
        };
        // column i of A^s has its one nonzero in row r
        let n = realized.n;
        let mut factors = try_copy(WHAT, &realized.atoms[2])?;
        let columns_of_a = factors.chunks_exact_mut(n).zip(&realized.atoms[0]);
        columns_of_a.for_each(|(column, x)| column.iter_mut().for_each(|a| *a *= -x));
        Ok(Some(Self { x0: x0.indices(), a: a.indices(), xf: xf.indices(), factors, goals, columns, n, m }))
    }

    /// A bound on the entries of all controls: if it is finite, all controls are.
    pub(super) fn bound(&self) -> f64 {
        // f64::max would ignore NaN
        let largest = |values: &[f64]| values.iter().fold(0.0_f64, |m, v| if v.abs() <= m { m } else { v.abs() });
        largest(&self.goals) + largest(&self.factors) * largest(self.columns)
    }

    /// The controls of the realizations from `first` on, as many as `out` has rows; past the caches if `large`.
    pub(super) fn controls(&self, first: usize, out: &mut [f64], large: bool) {
        if large { past(|to| self.by_index(first, out, to)) } else { self.by_index(first, out, &Through) }
    }

    fn by_index(&self, first: usize, out: &mut [f64], to: &impl Writer) {
        // lines of one length have indices of one width
        match (self.x0, self.xf, self.a) {
            (Indices::U8(x0), Indices::U8(xf), Indices::U8(a)) => self.rows([x0, xf, a], first, out, to),
            (Indices::U16(x0), Indices::U16(xf), Indices::U16(a)) => self.rows([x0, xf, a], first, out, to),
            (Indices::U32(x0), Indices::U32(xf), Indices::U32(a)) => self.rows([x0, xf, a], first, out, to),
            _ => unreachable!("x0, xf and the columns of A have the same length"),
        }
    }

    fn rows<I: Index>(&self, [x0, xf, a]: [&[I]; 3], first: usize, out: &mut [f64], to: &impl Writer) {
        let indices = [&x0[first..], &xf[first..], &a[first * self.n..]];
        macro_rules! by_width {
            ($($width:literal)*) => {
                match self.m {
                    $($width => self.sums::<I, $width>(indices, out, to),)*
                    _ => self.wide_sums(indices, out, to),
                }
            };
        }
        by_width!(1 2 3 4 5 6 7 8 9 10 11 12 16);
    }

    /// For each `u`: the goal, the column of `B^+`, and its factor.
    #[inline(always)]
    fn each<I: Index, U>(
        &self,
        [x0, xf, a]: [&[I]; 3],
        out: impl Iterator<Item = U>,
        to: &impl Writer,
        mut sum: impl FnMut(U, usize, usize, f64),
    ) {
        let (n, mut line) = (self.n, 0_usize);
        for (s, u) in out.enumerate() {
            let i = x0[s].get();
            if let Some(next) = x0.get(s + AHEAD) {
                // a hint: any position will do
                to.prefetch(a, line.wrapping_add(AHEAD.wrapping_mul(n)).wrapping_add(next.get()));
            }
            let r = a[line.wrapping_add(i)].get();
            // no overflow, because all indices are below n
            sum(u, xf[s].get(), r, self.factors[i.wrapping_mul(n).wrapping_add(r)]);
            line = line.wrapping_add(n);
        }
    }

    /// The sums, with the number of inputs known at compile time.
    fn sums<I: Index, const M: usize>(&self, indices: [&[I]; 3], out: &mut [f64], to: &impl Writer) {
        let (goals, columns) = (self.goals.as_chunks::<M>().0, self.columns.as_chunks::<M>().0);
        self.each(indices, out.as_chunks_mut::<M>().0.iter_mut(), to, |u, f, r, factor| {
            let (goal, column) = (&goals[f], &columns[r]);
            to.write(u, std::array::from_fn(|j| goal[j] + factor * column[j]));
        });
    }

    /// The same for any number of inputs.
    fn wide_sums<I: Index>(&self, indices: [&[I]; 3], out: &mut [f64], to: &impl Writer) {
        let m = self.m;
        self.each(indices, out.chunks_exact_mut(m), to, |u, f, r, factor| {
            let (goals, goal_rest) = self.goals[f * m..][..m].as_chunks::<8>();
            let (columns, column_rest) = self.columns[r * m..][..m].as_chunks::<8>();
            let (eights, rest) = u.as_chunks_mut::<8>();
            for ((u, goal), column) in eights.iter_mut().zip(goals).zip(columns) {
                to.write(u, std::array::from_fn(|j| goal[j] + factor * column[j]));
            }
            for ((u, q), p) in rest.iter_mut().zip(goal_rest).zip(column_rest) {
                to.write(std::array::from_mut(u), [q + factor * p]);
            }
        });
    }
}

/// Adds `sum_i v_i P[i]`.
fn combine_rows(rows: &[f64], v: &[f64], sum: &mut [f64]) {
    for (row, v) in rows.chunks_exact(sum.len()).zip(v) {
        sum.iter_mut().zip(row).for_each(|(s, p)| *s += v * p);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{Key, Law, Scheme, Stop, sample};

    /// Stores past the caches give the same controls, for any number of inputs, both index widths and any first
    /// realization.
    #[test]
    fn large_controls_are_the_same() {
        let size = 3 * AHEAD;
        let number = |k: usize| 0.1 + (k as f64 * 0.754_877).fract();
        for n in [3, 300] {
            let draw = |lines: usize, seed| {
                let law = Law::new((0..lines * n).map(number).collect(), lines, n).unwrap();
                let draws = sample(&Arc::new(law), size, Scheme::Iid, &Key([seed; 32]), 1, &Stop::new()).unwrap();
                Entity::Singletons { draws, rows: false }
            };
            let realized = Realized::new(draw(1, 1), draw(1, 2), draw(n, 3), n).unwrap();
            for m in (1..=17).chain([27]) {
                let columns: Vec<f64> = (0..n * m).map(number).collect();
                let picks = Picks::new(&realized, &columns, m).unwrap().unwrap();
                for (first, count, shift) in [(0, size, 0), (5, size - 5, 1), (size - 7, 7, 0), (3, 1, 1)] {
                    // one double further on is another position within a cache line
                    let mut large = vec![f64::NAN; count * m + 1];
                    let mut usual = vec![f64::NAN; count * m];
                    picks.controls(first, &mut large[shift..][..count * m], true);
                    picks.controls(first, &mut usual, false);
                    assert_eq!(large[shift..][..count * m], usual, "n = {n}, m = {m}, first = {first}");
                    assert!(large[if shift == 0 { count * m } else { 0 }].is_nan());
                }
            }
        }
    }
}
