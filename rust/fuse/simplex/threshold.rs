//! Euclidean projection on the probability simplex by a threshold.
//!
//! The projection of `u` is `w_i = max(u_i - theta, 0)` with the one `theta` for which the weights sum to one.
//! Michelot's iteration (J. Optim. Theory Appl. 50, 1986): `theta` is the mean excess over the entries above the last
//! `theta`. It only grows, so entries below it can be dropped. A handful of passes in practice.

use crate::error::Result;
use crate::memory::try_room;

/// `theta` with `sum_i max(u_i - theta, 0) = 1`; `alive` is scratch space with room for as many numbers, reused between
/// calls.
pub(crate) fn threshold(u: &[f64], alive: &mut Vec<f64>) -> f64 {
    // A cheap lower bound first: theta >= max(u) - 1, so everything below it can be dropped at once.
    let top = u.iter().fold(f64::NEG_INFINITY, |m, &v| if v > m { v } else { m });
    alive.clear();
    alive.extend(u.iter().filter(|&&v| v > top - 1.0));
    let mut theta = (crate::vector::sum(alive) - 1.0) / alive.len().max(1) as f64;
    loop {
        let before = alive.len();
        alive.retain(|&v| v > theta);
        if alive.len() == before || alive.is_empty() {
            return theta;
        }
        // theta = (sum_{alive} u - 1) / |alive|
        theta = (crate::vector::sum(alive) - 1.0) / alive.len() as f64;
    }
}

/// Projects `u` on the simplex in place.
pub(crate) fn project(u: &mut [f64]) -> Result<()> {
    // a common shift changes nothing; with the largest entry at 0, rounding of large ones cannot swallow the 1
    let top = u.iter().fold(f64::NEG_INFINITY, |m, v| m.max(*v));
    u.iter_mut().for_each(|v| *v = if *v == top { 0.0 } else { *v - top });
    let theta = threshold(u, &mut try_room("a projection", u.len())?);
    for v in u.iter_mut() {
        *v = (*v - theta).max(0.0);
    }
    settle(u);
    Ok(())
}

/// Leaves weights on the simplex to rounding as they are, and makes all others so: the uniform ones if nothing is left.
pub(crate) fn settle(w: &mut [f64]) {
    let (n, total) = (w.len() as f64, crate::vector::sum(w));
    let on = (total - 1.0).abs() <= f64::EPSILON * (n + 16.0) && w.iter().all(|v| *v >= 0.0);
    if !on && !normalise(w) {
        w.fill(1.0 / n);
    }
}

/// Clips to `w >= 0` and divides by the sum, so that the weights sum to one to rounding. `false` if nothing is left.
pub(crate) fn normalise(w: &mut [f64]) -> bool {
    for v in w.iter_mut() {
        *v = v.max(0.0);
    }
    let total = crate::vector::sum(w);
    if !(total > 0.0 && total.is_finite()) {
        return false;
    }
    for v in w.iter_mut() {
        *v /= total;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_projection_sums_to_one_and_satisfies_the_variational_inequality() {
        let u = [0.3, -2.0, 0.9, 0.55, 0.1];
        let mut w = u;
        project(&mut w).unwrap();
        assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-15);
        // <u - w, e_i - w> <= 0 for every vertex e_i
        for i in 0..u.len() {
            let lhs: f64 = (0..u.len()).map(|k| (u[k] - w[k]) * (f64::from(u8::from(k == i)) - w[k])).sum();
            assert!(lhs <= 1e-15);
        }
    }

    #[test]
    fn one_huge_entry_takes_everything() {
        let mut w = [1e9, 0.0, 1.0];
        project(&mut w).unwrap();
        assert_eq!(w, [1.0, 0.0, 0.0]);
    }

    #[test]
    fn entries_far_from_one_are_projected_on_the_simplex_too() {
        // of opposite sign and so large that a step of 1 is rounded away, equal, infinite, not a number
        let (far, inf) = (-1e20, f64::INFINITY);
        for (mut u, wanted) in [
            ([far, 2.0 * far, far], [0.5, 0.0, 0.5]),
            ([1e300, 1e299, -1e300], [1.0, 0.0, 0.0]),
            ([inf, 1.0, inf], [0.5, 0.0, 0.5]),
            ([-inf, -inf, -inf], [1.0 / 3.0; 3]),
            ([f64::NAN, 0.25, -1.0], [0.0, 1.0, 0.0]),
        ] {
            project(&mut u).unwrap();
            assert_eq!(u, wanted);
        }
    }
}
