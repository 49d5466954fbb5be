//! The state of SLSE on singletons, and its step in `O(lines)`.
//!
//! Signs are absorbed (`f_k = sign_k F_k >= 0`), and what is stored is `h` with `g f = c h + b g^2 S`, where `S` counts
//! the hits so far (`U = S / k` in units of the atoms) and `b = 0` without the safeguard: scaling `F` or adding a
//! multiple of `U` costs `O(1)`. The inner products of [`State`] are recomputed from `F` by [`Run::refresh`], every
//! `16 length` steps.

use super::line_search::{Move, State};
use super::slse_sample::{Sample, squared_norm};
use super::slse_tables::{Tables, WHAT};
use crate::error::Result;
use crate::memory::{try_collect, try_zeros};
use crate::sample::Index;

/// `F`, how it is stored, and the inner products of the next step.
pub(crate) struct Run<T> {
    pub(crate) length: usize,
    pub(crate) gamma: Vec<f64>,
    /// `1 / g_j`, and 0 for a zero line: nothing can be hit there
    inverse: Vec<f64>,
    /// `g_j^2`, and its sum `||E||^2`
    pub(crate) g2: Vec<f64>,
    pub(crate) gg: f64,
    pub(crate) tables: T,
    pub(crate) c: f64,
    pub(crate) b: f64,
    /// Hits so far, with the safeguard only.
    pub(crate) hits: Vec<f64>,
    pub(crate) state: State,
}

impl<T: Tables> Run<T> {
    /// Before the first realization; `target` yields `sign_k t_k`. `er` is set by [`Self::refresh`] only.
    pub(crate) fn new(
        gamma: Vec<f64>,
        length: usize,
        safeguard: bool,
        target: impl Iterator<Item = f64>,
    ) -> Result<Self> {
        let g2: Vec<f64> = try_collect(WHAT, gamma.iter().map(|g| g * g))?;
        let inverse = |&g: &f64| if g > 0.0 { (1.0 / g).min(f64::MAX) } else { 0.0 };
        let inverse = try_collect(WHAT, gamma.iter().map(inverse))?;
        let entries = gamma.len() * length;
        let hits = try_zeros(WHAT, if safeguard { entries } else { 0 })?;
        let (gg, tables) = (squared_norm(&g2), T::new(length, &gamma, target)?);
        Ok(Self { length, gamma, inverse, g2, gg, tables, c: 1.0, b: 0.0, hits, state: State::default() })
    }

    /// Fuses the realizations of `block`, after `before` earlier ones; writes their steps `t` and, with the safeguard,
    /// `s`.
    pub(crate) fn advance<I: Index>(&mut self, block: &[I], before: usize, steps: &mut [f64], safeguards: &mut [f64]) {
        let samples = Sample::all(block, self.gamma.len(), self.length);
        if self.hits.is_empty() {
            self.plain_steps(samples, steps, before == 0);
        } else {
            for (i, ((sample, step), safeguard)) in samples.zip(steps).zip(safeguards).enumerate() {
                (*step, *safeguard) = self.safeguarded_step(sample, before + i + 1);
            }
        }
    }

