//! What is known of a window of which readings may be missing: a Kalman filter, for which a reading that came has no error.
//!
//! `x+ = A_s x + G y + ..` with `y = C x + .. + w`: given those y that came the error of (x, y) has a smaller covariance, in
//! which they are 0; `(A_s, G)` takes it one step on. Begun at the first reading, with the range and the deviation of each
//! signal as its error. Where all readings came and nothing was missing before, it is the window of the model itself.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result, require_finite, sized};
use crate::memory::{covered, room_for_products, try_collect, try_copy, try_zeros};

use super::shape::{WHAT, Window};

/// Most of the variance of the next readings that an uncertain window may add, to run.
const UNSURE: f64 = 9.0;
/// Windows behind which it is said that as many more at the same pace will not do.
const PATIENCE: usize = 4;

/// The window after a call.
#[derive(Debug, Clone)]
pub struct Contents {
    /// The state of the window.
    pub x: Vec<f64>,
    /// Covariance of its error; None: all readings and inputs in it are true.
    pub covariance: Option<Mat<f64>>,
    /// What the covariance adds to the variance of the next readings, in units of the noise.
    pub excess: f64,
    /// Complete readings in a row.
    pub since: usize,
    /// Calls in a row in which no reading came.
    pub missed: usize,
    /// All calls.
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
        let n = self.x.len();
        let covariance = self.covariance.iter().flat_map(|of| (0..n * n).map(move |at| of[(at / n, at % n)]));
        let counts = counts.iter().chain(&self.read).map(|count| *count as f64);
        try_collect(
            WHAT,
            [self.excess, self.mark].into_iter().chain(counts).chain(self.x.iter().copied()).chain(covariance),
        )
    }

    /// Whether a loop may run: full, or long enough and sure enough.
    #[must_use]
    pub fn tells(&self, started: bool) -> bool {
        self.covariance.is_none() || (self.excess <= UNSURE && (started || self.calls >= self.first))
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
}

impl Filter {
    /// Of a model `theta` (p, d) with the covariance `noise` of its residuals (p, p); `mean`: of each output (p), taken where a
    /// first reading is missing; `wide`: by how much each output, then each input, may be off before the first reading, its
    /// largest value away from the mean for example (p + m).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Numerical`], [`Error::Memory`].
    pub fn new(window: Window, theta: &[f64], noise: &[f64], mean: &[f64], wide: &[f64]) -> Result<Self> {
        let (n, p, m) = (window.states(), window.outputs(), window.inputs());
        for (name, values, len) in [("noise", noise, p * p), ("mean", mean, p), ("wide", wide, p + m)] {
            sized(name, values.len(), len)?;
            require_finite(name, values)?;
        }
        let (of, none) = (window.linear(theta)?, window.linear(&try_zeros(WHAT, theta.len())?)?);
        let (d, k, past) = (window.length(), n + m + usize::from(window.intercept()), window.count() * p);
        room_for_products()?;
        covered(WHAT, 256 * (n as u128 + d as u128 + p as u128).pow(2), || {
            let of_outputs =
                MatRef::from_row_major_slice(theta, p, d) * MatRef::from_row_major_slice(&of.entering, d, k);
            let c = of_outputs.subcols(0, n).to_owned();
            let entry = |i: usize, j: usize| if j < n { none.matrix[i * k + j] } else { of.noise[i * p + j - n] };
            let noise = MatRef::from_row_major_slice(noise, p, p).to_owned();
            let root = noise.llt(Side::Lower).map_err(|_| {
                Error::Numerical("the covariance of the noise of the readings is not positive definite".into())
            })?;
            // L^-1 C
            let mut seen_by = c.clone();
            for j in 0..n {
                for i in 0..p {
                    let done = (0..i).map(|q| root.L()[(i, q)] * seen_by[(q, j)]).sum::<f64>();
                    seen_by[(i, j)] = (seen_by[(i, j)] - done) / root.L()[(i, i)];
                }
            }
            let error = |i: usize| if i < past { wide[i % p] } else { wide[p + (i - past) % m] };
            let (mean, apart) = (try_copy(WHAT, mean)?, try_collect(WHAT, (0..n).map(error))?);
            Ok(Self { window, c, step: Mat::from_fn(n, n + p, entry), noise, seen_by, mean, apart })
        })?
    }

    /// `z = J (x; u; 1)`.
    pub(crate) fn regressors(&self, now: &Contents, acted: &[f64]) -> Result<Vec<f64>> {
        let mut z = try_zeros(WHAT, self.window.length())?;
        self.window.regressors(&now.x, acted, 1.0, &mut z);
        Ok(z)
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
        let count = |at: usize| counts[at] as usize;
        let square = || MatRef::from_row_major_slice(covariance, n, n).to_owned();
        Ok(Contents {
            x: try_copy(WHAT, x)?,
            covariance: if known { None } else { Some(covered(WHAT, 8 * n as u128 * (n as u128 + 8), square)?) },
            excess: numbers[0],
            since: count(0),
            missed: count(1),
            calls: count(2),
            read: try_collect(WHAT, read.iter().map(|count| *count as usize))?,
            mark: numbers[1],
            first: count(3),
            stuck: count(4) == 1,
        })
    }

    /// What an uncertain window adds to the covariance of the next readings.
    pub(crate) fn unknown(&self, now: &Contents) -> Option<Mat<f64>> {
        now.covariance.as_ref().map(|covariance| &self.c * covariance * self.c.transpose())
    }

