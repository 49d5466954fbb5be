//! Exact covariances of averages of realizations, of the controls they give, and of states over several steps.
//!
//! One realization of a vector has the covariance `Cv(w) = g diag|w| - w w'`. Drawn columns `a_j` give
//! `E[A^s M A^s'] = A M A' + sum_j M_jj Cv(a_j)`; drawn rows change the diagonal of `A M A'` alone. Variances are sums of
//! nonnegative terms, hence without cancellation.

use super::fractions::fractions;
use super::sizes::{one_norm, others, sign};
use crate::control::{Factored, times, transposed};
use crate::error::{Error, Result, sized};
use crate::memory::{checked_len, try_collect, try_copy, try_extend, try_room, try_zeros};
use crate::parallel::Stop;
use crate::scaled::power_of_two_scale;
use crate::vector::{axpy, dot};

const WHAT: &str = "the covariances";

/// The realizations that are averaged.
#[derive(Debug, Clone, Copy)]
pub struct Sampling {
    /// How many there are, at most `2^53`; 0 for what is known exactly.
    pub size: u64,
    /// Whether they are systematic samples, not independent ones.
    pub systematic: bool,
}

impl Sampling {
    pub(super) const ONE: Self = Self { size: 1, systematic: false };

    /// `1 / N`; 0 for what is known exactly.
    fn rate(self) -> f64 {
        if self.size > 0 { 1.0 / self.size as f64 } else { 0.0 }
    }

    /// `(g / N)^2 v`, in a unit in which `g^2` does not overflow.
    fn squared(self, w: &[f64]) -> impl Fn(f64) -> f64 {
        let unit = power_of_two_scale(w);
        let scale = w.iter().map(|v| (v / unit).abs()).sum::<f64>() * self.rate();
        move |v| v * scale * scale * unit * unit
    }

    /// The variances of the entries of a vector's average.
    fn variances(self, w: &[f64]) -> Result<Vec<f64>> {
        let mut found = try_zeros(WHAT, w.len())?;
        if self.systematic && self.size > 0 {
            let (squared, parts) = (self.squared(w), fractions(w, self.size, false)?);
            found.iter_mut().zip(&parts).for_each(|(to, (f, rest))| *to = squared(f * rest));
        } else if self.size > 0 {
            let absolute = try_collect(WHAT, w.iter().map(|v| v.abs()))?;
            others(&absolute, &mut found);
            found.iter_mut().zip(&absolute).for_each(|(to, v)| *to *= v * self.rate());
        }
        Ok(found)
    }

    /// `E||average - w||^2` of vectors of n entries, summed.
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Memory`], [`Error::Value`] for too many systematic samples.
    pub fn mean_square(self, lines: &[f64], n: usize) -> Result<f64> {
        let mut total = 0.0;
        for line in lines.chunks_exact(n.max(1)) {
            total += self.variances(line)?.iter().sum::<f64>();
        }
        if total.is_finite() { Ok(total) } else { Err(Error::Overflow { what: "the mean squared error" }) }
    }

    /// The covariances (n, n) of the averages of vectors of n entries.
    ///
    /// # Errors
    /// As [`mean_square`](Self::mean_square).
    pub fn covariances(self, lines: &[f64], n: usize, stop: &Stop) -> Result<Vec<f64>> {
        let mut found = try_room(WHAT, checked_len(WHAT, lines.len(), n)?)?;
        for line in lines.chunks_exact(n.max(1)) {
            stop.check()?;
            try_extend(WHAT, &mut found, self.covariance(line)?)?;
        }
        finite(found)
    }

    pub(super) fn covariance(self, w: &[f64]) -> Result<Vec<f64>> {
        let (n, own) = (w.len(), self.variances(w)?);
        let mut found = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
        if self.size == 0 {
            return Ok(found);
        }
        let (squared, rate) = (self.squared(w), self.rate());
        let parts = if self.systematic { fractions(w, self.size, true)? } else { Vec::new() };
        // the counts are floor(c_i) - floor(c_{i-1}) + b_i - b_{i-1}; the covariance of b_{i-1} and b_{k-1}
        let both = |i: usize, k: usize| {
            let ((f, f_rest), (h, h_rest)) = (parts[i.max(1) - 1], parts[k.max(1) - 1]);
            if i.min(k) == 0 { 0.0 } else { f.min(h) * f_rest.min(h_rest) }
        };
        for (i, row) in found.chunks_exact_mut(n.max(1)).enumerate() {
            for (k, to) in row.iter_mut().enumerate() {
                *to = if i == k {
                    own[i]
                } else if self.systematic {
                    let counts = (both(i + 1, k + 1) - both(i, k + 1)) - (both(i + 1, k) - both(i, k));
                    // at most the product of the standard deviations, also where the differences are rounding
                    let most = own[i].sqrt() * own[k].sqrt();
                    sign(w[i]) * sign(w[k]) * squared(counts).max(-most).min(most)
                } else {
                    (0.0 - w[i] * w[k]) * rate
                };
            }
        }
        Ok(found)
    }

    /// `F C F'` for the covariance C of a vector and the points `F e_i` (n, r).
    fn carried(self, points: &[f64], w: &[f64], r: usize) -> Result<Vec<f64>> {
        if self.systematic || self.size == 0 {
            return around(&transposed(points, r)?, &self.covariance(w)?, w.len());
        }
        let mut found = pushed(points, w, r)?;
        found.iter_mut().for_each(|v| *v *= self.rate());
        Ok(found)
    }
}

