//! The average of N realizations of a vector, or of the lines of a matrix.

use super::sizes::{WHAT, nonzero, one_norm, others, unit_of};
use crate::control::{symmetric_norm, times, transposed};
use crate::error::{Error, Result, require_finite};
use crate::memory::{try_collect, try_zeros};

/// The norm of an error. That of all entries is the same for rows and columns; the sum of sizes is for one line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Norm {
    /// The sum of the sizes of the entries.
    One,
    /// The root of the sum of squares.
    Frobenius,
    /// The largest singular value, which has no [`Inequality::Bousquet`](super::Inequality) of its own.
    Spectral,
}

/// The numbers of lines with `p_i = |a_i| / g`, `g = ||a||_1`. Lines with fewer than two nonzero entries are always
/// exact and left out.
#[derive(Debug, Clone, Copy)]
pub struct Lines {
    pub(super) norm: Norm,
    /// The unit of all other numbers.
    pub unit: f64,
    /// Lines, entries that are not 0 in one of them at least, and entries that are not 0.
    pub(super) sizes: (usize, usize, usize),
    /// `sum_j g_j`
    pub(super) g: f64,
    /// `sum_j (g_j^2 - ||a_j||^2)`, the mean square error of one realization.
    pub(super) mean_square: f64,
    /// `max_j lambda_max(Cv(a_j))`, `Cv(a) = g diag|a| - a a'`.
    pub(super) top: f64,
    /// The largest error of a realization in the norm, and the largest one of a line, squared.
    pub(super) farthest: f64,
    pub(super) deviation: f64,
    /// `sum_j k_j g_j^2` for lines with `k_j` nonzero entries.
    pub(super) hits: f64,
    /// `max(||sum_j Cv(a_j)||_2, max_j (g_j^2 - ||a_j||^2))`, of Bernstein's inequality.
    pub(super) variance: f64,
}

impl Lines {
    /// The numbers of lines of n entries each.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Numerical`], [`Error::Memory`].
    pub fn new(lines: &[f64], n: usize, norm: Norm) -> Result<Self> {
        if n == 0 || !lines.len().is_multiple_of(n) {
            let found = lines.len().to_string();
            return Err(Error::Shape { name: "lines", expected: format!("rows of {n} entries"), found });
        }
        require_finite("lines", lines)?;
        let random = lines.chunks_exact(n).filter(|line| nonzero(line) >= 2);
        let mut kept = try_collect(WHAT, random.flatten().copied())?;
        let unit = unit_of(&kept);
        kept.iter_mut().for_each(|v| *v /= unit);
        let mut found = Self {
            norm,
            unit,
            sizes: (kept.len() / n, (0..n).filter(|i| kept.iter().skip(*i).step_by(n).any(|v| *v != 0.0)).count(), 0),
            g: 0.0,
            mean_square: 0.0,
            top: 0.0,
            farthest: 0.0,
            deviation: 0.0,
            hits: 0.0,
            variance: 0.0,
        };
        let (mut absolute, mut apart): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        let (mut rest, mut diagonal): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        let mut sum_of_deviations = 0.0;
        for line in kept.chunks_exact(n) {
            absolute.iter_mut().zip(line).for_each(|(to, v)| *to = v.abs());
            others(&absolute, &mut apart);
            // g_j^2 - ||a_j||^2, without cancellation
            let mean_square: f64 = absolute.iter().zip(&apart).map(|(v, apart)| v * apart).sum();
            diagonal.iter_mut().zip(&absolute).zip(&apart).for_each(|((to, v), apart)| *to += v * apart);
            let (g, k) = (one_norm(line), nonzero(line));
            // ||g sign(a_i) e_i - a||^2 = (g - |a_i|)^2 + sum_{k != i} a_k^2, or 2 (g - |a_i|) in the 1-norm
            absolute.iter_mut().for_each(|v| *v *= *v);
            others(&absolute, &mut rest);
            let atoms = line.iter().zip(&apart).zip(&rest).filter(|((v, _), _)| **v != 0.0);
            let deviation = atoms.fold(0.0f64, |m, ((_, apart), rest)| m.max(apart * apart + rest));
            let atoms = line.iter().zip(&apart).filter(|(v, _)| **v != 0.0);
            let in_sum = atoms.fold(0.0f64, |m, (_, apart)| m.max(2.0 * apart));
            sum_of_deviations += deviation;
            found.sizes.2 += k;
            found.g += g;
            found.mean_square += mean_square;
            found.variance = found.variance.max(mean_square);
            found.deviation = found.deviation.max(deviation);
            found.farthest = found.farthest.max(in_sum);
            found.hits += k as f64 * g * g;
            found.top = found.top.max(g * g * largest_eigenvalue(line, g));
        }
        if norm != Norm::One {
            found.farthest = sum_of_deviations.sqrt();
        }
        if norm == Norm::Spectral && !kept.is_empty() {
            // off the diagonal -sum_j a_j a_j'
            let mut total = times(&transposed(&kept, n)?, &kept, kept.len() / n)?;
            diagonal.iter().enumerate().for_each(|(i, v)| total[i * (n + 1)] = -v);
            found.variance = found.variance.max(symmetric_norm(&total, n)?);
        }
        Ok(found)
    }
}

/// The largest eigenvalue of `diag(p) - p p'` for `p = |a| / g`, from above.
///
/// Interlacing puts it between the two largest entries, where `sum_i p_i^2 / (p_i - x)` grows through 1 once.
fn largest_eigenvalue(line: &[f64], g: f64) -> f64 {
    let p = || line.iter().map(|v| v.abs() / g);
    let (mut below, mut above) = p().fold(
        (0.0, 0.0),
        |(second, first): (f64, f64), v| {
            if v > first { (first, v) } else { (second.max(v), first) }
        },
    );
    // halvings: more than the 53 bits of a float
    for _ in 0..60 {
        let middle = f64::midpoint(below, above);
        let secular: f64 = p().map(|v| v * v / (v - middle)).sum();
        // a middle that meets an entry is beyond, too
        if secular < 1.0 { below = middle } else { above = middle }
    }
    above
}
