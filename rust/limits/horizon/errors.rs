//! How far inputs that were computed from estimates are from the best ones of the exact system.

use super::map::{Horizon, WHAT};
use super::solve::ROUNDING;
use super::suboptimality::Apart;
use crate::error::{Error, Result};
use crate::limits::linear::{decomposition, least_eigenvalue, norm, product, singular_values, spectral, times};
use crate::limits::quadratic::Until;
use crate::limits::solve::Solution;
use crate::memory::{try_copy, try_extend, try_zeros};
use crate::scaled;
use crate::vector;

/// What makes the inputs differ from the best ones.
#[derive(Debug)]
pub enum Cause<'a> {
    /// Nothing is random: the error itself.
    Known,
    /// The map is exact and the target moves: `d >= ||P_Q (b^ - b)||_Q`, and `r^(k) - x^(k)` (K, n) of the estimates.
    Target(f64, &'a [f64]),
    /// Bounds of `||G (u - v)||_Q`, `||u - v||_2` and `J(u) - J(v)` that were simulated.
    Drawn([f64; 3]),
    /// The map moves with the system.
    Map(Apart),
}

/// Bounds for the inputs u and the best v: infinite where there is none.
#[derive(Debug, Clone, Copy)]
pub struct Radii {
    /// `||G (u - v)||_Q`
    pub state: f64,
    /// `||u - v||_2`
    pub control: f64,
    /// `J(u) - J(v)`
    pub excess: f64,
    /// `||G v - b||_Q`
    pub missed: f64,
}

impl Horizon {
    /// The least eigenvalue of `H = M'M + R`, 0 where it is not more than rounding.
    ///
    /// # Errors
    /// [`Error::Numerical`], [`Error::Memory`].
    pub fn least(&self) -> Result<f64> {
        let (stacked, d) = (self.stacked()?, self.steps * self.m);
        let s = singular_values(&stacked, d)?;
        let tiny = (stacked.len() / d).max(d) as f64 * f64::EPSILON;
        Ok(match s.get(d - 1) {
            Some(last) if *last > tiny * s[0] => last * last * (1.0 - ROUNDING),
            _ => 0.0,
        })
    }

    /// Bounds of the errors of `given`, inputs within the limits that the estimates gave. The horizon is the exact one.
    ///
    /// # Errors
    /// As [`Self::best`], and [`Error::Interrupted`].
    pub fn error(&self, x0: &[f64], given: &Solution, cause: &Cause<'_>, until: Until<'_>) -> Result<Radii> {
        let best = self.best(x0, false, None, until)?.found;
        until.check()?;
        let (map, state, target, d) = (self.map()?, self.state()?, self.target()?, self.steps * self.m);
        let least = self.least()?;
        let [mut of_state, mut control, mut excess] = match cause {
            Cause::Known => self.known(x0, given, &best, least)?,
            Cause::Target(distance, off) => self.moved(given, *distance, off, least)?,
            Cause::Drawn([state, control, excess]) => {
                [*state, if least > 0.0 { *control } else { f64::INFINITY }, *excess]
            }
            Cause::Map(apart) => [apart.state, apart.control, apart.excess],
        };
        // ||M v - (target - state x0)||
        let (mut left, free) = (times(map, &best.control, d)?, times(&state, x0, self.n)?);
        left.iter_mut().zip(target.iter().zip(&free)).for_each(|(v, (y, x))| *v += x - y);
        let mut missed = norm(&left) + best.distance;
        // rounding of M u for both controls, (rows + columns) eps ||M||_F ||u|| each at most, and of the effect of x0;
        // rounding in A^k B and A^k x0 themselves is not in it
        let rows = self.rows();
        let inputs = norm(&given.control) + norm(&best.control);
        let off = (rows + d) as f64 * f64::EPSILON * product(norm(map), inputs)
            + (rows + self.n) as f64 * f64::EPSILON * product(norm(&state), norm(x0));
        if off > 0.0 {
            of_state += off;
            control += if least > 0.0 { off / least.sqrt() } else { 0.0 };
            excess += product(2.0 * given.objective.sqrt() + off, off);
            missed += off;
        }
        Ok(Radii { state: of_state, control, excess, missed })
    }

