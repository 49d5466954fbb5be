//! The stabilising solution of `P = Q + A'P (I + B R^-1 B'P)^-1 A`, and why there is none.
//!
//! In units in which the equation is balanced: a gain that stabilises, by a doubling, or where rounding spoils that one
//! by gains for `gamma A`, `gamma B` with gamma up to 1; then the steps of Newton and Kleinman,
//!
//! ```text
//! P = sum_k F^k' (Q + K'R K) F^k,    F = A + B K,    K <- -(R + B'P B)^-1 B'P A,
//! ```
//!
//! which decrease P from any gain that stabilises to the only solution that does (Hewer 1971). P is kept as `L'L`, so
//! that K is a problem of least squares, and neither `R^-1` nor a difference of large numbers is formed.

use faer::linalg::solvers::SolveLstsq;
use faer::{Mat, Side, c64};

use crate::error::{Error, Obstacle, Result};
use crate::parallel::Stop;

use super::data::{Matrix, filled, finite, in_units, inverse, largest, lost, scaled, stacked, symmetric};
use super::doubling::limit;
use super::spectrum::{balancing, eigen, eigenvalues, radius};

/// Steps of Newton: one that halves the distance to the unit circle each time needs 50.
const STEPS: usize = 64;
/// Values of gamma; a mode that no input moves stops them much earlier.
const STAGES: usize = 80;
/// A mode that the inputs reach by less than this, relative to A and B, is out of reach if no gain is found that
/// stabilises.
const REACHED: f64 = 1e-10;
/// A mode of the loop within this of the unit circle must be seen by Q.
const SLOW: f64 = 1e-6;

/// The equation in balanced units, with `R = I`, and the root C of `Q = C'C`.
struct Equation {
    a: Matrix,
    b: Matrix,
    q: Matrix,
    c: Matrix,
}

/// A root `C'C` of Q >= 0 with small relative errors in its columns; negative eigenvalues are rounding.
fn root_of(q: &Matrix) -> Result<Matrix> {
    let n = q.nrows();
    let size = |i: usize| if q[(i, i)] > 0.0 { q[(i, i)].sqrt() } else { 1.0 };
    let unit = symmetric(&Mat::from_fn(n, n, |i, j| q[(i, j)] / size(i) / size(j)));
    let found = unit.self_adjoint_eigen(Side::Lower).map_err(lost)?;
    let values = found.S().column_vector();
    Ok(Mat::from_fn(n, n, |i, j| found.U()[(j, i)] * values[i].max(0.0).sqrt() * size(j)))
}

/// The triangle of `a` by orthogonal rotations, square.
fn triangle(a: &Matrix) -> Matrix {
    let (r, n) = (a.qr(), a.ncols());
    let r = r.thin_R();
    Mat::from_fn(n, n, |i, j| if i <= j && i < r.nrows() { r[(i, j)] } else { 0.0 })
}

/// L with `L'L = sum_k F^k' M'M F^k`, by squaring F; None where that leaves the range of doubles.
fn summed(mut f: Matrix, m: &Matrix) -> Option<Matrix> {
    let mut l = triangle(m);
    for _ in 0..STEPS {
        let next = &l * &f;
        if !finite(&next) {
            return None;
        }
        let done = next.norm_max() <= 1e-18 * l.norm_max();
        l = triangle(&stacked([&l, &next], f.ncols()));
        if done {
            return Some(l);
        }
        f = &f * &f;
    }
    finite(&f).then_some(l)
}

impl Equation {
    /// `-(I + gamma^2 B'P B)^-1 gamma^2 B'P A` for `P = L'L`.
    fn gain(&self, l: &Matrix, gamma: f64) -> Matrix {
        let (m, n) = (self.b.ncols(), self.a.ncols());
        let left = stacked([&Mat::identity(m, m), &scaled(&(l * &self.b), gamma)], m);
        let right = stacked([&Mat::zeros(m, n), &scaled(&(l * &self.a), -gamma)], n);
        left.qr().solve_lstsq(&right)
    }

    fn closed(&self, k: &Matrix) -> Matrix {
        &self.a + &self.b * k
    }

    /// One step from a gain that stabilises `gamma A`, with the weight `c` of the states: L and the next gain.
    fn step(&self, k: &Matrix, c: &Matrix, gamma: f64) -> Option<(Matrix, Matrix)> {
        let l = summed(scaled(&self.closed(k), gamma), &stacked([c, k], self.a.ncols()))?;
        let next = self.gain(&l, gamma);
        finite(&next).then_some((l, next))
    }

