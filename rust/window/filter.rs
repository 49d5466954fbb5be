//! What is known of a window of which readings may be missing: a Kalman filter, for which a reading that came has no
//! error.
//!
//! `x+ = A_s x + G y + ..` with `y = C x + .. + w`: given those y that came the error of (x, y) has a smaller
//! covariance, in which they are 0; `(A_s, G)` takes it one step on. Begun at the first reading, with the range and the
//! deviation of each signal as its error. Where all readings came and nothing was missing before, it is the window of
//! the model itself.

use std::mem::take;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par, Side};

use crate::error::{Error, Result, require_finite, sized};
use crate::identify::whiten;
use crate::matrix::MatrixView;
use crate::memory::{checked_len, covered, room_for_products, try_collect, try_copy, try_room, try_zeros};

use super::shape::{WHAT, Window};
use super::workspace::Workspace;

/// Most of the variance of the next readings that an uncertain window may add, to run.
const UNSURE: f64 = 9.0;
/// Windows behind which it is said that as many more at the same pace will not do.
const PATIENCE: usize = 4;

/// The window after a call.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// The state of the window.
    pub x: Vec<f64>,
    /// Whether all readings and inputs in it are true.
    pub known: bool,
    /// Covariance of its error (n, n), where it is not known.
    pub covariance: Vec<f64>,
    /// What the covariance adds to the variance of the next readings, in units of the noise.
    pub excess: f64,
    /// Complete readings in a row.
    pub since: usize,
    /// Calls in a row in which no reading came.
    pub missed: usize,
    /// All calls; 0 before the first readings.
    pub calls: usize,
    /// How many readings of each output came.
    pub read: Vec<usize>,
    /// The excess a window before.
    pub mark: f64,
    /// The call from which it may start.
    pub first: usize,
    /// Whether as many readings as came will not do.
    pub stuck: bool,
}

impl Contents {
    /// All of it, one after another.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn numbers(&self) -> Result<Vec<f64>> {
        let counts = [self.since, self.missed, self.calls, self.first, usize::from(self.stuck)];
        let covariance = if self.known { &[] } else { &self.covariance[..] };
        let counts = counts.iter().chain(&self.read).map(|count| *count as f64);
        try_collect(
            WHAT,
            [self.excess, self.mark].into_iter().chain(counts).chain(self.x.iter().chain(covariance).copied()),
        )
    }

    /// Whether there were readings.
    #[must_use]
    pub const fn began(&self) -> bool {
        self.calls > 0
    }

    /// The same as another window, in the memory of this one.
    pub(crate) fn copy(&mut self, of: &Self) {
        let (mut x, mut read, mut covariance) = (take(&mut self.x), take(&mut self.read), take(&mut self.covariance));
        x.copy_from_slice(&of.x);
        read.copy_from_slice(&of.read);
        covariance.copy_from_slice(&of.covariance);
        *self = Self { x, read, covariance, ..*of };
    }

    /// Whether a loop may run: full, or long enough and sure enough.
    #[must_use]
    pub fn tells(&self, started: bool) -> bool {
        self.known || (self.excess <= UNSURE && (started || self.calls >= self.first))
    }
}

/// How a window goes on.
#[derive(Debug)]
pub struct Filter {
    pub(crate) window: Window,
    /// C (p, n).
    pub(crate) c: Mat<f64>,
    /// `[A_s G]` (n, n + p).
    pub(crate) step: Mat<f64>,
    noise: Mat<f64>,
    /// `Sigma^(-1/2) C`.
    pub(crate) seen_by: Mat<f64>,
    pub(crate) mean: Vec<f64>,
    /// The error of each state at the first reading.
    pub(crate) apart: Vec<f64>,
    room: Room,
}

/// Memory of a step, so that none asks for any.
#[derive(Debug)]
struct Room {
    small: Workspace,
    came: Vec<usize>,
    /// `C P` (p, n) and `C P C'` (p, p).
    across: Mat<f64>,
    own: Mat<f64>,
    /// The covariance of (x, y), and a product of its size; its rows that came, and the gain for them (p, n + p).
    joint: Mat<f64>,
    product: Mat<f64>,
    rows: Mat<f64>,
    gain: Mat<f64>,
    /// What was not known of (x, y), and the readings with estimates of the missing ones.
    off: Vec<f64>,
    filled: Vec<f64>,
}

impl Room {
    fn new(n: usize, p: usize) -> Result<Self> {
        let (small, came, all) = (Workspace::new(p, n + p)?, try_room(WHAT, p)?, || Mat::zeros(n + p, n + p));
        let [across, own, rows, gain] = [n, p, n + p, n + p].map(|columns| Mat::zeros(p, columns));
        let (joint, product, off, filled) = (all(), all(), try_zeros(WHAT, n + p)?, try_zeros(WHAT, p)?);
        Ok(Self { small, came, across, own, joint, product, rows, gain, off, filled })
    }

