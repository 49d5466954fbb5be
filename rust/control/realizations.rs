//! `y^s = xf^s - A^s x0^s` for every realization, and the controls `u^s = B^+ y^s`.
//!
//! A singleton `x0^s` picks one column of `A^s`, and that column has one nonzero (columns scheme): `y^s` then has at most
//! two, and `u^s` is the sum of two scaled columns of `B^+`, `O(m)` per realization. Everything else goes through
//! blocks of dense `y` and one matrix product each.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::{Error, Result, checked_len, try_zeros};
use crate::fuse::Dense;
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::{Index, Singletons, with_indices};

/// Realizations of a vector or a matrix, or one that is known exactly. Matrices: row by row in `Exact` and `Dense`.
#[derive(Debug, Clone)]
pub enum Entity<'a> {
    /// The same for every realization.
    Exact(&'a [f64]),
    /// Arbitrary realizations.
    Dense(Dense<'a>),
    /// Singletons; of a matrix, one index per column, or with `rows` one per row.
    Singletons {
        /// The realizations.
        draws: Singletons,
        /// Whether the lines are the rows of the matrix.
        rows: bool,
    },
}

impl Entity<'_> {
    /// The number of realizations, if that is not arbitrary.
    pub fn size(&self) -> Option<usize> {
        match self {
            Self::Exact(_) => None,
            Self::Dense(samples) => Some(samples.size()),
            Self::Singletons { draws, .. } => Some(draws.size()),
        }
    }

    fn len(&self) -> usize {
        match self {
            Self::Exact(values) => values.len(),
            Self::Dense(samples) => samples.dim(),
            Self::Singletons { draws, .. } => draws.law().values().len(),
        }
    }
}

/// The paired realizations of `x0`, `xf` and `A` for a system with `n` states.
pub struct Realized<'a> {
    x0: Entity<'a>,
    xf: Entity<'a>,
    a: Entity<'a>,
    n: usize,
    size: usize,
    /// atoms of the singleton entities, empty otherwise
    atoms: [Vec<f64>; 3],
    /// `A x0` where both are exact: the same for every realization
    free: Option<Vec<f64>>,
}

/// Realizations treated together in the general case: their `y` fills part of a second-level cache.
const BLOCK: usize = 256;

impl<'a> Realized<'a> {
    /// Pairs the realizations by their index.
    ///
    /// # Errors
    /// [`Error::Shape`] if the entities' shapes or numbers of realizations differ.
    pub fn new(x0: Entity<'a>, xf: Entity<'a>, a: Entity<'a>, n: usize) -> Result<Self> {
        for (name, entity, len) in [("x0", &x0, n), ("xf", &xf, n), ("A", &a, checked_len("A", n, n)?)] {
            if entity.len() != len {
                return Err(Error::Shape { name, expected: format!("{len} entries"), found: entity.len().to_string() });
            }
        }
        let mut sizes = [("x0", &x0), ("xf", &xf), ("A", &a)].map(|(name, e)| (name, e.size()));
        sizes.sort_by_key(|(_, size)| size.is_none());
        let size = sizes[0].1.unwrap_or(1);
        if let Some((name, Some(other))) = sizes.into_iter().find(|(_, s)| s.is_some_and(|s| s != size)) {
            return Err(Error::Shape {
                name,
                expected: format!("as many realizations as `{}` ({size})", sizes[0].0),
                found: other.to_string(),
            });
        }
        let atoms = [&x0, &xf, &a].map(|entity| match entity {
            Entity::Singletons { draws, .. } => draws.law().atoms(),
            _ => Vec::new(),
        });
        let free = match (&x0, &a) {
            (Entity::Exact(x0), Entity::Exact(a)) => {
                Some(a.chunks_exact(n).map(|row| row.iter().zip(*x0).map(|(a, x)| a * x).sum()).collect())
            }
            _ => None,
        };
        Ok(Self { x0, xf, a, n, size, atoms, free })
    }

    /// Rough number of elementary operations for one `y^s`.
    pub fn cost(&self) -> f64 {
        let picks = |entity: &Entity| matches!(entity, Entity::Singletons { .. });
        let n = self.n as f64;
        if self.free.is_some() || picks(&self.x0) { n } else { n * n }
    }

    /// The number of paired realizations.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Calls `visit(row, value)` for the contributions to `y^s`; a row may be visited more than once.
    fn contributions(&self, s: usize, mut visit: impl FnMut(usize, f64)) {
        let index = |draws: &Singletons, at: usize| with_indices!(&**draws.indices(), v => v[at].get());
        match &self.xf {
            Entity::Exact(xf) => xf.iter().enumerate().for_each(|(i, v)| visit(i, *v)),
            Entity::Dense(xf) => xf.row(s).iter().enumerate().for_each(|(i, v)| visit(i, *v)),
            Entity::Singletons { draws, .. } => {
                let i = index(draws, s);
                visit(i, self.atoms[1][i]);
            }
        }
        if let Some(free) = &self.free {
            free.iter().enumerate().for_each(|(i, v)| visit(i, -v));
            return;
        }
        match &self.x0 {
            Entity::Exact(x0) => x0.iter().enumerate().for_each(|(i, v)| self.column(s, i, *v, &mut visit)),
            Entity::Dense(x0) => x0.row(s).iter().enumerate().for_each(|(i, v)| self.column(s, i, *v, &mut visit)),
            Entity::Singletons { draws, .. } => {
                let i = index(draws, s);
                self.column(s, i, self.atoms[0][i], &mut visit);
            }
        }
    }

