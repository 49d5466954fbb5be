//! Nonnegative numbers and second-order cones `x_0 >= ||x_1||`: their products, the way to their boundary, and the
//! scaling of Nesterov and Todd.

use super::units::WHAT;
use crate::error::Result;
use crate::memory::{try_room, try_zeros};
use crate::vector::{axpy, dot, norm};

/// Vectors of `flat` numbers, and behind them cones of `side` entries each.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub(super) flat: usize,
    pub(super) side: usize,
}

/// `x_0^2 - ||x_1||^2`
fn determinant(x: &[f64]) -> f64 {
    let rest = norm(&x[1..]);
    (x[0] - rest) * (x[0] + rest)
}

/// `x_0 y_0 - x_1'y_1`
fn form(x: &[f64], y: &[f64]) -> f64 {
    x[0] * y[0] - dot(&x[1..], &y[1..])
}

impl Shape {
    /// The number of inequalities, a cone counted once.
    pub(super) fn degree(&self, len: usize) -> f64 {
        (self.flat + (len - self.flat) / self.side) as f64
    }

    /// The least `t` for which `v + t e` is in the cones.
    pub(super) fn lacking(&self, v: &[f64]) -> f64 {
        let (flat, cones) = v.split_at(self.flat);
        let most = flat.iter().fold(f64::NEG_INFINITY, |most, v| most.max(-v));
        cones.chunks_exact(self.side).fold(most, |most, v| most.max(norm(&v[1..]) - v[0]))
    }

    /// `v += t e`
    pub(super) fn shift(&self, v: &mut [f64], t: f64) {
        let (flat, cones) = v.split_at_mut(self.flat);
        flat.iter_mut().chain(cones.iter_mut().step_by(self.side)).for_each(|v| *v += t);
    }

    /// How far `x + a d` stays in the cones, for an `x` inside.
    pub(super) fn way(&self, x: &[f64], d: &[f64]) -> f64 {
        let flat = x[..self.flat].iter().zip(&d[..self.flat]).filter(|(_, d)| **d < 0.0);
        let mut most = flat.fold(f64::INFINITY, |most, (x, d)| most.min(-x / d));
        let cones = x[self.flat..].chunks_exact(self.side).zip(d[self.flat..].chunks_exact(self.side));
        for (x, d) in cones {
            // c + 2 b a + q a^2, the first root
            let (q, b, c) = (determinant(d), form(x, d), determinant(x));
            let inside = b * b - q * c;
            let below = if inside >= 0.0 { inside.sqrt() - b } else { 0.0 };
            if below > 0.0 {
                most = most.min(c.max(0.0) / below);
            }
        }
        most
    }

    /// `a <- a o b`
    pub(super) fn times(&self, a: &mut [f64], b: &[f64]) {
        let ((flat, cones), (b, others)) = (a.split_at_mut(self.flat), b.split_at(self.flat));
        flat.iter_mut().zip(b).for_each(|(a, b)| *a *= b);
        for (a, b) in cones.chunks_exact_mut(self.side).zip(others.chunks_exact(self.side)) {
            let head = dot(a, b);
            let first = a[0];
            a[1..].iter_mut().zip(&b[1..]).for_each(|(a, b_i)| *a = first * b_i + b[0] * *a);
            a[0] = head;
        }
    }

    /// `r <- x` with `by o x = r`
    pub(super) fn divide(&self, r: &mut [f64], by: &[f64]) {
        let ((flat, cones), (b, others)) = (r.split_at_mut(self.flat), by.split_at(self.flat));
        flat.iter_mut().zip(b).for_each(|(r, b)| *r /= b);
        for (r, b) in cones.chunks_exact_mut(self.side).zip(others.chunks_exact(self.side)) {
            let (square, product) = (determinant(b), dot(&r[1..], &b[1..]));
            let (share, head) = (square / b[0], r[0]);
            r[0] = (head * b[0] - product) / square;
            let along = product / b[0] - head;
            r[1..].iter_mut().zip(&b[1..]).for_each(|(r, b)| *r = (*r * share + along * b) / square);
        }
    }
}

