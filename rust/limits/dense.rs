//! A problem given by its matrix.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::bounds::Bounds;
use super::factor::Factor;
use super::kernel::{add_lines, add_transposed, descend, padded, times};
use super::quadratic::Quadratic;
use super::tiles::gram;
use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, room_for_products, try_copy, try_room, try_zeros};
use crate::parallel::Stop;
use crate::vector;

const WHAT: &str = "a control within limits";

/// Sweeps of coordinate descent that guess which limits are reached.
const SWEEPS: usize = 4;
/// Inputs from which `H` is a matrix product of `faer`.
const LARGE: usize = 64;
/// Condition of a face above which its solution is corrected by its residual at once.
const ILL: f64 = 1e8;

/// `M` (rows, d) and the diagonal of `R`, with `H` and memory for its faces; lines are padded.
#[derive(Default)]
pub(super) struct Dense {
    pub(super) d: usize,
    pub(super) ld: usize,
    pub(super) m: Vec<f64>,
    /// `m` has zeros below its diagonal.
    pub(super) triangular: bool,
    pub(super) r: Vec<f64>,
    pub(super) h: Vec<f64>,
    curvature: Vec<f64>,
    pub(super) y: Vec<f64>,
    /// A part of `J` that no input changes.
    pub(super) rest: f64,
    /// `M'y`
    f: Vec<f64>,
    residual: Vec<f64>,
    free: Vec<usize>,
    /// `J(0)`
    zero: f64,
    work: Vec<f64>,
    second: Vec<f64>,
    third: Vec<f64>,
    pub(super) factor: Factor,
    /// For the interior point and the certificate, with the inputs it belongs to; from the first use on.
    other: Factor,
    others: Vec<usize>,
    /// `other` is of `H` itself.
    whole: bool,
    /// `H^{-1}`, in lines like `H`, where it serves for all faces
    inverse: Vec<f64>,
    /// The limits of the last face are few: `factor` is of the block of `H^{-1}` that belongs to them.
    by_inverse: bool,
    ill: bool,
}

impl Dense {
    /// Memory for problems of `rows` and `d`.
    pub(super) fn new(rows: usize, d: usize) -> Result<Self> {
        let ld = padded(d);
        let zeros = |len| try_zeros(WHAT, len);
        Ok(Self {
            d,
            ld,
            m: zeros(checked_len(WHAT, rows, ld)?)?,
            r: zeros(ld)?,
            h: zeros(checked_len(WHAT, d, ld)?)?,
            curvature: zeros(d)?,
            y: zeros(rows)?,
            f: zeros(ld)?,
            residual: zeros(rows)?,
            free: try_room(WHAT, d)?,
            work: zeros(ld)?,
            second: zeros(ld)?,
            third: zeros(ld)?,
            factor: Factor::new(d)?,
            ..Self::default()
        })
    }

    /// A copy with memory of its own.
    pub(super) fn try_clone(&self) -> Result<Self> {
        let mut copy = Self::new(self.y.len(), self.d)?;
        copy.m.copy_from_slice(&self.m);
        copy.r.copy_from_slice(&self.r);
        copy.h.copy_from_slice(&self.h);
        copy.curvature.copy_from_slice(&self.curvature);
        copy.inverse = try_copy(WHAT, &self.inverse)?;
        copy.triangular = self.triangular;
        Ok(copy)
    }

    /// Takes the diagonal of `R`, and `M` as [`Self::set_above`].
    pub(super) fn set(&mut self, m: &[f64], r: &[f64]) -> Result<()> {
        require_finite("R", r)?;
        self.r[..self.d].copy_from_slice(r);
        self.set_above(m)
    }

    /// Takes the first rows of `M`.
    pub(super) fn set_above(&mut self, m: &[f64]) -> Result<()> {
        let (d, ld) = (self.d, self.ld);
        for (line, row) in self.m.chunks_exact_mut(ld.max(1)).zip(m.chunks_exact(d.max(1))) {
            line[..d].copy_from_slice(row);
        }
        self.inverse.clear();
        self.whole = false;
        if d >= LARGE {
            room_for_products()?;
            let m = MatRef::from_row_major_slice(&self.m, self.y.len(), ld);
            let h = MatMut::from_row_major_slice_mut(&mut self.h, d, ld);
            matmul(h, Accum::Replace, m.transpose().subrows(0, d), m, 1.0, Par::Seq);
        } else {
            gram(&self.m, d, ld, &mut self.h);
        }
        for i in 0..d {
            let entry = &mut self.h[i * ld + i];
            *entry += self.r[i];
            self.curvature[i] = *entry;
        }
        if self.curvature.iter().all(|v| v.is_finite()) {
            Ok(())
        } else {
            require_finite("M", m)?;
            Err(Error::Overflow { what: "the square of `M`" })
        }
    }

