//! How far errors of the inputs move the states of any member: bounded ones, and those of a computer's numbers.

use faer::Mat;

use crate::error::{Error, Result};
use crate::memory::covered;
use crate::parallel::Stop;

use super::blocks::{Blocks, Channel};
use super::data::{Matrix, WHAT, filled, gathered};
use super::lemma::least;
use super::loops::{Loop, best_of, bytes, squares};
use super::spectrum::radius;
use super::tube::ROUNDING;

/// Rates between the square of the spectral radius and 1 that are tried.
const RATES: [f64; 7] = [0.02, 0.08, 0.2, 0.35, 0.5, 0.7, 0.9];

impl Loop {
    /// `|x_i|` and `|K x|` from 0 on, for ever, if the inputs are wrong by at most `sizes` (m) at each step, in any
    /// way; infinite where nothing is proved. What the errors add to any motion of the loop without a misfit.
    ///
    /// `diag(Y - alpha rho^2 S, alpha I) - F Y F' / lambda - G N G' / (1 - lambda) >= 0`, `G = [B; W_u]`,
    /// `N = diag(size_i^2 / pi_i)`, `sum pi = 1`: then `{x'Y^-1 x <= 1}` is invariant.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`], [`Error::Numerical`], [`Error::Interrupted`].
    pub fn errors(&self, sizes: &[f64], stop: &Stop) -> Result<Vec<f64>> {
        let (n, m) = (self.data.n, self.data.m);
        if sizes.len() != m || sizes.iter().any(|v| !(*v >= 0.0 && v.is_finite())) {
            let (expected, found) = (format!("{m} numbers >= 0"), format!("{sizes:?}"));
            return Err(Error::Shape { name: "sizes", expected, found });
        }
        let size = sizes.iter().fold(0.0f64, |most, v| most.max(*v));
        if size == 0.0 {
            return Ok(filled(n + m, 0.0));
        }
        if !self.free() {
            return Ok(filled(n + m, f64::INFINITY));
        }
        covered(WHAT, bytes(n, self.data.region.d), || {
            let mut shares = Vec::new();
            for (j, size) in sizes.iter().enumerate() {
                shares.push(size * self.data.b.col(j).norm_l2());
            }
            let whole = shares.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            // relative to the largest, so that squares neither overflow nor vanish
            let roots = shares.iter().zip(sizes).map(|(share, own)| own / size / (share / whole).max(1e-3).sqrt());
            let mut roots = gathered(roots);
            let sum: f64 = shares.iter().map(|share| (share / whole).max(1e-3)).sum();
            roots.iter_mut().for_each(|v| *v *= sum.sqrt() * (1.0 + 1e-12));
            let into = Mat::from_fn(m, m, |i, j| if i == j { roots[i] } else { 0.0 });
            let channel = [Channel::at_inputs(into.clone(), Mat::zeros(0, n))];
            let (rows, floor, lift) = (self.rows(), radius(&self.closed.a0)?.powi(2), self.data.lift);
            let through = &self.data.b * &into;
            let own = least(&self.closed.a0, None, &(&through * through.transpose()), 1.0, (0.0, lift)).found();
            let Some(own) = own else { return Ok(filled(n + m, f64::INFINITY)) };
            let nominal = squares(&own, &rows);
            let outputs = |w: &Matrix| (w.subcols(n, m) * &into).squared_norm_l2();
            let mut feed: f64 = self.data.pieces.iter().map(|piece| outputs(&piece.w)).sum();
            if feed == 0.0 {
                feed = (self.closed.outputs() * &own).squared_norm_l2(); // inputs that act later
            }
            let feed = feed.max(1e-300);
            let mut best: (f64, Vec<f64>) = (f64::INFINITY, filled(n + m, f64::INFINITY));
            for share in RATES {
                stop.check()?;
                let lambda = floor + (1.0 - floor) * share;
                let at = |log: f64| {
                    let alpha = feed / (1.0 - lambda) * 10f64.powf(log);
                    let t = gathered(self.closed.t.iter().map(|t| t * alpha));
                    let of = Blocks::new(&self.data, &self.closed.k, None, &t, &channel);
                    let root = [1e-5, 1e-3]
                        .iter()
                        .find_map(|more| of.proof(&[1.0], &[1.0 / (1.0 - lambda)], (None, lambda), 1.0 + more))?;
                    let found = squares(&root, &rows);
                    let cost: f64 =
                        found.iter().zip(&nominal).map(|(one, own)| if *own > 0.0 { one / own } else { 0.0 }).sum();
                    Some((cost, found))
                };
                if let Some(log) = best_of(0.0, 5.0, 16, |log| at(log).map(|one| one.0))
                    && let Some((cost, found)) = at(log)
                    && cost < best.0
                {
                    best = (cost, found);
                }
            }
            let mut bounds = best.1;
            bounds.iter_mut().for_each(|v| *v = (*v).sqrt() * size * (1.0 + ROUNDING));
            Ok(bounds)
        })?
    }

    /// How far states and inputs of the loop as it is computed are from those of exact numbers (n + m), for ever: each
    /// input is wrong by at most `weights` (m, n + m) times the sizes of states and inputs, which are those of `reach`
    /// (n + m) in exact numbers, and an `absolute` part (m).
    ///
    /// # Errors
    /// As [`Loop::errors`].
    pub fn computed(&self, reach: &[f64], weights: &[f64], absolute: &[f64], stop: &Stop) -> Result<Vec<f64>> {
        let (n, m) = (self.data.n, self.data.m);
        if reach.len() != n + m || weights.len() != m * (n + m) || absolute.len() != m {
            let found = format!("{}, {}, {}", reach.len(), weights.len(), absolute.len());
            return Err(Error::Shape { name: "reach", expected: format!("n + m = {} entries", n + m), found });
        }
        let weigh = |sizes: &[f64]| {
            gathered(weights.chunks_exact(n + m).map(|row| row.iter().zip(sizes).map(|(w, v)| w * v).sum::<f64>()))
        };
        // each input by what it is wrong at least
        let asked = weigh(reach);
        let start = gathered(asked.iter().zip(absolute).map(|(own, more)| own + more));
        let mut found = self.errors(&start, stop)?;
        // the states may move by c times that: weights (reach + c found) + absolute <= c start
        found[n..].iter_mut().zip(&start).for_each(|(one, own)| *one += own);
        let part = weigh(&found).into_iter().zip(&start).map(|(more, own)| if more > 0.0 { more / own } else { 0.0 });
        let chi = part.fold(0.0, f64::max);
        if chi.is_nan() || chi >= 1.0 {
            return Ok(filled(n + m, f64::INFINITY));
        }
        found.iter_mut().for_each(|v| *v *= (1.0 + ROUNDING) / (1.0 - chi));
        Ok(found)
    }
}
