//! The recursion for one face, and its affine terms.

use super::{Gains, Riccati, add_transposed};
use crate::error::Result;
use crate::limits::bounds::Bounds;
use crate::limits::factor::product;
use crate::limits::kernel::{Work, add_line, add_lines, add_times, axpy, kernel, solved, widest};
use crate::limits::quadratic::Until;
use crate::limits::tiles::factored;

impl Riccati {
    /// The recursion with `held` inputs out, and `diagonal` added to `R`; false where some `G` is singular to rounding.
    pub(super) fn recursion(
        &mut self,
        gains: &mut Gains,
        held: &[i8],
        diagonal: Option<&[f64]>,
        until: Until<'_>,
    ) -> Result<bool> {
        let (n, m, ln, lm, steps) = (self.n, self.m, self.ln, self.lm, self.steps);
        if gains.held.len() != held.len() {
            *gains = self.gains()?;
        }
        gains.held.copy_from_slice(held);
        for t in (0..steps).rev() {
            until.check()?;
            let held = &held[t * m..(t + 1) * m];
            let (before, after) = gains.p.split_at_mut(t * n * ln);
            let p = &mut after[..n * ln];
            if t + 1 == steps {
                p.copy_from_slice(&self.q[1].values);
            }
            let p = &*p;
            let gain = &mut gains.gain[t * m * ln..(t + 1) * m * ln];
            let g = &mut gains.lower[t * m * lm..(t + 1) * m * lm];
            let inverse = &mut gains.inverse[t * m..(t + 1) * m];
            let [pa, pb, closed, bpa] = &mut self.squares;
            product(p, ln, false, n, &self.a.values, &mut pa.values, ln)?;
            product(p, ln, false, n, &self.b.values, &mut pb.values, lm)?;
            product(&self.b.values, lm, true, n, &pb.values, g, lm)?;
            product(&self.b.values, lm, true, n, &pa.values, &mut bpa.values, ln)?;
            g.iter_mut().zip(&self.r.values).for_each(|(g, r)| *g += r);
            for j in 0..m {
                if let Some(diagonal) = diagonal {
                    g[j * lm + j] += diagonal[t * m + j];
                }
                if held[j] != 0 {
                    g[j * lm..(j + 1) * lm].fill(0.0);
                    (0..m).for_each(|i| g[i * lm + j] = 0.0);
                    g[j * lm + j] = 1.0;
                    bpa.line_mut(j).fill(0.0);
                }
            }
            gain.copy_from_slice(&bpa.values);
            let positive = factored(g, m, lm, inverse);
            if positive {
                solve_lines(g, lm, inverse, gain, ln);
            }
            if positive && t > 0 {
                let next = &mut before[(t - 1) * n * ln..];
                if self.grows {
                    // P <- Q + (A - B L)' P (A - B L) + L' R L
                    closed.values.copy_from_slice(&self.a.values);
                    for j in (0..m).filter(|&j| held[j] == 0) {
                        let gain = &gain[j * ln..(j + 1) * ln];
                        (0..n).for_each(|i| add_line(-self.b.line(i)[j], gain, closed.line_mut(i)));
                    }
                    product(p, ln, false, n, &closed.values, &mut pa.values, ln)?;
                    product(&closed.values, ln, true, n, &pa.values, next, ln)?;
                    for (j, k) in (0..m * m).map(|i| (i / m, i % m)).filter(|&(j, k)| held[j] == 0 && held[k] == 0) {
                        let more = diagonal.filter(|_| j == k).map_or(0.0, |diagonal| diagonal[t * m + j]);
                        let (weight, row) = (self.r.line(j)[k] + more, &gain[j * ln..(j + 1) * ln]);
                        let other = &gain[k * ln..(k + 1) * ln];
                        let lines = next.chunks_exact_mut(ln).take(n).zip(row);
                        lines.for_each(|(next, v)| add_line(weight * v, other, next));
                    }
                } else {
                    // P <- Q + A' P A - (B' P A)' L
                    product(&self.a.values, ln, true, n, &pa.values, next, ln)?;
                    for j in (0..m).filter(|&j| held[j] == 0) {
                        let (row, gain) = (bpa.line(j), &gain[j * ln..(j + 1) * ln]);
                        next.chunks_exact_mut(ln).take(n).zip(row).for_each(|(next, v)| add_line(-v, gain, next));
                    }
                }
                next.iter_mut().zip(&self.q[0].values).for_each(|(p, q)| *p += q);
                for i in 0..n {
                    for j in 0..i {
                        let mean = 0.5 * (next[i * ln + j] + next[j * ln + i]);
                        (next[i * ln + j], next[j * ln + i]) = (mean, mean);
                    }
                }
            }
            if !positive {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The free inputs of the face of `gains`: with `linear` the solution of `H_FF u_F = linear_F`, otherwise the
    /// minimiser of `J` for the held inputs in `u`; `limits`: clipped step by step.
    pub(super) fn roll(&mut self, gains: &Gains, linear: bool, u: &mut [f64], limits: Option<Bounds<'_>>) {
        let (n, m, ln, lm, steps) = (self.n, self.m, self.ln, self.lm, self.steps);
        let [p, w, x, input, h] = &mut self.work;
        p.fill(0.0);
        for t in (0..steps).rev() {
            let held = &gains.held[t * m..(t + 1) * m];
            let at = &mut u[t * m..(t + 1) * m];
            if !linear {
                // p - Q r: here p is of the step after
                let q = &self.q[usize::from(t + 1 == steps)];
                add_times(&q.values, self.reference.line(t), -1.0, &mut p[..n]);
            }
            // w = P c + p with c = B u_W
            w.copy_from_slice(p);
            input.fill(0.0);
            if !linear {
                (0..m).filter(|&j| held[j] != 0).for_each(|j| input[j] = at[j]);
                if input.iter().any(|v| *v != 0.0) {
                    x.fill(0.0);
                    add_times(&self.b.values, input, 1.0, &mut x[..n]);
                    add_times(&gains.p[t * n * ln..(t + 1) * n * ln], x, 1.0, &mut w[..n]);
                }
            }
            // h = B' w + R u_W - v
            h.fill(0.0);
            add_transposed(&self.b, &w[..n], 1.0, h);
            if !linear {
                add_times(&self.r.values, input, 1.0, &mut h[..m]);
            }
            for j in 0..m {
                h[j] = if held[j] != 0 {
                    0.0
                } else if linear {
                    h[j] - at[j]
                } else {
                    h[j]
                };
            }
            // p = A' w - L' h, and the constant part -G^{-1} h of the inputs
            p.fill(0.0);
            add_transposed(&self.a, &w[..n], 1.0, p);
            let gain = &gains.gain[t * m * ln..(t + 1) * m * ln];
            add_lines(gain, ln, h[..m].iter().enumerate().map(|(j, h)| (j, -h)), p);
            let (g, inverse) = (&gains.lower[t * m * lm..(t + 1) * m * lm], &gains.inverse[t * m..(t + 1) * m]);
            solved(g, lm, inverse, h);
            for j in 0..m {
                if held[j] == 0 {
                    at[j] = -h[j];
                } else if linear {
                    at[j] = 0.0;
                }
            }
        }
        x.fill(0.0);
        if !linear {
            x.copy_from_slice(&self.x0);
        }
        for t in 0..steps {
            let at = &mut u[t * m..(t + 1) * m];
            input.fill(0.0);
            add_times(&gains.gain[t * m * ln..(t + 1) * m * ln], x, -1.0, &mut input[..m]);
            for j in 0..m {
                if gains.held[t * m + j] == 0 {
                    at[j] += input[j];
                    if let Some(bounds) = limits {
                        at[j] = bounds.clip(t * m + j, at[j]);
                    }
                }
                input[j] = at[j];
            }
            w.fill(0.0);
            add_times(&self.a.values, x, 1.0, &mut w[..n]);
            add_times(&self.b.values, input, 1.0, &mut w[..n]);
            std::mem::swap(w, x);
            self.path[t * n..(t + 1) * n].copy_from_slice(&x[..n]);
        }
    }
}

kernel! {
/// `X <- (L L')^{-1} X` for `X` in lines, `L` in columns.
fn solve_lines<'a>(l: &'a [f64], lm: usize, inverse: &'a [f64], x: &'a mut [f64], ld: usize) -> () {
    let m = inverse.len();
    for k in 0..m {
        let (done, rest) = x.split_at_mut((k + 1) * ld);
        let row = &mut done[k * ld..];
        row.iter_mut().for_each(|v| *v *= inverse[k]);
        rest.chunks_exact_mut(ld).zip(k + 1..m).for_each(|(to, i)| axpy(-l[k * lm + i], row, to));
    }
    for k in (0..m).rev() {
        let (done, rest) = x.split_at_mut((k + 1) * ld);
        let row = &mut done[k * ld..];
        rest.chunks_exact(ld).zip(k + 1..m).for_each(|(from, i)| axpy(-l[k * lm + i], from, row));
        row.iter_mut().for_each(|v| *v *= inverse[k]);
    }
}
}
