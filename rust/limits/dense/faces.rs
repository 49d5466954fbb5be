//! What pivoting and the interior point ask of [`Dense`].

use super::{Dense, ILL, WHAT};
use crate::error::Result;
use crate::limits::bounds::Bounds;
use crate::limits::factor::Factor;
use crate::limits::kernel::{add_gradient, add_lines, add_transposed, combined, descend, padded};
use crate::limits::quadratic::{Quadratic, Until};
use crate::limits::search::NEGLIGIBLE;
use crate::memory::{checked_len, try_copy, try_extend, try_filled, try_room, try_zeros};
use crate::vector;

/// Inputs from which the inverse of `H` is worth its cost.
const SMALL: usize = 16;
/// Inputs up to which the inverse, which cannot be interrupted, takes a second at most.
const LARGE: usize = 1500;
/// Condition of `H` up to which solutions are combined: a combination is rounded by about 1e-16 times it.
const PLAIN: f64 = 1e5;
/// Most sweeps of coordinate descent that guess which limits are reached.
const SWEEPS: usize = 4;

impl Dense {
    /// Memory for what is asked for at its first use.
    pub(crate) fn reserve(&mut self) -> Result<()> {
        if (SMALL..=LARGE).contains(&self.d) {
            (self.inverse, self.spare) = (try_zeros(WHAT, self.h.len())?, try_zeros(WHAT, self.h.len())?);
        }
        (self.centre, self.none) = (try_room(WHAT, self.ld)?, try_zeros(WHAT, self.d)?);
        self.beside()
    }

    /// The second factor.
    fn beside(&mut self) -> Result<()> {
        if self.others.capacity() < self.d {
            (self.other, self.others) = (Factor::new(self.d)?, try_room(WHAT, self.d)?);
        }
        Ok(())
    }

    /// `M'y_j` and `H^{-1} M'y_j` of as many `y_j`, which `column` gives, each in a line. None where the second would
    /// be less exact than a solution.
    pub(crate) fn lines(
        &mut self,
        count: usize,
        column: impl Fn(usize, &mut [f64]),
        until: Until<'_>,
    ) -> Result<[Vec<f64>; 2]> {
        self.prepare(until)?;
        let (ld, all) = (self.ld, try_filled(WHAT, 0, self.d)?);
        let whole = block((&self.h, ld), &all, &mut self.free, None, &mut self.factor, until)?;
        self.unlimited = whole && self.factor.condition() <= PLAIN;
        if !self.unlimited {
            return Ok(<[Vec<f64>; 2]>::default());
        }
        let mut pulls = try_zeros(WHAT, checked_len(WHAT, count, ld)?)?;
        for (j, line) in pulls.chunks_exact_mut(ld).enumerate() {
            column(j, &mut self.residual);
            add_transposed(&self.m, &self.residual, self.triangular, line);
        }
        let mut centres = try_copy(WHAT, &pulls)?;
        centres.chunks_exact_mut(ld).for_each(|line| self.factor.solve(line));
        Ok([pulls, centres])
    }

    /// Takes `y = sum_j z_j y_j` by their lines.
    pub(crate) fn combine(&mut self, [pulls, centres]: &[Vec<f64>; 2], y: &[f64], z: &[f64]) -> Result<()> {
        combined(pulls, z, &mut self.f);
        if self.centre.is_empty() {
            try_extend(WHAT, &mut self.centre, std::iter::repeat_n(0.0, self.ld))?;
        }
        combined(centres, z, &mut self.centre);
        self.aimed(y)
    }

    /// `v <- H_FF^{-1} v` by the factor of the block.
    fn solve_block(&mut self, v: &mut [f64]) {
        solve_block(&self.factor, &self.free, &mut self.work, v);
    }

