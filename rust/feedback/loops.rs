//! [`Loop`]: a gain, and what is proved of it for all members of a region.

use faer::Mat;

use crate::error::{Error, Result, sized};
use crate::matrix::MatrixView;
use crate::memory::{covered, room_for_products};
use crate::parallel::Stop;
use crate::region::Region;

use super::certificate::{Certificate, Verdict, judged};
use super::data::{Closed, LIFT, Matrix, Misfit, REPEATED, Uncertain, WHAT, entries, in_units, matrix, scaled};
use super::lemma::least;
use super::verify::{Claim, verify};

/// How much larger the right-hand sides are solved than they are verified, from small to large.
const SLACKS: [f64; 4] = [1e-5, 1e-4, 1e-3, 1e-2];

/// A gain `u = K x` and a region.
#[derive(Debug)]
pub struct Loop {
    pub(super) data: Uncertain,
    pub(super) closed: Closed,
    pub(super) certificate: Certificate,
    /// R with `Q = R R'`, in the units of `data`.
    pub(super) proof: Option<Matrix>,
}

/// Bytes of what the functions of a loop hold at once: some forty squares of `n + d`.
pub(super) fn bytes(n: usize, d: usize) -> u128 {
    64 * 40 * (n as u128 + d as u128 + 16).pow(2)
}

/// The least of a function of one number between two, after a grid and golden sections; None is worse than all.
pub(super) fn best_of(low: f64, high: f64, count: usize, mut f: impl FnMut(f64) -> Option<f64>) -> Option<f64> {
    let mut value = |x: f64| f(x).unwrap_or(f64::INFINITY);
    let step = (high - low) / count as f64;
    let (mut best, mut at) = (f64::INFINITY, low);
    for k in 0..=count {
        let (x, found) = (low + step * k as f64, value(low + step * k as f64));
        if found < best {
            (best, at) = (found, x);
        }
    }
    if best.is_infinite() {
        return None;
    }
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    let (mut left, mut right) = ((at - step).max(low), (at + step).min(high));
    for _ in 0..18 {
        let (one, other) = (right - golden * (right - left), left + golden * (right - left));
        let (first, second) = (value(one), value(other));
        for (x, found) in [(one, first), (other, second)] {
            if found < best {
                (best, at) = (found, x);
            }
        }
        if first < second { right = other } else { left = one }
    }
    Some(at)
}

