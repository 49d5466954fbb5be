//! One entity of the stream: its realizations in order, and the `F` they are fused into.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::fuse::greedy::{Run, gather};
use crate::fuse::power_of_two_scale;
use crate::sample::{Law, Sequence};
use crate::stream::Key;

/// Norm of a vector whose squares are representable.
pub(super) fn norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// An entity drawn from its own law and fitted to its mean. Everything is in units of `scale`, a power of two.
#[derive(Clone)]
pub(super) struct Slot {
    pub(super) law: Arc<Law>,
    pub(super) scale: f64,
    pub(super) run: Run,
    pub(super) sequence: Sequence,
    /// the sign of every entry: 1, -1, or 0 off the support
    pub(super) signs: Vec<i8>,
    /// the latest realization, its indices
    pub(super) raw: Vec<u32>,
}

/// `F <- (1 - s) ((1 - t) F + t E) + (s / k) S`, `S` the sum of the `k` realizations so far, `E` among them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Move {
    pub(super) t: f64,
    pub(super) s: f64,
    pub(super) k: f64,
}

impl Slot {
    /// The slot before its first realization.
    pub(super) fn new(values: Vec<f64>, lines: usize, length: usize, key: Key, safeguard: bool) -> Result<Self> {
        let law = Arc::new(Law::new(values, lines, length)?);
        let scale = power_of_two_scale(law.gamma());
        let gamma: Vec<f64> = law.gamma().iter().map(|g| g / scale).collect();
        let magnitudes: Vec<f64> = law.values().iter().map(|a| a.abs() / scale).collect();
        Ok(Self {
            scale,
            run: Run::new(gamma, &magnitudes, safeguard),
            sequence: Sequence::new(&law, key),
            signs: law.signs().iter().map(|&s| s as i8).collect(),
            raw: vec![0; lines],
            law,
        })
    }

    /// How many realizations have been drawn.
    pub(super) fn count(&self) -> u64 {
        self.sequence.position()
    }

    /// Draws the next realization and moves `F` towards it: SLSE.
    pub(super) fn fuse_next(&mut self) -> Move {
        let k = self.count() + 1;
        self.raw.copy_from_slice(self.sequence.draw());
        let (t, s) = self.run.step(&self.raw, k as usize);
        Move { t, s, k: k as f64 }
    }

