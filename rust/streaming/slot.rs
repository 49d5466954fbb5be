//! One entity of the stream: its realizations in order, and the `F` they are fused into.

use std::sync::Arc;

use super::greedy::{Run, gather};
use super::vector::dot;
use crate::error::{Error, Result};
use crate::fuse::power_of_two_scale;
use crate::memory::{try_collect, try_zeros};
use crate::sample::{Law, Sequence};
use crate::stream::Key;

const WHAT: &str = "a stream";

/// A line with a smaller 1-norm, relative to the largest, counts as zero: its square is no number.
const NEGLIGIBLE: f64 = 1e-150;

/// `sign(w) value` by flipping a bit; 0, not -0, off the support, where `value` is 0.
#[inline]
fn signed(value: f64, w: f64) -> f64 {
    const SIGN: u64 = 1 << 63;
    f64::from_bits(value.to_bits() ^ (w.to_bits() & SIGN)) + 0.0
}

/// An entity drawn from its own law and fitted to its mean. Everything is in units of `scale`, a power of two.
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
        let unit = |g: &f64| if g / scale < NEGLIGIBLE { 0.0 } else { g / scale };
        let gamma = try_collect(WHAT, law.gamma().iter().map(unit))?;
        let magnitudes = try_collect(WHAT, law.values().iter().map(|a| a.abs() / scale))?;
        let sign = |v: &f64| i8::from(*v > 0.0) - i8::from(*v < 0.0);
        Ok(Self {
            scale,
            run: Run::new(gamma, &magnitudes, safeguard)?,
            sequence: Sequence::new(&law, key)?,
            signs: try_collect(WHAT, law.values().iter().map(sign))?,
            raw: try_zeros(WHAT, lines)?,
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
        let common: f64 =
            sample.iter().zip(&self.raw).zip(&self.run.g2).map(|((a, b), g)| if a == b { *g } else { 0.0 }).sum();
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
        let values = &self.law.values()[range.clone()];
        for ((out, h), w) in out.iter_mut().zip(&self.run.h[range.clone()]).zip(values) {
            *out = c * signed(*h, *w);
        }
        if b != 0.0 {
            for ((out, hits), w) in out.iter_mut().zip(&self.run.hits[range]).zip(values) {
                *out += b * signed(*hits, *w);
            }
        }
    }

    /// Line `j` of the sum `S` of all realizations times `factor` (with the safeguard).
    pub(super) fn sum_line(&self, j: usize, factor: f64, out: &mut [f64]) {
        let range = j * self.run.length..(j + 1) * self.run.length;
        let g = self.run.gamma[j] * factor;
        for ((out, hits), w) in out.iter_mut().zip(&self.run.hits[range.clone()]).zip(&self.law.values()[range]) {
            *out = g * signed(*hits, *w);
        }
    }

    /// Line `j` of `F`, as it is handed out; with `literal`, of the latest realization.
    pub(super) fn entries(&self, j: usize, literal: bool, out: &mut [f64]) {
        let run = &self.run;
        let range = j * run.length..(j + 1) * run.length;
        let g = run.gamma[j];
        if literal || g == 0.0 {
            out.fill(0.0);
            out[self.raw[j] as usize] = if literal { self.raw_value(j) } else { 0.0 };
            return;
        }
        let values = &self.law.values()[range.clone()];
        for ((out, h), w) in out.iter_mut().zip(&run.h[range.clone()]).zip(values) {
            *out = signed(run.c * h / g, *w);
        }
        if run.b != 0.0 {
            for (k, out) in out.iter_mut().enumerate() {
                *out = signed(run.f(j, range.start + k), values[k]);
            }
        }
    }

    /// Calls `visit` for every line of `F` and its difference to the line of `E*`: neighbouring doubles have an exact
    /// difference, so the second is exact once `F` is close. `room` is where the two are made.
    pub(super) fn visit(
        &self,
        literal: bool,
        [line, off]: [&mut Vec<f64>; 2],
        mut visit: impl FnMut(usize, &[f64], &[f64]),
    ) {
        let length = self.run.length;
        let unit = self.scale.recip(); // exact: a power of two
        for (j, values) in self.law.values().chunks_exact(length).enumerate() {
            self.entries(j, literal, line);
            for ((off, f), w) in off.iter_mut().zip(&*line).zip(values) {
                *off = f - w * unit;
            }
            visit(j, line, off);
        }
    }

    /// `F`, or with `literal` the latest realization, line by line, in units of `scale`.
    pub(super) fn estimate(&self, literal: bool) -> Result<Vec<f64>> {
        let mut out = try_zeros(WHAT, self.run.h.len())?;
        for (j, line) in out.chunks_exact_mut(self.run.length).enumerate() {
            self.entries(j, literal, line);
        }
        Ok(out)
    }

    /// `||F - E*||^2` and `<E* - F, F>`, summed from the entries.
    pub(super) fn inner_products(&self, literal: bool, room: [&mut Vec<f64>; 2]) -> (f64, f64) {
        let (mut er, mut al) = (0.0, 0.0);
        self.visit(literal, room, |_, line, off| {
            er += dot(off, off);
            al -= dot(off, line);
        });
        (er, al)
    }

    /// Folds the scalings into `F` and recomputes every inner product from its entries.
    pub(super) fn refresh(&mut self, room: [&mut Vec<f64>; 2]) {
        self.run.fold();
        (self.run.state.er, self.run.state.al) = self.inner_products(false, room);
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
        let (mut line, mut off_line) = (try_zeros(WHAT, length)?, try_zeros(WHAT, length)?);
        for (j, g) in self.run.gamma.iter().enumerate() {
            let range = j * length..(j + 1) * length;
            self.entries(j, false, &mut line);
            let sum: f64 = line.iter().map(|f| f.abs()).sum();
            let off = range.clone().zip(&line).any(|(at, f)| {
                // a mean of atoms has their sign; h alone may be negative with the safeguard
                let against = f64::from(self.signs[at]) * f < -1e-9 * largest;
                against || (self.signs[at] == 0 && *g > 0.0 && self.run.h[at] != 0.0)
            });
            let counted = self.run.hits.is_empty() || {
                let hits = &self.run.hits[range];
                (hits.iter().sum::<f64>() - count).abs() <= 1e-9 * count && hits.iter().all(|h| *h >= 0.0)
            };
            if off || !counted || (sum - g).abs() > 1e-6 * largest {
                return Err(damaged("estimates that are means of realizations", format!("another one in line {j}")));
            }
        }
        let (er, al) = self.inner_products(false, [&mut line, &mut off_line]);
        let mut folded = self.run.copy()?;
        folded.fold(); // the products with S, summed from the entries
        let (found, fresh, gg) = (&self.run.state, &folded.state, self.run.state.gg);
        let carried = [
            (found.er, er, gg),
            (found.al, al, gg),
            (found.fs, fresh.fs, gg * count),
            (found.ss, fresh.ss, gg * count * count),
            (found.sa, fresh.sa, gg * count),
        ];
        for (found, fresh, size) in carried {
            let slack = 1e-6 * fresh.abs() + 1e-9 * size;
            if (fresh - found).abs() > slack {
                return Err(damaged("inner products that belong to the estimates", format!("{found:e} for {fresh:e}")));
            }
        }
        Ok(())
    }
}

/// A saved state that cannot be one.
pub(super) fn damaged(expected: &'static str, found: String) -> Error {
    Error::Value { name: "state", expected, found }
}
