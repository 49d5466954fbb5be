//! The best control of an exact problem with its factors, and other controls beside it.
//!
//! The factored matrix is `C_K = [B, A B, ..., A^{K-1} B]` in doubles. [`ExactControl::off`] bounds how far the product
//! of the factors is from the exact `C_K`, so that `s_r - off` is at most its least singular value that is not 0.

use std::sync::Arc;

use super::best::{Best, Factors, best_control, pushed};
use super::pairs::Motion;
use super::products::times;
use super::pseudoinverse::{Pseudoinverse, pseudoinverse};
use crate::compensated::{dot as compensated_dot, two_sum};
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_collect, try_copy, try_room, try_zeros};
use crate::parallel::{Stop, detached};
use crate::scaled::{norm, power_of_two_scale};
use crate::vector::{axpy, dot};

const WHAT: &str = "the best control";
const EPS: f64 = f64::EPSILON;
/// Relative residuals up to here, half of the digits, count as 0.
const REACHABLE: f64 = 1.0 / 67_108_864.0;
/// Times `||y|| / ||C_K||`: [`Best::lower`] is about controls up to there where the rank is not certain.
const LARGEST: f64 = 1e20;
/// `n width min(n, width)` from which the factors, whose computation cannot be stopped, have a thread of their own: .1
/// s.
const LONG: f64 = 1e7;

/// A matrix `B = U diag(s) V^T` with its pseudoinverse.
#[derive(Debug)]
pub struct Factored {
    /// `B`, row by row.
    pub matrix: Vec<f64>,
    /// Rows of `B`.
    pub rows: usize,
    /// Columns of `B`.
    pub cols: usize,
    /// Rank, singular values and vectors, `B^+`.
    pub parts: Pseudoinverse,
}

impl Factored {
    /// # Errors
    /// As [`pseudoinverse`]; [`Error::Overflow`] of a singular value.
    pub fn new(matrix: Vec<f64>, rows: usize, cols: usize) -> Result<Self> {
        let parts = pseudoinverse(&matrix, rows, cols)?;
        if parts.singular_values.iter().any(|s| !s.is_finite()) {
            return Err(Error::Overflow { what: "the largest singular value of `B`" });
        }
        Ok(Self { matrix, rows, cols, parts })
    }

    /// The singular values above the cut-off.
    #[must_use]
    pub fn s(&self) -> &[f64] {
        &self.parts.singular_values[..self.parts.rank]
    }

    /// `||B||`.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.parts.singular_values.first().copied().unwrap_or(0.0)
    }

    /// `theta ||B||`: how far the product of the factors is from `B` (LAPACK Users' Guide, 4.9).
    #[must_use]
    pub fn off(&self) -> f64 {
        (2 * self.rows.max(self.cols) + 4) as f64 * EPS * self.size()
    }

    /// `eta ||B||_F`: rounding of a product `B w` with `||w|| = 1`.
    #[must_use]
    pub fn spread(&self) -> f64 {
        self.rows.max(self.cols) as f64 * EPS * norm(self.parts.singular_values.iter().copied())
    }

    /// `B v`.
    fn times(&self, v: &[f64]) -> Result<Vec<f64>> {
        try_collect(WHAT, self.matrix.chunks_exact(self.cols).map(|row| dot(row, v)))
    }

    /// `B^+ y`, refined once: that brings `B v` 3 to 5 times nearer, at any condition.
    fn solve(&self, y: &[f64]) -> Result<Vec<f64>> {
        let mut v: Vec<f64> = try_zeros(WHAT, self.cols)?;
        for _ in 0..2 {
            let found = self.times(&v)?;
            let rest = try_collect(WHAT, y.iter().zip(&found).map(|(y, found)| y - found))?;
            let vectors = self.parts.basis.chunks_exact(self.rows).zip(self.parts.right.chunks_exact(self.cols));
            vectors.zip(self.s()).for_each(|((left, right), s)| axpy(dot(left, &rest) / s, right, &mut v));
        }
        Ok(v)
    }
}

