//! The structure-preserving doubling, for gains and games.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

use super::data::{Matrix, finite, symmetric};

/// The limit of `P <- H + A'P (I + G P)^-1 A` from 0, G of mixed sign, if `sound` holds in each round and at the end
/// `P >= 0`: for a game the doubling can jump over horizons without a solution.
pub(super) fn limit(a: &Matrix, g: &Matrix, h: &Matrix, sound: impl Fn(&Matrix) -> bool) -> Option<Matrix> {
    let n = a.nrows();
    let (mut a, mut g, mut h) = (a.clone(), g.clone(), h.clone());
    let mut before = f64::INFINITY;
    for _ in 0..60 {
        if !(finite(&a) && finite(&g) && finite(&h) && sound(&h)) {
            return None;
        }
        let w = (Mat::<f64>::identity(n, n) + &g * &h).partial_piv_lu();
        let (wa, wg) = (w.solve(&a), w.solve(&g));
        let more = symmetric(&(a.transpose() * &h * &wa));
        g = symmetric(&(&g + &a * wg * a.transpose()));
        a = &a * wa;
        h = &h + &more;
        let (step, size) = (more.norm_l2(), h.norm_l2());
        if step <= 1e-14 * size || (step <= 1e-9 * size && step >= before) {
            let mut lifted = h.clone();
            let room = 1e-13 * (0..n).map(|i| h[(i, i)].abs()).sum::<f64>();
            (0..n).for_each(|i| lifted[(i, i)] += room.max(f64::MIN_POSITIVE));
            return (sound(&h) && lifted.llt(Side::Lower).is_ok()).then_some(h);
        }
        before = step;
    }
    None
}