    /// Draws the next realization in the place of the one before; the line search between the two (*literal* variant).
    pub(super) fn replace_next(&mut self) -> f64 {
        let before = gather(&self.run.ga, self.run.length, &self.raw);
        let sample = self.sequence.draw();
        // <E, E'>: two realizations have the same value where they hit the same entry, and nothing in common elsewhere
        let common: f64 = sample.iter().zip(&self.raw).zip(&self.run.g2).map(|((a, b), g)| if a == b { *g } else { 0.0 }).sum();
        let after = gather(&self.run.ga, self.run.length, sample);
        let gg = self.run.state.gg;
        let (num, den) = (after - before - common + gg, 2.0 * (gg - common)); // <E* - E, E' - E>, ||E' - E||^2
        self.raw.copy_from_slice(sample);
        if den > 0.0 { (num / den).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// The value the latest realization has in line `j`, in units of `scale`.
    pub(super) fn raw_value(&self, j: usize) -> f64 {
        let sign = self.signs[j * self.run.length + self.raw[j] as usize];
        f64::from(sign) * self.run.gamma[j]
    }

    /// Line `j` of `F` times `factor`.
    pub(super) fn line(&self, j: usize, factor: f64, out: &mut [f64]) {
        let g = self.run.gamma[j];
        if g == 0.0 {
            return out.fill(0.0);
        }
        let range = j * self.run.length..(j + 1) * self.run.length;
        let (c, b) = (self.run.c / g * factor, self.run.b * g * factor);
        let (h, signs) = (&self.run.h[range.clone()], &self.signs[range.clone()]);
        for ((out, h), sign) in out.iter_mut().zip(h).zip(signs) {
            *out = f64::from(*sign) * (c * h);
        }
        if b != 0.0 {
            for ((out, hits), sign) in out.iter_mut().zip(&self.run.hits[range]).zip(signs) {
                *out += f64::from(*sign) * (b * hits);
            }
        }
    }

    /// Line `j` of the sum `S` of all realizations times `factor` (with the safeguard).
    pub(super) fn sum_line(&self, j: usize, factor: f64, out: &mut [f64]) {
        let range = j * self.run.length..(j + 1) * self.run.length;
        let g = self.run.gamma[j] * factor;
        for ((out, hits), sign) in out.iter_mut().zip(&self.run.hits[range.clone()]).zip(&self.signs[range]) {
            *out = f64::from(*sign) * (g * hits);
        }
    }

    /// Entry `(j, k)` of `F`, as it is handed out.
    pub(super) fn entry(&self, j: usize, at: usize) -> f64 {
        let sign = f64::from(self.signs[at]);
        if sign == 0.0 || self.run.gamma[j] == 0.0 { 0.0 } else { sign * self.run.f(j, at) }
    }

    /// `F`, or with `literal` the latest realization, line by line, in units of `scale`.
    pub(super) fn estimate(&self, literal: bool) -> Vec<f64> {
        let length = self.run.length;
        if literal {
            let mut out = vec![0.0; self.run.h.len()];
            for (j, r) in self.raw.iter().enumerate() {
                out[j * length + *r as usize] = self.raw_value(j);
            }
            return out;
        }
        (0..self.run.h.len()).map(|at| self.entry(at / length, at)).collect()
    }

    /// `F - E*`, entry by entry: differences of neighbouring doubles, so exact once `F` is close.
    pub(super) fn deviation(&self, literal: bool) -> Vec<f64> {
        let mut out = self.estimate(literal);
        out.iter_mut().zip(self.law.values()).for_each(|(f, w)| *f -= w / self.scale);
        out
    }

    /// Folds the scalings into `F` and recomputes every inner product from its entries.
    pub(super) fn refresh(&mut self) {
        self.run.fold();
        let deviation = self.deviation(false);
        let length = self.run.length;
        self.run.state.er = deviation.iter().map(|d| d * d).sum();
        self.run.state.al = deviation.iter().enumerate().map(|(at, d)| -d * self.entry(at / length, at)).sum();
    }

    /// `E ||E - E*||^2 = sum_j (g_j^2 - ||a_j||^2)`.
    pub(super) fn variance(&self) -> f64 {
        (self.run.state.gg - self.run.state.aa).max(0.0)
    }

    /// Refuses an `F` that no sequence of realizations leads to: every line of `F` is a mean of atoms, so its 1-norm is
    /// `g_j`, and with the safeguard every line of `S` counts all realizations.
    pub(super) fn check(&self) -> Result<()> {
        let (length, count) = (self.run.length, self.count() as f64);
        let largest = self.run.gamma.iter().fold(0.0f64, |m, g| m.max(*g));
        for (j, g) in self.run.gamma.iter().enumerate() {
            let range = j * length..(j + 1) * length;
            let line: f64 = range.clone().map(|at| self.entry(j, at).abs()).sum();
            let off = range.clone().any(|at| self.run.h[at] < 0.0 || (self.signs[at] == 0 && *g > 0.0 && self.run.h[at] != 0.0));
            let counted = self.run.hits.is_empty() || {
                let hits = &self.run.hits[range];
                (hits.iter().sum::<f64>() - count).abs() <= 1e-9 * count && hits.iter().all(|h| *h >= 0.0)
            };
            if off || !counted || (line - g).abs() > 1e-6 * largest {
                return Err(damaged("estimates that are means of realizations", format!("another one in line {j}")));
            }
        }
        let er: f64 = self.deviation(false).iter().map(|d| d * d).sum();
        let slack = 1e-6 * er + 1e-9 * self.run.state.gg;
        if (er - self.run.state.er).abs() <= slack {
            return Ok(());
        }
        Err(damaged("errors that belong to the estimates", format!("{:e} for {er:e}", self.run.state.er)))
    }
}

/// A saved state that cannot be one.
pub(super) fn damaged(expected: &'static str, found: String) -> Error {
    Error::Value { name: "state", expected, found }
}
