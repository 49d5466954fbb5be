//! The state of SLSE for singleton realizations: a fused `F`, one exact line search per realization, `O(lines)` each.
//!
//! Signs are absorbed (`f_k = sign_k F_k >= 0`), and what is stored is `h` with `g f = c h + b g^2 S`, where `S` counts the
//! hits so far (`U = S / k` in units of the atoms) and `b = 0` without the safeguard: scaling `F` or adding a multiple of
//! `U` costs `O(1)`. The squared error `er = ||E* - F||^2` and `al = <E* - F, F>` follow recursions of their own instead of
//! being differences of large sums; whoever steps has to refresh them now and then.

use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_zeros};
use crate::sample::Index;

const WHAT: &str = "a stream";

/// The scalars a step needs; `aa = ||E*||^2` and `gg = ||E||^2` do not change.
#[derive(Debug, Clone, Default)]
pub(crate) struct State {
    pub(crate) aa: f64,
    pub(crate) gg: f64,
    /// `||E* - F||^2`
    pub(crate) er: f64,
    /// `<E* - F, F>`
    pub(crate) al: f64,
    /// `<F, S>`, `<S, S>`, `<S, E*>`: only with the safeguard
    pub(crate) fs: f64,
    pub(crate) ss: f64,
    pub(crate) sa: f64,
}

impl State {
    /// `||F||^2`, from `||E*||^2 = ||E* - F||^2 + 2 <E* - F, F> + ||F||^2`.
    pub(crate) fn ff(&self) -> f64 {
        self.aa - self.er - 2.0 * self.al
    }

    /// The line search from `F` to a point `X` with `<F, X>`, `<E*, X>`, `<X, X>`; updates `er` and `al`.
    fn line_search(&mut self, fx: f64, ax: f64, xx: f64) -> f64 {
        let ff = self.ff();
        let num = ax - fx - self.al; // <E* - F, X - F>
        let den = ff - 2.0 * fx + xx; // ||X - F||^2
        let t = if den > 0.0 { (num / den).clamp(0.0, 1.0) } else { 0.0 };
        self.move_to(t, fx, ax, xx, ff, num, den);
        t
    }

    #[expect(clippy::too_many_arguments, reason = "the inner products of one step")]
    fn move_to(&mut self, t: f64, fx: f64, ax: f64, xx: f64, ff: f64, num: f64, den: f64) {
        let u = 1.0 - t;
        self.er -= t * (2.0 * num - t * den);
        self.al += t * (u * (ff - fx) + (ax - u * fx) - t * xx - self.al);
    }
}

/// `F` and what its next step needs.
#[derive(Debug)]
pub(crate) struct Run {
    pub(crate) lines: usize,
    pub(crate) length: usize,
    /// `g_j^2`
    pub(crate) g2: Vec<f64>,
    /// `g_j sign_k t_k`
    pub(crate) ga: Vec<f64>,
    pub(crate) gamma: Vec<f64>,
    pub(crate) h: Vec<f64>,
    pub(crate) c: f64,
    pub(crate) b: f64,
    /// hits so far, with the safeguard only
    pub(crate) hits: Vec<f64>,
    pub(crate) state: State,
}

impl Run {
    /// No realization yet. Everything is in units in which squares are representable: `gamma` holds the 1-norm of each
    /// line, `magnitudes` the entries `sign_k E*_k` of what is fitted to.
    pub(crate) fn new(gamma: Vec<f64>, magnitudes: &[f64], safeguard: bool) -> Result<Self> {
        let length = magnitudes.len() / gamma.len();
        Ok(Self {
            lines: gamma.len(),
            length,
            g2: try_collect(WHAT, gamma.iter().map(|g| g * g))?,
            ga: try_collect(WHAT, magnitudes.iter().enumerate().map(|(k, a)| gamma[k / length] * a))?,
            h: try_zeros(WHAT, magnitudes.len())?,
            c: 1.0,
            b: 0.0,
            hits: try_zeros(WHAT, if safeguard { magnitudes.len() } else { 0 })?,
            state: State {
                aa: magnitudes.iter().map(|a| a * a).sum(),
                gg: gamma.iter().map(|g| g * g).sum(),
                ..State::default()
            },
            gamma,
        })
    }

    pub(crate) fn copy(&self) -> Result<Self> {
        let copy = |values: &[f64]| try_copy(WHAT, values);
        let (g2, ga, gamma) = (copy(&self.g2)?, copy(&self.ga)?, copy(&self.gamma)?);
        let (h, hits, state) = (copy(&self.h)?, copy(&self.hits)?, self.state.clone());
        Ok(Self { g2, ga, gamma, h, hits, state, ..*self })
    }

    /// `f_k = (c h_k + b g^2 S_k) / g`
    pub(crate) fn f(&self, j: usize, k: usize) -> f64 {
        let hits = self.hits.get(k).map_or(0.0, |s| self.b * self.g2[j] * s);
        (self.c * self.h[k] + hits) / self.gamma[j]
    }

    /// `||E* - F||^2` and `<E* - F, F>`, summed from the entries.
    pub(crate) fn direct(&self) -> (f64, f64) {
        let (mut er, mut al) = (0.0, 0.0);
        for j in (0..self.lines).filter(|&j| self.gamma[j] > 0.0) {
            for k in j * self.length..(j + 1) * self.length {
                let f = self.f(j, k);
                let p = self.ga[k] / self.gamma[j] - f;
                er += p * p;
                al += p * f;
            }
        }
        (er, al)
    }

