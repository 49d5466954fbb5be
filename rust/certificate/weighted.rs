//! What is not of first order, by a weighted small gain.
//!
//! `f = E e` of `e(k+1) = A e(k) + D G (E e(k) + c_k)`, `e(0) = 0`, `||G|| <= rho`, satisfies `f = E e1 + T G f`, e1 of
//! first order and T causal with the kernel `H_p = E A^p D`. In the norm `||f||_t^2 = sum_j t^(-2j) |f_j|^2` of k steps
//! T has the gain `g_t` of the Toeplitz matrix of `t^-(p+1) H_p`, since G commutes with the weights. So for every t
//! with `rho g_t < 1`
//!
//! ```text
//! |h'(e_k - e1_k)| <= rho (sum_j t^(2j) |D'A'^(k-1-j) h|^2)^(1/2) beta_t / (1 - rho g_t),    beta_t >= ||E e1||_t,
//! beta_t = min(rho g_t ||c||_t, phi lam_max(sum_j t^(-2j) T_j'T_j)^(1/2)),    T_j: vec G -> E e1_j,  ||G||_F <= phi.
//! ```
//!
//! The rates t may be chosen after the data. With a bound of second order, `h'e2_k = sum_j v_(k-1-j)' G E e1_j`, the
//! rest of it is at most `rho g_t` times the right side, for the same t.

use faer::Side;
use faer::linalg::cholesky::llt::factor::LltError;

use crate::error::Result;
use crate::fuse::norm;
use crate::identify::Symmetric;
use crate::memory::{checked_len, covered, try_collect, try_copy, try_filled, try_zeros};
use crate::parallel::Stop;

use super::carried::square_bytes;
use super::nuclear::WHAT;
use super::powers::{Powers, product};

/// Rates as shares of the way from 1 to a spectral radius below 1, as multiples of one that is not, and beside both.
const SHARES: [f64; 5] = [-1.0, 0.25, 0.5, 0.75, 0.9];
const MULTIPLES: [f64; 5] = [1.0, 1.02, 1.1, 1.2, 1.3];
const ALWAYS: [f64; 3] = [0.9, 1.0, 1.05];
/// Bounds of `rho g_t` that are tried: the horizon of each is found.
const GAINS: [f64; 10] = [0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96];
/// The largest Toeplitz matrix, and the largest `T_j'T_j`.
const LARGEST: usize = 400;
const WIDEST: usize = 160;
/// For the rounding of all that is computed, relative.
const ROUNDING: f64 = 1e-9;

/// One rate: its weight, and `rho beta_t / (1 - rho g_t)` and `rho g_t` of each horizon (K + 1).
struct Rate {
    t: f64,
    factors: Vec<f64>,
    gains: Vec<f64>,
    /// `sum_j t^(2j) P M_{k-1-j} M_{k-1-j}' P'` (p, p).
    sum: Vec<f64>,
}

/// Of all rates.
pub(super) struct Weighted {
    rates: Vec<Rate>,
    small: Symmetric,
}

/// A plan in a model of one part: `A` (n, n), `D` (n, q), `H_p` (r, q), `E` (r, n), and the `c_k` (K, r).
pub(super) struct Followed<'a> {
    pub a: &'a [f64],
    pub error: &'a [f64],
    pub seen: &'a [f64],
    pub kernel: &'a Powers,
    pub c: &'a [f64],
    /// Bounds of both norms of G.
    pub radii: (f64, f64),
}

/// About the spectral radius of A (n, n), by its powers over this many steps.
pub(super) fn growth(a: &[f64], n: usize, steps: usize) -> Result<f64> {
    let (mut power, mut norms) = (try_copy(WHAT, a)?, try_filled(WHAT, 0.0, steps)?);
    for to in &mut norms {
        *to = norm(power.iter().copied());
        power = product(a, &power, n, n, n)?;
    }
    let half = (steps - 1) / 2;
    Ok((norms[steps - 1] / norms[half]).powf(1.0 / (steps - 1 - half).max(1) as f64).max(0.0))
}

/// The rates that are tried for an A of about this spectral radius.
pub(super) fn rates(radius: f64) -> [f64; 8] {
    let near = |at: usize| {
        if radius < 1.0 { 1.0 - SHARES[at] * (1.0 - radius.max(0.05)) } else { MULTIPLES[at] * radius }
    };
    std::array::from_fn(|at| if at < SHARES.len() { near(at) } else { ALWAYS[at - SHARES.len()] })
}