/// The best control of one problem.
#[derive(Debug)]
#[non_exhaustive]
pub struct ExactControl {
    /// `A`, row by row.
    pub a: Vec<f64>,
    /// `B`, row by row.
    pub b: Vec<f64>,
    /// Length of a state.
    pub n: usize,
    /// Number of inputs.
    pub m: usize,
    /// Number of steps K.
    pub steps: usize,
    /// `C_K`.
    pub factors: Arc<Factored>,
    /// How far the product of the factors is from the exact `C_K` at most.
    pub off: f64,
    /// A lower bound of the least singular value of the exact `C_K` that is not 0; infinite for rank 0.
    pub gap: f64,
    /// The rounding of `xf - A^K x0` in doubles.
    pub unsure: f64,
    /// The control in the order of `C_K`, with its bounds.
    pub best: Best,
    /// `C_K v`.
    pub pushed: Vec<f64>,
    /// The state that the control leads to.
    pub reached: Vec<f64>,
}

/// The part of the target that no control reaches, with bounds.
#[derive(Debug, Clone, Copy)]
pub struct Reach {
    /// "reachable", "not reachable" or "undecided".
    pub verdict: &'static str,
    /// Its norm, and that over the norm of the wish.
    pub residual: f64,
    /// See `residual`.
    pub relative: f64,
}

