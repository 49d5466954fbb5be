//! What an uncertain `A` and `B` do to the best inputs within limits.
//!
//! `(G, b)` is the true problem, `(G^, b^)` that of the horizon, with the same limits, `Q` and `R`; u is the best of
//! the true one, w a point within the limits. With `alpha >= ||(G - G^) w - (b - b^)||_Q`,
//! `c = (G - G^)' Q (G^ w - b^)`, `gamma >= ||c||_{R^-1}` and `gap >= <J^'(w), w - v>` for all v within the limits, the
//! inequality of u, tested at w, is `p^2 + q^2 <= alpha p + gamma q + gap / 2` for `p = ||G (w - u)||_Q` and
//! `q = ||w - u||_R`: a disc. `J(w) - J(u) = <J'(w), w - u> - p^2 - q^2` is largest at `(alpha, gamma)`. Soft limits of
//! states add `soft C'C` to `Q` in alpha, and their force to `Q (G^ w - b^)`.

use super::map::{Horizon, WHAT};
use super::solve::ROUNDING;
use crate::error::{Error, Result};
use crate::limits::linear::{add_transposed, form, least_eigenvalue, norm, product, singular_values, spectral, times};
use crate::memory::{try_collect, try_copy, try_room, try_zeros};
use crate::region::Region;

/// How far w is from u: infinite where there is no bound.
#[derive(Debug, Clone, Copy)]
pub struct Apart {
    /// `||G (w - u)||_Q`
    pub state: f64,
    /// `||w - u||_R`
    pub weighted: f64,
    /// `(||G (w - u)||_Q^2 + ||w - u||_R^2)^(1/2)`
    pub distance: f64,
    /// `||w - u||_2`
    pub control: f64,
    /// `J(w) - J(u)`
    pub excess: f64,
}

/// Where the true `A` and `B` of a region are around those of a horizon: `A - A^` is a shift and a D of the region.
struct Around<'a> {
    region: &'a Region,
    /// `C - (A^, B^)` (n, n) and (n, m), with the centre C.
    shifts: [Vec<f64>; 2],
    /// Bounds of `||A - A^||` and `||B - B^||`.
    radii: [f64; 2],
    /// `sup ||v||_(V^-1)` over `||v||_2 = 1` in the columns of `A` and of `B`, for each part.
    lengths: Vec<[f64; 2]>,
}

impl<'a> Around<'a> {
    fn new(region: &'a Region, horizon: &Horizon) -> Result<Self> {
        let (n, m, d) = (region.n, region.m, region.d);
        if (n, m) != (horizon.n, horizon.m) {
            let found = format!("{n} and {m}");
            return Err(Error::Shape { name: "region", expected: format!("n={}, m={}", horizon.n, horizon.m), found });
        }
        let (mut shifts, mut radii) = ([try_copy(WHAT, &horizon.a)?, try_copy(WHAT, &horizon.b)?], [0.0; 2]);
        let columns = [(0, n), (n, n + m)];
        for ((shift, radius), (from, to)) in shifts.iter_mut().zip(&mut radii).zip(columns) {
            for (row, centre) in shift.chunks_exact_mut(to - from).zip(region.centre.chunks_exact(d)) {
                row.iter_mut().zip(&centre[from..to]).for_each(|(own, centre)| *own = centre - *own);
            }
            *radius = region.spread(from, to)? + spectral(shift, to - from)?;
        }
        let mut lengths = try_room(WHAT, region.parts.len())?;
        for part in &region.parts {
            lengths.push([part.reach(0, n)?, part.reach(n, n + m)?]);
        }
        Ok(Self { region, shifts, radii, lengths })
    }

    /// Bounds of `||(A - A^)' p||` and `||(B - B^)' p||`: `||D' p|| <= sum (factor p' S p)^(1/2) length` over the
    /// parts.
    fn along(&self, p: &[f64]) -> Result<[f64; 2]> {
        let mut found = [0.0; 2];
        for ((found, shift), columns) in found.iter_mut().zip(&self.shifts).zip([self.region.n, self.region.m]) {
            let mut image = try_zeros(WHAT, columns)?;
            add_transposed(shift, p, &mut image);
            *found = norm(&image);
        }
        for (part, lengths) in self.region.parts.iter().zip(&self.lengths) {
            let inside = try_collect(WHAT, part.rows.iter().map(|&i| p[i]))?;
            let size = product(part.factor.sqrt(), form(&part.shape, &inside).max(0.0).sqrt());
            found.iter_mut().zip(lengths).for_each(|(found, length)| *found += product(size, *length));
        }
        Ok(found)
    }
}

