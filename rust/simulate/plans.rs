//! Errors of estimates and of fused controls, simulated from the laws of their realizations.
//!
//! Every run draws new averages of `x0`, `xf` and `A`, as counts, so that its cost does not depend on their sizes
//! (except for paired systematic samples), and compares the control from them with the exact one, `v`:
//!
//! ```text
//! one step:  t = U^T (y_hat - y),  ||B (u - v)|| = ||t||,  ||u - v|| = ||diag(1/s) t||,   y = xf - A x0,  B = U diag(s) V^T
//! K steps:   u = C_K(A_hat)^+ (xf_hat - A_hat^K x0_hat),  ||C_K(A) (u - v)||,  ||u - v||
//! ```

use rand::rngs::ChaCha8Rng;

use crate::Scheme;
use crate::control::steps_control;
use crate::error::{Error, Result, sized};
use crate::fuse::norm;
use crate::memory::{checked_len, try_collect, try_room, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::binomial;
use crate::stream::{Key, Purpose};

mod average;
mod estimates;
mod sizes;

pub use average::{Average, PlanEntity};
pub use estimates::estimate_errors;

use sizes::{CHUNK, WHAT};

/// The fused control of a problem, whose realizations every run draws again.
#[derive(Debug, Clone)]
pub struct Plans {
    x0: PlanEntity,
    xf: PlanEntity,
    a: PlanEntity,
    rows: bool,
    paired: bool,
    n: usize,
}

/// The exact control.
#[derive(Debug, Clone, Copy)]
pub enum Exact<'a> {
    /// One step.
    OneStep {
        /// `U^T`, an orthonormal basis of the range of `B`, vector by vector.
        basis: &'a [f64],
        /// The singular values of `B` that belong to it.
        singular_values: &'a [f64],
        /// `xf - A x0`.
        y: &'a [f64],
    },
    /// Several steps.
    Steps {
        /// `B`, row by row.
        b: &'a [f64],
        /// `C_K = [B, A B, ..., A^{K-1} B]`, row by row.
        c: &'a [f64],
        /// The exact control in its order, `u(K-1), ..., u(0)`.
        v: &'a [f64],
    },
}

impl Plans {
    /// `rows`: the lines of `A` are its rows. `paired`: diagonal fusion, realization by realization (one step).
    ///
    /// # Errors
    /// [`Error::Shape`] if the entities do not fit together, [`Error::Value`] for systematic rows that are paired.
    pub fn new(x0: PlanEntity, xf: PlanEntity, a: PlanEntity, rows: bool, paired: bool) -> Result<Self> {
        let n = x0.len();
        for (name, entity, len) in [("xf", &xf, n), ("A", &a, checked_len("A", n, n)?)] {
            sized(name, entity.len(), len)?;
        }
        let systematic = matches!(&a, PlanEntity::Drawn(average) if average.scheme == Scheme::Systematic);
        if rows && paired && systematic {
            let found = "systematic rows".into();
            return Err(Error::Value { name: "fusion", expected: "'product' for systematic rows of `A`", found });
        }
        // with fewer than two random entities nothing is paired
        let paired = paired && matches!((&x0, &a), (PlanEntity::Drawn(_), PlanEntity::Drawn(_)));
        Ok(Self { x0, xf, a, rows, paired, n })
    }

    /// `(state, control)`: the errors of every run, which depends on `(key, run)` and the problem only.
    ///
    /// # Errors
    /// [`Error::Overflow`] if an error is not finite, [`Error::Numerical`] if a factorization fails, [`Error::Memory`],
    /// [`Error::Interrupted`] after a stop.
    pub fn errors(&self, exact: Exact<'_>, runs: usize, key: &Key, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
        let mut errors: Vec<f64> = try_zeros("the simulated errors", checked_len("the errors", runs, 2)?)?;
        let size = if let Exact::Steps { c, .. } = exact { norm(c.iter().copied()) } else { 0.0 }; // ||C_K||_F
        for_each_chunk(errors.chunks_mut(2 * CHUNK).enumerate(), threads, stop, |(chunk, errors)| {
            let mut scratch = Scratch::new(self.n, matches!(exact, Exact::Steps { .. }))?;
            for (at, errors) in errors.chunks_exact_mut(2).enumerate() {
                stop.check()?;
                let mut rng = key.stream(Purpose::Plans, chunk * CHUNK + at);
                match exact {
                    Exact::OneStep { basis, singular_values, y } => {
                        self.difference(&mut rng, &mut scratch)?;
                        let Scratch { y: found, t, .. } = &mut scratch;
                        t.clear();
                        t.extend(basis.chunks_exact(self.n).map(|u| {
                            u.iter().zip(found.iter()).zip(y).map(|((u, found), y)| u * (found - y)).sum::<f64>()
                        }));
                        let state = norm(t.iter().copied());
                        t.iter_mut().zip(singular_values).for_each(|(t, s)| *t /= s);
                        errors.copy_from_slice(&[state, norm(t.iter().copied())]);
                    }
                    Exact::Steps { b, c, v } => {
                        errors.copy_from_slice(&self.steps(&mut rng, &mut scratch, b, c, v, size)?);
                    }
                }
            }
            Ok(())
        })?;
        if errors.iter().any(|error| !error.is_finite()) {
            return Err(Error::Overflow { what: "a simulated error" });
        }
        Ok(errors)
    }