    /// A gain that stabilises.
    fn start(&self, stop: &Stop) -> Result<Option<Matrix>> {
        let g = symmetric(&(&self.b * self.b.transpose()));
        if let Some(p) = limit(&self.a, &g, &self.q, |_| true) {
            let k = self.gain(&root_of(&p)?, 1.0);
            if radius(&self.closed(&k))? < 1.0 {
                return Ok(Some(k));
            }
        }
        let size = self.q.norm_max();
        for more in [1e-4 * size, size, self.a.norm_max()] {
            if more > 0.0
                && let Some(k) = self.raised(more, stop)?
            {
                return Ok(Some(k));
            }
        }
        Ok(None)
    }

    /// The same for gamma A with gamma raised to 1, as far each time as the last gain stabilises; `more` on the
    /// diagonal of Q.
    fn raised(&self, more: f64, stop: &Stop) -> Result<Option<Matrix>> {
        let (n, m) = (self.a.ncols(), self.b.ncols());
        let c = stacked([&self.c, &scaled(&Mat::identity(n, n), more.sqrt())], n);
        let (mut k, mut gamma) = (Mat::zeros(m, n), (0.95 / radius(&self.a)?.max(0.1)).min(1.0));
        for _ in 0..STAGES {
            stop.check()?;
            let mut own = f64::INFINITY;
            for _ in 0..3 {
                let Some((_, next)) = self.step(&k, &c, gamma) else { return Ok(None) };
                k = next;
                own = radius(&self.closed(&k))?;
                if gamma * own >= 1.0 {
                    return Ok(None);
                }
            }
            if own < 1.0 {
                return Ok(Some(k));
            }
            let next = (gamma * (gamma * own).powf(-0.9)).min(1.0);
            if next <= gamma * (1.0 + 1e-9) {
                return Ok(None);
            }
            gamma = next;
        }
        Ok(None)
    }

    /// A mode of the loop on the unit circle that Q does not see, but for rounding.
    fn unseen(&self, k: &Matrix) -> Result<Option<(c64, Mat<c64>)>> {
        let (n, (values, vectors)) = (self.a.nrows(), eigen(&self.closed(k))?);
        let eps = 100.0 * n as f64 * f64::EPSILON;
        for (at, value) in values.iter().enumerate().filter(|(_, value)| value.norm() > 1.0 - SLOW) {
            let v = vectors.subcols(at, 1).to_owned();
            let (mut seen, mut whole) = (c64::new(0.0, 0.0), 0.0);
            for i in 0..n {
                for j in 0..n {
                    seen += v[(i, 0)].conj() * v[(j, 0)] * self.q[(i, j)];
                    whole += v[(i, 0)].norm() * v[(j, 0)].norm() * self.q[(i, j)].abs();
                }
            }
            if seen.re <= eps * whole + eps * eps * self.q.norm_max() * v.squared_norm_l2() {
                return Ok(Some((*value, v)));
            }
        }
        Ok(None)
    }

    /// The largest entry of `Q + K'K + F'P F - P` relative to that of P.
    fn residual(&self, p: &Matrix, k: &Matrix) -> f64 {
        let f = self.closed(k);
        let left = &self.q + k.transpose() * k + f.transpose() * p * &f - p;
        left.norm_max() / p.norm_max().max(f64::MIN_POSITIVE)
    }
}

/// The mode with `|lambda| >= 1` that the inputs reach least: the least singular value of `[A - lambda I, B]`,
/// balanced, relative to the largest one, and its left vector.
fn least_reached(a: &Matrix, b: &Matrix) -> Result<Option<(f64, c64, Mat<c64>)>> {
    let (n, m) = (a.nrows(), b.ncols());
    let whole = Mat::from_fn(n + m, n + m, |i, j| {
        if i >= n {
            0.0
        } else if j < n {
            a[(i, j)]
        } else {
            b[(i, j - n)]
        }
    });
    let d = balancing(&whole, None);
    let whole = in_units(&whole, &inverse(&d), &d);
    let mut least: Option<(f64, c64, Mat<c64>)> = None;
    for value in eigenvalues(a)? {
        if value.norm() < 1.0 - 1e-9 || value.im < 0.0 {
            continue;
        }
        let own = |i: usize, j: usize| if i == j { value } else { c64::new(0.0, 0.0) };
        let shifted = Mat::from_fn(n, n + m, |i, j| c64::new(whole[(i, j)], 0.0) - own(i, j));
        let found = shifted.thin_svd().map_err(lost)?;
        let sizes = found.S().column_vector();
        let ratio = sizes[n - 1].re / sizes[0].re.max(f64::MIN_POSITIVE);
        if least.as_ref().is_none_or(|(other, ..)| ratio < *other) {
            least = Some((ratio, value, found.U().subcols(n - 1, 1).to_owned()));
        }
    }
    Ok(least)
}

