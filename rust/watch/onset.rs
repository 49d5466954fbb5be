//! When a change began: by the likelihood of one change of the coefficients that stays.
//!
//! Before it the coefficients are of the region as a Gaussian one, behind it within the noise of 5, 50 or 500 pairs,
//! with noise as before or louder. The root of the likelihood is what is trusted, as the law of the noise is not
//! exactly known.

use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_extend, try_push, try_zeros};
use crate::vector::{axpy, dot};

use super::alarm::Watch;
use super::frame::WHAT;
use super::fresh::MIXTURES;

/// How many times louder the noise may be.
const SCALES: [f64; 6] = [1.0, 1.2, 1.5, 3.0, 8.0, 20.0];
/// The power of the likelihood.
const TRUST: f64 = 0.5;

/// Complete pairs: `W z` (any, r) and e (any, n), and the call of each behind the oldest one.
struct Pairs {
    x: Vec<f64>,
    e: Vec<f64>,
    at: Vec<usize>,
}

/// Logarithms and squares of the density of the first 0, 1, .. rows of `e = B x + w`.
struct Density {
    logs: Vec<f64>,
    squares: Vec<f64>,
    n: f64,
}

impl Density {
    /// Of B of this size.
    fn new<'a>(rows: impl Iterator<Item = (&'a [f64], &'a [f64])>, (r, n): (usize, usize), size: f64) -> Result<Self> {
        let (mut k, mut b) = (try_zeros::<f64>(WHAT, checked_len(WHAT, r, r)?)?, try_zeros::<f64>(WHAT, r * n)?);
        k.iter_mut().step_by(r + 1).for_each(|v| *v = size);
        let [mut g, mut off] = [try_zeros::<f64>(WHAT, r)?, try_zeros::<f64>(WHAT, n)?];
        let (mut logs, mut squares) = (try_zeros(WHAT, 1)?, try_zeros(WHAT, 1)?);
        let (mut log, mut square) = (0.0, 0.0);
        for (x, e) in rows {
            g.iter_mut().zip(k.chunks_exact(r.max(1))).for_each(|(to, row)| *to = dot(row, x));
            off.copy_from_slice(e);
            b.chunks_exact(n).zip(x).for_each(|(row, x)| axpy(-x, row, &mut off));
            let v = 1.0 + dot(x, &g);
            log += n as f64 * v.ln();
            square += dot(&off, &off) / v;
            k.chunks_exact_mut(r.max(1)).zip(&g).for_each(|(row, one)| axpy(-one / v, &g, row));
            b.chunks_exact_mut(n).zip(&g).for_each(|(row, one)| axpy(one / v, &off, row));
            try_push(WHAT, &mut logs, log)?;
            try_push(WHAT, &mut squares, square)?;
        }
        Ok(Self { logs, squares, n: n as f64 })
    }

    /// Of the first so many, with noise that is `scale` times as loud.
    fn of(&self, count: usize, scale: f64) -> f64 {
        let own = self.logs[count] + self.squares[count] / (scale * scale);
        -0.5 * own - self.n * count as f64 * scale.ln()
    }
}

impl Watch {
    fn recent_pairs(&self) -> Result<Pairs> {
        let ((p, n), frame) = ((self.frame.outputs, self.frame.sizes.0), &self.frame);
        let (mut pairs, mut first, mut ends) = (Vec::new(), Vec::new(), Vec::new());
        let mut following = false;
        for k in 1..self.recent.len() {
            let (before, now) = (self.recent.row(k - 1), self.recent.row(k));
            let follows = before[..p].iter().chain(now).all(|v| v.is_finite());
            if follows {
                try_extend(WHAT, &mut pairs, before[..p].iter().chain(&now[p..]).chain(&now[..p]).copied())?;
                try_push(WHAT, &mut first, !following)?;
                try_push(WHAT, &mut ends, k)?;
            }
            following = follows;
        }
        let (rows, places) = self.window.rows(&pairs, &first)?;
        let (d, r) = (self.window.length(), frame.white.len() / self.window.length());
        let [mut x, mut e] = [try_zeros(WHAT, places.len() * r)?, try_zeros(WHAT, places.len() * n)?];
        let mut lengths = try_zeros(WHAT, frame.norms.len())?;
        for (t, row) in rows.chunks_exact(d + p).enumerate() {
            let (e, x) = (&mut e[t * n..(t + 1) * n], &mut x[t * r..(t + 1) * r]);
            frame.residual(&row[..d], &row[d..], e, x, &mut lengths);
        }
        Ok(Pairs { x, e, at: try_collect(WHAT, places.iter().map(|place| ends[*place]))? })
    }

    /// Between which calls the change began that the alarm saw, with `level` left out on both sides together, for
    /// Gaussian noise and one change that stays; of the last 1000 calls. None without an alarm, where no pair is
    /// complete, and where each row has a region of its own.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn onset(&self, level: f64) -> Result<Option<[f64; 2]>> {
        if self.counts().alarmed == 0.0 || self.frame.parts.len() != 1 {
            return Ok(None);
        }
        let Pairs { x, e, at } = self.recent_pairs()?;
        let (n, count) = (self.frame.sizes.0, at.len());
        if count == 0 {
            return Ok(None);
        }
        let r = x.len() / count;
        let pair = |t: usize| (&x[t * r..(t + 1) * r], &e[t * n..(t + 1) * n]);
        let before = Density::new((0..count).map(pair), (r, n), 1.0)?;
        let behind = |pairs: &f64| Density::new((0..count).rev().map(pair), (r, n), self.frame.pairs / pairs);
        let [few, some, many] = [behind(&MIXTURES[0])?, behind(&MIXTURES[1])?, behind(&MIXTURES[2])?];
        let total = |t: usize| {
            let all = || [&few, &some, &many].into_iter().flat_map(|of| SCALES.map(|scale| of.of(count - t, scale)));
            let most = all().fold(f64::NEG_INFINITY, f64::max);
            before.of(t, 1.0) + most + all().map(|one| (one - most).exp()).sum::<f64>().ln()
        };
        let totals = try_collect(WHAT, (0..count).map(total))?;
        let most = totals.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let shares = try_collect(WHAT, totals.iter().map(|one| (TRUST * (one - most)).exp()))?;
        let whole = shares.iter().sum::<f64>();
        let end = |share: f64| {
            let mut sum = 0.0;
            let place = shares.iter().position(|one| {
                sum += one;
                sum >= share * whole
            });
            self.counts().first[0] + 1.0 + at[place.unwrap_or(count - 1)] as f64 - self.recent.len() as f64
        };
        Ok(Some([end(0.5 * level), end(1.0 - 0.5 * level)]))
    }

    /// The root mean squares of the inputs that acted in these calls (m); nan where none is known.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn acting(&self) -> Result<Vec<f64>> {
        let (p, m) = (self.frame.outputs, self.window.inputs());
        let size = |j: usize| {
            let known = || self.recent.iter().map(|row| row[p + j]).filter(|v| !v.is_nan());
            (known().map(|v| v * v).sum::<f64>() / known().count() as f64).sqrt()
        };
        try_collect(WHAT, (0..m).map(size))
    }
}