    /// `F P F'` in `own`.
    fn seen_through(&mut self, f: &Mat<f64>, covariance: &[f64]) {
        let covariance = MatRef::from_column_major_slice(covariance, f.ncols(), f.ncols());
        matmul(&mut self.across, Accum::Replace, f, covariance, 1.0, Par::Seq);
        matmul(&mut self.own, Accum::Replace, &self.across, f.transpose(), 1.0, Par::Seq);
    }
}

impl Filter {
    /// Of a model `theta` (p, d) with the covariance `noise` of its residuals (p, p); `mean`: of each output (p), taken
    /// where a first reading is missing; `wide`: by how much each output, then each input, may be off before the first
    /// reading, its largest value away from the mean for example (p + m).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Numerical`], [`Error::Memory`].
    pub fn new<'a>(
        window: Window,
        theta: impl Into<MatrixView<'a>>,
        noise: impl Into<MatrixView<'a>>,
        mean: &[f64],
        wide: &[f64],
    ) -> Result<Self> {
        let (n, p, m, d) = (window.states(), window.outputs(), window.inputs(), window.length());
        let (theta, noise) = (theta.into().sized("theta", p, d)?, noise.into().finite("noise", p, p)?);
        for (name, values, len) in [("mean", mean, p), ("wide", wide, p + m)] {
            sized(name, values.len(), len)?;
            require_finite(name, values)?;
        }
        let [of, none] = [&*theta, &try_zeros(WHAT, theta.len())?].map(|of| window.linear(MatrixView::of(of, d)));
        let (of, none) = (of?, none?);
        let (k, past) = (n + m + usize::from(window.intercept()), window.count() * p);
        room_for_products()?;
        covered(WHAT, 256 * (n as u128 + d as u128 + p as u128).pow(2), || {
            let of_outputs =
                MatRef::from_row_major_slice(&theta, p, d) * MatRef::from_row_major_slice(&of.entering, d, k);
            let c = of_outputs.subcols(0, n).to_owned();
            let entry = |i: usize, j: usize| if j < n { none.matrix[i * k + j] } else { of.noise[i * p + j - n] };
            let noise = MatRef::from_row_major_slice(&noise, p, p).to_owned();
            let root = noise.llt(Side::Lower).map_err(|_| {
                Error::Numerical("the covariance of the noise of the readings is not positive definite".into())
            })?;
            let mut seen_by = c.clone();
            whiten(root.L(), seen_by.as_mut());
            let error = |i: usize| if i < past { wide[i % p] } else { wide[p + (i - past) % m] };
            let (mean, apart) = (try_copy(WHAT, mean)?, try_collect(WHAT, (0..n).map(error))?);
            let step = Mat::from_fn(n, n + p, entry);
            Ok(Self { window, c, step, noise, seen_by, mean, apart, room: Room::new(n, p)? })
        })?
    }

    /// A window before the first readings.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn empty(&self) -> Result<Contents> {
        let n = self.window.states();
        let (x, covariance) = (try_zeros(WHAT, n)?, try_zeros(WHAT, checked_len(WHAT, n, n)?)?);
        let read = try_zeros(WHAT, self.window.outputs())?;
        Ok(Contents { x, covariance, read, known: true, ..Contents::default() })
    }

    /// Undo [`Contents::numbers`].
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn restored(&self, numbers: &[f64]) -> Result<Contents> {
        let (n, p) = (self.window.states(), self.window.outputs());
        let known = numbers.len() == 7 + p + n;
        if !known && numbers.len() != 7 + p + n + n * n {
            let (expected, found) = (format!("{} entries", 7 + p + n), numbers.len().to_string());
            return Err(Error::Shape { name: "state", expected, found });
        }
        let (counts, rest) = numbers[2..].split_at(5);
        let (read, rest) = rest.split_at(p);
        let (x, covariance) = rest.split_at(n);
        let (count, mut now) = (|at: usize| counts[at] as usize, self.empty()?);
        now.x.copy_from_slice(x);
        if !known {
            now.covariance.copy_from_slice(covariance);
        }
        now.read.iter_mut().zip(read).for_each(|(to, count)| *to = *count as usize);
        (now.known, now.excess, now.mark, now.stuck) = (known, numbers[0], numbers[1], count(4) == 1);
        (now.since, now.missed, now.calls, now.first) = (count(0), count(1), count(2), count(3));
        Ok(now)
    }

    /// What an uncertain window adds to the covariance of the next readings; zeros of a known one.
    pub(crate) fn unknown(&mut self, now: &Contents) -> &mut Mat<f64> {
        if now.known {
            self.room.own.fill(0.0);
        } else {
            self.room.seen_through(&self.c, &now.covariance);
        }
        &mut self.room.own
    }

    /// A window that is known, of the state `x` (n).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Memory`].
    pub fn full(&self, x: &[f64]) -> Result<Contents> {
        sized("x", x.len(), self.window.states())?;
        require_finite("x", x)?;
        let (calls, mut now) = (self.window.fill() + 1, self.empty()?);
        now.x.copy_from_slice(x);
        now.read.fill(calls);
        (now.since, now.calls) = (calls, calls);
        Ok(now)
    }

    /// The window at a first reading: all before it is taken to be the same.
    pub(crate) fn begun(&mut self, now: &mut Contents, y: &[f64], acted: &[f64], seen: &[bool]) {
        let (p, first) = (y.len(), &mut self.room.filled);
        (0..p).for_each(|i| first[i] = if seen[i] { y[i] } else { self.mean[i] });
        self.window.start(first, acted, &mut now.x);
        now.covariance.fill(0.0);
        for (i, apart) in self.apart.iter().enumerate() {
            let read = self.window.lags() && i < p && seen[i];
            now.covariance[i * (self.apart.len() + 1)] = if read { 0.0 } else { apart.powi(2) };
        }
        now.read.fill(0);
        (now.known, now.mark, now.first, now.stuck) = (false, f64::INFINITY, self.window.fill() + 1, false);
        (now.since, now.missed, now.calls) = (0, 0, 0);
        self.counted(now, seen);
    }

    /// The window one step later, with the readings that came and estimates of the others.
    pub(crate) fn advance(&mut self, now: &mut Contents, y: &[f64], acted: &[f64], seen: &[bool], predicted: &[f64]) {
        if now.known && seen.iter().all(|came| *came) {
            self.window.advance(&mut now.x, y, acted);
            return self.counted(now, seen);
        }
        let (n, p) = (now.x.len(), y.len());
        if now.known {
            now.covariance.fill(0.0);
            now.known = false;
        }
        let Self { room, window, .. } = self;
        room.seen_through(&self.c, &now.covariance);
        let Room { small, came, across, own, joint, product, rows, gain, off, filled } = room;
        *own += &self.noise;
        for (i, j) in (0..n + p).flat_map(|i| (0..n + p).map(move |j| (i, j))) {
            joint[(i, j)] = match (i < n, j < n) {
                (true, true) => now.covariance[i * n + j],
                (true, false) => across[(j - n, i)],
                (false, true) => across[(i - n, j)],
                (false, false) => own[(i - n, j - n)],
            };
        }
        off.fill(0.0);
        came.clear();
        came.extend((0..p).filter(|i| seen[*i]));
        let count = came.len();
        if count > 0 {
            let mut some = own.submatrix_mut(0, 0, count, count);
            let (mut rows, mut gain) = (rows.subrows_mut(0, count), gain.subrows_mut(0, count));
            for (i, at) in came.iter().enumerate() {
                (0..count).for_each(|j| some[(i, j)] = joint[(n + at, n + came[j])]);
                (0..n + p).for_each(|j| rows[(i, j)] = joint[(n + at, j)]);
            }
            gain.copy_from(&rows);
            small.solve(some, gain.as_mut());
            for (j, off) in off.iter_mut().enumerate() {
                *off = came.iter().enumerate().map(|(i, at)| gain[(i, j)] * (y[*at] - predicted[*at])).sum();
            }
            matmul(&mut *product, Accum::Replace, gain.transpose(), &rows, 1.0, Par::Seq);
            *joint -= &*product;
            for i in came.iter().map(|i| n + i) {
                joint.row_mut(i).fill(0.0);
                joint.col_mut(i).fill(0.0);
            }
        }
        let mut half = product.subrows_mut(0, n);
        matmul(half.as_mut(), Accum::Replace, &self.step, &*joint, 1.0, Par::Seq);
        let mut covariance = MatMut::from_column_major_slice_mut(&mut now.covariance, n, n);
        matmul(covariance.as_mut(), Accum::Replace, &half, self.step.transpose(), 1.0, Par::Seq);
        for (i, j) in (0..n).flat_map(|i| (0..i).map(move |j| (i, j))) {
            let mean = (covariance[(i, j)] + covariance[(j, i)]) / 2.0;
            (covariance[(i, j)], covariance[(j, i)]) = (mean, mean);
        }
        for (i, to) in filled.iter_mut().enumerate() {
            *to = if seen[i] { y[i] } else { predicted[i] + off[n + i] };
        }
        now.x.iter_mut().zip(&*off).for_each(|(x, off)| *x += off);
        window.advance(&mut now.x, filled, acted);
        self.counted(now, seen);
    }

    fn counted(&mut self, now: &mut Contents, seen: &[bool]) {
        let (fill, room) = (self.window.fill(), &mut self.room);
        now.calls += 1;
        now.since = if seen.iter().all(|came| *came) { now.since + 1 } else { 0 };
        now.missed = if seen.contains(&true) { 0 } else { now.missed + 1 };
        now.read.iter_mut().zip(seen).for_each(|(count, came)| *count += usize::from(*came));
        now.known |= now.since > fill;
        now.excess = 0.0;
        if !now.known {
            room.seen_through(&self.seen_by, &now.covariance);
            let largest = if room.own.norm_l2().is_finite() { room.small.largest(room.own.as_ref()) } else { None };
            now.excess = largest.unwrap_or(f64::INFINITY);
        }
        if now.calls.is_multiple_of(fill + 1) {
            let slower = (now.excess / now.mark).powi(PATIENCE as i32);
            let then = if now.excess < now.mark { now.excess * slower } else { now.excess };
            now.stuck = now.calls >= PATIENCE * (fill + 1) && (then.is_nan() || then > UNSURE);
            now.mark = now.excess;
        }
    }
}
