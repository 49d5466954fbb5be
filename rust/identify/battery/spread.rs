//! How large the noise is: against what was declared of it, and over states and time.

use super::explained::{Outcomes, explained};
use super::given::{Given, Test, WHAT, dot, zeros};
use super::sums::{Pieces, Sums};
use crate::error::{Error, Result};
use crate::identify::distributions::{chi2_above, chi2_below, f_above};
use crate::identify::symmetric::log_determinant;
use crate::memory::{checked_len, try_copy, try_filled, try_push};

/// What was declared of the noise, beside its mean of 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Declared<'a> {
    /// Gaussian noise of this covariance (n, n).
    Gaussian(&'a [f64]),
    /// Sub-Gaussian noise with this bound (n, n).
    SubGaussian(&'a [f64]),
    /// Noise of at most this norm.
    Bounded(f64),
    /// `sigma^2 I`.
    Scalar,
    /// A diagonal covariance.
    Diagonal,
}

/// Tests of the sum of squares S (n, n) of the residuals of so many pairs and degrees of freedom.
///
/// Gaussian: `tr(Sigma^-1 S) <= ||w||^2 ~ chi2_{n N}` and the same of each state, for any design, since least squares
/// only takes away. Sub-Gaussian: `P(||w||^2 > k + 2 sqrt(k t) + 2 t) <= exp(-t)`, `k = n N` (Hsu, Kakade and Zhang
/// 2012). Bounded: `tr S <= N sigma^2`. "scalar": Mauchly's likelihood ratio, "diagonal": `det` of the correlations,
/// both with Bartlett's factor.
///
/// # Errors
/// [`Error::Shape`], [`Error::Memory`].
pub fn noise_tests(squares: &[f64], n: usize, (size, nu): (usize, usize), declared: Declared<'_>) -> Result<Vec<Test>> {
    let mut tests = Vec::new();
    if squares.len() != checked_len(WHAT, n, n)? {
        let found = squares.len().to_string();
        return Err(Error::Shape { name: "S", expected: format!("{n} x {n} entries"), found });
    }
    if n == 0 || nu == 0 {
        return Ok(tests);
    }
    let trace: f64 = squares.iter().step_by(n + 1).sum();
    let mut push = |name, p_value: f64, share, at| {
        try_push(WHAT, &mut tests, Test { name, p_value: p_value.min(1.0), share, at, each: Vec::new() })
    };
    match declared {
        Declared::Gaussian(known) | Declared::SubGaussian(known) => {
            let (sum, rank) = whitened(squares, known, n)?;
            let all = (rank * size) as f64;
            let gaussian = matches!(declared, Declared::Gaussian(_));
            let above = |x: f64, k: f64| if gaussian { chi2_above(x, k) } else { above_any(x, k) };
            let (mut p_value, mut ratio, mut at) = (above(sum, all), sum / (rank * nu) as f64, Vec::new());
            for i in (0..n).filter(|&i| known[i * (n + 1)] > 0.0) {
                let own = squares[i * (n + 1)] / known[i * (n + 1)];
                let p = above(own, size as f64);
                if p < p_value {
                    (p_value, ratio, at) = (p, own / nu as f64, Vec::from([i]));
                }
            }
            push("noise size", p_value * (n + 1) as f64, ratio.sqrt(), at)?;
            if gaussian {
                let below = chi2_below(sum, (rank * nu) as f64);
                push("noise too large", below, (sum / (rank * nu) as f64).sqrt(), Vec::new())?;
            }
        }
        Declared::Bounded(sigma) => {
            let ratio = (trace / size as f64).sqrt() / sigma;
            push("noise size", if ratio > 1.0 { 0.0 } else { 1.0 }, ratio, Vec::new())?;
        }
        Declared::Scalar | Declared::Diagonal => {
            let log_det = log_determinant(squares, n)?.filter(|_| n > 1 && nu > n + 1);
            let Some(log_det) = log_det else { return Ok(tests) };
            let (p, nu) = (n as f64, nu as f64);
            let (log, factor, degrees) = if declared == Declared::Scalar {
                (p * (trace / p).ln(), (2.0 * p * p + p + 2.0) / (6.0 * p), p * (p + 1.0) / 2.0 - 1.0)
            } else {
                let logs = squares.iter().step_by(n + 1).map(|v| v.ln()).sum::<f64>();
                (logs, (2.0 * p + 5.0) / 6.0, p * (p - 1.0) / 2.0)
            };
            let statistic = (nu - factor) * (log - log_det);
            push("noise shape", chi2_above(statistic, degrees), 1.0 - ((log_det - log) / p).exp(), Vec::new())?;
        }
    }
    Ok(tests)
}

/// `P(||w||^2 > x)` at most, of sub-Gaussian noise of k entries.
fn above_any(x: f64, k: f64) -> f64 {
    if x <= k { 1.0 } else { (-(((2.0 * x - k).sqrt() - k.sqrt()) / 2.0).powi(2)).exp() }
}

/// `tr(Sigma^-1 S)` over states of which the covariance is of full rank, and their number: Cholesky with pivots.
fn whitened(squares: &[f64], known: &[f64], n: usize) -> Result<(f64, usize)> {
    let (mut k, mut s) = (try_copy(WHAT, known)?, try_copy(WHAT, squares)?);
    let mut open = try_filled(WHAT, true, n)?;
    let (mut sum, mut rank) = (0.0, 0);
    loop {
        let part = |j: usize| if known[j * (n + 1)] > 0.0 { k[j * (n + 1)] / known[j * (n + 1)] } else { 0.0 };
        let free = (0..n).filter(|&j| open[j]);
        let Some(at) = free.max_by(|&i, &j| part(i).total_cmp(&part(j))) else { break };
        if part(at).is_nan() || part(at) <= 1e-9 {
            break;
        }
        (open[at], rank) = (false, rank + 1);
        let pivot = k[at * (n + 1)];
        sum += s[at * (n + 1)] / pivot;
        // e_i <- e_i - e_at k_i / pivot, in S and Sigma alike
        let factors = try_copy(WHAT, &k[at * n..(at + 1) * n])?;
        for m in [&mut k, &mut s] {
            for i in (0..n).filter(|&i| open[i]) {
                (0..n).for_each(|j| m[i * n + j] -= factors[i] / pivot * m[at * n + j]);
            }
            for i in (0..n).filter(|&i| open[i]) {
                (0..n).for_each(|j| m[j * n + i] -= factors[i] / pivot * m[j * n + at]);
            }
        }
    }
    Ok((sum, rank))
}

/// Whether the squares of residuals depend on leverage, time, large signals, or the run.
///
/// `(s / p)^(1/3)` of the part s of each row in the sum of squares is nearly normal (Wilson and Hilferty 1931), so that
/// F has its level, which it has not for s itself where few rows have large signals.
pub(super) fn variance(given: &Given<'_>, sums: &Sums<'_>, tests: &mut Vec<Test>) -> Result<()> {
    let (size, signals) = (given.size(), &sums.columns.signals);
    let mut size_of = try_copy(WHAT, &sums.parts)?;
    size_of.iter_mut().for_each(|v| *v = v.cbrt());
    let mean = size_of.iter().sum::<f64>() / size as f64;
    size_of.iter_mut().for_each(|v| *v -= mean);
    let whole = [dot(&size_of, &size_of)];
    let Some(of) = Outcomes::new(&whole, &[1.0], 1, size.saturating_sub(1))? else { return Ok(()) };
    let q = 2 + signals.len();
    let (mut row, mut means) = (zeros(q)?, zeros(q)?);
    let fill = |t: usize, row: &mut [f64]| {
        row[0] = sums.leverages[t];
        row[1] = t as f64 / size as f64 - 0.5;
        let z = given.z(t);
        row[2..].iter_mut().zip(signals).for_each(|(to, &(j, one))| *to = (z[j] * one).abs().ln_1p());
    };
    for t in 0..size {
        fill(t, &mut row);
        means.iter_mut().zip(&row).for_each(|(to, v)| *to += v / size as f64);
    }
    let (mut left, mut own, mut along) = (zeros(q * q)?, zeros(q)?, zeros(q)?);
    for (t, size_of) in size_of.iter().enumerate() {
        fill(t, &mut row);
        for i in 0..q {
            own[i] += row[i] * row[i];
            along[i] += size_of * (row[i] - means[i]);
            (0..q).for_each(|j| left[i * q + j] += (row[i] - means[i]) * (row[j] - means[j]));
        }
    }
    let mut p_value = 1.0f64;
    let mut share = 0.0;
    if let Some(found) = explained(&left, &own, &along, &of)? {
        (p_value, share) = (found.p_value, found.share);
    }
    let pieces = Pieces::of(given, given.fitted.rank());
    let (mut between, mut t) = (0.0, 0);
    while t < size && pieces.count > 1 {
        let end = pieces.end(t).min(size);
        let sum: f64 = size_of[t..end].iter().sum();
        between += sum * sum / (end - t) as f64;
        t = end;
    }
    if pieces.count > 1 && 3 * pieces.count < size {
        let (a, b) = ((pieces.count - 1) as f64, (size - pieces.count) as f64);
        let other = f_above(between / a * b / (whole[0] - between).max(f64::MIN_POSITIVE), a, b);
        if other < p_value {
            (p_value, share) = (other, between / whole[0]);
        }
        p_value = (2.0 * p_value).min(1.0);
    }
    try_push(WHAT, tests, Test { name: "variance", p_value, share, at: Vec::new(), each: Vec::new() })
}
