//! A closed loop along a reference, with estimates from fresh realizations at every step.
//!
//! ```text
//! u(k) = B^+ (r^(k+1) - A^_k y^(k)),   x(k+1) = A x(k) + B u(k)
//! ```
//!
//! with `y = x`, or `y = r` without feedback. `A^_k` is fused from realizations of `A`. If states are sampled, `y^(k)`
//! and `r^(k+1)` are fused from realizations too; otherwise they are exact.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::model::add_product;
use crate::Scheme;
use crate::error::{Error, Result};
use crate::fuse::{Fusion, Samples, Settings, WeightStatus, Weights, alse, closed_form, uniform};
use crate::memory::{checked_len, try_collect, try_copy, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::{Law, multinomial_counts, sample};
use crate::stream::Key;

const WHAT: &str = "the trajectories";

/// A system that follows a reference.
#[derive(Debug, Clone)]
pub struct ClosedLoop<'a> {
    /// `A`, column by column.
    pub a: Arc<Law>,
    /// `B`, column by column.
    pub b: Law,
    /// `x(0)`.
    pub x0: &'a [f64],
    /// `r(0), ..., r(K)`, n entries each.
    pub reference: &'a [f64],
    /// `U^T` of `B = U diag(s) V^T`, vector by vector, as `basis` of a
    /// [`Pseudoinverse`](crate::control::Pseudoinverse).
    pub basis: &'a [f64],
    /// `V^T`, as its `right`.
    pub right: &'a [f64],
    /// `s`.
    pub singular_values: &'a [f64],
    /// Realizations per estimate.
    pub size: u64,
    /// The fusion method.
    pub method: Fusion,
    /// Whether the control uses `x(k)`, or `r(k)` instead.
    pub feedback: bool,
    /// Whether the states in the formula of the control are estimates too.
    pub sample_states: bool,
}

/// The trajectories along the reference.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ReferenceRuns {
    /// `x(0), ..., x(K)` of every run. If `||x(k) - r(k)||^2` of a run is not finite, the states after it are zeros.
    pub states: Vec<f64>,
    /// `u(0), ..., u(K-1)` of every run.
    pub inputs: Vec<f64>,
    /// Whether all optimised weights are within the tolerance.
    pub optimal: bool,
}