    /// One line search per realization; `b = 0` and there is no `S`.
    fn plain_steps<'s, I: Index>(
        &mut self,
        mut samples: impl Iterator<Item = Sample<'s, I>>,
        steps: &mut [f64],
        mut first: bool,
    ) {
        let Some(mut sample) = samples.next() else { return };
        // local copies in registers: fields of `self` would be stored and loaded again in each step
        let (mut state, mut c, gg) = (self.state, self.c, self.gg);
        let (mut h_sum, mut ae) = self.tables.gather(sample);
        for step in steps {
            let Move { t, u, ratio: (num, rest) } =
                if first { state.restart(ae, gg) } else { state.line_search(c * h_sum, ae, gg) };
            first = false;
            *step = t;
            // F <- u c h + t E: h gains t / (u c) g^2
            let mut gain = num / (rest * c);
            c *= u;
            if u <= 0.0 {
                self.forget();
                (gain, c) = (1.0, 1.0);
            }
            let Some(next) = samples.next() else {
                if gain != 0.0 {
                    self.tables.scatter(sample, &self.g2, gain);
                }
                break;
            };
            (h_sum, ae) = self.tables.scatter_and_gather(sample, &self.g2, gain, next);
            sample = next;
            if c < 1e-100 {
                (self.state, self.c) = (state, c);
                self.refresh();
                (state, c) = (self.state, self.c);
                (h_sum, ae) = self.tables.gather(sample);
            }
        }
        (self.state, self.c) = (state, c);
        if c < 1e-100 {
            self.refresh();
        }
    }

    /// The step towards the `n`-th realization, then the one towards the mean of all `n`.
    fn safeguarded_step<I: Index>(&mut self, sample: Sample<'_, I>, n: usize) -> (f64, f64) {
        let (h_sum, ae) = self.tables.gather(sample);
        let (gg, k) = (self.gg, n as f64);
        let mut se = 0.0;
        for (at, g2) in sample.positions().zip(&self.g2) {
            se += g2 * self.hits[at];
            self.hits[at] += 1.0; // the mean includes this realization
        }
        let fe = self.c * h_sum + self.b * se;
        let Move { t, u, .. } = if n == 1 { self.state.restart(ae, gg) } else { self.state.line_search(fe, ae, gg) };
        self.state.ss += 2.0 * se + gg;
        self.state.sa += ae;
        let fs = u * (self.state.fs + fe) + t * (se + gg); // <F', S>
        let (ua, uu) = (self.state.sa / k, self.state.ss / (k * k));
        let Move { t: s, u: v, .. } = self.state.line_search(fs / k, ua, uu);
        self.state.fs = v * fs + s * self.state.ss / k;
        // F'' = v u c h + (v u b + s/k) S + v (t - u b) E, all in units of g
        let e = v * (t - u * self.b);
        self.b = v * u * self.b + s / k;
        let c = v * u * self.c;
        if c > 0.0 {
            self.c = c;
            self.tables.scatter(sample, &self.g2, e / c);
            if self.c < 1e-100 {
                self.refresh();
            }
        } else {
            self.forget();
            self.tables.scatter(sample, &self.g2, e);
        }
        (t, s)
    }

    /// Resets `h`, of which nothing is left in the new `F`.
    #[cold]
    fn forget(&mut self) {
        (0..self.tables.len()).for_each(|k| *self.tables.h_mut(k) = 0.0);
        self.c = 1.0;
    }

    /// Folds `c` and `b` into `h` and recomputes every inner product.
    pub(crate) fn refresh(&mut self) {
        for (j, g2) in self.g2.iter().enumerate() {
            for k in j * self.length..(j + 1) * self.length {
                let hits = self.hits.get(k).map_or(0.0, |s| self.b * g2 * s);
                let h = self.tables.h_mut(k);
                *h = self.c * *h + hits;
            }
        }
        (self.c, self.b) = (1.0, 0.0);
        self.state = self.sums();
    }

    /// Every inner product, summed from the entries; four at a time in each line.
    pub(crate) fn sums(&self) -> State {
        let mut state = State::default();
        for (j, (g2, inverse)) in self.g2.iter().zip(&self.inverse).enumerate() {
            let (from, to) = (j * self.length, (j + 1) * self.length);
            let mut sums = [[0.0; 3]; 4];
            for four in (from..to).step_by(4) {
                for (lane, sum) in sums.iter_mut().enumerate().take(to - four) {
                    let hits = self.hits.get(four + lane).map_or(0.0, |s| self.b * g2 * s);
                    let (h, a) = self.tables.get(four + lane);
                    let gf = self.c * h + hits;
                    let (f, p) = (gf * inverse, (a - gf) * inverse);
                    sum[0] += f * f;
                    sum[1] += p * f;
                    sum[2] += p * p;
                }
            }
            let [ff, al, er] = [0, 1, 2].map(|i| (sums[0][i] + sums[1][i]) + (sums[2][i] + sums[3][i]));
            state.ff += ff;
            state.al += al;
            state.er += er;
            for (k, s) in (from..to).zip(self.hits.get(from..to).unwrap_or_default()) {
                let (h, a) = self.tables.get(k);
                state.fs += (self.c * h + self.b * g2 * s) * s;
                state.ss += g2 * s * s;
                state.sa += a * s;
            }
        }
        state
    }

    /// `||E* - F||` for the `t_k sign_k` of the target, summed from the entries of `F` that are reported.
    pub(super) fn error(&self, mut target: impl Iterator<Item = f64>) -> f64 {
        // four independent sums, so that an addition does not wait for the one before
        let mut sums = [0.0; 4];
        for j in 0..self.gamma.len() {
            for (k, (f, t)) in self.line(j).zip(&mut target).enumerate() {
                sums[k % 4] += (t - f).powi(2);
            }
        }
        ((sums[0] + sums[1]) + (sums[2] + sums[3])).sqrt()
    }

    /// `f_k = (c h_k + b g^2 S_k) / g` in line `j`; 0 in a zero line.
    pub(crate) fn line(&self, j: usize) -> impl Iterator<Item = f64> {
        let (from, to) = (j * self.length, (j + 1) * self.length);
        let (c, b, g) = (self.c, self.b * self.g2[j], if self.gamma[j] > 0.0 { self.gamma[j] } else { 1.0 });
        let hits = move |k: usize| self.hits.get(k).map_or(0.0, |hits| b * hits);
        self.tables.h(from, to).zip(from..).map(move |(h, k)| (c * h + hits(k)) / g)
    }
}

