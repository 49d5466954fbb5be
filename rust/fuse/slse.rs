//! SLSE for singleton realizations: one exact line search per realization, in `O(lines)`.
//!
//! `t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1)`, `F <- (1 - t) F + t E`, from `F = E_1` (math: Lemma 4.5, with the
//! recursion on the fused `F`). The *safeguarded* variant follows every step with one more line search, from `F` towards
//! the running mean `U`; that makes the printed inequality SLSE <= uniform true for every sample path.
//!
//! Signs are absorbed (`f_k = sign_k F_k >= 0`), and what is stored is `h` with `g f = c h + b g^2 S`, where `S` counts the
//! hits so far (`U = S / k` in units of the atoms) and `b = 0` without the safeguard: scaling `F` or adding a multiple of
//! `U` costs `O(1)`. The squared error `er = ||E* - F||^2` and `al = <E* - F, F>` follow recursions of their own instead of
//! being differences of large sums, and are recomputed from `F` every `16 length` steps, so that the reported error keeps
//! its relative accuracy however small it becomes.

use super::{distance, power_of_two_scale};
use crate::error::{Result, try_zeros};
use crate::parallel::Stop;
use crate::sample::{Index, Singletons, with_indices};

/// What a sequential fusion leaves behind.
#[derive(Debug, Clone, Default)]
pub struct Sequential {
    /// One weight per realization; they add up to one.
    pub weights: Vec<f64>,
    /// `F = sum_i w_i E_i` after the last realization.
    pub estimate: Vec<f64>,
    /// `||F - E*||` after the first `k` realizations, for each `k` asked for.
    pub errors: Vec<f64>,
    /// The estimates at the same places, one after the other, when asked for.
    pub estimates: Vec<f64>,
}

/// The scalars a step needs; `aa = ||E*||^2` and `gg = ||E||^2` do not change.
struct State {
    aa: f64,
    gg: f64,
    /// `||E* - F||^2`
    er: f64,
    /// `<E* - F, F>`
    al: f64,
    /// `<F, S>`, `<S, S>`, `<S, E*>`: only with the safeguard
    fs: f64,
    ss: f64,
    sa: f64,
}

impl State {
    /// `||F||^2`, from `||E*||^2 = ||E* - F||^2 + 2 <E* - F, F> + ||F||^2`.
    fn ff(&self) -> f64 {
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

struct Run<'a> {
    lines: usize,
    length: usize,
    /// `g_j^2`
    g2: Vec<f64>,
    /// `g_j sign_k t_k`
    ga: Vec<f64>,
    gamma: &'a [f64],
    h: Vec<f64>,
    c: f64,
    b: f64,
    /// hits so far, with the safeguard only
    hits: Vec<f64>,
    state: State,
}

impl Run<'_> {
    /// `f_k = (c h_k + b g^2 S_k) / g`
    fn f(&self, j: usize, k: usize) -> f64 {
        let hits = self.hits.get(k).map_or(0.0, |s| self.b * self.g2[j] * s);
        (self.c * self.h[k] + hits) / self.gamma[j]
    }

