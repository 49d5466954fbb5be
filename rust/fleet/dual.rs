//! A lower bound of the least largest miss, from any vectors: no solver is believed.

use super::units::WHAT;
use crate::control::pseudoinverse;
use crate::error::Result;
use crate::memory::{try_filled, try_room, try_zeros};
use crate::vector::{axpy, dot, norm};

/// Where the projection leaves a smaller share of the vectors, what is left is rounding, and no bound follows. Rounding
/// of the projected vectors is about `eps` of the whole, so that 1e-6 leaves ten digits.
const LEFT: f64 = 1e-6;

/// `max_w ||M_w u - t_w|| >= sum_w v_w'(M_w u - t_w)` for `sum ||v_w|| <= 1`, so over the limits at least `-sum v_w't_w +
/// sum_i min(g_i low_i, g_i high_i)`, `g = sum M_w'v_w`. Where g points to an infinite limit it must be 0: the vectors are
/// projected there first, and then scaled to `sum ||v_w|| = 1`. Returns the bound and the norms `||v_w||`.
pub(super) fn lower_bound(
    maps: &[f64],
    targets: &[f64],
    rows: usize,
    (low, high): (&[f64], &[f64]),
    vectors: &mut [f64],
) -> Result<(f64, Vec<f64>)> {
    let d = low.len();
    let whole: f64 = vectors.chunks_exact(rows).map(norm).sum();
    let mut open = try_filled(WHAT, false, d)?;
    let mut g = try_zeros(WHAT, d)?;
    loop {
        g.fill(0.0);
        for (v, row) in vectors.iter().zip(maps.chunks_exact(d)) {
            axpy(*v, row, &mut g);
        }
        let mut more = false;
        for i in 0..d {
            let out = (g[i] >= 0.0 && low[i] == f64::NEG_INFINITY) || (g[i] <= 0.0 && high[i] == f64::INFINITY);
            more |= out && !open[i];
            open[i] |= out;
        }
        if !more {
            break;
        }
        let count = open.iter().filter(|open| **open).count();
        let mut columns = try_room(WHAT, vectors.len() * count)?;
        for row in maps.chunks_exact(d) {
            columns.extend(row.iter().zip(&open).filter(|(_, open)| **open).map(|(v, _)| v));
        }
        let basis = pseudoinverse(&columns, vectors.len(), count)?.basis;
        // twice: what rounding left the first time
        for _ in 0..2 {
            for direction in basis.chunks_exact(vectors.len()) {
                axpy(-dot(direction, vectors), direction, vectors);
            }
        }
    }
    let mut shares = try_room(WHAT, vectors.len() / rows)?;
    shares.extend(vectors.chunks_exact(rows).map(norm));
    let total: f64 = shares.iter().sum();
    if !(total > LEFT * whole && total.is_finite()) {
        return Ok((0.0, shares));
    }
    shares.iter_mut().for_each(|share| *share /= total);
    let mut bound = -dot(vectors, targets);
    for i in 0..d {
        if !open[i] && g[i] != 0.0 {
            bound += g[i] * if g[i] > 0.0 { low[i] } else { high[i] };
        }
    }
    let bound = bound / total;
    Ok((if bound.is_finite() { bound.max(0.0) } else { 0.0 }, shares))
}