impl Weighted {
    /// For the first `p` rows; `betas`: other bounds of `||E e1||_t` for each of the rates; `maps`: those of
    /// [`Followed::maps`]. None where it would take too long.
    pub fn new(
        of: &Followed<'_>,
        (n, p): (usize, usize),
        rates: &[f64],
        betas: Option<&[f64]>,
        maps: impl Iterator<Item = Result<Vec<f64>>>,
        stop: &Stop,
    ) -> Result<Option<Self>> {
        let (q, r) = (of.error.len() / n, of.seen.len() / n);
        let steps = of.c.len().checked_div(r).unwrap_or(0);
        let (rho, phi) = (of.radii.0, of.radii.1.min(of.radii.0 * (q.min(r) as f64).sqrt()));
        if steps < 2 || q * steps > LARGEST || !(rho.is_finite() && rho > 0.0 && rates.iter().all(|t| t.is_finite())) {
            return Ok(None);
        }
        let bounds = if q * r <= WIDEST { Some(first_orders((q * r, r), steps, maps, rates)?) } else { None };
        let mut found = Vec::new();
        for (at, &t) in rates.iter().enumerate() {
            stop.check()?;
            let gains = gains(of.kernel, (q, r, steps), t, rho)?;
            let mut factors = try_filled(WHAT, f64::INFINITY, steps + 1)?;
            let mut squared: f64 = 0.0;
            for k in 1..=steps {
                let gain = gains[k];
                let mut beta = gain * squared.sqrt(); // of c_j, j < k - 1
                if let Some(bounds) = &bounds {
                    beta = beta.min(phi * bounds[at][k]);
                }
                if let Some(betas) = betas {
                    beta = beta.min(betas[at]);
                }
                let factor = rho * beta / (1.0 - gain) * (1.0 + ROUNDING);
                if gain < 1.0 && factor.is_finite() {
                    factors[k] = factor;
                }
                let c = norm(of.c[(k - 1) * r..k * r].iter().copied());
                squared += (c * t.powi(-(k as i32 - 1))).powi(2);
            }
            found.push(Rate { t, factors, gains, sum: try_zeros(WHAT, p * p)? });
        }
        Ok(Some(Self { rates: found, small: Symmetric::new(p)? }))
    }

    /// Takes in `P M_{k-1}` by its square (p, p), and gives bounds of `|P (e_k - e1_k)|` and of each row of it;
    /// `second`: bounds of the second order of each row, or infinite.
    pub fn step(&mut self, k: usize, square: &[f64], second: Option<&[f64]>, rows: &mut [f64]) -> Result<f64> {
        let p = rows.len();
        rows.fill(f64::INFINITY);
        let mut whole = f64::INFINITY;
        for rate in &mut self.rates {
            let by = rate.t * rate.t;
            rate.sum.iter_mut().zip(square).for_each(|(to, new)| *to = by * *to + new);
            let (factor, gain) = (rate.factors[k], rate.gains[k]);
            if !(factor.is_finite() && rate.sum.iter().all(|v| v.is_finite())) {
                continue;
            }
            for (i, to) in rows.iter_mut().enumerate() {
                let size = factor * rate.sum[i * (p + 1)].max(0.0).sqrt();
                let apart = second.map_or(f64::INFINITY, |second| second[i] + gain * size);
                *to = to.min(size).min(apart);
            }
            self.small.matrix.copy_from_slice(&rate.sum);
            whole = whole.min(factor * self.small.largest()?.max(0.0).sqrt() * (1.0 + ROUNDING));
        }
        Ok(whole.min(norm(rows.iter().copied())))
    }
}

/// Bounds of `rho g_t` over k steps, k <= K: by the horizons on which `s^2 / rho^2 I - M` is positive definite, M the
/// Gram matrix of the Toeplitz matrix, last step first, so that its leading blocks are those of shorter horizons.
fn gains(kernel: &Powers, (q, r, steps): (usize, usize, usize), t: f64, rho: f64) -> Result<Vec<f64>> {
    let size = (steps - 1) * q;
    covered(WHAT, 8 * square_bytes(size), || gains_of(kernel, (q, r, steps), t, rho))?
}