    /// Takes `y`.
    pub(super) fn aim(&mut self, y: &[f64]) -> Result<()> {
        self.y.copy_from_slice(y);
        self.f.fill(0.0);
        add_transposed(&self.m, &self.y, self.triangular, &mut self.f);
        self.zero = vector::dot(&self.y, &self.y) + self.rest;
        if self.zero.is_finite() && self.f.iter().all(|v| v.is_finite()) {
            Ok(())
        } else {
            require_finite("y", y)?;
            Err(Error::Overflow { what: "the square of `y`" })
        }
    }

    /// `H^{-1}`, if it is kept.
    pub(super) fn inverse(&self) -> Option<&[f64]> {
        (!self.inverse.is_empty()).then_some(&self.inverse)
    }

    /// Keeps `H^{-1}` if the condition of `H` is small enough for it.
    pub(super) fn invert(&mut self, stop: &Stop) -> Result<()> {
        let (d, ld, h) = (self.d, self.ld, &self.h);
        let positive = self.factor.set(d, |j, to| to.copy_from_slice(&h[j * ld + j..j * ld + d]), stop)?;
        if !positive || self.factor.condition() > ILL {
            return Ok(());
        }
        let mut inverse = try_zeros(WHAT, checked_len(WHAT, d, ld)?)?;
        for (j, line) in inverse.chunks_exact_mut(ld).enumerate() {
            stop.check()?;
            line[j] = 1.0;
            self.factor.solve(line);
        }
        // cond(H) <= ||H||_F ||H^{-1}||_F
        if vector::norm(&inverse) * vector::norm(&self.h) <= ILL {
            self.inverse = inverse;
        }
        Ok(())
    }

    /// `v <- H_FF^{-1} v` by the factor of the block.
    fn solve_block(&mut self, v: &mut [f64]) {
        solve_block(&self.factor, &self.free, &mut self.work, v);
    }

    /// `v <- H^{-1} v - (H^{-1})_{:W} ((H^{-1})_{WW})^{-1} ((H^{-1} v)_W - b)`, the solution of `H u = v - lambda` with
    /// `u_W = b`; `free` names `W` here.
    fn solve_by_inverse(&mut self, v: &mut [f64], b: impl Fn(usize) -> f64) {
        let (ld, limits) = (self.ld, &self.free);
        self.second[..v.len()].copy_from_slice(v);
        times(&self.inverse, &self.second, false, v);
        let work = &mut self.work[..padded(limits.len())];
        work.fill(0.0);
        work.iter_mut().zip(limits).for_each(|(to, &i)| *to = v[i] - b(i));
        self.factor.solve(work);
        self.second.fill(0.0);
        add_lines(&self.inverse, ld, limits.iter().zip(&*work).map(|(&i, x)| (i, -x)), &mut self.second);
        v.iter_mut().zip(&self.second).for_each(|(v, x)| *v += x);
        limits.iter().for_each(|&i| v[i] = b(i));
    }
}