    /// `v <- v - (H^{-1})_{:W} ((H^{-1})_{WW})^{-1} (v_W - b)`: of `v = H^{-1} f` the solution of `H u = f - lambda`
    /// with `u_W = b`; `free` names `W` here.
    fn limit(&mut self, v: &mut [f64], b: impl Fn(usize) -> f64) {
        let (ld, limits) = (self.ld, &self.free);
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

    fn prepare(&mut self, until: Until<'_>) -> Result<()> {
        if self.prepared { Ok(()) } else { self.square(until) }
    }

    fn curvature(&self) -> &[f64] {
        &self.curvature
    }

    fn scale(&self) -> f64 {
        self.zero
    }

    fn face(&mut self, held: &[i8], u: &mut [f64], until: Until<'_>) -> Result<bool> {
        let (d, ld) = (self.d, self.ld);
        let limits = held.iter().filter(|held| **held != 0).count();
        self.faces += 1;
        let again = self.unlimited && limits == 0; // the last face was the same
        if again && !self.centre.is_empty() {
            (self.by_inverse, self.ill) = (false, false);
            u.copy_from_slice(&self.centre[..d]);
            return Ok(true);
        }
        let due = (SMALL..=LARGE).contains(&d) && !self.tried && self.faces > 1 + usize::from(!self.unlimited);
        if due && !again && 2 * limits <= d {
            self.invert(until)?;
        }
        self.unlimited = again && !self.inverted;
        if self.inverted && 2 * limits <= d {
            self.by_inverse = true;
            self.ill = false;
            self.free.clear();
            self.free.extend((0..d).filter(|&i| held[i] != 0));
            let (limits, inverse) = (&self.free, &self.inverse);
            let column = |j: usize, to: &mut [f64]| {
                to.iter_mut().zip(&limits[j..]).for_each(|(to, &i)| *to = inverse[limits[j] * ld + i]);
            };
            if !self.factor.set(limits.len(), column, until)? {
                return Ok(false);
            }
            if self.centre.is_empty() {
                try_extend(WHAT, &mut self.centre, std::iter::repeat_n(0.0, ld))?;
                combined(&self.inverse, &self.f, &mut self.centre);
            }
            let mut v = std::mem::take(&mut self.third);
            v.copy_from_slice(&self.centre);
            self.limit(&mut v[..d], |i| u[i]);
            u.copy_from_slice(&v[..d]);
            self.third = v;
            return Ok(true);
        }
        self.by_inverse = false;
        if !self.unlimited && !block((&self.h, ld), held, &mut self.free, None, &mut self.factor, until)? {
            return Ok(false);
        }
        self.unlimited = limits == 0;
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
            combined(&self.inverse, v, &mut self.second);
            v.copy_from_slice(&self.second[..v.len()]);
            self.limit(v, |_| 0.0);
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
        } else if self.unlimited {
            g.fill(0.0);
        } else {
            // g = H u - f
            combined(&self.h, u, &mut self.second);
            g.iter_mut().zip(self.second.iter().zip(&self.f)).for_each(|(g, (of, f))| *g = of - f);
        }
        u.iter().zip(&*g).zip(&self.f).map(|((u, g), f)| u * (g + f)).sum()
    }

    fn slope(&mut self, u: &[f64], g: &mut [f64]) -> f64 {
        let (work, slope) = (&mut self.work, &mut self.second);
        work[..u.len()].copy_from_slice(u);
        work[u.len()..].fill(0.0);
        let of_inputs: f64 = u.iter().zip(&self.r).map(|(u, r)| r * u * u).sum();
        // g = M'(M u - y) + R u
        slope.iter_mut().zip(&*work).zip(&self.r).for_each(|((to, u), r)| *to = r * u);
        add_gradient(&self.m, work, &self.y, self.triangular, &mut self.residual, slope);
        g.copy_from_slice(&slope[..g.len()]);
        vector::dot(&self.residual, &self.residual) + of_inputs + self.rest
    }

    fn barrier(&mut self, held: &[i8], diagonal: &[f64], until: Until<'_>) -> Result<bool> {
        self.whole = false;
        self.beside()?;
        block((&self.h, self.ld), held, &mut self.others, Some(diagonal), &mut self.other, until)
    }

    fn newton(&mut self, v: &mut [f64]) {
        solve_block(&self.other, &self.others, &mut self.work, v);
    }

    fn dual_at_hand(&self, held: &[i8]) -> bool {
        (self.inverted || self.unlimited) && held.iter().all(|held| *held == 0)
    }

    fn dual_norm(&mut self, held: &[i8], e: &[f64], until: Until<'_>) -> Result<f64> {
        let all = held.iter().all(|held| *held == 0);
        // H >= min R, and H^{-1} <= its norm, but for the rounding of an inverse that is kept
        let root = if self.inverted { self.size.min(1.0 / self.least) } else { 1.0 / self.least };
        let most = 1.001 * root * vector::dot(e, e);
        if most <= NEGLIGIBLE * self.zero {
            return Ok(most);
        }
        let (by_inverse, by_face) = (self.inverted && all, self.unlimited && all);
        if !by_inverse && !by_face && !self.whole {
            let zeros = if self.none.is_empty() { try_zeros(WHAT, self.d)? } else { std::mem::take(&mut self.none) };
            let whole = self.barrier(held, &zeros, until);
            self.none = zeros;
            self.whole = whole?;
        }
        if !by_inverse && !by_face && !self.whole {
            return Ok(if e.iter().all(|e| *e == 0.0) { 0.0 } else { f64::INFINITY });
        }
        let mut v = std::mem::take(&mut self.third);
        v[..self.d].copy_from_slice(e);
        if by_inverse {
            combined(&self.inverse, e, &mut v);
        } else if by_face {
            self.solve_block(&mut v[..self.d]);
        } else {
            self.newton(&mut v[..self.d]);
        }
        let squared: f64 = e.iter().zip(&v).map(|(e, v)| e * v).sum();
        self.third = v;
        Ok(squared.abs())
    }

    fn guess(&mut self, bounds: Bounds<'_>, held: &[i8], u: &mut [f64], _: Until<'_>) -> Result<()> {
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
    until: Until<'_>,
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
    factor.set(free.len(), column, until)
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