    /// `||E* - F||^2` and `<E* - F, F>`, summed from the entries.
    fn direct(&self) -> (f64, f64) {
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
    fn refresh(&mut self) {
        for j in 0..self.lines {
            for k in j * self.length..(j + 1) * self.length {
                let hits = self.hits.get(k).map_or(0.0, |s| self.b * self.g2[j] * s);
                self.h[k] = self.c * self.h[k] + hits;
            }
        }
        (self.c, self.b) = (1.0, 0.0);
        (self.state.er, self.state.al) = self.direct();
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
    fn step<I: Index>(&mut self, sample: &[I], n: usize) -> (f64, f64) {
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
fn gather<I: Index>(table: &[f64], length: usize, sample: &[I]) -> f64 {
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

/// Fuses the realizations one after the other towards `target`, recording the error after the first `k` for each `k` in
/// the increasing `sizes`.
///
/// # Errors
/// [`crate::Error::Interrupted`] after a stop, [`crate::Error::Memory`] if the weights do not fit.
pub fn slse(
    draws: &Singletons,
    target: &[f64],
    safeguard: bool,
    sizes: &[usize],
    keep_estimates: bool,
    stop: &Stop,
) -> Result<Sequential> {
    let law = draws.law();
    let (lines, length) = (law.lines(), law.length());
    let signs = law.signs();
    let on_support = |k: usize| signs[k] != 0.0;
    // What no realization can change stays out of every inner product: a large part there would drown the rest.
    let split = |on: bool| -> Vec<f64> {
        target.iter().enumerate().map(|(k, &t)| if on_support(k) == on { t } else { 0.0 }).collect()
    };
    let reachable = split(true);
    let off = distance(&split(false), &vec![0.0; target.len()]);
    let scale = power_of_two_scale(law.gamma().iter().chain(&reachable));
    let gamma: Vec<f64> = law.gamma().iter().map(|g| g / scale).collect();
    let scaled: Vec<f64> = reachable.iter().map(|t| t / scale).collect();
    let mut run = Run {
        lines,
        length,
        g2: gamma.iter().map(|g| g * g).collect(),
        ga: (0..scaled.len()).map(|k| gamma[k / length] * signs[k] * scaled[k]).collect(),
        h: vec![0.0; scaled.len()],
        c: 1.0,
        b: 0.0,
        hits: if safeguard { vec![0.0; scaled.len()] } else { Vec::new() },
        state: State {
            aa: scaled.iter().map(|t| t * t).sum(),
            gg: gamma.iter().map(|g| g * g).sum(),
            er: 0.0,
            al: 0.0,
            fs: 0.0,
            ss: 0.0,
            sa: 0.0,
        },
        gamma: &gamma,
    };
    let size = draws.size();
    let mut out = Sequential { weights: try_zeros("the weights", size)?, ..Sequential::default() };
    let mut safeguards = if safeguard { try_zeros("the safeguard steps", size)? } else { Vec::new() };
    let mut wanted = sizes.iter().copied().peekable();
    let estimate =
        |run: &Run| -> Vec<f64> {
            (0..scaled.len())
                .map(|k| {
                    if on_support(k) && gamma[k / length] > 0.0 { signs[k] * run.f(k / length, k) * scale } else { 0.0 }
                })
                .collect()
        };
    let refresh_every = 16 * length.max(16);
    let check_every = (1 << 18) / lines + 1; // about a millisecond
    with_indices!(&**draws.indices(), indices => {
        for (i, sample) in indices.chunks_exact(lines).take(size).enumerate() {
            let (t, s) = run.step(sample, i + 1);
            out.weights[i] = t;
            if safeguard {
                safeguards[i] = s;
            }
            if (i + 1) % refresh_every == 0 {
                run.refresh();
            }
            if (i + 1) % check_every == 0 {
                stop.check()?;
            }
            if wanted.next_if_eq(&(i + 1)).is_some() {
                out.errors.push((run.direct().0.max(0.0).sqrt() * scale).hypot(off));
                stop.check()?;
                if keep_estimates {
                    out.estimates.extend(estimate(&run));
                }
            }
        }
    });
    out.estimate = estimate(&run);
    steps_to_weights(&mut out.weights, &safeguards);
    Ok(out)
}

/// Turns the steps `t_k` (in place) and `s_k` into weights: `w_k = C_k (1 - s_k) t_k + sum_{i >= k} C_i s_i / i` with
/// `C_k = prod_{i > k} (1 - s_i)(1 - t_i)`.
pub(super) fn steps_to_weights(steps: &mut [f64], safeguards: &[f64]) {
    let (mut carried, mut from_means) = (1.0, 0.0);
    for k in (0..steps.len()).rev() {
        let (t, s) = (steps[k], safeguards.get(k).copied().unwrap_or(0.0));
        from_means += carried * s / (k + 1) as f64;
        steps[k] = from_means + carried * (1.0 - s) * t;
        carried *= (1.0 - s) * (1.0 - t);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Indices, Law};
    use crate::{Key, Scheme, sample};
    use std::sync::Arc;

    fn run(w: &[f64], lines: usize, length: usize, indices: &[u8], safeguard: bool) -> Sequential {
        let law = Arc::new(Law::new(w.to_vec(), lines, length).unwrap());
        let size = indices.len() / lines;
        let draws = Singletons::new(law, Indices::U8(indices.to_vec()), size).unwrap();
        slse(&draws, w, safeguard, &[size], false, &Stop::new()).unwrap()
    }

    /// The exact rationals that refute SLSE <= uniform path by path.
    #[test]
    fn exact_cases() {
        let squared = |s: Sequential| s.errors[0] * s.errors[0];
        assert!((squared(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 0, 1, 2], false)) - 3.0 / 98.0).abs() < 1e-14);
        assert!((squared(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 1, 2, 0], false)) - 75.0 / 7154.0).abs() < 1e-14);
        // A = [[1, 1], [2, 2]], columns (1, 2) and (1, 2); realizations (1,1), (0,1), (1,0)
        let matrix = [1.0, 2.0, 1.0, 2.0];
        assert!((squared(run(&matrix, 2, 2, &[1, 1, 0, 1, 1, 0], false)) - 0.2).abs() < 1e-14);
        // uniform weights are exact on both: the safeguard finds that
        assert!(run(&[2.0, 1.0, 1.0], 1, 3, &[0, 0, 1, 2], true).errors[0] < 1e-15);
    }

    #[test]
    fn estimate_weights_and_error_agree_over_a_long_run() {
        let w: Vec<f64> = (1..=12).map(|i| f64::from(i) * if i % 3 == 0 { -1.0 } else { 1.0 }).collect();
        let law = Arc::new(Law::new(w.clone(), 3, 4).unwrap());
        let draws = sample(&law, 20_000, Scheme::Iid, &Key([5; 32]), 1, &Stop::new()).unwrap();
        for safeguard in [false, true] {
            let fit = slse(&draws, &w, safeguard, &[20_000], false, &Stop::new()).unwrap();
            assert!((fit.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(distance(&fit.estimate, &draws.combine(&fit.weights, &Stop::new()).unwrap()) < 1e-11);
            assert!((fit.errors[0] - distance(&fit.estimate, &w)).abs() <= 1e-12 * fit.errors[0] + 1e-300);
        }
    }
}