    /// A window that is known, of the state `x` (n).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Memory`].
    pub fn full(&self, x: &[f64]) -> Result<Contents> {
        sized("x", x.len(), self.window.states())?;
        require_finite("x", x)?;
        let (calls, mut read) = (self.window.fill() + 1, try_zeros(WHAT, self.window.outputs())?);
        read.fill(calls);
        let (x, since) = (try_copy(WHAT, x)?, calls);
        let (covariance, excess, mark, stuck) = (None, 0.0, 0.0, false);
        Ok(Contents { x, covariance, excess, since, missed: 0, calls, read, mark, first: 0, stuck })
    }

    /// The window at a first reading: all before it is taken to be the same.
    pub(crate) fn begun(&self, y: &[f64], acted: &[f64], seen: &[bool]) -> Result<Contents> {
        let (n, p) = (self.window.states(), self.window.outputs());
        let mut contents = self.full(&try_zeros(WHAT, n)?)?;
        let first = try_collect(WHAT, (0..p).map(|i| if seen[i] { y[i] } else { self.mean[i] }))?;
        self.window.start(&first, acted, &mut contents.x);
        let error = |i: usize| if self.window.lags() && i < p && seen[i] { 0.0 } else { self.apart[i].powi(2) };
        contents.covariance = Some(covered(WHAT, 8 * n as u128 * (n as u128 + 8), || {
            Mat::from_fn(n, n, |i, j| if i == j { error(i) } else { 0.0 })
        })?);
        contents.read.fill(0);
        (contents.since, contents.calls, contents.mark) = (0, 0, f64::INFINITY);
        contents.first = self.window.fill() + 1;
        self.counted(contents, seen)
    }

    /// The window one step later, with the readings that came and estimates of the others.
    pub(crate) fn advanced(
        &self,
        now: &Contents,
        y: &[f64],
        acted: &[f64],
        seen: &[bool],
        predicted: &[f64],
    ) -> Result<Contents> {
        let (n, p, mut next) = (now.x.len(), y.len(), now.clone());
        if now.covariance.is_none() && seen.iter().all(|came| *came) {
            self.window.advance(&mut next.x, y, acted);
            return self.counted(next, seen);
        }
        let came = try_collect(WHAT, (0..p).filter(|i| seen[*i]))?;
        room_for_products()?;
        let off = covered(WHAT, 256 * (n as u128 + p as u128).pow(2), || {
            let none = Mat::zeros(n, n);
            let covariance = now.covariance.as_ref().unwrap_or(&none);
            let across = &self.c * covariance;
            let own = &across * self.c.transpose() + &self.noise;
            // of (x, y)
            let mut joint = Mat::from_fn(n + p, n + p, |i, j| match (i < n, j < n) {
                (true, true) => covariance[(i, j)],
                (true, false) => across[(j - n, i)],
                (false, true) => across[(i - n, j)],
                (false, false) => own[(i - n, j - n)],
            });
            let mut off = Mat::zeros(n + p, 1);
            if !came.is_empty() {
                let some = Mat::from_fn(came.len(), came.len(), |i, j| own[(came[i], came[j])]);
                let rows = Mat::from_fn(came.len(), n + p, |i, j| joint[(n + came[i], j)]);
                let gain = some.partial_piv_lu().solve(&rows);
                off = gain.transpose() * Mat::from_fn(came.len(), 1, |i, _| y[came[i]] - predicted[came[i]]);
                joint -= gain.transpose() * &rows;
                for i in came.iter().map(|i| n + i) {
                    joint.row_mut(i).fill(0.0);
                    joint.col_mut(i).fill(0.0);
                }
            }
            let after = &self.step * joint * self.step.transpose();
            next.covariance = Some(Mat::from_fn(n, n, |i, j| (after[(i, j)] + after[(j, i)]) / 2.0));
            off
        })?;
        let filled = (0..p).map(|i| if seen[i] { y[i] } else { predicted[i] + off[(n + i, 0)] });
        let filled = try_collect(WHAT, filled)?;
        next.x.iter_mut().enumerate().for_each(|(i, x)| *x += off[(i, 0)]);
        self.window.advance(&mut next.x, &filled, acted);
        self.counted(next, seen)
    }

    fn counted(&self, mut now: Contents, seen: &[bool]) -> Result<Contents> {
        let fill = self.window.fill();
        now.calls += 1;
        now.since = if seen.iter().all(|came| *came) { now.since + 1 } else { 0 };
        now.missed = if seen.contains(&true) { 0 } else { now.missed + 1 };
        now.read.iter_mut().zip(seen).for_each(|(count, came)| *count += usize::from(*came));
        if now.since > fill {
            now.covariance = None;
        }
        now.excess = match &now.covariance {
            None => 0.0,
            Some(covariance) => {
                let added = &self.seen_by * covariance * self.seen_by.transpose();
                let finite = added.norm_l2().is_finite();
                let values = finite.then(|| added.self_adjoint_eigenvalues(Side::Lower).ok()).flatten();
                values.and_then(|values| values.last().copied()).unwrap_or(f64::INFINITY)
            }
        };
        if now.calls.is_multiple_of(fill + 1) {
            let slower = (now.excess / now.mark).powi(PATIENCE as i32);
            let then = if now.excess < now.mark { now.excess * slower } else { now.excess };
            now.stuck = now.calls >= PATIENCE * (fill + 1) && (then.is_nan() || then > UNSURE);
            now.mark = now.excess;
        }
        Ok(now)
    }
}