impl ClosedLoop<'_> {
    /// `runs` independent runs. Run i uses the child key "replicate-i" of `key`; step k uses the child "step-k" of
    /// that, and its entities the children "A", "state" and "target" of that.
    ///
    /// # Errors
    /// [`Error::Shape`] if the arguments do not fit together, [`Error::NonFinite`] if the 1-norm of a state overflows,
    /// errors of the fusion method, [`Error::Memory`], [`Error::Interrupted`] after a stop.
    pub fn run(&self, runs: usize, key: &Key, threads: usize, stop: &Stop) -> Result<ReferenceRuns> {
        let (n, m, rank) = (self.a.lines(), self.b.lines(), self.singular_values.len());
        let shape = |name, expected: String, found: usize| Error::Shape { name, expected, found: found.to_string() };
        for (name, found, expected) in [
            ("A", self.a.length(), n),
            ("B", self.b.length(), n),
            ("x0", self.x0.len(), n),
            ("basis", self.basis.len(), checked_len(WHAT, rank, n)?),
            ("right", self.right.len(), checked_len(WHAT, rank, m)?),
        ] {
            if found != expected {
                return Err(shape(name, format!("{expected} entries"), found));
            }
        }
        if self.reference.len() < 2 * n || !self.reference.len().is_multiple_of(n) {
            return Err(shape("reference", format!("at least 2 states of {n} entries"), self.reference.len()));
        }
        let (one, moved) = (self.reference.len(), checked_len(WHAT, self.reference.len() / n - 1, m)?);
        let mut states = try_zeros(WHAT, checked_len(WHAT, runs, one)?)?;
        let mut inputs = try_zeros(WHAT, checked_len(WHAT, runs, moved)?)?;
        let (lost, optimal) = (AtomicUsize::new(usize::MAX), AtomicBool::new(true));
        // the solver divides its own work among the threads
        let (threads, inner) = if self.method == Fusion::Alse { (1, threads) } else { (threads, 1) };
        let chunks = states.chunks_exact_mut(one).zip(inputs.chunks_exact_mut(moved)).enumerate();
        for_each_chunk(chunks, threads, stop, |(run, (states, inputs))| {
            if run > lost.load(Ordering::Relaxed) {
                return Ok(()); // only the first such run is reported
            }
            let estimate = |target: &Arc<Law>, key: &Key| {
                let (found, good) = self.estimate(target, key, inner, stop)?;
                optimal.fetch_and(good, Ordering::Relaxed);
                Ok(found)
            };
            if !self.follow(&key.child(&format!("replicate-{run}")), estimate, states, inputs, stop)? {
                lost.fetch_min(run, Ordering::Relaxed);
            }
            Ok(())
        })?;
        Ok(ReferenceRuns { states, inputs, optimal: optimal.into_inner() })
    }

    /// Fills one trajectory and its inputs; stops and returns false if the squared error is not finite.
    fn follow(
        &self,
        key: &Key,
        estimate: impl Fn(&Arc<Law>, &Key) -> Result<Vec<f64>>,
        states: &mut [f64],
        inputs: &mut [f64],
        stop: &Stop,
    ) -> Result<bool> {
        let (n, m) = (self.a.lines(), self.b.lines());
        let vector = |values: &[f64], key: Key| {
            let values = try_copy("a state", values)?;
            if self.sample_states { estimate(&Law::new(values, 1, n)?.into(), &key) } else { Ok(values) }
        };
        states[..n].copy_from_slice(self.x0);
        for (k, u) in inputs.chunks_exact_mut(m).enumerate() {
            stop.check()?;
            let step = key.child(&format!("step-{k}"));
            let (past, future) = states.split_at_mut((k + 1) * n);
            let (x, next) = (&past[k * n..], &mut future[..n]);
            let goal = &self.reference[(k + 1) * n..(k + 2) * n];
            let now = if self.feedback { x } else { &self.reference[k * n..(k + 1) * n] };
            let now = vector(now, step.child("state"))?;
            // y = r(k+1) - A^ x(k)
            let mut y = vector(goal, step.child("target"))?;
            let found = estimate(&self.a, &step.child("A"))?;
            for (column, x) in found.chunks_exact(n).zip(&now) {
                y.iter_mut().zip(column).for_each(|(y, a)| *y -= a * x);
            }
            self.control(&mut y, u, stop)?;
            add_product(&self.a, x, next, stop)?;
            add_product(&self.b, u, next, stop)?;
            if !next.iter().zip(goal).map(|(x, r)| (x - r) * (x - r)).sum::<f64>().is_finite() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// `u = B^+ y` with one refinement from the residual, `u += B^+ (y - B u)`. Expects zeros in `u`.
    fn control(&self, y: &mut [f64], u: &mut [f64], stop: &Stop) -> Result<()> {
        let (n, m) = (y.len(), u.len());
        // B^+ y = V diag(1/s) U^T y
        let add = |y: &[f64], u: &mut [f64]| {
            let directions = self.basis.chunks_exact(n).zip(self.right.chunks_exact(m));
            for ((left, right), s) in directions.zip(self.singular_values) {
                let size = left.iter().zip(y).map(|(l, y)| l * y).sum::<f64>() / s;
                u.iter_mut().zip(right).for_each(|(u, v)| *u += size * v);
            }
        };
        add(y, u);
        let back = try_collect("a control", u.iter().map(|u| -u))?;
        add_product(&self.b, &back, y, stop)?;
        add(y, u);
        Ok(())
    }

    /// The estimate from fresh realizations of `target`, line by line, and whether its weights are optimal.
    fn estimate(&self, target: &Arc<Law>, key: &Key, threads: usize, stop: &Stop) -> Result<(Vec<f64>, bool)> {
        let size = usize::try_from(self.size).unwrap_or(usize::MAX);
        let (draws, goal) = (|| sample(target, size, Scheme::Iid, key, threads, stop), target.values());
        let settings = Settings { threads, ..Settings::new(Weights::Simplex, 1e-9) };
        Ok(match self.method {
            Fusion::Uniform => {
                let counts = multinomial_counts(target, self.size, key, stop)?;
                (uniform(target, &counts, self.size)?, true)
            }
            Fusion::Alse if target.lines() == 1 => {
                let fit = closed_form(&draws()?, goal, settings.set, stop)?;
                (fit.estimate, fit.gap.relative <= settings.tol)
            }
            Fusion::Alse => {
                let fit = alse(&draws()?, goal, &settings, stop)?;
                if fit.status == WeightStatus::Interrupted {
                    return Err(Error::Interrupted); // half a trajectory is of no use
                }
                (fit.estimate, fit.status == WeightStatus::Optimal)
            }
            other => (other.fuse(Samples::Drawn(&draws()?), goal, &[size], false, stop)?.estimate, true),
        })
    }
}

#[cfg(test)]
mod tests;