/// `W`, symmetric, with `W z = W^-1 s`: numbers, and `beta (2 v v' - J)` of every cone.
pub(super) struct Scaling {
    shape: Shape,
    flat: Vec<f64>,
    pub(super) beta: Vec<f64>,
    /// `w` with `W^-2 = (2 (J w)(J w)' - J) / beta^2`
    pub(super) points: Vec<f64>,
    v: Vec<f64>,
    /// `W z`
    pub(super) middle: Vec<f64>,
}

impl Scaling {
    /// None where `s` or `z` is not inside to rounding.
    pub(super) fn new(shape: Shape, s: &[f64], z: &[f64]) -> Result<Option<Self>> {
        let (side, count) = (shape.side, (s.len() - shape.flat) / shape.side);
        let mut new = Self {
            shape,
            flat: try_room(WHAT, shape.flat)?,
            beta: try_room(WHAT, count)?,
            points: try_zeros(WHAT, count * side)?,
            v: try_zeros(WHAT, count * side)?,
            middle: try_zeros(WHAT, s.len())?,
        };
        for (to, (s, z)) in new.middle.iter_mut().zip(s.iter().zip(z)).take(shape.flat) {
            if !(*s > 0.0 && *z > 0.0) {
                return Ok(None);
            }
            new.flat.push((s / z).sqrt());
            *to = (s * z).sqrt();
        }
        for k in 0..count {
            let at = shape.flat + k * side;
            let (s, z, lambda) = (&s[at..][..side], &z[at..][..side], &mut new.middle[at..][..side]);
            let (of_s, of_z) = (determinant(s), determinant(z));
            if !(of_s > 0.0 && of_z > 0.0 && s[0] > 0.0 && z[0] > 0.0) {
                return Ok(None);
            }
            let (a, b) = (of_s.sqrt(), of_z.sqrt());
            let c = ((dot(s, z) / a / b + 1.0) / 2.0).sqrt();
            new.beta.push((a / b).sqrt());
            let (w, v) = (&mut new.points[k * side..][..side], &mut new.v[k * side..][..side]);
            for (w, (s, z)) in w.iter_mut().zip(s.iter().zip(z)) {
                *w = (s / a - z / b) / (2.0 * c);
            }
            w[0] = (s[0] / a + z[0] / b) / (2.0 * c);
            let share = (2.0 * (w[0] + 1.0)).sqrt();
            v.iter_mut().zip(w.iter()).for_each(|(v, w)| *v = w / share);
            v[0] += 1.0 / share;
            // the middle without the cancellation of W z
            let (size, head) = ((a * b).sqrt(), 2.0 * c + s[0] / a + z[0] / b);
            let (by_s, by_z) = ((c + z[0] / b) / head / a, (c + s[0] / a) / head / b);
            for (to, (s, z)) in lambda.iter_mut().zip(s.iter().zip(z)) {
                *to = size * (by_s * s + by_z * z);
            }
            lambda[0] = size * c;
        }
        Ok(new.middle.iter().chain(&new.points).all(|v| v.is_finite()).then_some(new))
    }

    /// `x <- W x`
    pub(super) fn times(&self, x: &mut [f64]) {
        let (flat, cones) = x.split_at_mut(self.shape.flat);
        flat.iter_mut().zip(&self.flat).for_each(|(x, w)| *x *= w);
        let side = self.shape.side;
        for ((x, v), beta) in cones.chunks_exact_mut(side).zip(self.v.chunks_exact(side)).zip(&self.beta) {
            let along = 2.0 * dot(v, x);
            x[0] = -x[0];
            axpy(along, v, x);
            x.iter_mut().for_each(|x| *x *= beta);
        }
    }

    /// `x <- W^-1 x`
    pub(super) fn undo(&self, x: &mut [f64]) {
        let (flat, cones) = x.split_at_mut(self.shape.flat);
        flat.iter_mut().zip(&self.flat).for_each(|(x, w)| *x /= w);
        let side = self.shape.side;
        for ((x, v), beta) in cones.chunks_exact_mut(side).zip(self.v.chunks_exact(side)).zip(&self.beta) {
            let along = 2.0 * form(v, x);
            x[0] = along * v[0] - x[0];
            axpy(-along, &v[1..], &mut x[1..]);
            x.iter_mut().for_each(|x| *x /= beta);
        }
    }

    /// The weights `W^-2` of the numbers.
    pub(super) fn weights(&self) -> impl Iterator<Item = f64> + '_ {
        self.flat.iter().map(|w| 1.0 / (w * w))
    }
}