/// Another control beside the best one: the errors of the control and of the state, each with its rounding and with
/// what it is relative to; and the residual.
#[derive(Debug, Clone, Copy)]
pub struct Beside {
    /// `||u - v||`, what it is relative to and the norm of that, and the rounding.
    pub control: (f64, &'static str, f64, f64),
    /// `||C_K (u - v)||` in the same way.
    pub state: (f64, &'static str, f64, f64),
    /// `||(I - C C^+)(xf - A^K x0)||`.
    pub residual: f64,
}

impl ExactControl {
    /// The control from x0 to xf over `steps` steps; `b` has rows of `m` entries.
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Numerical`] if the factors do not converge, [`Error::Memory`],
    /// [`Error::Interrupted`].
    pub fn new(a: &[f64], b: &[f64], x0: &[f64], xf: &[f64], steps: usize, stop: &Stop) -> Result<Self> {
        let n = x0.len();
        let m = b.len().checked_div(n).unwrap_or(0);
        let (c, off) = controllability(a, b, n, steps, stop)?;
        if c.iter().any(|entry| !entry.is_finite()) {
            return Err(Error::Overflow { what: "`A` to a power times `B`" });
        }
        let width = checked_len(WHAT, m, steps)?;
        let work = move || Factored::new(c, n, width);
        let long = (n * width) as f64 * n.min(width) as f64 > LONG;
        let factors = if long { detached("stochens-factors", stop, work)? } else { work()? };
        let off = off + factors.off();
        let gap = factors.s().last().map_or(f64::INFINITY, |s| s - off);
        let parts = &factors.parts;
        let given = Factors { basis: &parts.basis, right: &parts.right, singular_values: &parts.singular_values, gap };
        let best = best_control(&Motion { a, b, n, m, steps }, &given, x0, xf, stop)?;
        let (pushed, unsure) = (factors.times(&best.control)?, (n + 1) as f64 * EPS * best.unit);
        let reached = try_collect(WHAT, best.free.iter().zip(&pushed).map(|(free, pushed)| free + pushed))?;
        representable(&[&best.free, &best.needed, &best.control, &best.residual, &pushed, &reached])?;
        let (a, b) = (try_copy(WHAT, a)?, try_copy(WHAT, b)?);
        Ok(Self { a, b, n, m, steps, factors: Arc::new(factors), off, gap, unsure, best, pushed, reached })
    }

    /// The control that adds `needed` to `free` in one step.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn added(b: &[f64], free: &[f64], needed: &[f64], stop: &Stop) -> Result<Self> {
        let n = needed.len();
        let (rest, start): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, checked_len(WHAT, n, n)?)?, try_zeros(WHAT, n)?);
        let mut found = Self::new(&rest, b, &start, needed, 1, stop)?;
        let goal = free.iter().zip(needed).map(|(free, needed)| free + needed);
        found.unsure = EPS * (norm(free.iter().copied()) + norm(goal));
        found.reached.iter_mut().zip(free).for_each(|(reached, free)| *reached += free);
        found.best.free = try_copy(WHAT, free)?;
        representable(&[&found.best.free, &found.reached])?;
        Ok(found)
    }

    /// Whether the target is within reach.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn reach(&self) -> Result<Reach> {
        let (needed, residual) = (length(&self.best.needed)?, length(&self.best.residual)?);
        // the wish is known to about eps of its own size, the unit of the rest
        let near = (REACHABLE * needed).max(self.unsure);
        let verdict = if self.best.upper <= near {
            "reachable"
        } else if self.best.lower > near && 2.0 * self.best.size * self.factors.size() >= LARGEST * needed {
            "not reachable"
        } else {
            "undecided"
        };
        Ok(Reach { verdict, residual, relative: if needed > 0.0 { residual / needed } else { 0.0 } })
    }

    /// What an error of the wish moves the control by at most; infinite if no gap is known.
    #[must_use]
    pub fn amplified(&self, state: f64) -> f64 {
        if state == 0.0 {
            0.0
        } else if self.gap > 0.0 {
            state / self.gap
        } else {
            f64::INFINITY
        }
    }

    /// `(I - C_K^+ C_K) u` for u in the order of time, in that of `C_K`: the part without effect on the state.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn aside(&self, u: &[f64]) -> Result<Vec<f64>> {
        let mut out = self.reversed(u)?;
        let along = try_copy(WHAT, &out)?;
        let right = self.factors.parts.right.chunks_exact(self.factors.cols);
        right.for_each(|v| axpy(-dot(v, &along), v, &mut out));
        Ok(out)
    }

    /// From the order of time to that of `C_K`, or back.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn reversed(&self, u: &[f64]) -> Result<Vec<f64>> {
        try_collect(WHAT, u.chunks_exact(self.m).rev().flatten().copied())
    }

    /// The vector that an error of the control, or of the state, is relative to, and its norm: where `C_K v` cannot be
    /// told from the rounding of `xf - A^K x0`, or the state that is reached from 0, another one takes its place.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn compared(&self, of_control: bool, x0: &[f64]) -> Result<(&'static str, f64)> {
        let size = |values: &[f64]| norm(values.iter().copied());
        let (name, size) = match of_control {
            true if size(&self.pushed) > self.unsure => ("v", size(&self.best.control)),
            true => ("B^+ A x0", size(&self.factors.solve(&self.best.free)?)),
            false if size(&self.reached) > self.unsure + self.best.state_rounding => ("x_actual", size(&self.reached)),
            false => ("x0", size(x0)),
        };
        Ok(if size > 0.0 { (name, size) } else { ("nothing", 0.0) })
    }

    /// Another control, in the order of time, beside this one.
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Memory`].
    pub fn beside(&self, u: &[f64], x0: &[f64]) -> Result<Beside> {
        let u = self.reversed(u)?;
        let (mut wrong, mut rest) = (try_room(WHAT, u.len())?, try_room(WHAT, u.len())?);
        for (u, v) in u.iter().zip(&self.best.control) {
            let (high, low) = two_sum(*u, -v); // u - v exactly
            wrong.push(high);
            rest.push(low);
        }
        representable(&[&wrong, &rest])?;
        let motion = Motion { a: &self.a, b: &self.b, n: self.n, m: self.m, steps: self.steps };
        let (shift, off) = pushed(&motion, &wrong, &rest)?;
        representable(&[&shift])?;
        let (control, state, residual) = (length(&wrong)?, length(&shift)?, length(&self.best.residual)?);
        let ((to, size), (place, last)) = (self.compared(true, x0)?, self.compared(false, x0)?);
        // a norm of entries that are rounded once is rounded by 2 eps at most
        let control_rounding = self.best.control_rounding + 2.0 * EPS * control;
        let state_rounding = self.best.state_rounding + off + 2.0 * EPS * state.max(residual);
        Ok(Beside {
            control: (control, to, size, control_rounding),
            state: (state, place, last, state_rounding),
            residual,
        })
    }

    /// Bounds of drawn errors `(state, control)` with what rounding can add to them and to a control like v; `largest`
    /// bounds the norm of an error of the wish.
    #[must_use]
    pub fn with_rounding(&self, [mut state, mut control]: [f64; 2], largest: f64) -> [f64; 2] {
        let s = self.factors.s();
        state += self.best.state_rounding;
        if s.is_empty() {
            return [state, control + self.best.control_rounding];
        }
        let turn = if self.gap > 0.0 { self.off / self.gap } else { f64::INFINITY };
        if self.steps > 1 {
            state += (self.off + self.factors.spread()) * control; // the rounding of u is in the errors
        } else if s.len() == self.n {
            state += 2.0 * self.unsure + self.off / s[0] * state;
        } else {
            // the range of the factors is turned by at most off / gap (Wedin, BIT 13 (1973) 217-232)
            let off = 2.0 * self.unsure + turn.min(1.0) * largest;
            state += off;
            control += self.amplified(off);
        }
        let turned = if control > 0.0 { 2.0 * turn * control } else { 0.0 };
        [state, control + self.best.control_rounding + turned]
    }
}

/// `[B, A B, ..., A^{K-1} B]` row by row, and a bound of its rounding in the Frobenius norm.
///
/// `A X` is rounded by at most `n eps |A| |X|`, and that is carried on (Higham, Accuracy and Stability of Numerical
/// Algorithms (2002), 3.5).
fn controllability(a: &[f64], b: &[f64], n: usize, steps: usize, stop: &Stop) -> Result<(Vec<f64>, f64)> {
    let m = b.len().checked_div(n).unwrap_or(0);
    let width = checked_len(WHAT, m, steps)?;
    let mut c: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, n, width)?)?;
    let size = try_collect(WHAT, a.iter().map(|a| a.abs()))?;
    let (mut block, mut wrong): (Vec<f64>, Vec<f64>) = (try_copy(WHAT, b)?, try_zeros(WHAT, b.len())?);
    let mut off = 0.0f64;
    for k in 0..steps {
        stop.check()?;
        for (row, block) in c.chunks_exact_mut(width).zip(block.chunks_exact(m)) {
            row[k * m..(k + 1) * m].copy_from_slice(block);
        }
        off = off.hypot(norm(wrong.iter().copied()));
        if k + 1 < steps {
            let own = n as f64 * EPS;
            wrong.iter_mut().zip(&block).for_each(|(wrong, x)| *wrong += own * x.abs());
            (wrong, block) = (times(&size, &wrong, n)?, times(a, &block, n)?);
        }
    }
    Ok((c, off))
}