    /// `y = xf_hat - A_hat x0_hat`, or the mean of `xf^s - A^s x0^s`, into the scratch space.
    fn difference(&self, rng: &mut ChaCha8Rng, scratch: &mut Scratch) -> Result<()> {
        let Scratch { x, y, left, .. } = scratch;
        self.xf.vector(rng, y)?;
        self.x0.vector(rng, x)?;
        let n = self.n;
        let a = match &self.a {
            PlanEntity::Fixed(a) => {
                for (column, x) in a.chunks_exact(n).zip(x.iter()) {
                    y.iter_mut().zip(column).for_each(|(y, a)| *y -= a * x);
                }
                return Ok(());
            }
            PlanEntity::Drawn(a) => a,
        };
        for j in 0..n {
            let (line, g, value) = (a.law.line(j), a.law.gamma()[j], x[j]);
            match (self.rows, self.paired) {
                (false, _) if value == 0.0 => {}
                (false, false) => a.line(j, rng, |i, entry| y[i] -= value * entry)?,
                (false, true) => {
                    // x0^s hits j in `some` of the realizations; the others do not use column j
                    let some = self.hits(j, value);
                    let one = value * g / some as f64;
                    a.part(j, some, rng, left, |i, count| y[i] -= one * line[i].signum() * count as f64)?;
                }
                (true, false) => {
                    let mut sum = 0.0;
                    a.line(j, rng, |k, entry| sum += entry * x[k])?;
                    y[j] -= sum;
                }
                (true, true) => {
                    for (k, (entry, value)) in line.iter().zip(x.iter()).enumerate() {
                        let some = self.hits(k, *value);
                        if some > 0 && *entry != 0.0 {
                            // row j hits entry k in some of the realizations whose x0^s hits k
                            let p = (entry.abs() / g).min(1.0);
                            let share = binomial(some, p, rng)? as f64 / some as f64;
                            y[j] -= value * g.copysign(*entry) * share;
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// How many realizations of `x0` hit entry `i`, whose average is `value = g0 sign(x0_i) hits / N`.
    fn hits(&self, i: usize, value: f64) -> u64 {
        match &self.x0 {
            PlanEntity::Drawn(x0) if value != 0.0 => {
                let share = value / x0.law.gamma()[0].copysign(x0.law.line(0)[i]);
                (share * x0.size as f64).round() as u64
            }
            _ => 0,
        }
    }

    /// The estimates of `x0` and `xf`, and of `A` row by row, in one run of product fusion.
    fn estimate(&self, rng: &mut ChaCha8Rng, x0: &mut [f64], xf: &mut [f64], a: &mut [f64]) -> Result<()> {
        let n = self.n;
        self.xf.vector(rng, xf)?;
        self.x0.vector(rng, x0)?;
        match &self.a {
            PlanEntity::Fixed(columns) => {
                for (j, column) in columns.chunks_exact(n).enumerate() {
                    column.iter().enumerate().for_each(|(i, value)| a[i * n + j] = *value);
                }
            }
            PlanEntity::Drawn(average) => {
                a.fill(0.0);
                for j in 0..n {
                    average.line(j, rng, |i, value| a[if self.rows { j * n + i } else { i * n + j }] = value)?;
                }
            }
        }
        Ok(())
    }

    /// The estimates of the runs `first .. first + runs`: for each `x0`, `xf`, and `A` row by row. They are those that
    /// [`Plans::errors`] draws over several steps.
    ///
    /// # Errors
    /// As [`Plans::errors`].
    pub fn estimates(&self, first: usize, runs: usize, key: &Key, stop: &Stop) -> Result<Vec<f64>> {
        let n = self.n;
        let width = checked_len("the estimates", n, n + 2)?;
        let mut found: Vec<f64> = try_zeros("the simulated estimates", checked_len("the estimates", runs, width)?)?;
        for (at, row) in found.chunks_exact_mut(width.max(1)).enumerate() {
            stop.check()?;
            let (x0, rest) = row.split_at_mut(n);
            let (xf, a) = rest.split_at_mut(n);
            self.estimate(&mut key.stream(Purpose::Plans, first + at), x0, xf, a)?;
        }
        Ok(found)
    }

    /// The two errors of one control over several steps, each with a bound on its rounding error added.
    fn steps(
        &self,
        rng: &mut ChaCha8Rng,
        scratch: &mut Scratch,
        b: &[f64],
        c: &[f64],
        v: &[f64],
        size: f64,
    ) -> Result<[f64; 2]> {
        let n = self.n;
        let Scratch { x, y, a, .. } = scratch;
        self.estimate(rng, x, y, a)?;
        let (u, rounding) = steps_control(a, b, x, y, v.len() * n / b.len())?;
        let wrong = try_collect(WHAT, u.iter().zip(v).map(|(u, v)| u - v))?;
        let dot = |row: &[f64]| row.iter().zip(&wrong).map(|(c, w)| c * w).sum();
        let shift: Vec<f64> = try_collect(WHAT, c.chunks_exact(v.len()).map(dot))?;
        Ok([norm(shift.iter().copied()) + size * rounding, norm(wrong.iter().copied()) + rounding])
    }
}

/// Scratch space of one run.
struct Scratch {
    t: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
    left: Vec<u64>,
    a: Vec<f64>,
}

impl Scratch {
    fn new(n: usize, several: bool) -> Result<Self> {
        let zeros = || try_zeros(WHAT, n);
        let a = try_zeros(WHAT, if several { checked_len(WHAT, n, n)? } else { 0 })?;
        Ok(Self { t: try_room(WHAT, n)?, x: zeros()?, y: zeros()?, left: try_zeros(WHAT, n)?, a })
    }
}

#[cfg(test)]
mod tests;