impl Quadratic for Dense {
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
        let (d, ld) = (self.d, self.ld);
        let limits = held.iter().filter(|held| **held != 0).count();
        if !self.inverse.is_empty() && 2 * limits <= d {
            self.by_inverse = true;
            self.ill = false;
            self.free.clear();
            self.free.extend((0..d).filter(|&i| held[i] != 0));
            let (limits, inverse) = (&self.free, &self.inverse);
            let column = |j: usize, to: &mut [f64]| {
                to.iter_mut().zip(&limits[j..]).for_each(|(to, &i)| *to = inverse[limits[j] * ld + i]);
            };
            if !self.factor.set(limits.len(), column, stop)? {
                return Ok(false);
            }
            let mut v = std::mem::take(&mut self.third);
            v.copy_from_slice(&self.f);
            self.solve_by_inverse(&mut v, |i| u[i]);
            u.copy_from_slice(&v[..d]);
            self.third = v;
            return Ok(true);
        }
        self.by_inverse = false;
        if !block((&self.h, ld), held, &mut self.free, None, &mut self.factor, stop)? {
            return Ok(false);
        }
        // H_FF u_F = f_F - H_FW u_W
        self.second.copy_from_slice(&self.f);
        let limits = u.iter().enumerate().filter(|&(i, u)| held[i] != 0 && *u != 0.0);
        add_lines(&self.h, ld, limits.map(|(i, u)| (i, -u)), &mut self.second);
        let count = self.free.len();
        let work = &mut self.work[..padded(count)];
        work.iter_mut().zip(&self.free).for_each(|(to, &i)| *to = self.second[i]);
        work[count..].fill(0.0);
        self.factor.solve(work);
        self.free.iter().zip(work).for_each(|(&i, x)| u[i] = *x);
        self.ill = self.factor.condition() > ILL;
        if self.ill {
            let mut g = std::mem::take(&mut self.third);
            for _ in 0..2 {
                self.slope(u, &mut g[..d]);
                self.solve_block(&mut g[..d]);
                u.iter_mut().zip(&g).for_each(|(u, g)| *u -= g);
            }
            self.third = g;
        }
        Ok(true)
    }

    fn correct(&mut self, v: &mut [f64]) {
        if self.by_inverse {
            self.solve_by_inverse(v, |_| 0.0);
        } else {
            self.solve_block(v);
        }
    }

    fn pull(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        if self.by_inverse {
            // H u = f - lambda on the face just solved
            g.fill(0.0);
            self.free.iter().zip(&self.work).for_each(|(&i, lambda)| g[i] = -lambda);
        } else if self.ill {
            self.slope(u, g);
        } else {
            // g = H u - f
            self.second[..u.len()].copy_from_slice(u);
            self.second[u.len()..].fill(0.0);
            times(&self.h, &self.second, false, g);
            g.iter_mut().zip(&self.f).for_each(|(g, f)| *g -= f);
        }
        u.iter().zip(&*g).zip(&self.f).map(|((u, g), f)| u * (g + f)).sum()
    }

    fn slope(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        let work = &mut self.work;
        work[..u.len()].copy_from_slice(u);
        work[u.len()..].fill(0.0);
        times(&self.m, work, self.triangular, &mut self.residual);
        self.residual.iter_mut().zip(&self.y).for_each(|(v, y)| *v -= y);
        let of_inputs: f64 = u.iter().zip(&self.r).map(|(u, r)| r * u * u).sum();
        // g = M'(M u - y) + R u
        work.iter_mut().zip(&self.r).for_each(|(u, r)| *u *= r);
        add_transposed(&self.m, &self.residual, self.triangular, work);
        g.copy_from_slice(&work[..g.len()]);
        vector::dot(&self.residual, &self.residual) + of_inputs + self.rest
    }

    fn barrier(&mut self, held: &[i8], diagonal: &[f64], stop: &Stop) -> Result<bool> {
        self.whole = false;
        if self.others.capacity() < self.d {
            (self.other, self.others) = (Factor::new(self.d)?, try_room(WHAT, self.d)?);
        }
        block((&self.h, self.ld), held, &mut self.others, Some(diagonal), &mut self.other, stop)
    }

    fn newton(&mut self, v: &mut [f64]) {
        solve_block(&self.other, &self.others, &mut self.work, v);
    }

    fn dual_norm(&mut self, held: &[i8], e: &[f64], stop: &Stop) -> Result<f64> {
        let by_inverse = !self.inverse.is_empty() && held.iter().all(|held| *held == 0);
        if !by_inverse && !self.whole {
            let zeros = try_zeros(WHAT, self.d)?;
            self.whole = self.barrier(held, &zeros, stop)?;
        }
        if !by_inverse && !self.whole {
            return Ok(if e.iter().all(|e| *e == 0.0) { 0.0 } else { f64::INFINITY });
        }
        let mut v = std::mem::take(&mut self.third);
        v[..self.d].copy_from_slice(e);
        if by_inverse {
            times(&self.inverse, &v, false, &mut self.second);
            v.copy_from_slice(&self.second);
        } else {
            self.newton(&mut v[..self.d]);
        }
        let squared: f64 = e.iter().zip(&v).map(|(e, v)| e * v).sum();
        self.third = v;
        Ok(squared.abs())
    }

    fn guess(&mut self, bounds: Bounds<'_>, held: &[i8], u: &mut [f64], _: &Stop) -> Result<()> {
        let (ld, h, g) = (self.ld, &self.h, &mut self.second);
        g.iter_mut().zip(&self.f).for_each(|(g, f)| *g = -f);
        add_lines(h, ld, u.iter().copied().enumerate().filter(|(_, u)| *u != 0.0), g);
        descend(h, &self.curvature, held, bounds, SWEEPS, u, g);
        Ok(())
    }
}

/// Factors the block of `h` of the inputs with `held = 0`, which `free` lists, plus `diagonal`.
fn block(
    (h, ld): (&[f64], usize),
    held: &[i8],
    free: &mut Vec<usize>,
    diagonal: Option<&[f64]>,
    factor: &mut Factor,
    stop: &Stop,
) -> Result<bool> {
    free.clear();
    free.extend((0..held.len()).filter(|&i| held[i] == 0));
    let whole = free.len() == held.len();
    let column = |j: usize, to: &mut [f64]| {
        let line = &h[free[j] * ld..(free[j] + 1) * ld];
        if whole {
            to.copy_from_slice(&line[j..free.len()]);
        } else {
            to.iter_mut().zip(&free[j..]).for_each(|(to, &i)| *to = line[i]);
        }
        if let Some(diagonal) = diagonal {
            to[0] += diagonal[free[j]];
        }
    };
    factor.set(free.len(), column, stop)
}

/// `v <- A^{-1} v` on the inputs `free` of the factor, 0 elsewhere.
fn solve_block(factor: &Factor, free: &[usize], work: &mut [f64], v: &mut [f64]) {
    let work = &mut work[..padded(free.len())];
    work.fill(0.0);
    work.iter_mut().zip(free).for_each(|(to, &i)| *to = v[i]);
    factor.solve(work);
    v.fill(0.0);
    free.iter().zip(work).for_each(|(&i, x)| v[i] = *x);
}
