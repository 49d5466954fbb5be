//! One entity of the stream: its realizations in order, and their fusion `F`.

use std::sync::Arc;

use crate::error::Result;
use crate::fuse::{Apart, Run, power_of_two_scale};
use crate::memory::{try_collect, try_zeros};
use crate::sample::{Law, Sequence};
use crate::storage::damaged;
use crate::stream::Key;
use crate::vector::dot;

const WHAT: &str = "a stream";

/// A line with a smaller 1-norm, relative to the largest, counts as zero, because its square underflows.
const NEGLIGIBLE: f64 = 1e-150;

/// `sign(w) value` by flipping a bit; 0, not -0, off the support, where `value` is 0.
#[inline]
fn signed(value: f64, w: f64) -> f64 {
    const SIGN: u64 = 1 << 63;
    f64::from_bits(value.to_bits() ^ (w.to_bits() & SIGN)) + 0.0
}

/// An entity drawn from its own law and fitted to its mean, in units of `scale`, a power of two.
pub(super) struct Estimator {
    pub(super) law: Arc<Law>,
    pub(super) scale: f64,
    pub(super) run: Run<Apart>,
    /// `E ||E - E*||^2 = sum_j (g_j^2 - ||a_j||^2)`
    pub(super) variance: f64,
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

impl Estimator {
    /// A slot without realizations.
    pub(super) fn new(values: Vec<f64>, lines: usize, length: usize, key: Key, safeguard: bool) -> Result<Self> {
        let law = Arc::new(Law::new(values, lines, length)?);
        let scale = power_of_two_scale(law.gamma());
        let unit = |g: &f64| if g / scale < NEGLIGIBLE { 0.0 } else { g / scale };
        let gamma = try_collect(WHAT, law.gamma().iter().map(unit))?;
        let mut run = Run::new(gamma, length, safeguard, law.values().iter().map(|a| a.abs() / scale))?;
        run.refresh(); // er = ||E*||^2
        let sign = |v: &f64| i8::from(*v > 0.0) - i8::from(*v < 0.0);
        Ok(Self {
            scale,
            variance: (run.gg - run.state.er).max(0.0),
            run,
            sequence: Sequence::new(&law, key)?,
            signs: try_collect(WHAT, law.values().iter().map(sign))?,
            raw: try_zeros(WHAT, lines)?,
            law,
        })
    }

    /// Number of realizations drawn.
    pub(super) fn count(&self) -> u64 {
        self.sequence.position()
    }

    /// Draws the next realization and moves `F` towards it: SLSE.
    pub(super) fn fuse_next(&mut self) -> Move {
        let before = self.count();
        self.raw.copy_from_slice(self.sequence.draw());
        let (mut t, mut s) = ([0.0], [0.0]);
        self.run.advance(&self.raw, before as usize, &mut t, &mut s);
        Move { t: t[0], s: s[0], k: (before + 1) as f64 }
    }

