//! What more columns explain of residuals: Wilks' Lambda by Rao's F.

use faer::{ColMut, MatRef};

use super::given::{WHAT, zeros};
use crate::error::Result;
use crate::identify::distributions::f_above;
use crate::identify::symmetric::{cholesky, log_determinant, whiten};
use crate::memory::{try_copy, try_push, try_zeros};

/// Share of the squares of a column below which what is left of it is rounding.
const NOTHING: f64 = 1e-9;

/// Residuals: their squares, and the combinations that are independent.
pub(super) struct Outcomes<'a> {
    /// The sum of squares of all outcomes (n, n).
    pub(super) squares: &'a [f64],
    /// Combinations that are independent (n, p).
    pub(super) basis: &'a [f64],
    /// `L L' = basis' squares basis` (p, p).
    pub(super) root: Vec<f64>,
    pub(super) n: usize,
    pub(super) p: usize,
    /// Degrees of freedom.
    pub(super) nu: usize,
}

impl<'a> Outcomes<'a> {
    /// None where nothing is left of them, or too few pairs for a test.
    pub(super) fn new(squares: &'a [f64], basis: &'a [f64], n: usize, nu: usize) -> Result<Option<Self>> {
        let p = basis.len().checked_div(n).unwrap_or(0);
        if p == 0 || nu <= p {
            return Ok(None);
        }
        let mut inner = zeros(p * p)?;
        for a in 0..p {
            for b in 0..=a {
                let sum = |i: usize| (0..n).map(|j| squares[i * n + j] * basis[j * p + b]).sum::<f64>();
                inner[a * p + b] = (0..n).map(|i| basis[i * p + a] * sum(i)).sum();
            }
        }
        Ok(cholesky(&inner, p)?.map(|root| Self { squares, basis, root, n, p, nu }))
    }

    /// `L^-1 basis' e`: its square is the part of this row in the sum of squares.
    pub(super) fn whiten(&self, e: &[f64], to: &mut [f64]) {
        let own = |a: usize| (0..self.n).map(|i| self.basis[i * self.p + a] * e[i]).sum();
        to.iter_mut().enumerate().for_each(|(a, to)| *to = own(a));
        whiten(MatRef::from_row_major_slice(&self.root, self.p, self.p), ColMut::from_slice_mut(to).as_mat_mut());
    }
}

/// The test of some columns.
#[derive(Debug, Clone)]
pub struct Explained {
    /// The probability of as much without an effect.
    pub p_value: f64,
    /// `1 - Lambda^(1/p)`, the share of the variance.
    pub share: f64,
    /// The same of each outcome alone (n).
    pub each: Vec<f64>,
}

/// The test of q columns: `left` (q, q), the products of what the regressors leave of them, `own` (q) the squares of
/// all of them, `along` (q, n) their products with the residuals. None where nothing is left of them, or of the pairs.
///
/// With `X = along' left^+ along` Wilks' Lambda is `det(S - X) / det S`, and by Rao (1951)
/// `(L^(-1/t) - 1) b / a ~ F(a, b)`, `a = p q`, `t^2 = (p^2 q^2 - 4) / (p^2 + q^2 - 5)`,
/// `b = t (nu - (p - q + 1) / 2) - (p q - 2) / 2` with nu degrees of freedom beside all columns; exact for p or q up to
/// 2.
pub(super) fn explained(left: &[f64], own: &[f64], along: &[f64], of: &Outcomes<'_>) -> Result<Option<Explained>> {
    let (q, n, p) = (own.len(), of.n, of.p);
    let Some(rows) = halved(left, own, along, n)? else { return Ok(None) };
    let rank = rows.len() / n;
    let nu = of.nu.saturating_sub(rank);
    if q == 0 || rank == 0 || nu <= p {
        return Ok(None);
    }
    let mut rest = zeros(p * p)?;
    rest.iter_mut().step_by(p + 1).for_each(|v| *v = 1.0);
    let (mut white, mut each) = (zeros(p)?, zeros(n)?);
    for row in rows.chunks_exact(n) {
        of.whiten(row, &mut white);
        for a in 0..p {
            (0..p).for_each(|b| rest[a * p + b] -= white[a] * white[b]);
        }
        each.iter_mut().zip(row).for_each(|(to, v)| *to += v * v);
    }
    for (i, share) in each.iter_mut().enumerate() {
        let whole = of.squares[i * (n + 1)];
        *share = if whole > 0.0 { (*share / whole).min(1.0) } else { 0.0 };
    }
    // what is explained but for rounding counts as EPS
    let least = p as f64 * f64::EPSILON.ln();
    let log_lambda = log_determinant(&rest, p)?.map_or(least, |log| log.max(least));
    let (pf, qf, nu) = (p as f64, rank as f64, nu as f64);
    let squares = pf * pf + qf * qf - 5.0;
    let t = if squares > 0.0 { ((pf * pf * qf * qf - 4.0) / squares).sqrt() } else { 1.0 };
    let b = t * (nu - (pf - qf + 1.0) / 2.0) - (pf * qf - 2.0) / 2.0;
    if b <= 0.0 {
        return Ok(None);
    }
    let p_value = f_above((-log_lambda / t).exp_m1() * b / (pf * qf), pf * qf, b);
    Ok(Some(Explained { p_value, share: -(log_lambda / pf).exp_m1(), each }))
}

/// `U` (rank, n) with `U' U = along' left^+ along`: Cholesky with pivots, on columns of length 1. None without a
/// column.
pub(super) fn halved(left: &[f64], own: &[f64], along: &[f64], n: usize) -> Result<Option<Vec<f64>>> {
    let q = own.len();
    let (mut k, mut b) = (try_copy(WHAT, left)?, try_copy(WHAT, along)?);
    let size = |j: usize| if own[j] > 0.0 { own[j].sqrt().recip() } else { 0.0 };
    for i in 0..q {
        (0..q).for_each(|j| k[i * q + j] *= size(i) * size(j));
        b[i * n..(i + 1) * n].iter_mut().for_each(|v| *v *= size(i));
    }
    let mut rows = Vec::new();
    let mut open = try_zeros::<u8>(WHAT, q)?;
    loop {
        let free = (0..q).filter(|&j| open[j] == 0);
        let Some(at) = free.max_by(|&i, &j| k[i * (q + 1)].total_cmp(&k[j * (q + 1)])) else { break };
        let pivot = k[at * (q + 1)];
        if pivot.is_nan() || pivot <= NOTHING {
            break;
        }
        open[at] = 1;
        let (line, outcome) = (try_copy(WHAT, &k[at * q..(at + 1) * q])?, try_copy(WHAT, &b[at * n..(at + 1) * n])?);
        for value in &outcome {
            try_push(WHAT, &mut rows, value / pivot.sqrt())?;
        }
        for i in (0..q).filter(|&i| open[i] == 0) {
            let factor = line[i] / pivot;
            (0..q).for_each(|j| k[i * q + j] -= factor * line[j]);
            b[i * n..(i + 1) * n].iter_mut().zip(&outcome).for_each(|(v, o)| *v -= factor * o);
        }
    }
    Ok((!rows.is_empty()).then_some(rows))
}