/// `size / sqrt(least)`, infinite over 0.
pub(super) fn over(size: f64, least: f64) -> f64 {
    if size == 0.0 {
        0.0
    } else if least > 0.0 {
        size / least.sqrt()
    } else {
        f64::INFINITY
    }
}

/// Half of the gradient of J, and what it consists of.
struct Forces {
    /// `p_k` (K, n): `p_K = f_K`, `p_k = A'p_(k+1) + f_k` of `f_k = Q_k (x(k) - r(k))` with the force of soft limits.
    costates: Vec<f64>,
    /// `B'p_(k+1) + R u(k)` (K, m).
    slope: Vec<f64>,
    objective: f64,
}

impl Horizon {
    /// Weights of the state k < K, and of the state K.
    fn weight(&self, k: usize) -> &[f64] {
        if k + 1 == self.steps { &self.task.terminal } else { &self.task.stage }
    }

    /// `Q_k` (n, n); with `soft` what bounds the curvature with soft limits.
    pub(super) fn curvature(&self, k: usize, soft: bool) -> Result<Vec<f64>> {
        let mut weight = try_copy(WHAT, self.weight(k))?;
        if let (true, Some(size), Some((low, high))) = (soft, self.task.soft, &self.task.states) {
            for i in 0..self.n {
                if low[k * self.n + i].is_finite() || high[k * self.n + i].is_finite() {
                    weight[i * self.n + i] += size;
                }
            }
        }
        Ok(weight)
    }

    /// `||Q_1||_2 .. ||Q_K||_2`; with `soft` of what bounds the curvature with soft limits.
    ///
    /// # Errors
    /// [`crate::Error::Numerical`], [`crate::Error::Memory`].
    pub fn weights(&self, soft: bool) -> Result<Vec<f64>> {
        let mut sizes = try_zeros(WHAT, self.steps)?;
        let varying = soft && self.task.soft.is_some() && self.task.states.is_some();
        for k in 0..self.steps {
            sizes[k] = match k {
                0 => spectral(&self.curvature(0, soft)?, self.n)?,
                _ if !varying && k + 1 < self.steps => sizes[0],
                _ => spectral(&self.curvature(k, soft)?, self.n)?,
            };
        }
        Ok(sizes)
    }

    /// The largest distance of `u` from inputs within the limits of single inputs.
    pub fn farthest(&self, u: &[f64]) -> f64 {
        let reach = u.iter().zip(self.task.low.iter().zip(&self.task.high)).map(|(u, (l, h))| (h - u).max(u - l));
        crate::scaled::norm(reach)
    }

    fn forces(&self, states: &[f64], u: &[f64]) -> Result<Forces> {
        let (n, m) = (self.n, self.m);
        let mut costates = try_zeros(WHAT, states.len())?;
        let mut objective: f64 = u.chunks_exact(m).map(|u| form(&self.r, u)).sum();
        for (k, force) in costates.chunks_exact_mut(n).enumerate() {
            let mut off = try_copy(WHAT, &states[k * n..(k + 1) * n])?;
            off.iter_mut().zip(&self.task.reference[k * n..]).for_each(|(x, r)| *x -= r);
            add_transposed(self.weight(k), &off, force); // Q_k is symmetric
            objective += off.iter().zip(&*force).map(|(off, force)| off * force).sum::<f64>();
        }
        if let (Some(soft), Some((low, high))) = (self.task.soft, &self.task.states) {
            for (i, force) in costates.iter_mut().enumerate() {
                let over = (states[i] - high[i]).max(0.0) - (low[i] - states[i]).max(0.0);
                *force += soft * over;
                objective += soft * over * over;
            }
        }
        for k in (1..self.steps).rev() {
            let (before, after) = costates.split_at_mut(k * n);
            add_transposed(&self.a, &after[..n], &mut before[(k - 1) * n..]);
        }
        let mut slope = try_zeros(WHAT, u.len())?;
        for ((slope, p), u) in slope.chunks_exact_mut(m).zip(costates.chunks_exact(n)).zip(u.chunks_exact(m)) {
            add_transposed(&self.b, p, slope);
            add_transposed(&self.r, u, slope);
        }
        Ok(Forces { costates, slope, objective })
    }

