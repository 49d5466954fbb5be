//! A lower bound of the least largest miss, from any vectors: no solver is believed.

use super::held::{Forces, Held};
use super::units::WHAT;
use super::within::Within;
use crate::control::{Pseudoinverse, pseudoinverse};
use crate::error::Result;
use crate::memory::{try_filled, try_room, try_zeros};
use crate::vector::{axpy, dot, norm};

/// Where the projection leaves a smaller share of the vectors, what is left is rounding, and no bound follows. Rounding
/// of the projected vectors is about `eps` of the whole, so that 1e-6 leaves ten digits.
const LEFT: f64 = 1e-6;
/// What no vector balances of a force, relative, is rounding up to this.
const BALANCED: f64 = 1e-12;
/// Halvings of the scale of the vectors.
const HALVINGS: usize = 100;

/// The units and limits that were solved for.
pub(super) struct Dual<'a> {
    /// `M_w`, `(count * rows, d)`
    pub(super) maps: &'a [f64],
    /// `t_w`, `count * rows`
    pub(super) targets: &'a [f64],
    pub(super) rows: usize,
    pub(super) within: &'a Within<'a>,
    pub(super) held: &'a [Held],
}

impl Dual<'_> {
    /// A lower bound of `max_w (||M_w u - t_w||^2 + ||u||_R^2)^{1/2}` over the limits, `R = diag(r) + F'F`, from
    /// vectors `v_w` and, behind them, `c` with an entry for each row of F, and from forces `l >= 0` of the limits
    /// `C u <= k` of states and changes; and the shares `||v_w|| / sum ||v_w||`.
    ///
    /// With `a = sum ||v_w||` the square is at least
    /// `2 a max ||M_w u - t_w|| - a^2 + 2 c'F u - |c|^2 + sum_i r_i u_i^2 + 2 l'(C u - k)`, so at least
    /// `-a^2 - |c|^2 - 2 sum v_w't_w - 2 l'k + sum_i min (r_i u_i^2 + 2 g_i u_i)` with `g = sum M_w'v_w + F'c + C'l`
    /// and the minima over the limits of single inputs. Where `r_i` is 0 and g points to an infinite limit it must be
    /// 0: the vectors are corrected there first. Then all are scaled to the largest bound.
    pub(super) fn lower_bound(&self, vectors: &mut [f64], forces: &Forces) -> Result<(f64, Vec<f64>)> {
        let Within { low, high, diagonal, cost, .. } = self.within;
        let (d, units) = (low.len(), self.targets.len());
        let size = |vectors: &[f64]| -> f64 {
            let (own, others) = vectors.split_at(units);
            own.chunks_exact(self.rows).map(norm).sum::<f64>().hypot(norm(others))
        };
        let whole = size(vectors);
        let mut open = try_filled(WHAT, false, d)?;
        let mut g = try_zeros(WHAT, d)?;
        let mut pushed;
        let pull = |vectors: &[f64], g: &mut [f64]| {
            g.fill(0.0);
            for (v, row) in vectors.iter().zip(self.maps.chunks_exact(d).chain(cost.chunks_exact(d))) {
                axpy(*v, row, g);
            }
            forces.pull(self.held, self.within, g)
        };
        loop {
            pushed = pull(vectors, &mut g);
            let mut more = false;
            for i in 0..d {
                let out = (g[i] >= 0.0 && low[i] == f64::NEG_INFINITY) || (g[i] <= 0.0 && high[i] == f64::INFINITY);
                more |= out && diagonal[i] == 0.0 && !open[i];
                open[i] |= out && diagonal[i] == 0.0;
            }
            if !more {
                break;
            }
            let count = open.iter().filter(|open| **open).count();
            let mut columns = try_room(WHAT, vectors.len() * count)?;
            for row in self.maps.chunks_exact(d).chain(cost.chunks_exact(d)) {
                columns.extend(row.iter().zip(&open).filter(|(_, open)| **open).map(|(v, _)| v));
            }
            let Pseudoinverse { rank, singular_values, basis, right, .. } =
                pseudoinverse(&columns, vectors.len(), count)?;
            // twice: what rounding left the first time
            for _ in 0..2 {
                for direction in basis.chunks_exact(vectors.len()) {
                    axpy(-dot(direction, vectors), direction, vectors);
                }
            }
            // and what balances the forces
            g.fill(0.0);
            forces.pull(self.held, self.within, &mut g);
            let along = basis.chunks_exact(vectors.len()).zip(right.chunks_exact(count)).zip(&singular_values);
            for ((direction, right), sigma) in along.take(rank) {
                let pushed = right.iter().zip(g.iter().zip(&open).filter(|(_, open)| **open));
                let pushed: f64 = pushed.map(|(right, (g, _))| right * g).sum();
                axpy(-pushed / sigma, direction, vectors);
            }
        }
        // where no vector can balance them there is no bound
        let forced = forces.held.iter().any(|force| *force > 0.0);
        let scale = (0..d).filter(|&i| !open[i]).fold(norm(vectors), |most, i| most.max(g[i].abs()));
        if forced && (0..d).any(|i| open[i] && g[i].abs() > BALANCED * scale) {
            return Ok((0.0, try_zeros(WHAT, units / self.rows)?));
        }
        let mut shares = try_room(WHAT, units / self.rows)?;
        shares.extend(vectors[..units].chunks_exact(self.rows).map(norm));
        let total: f64 = shares.iter().sum();
        shares.iter_mut().filter(|_| total > 0.0).for_each(|share| *share /= total);
        let left = size(vectors);
        if !(left > LEFT * whole && left.is_finite()) {
            return Ok((0.0, shares));
        }
        let (square, aim) = (left * left, dot(&vectors[..units], self.targets) + pushed);
        // where r_i u^2 + 2 s g_i u is least
        let least = |i: usize, s: f64| match (diagonal[i] > 0.0, g[i]) {
            (true, g) => (-s * g / diagonal[i]).clamp(low[i], high[i]),
            _ if open[i] || g[i] == 0.0 => 0.0,
            (_, 0.0..) => low[i],
            _ => high[i],
        };
        // half the derivative of the bound with respect to the scale s; it falls, and is at most slope(0) - s square
        let slope =
            |s: f64| -s * square - aim + (0..d).map(|i| if open[i] { 0.0 } else { g[i] * least(i, s) }).sum::<f64>();
        let (mut below, mut above) = (0.0, slope(0.0).max(0.0) / square);
        if diagonal.iter().all(|r| *r == 0.0) {
            below = above; // the rest of the slope does not depend on s
        }
        for _ in 0..HALVINGS {
            let s = below / 2.0 + above / 2.0;
            if s <= below || s >= above {
                break;
            }
            if slope(s) > 0.0 { below = s } else { above = s }
        }
        let s = below;
        let inputs = |i: usize| {
            let u = least(i, s);
            if open[i] { 0.0 } else { diagonal[i] * u * u + 2.0 * s * g[i] * u }
        };
        let bound = (0..d).map(inputs).sum::<f64>() - s * s * square - 2.0 * s * aim;
        Ok((if bound.is_finite() { bound.max(0.0).sqrt() } else { 0.0 }, shares))
    }
}