/// A matrix of which an average is known.
#[derive(Debug, Clone, Copy)]
pub struct Averaged<'a> {
    /// The matrix itself, row by row.
    pub entries: &'a [f64],
    /// Its columns.
    pub columns: usize,
    /// Whether its rows are drawn, not its columns.
    pub rows: bool,
    /// The average of each line.
    pub average: Sampling,
}

impl Averaged<'_> {
    /// `E[A_hat M A_hat']`.
    ///
    /// # Errors
    /// As [`Sampling::mean_square`]; [`Error::Shape`].
    pub fn second_moment(&self, m: &[f64]) -> Result<Vec<f64>> {
        fits("M", m, self.columns, self.columns)?;
        let mut found = self.excess(Some(m), None)?;
        add(&mut found, &around(self.entries, m, self.columns)?);
        finite(found).map_err(|_| Error::Overflow { what: "the second moment" })
    }

    /// `E[A_hat M A_hat'] - A M A'` for `M = C + x x'`.
    pub(super) fn excess(&self, c: Option<&[f64]>, x: Option<&[f64]>) -> Result<Vec<f64>> {
        let (a, m, average) = (self.entries, self.columns, self.average);
        let n = a.len().checked_div(m).unwrap_or(0);
        let own = |j: usize| c.map_or(0.0, |c| c[j * m + j]) + x.map_or(0.0, |x| x[j] * x[j]);
        if self.rows && average.size > 0 {
            let mut found: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
            let own = if average.systematic { self.systematic_rows(c, x)? } else { self.independent_rows(c, x)? };
            found.iter_mut().step_by(n + 1).zip(own).for_each(|(to, v)| *to = v);
            return Ok(found);
        }
        let lines = transposed(a, m)?;
        let mut found = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
        if average.systematic {
            for (j, line) in lines.chunks_exact(n).enumerate() {
                axpy(own(j), &average.covariance(line)?, &mut found);
            }
        } else if average.size > 0 {
            let left = try_collect(WHAT, a.iter().enumerate().map(|(at, v)| 0.0 - v * own(at % m) * average.rate()))?;
            found = times(&left, &lines, m)?;
            let mut variances: Vec<f64> = try_zeros(WHAT, n)?;
            for (j, line) in lines.chunks_exact(n).enumerate() {
                axpy(own(j), &average.variances(line)?, &mut variances);
            }
            found.iter_mut().step_by(n + 1).zip(variances).for_each(|(to, v)| *to = v);
        }
        Ok(found)
    }

    /// The variances of independently drawn rows.
    fn independent_rows(&self, c: Option<&[f64]>, x: Option<&[f64]>) -> Result<Vec<f64>> {
        let (m, rate) = (self.columns, self.average.rate());
        let apart = c.map(|c| -> Result<Vec<f64>> {
            let mut apart = try_copy(WHAT, c)?;
            apart.iter_mut().step_by(m + 1).for_each(|v| *v = 0.0);
            times(self.entries, &apart, m)
        });
        let (apart, mut found) = (apart.transpose()?, try_room(WHAT, self.entries.len() / m)?);
        for (i, row) in self.entries.chunks_exact(m).enumerate() {
            // g sum_j |a_j| y_j^2, y_j = sign(a_j) x_j minus its mean
            let mut total = x.map_or(Ok(0.0), |x| pushed(x, row, 1).map(|of_x| of_x[0]))?;
            // sum_j |a_j| (g - |a_j|) C_jj - sum_{j != k} a_j a_k C_jk
            if let (Some(c), Some(apart)) = (c, &apart) {
                let own = Sampling::ONE.variances(row)?;
                total += own.iter().enumerate().map(|(j, own)| own * c[j * m + j]).sum::<f64>();
                total -= dot(&apart[i * m..(i + 1) * m], row);
            }
            found.push(rate * total);
        }
        Ok(found)
    }

    /// Those of rows that are systematic samples: `<V, C> + x' V x` for the covariance V of a row.
    fn systematic_rows(&self, c: Option<&[f64]>, x: Option<&[f64]>) -> Result<Vec<f64>> {
        let mut found = try_room(WHAT, self.entries.len() / self.columns)?;
        for row in self.entries.chunks_exact(self.columns) {
            let covariance = self.average.covariance(row)?;
            let mut total = c.map_or(0.0, |c| dot(c, &covariance));
            if let Some(x) = x {
                // V times the signs is 0
                let mut y = centred(x, row, 1)?;
                y.iter_mut().zip(row).for_each(|(y, v)| *y *= sign(*v));
                total += around(&y, &covariance, self.columns)?[0];
            }
            found.push(total);
        }
        Ok(found)
    }
}