    /// The value of the latest realization in line `j`, in units of `scale`.
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
        for ((out, h), w) in out.iter_mut().zip(&self.run.tables.h[range.clone()]).zip(values) {
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

    /// Line `j` of `F`.
    pub(super) fn entries(&self, j: usize, out: &mut [f64]) {
        let (run, values) = (&self.run, self.law.line(j));
        if run.b != 0.0 || run.gamma[j] == 0.0 {
            out.iter_mut().zip(run.line(j)).zip(values).for_each(|((out, f), w)| *out = signed(f, *w));
        } else {
            let (h, c, g) = (&run.tables.h[j * run.length..], run.c, run.gamma[j]); // the same without hits
            out.iter_mut().zip(h).zip(values).for_each(|((out, h), w)| *out = signed(c * h / g, *w));
        }
    }

    /// Calls `visit` for every line of `F` and its difference to the line of `E*`. Neighbouring doubles have an exact
    /// difference, so the second is exact once `F` is close. `room` is scratch space for the two.
    pub(super) fn visit(&self, [line, off]: [&mut Vec<f64>; 2], mut visit: impl FnMut(usize, &[f64], &[f64])) {
        let length = self.run.length;
        let unit = self.scale.recip(); // exact: a power of two
        for (j, values) in self.law.values().chunks_exact(length).enumerate() {
            self.entries(j, line);
            for ((off, f), w) in off.iter_mut().zip(&*line).zip(values) {
                *off = f - w * unit;
            }
            visit(j, line, off);
        }
    }

    /// `F` line by line, in units of `scale`.
    pub(super) fn estimate(&self) -> Result<Vec<f64>> {
        let mut out = try_zeros(WHAT, self.law.values().len())?;
        for (j, line) in out.chunks_exact_mut(self.run.length).enumerate() {
            self.entries(j, line);
        }
        Ok(out)
    }

    /// `||F - E*||^2`, summed from the entries.
    pub(super) fn squared_error(&self, room: [&mut Vec<f64>; 2]) -> f64 {
        let mut er = 0.0;
        self.visit(room, |_, _, off| er += dot(off, off));
        er
    }

    /// Refuses an `F` that no sequence of realizations gives: every line of `F` is a mean of atoms, so its 1-norm is
    /// `g_j`, and with the safeguard every line of `S` counts all realizations.
    pub(super) fn check(&self) -> Result<()> {
        let (length, count) = (self.run.length, self.count() as f64);
        let largest = self.run.gamma.iter().fold(0.0f64, |m, g| m.max(*g));
        let mut line = try_zeros(WHAT, length)?;
        for (j, g) in self.run.gamma.iter().enumerate() {
            let range = j * length..(j + 1) * length;
            self.entries(j, &mut line);
            let sum: f64 = line.iter().map(|f| f.abs()).sum();
            let off = range.clone().zip(&line).any(|(at, f)| {
                // a mean of atoms has their signs; h alone may be negative with the safeguard
                let against = f64::from(self.signs[at]) * f < -1e-9 * largest;
                against || (self.signs[at] == 0 && *g > 0.0 && self.run.tables.h[at] != 0.0)
            });
            let counted = self.run.hits.is_empty() || {
                let hits = &self.run.hits[range];
                (hits.iter().sum::<f64>() - count).abs() <= 1e-9 * count && hits.iter().all(|h| *h >= 0.0)
            };
            if off || !counted || (sum - g).abs() > 1e-6 * largest {
                return Err(damaged("a state with means of realizations", format!("another line {j}")));
            }
        }
        let (found, fresh, gg) = (self.run.state, self.run.sums(), self.run.gg);
        let carried = [
            (found.ff, fresh.ff, gg),
            (found.al, fresh.al, gg),
            (found.er, fresh.er, gg),
            (found.fs, fresh.fs, gg * count),
            (found.ss, fresh.ss, gg * count * count),
            (found.sa, fresh.sa, gg * count),
        ];
        for (found, fresh, size) in carried {
            let slack = 1e-6 * fresh.abs() + 1e-9 * size;
            if (fresh - found).abs() > slack {
                return Err(damaged(
                    "a state with the inner products of its estimates",
                    format!("{found:e} for {fresh:e}"),
                ));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns with one dominant atom: after a million steps `er` is below `1e-12 ||E*||^2`, so a difference of the
    /// other sums would have no correct digits.
    #[test]
    fn the_carried_error_is_accurate_where_the_target_is_nearly_reached() {
        let n = 6;
        let small = |k: usize| 1e-3 * (k as f64 * 2.399).sin();
        let values: Vec<f64> = (0..n * n).map(|k| if k % (n + 1) == 0 { -1.3 } else { small(k) }).collect();
        for safeguard in [false, true] {
            let mut slot = Estimator::new(values.clone(), n, n, Key([1; 32]), safeguard).unwrap();
            for step in 1..=1_000_000 {
                slot.fuse_next();
                if step % 256 == 0 {
                    slot.run.refresh(); // the last one is 64 steps before the end
                }
            }
            let (mut line, mut off) = (vec![0.0; n], vec![0.0; n]);
            let er = slot.squared_error([&mut line, &mut off]);
            let (found, fresh) = (slot.run.state, slot.run.sums());
            assert!(er > 0.0 && er < 1e-12 * fresh.ff, "{er:e}");
            assert!((found.er - er).abs() < 1e-7 * er, "{:e} for {er:e}", found.er);
            assert!((found.al - fresh.al).abs() < 1e-14 * fresh.ff, "{:e} for {:e}", found.al, fresh.al);
            assert!((found.ff - fresh.ff).abs() < 1e-14 * fresh.ff);
        }
    }
}
