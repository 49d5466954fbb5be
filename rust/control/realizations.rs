//! The paired realizations of a control problem, and the mean of `y^s = xf^s - A^s x0^s`.

use crate::error::{Error, Result, sized};
use crate::fuse::Dense;
use crate::memory::{checked_len, try_collect, try_zeros};
use crate::parallel::Stop;
use crate::sample::{Index, Singletons, with_indices};

/// Realizations of a vector or a matrix, or its exact value. Matrices: row by row in `Exact` and `Dense`.
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
        /// Whether the lines are the rows of the matrix (otherwise the columns).
        rows: bool,
    },
}

impl Entity<'_> {
    /// The number of realizations; none for an exact value.
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
#[derive(Debug)]
pub struct Realized<'a> {
    pub(super) x0: Entity<'a>,
    pub(super) xf: Entity<'a>,
    pub(super) a: Entity<'a>,
    pub(super) n: usize,
    pub(super) size: usize,
    /// atoms of the singleton entities, empty otherwise
    pub(super) atoms: [Vec<f64>; 3],
    /// `A x0` where both are exact: the same for every realization
    free: Option<Vec<f64>>,
}

impl<'a> Realized<'a> {
    /// Pairs the realizations by their index.
    ///
    /// # Errors
    /// [`Error::Shape`] if the entities' shapes or numbers of realizations differ.
    pub fn new(x0: Entity<'a>, xf: Entity<'a>, a: Entity<'a>, n: usize) -> Result<Self> {
        for (name, entity, len) in [("x0", &x0, n), ("xf", &xf, n), ("A", &a, checked_len("A", n, n)?)] {
            sized(name, entity.len(), len)?;
        }
        let mut sizes = [("x0", &x0), ("xf", &xf), ("A", &a)].map(|(name, e)| (name, e.size()));
        sizes.sort_unstable_by_key(|(_, size)| size.is_none());
        let size = sizes[0].1.unwrap_or(1);
        if let Some((name, Some(other))) = sizes.into_iter().find(|(_, s)| s.is_some_and(|s| s != size)) {
            return Err(Error::Shape {
                name,
                expected: format!("as many realizations as `{}` ({size})", sizes[0].0),
                found: other.to_string(),
            });
        }
        let atoms = |entity: &Entity| match entity {
            Entity::Singletons { draws, .. } => draws.law().atoms(),
            _ => Ok(Vec::new()),
        };
        let atoms = [atoms(&x0)?, atoms(&xf)?, atoms(&a)?];
        let free = match (&x0, &a) {
            (Entity::Exact(x0), Entity::Exact(a)) => {
                let product = |row: &[f64]| row.iter().zip(*x0).map(|(a, x)| a * x).sum();
                Some(try_collect("`A x0`", a.chunks_exact(n).map(product))?)
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
    pub(super) fn contributions(&self, s: usize, mut visit: impl FnMut(usize, f64)) {
        self.goal(s, &mut visit);
        if let Some(free) = &self.free {
            free.iter().enumerate().for_each(|(i, v)| visit(i, -v));
            return;
        }
        match &self.x0 {
            Entity::Exact(x0) => x0.iter().enumerate().for_each(|(i, v)| self.column(s, i, *v, &mut visit)),
            Entity::Dense(x0) => x0.row(s).iter().enumerate().for_each(|(i, v)| self.column(s, i, *v, &mut visit)),
            Entity::Singletons { draws, .. } => {
                let i = with_indices!(&**draws.indices(), v => v[s].get());
                self.column(s, i, self.atoms[0][i], &mut visit);
            }
        }
    }

    /// The entries of `xf^s`.
    pub(super) fn goal(&self, s: usize, mut visit: impl FnMut(usize, f64)) {
        match &self.xf {
            Entity::Exact(xf) => xf.iter().enumerate().for_each(|(i, v)| visit(i, *v)),
            Entity::Dense(xf) => xf.row(s).iter().enumerate().for_each(|(i, v)| visit(i, *v)),
            Entity::Singletons { draws, .. } => {
                let i = with_indices!(&**draws.indices(), v => v[s].get());
                visit(i, self.atoms[1][i]);
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

    /// `(1/N) sum_s y^s`, in one pass and without a dense realization; its rounding error does not grow with `N`.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after a stop.
    pub fn mean(&self, stop: &Stop) -> Result<Vec<f64>> {
        let (mut sum, mut lost): (Vec<f64>, Vec<f64>) =
            (try_zeros("the mean", self.n)?, try_zeros("the mean", self.n)?);
        let check_every = ((1 << 14) as f64 / self.cost()) as usize + 1;
        for s in 0..self.size {
            if s % check_every == 0 {
                stop.check()?;
            }
            // Neumaier: the rounding error of each sum is added up beside it
            self.contributions(s, |i, v| {
                let total = sum[i] + v;
                lost[i] += if sum[i].abs() >= v.abs() { (sum[i] - total) + v } else { (v - total) + sum[i] };
                sum[i] = total;
            });
        }
        sum.iter_mut().zip(&lost).for_each(|(v, lost)| *v = (*v + lost) / self.size as f64);
        Ok(sum)
    }
}
