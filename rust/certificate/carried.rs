//! Noise of a run to come with what the error of the model makes of it, over a horizon.
//!
//! `n(k+1) = (A + D G E) n(k) + R w(k)`, `||G|| <= 1`, has for every such G a covariance of at most `Y_k`, with
//! `Y_0 = 0` and
//!
//! ```text
//! Y_{k+1} = R R' + alpha D D' + A (Y_k + Y_k E' (alpha I - E Y_k E')^-1 E Y_k) A',    alpha I > E Y_k E',
//! ```
//!
//! since `(A + D G E) Y (A + D G E)'` is at most that without `R R'` for every such alpha (Petersen 1987). With
//! `alpha = lam_max(E Y E') + kappa sqrt(||A Y E'||^2 / ||D||^2)` every kappa gives a bound; they hold at once.

use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, MatRef, Par, Side};

use crate::error::Result;
use crate::identify::Symmetric;
use crate::memory::{covered, try_filled};

use super::nuclear::WHAT;

/// Fixed; not tuned on data.
const KAPPAS: [f64; 7] = [0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.5];
/// For the rounding of one step, relative.
const ROUNDING: f64 = 1e-9;

/// Bytes of a matrix of `faer` (n, n), whose columns are padded.
pub(super) fn square_bytes(n: usize) -> u128 {
    8 * (n + 16) as u128 * (n + 4) as u128
}

/// `Y_k` for each kappa, None from where there is no bound.
pub(super) struct Carried<'a> {
    /// A (n, n) and E (r, n).
    a: MatRef<'a, f64>,
    e: MatRef<'a, f64>,
    /// `R R'` and `rho^2 D D'` (n, n).
    noise: Mat<f64>,
    error: Mat<f64>,
    /// `1 / (D D')_ii`, 0 where the error of the model does not act: in this metric alpha is chosen, whatever the units
    /// are.
    weights: Vec<f64>,
    y: [Option<Mat<f64>>; KAPPAS.len()],
}

impl<'a> Carried<'a> {
    /// `root` (n, n) of the covariance of w, and `error` D (n, q) with `||G|| <= rho`.
    pub fn new((a, e): (&'a [f64], &'a [f64]), root: &[f64], (rho, error): (f64, &[f64]), n: usize) -> Result<Self> {
        let square = |m: &[f64]| {
            let m = MatRef::from_row_major_slice(m, n, m.len() / n);
            m * m.transpose()
        };
        let [a, e] = [a, e].map(|m| MatRef::from_row_major_slice(m, m.len() / n, n));
        covered(WHAT, 12 * square_bytes(n), || {
            let error = square(error) * faer::Scale(rho * rho);
            let mut weights = Vec::new();
            weights.extend((0..n).map(|i| if error[(i, i)] > 0.0 { 1.0 / error[(i, i)] } else { 0.0 }));
            Self { a, e, noise: square(root), error, weights, y: KAPPAS.map(|_| Some(Mat::zeros(n, n))) }
        })
    }

    /// One step further; without a bound where `known` is false: the data do not determine `E n`.
    pub fn step(&mut self, known: bool) -> Result<()> {
        let (n, r) = (self.a.nrows(), self.e.nrows());
        covered(WHAT, 24 * square_bytes(n + r), || {
            for (at, kappa) in KAPPAS.iter().enumerate() {
                let before = self.y[at].take().filter(|_| known);
                self.y[at] = before.map(|y| self.next(y, *kappa)).transpose()?.flatten();
            }
            Ok(())
        })?
    }

    fn next(&self, mut y: Mat<f64>, kappa: f64) -> Result<Option<Mat<f64>>> {
        let (r, acting) = (self.e.nrows(), self.weights.iter().filter(|w| **w > 0.0).count());
        let seen = self.e * &y;
        let inner = &seen * self.e.transpose();
        let mut small = Symmetric::new(r)?;
        small.matrix.iter_mut().enumerate().for_each(|(at, to)| *to = inner[(at / r, at % r)]);
        if !small.matrix.iter().all(|v| v.is_finite()) {
            return Ok(None);
        }
        let (largest, mut alpha) = (small.largest()?.max(0.0), 0.0);
        if largest > 0.0 && acting > 0 {
            let moved = self.a * seen.transpose();
            let size: f64 = self.weights.iter().enumerate().map(|(i, w)| w * moved.row(i).squared_norm_l2()).sum();
            alpha = largest * (1.0 + ROUNDING) + kappa * (size / acting as f64).sqrt();
            let room =
                Mat::from_fn(r, r, |i, j| f64::from(u8::from(i == j)) * alpha - 0.5 * (inner[(i, j)] + inner[(j, i)]));
            let Ok(factor) = room.llt(Side::Lower) else { return Ok(None) };
            let mut through = seen;
            solve_lower_triangular_in_place(factor.L(), through.as_mut(), Par::Seq);
            y += through.transpose() * &through;
        }
        let next = self.a * y * self.a.transpose() + &self.noise + &self.error * faer::Scale(alpha);
        let next = Mat::from_fn(next.nrows(), next.ncols(), |i, j| {
            0.5 * (next[(i, j)] + next[(j, i)]) * (1.0 + if i == j { ROUNDING } else { 0.0 })
        });
        Ok(next.is_all_finite().then_some(next))
    }

    /// Of the first `p` rows: the covariance of the least trace (p, p), and the least variances (p); infinite without a
    /// bound.
    pub fn leading(&self, p: usize) -> Result<(Vec<f64>, Vec<f64>)> {
        let mut variances = try_filled(WHAT, f64::INFINITY, p)?;
        let (mut least, mut covariance) = (f64::INFINITY, try_filled(WHAT, f64::INFINITY, p * p)?);
        for y in self.y.iter().flatten() {
            variances.iter_mut().enumerate().for_each(|(i, to)| *to = to.min(y[(i, i)]));
            let trace: f64 = (0..p).map(|i| y[(i, i)]).sum();
            if trace < least {
                least = trace;
                covariance.iter_mut().enumerate().for_each(|(at, to)| *to = y[(at / p, at % p)]);
            }
        }
        Ok((covariance, variances))
    }
}
