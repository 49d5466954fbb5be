//! The operations on realizations that ALSE needs, for those of a law and dense ones.

use super::super::Dense;
use super::super::simplex::{self, DenseProblem, IndexView, Options, SingletonProblem};
use crate::error::{Error, Result};
use crate::memory::try_copy;
use crate::parallel::Stop;
use crate::sample::{Indices, Singletons};

/// Realizations as a linear map from weights to entries.
pub trait Realizations {
    /// Number of realizations.
    fn size(&self) -> usize;
    /// `sum_i w_i E_i`.
    fn combine(&self, weights: &[f64], stop: &Stop) -> Result<Vec<f64>>;
    /// `<r, E_i>` for every `i`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    fn correlate(&self, r: &[f64]) -> Result<Vec<f64>>;
    /// The largest norm of a realization.
    fn norm(&self) -> f64;
    /// Visits the nonzero entries of realization `i`, by increasing position.
    fn entries(&self, i: usize, visit: impl FnMut(usize, f64));
    /// Nonzero entries of all realizations together, at most.
    fn nonzeros(&self) -> usize;
    /// Weights and certificate of our own solver, from the weights of fewer realizations if there are any.
    fn solve(&self, target: &[f64], options: &Options, warm: Option<&[f64]>, stop: &Stop) -> Result<simplex::Solution>;
}

/// Errors of the solver's own checks; they cannot occur after the checks here.
fn refused(invalid: simplex::Invalid) -> Error {
    Error::Numerical(format!("the solver refused the problem: {invalid}"))
}

impl Realizations for Singletons {
    fn size(&self) -> usize {
        Singletons::size(self)
    }
    fn combine(&self, weights: &[f64], stop: &Stop) -> Result<Vec<f64>> {
        Singletons::combine(self, weights, stop)
    }
    fn correlate(&self, r: &[f64]) -> Result<Vec<f64>> {
        Singletons::correlate(self, r)
    }
    fn norm(&self) -> f64 {
        self.law().gamma().iter().fold(0.0, |norm: f64, &g| norm.hypot(g))
    }
    fn entries(&self, i: usize, mut visit: impl FnMut(usize, f64)) {
        use crate::sample::Index as _;
        let (lines, length) = (self.law().lines(), self.law().length());
        crate::sample::with_indices!(&**self.indices(), indices => {
            for (j, r) in indices[i * lines..(i + 1) * lines].iter().enumerate() {
                let k = j * length + r.get();
                let value = self.law().gamma()[j].copysign(self.law().values()[k]);
                if value != 0.0 {
                    visit(k, value);
                }
            }
        });
    }
    fn nonzeros(&self) -> usize {
        Singletons::size(self) * self.law().lines()
    }
    fn solve(&self, target: &[f64], options: &Options, warm: Option<&[f64]>, stop: &Stop) -> Result<simplex::Solution> {
        with_problem(self, target, |problem| simplex::solve(problem, options, warm, stop))?
    }
}

/// The problem of `draws` in the solver's sign-free form: the law's signs are divided out of the target.
fn with_problem<T>(draws: &Singletons, target: &[f64], work: impl FnOnce(&SingletonProblem<'_>) -> T) -> Result<T> {
    let law = draws.law();
    let mut signed = try_copy("the target", target)?;
    let signs = law.values().iter().map(|&v| if v == 0.0 { 1.0 } else { v.signum() });
    signed.iter_mut().zip(signs).for_each(|(t, s)| *t *= s);
    let used = draws.size() * law.lines();
    let indices = match &**draws.indices() {
        Indices::U8(v) => IndexView::U8(&v[..used]),
        Indices::U16(v) => IndexView::U16(&v[..used]),
        Indices::U32(v) => IndexView::U32(&v[..used]),
    };
    SingletonProblem::new(indices, draws.size(), law.lines(), law.length(), law.gamma(), &signed)
        .map(|problem| work(&problem))
        .map_err(refused)
}

impl Realizations for Dense<'_> {
    fn size(&self) -> usize {
        Dense::size(self)
    }
    fn combine(&self, weights: &[f64], _: &Stop) -> Result<Vec<f64>> {
        Dense::combine(self, weights)
    }
    fn correlate(&self, r: &[f64]) -> Result<Vec<f64>> {
        Dense::correlate(self, r)
    }
    fn norm(&self) -> f64 {
        let norm = |i| self.row(i).iter().fold(0.0, |norm: f64, &e| norm.hypot(e));
        (0..Dense::size(self)).map(norm).fold(0.0, f64::max)
    }
    fn entries(&self, i: usize, mut visit: impl FnMut(usize, f64)) {
        self.row(i).iter().enumerate().filter(|(_, e)| **e != 0.0).for_each(|(k, e)| visit(k, *e));
    }
    fn nonzeros(&self) -> usize {
        self.values().len()
    }
    fn solve(&self, target: &[f64], options: &Options, warm: Option<&[f64]>, stop: &Stop) -> Result<simplex::Solution> {
        DenseProblem::new(self.values(), Dense::size(self), target)
            .map_err(refused)
            .and_then(|problem| simplex::solve_dense(&problem, options, warm, stop))
    }
}
