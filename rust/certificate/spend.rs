//! Weights that make the error of a fit with feedback exactly Gaussian.
//!
//! Let q(t) in R^d depend on what was before w(t+1) alone, and `sum_t q(t) q(t)' = I` surely, for a number N of pairs
//! that is fixed beforehand. Then `Gamma = Sigma^(-1/2) sum_t w(t+1) q(t)'` is standard normal (n, d), whatever the
//! design: for every L `exp(i sum <L q, Sigma^(-1/2) w> + ||L q||^2 / 2)` is a martingale, and at N its compensator is
//! the constant `||L||_F^2 / 2` (Lai and Siegmund 1983, here for matrices, with the last d weights as completion).
//!
//! The weights spend I as least squares would: `q = M x` in coordinates x in which the first part has covariance I, M
//! the geometric mean of `((N - t) Vh)^-1` and of what is left, Vh the mean square so far. No step takes more than half
//! of what is left in its direction; the last d directions are completed.

use faer::linalg::solvers::DenseSolveCore;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, Par, Side};

use crate::error::{Error, Result};
use crate::memory::{checked_len, covered, try_zeros};
use crate::parallel::Stop;

use super::carried::square_bytes;

const WHAT: &str = "the weights of a fit with feedback";
/// How often M is found anew.
const BLOCKS: usize = 24;
/// What is kept back for the last directions, times d / N.
const BACK: f64 = 0.3;
/// A step may take this share of what is left in its direction.
const MOST: f64 = 0.5;
/// Steps of a smaller share of what is kept back are left out: their direction is spent.
const SPENT: f64 = 1e-6;
/// Parts of a direction below this share are rounding.
const NOTHING: f64 = 1e-12;
/// The largest `||sum q q' - I||`.
const ROUNDING: f64 = 1e-10;

type Matrix = Mat<f64>;

/// What is left of I but for what is kept `back`, and its inverse.
struct Left {
    r: Matrix,
    inverse: Matrix,
    back: f64,
}

impl Left {
    fn new(d: usize, back: f64) -> Self {
        let times = |v: f64| Mat::from_fn(d, d, |i, j| if i == j { v } else { 0.0 });
        Self { r: times(1.0 - back), inverse: times(1.0 / (1.0 - back)), back }
    }

    /// The inverse anew; in each block a thousandth of what is kept back may be used for rounding.
    fn refreshed(self) -> Option<Self> {
        let (d, back) = (self.r.nrows(), self.back);
        let r =
            Mat::from_fn(d, d, |i, j| 0.5 * (self.r[(i, j)] + self.r[(j, i)]) + if i == j { 1e-3 * back } else { 0.0 });
        let inverse = r.llt(Side::Lower).ok()?.inverse();
        Some(Self { r, inverse, back })
    }

    /// The weight in the direction `q` (d, 1), of which the rest has less.
    fn take(&mut self, mut q: Matrix) -> Matrix {
        let mut through = &self.inverse * &q;
        let mut share = (q.transpose() * &through)[(0, 0)];
        if share > MOST {
            let by = (MOST / share).sqrt();
            (q, through, share) = (q * faer::Scale(by), through * faer::Scale(by), MOST);
        }
        if q.squared_norm_l2() < SPENT * self.back {
            return Mat::zeros(q.nrows(), 1);
        }
        self.r -= &q * q.transpose();
        self.inverse += &through * through.transpose() * faer::Scale(1.0 / (1.0 - share)); // Sherman and Morrison
        q
    }
}