fn gains_of(kernel: &Powers, (q, r, steps): (usize, usize, usize), t: f64, rho: f64) -> Result<Vec<f64>> {
    let size = (steps - 1) * q;
    let mut gram = faer::Mat::<f64>::zeros(size, size);
    let h = try_collect(WHAT, kernel.all().take(steps - 1))?;
    for (s, left) in h.iter().enumerate() {
        for (u, right) in h.iter().enumerate().take(s + 1) {
            let weight = t.powi(-((s + u + 2) as i32));
            for i in 0..q {
                for j in 0..q {
                    let own = (0..r).map(|row| left[row * q + i] * right[row * q + j]).sum::<f64>();
                    let before = if u > 0 { gram[((s - 1) * q + i, (u - 1) * q + j)] } else { 0.0 };
                    gram[(s * q + i, u * q + j)] = before + weight * own;
                }
            }
        }
    }
    let mut found = try_filled(WHAT, 1.0, steps + 1)?;
    found[..2].fill(0.0);
    for gain in GAINS.iter().rev() {
        let square = (gain / rho).powi(2);
        let room = faer::Mat::from_fn(size, size, |i, j| {
            let (i, j) = (i.max(j), i.min(j));
            if i == j { square - gram[(i, i)] } else { -gram[(i, j)] }
        });
        let sound = match room.llt(Side::Lower) {
            Ok(_) => steps - 1,
            Err(LltError::NonPositivePivot { index }) => index / q,
        };
        // horizon k has the blocks of k - 1 steps
        found[2..2 + sound].fill(gain * (1.0 + ROUNDING));
        if sound == 0 {
            break;
        }
    }
    Ok(found)
}

/// `lam_max(sum_{j<k} t^(-2j) T_j'T_j)^(1/2)` for each rate and k <= K, that of a longer horizon where it is not
/// computed.
fn first_orders(
    (width, r): (usize, usize),
    steps: usize,
    maps: impl Iterator<Item = Result<Vec<f64>>>,
    rates: &[f64],
) -> Result<Vec<Vec<f64>>> {
    let (mut sums, mut found) = (Vec::new(), Vec::new());
    for _ in rates {
        sums.push(Symmetric::new(width)?);
        found.push(try_zeros(WHAT, steps + 1)?);
    }
    let mut last = 0;
    for (j, seen) in maps.enumerate() {
        let seen = seen?;
        if j > 0 {
            let mut turned = try_zeros(WHAT, width * r)?;
            turned.iter_mut().enumerate().for_each(|(at, to)| *to = seen[at % r * width + at / r]);
            let square = product(&turned, &seen, width, r, width)?;
            for (sum, t) in sums.iter_mut().zip(rates) {
                let weight = t.powi(-2 * j as i32);
                sum.matrix.iter_mut().zip(&square).for_each(|(to, v)| *to += weight * v);
            }
        }
        // of j + 1 steps: at about twice as many each time, from the end
        let k = j + 1;
        if (0..usize::BITS).any(|half| steps >> half == k) {
            for (found, sum) in found.iter_mut().zip(&sums) {
                let mut small = Symmetric::new(width)?;
                small.matrix.copy_from_slice(&sum.matrix);
                let finite = small.matrix.iter().all(|v| v.is_finite());
                let root = if finite { small.largest()?.max(0.0).sqrt() * (1.0 + ROUNDING) } else { f64::INFINITY };
                found[last + 1..=k].fill(root);
            }
            last = k;
        }
    }
    Ok(found)
}

impl Followed<'_> {
    /// `T_j` with `E e1_j = T_j vec G`, j < K, each (r, r q) row by row.
    pub fn maps(&self, n: usize, stop: &Stop) -> impl Iterator<Item = Result<Vec<f64>>> {
        let (q, r) = (self.error.len() / n, self.seen.len() / n);
        let mut now = Vec::new(); // e1_j = now vec G
        (0..self.c.len() / r).map(move |j| {
            stop.check()?;
            if j == 0 {
                now = try_zeros(WHAT, checked_len(WHAT, n, q * r)?)?;
            }
            let seen = product(self.seen, &now, r, n, q * r)?;
            now = self.next(&now, j, n)?;
            Ok(seen)
        })
    }

    /// `e1_{j+1}` from `e1_j`, each as a matrix (n, r q) that acts on the columns of G, one below the other.
    pub fn next(&self, now: &[f64], j: usize, n: usize) -> Result<Vec<f64>> {
        let (q, r) = (self.error.len() / n, self.seen.len() / n);
        let mut next = product(self.a, now, n, n, q * r)?;
        for (row, d) in next.chunks_exact_mut(q * r).zip(self.error.chunks_exact(q)) {
            for (to, c) in row.chunks_exact_mut(q).zip(&self.c[j * r..(j + 1) * r]) {
                to.iter_mut().zip(d).for_each(|(to, d)| *to += c * d);
            }
        }
        Ok(next)
    }
}