    /// Folds `c` and `b` into `h` and recomputes every inner product.
    pub(crate) fn refresh(&mut self) {
        self.fold();
        (self.state.er, self.state.al) = self.direct();
    }

    /// Folds `c` and `b` into `h` and recomputes the inner products of the safeguard.
    pub(crate) fn fold(&mut self) {
        for j in 0..self.lines {
            for k in j * self.length..(j + 1) * self.length {
                let hits = self.hits.get(k).map_or(0.0, |s| self.b * self.g2[j] * s);
                self.h[k] = self.c * self.h[k] + hits;
            }
        }
        (self.c, self.b) = (1.0, 0.0);
        if !self.hits.is_empty() {
            (self.state.fs, self.state.ss, self.state.sa) = (0.0, 0.0, 0.0);
            for j in 0..self.lines {
                for k in j * self.length..(j + 1) * self.length {
                    self.state.fs += self.h[k] * self.hits[k];
                    self.state.ss += self.g2[j] * self.hits[k] * self.hits[k];
                    self.state.sa += self.ga[k] * self.hits[k];
                }
            }
        }
    }

    /// `(sum_j h, sum_j g a, sum_j g^2 S)` over the entries that a realization hits.
    #[inline]
    fn gather<I: Index>(&self, sample: &[I]) -> (f64, f64, f64) {
        let fe = gather(&self.h, self.length, sample);
        let ae = gather(&self.ga, self.length, sample);
        let mut se = 0.0;
        if !self.hits.is_empty() {
            let mut base = 0;
            for (r, g2) in sample.iter().zip(&self.g2) {
                se += g2 * self.hits[base + r.get()];
                base += self.length;
            }
        }
        (fe, ae, se)
    }

    /// Adds `step g^2` to `h` where the realization is.
    #[inline]
    fn scatter<I: Index>(&mut self, sample: &[I], step: f64) {
        let mut base = 0;
        for (r, g2) in sample.iter().zip(&self.g2) {
            self.h[base + r.get()] += step * g2;
            base += self.length;
        }
    }

    /// One realization: the SLSE step and, with the safeguard, the step towards the mean of `n` realizations.
    #[inline]
    pub(crate) fn step<I: Index>(&mut self, sample: &[I], n: usize) -> (f64, f64) {
        let (h_sum, ae, se) = self.gather(sample);
        let fe = self.c * h_sum + self.b * se;
        let gg = self.state.gg;
        let t = if n == 1 {
            self.state.er = self.state.aa - 2.0 * ae + gg;
            self.state.al = ae - gg;
            1.0
        } else {
            self.state.line_search(fe, ae, gg)
        };
        let u = 1.0 - t;
        if self.hits.is_empty() {
            self.replace(sample, t, u * self.c, 0.0, t);
            return (t, 0.0);
        }
        // the mean now includes this realization
        let mut base = 0;
        for r in sample {
            self.hits[base + r.get()] += 1.0;
            base += self.length;
        }
        self.state.ss += 2.0 * se + gg;
        self.state.sa += ae;
        let fs = u * (self.state.fs + fe) + t * (se + gg); // <F', S>
        let k = n as f64;
        let (fu, ua, uu) = (fs / k, self.state.sa / k, self.state.ss / (k * k));
        let s = self.state.line_search(fu, ua, uu);
        self.state.fs = (1.0 - s) * fs + s * self.state.ss / k;
        // F'' = (1-s) u c h + ((1-s) u b + s/k) S + (1-s)(t - u b) E, all in units of g
        let v = 1.0 - s;
        self.replace(sample, t, v * u * self.c, v * u * self.b + s / k, v * (t - u * self.b));
        (t, s)
    }

    /// `F <- c h + b S + e E`; when nothing of the old `h` is left, `h` starts again.
    #[inline]
    fn replace<I: Index>(&mut self, sample: &[I], t: f64, c: f64, b: f64, e: f64) {
        self.b = b;
        if c > 0.0 {
            self.c = c;
            if e != 0.0 {
                self.scatter(sample, e / c);
            }
        } else {
            debug_assert!(t == 1.0 || self.b > 0.0);
            self.h.fill(0.0);
            self.c = 1.0;
            self.scatter(sample, e);
        }
        if self.c < 1e-100 {
            self.refresh();
        }
    }
}

/// `sum_j table[j][R_j]`, four lines at a time: one sum alone would wait for every addition.
#[inline]
pub(crate) fn gather<I: Index>(table: &[f64], length: usize, sample: &[I]) -> f64 {
    let mut sums = [0.0; 4];
    let mut base = 0;
    let (fours, rest) = sample.as_chunks::<4>();
    for [r0, r1, r2, r3] in fours {
        let lines = &table[base..base + 4 * length];
        sums[0] += lines[r0.get()];
        sums[1] += lines[length + r1.get()];
        sums[2] += lines[2 * length + r2.get()];
        sums[3] += lines[3 * length + r3.get()];
        base += 4 * length;
    }
    for r in rest {
        sums[0] += table[base + r.get()];
        base += length;
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}