    /// A Frank-Wolfe gap over the limits, and the norm of what no limit balances of `slope`.
    ///
    /// With limits of rates or hard ones of states `<J'(w), w - v> <= 2 max(sqrt(gap) reach, gap)` for
    /// `gap >= J(w) - min J` and `reach >= ||w - v||_H`, from `J(w + t (v - w)) >= J(w) - gap` at the best t.
    fn balanced(&self, sizes: &[f64], slope: &[f64], u: &[f64], gap: f64) -> (f64, f64) {
        let (m, task) = (self.m, &self.task);
        if task.rate.is_none() && (task.states.is_none() || task.soft.is_some()) {
            let (mut sum, mut rest) = (0.0, 0.0f64);
            for (i, (slope, u)) in slope.iter().zip(u).enumerate() {
                let side = if *slope > 0.0 { task.low[i] } else { task.high[i] };
                if side.is_finite() {
                    sum += (slope * (u - side)).max(0.0);
                } else {
                    rest = rest.hypot(*slope);
                }
            }
            return (2.0 * sum, rest);
        }
        if gap == 0.0 {
            return (0.0, 0.0);
        }
        let mut reach = 0.0;
        for i in 0..u.len() {
            // ||G e_i||_Q^2 <= sum_k ||Q_k|| ||A^(k-1-j) B e_i||^2 for the input of step j
            let (j, input) = (i / m, i % m);
            let mut square = self.r[input * (m + 1)];
            for (push, size) in self.pushes.chunks_exact(self.n * m).zip(&sizes[j..]) {
                square += size * push.iter().skip(input).step_by(m).map(|v| v * v).sum::<f64>();
            }
            reach += product(task.high[i] - task.low[i], square.sqrt());
        }
        (2.0 * product(gap.sqrt(), reach).max(gap), 0.0)
    }

    /// A Frank-Wolfe gap of `u` under which the states are these, and the norm of what no limit balances of half of the
    /// gradient; `gap` bounds `J(u) - min J`.
    ///
    /// # Errors
    /// As [`Self::weights`].
    pub fn optimality(&self, states: &[f64], u: &[f64], gap: f64) -> Result<(f64, f64)> {
        let slope = self.forces(states, u)?.slope;
        Ok(self.balanced(&self.weights(true)?, &slope, u, gap))
    }

    /// A bound of `||c||_2`: block k of c is `B'p_(k+1) - B^'p^_(k+1)`.
    ///
    /// `d_k >= ||p_k - p^_k||`: `d_K = 0`, `d_k = (||A^|| + a) d_(k+1) + a(p^_(k+1))`, and
    /// `||c_k|| <= (||B^|| + b) d_(k+1) + b(p^_(k+1))`.
    fn costate_errors(&self, around: &Around<'_>, costates: &[f64], [norm_a, norm_b]: [f64; 2]) -> Result<f64> {
        let (mut delta, mut total) = (0.0, 0.0f64);
        for p in costates.rchunks_exact(self.n) {
            let [along_a, along_b] = around.along(p)?;
            total = total.hypot(product(norm_b + around.radii[1], delta) + along_b);
            delta = product(norm_a + around.radii[0], delta) + along_a;
        }
        Ok(total)
    }

    /// A bound of `||Q^(1/2) (G - G^)||`, with `sizes = ||Q_1|| .. ||Q_K||`.
    ///
    /// `E_p >= ||A^p - A^^p||`: `E_(p+1) = (||A^|| + a) E_p + a ||A^^p||`, and
    /// `||A^p B - A^^p B^|| <= E_p (||B^|| + b) + ||A^^p|| b`; then the Frobenius norm of the norms of the blocks.
    ///
    /// # Errors
    /// As [`Self::powers`].
    pub fn map_radius(&self, [a, b]: [f64; 2], sizes: &[f64]) -> Result<f64> {
        let norms = self.power_norms()?;
        let (norm_a, norm_b) = (norms[1], spectral(&self.b, self.m)?);
        let (mut error, mut blocks, mut sum) = (0.0, 0.0, 0.0);
        for (power, size) in norms.iter().zip(sizes) {
            let block = product(error, norm_b + b) + product(*power, b);
            blocks += block * block;
            error = product(norm_a + a, error) + product(*power, a);
            sum += product(*size, blocks);
        }
        Ok(sum.sqrt())
    }

    /// `||A^0||_2 .. ||A^K||_2`
    pub(super) fn power_norms(&self) -> Result<Vec<f64>> {
        let mut norms = try_zeros(WHAT, self.steps + 1)?;
        for (norm, power) in norms.iter_mut().zip(self.powers()?.chunks_exact(self.n * self.n)) {
            *norm = spectral(power, self.n)?;
        }
        Ok(norms)
    }