/// The weight in the direction of `toward` among those of the columns of `open`, and the others.
fn complete(open: &Matrix, toward: &Matrix) -> (Matrix, Matrix) {
    let (d, left) = (open.nrows(), open.ncols());
    let along = open.transpose() * toward;
    let size = along.norm_l2();
    let v = Mat::from_fn(left, 1, |i, _| match () {
        () if size > NOTHING * open.norm_l2() * toward.norm_l2() => along[(i, 0)] / size,
        () => f64::from(u8::from(i == 0)),
    });
    // Householder: I - 2 h h' / |h|^2 takes v to the first axis
    let mut h = v.clone();
    h[(0, 0)] += if v[(0, 0)] < 0.0 { -1.0 } else { 1.0 };
    let through = open * &h * faer::Scale(2.0 / h.squared_norm_l2());
    let rest = Mat::from_fn(d, left - 1, |i, j| open[(i, j + 1)] - through[(i, 0)] * h[(j + 1, 0)]);
    (open * v, rest)
}

/// The M > 0 with `M W M = R`.
fn geometric_mean(w: &Matrix, r: &Matrix) -> Option<Matrix> {
    let c = w.llt(Side::Lower).ok()?.L().to_owned();
    let inner = c.transpose() * r * &c;
    let found = inner.self_adjoint_eigen(Side::Lower).ok()?;
    let (u, s) = (found.U(), found.S().column_vector());
    let scaled = Mat::from_fn(u.nrows(), u.ncols(), |i, j| u[(i, j)] * s[j].max(0.0).sqrt());
    let mut half = scaled * u.transpose();
    // C'^-1 half C^-1
    solve_upper_triangular_in_place(c.transpose(), half.as_mut(), Par::Seq);
    let mut turned = half.transpose().to_owned();
    solve_upper_triangular_in_place(c.transpose(), turned.as_mut(), Par::Seq);
    Some(turned)
}

