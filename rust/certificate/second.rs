//! The error near a reference that was fixed before the noise of the data: what is not of first order.
//!
//! Given what was before, Gamma is standard normal, and all of the reference is constant: `e1_j = N0_j gamma` with
//! gamma the columns of Gamma, one below the other. With `T_j = E N_j`, `S0_t = sum_j t^(-2j) T0_j'T0_j` (Laurent and
//! Massart 2000):
//!
//! ```text
//! ||E e1||_t <= chaos(S0_t, x) + phi lam_max(sum_j t^(-2j) (T_j - T0_j)'(T_j - T0_j))^(1/2)
//! chaos(S, x) = sqrt(tr S + 2 sqrt(x) ||S||_F + 2 x lam_max(S)),                          P <= exp(-x)
//! |h'e2_k| <= |tr Q0| + 2 sqrt(x) ||Q0||_F + 2 x ||Q0|| + phi^2 ||Q - Q0||,               P <= 2 exp(-x)
//! Q = sym sum_j v_(k-1-j) (x) T_j,    h'e2_k = gamma'Q gamma.
//! ```
//!
//! A covariance that is only bounded makes each of these smaller but the trace: in its place is the largest `|tr|` of
//! all covariances below the bound, from the eigenvalues of the partial trace.

use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result};
use crate::memory::{covered, try_collect, try_collect_all, try_filled, try_room};
use crate::parallel::Stop;

use super::carried::square_bytes;
use super::nuclear::WHAT;
use super::powers::Powers;
use super::weighted::{Followed, Weighted, growth, rates};

/// The most entries of Gamma.
const WIDEST: usize = 300;
/// For the rounding of all that is computed, relative.
const ROUNDING: f64 = 1e-9;

type Matrix = Mat<f64>;

/// What both ways make of gamma.
pub(super) struct Second {
    /// `T_j` and `T0_j` (r, r q), j < K.
    own: Vec<Matrix>,
    reference: Vec<Matrix>,
    q: usize,
    phi: f64,
}

fn lost(_: impl std::fmt::Debug) -> Error {
    Error::Numerical("the eigenvalues of a bound near a reference".into())
}

fn eigenvalues(of: &Matrix) -> Result<Vec<f64>> {
    of.self_adjoint_eigenvalues(Side::Lower).map_err(lost)
}

/// The largest absolute value.
fn largest(of: &Matrix) -> Result<f64> {
    Ok(eigenvalues(of)?.iter().fold(0.0, |most: f64, v| most.max(v.abs())))
}

impl Second {
    /// None where it would take too long.
    pub fn new([own, reference]: [&Followed<'_>; 2], n: usize, stop: &Stop) -> Result<Option<Self>> {
        let (q, r) = (own.error.len() / n, own.seen.len() / n);
        if q * r > WIDEST || q * r == 0 || !own.radii.1.is_finite() {
            return Ok(None);
        }
        let steps = own.c.len() / r;
        covered(WHAT, (16 * steps * (r + 16) * r * q + 64 * n * q * r) as u128, || {
            let maps = |of: &Followed<'_>| {
                let matrix = |seen: Vec<f64>| MatRef::from_row_major_slice(&seen, r, q * r).to_owned();
                try_collect_all(WHAT, of.maps(n, stop).map(|seen| seen.map(matrix)))
            };
            Ok(Some(Self { own: maps(own)?, reference: maps(reference)?, q, phi: own.radii.1 }))
        })?
    }

    /// `T_j` row by row, as [`Followed::maps`].
    pub fn maps(&self) -> impl Iterator<Item = Result<Vec<f64>>> {
        self.own.iter().map(|of| {
            let entry = |at: usize| of[(at / of.ncols(), at % of.ncols())];
            try_collect(WHAT, (0..of.nrows() * of.ncols()).map(entry))
        })
    }

    /// Bounds of `||E e1||_t` for each of the rates, which were fixed with the reference; all with `level`.
    pub fn betas(&self, rates: &[f64], level: f64) -> Result<Vec<f64>> {
        let (width, x) = (self.own[0].ncols(), (rates.len() as f64 / level).ln());
        let mut found = try_room(WHAT, rates.len())?;
        covered(WHAT, 24 * square_bytes(width), || {
            for t in rates {
                let (mut apart, mut s) = (Matrix::zeros(width, width), Matrix::zeros(width, width));
                for (j, (own, reference)) in self.own.iter().zip(&self.reference).enumerate() {
                    let weight = faer::Scale(t.powi(-2 * j as i32));
                    let off = own - reference;
                    apart += off.transpose() * &off * weight;
                    s += reference.transpose() * reference * weight;
                }
                if !(apart.is_all_finite() && s.is_all_finite()) {
                    found.push(f64::INFINITY);
                    continue;
                }
                let trace: f64 = (0..width).map(|i| s[(i, i)]).sum();
                let chaos = trace + 2.0 * x.sqrt() * s.norm_l2() + 2.0 * x * largest(&s)?;
                found.push((chaos.sqrt() + self.phi * largest(&apart)?.sqrt()) * (1.0 + ROUNDING));
            }
            Ok(found)
        })?
    }