/// The states that are at least 3/10 of the largest one, three at most.
fn states_of(v: &Mat<c64>) -> Vec<usize> {
    let mut order = Vec::new();
    order.extend(0..v.nrows());
    order.sort_by(|&i, &j| v[(j, 0)].norm().total_cmp(&v[(i, 0)].norm()));
    order.retain(|&i| v[(i, 0)].norm() >= 0.3 * v.norm_max());
    order.truncate(3);
    order
}

/// P and `K = -(R + B'P B)^-1 B'P A`; Q >= 0.
///
/// # Errors
/// [`Error::Value`] for an R that is not positive definite, [`Error::NoGain`] with its cause, [`Error::Interrupted`].
pub(super) fn regulator(a: &Matrix, b: &Matrix, q: &Matrix, r: &Matrix, stop: &Stop) -> Result<(Matrix, Matrix)> {
    let inputs = match r.llt(Side::Lower) {
        Ok(found) => found.L().to_owned(),
        Err(_) => {
            let found = format!("one with the eigenvalue {:.3e}", 0.0 - largest(&scaled(r, -1.0))?);
            return Err(Error::Value { name: "R", expected: "positive definite", found });
        }
    };
    // u = L'^-1 v: the weight of v is I
    let m = b.ncols();
    let mut free = Mat::identity(m, m);
    faer::linalg::triangular_solve::solve_lower_triangular_in_place(inputs.as_ref(), free.as_mut(), faer::Par::Seq);
    let free = free.transpose().to_owned();
    let own = b * &free;
    let d = balancing(a, Some((&symmetric(&(&own * own.transpose())), q)));
    let (back, ones) = (inverse(&d), filled(m, 1.0));
    let (a, b, q) = (in_units(a, &back, &d), in_units(&own, &back, &ones), in_units(q, &d, &d));
    let of = Equation { c: root_of(&q)?, a, b, q };
    let (p, k) = of.solved(stop)?;
    Ok((in_units(&p, &back, &back), in_units(&(free * k), &ones, &back)))
}

impl Equation {
    fn solved(&self, stop: &Stop) -> Result<(Matrix, Matrix)> {
        let refused = |obstacle| Err(Error::NoGain(obstacle));
        let reached = least_reached(&self.a, &self.b)?;
        let reach = reached.as_ref().map_or(1.0, |found| found.0);
        // what rounding alone could move cannot be stabilised, whatever the spectral radius looks like
        let surely = reach <= 10.0 * self.a.nrows() as f64 * f64::EPSILON;
        let start = if surely { None } else { self.start(stop)? };
        let Some(mut k) = start else {
            return refused(match reached {
                Some((ratio, value, v)) if ratio <= REACHED => {
                    Obstacle::Unreached { value: (value.re, value.im), states: states_of(&v) }
                }
                _ => Obstacle::Unstabilised { reach },
            });
        };
        let (mut p, mut before) = (Mat::zeros(0, 0), f64::INFINITY);
        for round in 0..STEPS {
            stop.check()?;
            let Some((l, next)) = self.step(&k, &self.c, 1.0) else { return refused(Obstacle::Unstabilised { reach }) };
            let step = (&next - &k).norm_max() / next.norm_max().max(f64::MIN_POSITIVE);
            if radius(&self.closed(&next))? >= 1.0 {
                break; // rounding, or a mode on the circle: the last gain still stabilises
            }
            (k, p) = (next, l.transpose() * &l);
            if step <= 1e-15 || (round > 0 && step < 1e-7 && step >= before) {
                break;
            }
            before = step;
        }
        if let Some((value, v)) = self.unseen(&k)? {
            return refused(Obstacle::Unseen { value: (value.re, value.im), states: states_of(&v) });
        }
        let residual = if p.nrows() == 0 { f64::INFINITY } else { self.residual(&p, &k) };
        if residual <= 1e-8 { Ok((p, k)) } else { refused(Obstacle::Rounding { residual }) }
    }
}
