//! What pivoting and the interior point ask of [`Riccati`].

use super::{Riccati, add_transposed};
use crate::error::Result;
use crate::limits::bounds::Bounds;
use crate::limits::kernel::{add_times, dot};
use crate::limits::quadratic::{Quadratic, Until};

impl Quadratic for Riccati {
    fn size(&self) -> usize {
        self.steps * self.m
    }

    fn prepare(&mut self, until: Until<'_>) -> Result<()> {
        if self.curvature.is_empty() { self.set_curvature(until) } else { Ok(()) }
    }

    fn curvature(&self) -> &[f64] {
        &self.curvature
    }

    fn scale(&self) -> f64 {
        self.zero.min(self.size)
    }

    fn face(&mut self, held: &[i8], u: &mut [f64], until: Until<'_>) -> Result<bool> {
        let mut gains = std::mem::take(&mut self.face);
        let positive = self.recursion(&mut gains, held, None, until);
        if matches!(positive, Ok(true)) {
            self.roll(&gains, false, u, None);
        }
        self.face = gains;
        positive
    }

    fn correct(&mut self, v: &mut [f64]) {
        let gains = std::mem::take(&mut self.face);
        self.roll(&gains, true, v, None);
        self.face = gains;
    }

    fn pull(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        self.slope(u, g);
        u.iter().zip(&*g).zip(&self.f).map(|((u, g), f)| u * (g + f)).sum()
    }

    fn slope(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        let (n, m, steps) = (self.n, self.m, self.steps);
        let [costate, w, x, input, _] = &mut self.work;
        x.copy_from_slice(&self.x0);
        let (mut sum, mut size) = (0.0, self.references);
        for (t, u) in u.chunks_exact(m.max(1)).enumerate() {
            input[..m].copy_from_slice(u);
            w.fill(0.0);
            add_times(&self.a.values, x, 1.0, &mut w[..n]);
            costate.fill(0.0);
            add_times(&self.q[usize::from(t + 1 == steps)].values, w, 1.0, &mut costate[..n]);
            size += dot(costate, w);
            add_times(&self.b.values, input, 1.0, &mut w[..n]);
            std::mem::swap(w, x);
            let error = self.errors.line_mut(t);
            error.iter_mut().zip(&*x).zip(self.reference.line(t)).for_each(|((e, x), r)| *e = x - r);
        }
        costate.fill(0.0);
        for t in (0..steps).rev() {
            // p = Q e + A' p
            w.fill(0.0);
            add_times(&self.q[usize::from(t + 1 == steps)].values, self.errors.line(t), 1.0, &mut w[..n]);
            sum += dot(w, self.errors.line(t));
            if t + 1 < steps {
                add_transposed(&self.a, &costate[..n], 1.0, w);
            }
            std::mem::swap(w, costate);
            input.fill(0.0);
            input[..m].copy_from_slice(&u[t * m..(t + 1) * m]);
            let g = &mut g[t * m..(t + 1) * m];
            g.fill(0.0);
            add_times(&self.r.values, input, 1.0, g);
            let of_input = g.iter().zip(&*input).map(|(g, u)| g * u).sum::<f64>();
            (sum, size) = (sum + of_input, size + of_input);
            input.fill(0.0);
            add_transposed(&self.b, &costate[..n], 1.0, input);
            g.iter_mut().zip(&*input).for_each(|(g, v)| *g += v);
        }
        self.size = size;
        sum
    }

    fn barrier(&mut self, held: &[i8], diagonal: &[f64], until: Until<'_>) -> Result<bool> {
        self.whole = false;
        let mut gains = std::mem::take(&mut self.other);
        let positive = self.recursion(&mut gains, held, Some(diagonal), until);
        self.other = gains;
        positive
    }

    fn newton(&mut self, v: &mut [f64]) {
        let gains = std::mem::take(&mut self.other);
        self.roll(&gains, true, v, None);
        self.other = gains;
    }

    fn dual_norm(&mut self, held: &[i8], e: &[f64], until: Until<'_>) -> Result<f64> {
        if !self.unlimited(held, until)? {
            return Ok(if e.iter().all(|e| *e == 0.0) { 0.0 } else { f64::INFINITY });
        }
        let mut v = std::mem::take(&mut self.moves);
        v.copy_from_slice(e);
        self.newton(&mut v);
        let squared = e.iter().zip(&v).map(|(e, v)| e * v).sum::<f64>();
        self.moves = v;
        Ok(squared.abs())
    }

    /// The best control without limits, clipped step by step.
    fn guess(&mut self, bounds: Bounds<'_>, held: &[i8], u: &mut [f64], until: Until<'_>) -> Result<()> {
        if self.unlimited(held, until)? {
            let gains = std::mem::take(&mut self.other);
            self.roll(&gains, false, u, Some(bounds));
            self.other = gains;
        }
        Ok(())
    }
}

impl Riccati {
    /// The gains of all inputs with `held = 0`, if there are any to rounding.
    fn unlimited(&mut self, held: &[i8], until: Until<'_>) -> Result<bool> {
        if !self.whole {
            let none = std::mem::take(&mut self.none);
            let whole = self.barrier(held, &none, until);
            self.none = none;
            self.whole = whole?;
        }
        Ok(self.whole)
    }
}