    /// `alpha` of the head of this file for a `tube` (K) around the states: `(sum_k ||Q_k|| tube_k^2)^(1/2)`.
    ///
    /// With `sure`, the state before the first of one step: at most
    /// `||F D z|| <= (factor ||F S F'||)^(1/2) ||z||_(V^-1)` too, `F'F = Q`, D of one part, with the shift of the
    /// centre.
    ///
    /// # Errors
    /// As [`Self::weights`]; [`Error::Shape`].
    pub fn alpha(&self, region: &Region, tube: &[f64], states: &[f64], u: &[f64], sure: Option<&[f64]>) -> Result<f64> {
        let sizes = self.weights(true)?;
        let alpha = sizes.iter().zip(tube).map(|(size, radius)| product(*size, radius * radius)).sum::<f64>().sqrt();
        let (Some(x0), [part]) = (sure, region.parts.as_slice()) else {
            return Ok(alpha);
        };
        let (n, root, z) = (self.n, self.roots()[1], region.regressor(x0, u)?);
        let centre = times(&region.centre, &z, region.d)?;
        let off = try_collect(WHAT, centre.iter().zip(states).map(|(centre, state)| centre - state))?;
        // F of the rows of the part, and F S F'
        let rows = root.chunks_exact(n);
        let inside = try_collect(WHAT, rows.flat_map(|row| part.rows.iter().map(|&i| row[i])))?;
        let (k, among) = (root.len() / n, part.rows.len());
        let mut turned = try_zeros(WHAT, k * among)?;
        for (to, row) in turned.chunks_exact_mut(among).zip(inside.chunks_exact(among)) {
            add_transposed(&part.shape, row, to); // S is symmetric
        }
        let mut shape = try_zeros(WHAT, k * k)?;
        for (to, row) in shape.chunks_exact_mut(k).zip(turned.chunks_exact(among)) {
            let products = inside.chunks_exact(among).map(|other| row.iter().zip(other).map(|(a, b)| a * b).sum());
            to.iter_mut().zip(products).for_each(|(to, product): (&mut f64, f64)| *to = product);
        }
        let size = (part.factor * spectral(&shape, k)?).sqrt();
        Ok(alpha.min(norm(&times(root, &off, n)?) + product(size, part.length(&z))))
    }

    /// How far `u`, under which the horizon has these states (K, n), is from the best inputs of any system of the
    /// region; `alpha` is that of the head of this file, `gap` bounds `J(u) - min J` of the horizon.
    ///
    /// # Errors
    /// As [`Self::powers`]; [`Error::Shape`].
    pub fn apart(&self, region: &Region, states: &[f64], u: &[f64], alpha: f64, gap: f64) -> Result<Apart> {
        let (around, sizes) = (Around::new(region, self)?, self.weights(true)?);
        let at = self.forces(states, u)?;
        let (gap, unbalanced) = self.balanced(&sizes, &at.slope, u, gap);
        let norms = [spectral(&self.a, self.n)?, spectral(&self.b, self.m)?];
        let c = self.costate_errors(&around, &at.costates, norms)? + unbalanced;
        let least_r = least_eigenvalue(&self.r, self.m)?.max(0.0);
        let gamma = over(c, least_r);
        let (h, slack) = (alpha.hypot(gamma), (2.0 * gap).sqrt());
        let rho = h.hypot(slack);
        // ||v||_H^2 >= least ||v||^2 for the true H, without soft limits: s_min(Q^1/2 G) >= s_min(Q^1/2 G^) - ||Q^1/2
        // (G - G^)||
        let (radius, d) = (self.map_radius(around.radii, &sizes)?, self.steps * self.m);
        let s = singular_values(self.map()?, d)?;
        let smallest = s.get(d - 1).map_or(0.0, |last| last - ROUNDING * s[0]);
        let sure = (smallest - radius).max(0.0);
        let least = sure * sure + least_r;
        let e = alpha + over(c, least);
        let small = (e + e.hypot(slack)) / 2.0;
        let (weighted, distance) = (((gamma + rho) / 2.0).min(small), ((h + rho) / 2.0).min(small));
        // N = J^1/2: N(w) <= N^(w) + alpha, N(u) >= N(w) - sqrt(gap) - 2 alpha - ||G - G^|| ||w - u||
        let most = at.objective.sqrt() + alpha;
        let less = gap.sqrt() + 2.0 * alpha + product(radius, self.farthest(u));
        let less = if unbalanced > 0.0 { most } else { less.min(most) };
        let regret = if most.is_finite() { less * (2.0 * most - less) } else { f64::INFINITY };
        Ok(Apart {
            state: ((alpha + rho) / 2.0).min(small),
            weighted,
            distance,
            control: over(weighted, least_r).min(over(distance, least)),
            excess: (h * h + gap).min(e * e + gap).min(regret),
        })
    }
}