    /// The error itself, with what the certificate of `best` may add.
    fn known(&self, x0: &[f64], given: &Solution, best: &Solution, least: f64) -> Result<[f64; 3]> {
        let mut wrong = try_copy(WHAT, &given.control)?;
        wrong.iter_mut().zip(&best.control).for_each(|(u, v)| *u -= v);
        let (cost, least_cost) = (self.objective(x0, &given.control)?, self.objective(x0, &best.control)?);
        let state = vector::norm(&times(self.map()?, &wrong, self.steps * self.m)?) + best.distance;
        let control = if least > 0.0 { norm(&wrong) + best.distance / least.sqrt() } else { f64::INFINITY };
        Ok([state, control, (cost - least_cost).max(0.0) + best.gap + ROUNDING * cost])
    }

    /// `||du||_H <= d` and `||du||_R <= d / 2` for `d = ||P_Q (b^ - b)||_Q`.
    ///
    /// The inequalities of the two best controls, each tested at the other, add up to
    /// `||B du||_Q^2 + ||du||_R^2 <= <B du, b^ - b>_Q`.
    fn moved(&self, given: &Solution, moved: f64, off: &[f64], least: f64) -> Result<[f64; 3]> {
        let mut control = if least > 0.0 { (moved + given.distance) / least.sqrt() } else { f64::INFINITY };
        let least_r = least_eigenvalue(&self.r, self.m)?;
        if least_r > 0.0 {
            control = control.min((moved / 2.0 + given.distance) / least_r.sqrt());
        }
        if self.boxed() {
            control = control.min(self.inside(given, moved, off)?);
        }
        Ok([moved + given.distance, control, product(moved, moved) + given.gap])
    }

    /// Where no limit comes into play for any b within `d`, `u = L b`: `||L|| d`.
    ///
    /// `L = H^+ M' = [M; R^(1/2)]^+ [I; 0]`: in H a small R would be lost beside a large M.
    fn inside(&self, given: &Solution, mut distance: f64, off: &[f64]) -> Result<f64> {
        let d = self.steps * self.m;
        let (map, found) = (self.map()?, decomposition(&self.stacked()?, d)?);
        let (rows, rank) = (self.rows(), found.s.len());
        let height = found.u.len().checked_div(rank).unwrap_or(0);
        if let Some(last) = found.s.last() {
            distance *= 1.0 + found.tiny / last; // what rounding may add to L
        }
        // b^ = (b^ - M u) + M u
        let mut b = times(map, &given.control, d)?;
        b.iter_mut().zip(self.weighted(off)?).for_each(|(b, off)| *b += off);
        // L = sum_k v_k u_k' / s_k
        let mut operator = try_zeros(WHAT, crate::memory::checked_len(WHAT, d, rows)?)?;
        for k in 0..rank {
            let u = &found.u[k * height..][..rows];
            for (v, line) in found.v[k * d..(k + 1) * d].iter().zip(operator.chunks_exact_mut(rows.max(1))) {
                vector::axpy(v / found.s[k], u, line);
            }
        }
        let mut wrong = try_zeros(WHAT, d)?;
        for (i, wrong) in wrong.iter_mut().enumerate() {
            let line = &operator[i * rows..(i + 1) * rows];
            let (free, reach) = (vector::dot(line, &b), vector::norm(line) * distance);
            if !(free - reach >= self.task.low[i] && free + reach <= self.task.high[i]) {
                return Ok(f64::INFINITY);
            }
            *wrong = given.control[i] - free;
        }
        Ok(norm(&wrong) + spectral(&operator, rows)? * distance)
    }

