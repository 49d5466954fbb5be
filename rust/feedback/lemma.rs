//! The least `Y` with `A_G Y A_G' / lambda + X <= Y` for all members of the region, by doubling.
//!
//! It is solved in coordinates in which what `X` stirs up in the centre alone is about I: the states of a long window
//! nearly depend on each other, and `Y` is then singular to rounding where its root R, `Y = R R'`, is not.

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side};

use super::data::{Matrix, finite, scaled, symmetric, trace};

/// Rounds after which a loop counts as too close to its limit: 2^60 steps.
const ROUNDS: usize = 60;

/// How the recursion ended.
#[derive(Debug)]
pub(super) enum Solved {
    /// R with `Y = R R'`.
    Found(Matrix),
    /// A finite horizon has no solution: there is none, up to rounding.
    Broken,
    Slow,
}

impl Solved {
    pub fn found(self) -> Option<Matrix> {
        if let Self::Found(root) = self { Some(root) } else { None }
    }
}

/// What is added to `X` at least, relative to what it stirs up.
const LEAST: f64 = 1e-10;

/// The root of the limit of `Y <- H + (1/lambda) A0 Y (I - E'E Y / lambda)^-1 A0'` from 0, with
/// `H = X + alpha rho^2 S`, and E divided by `sqrt(alpha)`. H is larger by `room` times what it and `lift` times its
/// mean diagonal stir up; a H of 0 stirs up what I does.
pub(super) fn least(a0: &Matrix, e: Option<&Matrix>, h: &Matrix, lambda: f64, (room, lift): (f64, f64)) -> Solved {
    let (n, size, mut lifted) = (a0.nrows(), trace(h) / a0.nrows() as f64, h.clone());
    (0..n).for_each(|i| lifted[(i, i)] += if size > 0.0 { lift * size } else { 1.0 });
    let Some(white) = doubled(a0, None, &lifted, lambda).found().and_then(|y| rooted(&y)) else {
        return Solved::Slow;
    };
    let inner = |mut a: Matrix| {
        solve_lower_triangular_in_place(white.as_ref(), a.as_mut(), Par::Seq);
        a
    };
    let own = inner(a0 * &white);
    let mut h = symmetric(&inner(inner(h.clone()).transpose().to_owned()));
    (0..n).for_each(|i| h[(i, i)] += room.max(LEAST));
    match doubled(&own, e.map(|e| e * &white).as_ref(), &h, lambda) {
        Solved::Found(y) => rooted(&y).map_or(Solved::Slow, |root| Solved::Found(&white * root)),
        other => other,
    }
}

/// The lower triangle L with `L L' = a`, up to rounding of its diagonal.
fn rooted(a: &Matrix) -> Option<Matrix> {
    [0.0, 1e-15, 1e-14, 1e-13, 1e-12].iter().find_map(|more| {
        let mut lifted = a.clone();
        (0..a.nrows()).for_each(|i| lifted[(i, i)] *= 1.0 + more);
        lifted.llt(Side::Lower).ok().map(|factor| factor.L().to_owned()).filter(finite)
    })
}

/// The limit of `Y <- H + (1/lambda) A0 Y (I - E'E Y / lambda)^-1 A0'` from 0: a structure-preserving doubling, after
/// round k of which `Y` is that of `2^k` steps.
fn doubled(a0: &Matrix, e: Option<&Matrix>, h: &Matrix, lambda: f64) -> Solved {
    let n = a0.nrows();
    let mut a = scaled(&a0.transpose().to_owned(), lambda.sqrt().recip());
    let (mut m, mut h) = (e.map(|e| scaled(&(e.transpose() * e), 1.0 / lambda)), h.clone());
    let mut before = f64::INFINITY;
    for _ in 0..ROUNDS {
        if !finite(&h) || !finite(&a) || m.as_ref().is_some_and(|m| !finite(m)) {
            return Solved::Broken;
        }
        let more = if let Some(last) = &m {
            let Ok(factor) = h.llt(Side::Lower) else { return Solved::Slow };
            // (I - M H)^-1 M = M + M L (I - L'M L)^-1 L'M
            let ml = last * factor.L();
            let room = Mat::<f64>::identity(n, n) - factor.L().transpose() * &ml;
            let Ok(inner) = symmetric(&room).llt(Side::Lower) else { return Solved::Broken };
            let inverse = last + &ml * inner.solve(ml.transpose());
            let nh = &inverse * &h;
            let more = symmetric(&(a.transpose() * (&h + &h * &nh) * &a));
            let wider = symmetric(&(last + &a * &inverse * a.transpose()));
            a = &a * (&a + &nh * &a);
            m = Some(wider);
            more
        } else {
            let more = symmetric(&(a.transpose() * &h * &a));
            a = &a * &a;
            more
        };
        h = &h + &more;
        let (step, size) = (more.norm_l2(), h.norm_l2());
        if step <= 1e-13 * size || (step <= 1e-8 * size && step >= before) {
            return Solved::Found(h);
        }
        before = step;
    }
    Solved::Slow
}