/// `||x||`, rounded by less than eps.
fn length(x: &[f64]) -> Result<f64> {
    let scale = power_of_two_scale(x);
    let scaled = try_collect(WHAT, x.iter().map(|x| x / scale))?;
    let (high, low) = compensated_dot(&scaled, &scaled);
    Ok((high + low).sqrt() * scale)
}

fn representable(results: &[&[f64]]) -> Result<()> {
    let finite = results.iter().all(|result| result.iter().all(|entry| entry.is_finite()));
    let what = "`A x0`, `xf - A x0`, the control or the state it leads to";
    if finite { Ok(()) } else { Err(Error::Overflow { what }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_control_beside_the_best_one_has_exact_errors() {
        // x+ = 2 x + u: over two steps C = [1, 2] in the order u(1), u(0), and the best control to 5 is (1, 2)
        let best = ExactControl::new(&[2.0], &[1.0], &[0.0], &[5.0], 2, &Stop::new()).unwrap();
        assert!((best.best.control[0] - 1.0).abs() < 1e-15 && (best.best.control[1] - 2.0).abs() < 1e-15);
        assert_eq!(best.reach().unwrap().verdict, "reachable");
        let beside = best.beside(&[3.0, 1.0], &[0.0]).unwrap(); // u(0) is one too large
        assert!((beside.control.0 - 1.0).abs() < 1e-15 && (beside.state.0 - 2.0).abs() < 1e-15);
        assert_eq!((beside.control.1, beside.state.1), ("v", "x_actual"));
        let aside = best.aside(&[1.0, 0.0]).unwrap();
        assert!((aside[0] + 0.4).abs() < 1e-15 && (aside[1] - 0.2).abs() < 1e-15);
    }

    #[test]
    fn powers_that_grow_carry_their_rounding() {
        let (c, off) = controllability(&[1.0, 2.0, 3.0, 4.0], &[1.0, 1.0], 2, 3, &Stop::new()).unwrap();
        assert_eq!(c, [1.0, 3.0, 17.0, 1.0, 7.0, 37.0]);
        // n eps |A| |B| = 2 eps (3, 7), then |A| (that + 2 eps (3, 7)) = 4 eps (17, 37)
        let expected = EPS * (36.0f64 + 196.0 + 16.0 * (289.0 + 1369.0)).sqrt();
        assert!((off - expected).abs() <= 1e-12 * expected);
        let best = ExactControl::new(&[1e200], &[1e200], &[1.0], &[1.0], 3, &Stop::new());
        assert!(matches!(best, Err(Error::Overflow { .. })));
    }
}