/// Weights (N, d) of the rows `z` (N, d), in the order of time; `root` (d, d), an upper triangle, has `root' root` the
/// mean square of `before` rows that were before them.
///
/// # Errors
/// [`Error::Value`] for fewer than 2 d rows or a singular `root`, [`Error::Numerical`], [`Error::Memory`],
/// [`Error::Interrupted`].
pub(super) fn spend(z: &[f64], root: &[f64], before: usize, d: usize, stop: &Stop) -> Result<Vec<f64>> {
    let count = z.len() / d;
    if count < 2 * d {
        let expected = "longer: two pairs behind the first runs for each coefficient of a row";
        return Err(Error::Value { name: "data", expected, found: format!("{count} for {d}") });
    }
    let mut weights = try_zeros(WHAT, checked_len(WHAT, count, d)?)?;
    covered(WHAT, 40 * square_bytes(d), || {
        let triangle = Mat::from_fn(d, d, |i, j| if i <= j { root[i * d + j] } else { 0.0 });
        if (0..d).any(|i| triangle[(i, i)] == 0.0) {
            let (expected, found) = ("enough to determine the model", "a singular one".into());
            return Err(Error::Value { name: "the first part", expected, found });
        }
        let lost = || Error::Numerical("no weights for inputs='any': pass `source` more runs, or another pilot".into());
        let mut left = Left::new(d, BACK * d as f64 / count as f64);
        let mut squares = Mat::from_fn(d, d, |i, j| if i == j { before as f64 } else { 0.0 });
        let mut spent = Mat::<f64>::zeros(d, d);
        let (mut mean, mut open, mut block) = (Mat::zeros(d, d), None::<Matrix>, 0);
        for (t, (row, to)) in z.chunks_exact(d).zip(weights.chunks_exact_mut(d)).enumerate() {
            // blocks are shorter towards the end
            let share = |b: usize| 1.0 - (1.0 - b as f64 / BLOCKS as f64).powi(2);
            if t == 0 || (block < BLOCKS && t as f64 >= share(block) * (count - d) as f64) {
                stop.check()?;
                while block < BLOCKS && t as f64 >= share(block) * (count - d) as f64 {
                    block += 1;
                }
                let ahead = (count - t) as f64 / (before + t).max(1) as f64;
                left = left.refreshed().ok_or_else(lost)?; // without the rounding of its updates
                mean = geometric_mean(&(&squares * faer::Scale(ahead)), &left.r).ok_or_else(lost)?;
            }
            let mut x = Mat::from_fn(d, 1, |i, _| row[i]);
            solve_lower_triangular_in_place(triangle.transpose(), x.as_mut(), Par::Seq);
            let toward = &mean * &x;
            let q = if t + d < count {
                left.take(toward)
            } else {
                let rest = match open.take() {
                    Some(open) => open,
                    None => (Mat::<f64>::identity(d, d) - &spent).llt(Side::Lower).map_err(|_| lost())?.L().to_owned(),
                };
                let (q, rest) = complete(&rest, &toward);
                open = Some(rest);
                q
            };
            spent += &q * q.transpose();
            squares += &x * x.transpose();
            to.iter_mut().enumerate().for_each(|(i, to)| *to = q[(i, 0)]);
        }
        let off = (spent - Mat::<f64>::identity(d, d)).norm_l2();
        if off <= ROUNDING { Ok(()) } else { Err(lost()) }
    })??;
    Ok(weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `M = I`, nothing kept back: the first eight weights, and the two that complete them.
    #[test]
    fn weights_as_computed_by_other_code() {
        let x = |t: i32| {
            let values = [f64::from((3 * t * t + t) % 7 - 3) / 6.0, f64::from((5 * t + 2) % 9 - 4) / 8.0];
            Mat::from_fn(2, 1, |i, _| values[i])
        };
        let (mut left, mut sum, mut spent) = (Left::new(2, 0.0), Mat::<f64>::zeros(2, 2), Mat::<f64>::zeros(2, 2));
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-11, "{a} {b}");
        for t in 0..8 {
            let q = left.take(x(t));
            sum += x(t) * q.transpose();
            spent += &q * q.transpose();
        }
        [left.r[(0, 0)], left.r[(0, 1)], left.r[(1, 1)]]
            .iter()
            .zip([0.351359338061, -0.194813829787, 0.244514627660])
            .for_each(|(a, b)| near(*a, b));
        let mut open = (Mat::<f64>::identity(2, 2) - &spent).llt(Side::Lower).unwrap().L().to_owned();
        for (t, expected) in [(8, [0.105024220991, 0.305380390237]), (9, [-0.583377451627, 0.388918301085])] {
            let (q, rest) = complete(&open, &x(t));
            (0..2).for_each(|i| near(q[(i, 0)], expected[i]));
            sum += x(t) * q.transpose();
            spent += &q * q.transpose();
            open = rest;
        }
        let expected = [1.020302588931, 0.098103284212, 0.413766121202, 0.777426258712];
        (0..4).for_each(|at| near(sum[(at / 2, at % 2)], expected[at]));
        assert!((spent - Mat::<f64>::identity(2, 2)).norm_l2() < 1e-14 && open.ncols() == 0);
    }

    /// They are I in the end, no weight knows what comes later, and what does not move is completed too.
    #[test]
    fn weights_look_at_the_past_alone() {
        let (d, count) = (3, 60);
        let row = |t: usize, j: usize| ((7 * t + 3 * j * j) as f64).sin() + if j == 2 { 1.0 } else { 0.0 };
        let mut z: Vec<f64> = (0..count * d).map(|at| row(at / d, at % d)).collect();
        let root = [1.0, 0.2, 0.1, 0.0, 0.8, 0.3, 0.0, 0.0, 1.1];
        let stop = Stop::new();
        let first = spend(&z, &root, 20, d, &stop).unwrap();
        for change in [5, 30, count - 2] {
            let mut other = z.clone();
            other[(change + 1) * d..].iter_mut().for_each(|v| *v += 3.0);
            assert_eq!(spend(&other, &root, 20, d, &stop).unwrap()[..change * d], first[..change * d]);
        }
        z[20 * d..].iter_mut().enumerate().filter(|(at, _)| at % d == 1).for_each(|(_, v)| *v = 0.0);
        assert!(spend(&z, &root, 20, d, &stop).is_ok());
        assert!(spend(&z[..5 * d], &root, 20, d, &stop).is_err());
        assert!(spend(&z, &[0.0; 9], 20, d, &stop).is_err());
    }
}