/// The covariance of `xf_hat - A_hat x0_hat` from so many realizations of `x0` and `xf`; with B that of the control by
/// its pseudoinverse (true) or of the state that it leads to. In pairs N controls are averaged (diagonal fusion), not
/// every entity for itself (product fusion).
///
/// # Errors
/// As [`Sampling::mean_square`]; [`Error::Shape`].
pub fn fused_covariance(
    mut a: Averaged<'_>,
    [x0, xf]: [&[f64]; 2],
    mut sizes: [u64; 2],
    paired: bool,
    b: Option<(&Factored, bool)>,
) -> Result<Vec<f64>> {
    let n = xf.len();
    sized("x0", x0.len(), a.columns)?;
    fits("A", a.entries, n, x0.len())?;
    let mut total = 1.0;
    if paired {
        // one pair, over N; what is exact stays so
        total = Sampling { size: sizes[0].max(sizes[1]).max(a.average.size), ..a.average }.rate();
        sizes = sizes.map(|size| size.min(1));
        a.average.size = a.average.size.min(1);
    }
    let [first, last] = sizes.map(|size| Sampling { size, ..a.average });
    let mut found = last.covariance(xf)?;
    add(&mut found, &first.carried(&transposed(a.entries, x0.len())?, x0, n)?);
    // given x0_hat, A_hat x0_hat has the covariance of A_hat at x0_hat
    add(&mut found, &a.excess(Some(&first.covariance(x0)?), Some(x0))?);
    found.iter_mut().for_each(|v| *v *= total);
    let Some((b, control)) = b else { return finite(found) };
    sized("B", b.rows, n)?;
    let (s, outer, side) =
        if control { (b.s(), &b.parts.right, b.cols) } else { (&b.s()[..0], &b.parts.basis, b.rows) };
    if b.s().is_empty() {
        return try_zeros(WHAT, checked_len(WHAT, side, side)?);
    }
    let mut inner = around(&b.parts.basis, &found, n)?;
    let pairs = s.iter().flat_map(|s| b.s().iter().map(move |t| (s, t)));
    inner.iter_mut().zip(pairs).for_each(|(v, (s, t))| *v = *v / s / t);
    symmetric(around(&transposed(outer, side)?, &inner, b.s().len())?, side)
}

/// The covariance of the state after the steps of the best control by averages of `x0`, `xf` and A, of so many
/// independent realizations of the vectors: its leading term, from the exact `states` x(0), .., x(K).
///
/// # Errors
/// As [`fused_covariance`]; [`Error::Interrupted`].
pub fn final_covariance(a: Averaged<'_>, states: &[f64], xf: &[f64], sizes: [u64; 2], stop: &Stop) -> Result<Vec<f64>> {
    let (n, steps) = (xf.len(), (states.len() / xf.len().max(1)).saturating_sub(1));
    fits("A", a.entries, n, a.columns)?;
    fits("states", states, steps + 1, a.columns)?;
    let [first, last] = sizes.map(|size| Sampling { size, ..a.average });
    let (back, square, x) = (transposed(a.entries, n)?, a.entries.len(), &states[..steps * n]);
    // (A')^{K-1-k} at k, and (A')^K
    let mut carry: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, steps, square)?)?;
    let mut power: Vec<f64> = try_zeros(WHAT, square)?;
    power.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
    for to in carry.chunks_exact_mut(square).rev() {
        stop.check()?;
        to.copy_from_slice(&power);
        power = times(&power, &back, n)?;
    }
    let mut found = last.covariance(xf)?;
    add(&mut found, &first.carried(&power, &states[..n], n)?);
    // sum_k x_c(k) (A')^{K-1-k} at c
    let led = times(&transposed(x, n)?, &carry, steps)?;
    for (j, line) in if a.rows { a.entries } else { &back }.chunks_exact(n).enumerate() {
        stop.check()?;
        let mut points = try_room(WHAT, square)?;
        for c in 0..n {
            points.extend_from_slice(&led[if a.rows { c * square + j * n } else { j * square + c * n }..][..n]);
        }
        add(&mut found, &a.average.carried(&points, line, n)?);
    }
    symmetric(found, n)
}

