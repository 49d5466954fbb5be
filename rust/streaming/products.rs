//! `FA F0`, updated in `O(n)` per realization instead of `O(n^2)`.
//!
//! With the safeguard, `F` also moves towards the mean of all realizations, so the products with the sums `SA`, `S0` of
//! the realizations are kept as well. The product is linear in each factor, and each factor changes by a [`Move`].

use super::estimator::{Estimator, Move};
use crate::error::Result;
use crate::memory::try_zeros;

const WHAT: &str = "a stream";

/// `FA F0` and, with the safeguard, `FA S0`, `SA F0`, `SA S0`; in units of both scales.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Products {
    pub(super) ff: Vec<f64>,
    /// `[FA S0, SA F0, SA S0]`, empty without the safeguard
    pub(super) sums: Vec<[f64; 3]>,
}

/// `F0` and `S0` as plain vectors.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Start {
    pub(super) f: Vec<f64>,
    pub(super) s: Vec<f64>,
}

impl Start {
    pub(super) fn of(x0: &Estimator) -> Result<Self> {
        let mut start = Self { f: try_zeros(WHAT, x0.run.length)?, s: try_zeros(WHAT, x0.run.hits.len())? };
        start.update(x0);
        Ok(start)
    }

    pub(super) fn update(&mut self, x0: &Estimator) {
        x0.line(0, 1.0, &mut self.f);
        if !self.s.is_empty() {
            x0.sum_line(0, 1.0, &mut self.s);
        }
    }
}

impl Products {
    /// Zeros.
    pub(super) fn none(n: usize, x0: &Estimator) -> Result<Self> {
        Ok(Self { ff: try_zeros(WHAT, n)?, sums: try_zeros(WHAT, x0.run.hits.len())? })
    }

    /// All products, summed from the entries: `O(n^2)`.
    pub(super) fn direct(a: &Estimator, start: &Start) -> Result<Self> {
        let n = a.run.length;
        let mut made = Self { ff: try_zeros(WHAT, n)?, sums: try_zeros(WHAT, start.s.len())? };
        made.sum_up(a, start, &mut try_zeros(WHAT, n)?);
        Ok(made)
    }

    /// The same; `line` is scratch space for a line of `A`.
    pub(super) fn sum_up(&mut self, a: &Estimator, start: &Start, line: &mut [f64]) {
        self.ff.fill(0.0);
        self.sums.fill([0.0; 3]);
        for j in 0..a.run.length {
            a.line(j, 1.0, line);
            self.ff.iter_mut().zip(&*line).for_each(|(y, a)| *y += a * start.f[j]);
            if self.sums.is_empty() {
                continue;
            }
            self.sums.iter_mut().zip(&*line).for_each(|(y, a)| y[0] += a * start.s[j]);
            a.sum_line(j, 1.0, line);
            for (y, a) in self.sums.iter_mut().zip(&*line) {
                y[1] += a * start.f[j];
                y[2] += a * start.s[j];
            }
        }
    }

    /// Updates after `F0` and `S0` have moved by a realization that hits entry `i` with `value`.
    pub(super) fn move_start(&mut self, a: &Estimator, i: usize, value: f64, by: Move, work: &mut [Vec<f64>; 2]) {
        let [first, second] = work;
        if self.sums.is_empty() {
            if by.t > 0.0 {
                a.line(i, by.t * value, first); // t FA E0
                let u = 1.0 - by.t;
                self.ff.iter_mut().zip(first).for_each(|(y, e)| *y = u * *y + *e);
            }
            return;
        }
        a.line(i, value, first); // FA E0
        a.sum_line(i, value, second); // SA E0
        let (u, v, w) = (1.0 - by.t, 1.0 - by.s, by.s / by.k);
        for (((ff, sums), fe), se) in self.ff.iter_mut().zip(&mut self.sums).zip(first).zip(second) {
            let [fs, sf, ss] = sums;
            *fs += *fe;
            *ss += *se;
            *ff = v * (u * *ff + by.t * *fe) + w * *fs;
            *sf = v * (u * *sf + by.t * *se) + w * *ss;
        }
    }

    /// Updates after `FA` and `SA` have moved by the realization that `a` drew last.
    pub(super) fn move_matrix(&mut self, a: &Estimator, start: &Start, by: Move, work: &mut [Vec<f64>; 2]) {
        let [first, second] = work;
        let n = a.run.length;
        let scatter = |x: &[f64], out: &mut [f64]| {
            out.fill(0.0); // E x
            for (j, ((r, g), x)) in a.raw.iter().zip(&a.run.gamma).zip(x).enumerate() {
                let i = *r as usize;
                out[i] += f64::from(a.signs[j * n + i]) * (g * x);
            }
        };
        if self.sums.is_empty() {
            if by.t > 0.0 {
                scatter(&start.f, first);
                let u = 1.0 - by.t;
                self.ff.iter_mut().zip(first).for_each(|(y, e)| *y = u * *y + by.t * *e);
            }
            return;
        }
        scatter(&start.f, first); // EA F0
        scatter(&start.s, second); // EA S0
        let (u, v, w) = (1.0 - by.t, 1.0 - by.s, by.s / by.k);
        for (((ff, sums), ef), es) in self.ff.iter_mut().zip(&mut self.sums).zip(first).zip(second) {
            let [fs, sf, ss] = sums;
            *sf += *ef;
            *ss += *es;
            *ff = v * (u * *ff + by.t * *ef) + w * *sf;
            *fs = v * (u * *fs + by.t * *es) + w * *ss;
        }
    }
}
