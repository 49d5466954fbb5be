//! The least `Y` with `A_G Y A_G' / lambda + X <= Y` for all members of the region, by doubling.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

use super::data::{Matrix, finite, scaled, symmetric};

/// Rounds after which a loop counts as too close to its limit: 2^60 steps.
const ROUNDS: usize = 60;

/// How the recursion ended.
#[derive(Debug)]
pub(super) enum Solved {
    Found(Matrix),
    /// A finite horizon has no solution: there is none, up to rounding.
    Broken,
    Slow,
}

impl Solved {
    pub fn found(self) -> Option<Matrix> {
        if let Self::Found(y) = self { Some(y) } else { None }
    }
}

/// The limit of `Y <- H + (1/lambda) A0 Y (I - M Y / lambda)^-1 A0'` from 0, with `H = X + alpha rho^2 S` and
/// `M = E'E / alpha`. A structure-preserving doubling: round k has `Y` after `2^k` steps.
pub(super) fn least(a0: &Matrix, m: &Matrix, h: &Matrix, lambda: f64) -> Solved {
    let n = a0.nrows();
    let mut a = scaled(&a0.transpose().to_owned(), lambda.sqrt().recip());
    let (mut m, mut h) = (scaled(m, 1.0 / lambda), h.clone());
    let mut before = f64::INFINITY;
    for _ in 0..ROUNDS {
        if !finite(&h) || !finite(&a) || !finite(&m) {
            return Solved::Broken;
        }
        let Ok(factor) = h.llt(Side::Lower) else { return Solved::Slow };
        // (I - M H)^-1 M = M + M L (I - L'M L)^-1 L'M
        let ml = &m * factor.L();
        let room = Mat::<f64>::identity(n, n) - factor.L().transpose() * &ml;
        let Ok(inner) = symmetric(&room).llt(Side::Lower) else { return Solved::Broken };
        let inverse = &m + &ml * inner.solve(ml.transpose());
        let nh = &inverse * &h;
        let more = symmetric(&(a.transpose() * (&h + &h * &nh) * &a));
        let wider = &a * &inverse * a.transpose();
        a = &a * (&a + &nh * &a);
        h = &h + &more;
        m = symmetric(&(&m + &wider));
        let (step, size) = (more.norm_l2(), h.norm_l2());
        if step <= 1e-13 * size || (step <= 1e-8 * size && step >= before) {
            return Solved::Found(h);
        }
        before = step;
    }
    Solved::Slow
}
