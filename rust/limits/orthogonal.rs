//! A problem by orthogonal factors, for ill-conditioned ones: `[M y; R^(1/2) 0] = Q [T c; 0 p]` gives
//! `J(u) = ||T u - c||^2 + p^2`, and a face is solved by the triangle of `T_F`. No matrix is squared. Where `T` is
//! singular, `J(u) + damping sum_i H_ii u_i^2` is minimised, whose control is unique and does not depend on the units
//! of inputs, and [`Orthogonal::certified`] judges it by J.

use super::bounds::Bounds;
use super::certificate::{Certificate, frank_wolfe};
use super::dense::Dense;
use super::kernel::{add_transposed, padded, triangular_times};
use super::quadratic::{Quadratic, Until};
use crate::control::pseudoinverse;
use crate::error::Result;
use crate::identify::triangle;
use crate::memory::{checked_len, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::vector::{axpy, dot};

const WHAT: &str = "a control within limits";

/// Diagonal of a singular `T`: what products of matrices of lower rank are rounded by.
const SINGULAR: f64 = 16.0 * f64::EPSILON;
/// Added to the square of each column of a singular `T`, relative to it: a little more than rounding.
const DAMPED: f64 = 1e-14;

/// `R` of the columns of some inputs, `k x k` row by row.
#[derive(Default)]
struct Upper {
    free: Vec<usize>,
    r: Vec<f64>,
    /// Columns of `r`, of which the last may be a right side.
    width: usize,
}

impl Upper {
    fn at(&self, i: usize, j: usize) -> f64 {
        self.r[i * self.width + j]
    }

    fn regular(&self) -> bool {
        let k = self.free.len();
        let most = (0..k).fold(0.0f64, |m, i| m.max(self.at(i, i)));
        (0..k).all(|i| self.at(i, i) > f64::EPSILON * k as f64 * most)
    }

    /// `x <- R^{-1} x`
    fn back(&self, x: &mut [f64]) {
        for i in (0..x.len()).rev() {
            let sum: f64 = (i + 1..x.len()).map(|j| self.at(i, j) * x[j]).sum();
            x[i] = (x[i] - sum) / self.at(i, i);
        }
    }

    /// `x <- R'^{-1} x`
    fn forth(&self, x: &mut [f64]) {
        for i in 0..x.len() {
            x[i] /= self.at(i, i);
            for j in i + 1..x.len() {
                x[j] -= self.at(i, j) * x[i];
            }
        }
    }

    /// `v <- (R'R)^{-1} v`, 0 elsewhere.
    fn solve(&self, v: &mut [f64], work: &mut [f64]) {
        let work = &mut work[..self.free.len()];
        work.iter_mut().zip(&self.free).for_each(|(to, &i)| *to = v[i]);
        self.forth(work);
        self.back(work);
        v.fill(0.0);
        self.free.iter().zip(work).for_each(|(&i, x)| v[i] = *x);
    }
}

pub(super) struct Orthogonal {
    d: usize,
    ld: usize,
    t: Vec<f64>,
    c: Vec<f64>,
    rest: f64,
    zero: f64,
    curvature: Vec<f64>,
    damping: f64,
    residual: Vec<f64>,
    work: Vec<f64>,
    face: Upper,
    other: Upper,
}

/// `[T c]` and `p^2` of rows `[M y]`, `M` in lines of `ld`, with `R^(1/2)` below, for several right sides `y`.
pub(super) fn reduce(
    (m, d, ld): (&[f64], usize, usize),
    r: &[f64],
    right: &[&[f64]],
    stop: &Stop,
) -> Result<(Vec<f64>, usize)> {
    let (rows, width) = (m.len().checked_div(ld).unwrap_or(0), d + right.len());
    let some = r[..d].iter().filter(|r| **r > 0.0).count();
    let mut all = try_zeros(WHAT, checked_len(WHAT, rows + some, width)?)?;
    let (above, below) = all.split_at_mut(rows * width);
    for (i, row) in above.chunks_exact_mut(width).enumerate() {
        row[..d].copy_from_slice(&m[i * ld..i * ld + d]);
        row[d..].iter_mut().zip(right).for_each(|(to, right)| *to = right[i]);
    }
    let roots = r[..d].iter().enumerate().filter(|(_, r)| **r > 0.0);
    for (row, (i, r)) in below.chunks_exact_mut(width).zip(roots) {
        row[i] = r.sqrt();
    }
    Ok((triangle(&all, width, 1, stop)?, width))
}

impl Orthogonal {
    pub(super) fn new(dense: &Dense, until: Until<'_>) -> Result<Self> {
        let (d, ld) = (dense.d, dense.ld);
        let (found, width) = reduce((&dense.m, d, ld), &dense.r, &[&dense.y], until.stop)?;
        let (mut t, mut c, mut curvature) =
            (try_zeros(WHAT, checked_len(WHAT, d, ld)?)?, try_zeros(WHAT, d)?, try_zeros(WHAT, d)?);
        for (i, row) in found.chunks_exact(width).take(d).enumerate() {
            t[i * ld..i * ld + d].copy_from_slice(&row[..d]);
            c[i] = row[d];
            row.iter().zip(&mut curvature).for_each(|(v, sum)| *sum += v * v);
        }
        let mut new = Self {
            d,
            ld,
            t,
            c,
            rest: found[width * width - 1].powi(2) + dense.rest,
            zero: dense.scale(),
            curvature,
            damping: 0.0,
            residual: try_zeros(WHAT, d)?,
            work: try_zeros(WHAT, ld)?,
            face: Upper::default(),
            other: Upper::default(),
        };
        // an input that changes nothing stays where it is
        let mut idle = try_filled(WHAT, 0, d)?;
        idle.iter_mut().zip(&new.curvature).for_each(|(idle, v)| *idle = i8::from(*v == 0.0));
        // what is left of each column beside those before it
        let upper = new.upper(&idle, None, None, until)?;
        let least = |i: usize| SINGULAR * d as f64 * new.curvature[upper.free[i]].sqrt();
        if (0..upper.free.len()).any(|i| upper.at(i, i) <= least(i)) {
            new.damping = DAMPED;
        }
        Ok(new)
    }

    /// Whether `T` is singular to rounding.
    pub(super) fn damped(&self) -> bool {
        self.damping > 0.0
    }

    /// `damping sum_i H_ii u_i^2`
    fn damped_part(&self, u: &[f64]) -> f64 {
        self.damping * u.iter().zip(&self.curvature).map(|(u, h)| h * u * u).sum::<f64>()
    }

    /// `J(u)` without damping, its half gradient in `g`, and how far it is from the least.
    ///
    /// With `r = T u - c` and any `v`, `J(z) >= J(u) - ||r - v||^2 + 2 sum_i (T'v)_i (z_i - u_i)` for all z. The sum is
    /// at least 0 within the limits if `T'v` is 0 but for inputs at a limit that balances it. So v is r less its part
    /// in the range of the columns of the other inputs. Inputs with `held` not 0 do not change.
    pub(super) fn certified(
        &mut self,
        bounds: Bounds<'_>,
        held: &[i8],
        (u, g): (&[f64], &mut [f64]),
        until: Until<'_>,
    ) -> Result<Certificate> {
        let (d, ld) = (self.d, self.ld);
        let damping = std::mem::take(&mut self.damping);
        let objective = self.slope(u, g);
        self.damping = damping;
        let frank_wolfe = frank_wolfe(bounds, u, g);
        let mut found = Certificate { objective, gap: frank_wolfe, frank_wolfe, distance: (frank_wolfe / 2.0).sqrt() };
        found.at_least_nothing(self.scale());
        let mut open = try_filled(WHAT, false, d)?;
        let (mut v, mut slope) = (try_copy(WHAT, &self.residual)?, try_copy(WHAT, g)?);
        loop {
            if until.reached().is_some() {
                return Ok(found);
            }
            let mut more = false;
            for (i, open) in open.iter_mut().enumerate().filter(|(i, open)| held[*i] == 0 && !**open) {
                let at = bounds.reached(i, u[i], slope[i]);
                *open = !(at < 0 && slope[i] >= 0.0 || at > 0 && slope[i] <= 0.0);
                more |= *open;
            }
            if !more {
                found.improve(self.residual.iter().zip(&v).map(|(r, v)| (r - v).powi(2)).sum());
                return Ok(found);
            }
            let count = open.iter().filter(|open| **open).count();
            let mut columns = try_room(WHAT, checked_len(WHAT, d, count)?)?;
            // columns of size 1: the units of inputs do not decide about the rank
            for row in self.t.chunks_exact(ld).take(d) {
                let some = row.iter().zip(&self.curvature).zip(&open).filter(|(_, open)| **open);
                columns.extend(some.map(|((t, h), _)| t / h.sqrt()));
            }
            let basis = pseudoinverse(&columns, d, count)?.basis;
            // twice: what rounding left the first time
            for _ in 0..2 {
                for direction in basis.chunks_exact(d) {
                    axpy(-dot(direction, &v), direction, &mut v);
                }
            }
            let work = &mut self.work;
            work.fill(0.0);
            add_transposed(&self.t, &v, true, work);
            slope.copy_from_slice(&work[..d]);
        }
    }

    /// The triangle of the columns with `held = 0`, of rows of `diagonal` below, and of a right side.
    fn upper(&self, held: &[i8], diagonal: Option<&[f64]>, right: Option<&[f64]>, until: Until<'_>) -> Result<Upper> {
        let (d, ld) = (self.d, self.ld);
        let mut free = try_room(WHAT, d)?;
        free.extend((0..d).filter(|&i| held[i] == 0));
        let (k, extra) = (free.len(), usize::from(right.is_some()));
        let width = k + extra;
        if width == 0 {
            return Ok(Upper::default());
        }
        let damped = diagonal.is_some() || self.damping > 0.0;
        let more = if damped { k } else { 0 };
        let mut rows = try_zeros(WHAT, checked_len(WHAT, d + more, width)?)?;
        for (i, row) in rows.chunks_exact_mut(width).take(d).enumerate() {
            row.iter_mut().zip(&free).for_each(|(to, &j)| *to = self.t[i * ld + j]);
            if let Some(right) = right {
                row[k] = right[i];
            }
        }
        if damped {
            for (j, row) in rows[d * width..].chunks_exact_mut(width).enumerate() {
                let i = free[j];
                row[j] = (self.damping * self.curvature[i] + diagonal.map_or(0.0, |diagonal| diagonal[i])).sqrt();
            }
        }
        Ok(Upper { r: triangle(&rows, width, 1, until.stop)?, free, width })
    }
}

impl Quadratic for Orthogonal {
    fn size(&self) -> usize {
        self.d
    }

    fn prepare(&mut self, _: Until<'_>) -> Result<()> {
        Ok(())
    }

    fn curvature(&self) -> &[f64] {
        &self.curvature
    }

    fn scale(&self) -> f64 {
        self.zero
    }

    fn face(&mut self, held: &[i8], u: &mut [f64], until: Until<'_>) -> Result<bool> {
        // T_F u_F = c - T_W u_W
        let work = &mut self.work;
        work.fill(0.0);
        work.iter_mut().zip(u.iter().zip(held)).for_each(|(to, (u, held))| *to = if *held != 0 { *u } else { 0.0 });
        triangular_times(&self.t, work, &mut self.residual);
        self.residual.iter_mut().zip(&self.c).for_each(|(v, c)| *v = c - *v);
        self.face = self.upper(held, None, Some(&self.residual), until)?;
        if !self.face.regular() {
            return Ok(false);
        }
        let k = self.face.free.len();
        let work = &mut self.work[..padded(k)];
        (0..k).for_each(|i| work[i] = self.face.at(i, k));
        self.face.back(&mut work[..k]);
        self.face.free.iter().zip(work).for_each(|(&i, x)| u[i] = *x);
        Ok(true)
    }

    fn correct(&mut self, v: &mut [f64]) {
        self.face.solve(v, &mut self.work);
    }

    fn pull(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        self.slope(u, g);
        let seen: f64 = self.residual.iter().zip(&self.c).map(|(v, c)| (v + c).powi(2)).sum();
        seen + self.damped_part(u)
    }

    fn slope(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        let work = &mut self.work;
        work.fill(0.0);
        work[..u.len()].copy_from_slice(u);
        triangular_times(&self.t, work, &mut self.residual);
        self.residual.iter_mut().zip(&self.c).for_each(|(v, c)| *v -= c);
        work.fill(0.0);
        add_transposed(&self.t, &self.residual, true, work);
        g.copy_from_slice(&work[..g.len()]);
        g.iter_mut().zip(u.iter().zip(&self.curvature)).for_each(|(g, (u, h))| *g += self.damping * h * u);
        self.residual.iter().map(|v| v * v).sum::<f64>() + self.rest + self.damped_part(u)
    }

    fn barrier(&mut self, held: &[i8], diagonal: &[f64], until: Until<'_>) -> Result<bool> {
        self.other = self.upper(held, Some(diagonal), None, until)?;
        Ok(self.other.regular())
    }

    fn newton(&mut self, v: &mut [f64]) {
        self.other.solve(v, &mut self.work);
    }

    fn dual_norm(&mut self, held: &[i8], e: &[f64], until: Until<'_>) -> Result<f64> {
        let upper = self.upper(held, None, None, until)?;
        if !upper.regular() {
            return Ok(f64::INFINITY);
        }
        let work = &mut self.work[..upper.free.len()];
        work.iter_mut().zip(&upper.free).for_each(|(to, &i)| *to = e[i]);
        upper.forth(work);
        Ok(work.iter().map(|v| v * v).sum())
    }

    fn guess(&mut self, bounds: Bounds<'_>, _: &[i8], u: &mut [f64], _: Until<'_>) -> Result<()> {
        u.iter_mut().enumerate().for_each(|(i, u)| *u = bounds.clip(i, *u));
        Ok(())
    }
}