    /// `||G w - (b^ - ...)||_Q` along states `x^(0) .. x^(K)` that were computed with another `A`, at most:
    /// `||x(k) - x^(k)|| <= ||A^k|| e0 + eA sum_j ||A^(k-1-j)|| ||x^(j)||`, and `ef` for the target.
    ///
    /// # Errors
    /// As [`Self::powers`].
    pub fn along(&self, states: &[f64], [e0, ef, ea]: [f64; 3]) -> Result<f64> {
        let norms = self.power_norms()?;
        let mut sizes = Vec::new();
        try_extend(WHAT, &mut sizes, states.chunks_exact(self.n).map(norm))?;
        let mut squares = 0.0;
        for (k, weight) in self.weights(true)?.iter().enumerate() {
            let sum: f64 = norms[..=k].iter().rev().zip(&sizes).map(|(a, x)| a * x).sum();
            squares += product(*weight, (product(norms[k + 1], e0) + product(ea, sum)).powi(2));
        }
        Ok(squares.sqrt() + product(self.weights(false)?.iter().sum::<f64>().sqrt(), ef))
    }

    /// A bound of `||P_Q (b^ - b)||_Q` from bounds of the errors of `x0`, `xf` and `A`; over several steps `A` is
    /// exact. With soft limits of `||dc||_W + ||dr||_Q`. `estimate`: `A^` and `x0^`.
    ///
    /// # Errors
    /// As [`Self::powers`].
    pub fn moved_target(&self, [e0, ef, ea]: [f64; 3], estimate: [&[f64]; 2]) -> Result<f64> {
        let goal = product(self.weights(false)?.iter().sum::<f64>().sqrt(), ef);
        let [a, x0] = estimate;
        if self.steps == 1 {
            let moved = product(spectral(a, self.n)?, e0) + product(ea, norm(x0) + e0);
            return Ok(goal + product(self.weights(true)?[0].sqrt(), moved));
        }
        Ok(goal + product(spectral(&self.curved_state(self.powers()?)?, self.n)?, e0))
    }

    /// `W_k^(1/2) P_k` below each other, of `P_1 ..`, given from `P_0` on.
    pub(super) fn curved_state(&self, powers: &[f64]) -> Result<Vec<f64>> {
        let (mut tall, square) = (Vec::new(), self.n * self.n);
        for (k, power) in powers.chunks_exact(square).skip(1).enumerate() {
            let root = crate::limits::linear::root(&self.curvature(k, true)?, self.n)?;
            try_extend(WHAT, &mut tall, times(&root, power, self.n)?)?;
        }
        Ok(tall)
    }
}

/// `||M (u - v)||`, `||u - v||_2` and `J(u) - J(v)` with the exact M, y and R of `v`.
pub(super) fn measured(map: &[f64], y: &[f64], r: (&[f64], bool), u: &[f64], v: &[f64]) -> Result<[f64; 3]> {
    let d = u.len();
    let mut wrong = try_copy(WHAT, u)?;
    wrong.iter_mut().zip(v).for_each(|(u, v)| *u -= v);
    let (shift, mut residual) = (times(map, &wrong, d)?, times(map, v, d)?);
    residual.iter_mut().zip(y).for_each(|(m, y)| *m -= y);
    let mut slope = try_zeros(WHAT, d)?;
    crate::limits::linear::add_transposed(map, &residual, &mut slope);
    let (r, diagonal) = r;
    let mut cost = 0.0;
    for i in 0..d {
        let of = |v: &[f64]| if diagonal { r[i] * v[i] } else { vector::dot(&r[i * d..(i + 1) * d], v) };
        slope[i] += of(v);
        cost += wrong[i] * of(&wrong);
    }
    let squares = vector::dot(&shift, &shift);
    let excess = (2.0 * vector::dot(&slope, &wrong) + squares + cost).max(0.0);
    let control = scaled::norm(wrong.iter().copied());
    let found = [squares.sqrt(), control, excess];
    if found.iter().all(|v| v.is_finite()) { Ok(found) } else { Err(Error::Overflow { what: "a simulated error" }) }
}