/// The covariances of the averaged state along `states` (K + 1, n), with new realizations of A and B in every step and
/// of the first state: of averages of each, or of one run.
///
/// # Errors
/// As [`final_covariance`].
pub fn trajectory_covariances(
    [a, b]: [Averaged<'_>; 2],
    start: Sampling,
    states: &[f64],
    inputs: &[f64],
    stop: &Stop,
) -> Result<Vec<f64>> {
    let (n, m) = (a.columns, b.columns);
    fits("A", a.entries, n, n)?;
    fits("B", b.entries, n, m)?;
    fits("states", states, inputs.len() / m + 1, n)?;
    let mut found = try_room(WHAT, checked_len(WHAT, states.len(), n)?)?;
    let mut now = start.covariance(&states[..n])?;
    for (x, u) in states.chunks_exact(n).zip(inputs.chunks_exact(m)) {
        stop.check()?;
        let mut next = around(a.entries, &now, n)?;
        add(&mut next, &a.excess(Some(&now), Some(x))?);
        add(&mut next, &b.excess(None, Some(u))?);
        try_extend(WHAT, &mut found, std::mem::replace(&mut now, next))?;
    }
    try_extend(WHAT, &mut found, now)?;
    finite(found)
}

/// `F C F'` for C (n, n).
pub(super) fn around(f: &[f64], c: &[f64], n: usize) -> Result<Vec<f64>> {
    times(&times(f, c, n)?, &transposed(f, n)?, n)
}

/// `sign(w_i) p_i` minus their mean by the weights |w|. The heaviest is subtracted first, and is then exactly 0, so that
/// squares keep their relative accuracy.
fn centred(points: &[f64], w: &[f64], r: usize) -> Result<Vec<f64>> {
    let g = Some(one_norm(w)).filter(|g| *g > 0.0).unwrap_or(1.0);
    let mut y: Vec<f64> = try_room(WHAT, points.len())?;
    for (s, point) in w.iter().map(|w| sign(*w)).zip(points.chunks_exact(r)) {
        y.extend(point.iter().map(|p| s * p));
    }
    let heaviest = (1..w.len()).fold(0, |k, i| if w[i].abs() > w[k].abs() { i } else { k });
    let first = try_copy(WHAT, &y[heaviest * r..(heaviest + 1) * r])?;
    let mut mean: Vec<f64> = try_zeros(WHAT, r)?;
    for (point, w) in y.chunks_exact_mut(r).zip(w) {
        axpy(-1.0, &first, point);
        axpy(w.abs(), point, &mut mean);
    }
    mean.iter_mut().for_each(|mean| *mean /= g);
    y.chunks_exact_mut(r).for_each(|point| axpy(-1.0, &mean, point));
    Ok(y)
}

/// `F Cv(w) F' = g sum_i |w_i| y_i y_i'` with `y_i = sign(w_i) F e_i` minus its mean, for the points `F e_i`.
pub(super) fn pushed(points: &[f64], w: &[f64], r: usize) -> Result<Vec<f64>> {
    let g = one_norm(w);
    if g == 0.0 {
        return try_zeros(WHAT, checked_len(WHAT, r, r)?);
    }
    let y = centred(points, w, r)?;
    let mut left = transposed(&y, r)?;
    left.chunks_exact_mut(w.len()).for_each(|row| row.iter_mut().zip(w).for_each(|(v, w)| *v *= w.abs()));
    let mut found = times(&left, &y, w.len())?;
    found.iter_mut().for_each(|v| *v *= g);
    Ok(found)
}

/// A matrix with these sizes.
fn fits(name: &'static str, found: &[f64], rows: usize, columns: usize) -> Result<()> {
    sized(name, found.len().max(1), checked_len(WHAT, rows, columns)?)
}

fn add(to: &mut [f64], values: &[f64]) {
    to.iter_mut().zip(values).for_each(|(to, v)| *to += v);
}

/// `(C + C') / 2`
fn symmetric(mut c: Vec<f64>, n: usize) -> Result<Vec<f64>> {
    for (i, k) in (0..n).flat_map(|i| (0..i).map(move |k| (i, k))) {
        let mean = (c[i * n + k] + c[k * n + i]) / 2.0;
        (c[i * n + k], c[k * n + i]) = (mean, mean);
    }
    finite(c)
}

fn finite(values: Vec<f64>) -> Result<Vec<f64>> {
    if values.iter().all(|v| v.is_finite()) { Ok(values) } else { Err(Error::Overflow { what: "the covariance" }) }
}
