//! A problem by orthogonal factors, for ill-conditioned ones: `[M y; R^(1/2) 0] = Q [T c; 0 p]` gives
//! `J(u) = ||T u - c||^2 + p^2`, and a face is solved by the triangle of `T_F`. No matrix is squared.

use super::bounds::Bounds;
use super::dense::Dense;
use super::kernel::{add_transposed, padded, times};
use super::quadratic::Quadratic;
use crate::error::Result;
use crate::identify::triangle;
use crate::memory::{checked_len, try_room, try_zeros};
use crate::parallel::Stop;

const WHAT: &str = "a control within limits";

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
    pub(super) fn new(dense: &Dense, stop: &Stop) -> Result<Self> {
        let (d, ld) = (dense.d, dense.ld);
        let (found, width) = reduce((&dense.m, d, ld), &dense.r, &[&dense.y], stop)?;
        let (mut t, mut c, mut curvature) =
            (try_zeros(WHAT, checked_len(WHAT, d, ld)?)?, try_zeros(WHAT, d)?, try_zeros(WHAT, d)?);
        for (i, row) in found.chunks_exact(width).take(d).enumerate() {
            t[i * ld..i * ld + d].copy_from_slice(&row[..d]);
            c[i] = row[d];
            row.iter().zip(&mut curvature).for_each(|(v, sum)| *sum += v * v);
        }
        Ok(Self {
            d,
            ld,
            t,
            c,
            rest: found[width * width - 1].powi(2) + dense.rest,
            zero: dense.scale(),
            curvature,
            residual: try_zeros(WHAT, d)?,
            work: try_zeros(WHAT, ld)?,
            face: Upper::default(),
            other: Upper::default(),
        })
    }

    /// The triangle of the columns with `held = 0`, of rows of `diagonal` below, and of a right side.
    fn upper(&self, held: &[i8], diagonal: Option<&[f64]>, right: Option<&[f64]>, stop: &Stop) -> Result<Upper> {
        let (d, ld) = (self.d, self.ld);
        let mut free = try_room(WHAT, d)?;
        free.extend((0..d).filter(|&i| held[i] == 0));
        let (k, extra) = (free.len(), usize::from(right.is_some()));
        let width = k + extra;
        if width == 0 {
            return Ok(Upper::default());
        }
        let more = if diagonal.is_some() { k } else { 0 };
        let mut rows = try_zeros(WHAT, checked_len(WHAT, d + more, width)?)?;
        for (i, row) in rows.chunks_exact_mut(width).take(d).enumerate() {
            row.iter_mut().zip(&free).for_each(|(to, &j)| *to = self.t[i * ld + j]);
            if let Some(right) = right {
                row[k] = right[i];
            }
        }
        if let Some(diagonal) = diagonal {
            for (j, row) in rows[d * width..].chunks_exact_mut(width).enumerate() {
                row[j] = diagonal[free[j]].sqrt();
            }
        }
        Ok(Upper { r: triangle(&rows, width, 1, stop)?, free, width })
    }
}

impl Quadratic for Orthogonal {
    fn size(&self) -> usize {
        self.d
    }

    fn curvature(&self) -> &[f64] {
        &self.curvature
    }

    fn scale(&self) -> f64 {
        self.zero
    }

    fn face(&mut self, held: &[i8], u: &mut [f64], stop: &Stop) -> Result<bool> {
        // T_F u_F = c - T_W u_W
        let work = &mut self.work;
        work.fill(0.0);
        work.iter_mut().zip(u.iter().zip(held)).for_each(|(to, (u, held))| *to = if *held != 0 { *u } else { 0.0 });
        times(&self.t, work, true, &mut self.residual);
        self.residual.iter_mut().zip(&self.c).for_each(|(v, c)| *v = c - *v);
        self.face = self.upper(held, None, Some(&self.residual), stop)?;
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
        self.residual.iter().zip(&self.c).map(|(v, c)| (v + c).powi(2)).sum()
    }

    fn slope(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        let work = &mut self.work;
        work.fill(0.0);
        work[..u.len()].copy_from_slice(u);
        times(&self.t, work, true, &mut self.residual);
        self.residual.iter_mut().zip(&self.c).for_each(|(v, c)| *v -= c);
        work.fill(0.0);
        add_transposed(&self.t, &self.residual, true, work);
        g.copy_from_slice(&work[..g.len()]);
        self.residual.iter().map(|v| v * v).sum::<f64>() + self.rest
    }

    fn barrier(&mut self, held: &[i8], diagonal: &[f64], stop: &Stop) -> Result<bool> {
        self.other = self.upper(held, Some(diagonal), None, stop)?;
        Ok(self.other.regular())
    }

    fn newton(&mut self, v: &mut [f64]) {
        self.other.solve(v, &mut self.work);
    }

    fn dual_norm(&mut self, held: &[i8], e: &[f64], stop: &Stop) -> Result<f64> {
        let upper = self.upper(held, None, None, stop)?;
        if !upper.regular() {
            return Ok(f64::INFINITY);
        }
        let work = &mut self.work[..upper.free.len()];
        work.iter_mut().zip(&upper.free).for_each(|(to, &i)| *to = e[i]);
        upper.forth(work);
        Ok(work.iter().map(|v| v * v).sum())
    }

    fn guess(&mut self, bounds: Bounds<'_>, _: &[i8], u: &mut [f64], _: &Stop) -> Result<()> {
        u.iter_mut().enumerate().for_each(|(i, u)| *u = bounds.clip(i, *u));
        Ok(())
    }
}