impl Loop {
    /// Judges the gain `u = K x`, K (m, n).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn new<'a>(region: &Region, gain: impl Into<MatrixView<'a>>, stop: &Stop) -> Result<Self> {
        Self::beside(region, Vec::new(), gain, stop)
    }

    /// The same for a plant with declared terms beside those of the region.
    ///
    /// # Errors
    /// As [`Loop::new`].
    pub fn beside<'a>(
        region: &Region,
        misfits: Vec<Misfit>,
        gain: impl Into<MatrixView<'a>>,
        stop: &Stop,
    ) -> Result<Self> {
        Self::lifted((region, misfits, LIFT), gain.into(), stop)
    }

    /// The loop of more states, which follow those of this one and do not act on them, nor on the input: readings,
    /// inputs of before. They may repeat others. `region` is of the same event, with their rows below; `rho g` is that
    /// of this loop.
    ///
    /// # Errors
    /// As [`Loop::new`]; [`Error::Shape`] for a region or a gain in which they act.
    pub fn behind<'a>(&self, region: &Region, gain: impl Into<MatrixView<'a>>, stop: &Stop) -> Result<Self> {
        let (of, own, gain) = (&self.data.region, self.own_gain(), gain.into());
        let (n, m, more) = (of.n, of.m, region.n.saturating_sub(of.n));
        let given = gain.sized("K", region.m, region.n)?;
        let apart = |j: usize| (n..n + more).contains(&j);
        let before =
            |i: usize, j: usize| if apart(j) { 0.0 } else { of.centre[i * of.d + if j < n { j } else { j - more }] };
        let alike = |i: usize| (0..region.d).all(|j| region.centre[i * region.d + j] == before(i, j));
        let silent = |i: usize| (0..region.n).all(|j| given[i * region.n + j] == if j < n { own[(i, j)] } else { 0.0 });
        let fits = region.n >= n && region.m == m && region.d == of.d + more;
        if !(fits && (0..n).all(alike) && (0..m).all(silent)) {
            let (expected, found) = (format!("{n} first states that move by themselves"), "others".into());
            return Err(Error::Shape { name: "region", expected, found });
        }
        let mut found = Self::lifted((region, Vec::new(), REPEATED), gain, stop)?;
        found.certificate.norm = found.certificate.norm.min(self.certificate.norm);
        Ok(found)
    }

    fn lifted((region, misfits, lift): (&Region, Vec<Misfit>, f64), gain: MatrixView<'_>, stop: &Stop) -> Result<Self> {
        let (n, m) = (region.n, region.m);
        let gain = gain.finite("K", m, n)?;
        room_for_products()?;
        covered(WHAT, bytes(n, region.d), || {
            let mut data = Uncertain::beside(region, misfits)?;
            data.lift = lift;
            let k = Mat::from_fn(m, n, |i, j| gain[i * n + j] * data.unit[j]);
            let closed = Closed::new(&data, k);
            let (mut certificate, proof, closed) = judged(&data, closed, stop)?;
            certificate.proof = proof.as_ref().map(|root| entries(&in_units(root, &data.unit, &data.ones(data.n))));
            Ok(Self { data, closed, certificate, proof })
        })?
    }

    /// The same, for data that are in doubt: nothing is certified.
    #[must_use]
    pub fn doubted(mut self) -> Self {
        let of = &mut self.certificate;
        (of.status, of.norm, of.proof, of.member) = (Verdict::Undetermined, f64::INFINITY, None, None);
        self.proof = None;
        self
    }

    /// K (m, n), row by row.
    #[must_use]
    pub fn gain(&self) -> Vec<f64> {
        entries(&self.own_gain())
    }

    /// The region.
    #[must_use]
    pub const fn region(&self) -> &Region {
        &self.data.region
    }

    /// What is proved.
    pub const fn certificate(&self) -> &Certificate {
        &self.certificate
    }

    /// R (n, n), for `Y = R R'` with `A_G Y A_G' / lambda + X <= Y` for all members, proved; `X` (n, n) in the units of
    /// the data. None where there is none. With `slack` 0 it is that of the least Y, not proved.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn invariant(&self, x: &[f64], alpha: f64, lambda: f64, slack: Option<f64>) -> Result<Option<Vec<f64>>> {
        let n = self.data.n;
        sized("X", x.len(), n * n)?;
        covered(WHAT, bytes(n, self.data.region.d), || {
            let back = self.data.back();
            let x = in_units(&matrix(x, n, n), &back, &back);
            let found = match slack {
                Some(slack) => self.solved(&x, alpha, lambda, slack),
                None => self.proved(&x, alpha, lambda),
            };
            found.map(|root| entries(&in_units(&root, &self.data.unit, &self.data.ones(n))))
        })
    }

    /// Whether `Y = R R'` is proved to be such a matrix, and positive definite, with these `multipliers` of the parts.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn verified(&self, root: &[f64], x: &[f64], alpha: f64, lambda: f64, multipliers: &[f64]) -> Result<bool> {
        let (n, parts) = (self.data.n, self.data.pieces.len());
        if root.len() != n * n || x.len() != n * n || multipliers.len() != parts {
            let found = format!("{}, {} and {}", root.len(), x.len(), multipliers.len());
            return Err(Error::Shape {
                name: "R",
                expected: format!("{n} x {n} entries, as X, and {parts} multipliers"),
                found,
            });
        }
        covered(WHAT, bytes(n, self.data.region.d), || {
            let (back, ones) = (self.data.back(), self.data.ones(n));
            let own = |values: &[f64], right: &[f64]| in_units(&matrix(values, n, n), &back, right);
            let mut closed = Closed::new(&self.data, self.closed.k.clone());
            closed.t.copy_from_slice(multipliers);
            let claim = Claim { root: &own(root, &ones), x: Some(&own(x, &back)), alpha, lambda, by: 1.0 };
            self.data.determines(&closed.k) && verify(&self.data, &closed, &claim)
        })
    }

    /// The root of the least `Y` for right-hand sides that are larger by `slack`.
    fn solved(&self, x: &Matrix, alpha: f64, lambda: f64, slack: f64) -> Option<Matrix> {
        let (e, d, lift) = (self.closed.outputs(), self.closed.inputs(&self.data), self.data.lift);
        let h = scaled(&(x + scaled(&(&d * d.transpose()), alpha)), 1.0 + slack);
        least(&self.closed.a0, Some(&scaled(&e, alpha.sqrt().recip())), &h, lambda, (1e-2 * slack, lift)).found()
    }

    /// The same, verified; in the units of the loop, as `x`.
    pub(super) fn proved(&self, x: &Matrix, alpha: f64, lambda: f64) -> Option<Matrix> {
        SLACKS.iter().find_map(|slack| {
            let root = self.solved(x, alpha, lambda, *slack)?;
            let claim = Claim { root: &root, x: Some(x), alpha, lambda, by: 1.0 };
            verify(&self.data, &self.closed, &claim).then_some(root)
        })
    }

    /// The root of a verified `Y` with small `h'Yh` for all rows h of `rows` (q, n) at once, each relative to that of
    /// the centre.
    pub(super) fn smallest(&self, x: &Matrix, lambda: f64, rows: &Matrix) -> Option<Matrix> {
        let own = least(&self.closed.a0, None, x, lambda, (0.0, self.data.lift)).found()?;
        let e = self.closed.outputs();
        let start = (&e * &own).squared_norm_l2() / lambda;
        if start <= 0.0 {
            return self.proved(x, 1.0, lambda);
        }
        let nominal = squares(&own, rows);
        let cost = |log: f64| {
            let root = self.solved(x, start * 10f64.powf(log), lambda, 1e-5)?;
            Some(
                squares(&root, rows)
                    .iter()
                    .zip(&nominal)
                    .map(|(one, own)| if *own > 0.0 { one / own } else { 0.0 })
                    .sum(),
            )
        };
        let log = best_of(-2.0, 6.0, 24, cost)?;
        // at the edge of what can be solved a larger one may be verified
        [0.0, 0.05, 0.5].iter().find_map(|more| self.proved(x, start * 10f64.powf(log + more), lambda))
    }
}

/// `h'Yh` for each row h, from the root of Y.
pub(super) fn squares(root: &Matrix, rows: &Matrix) -> Vec<f64> {
    let (product, mut found) = (rows * root, Vec::new());
    (0..rows.nrows()).for_each(|i| found.push(product.row(i).squared_norm_l2()));
    found
}

/// `h'Yh` for each row h, from Y.
pub(super) fn forms(y: &Matrix, rows: &Matrix) -> Vec<f64> {
    let (product, mut found) = (rows * y, Vec::new());
    for i in 0..rows.nrows() {
        found.push((0..rows.ncols()).map(|j| product[(i, j)] * rows[(i, j)]).sum::<f64>().max(0.0));
    }
    found
}