    /// Bounds of `|h'e2_k|` for the first rows of `M_p`, p < k, of both ways, for x of the level of each of them.
    fn rows(&self, k: usize, powers: [&Powers; 2], x: f64, rows: &mut [f64]) -> Result<()> {
        let width = self.own[0].ncols();
        covered(WHAT, 24 * square_bytes(width), || {
            for (i, to) in rows.iter_mut().enumerate() {
                let (own, reference) =
                    (self.form(&self.own, k, powers[0], i), self.form(&self.reference, k, powers[1], i));
                let off = &own - &reference;
                if !(off.is_all_finite() && reference.is_all_finite()) {
                    continue;
                }
                let square = self.phi * self.phi;
                let around = self.trace(&reference)?
                    + 2.0 * x.sqrt() * reference.norm_l2()
                    + 2.0 * x * largest(&reference)?
                    + square * largest(&off)?;
                *to = around.min(square * largest(&own)?) * (1.0 + ROUNDING);
            }
            Ok(())
        })?
    }

    /// `sym sum_j v_(k-1-j) (x) T_j`.
    fn form(&self, maps: &[Matrix], k: usize, powers: &Powers, i: usize) -> Matrix {
        let (q, width) = (self.q, maps[0].ncols());
        let mut found = Matrix::zeros(width, width);
        for (t, m) in maps.iter().zip(powers.back(k)) {
            for (a, v) in m[i * q..(i + 1) * q].iter().enumerate() {
                for column in 0..width {
                    for b in 0..t.nrows() {
                        found[(b * q + a, column)] += v * t[(b, column)];
                    }
                }
            }
        }
        (&found + found.transpose()) * faer::Scale(0.5)
    }

    /// The largest `|tr Q0|` of all covariances below the bound that Q0 is made with.
    fn trace(&self, form: &Matrix) -> Result<f64> {
        let q = self.q;
        let partial = Matrix::from_fn(q, q, |a, b| (0..form.nrows() / q).map(|i| form[(i * q + a, i * q + b)]).sum());
        let (mut above, mut below) = (0.0, 0.0);
        for value in eigenvalues(&partial)? {
            above += value.max(0.0);
            below -= value.min(0.0);
        }
        Ok(f64::max(above, below))
    }
}

/// What is not of first order near a reference: by a weighted small gain, and with what is of second order.
pub(super) struct Later {
    second: Option<Second>,
    weighted: Weighted,
    /// Of the level of each row.
    x: f64,
}

impl Later {
    /// For the first `p` rows, with a level for so many `events`. None where it would take too long.
    pub fn new(
        [own, reference]: [&Followed<'_>; 2],
        (n, p): (usize, usize),
        (level, events): (f64, usize),
        stop: &Stop,
    ) -> Result<Option<Self>> {
        // fixed with the reference: by its A alone
        let rates = rates(growth(reference.a, n, own.c.len() / (own.seen.len() / n))?);
        let second = Second::new([own, reference], n, stop)?;
        let betas = second.as_ref().map(|of| of.betas(&rates, level / 2.0)).transpose()?;
        let maps: Box<dyn Iterator<Item = Result<Vec<f64>>>> = match &second {
            Some(second) => Box::new(second.maps()),
            None => Box::new(own.maps(n, stop)),
        };
        let weighted = Weighted::new(own, (n, p), &rates, betas.as_deref(), maps, stop)?;
        Ok(weighted.map(|weighted| Self { second, weighted, x: (4.0 * events as f64 / level).ln() }))
    }

    /// As [`Weighted::step`], with the second order where the powers of both ways are given.
    pub fn step(&mut self, k: usize, square: &[f64], powers: Option<[&Powers; 2]>, rows: &mut [f64]) -> Result<f64> {
        let mut apart = try_filled(WHAT, f64::INFINITY, rows.len())?;
        if let (Some(second), Some(powers)) = (&self.second, powers) {
            second.rows(k, powers, self.x, &mut apart)?;
        }
        self.weighted.step(k, square, Some(&apart), rows)
    }
}