#[cfg(test)]
mod tests {
    use super::super::slse_tables::{Apart, Beside};
    use super::*;

    /// The same `F`, stored with a tiny `c`, takes the same steps, also across the refresh that follows, and whether or
    /// not the next realization is known in advance.
    #[test]
    fn a_tiny_scale_is_folded_into_the_table_in_time() {
        /// The steps, with a `c` just above the limit after ten of them; the others halve it.
        fn steps<T: Tables>(c: Option<f64>, blocks: usize) -> Vec<f64> {
            let gamma = [1.0, 2.0, 0.5, 1.5, 3.0];
            let target = (0..15).map(|k| 0.1 + f64::from(k % 4) / 3.0);
            let indices: Vec<u8> = (0..200_u32).map(|k| (k * k % 7 % 3) as u8).collect();
            let mut run: Run<T> = Run::new(gamma.to_vec(), 3, false, target).unwrap();
            let mut steps = vec![0.0; 40];
            run.advance(&indices[..50], 0, &mut steps[..10], &mut []);
            let shrink = c.map_or(1.0, |c| c / run.c);
            run.c *= shrink;
            (0..run.tables.len()).for_each(|k| *run.tables.h_mut(k) /= shrink);
            for block in 0..blocks {
                let (from, to) = (10 + block * 30 / blocks, 10 + (block + 1) * 30 / blocks);
                run.advance(&indices[5 * from..5 * to], from, &mut steps[from..to], &mut []);
            }
            assert!(run.c > 1e-3, "c = {:e} was never folded", run.c);
            steps
        }
        for blocks in [1, 3, 30] {
            let expected = steps::<Apart>(None, blocks);
            assert!(expected[10..].iter().filter(|&&t| t > 0.0).count() > 10);
            for c in [1.01e-100, 1.1e-100, 1.3e-100, 1.6e-100] {
                for found in [steps::<Apart>(Some(c), blocks), steps::<Beside>(Some(c), blocks)] {
                    for (found, expected) in found.iter().zip(&expected) {
                        assert!((found - expected).abs() <= 1e-12, "{blocks} blocks: {found} and {expected}");
                    }
                }
            }
        }
    }
}
