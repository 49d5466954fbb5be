//! Many steps of `x(k+1) = A x(k) + B u(k)`: Riccati's recursion solves a face in time proportional to the number of steps,
//! and does not form powers of `A`.
//!
//! `J(u) = sum_{k=1..K} ||x(k) - ref(k)||^2_{Q_k} + sum_{k<K} ||u(k)||^2_R`, `Q_k = Q` before the last step. On a face with
//! free inputs `F`, backwards from `P_K = Q_K`: `G = R_FF + B_F' P B_F`, `L = G^{-1} B_F' P A`, `P <- Q + A' P A - A' P B_F L`
//! (Bertsekas 2017, 3.1); the affine terms follow in a second recursion.

use super::bounds::Bounds;
use super::kernel::{Work, add_line, add_lines, add_times, axpy, dot, kernel, padded, product, solved, widest};
use super::quadratic::{Quadratic, Status, Until};
use super::search::Search;
use super::solve::{Penalty, Solution, checked_rows, checked_warm, told};
use super::tiles::factored;
use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_copy, try_filled, try_zeros};
use crate::parallel::Stop;

const WHAT: &str = "a control of many steps";

/// A problem of many steps; matrices row by row.
#[derive(Clone, Copy)]
pub struct Horizon<'a> {
    /// `A` (n, n).
    pub a: &'a [f64],
    /// `B` (n, m).
    pub b: &'a [f64],
    /// The state before the first step (n).
    pub x0: &'a [f64],
    /// Wanted states after each step (K, n).
    pub reference: &'a [f64],
    /// `Q` (n, n), positive semidefinite.
    pub stage: &'a [f64],
    /// `Q_K` (n, n), positive semidefinite.
    pub terminal: &'a [f64],
    /// `R` (m, m), positive semidefinite.
    pub r: &'a [f64],
}

/// A matrix in padded lines.
#[derive(Default, Clone)]
struct Lines {
    values: Vec<f64>,
    ld: usize,
}

impl Lines {
    fn zeros(rows: usize, columns: usize) -> Result<Self> {
        let ld = padded(columns).max(1);
        Ok(Self { values: try_zeros(WHAT, checked_len(WHAT, rows, ld)?)?, ld })
    }

    fn new(values: &[f64], rows: usize, columns: usize) -> Result<Self> {
        let mut lines = Self::zeros(rows, columns)?;
        for (line, row) in lines.values.chunks_exact_mut(lines.ld).zip(values.chunks_exact(columns)) {
            line[..columns].copy_from_slice(row);
        }
        Ok(lines)
    }

    fn line(&self, i: usize) -> &[f64] {
        &self.values[i * self.ld..(i + 1) * self.ld]
    }

    fn line_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.values[i * self.ld..(i + 1) * self.ld]
    }
}

/// `out += A' v`, `A` in lines.
fn add_transposed(a: &Lines, v: &[f64], sign: f64, out: &mut [f64]) {
    add_lines(&a.values, a.ld, v.iter().enumerate().map(|(i, v)| (i, sign * v)), out);
}

/// The recursion for one face.
#[derive(Default)]
struct Gains {
    /// `P_1 .. P_K`, each `n` lines.
    p: Vec<f64>,
    /// `L_0 .. L_{K-1}`, each `m` lines of the length of a state.
    gain: Vec<f64>,
    /// The factor of each `G`, `m` columns, and the inverse of its diagonal.
    lower: Vec<f64>,
    inverse: Vec<f64>,
    held: Vec<i8>,
}

pub(super) struct Riccati {
    n: usize,
    m: usize,
    steps: usize,
    /// Lengths of lines of states and inputs.
    ln: usize,
    lm: usize,
    a: Lines,
    b: Lines,
    q: [Lines; 2],
    r: Lines,
    x0: Vec<f64>,
    reference: Lines,
    curvature: Vec<f64>,
    /// `-J'(0) / 2`, and `J(0)`.
    f: Vec<f64>,
    pub(super) zero: f64,
    /// `sum ||ref||_Q^2`, and with `sum ||A x||_Q^2 + ||u||_R^2` at the last `u`: what `J` is before anything cancels.
    /// `J(0)` of an unstable system grows without end.
    references: f64,
    size: f64,
    face: Gains,
    other: Gains,
    whole: bool,
    /// States less references.
    errors: Lines,
    work: [Vec<f64>; 5],
    squares: [Lines; 4],
}