    /// Minus `value` times column `i` of `A^s`.
    fn column(&self, s: usize, i: usize, value: f64, visit: &mut impl FnMut(usize, f64)) {
        let n = self.n;
        if value == 0.0 {
            return;
        }
        match &self.a {
            Entity::Exact(a) => (0..n).for_each(|r| visit(r, -value * a[r * n + i])),
            Entity::Dense(a) => (0..n).for_each(|r| visit(r, -value * a.row(s)[r * n + i])),
            Entity::Singletons { draws, rows: false } => {
                let r = with_indices!(&**draws.indices(), v => v[s * n + i].get());
                visit(r, -value * self.atoms[2][i * n + r]);
            }
            Entity::Singletons { draws, rows: true } => with_indices!(&**draws.indices(), v => {
                for (r, picked) in v[s * n..(s + 1) * n].iter().enumerate() {
                    if picked.get() == i {
                        visit(r, -value * self.atoms[2][r * n + i]);
                    }
                }
            }),
        }
    }

    /// `(1/N) sum_s y^s`, in one pass and without a dense realization.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after a stop.
    pub fn mean(&self, stop: &Stop) -> Result<Vec<f64>> {
        let mut sum = vec![0.0; self.n];
        for s in 0..self.size {
            stop.check()?;
            self.contributions(s, |i, v| sum[i] += v);
        }
        sum.iter_mut().for_each(|v| *v /= self.size as f64);
        Ok(sum)
    }

    /// The controls `B^+ y^s`, one row of `m` per realization. `pinv` is `B^+`, row by row (`m x n`).
    ///
    /// # Errors
    /// [`Error::Interrupted`] after a stop, [`Error::Memory`] if the controls do not fit, [`Error::Overflow`] if one of
    /// them is no finite number.
    pub fn controls(&self, pinv: &[f64], m: usize, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
        let n = self.n;
        let mut out = try_zeros("the controls", checked_len("the controls", self.size, m)?)?;
        // rows of the transpose are the contiguous columns of B^+
        let transposed: Vec<f64> = (0..n * m).map(|k| pinv[(k % m) * n + k / m]).collect();
        let is_singleton = |entity: &Entity| matches!(entity, Entity::Singletons { rows: false, .. });
        let sparse = is_singleton(&self.x0) && is_singleton(&self.a) && !matches!(self.xf, Entity::Dense(_));
        let base = match &self.xf {
            Entity::Exact(xf) if sparse => combine_rows(&transposed, m, xf),
            _ => vec![0.0; m],
        };
        for_each_chunk(out.chunks_mut(BLOCK * m).enumerate(), threads, stop, |(block, out)| {
            let first = block * BLOCK;
            if sparse {
                out.chunks_exact_mut(m)
                    .enumerate()
                    .for_each(|(at, u)| self.sparse_control(first + at, &transposed, &base, u));
            } else {
                let count = out.len() / m;
                let mut y = vec![0.0; count * n];
                for (at, y) in y.chunks_exact_mut(n).enumerate() {
                    stop.check()?;
                    self.contributions(first + at, |i, v| y[i] += v);
                }
                // U = Y (B^+)^T
                matmul(
                    MatMut::from_row_major_slice_mut(out, count, m),
                    Accum::Replace,
                    MatRef::from_row_major_slice(&y, count, n),
                    MatRef::from_row_major_slice(&transposed, n, m),
                    1.0,
                    Par::Seq,
                );
            }
            // while the block is in the cache
            if out.iter().all(|u| u.is_finite()) { Ok(()) } else { Err(Error::Overflow { what: "a control" }) }
        })?;
        Ok(out)
    }

    /// `u = base + a P[r1] + b P[r2]` for singletons; an exact `xf` is in `base`.
    #[inline]
    fn sparse_control(&self, s: usize, transposed: &[f64], base: &[f64], u: &mut [f64]) {
        let m = u.len();
        u.copy_from_slice(base);
        let mut add = |row: usize, value: f64| {
            u.iter_mut().zip(&transposed[row * m..(row + 1) * m]).for_each(|(u, p)| *u += value * p);
        };
        if let Entity::Singletons { draws, .. } = &self.xf {
            let i = with_indices!(&**draws.indices(), v => v[s].get());
            add(i, self.atoms[1][i]);
        }
        if let Entity::Singletons { draws, .. } = &self.x0 {
            let i = with_indices!(&**draws.indices(), v => v[s].get());
            self.column(s, i, self.atoms[0][i], &mut add);
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
