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
use crate::fuse::{Settings, Status, Weights, alse, closed_form, slse, uniform};
use crate::memory::{checked_len, try_collect, try_copy, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::{Law, multinomial_counts, sample};
use crate::stream::Key;

const WHAT: &str = "the trajectories";

/// Fusion of the realizations of one step into an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Their average, from counts: the cost of a step does not depend on their number.
    Uniform,
    /// Accumulated least squares, fitted to the exact entity.
    Alse,
    /// Sequential least squares, fitted to the exact entity.
    Slse {
        /// Whether every step is followed by one towards the running average.
        safeguard: bool,
    },
}

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
    /// `U^T` of `B = U diag(s) V^T`, vector by vector, as `basis` of a [`Pseudoinverse`](crate::control::Pseudoinverse).
    pub basis: &'a [f64],
    /// `V^T`, as its `right`.
    pub right: &'a [f64],
    /// `s`.
    pub singular_values: &'a [f64],
    /// Realizations per estimate.
    pub size: u64,
    /// The fusion method.
    pub method: Method,
    /// Whether the control uses `x(k)`, or `r(k)` instead.
    pub feedback: bool,
    /// Whether the states in the formula of the control are estimates too.
    pub sample_states: bool,
}

/// The trajectories along the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
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
    pub fn run(&self, runs: usize, key: &Key, threads: usize, stop: &Stop) -> Result<Followed> {
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
        let (threads, inner) = if self.method == Method::Alse { (1, threads) } else { (threads, 1) };
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
        Ok(Followed { states, inputs, optimal: optimal.into_inner() })
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
        if self.method == Method::Uniform {
            let counts = multinomial_counts(target, self.size, key, stop)?;
            return Ok((uniform(target, &counts, self.size)?, true));
        }
        let size = usize::try_from(self.size).unwrap_or(usize::MAX);
        let (draws, goal) = (sample(target, size, Scheme::Iid, key, threads, stop)?, target.values());
        let settings = Settings { threads, ..Settings::new(Weights::Simplex, 1e-9) };
        Ok(match self.method {
            Method::Alse if target.lines() == 1 => {
                let fit = closed_form(&draws, goal, settings.set, stop)?;
                (fit.estimate, fit.gap.relative <= settings.tol)
            }
            Method::Alse => {
                let fit = alse(&draws, goal, &settings, stop)?;
                if fit.status == Status::Interrupted {
                    return Err(Error::Interrupted); // half a trajectory is of no use
                }
                (fit.estimate, fit.status == Status::Optimal)
            }
            _ => {
                let safeguard = self.method == Method::Slse { safeguard: true };
                (slse(&draws, goal, safeguard, &[], false, stop)?.estimate, true)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::pseudoinverse;
    use proptest::prelude::*;

    /// `A` and `B` by columns, n of them in `A`; `work` is given a loop along the reference.
    fn with_loop<T>(a: &[f64], b: &[f64], reference: &[f64], work: impl FnOnce(ClosedLoop<'_>) -> T) -> T {
        let n = (a.len() as f64).sqrt() as usize;
        let m = b.len() / n;
        let rows: Vec<f64> = (0..n * m).map(|at| b[at % m * n + at / m]).collect();
        let factors = pseudoinverse(&rows, n, m).unwrap();
        work(ClosedLoop {
            a: Law::new(a.to_vec(), n, n).unwrap().into(),
            b: Law::new(b.to_vec(), m, n).unwrap(),
            x0: &reference[..n],
            reference,
            basis: &factors.basis,
            right: &factors.right,
            singular_values: &factors.singular_values[..factors.rank],
            size: 40,
            method: Method::Uniform,
            feedback: true,
            sample_states: false,
        })
    }

    const A: [f64; 4] = [0.5, -0.25, 0.75, 0.5];
    const B: [f64; 4] = [1.0, 0.5, 0.0, 1.0];
    const R: [f64; 8] = [1.0, -1.0, 0.5, 2.0, 0.0, 1.0, -1.0, 0.5];
    const METHODS: [Method; 4] =
        [Method::Uniform, Method::Alse, Method::Slse { safeguard: false }, Method::Slse { safeguard: true }];

    #[test]
    fn threads_change_nothing_and_more_runs_start_with_the_fewer() {
        for (method, sample_states) in METHODS.into_iter().zip([false, true, true, false]) {
            with_loop(&A, &B, &R, |given| {
                let given = ClosedLoop { method, sample_states, ..given };
                let run = |runs, threads| given.run(runs, &Key([1; 32]), threads, &Stop::new()).unwrap();
                let whole = run(9, 1);
                assert!(whole.optimal);
                assert_eq!(run(9, 3), whole);
                assert_eq!(run(2, 2).states, whole.states[..16]);
                assert_ne!(whole.states[..8], whole.states[8..16]);
            });
        }
    }

    #[test]
    fn a_stop_and_what_does_not_fit_are_errors_and_a_lost_run_ends() {
        with_loop(&A, &B, &R, |given| {
            let stop = Stop::new();
            let run = |given: &ClosedLoop<'_>| given.run(3, &Key([1; 32]), 2, &stop);
            let short = ClosedLoop { x0: &R[..1], ..given.clone() };
            assert!(matches!(run(&short), Err(Error::Shape { name: "x0", .. })));
            let short = ClosedLoop { reference: &R[..2], ..given.clone() };
            assert!(matches!(run(&short), Err(Error::Shape { name: "reference", .. })));
            let none = ClosedLoop { size: 0, method: Method::Alse, ..given.clone() };
            assert!(run(&none).is_err());
            let far = ClosedLoop { x0: &[1e200, 0.0], ..given.clone() };
            let lost = run(&far).unwrap();
            assert!(lost.states[2..4].iter().all(|x| x.abs() > 1e150));
            assert!(lost.states[4..8].iter().all(|&x| x == 0.0));
            stop.request();
            assert_eq!(run(&given), Err(Error::Interrupted));
        });
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

        /// The states follow the exact system, and `B^T (y - B u) = 0` with the estimates of the named streams.
        #[test]
        fn every_step_is_the_one_of_the_formula(
            a in prop::collection::vec(-1.0..1.0f64, 9),
            b in prop::collection::vec(-1.0..1.0f64, 6),
            reference in prop::collection::vec(-2.0..2.0f64, 12),
            seed in any::<u8>(),
            feedback in any::<bool>(),
            sample_states in any::<bool>(),
        ) {
            let key = Key([seed; 32]);
            let found = with_loop(&a, &b, &reference, |given| {
                ClosedLoop { feedback, sample_states, ..given }.run(2, &key, 1, &Stop::new()).unwrap()
            });
            let product = |m: &[f64], v: &[f64], i: usize| -> f64 { v.iter().enumerate().map(|(j, v)| m[j * 3 + i] * v).sum() };
            for (run, k) in [(0, 0), (0, 2), (1, 1)] {
                let state = |k: usize| &found.states[run * 12 + k * 3..][..3];
                let u = &found.inputs[run * 6 + k * 2..][..2];
                let step = key.child(&format!("replicate-{run}")).child(&format!("step-{k}"));
                let average = |values: &[f64], lines: usize, name: &str| {
                    let law = Law::new(values.to_vec(), lines, 3).unwrap();
                    let counts = multinomial_counts(&law, 40, &step.child(name), &Stop::new()).unwrap();
                    uniform(&law, &counts, 40).unwrap()
                };
                let vector = |values: &[f64], name| if sample_states { average(values, 1, name) } else { values.to_vec() };
                let now = vector(if feedback { state(k) } else { &reference[k * 3..][..3] }, "state");
                let goal = vector(&reference[(k + 1) * 3..][..3], "target");
                let a_hat = average(&a, 3, "A");
                let left: Vec<f64> = (0..3).map(|i| goal[i] - product(&a_hat, &now, i) - product(&b, u, i)).collect();
                for i in 0..3 {
                    let next = product(&a, state(k), i) + product(&b, u, i);
                    prop_assert!((state(k + 1)[i] - next).abs() <= 1e-13 * (1.0 + next.abs()));
                }
                for column in b.chunks(3) {
                    let slope: f64 = column.iter().zip(&left).map(|(b, l)| b * l).sum();
                    let size = 1.0 + goal.iter().chain(u).map(|v| v.abs()).fold(0.0, f64::max);
                    prop_assert!(slope.abs() <= 1e-10 * size, "{slope}");
                }
            }
        }
    }
}