impl Riccati {
    pub(super) fn new(h: &Horizon<'_>, stop: &Stop) -> Result<Self> {
        let n = h.x0.len();
        let (m, steps) = (h.b.len().checked_div(n).unwrap_or(0), h.reference.len().checked_div(n).unwrap_or(0));
        let named = [
            ("A", h.a, n, n),
            ("B", h.b, n, m),
            ("reference", h.reference, steps, n),
            ("stage", h.stage, n, n),
            ("terminal", h.terminal, n, n),
            ("R", h.r, m, m),
        ];
        require_finite("x0", h.x0)?;
        for (name, values, rows, columns) in named {
            checked_rows(name, values.len(), rows, columns)?;
            require_finite(name, values)?;
        }
        for (name, values, d) in [("stage", h.stage, n), ("terminal", h.terminal, n), ("R", h.r, m)] {
            Penalty::Full(values).split(name, d)?;
        }
        let (ln, lm) = (padded(n).max(1), padded(m).max(1));
        let mut x0 = try_zeros(WHAT, ln)?;
        x0[..n].copy_from_slice(h.x0);
        let (state, input) = (|| try_zeros(WHAT, ln), || try_zeros(WHAT, lm));
        let mut new = Self {
            n,
            m,
            steps,
            ln,
            lm,
            a: Lines::new(h.a, n, n)?,
            b: Lines::new(h.b, n, m)?,
            q: [Lines::new(h.stage, n, n)?, Lines::new(h.terminal, n, n)?],
            r: Lines::new(h.r, m, m)?,
            x0,
            reference: Lines::new(h.reference, steps, n)?,
            curvature: try_zeros(WHAT, checked_len(WHAT, steps, m)?)?,
            f: try_zeros(WHAT, steps * m)?,
            zero: f64::INFINITY,
            references: 0.0,
            size: 0.0,
            face: Gains::default(),
            other: Gains::default(),
            whole: false,
            errors: Lines::zeros(steps, n)?,
            work: [state()?, state()?, state()?, input()?, input()?],
            squares: [Lines::zeros(n, n)?, Lines::zeros(n, m)?, Lines::zeros(n, n)?, Lines::zeros(m, n)?],
        };
        new.set_curvature(stop)?;
        for t in 0..steps {
            new.work[0].fill(0.0);
            add_times(&new.q[usize::from(t + 1 == steps)].values, new.reference.line(t), 1.0, &mut new.work[0][..n]);
            new.references += dot(&new.work[0], new.reference.line(t));
        }
        let (mut g, u) = (try_zeros(WHAT, steps * m)?, try_zeros(WHAT, steps * m)?);
        new.zero = new.slope(&u, &mut g);
        new.f.iter_mut().zip(&g).for_each(|(f, g)| *f = 0.0 - g);
        if new.zero.is_finite() && new.f.iter().chain(&new.curvature).all(|v| v.is_finite()) {
            Ok(new)
        } else {
            Err(Error::Overflow { what: "the state without inputs over all steps" })
        }
    }

    /// `diag(R + B' S B)` with `S_k = Q_k + A' S_{k+1} A`.
    fn set_curvature(&mut self, stop: &Stop) -> Result<()> {
        let (n, m, ln, lm) = (self.n, self.m, self.ln, self.lm);
        let mut s = self.q[1].clone();
        for t in (0..self.steps).rev() {
            stop.check()?;
            let [sa, sb, next, _] = &mut self.squares;
            product(&s.values, ln, false, n, &self.b.values, &mut sb.values, lm);
            for j in 0..m {
                let sum: f64 = (0..n).map(|i| self.b.values[i * lm + j] * sb.values[i * lm + j]).sum();
                self.curvature[t * m + j] = self.r.values[j * lm + j] + sum;
            }
            product(&s.values, ln, false, n, &self.a.values, &mut sa.values, ln);
            product(&self.a.values, ln, true, n, &sa.values, &mut next.values, ln);
            next.values.iter_mut().zip(&self.q[0].values).for_each(|(s, q)| *s += q);
            std::mem::swap(&mut s.values, &mut next.values);
        }
        Ok(())
    }

    /// The recursion with `held` inputs out, and `diagonal` added to `R`; false where some `G` is singular to rounding.
    fn recursion(&mut self, gains: &mut Gains, held: &[i8], diagonal: Option<&[f64]>, stop: &Stop) -> Result<bool> {
        let (n, m, ln, lm, steps) = (self.n, self.m, self.ln, self.lm, self.steps);
        if gains.held.len() != held.len() {
            gains.p = try_zeros(WHAT, checked_len(WHAT, steps * n, ln)?)?;
            gains.gain = try_zeros(WHAT, checked_len(WHAT, steps * m, ln)?)?;
            gains.lower = try_zeros(WHAT, checked_len(WHAT, steps * m, lm)?)?;
            gains.inverse = try_zeros(WHAT, steps * m)?;
            gains.held = try_filled(WHAT, 0, held.len())?;
        }
        gains.held.copy_from_slice(held);
        for t in (0..steps).rev() {
            stop.check()?;
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
            let [pa, pb, _, bpa] = &mut self.squares;
            product(p, ln, false, n, &self.a.values, &mut pa.values, ln);
            product(p, ln, false, n, &self.b.values, &mut pb.values, lm);
            product(&self.b.values, lm, true, n, &pb.values, g, lm);
            product(&self.b.values, lm, true, n, &pa.values, &mut bpa.values, ln);
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
                // P <- Q + A' P A - (B' P A)' L
                let next = &mut before[(t - 1) * n * ln..];
                product(&self.a.values, ln, true, n, &pa.values, next, ln);
                next.iter_mut().zip(&self.q[0].values).for_each(|(p, q)| *p += q);
                for j in (0..m).filter(|&j| held[j] == 0) {
                    let (row, gain) = (bpa.line(j), &gain[j * ln..(j + 1) * ln]);
                    next.chunks_exact_mut(ln).take(n).zip(row).for_each(|(next, v)| add_line(-v, gain, next));
                }
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

    /// The free inputs of the face of `gains`: with `linear` the solution of `H_FF u_F = linear_F`, otherwise the minimiser
    /// of `J` for the held inputs in `u`; `limits`: clipped step by step.
    fn roll(&mut self, gains: &Gains, linear: bool, u: &mut [f64], limits: Option<Bounds<'_>>) {
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

impl Quadratic for Riccati {
    fn size(&self) -> usize {
        self.steps * self.m
    }

    fn curvature(&self) -> &[f64] {
        &self.curvature
    }

    fn scale(&self) -> f64 {
        self.zero.min(self.size)
    }

    fn face(&mut self, held: &[i8], u: &mut [f64], stop: &Stop) -> Result<bool> {
        let mut gains = std::mem::take(&mut self.face);
        let positive = self.recursion(&mut gains, held, None, stop);
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

    fn barrier(&mut self, held: &[i8], diagonal: &[f64], stop: &Stop) -> Result<bool> {
        self.whole = false;
        let mut gains = std::mem::take(&mut self.other);
        let positive = self.recursion(&mut gains, held, Some(diagonal), stop);
        self.other = gains;
        positive
    }

    fn newton(&mut self, v: &mut [f64]) {
        let gains = std::mem::take(&mut self.other);
        self.roll(&gains, true, v, None);
        self.other = gains;
    }

    fn dual_norm(&mut self, held: &[i8], e: &[f64], stop: &Stop) -> Result<f64> {
        if !self.whole {
            let zeros = try_zeros(WHAT, e.len())?;
            self.whole = self.barrier(held, &zeros, stop)?;
        }
        if !self.whole {
            return Ok(if e.iter().all(|e| *e == 0.0) { 0.0 } else { f64::INFINITY });
        }
        let mut v = try_copy(WHAT, e)?;
        self.newton(&mut v);
        Ok(e.iter().zip(&v).map(|(e, v)| e * v).sum::<f64>().abs())
    }

    /// The best control without limits, clipped step by step.
    fn guess(&mut self, bounds: Bounds<'_>, held: &[i8], u: &mut [f64], stop: &Stop) -> Result<()> {
        if !self.whole {
            let zeros = try_zeros(WHAT, u.len())?;
            self.whole = self.barrier(held, &zeros, stop)?;
        }
        if self.whole {
            let gains = std::mem::take(&mut self.other);
            self.roll(&gains, false, u, Some(bounds));
            self.other = gains;
        }
        Ok(())
    }
}

/// The best inputs of a horizon within `bounds` (K m), step by step, from the limits that `warm` names.
///
/// # Errors
/// As [`super::box_control`], and [`Error::Interrupted`] before a first control.
pub fn horizon_control(
    horizon: &Horizon<'_>,
    bounds: Bounds<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
) -> Result<Solution> {
    let mut problem = Riccati::new(horizon, until.stop)?;
    let d = problem.size();
    checked_rows("low", bounds.low.len(), 1, d)?;
    checked_warm(warm, d)?;
    let mut search = Search::new(d)?;
    let early = match search.run(&mut problem, bounds, warm, until) {
        Err(Error::Interrupted) => Some(Status::Interrupted),
        other => other?,
    };
    if !search.certificate.objective.is_finite() {
        search.give_up(&mut problem, bounds);
    }
    let found = search.certificate;
    let mut g = try_zeros(WHAT, d)?;
    problem.slope(&search.u, &mut g);
    told(&search, bounds, (early, found), (problem.zero, problem.scale()))
}
