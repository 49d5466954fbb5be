//! Covariances of `M` times `A x0^s`, `xf^s`, `A^s x0` and `(A^s - A)(x0^s - x0)`.

use super::image::Image;
use super::sizes::{WHAT, one_norm, others, sign};
use crate::control::{times, transposed};
use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_zeros};

/// The four covariances (rank, rank), and their traces; for columns the last two are sums of nonnegative terms.
#[derive(Debug)]
pub(super) struct Moments {
    pub covariances: [Vec<f64>; 4],
    pub traces: [f64; 4],
}

impl Moments {
    pub(super) fn new(of: &Image) -> Result<Self> {
        let (x0, r) = (&of.x0, of.rank());
        let squares = try_collect(WHAT, x0.iter().map(|x| x * x))?;
        let (absolute, mut own) = (try_collect(WHAT, x0.iter().map(|x| x.abs()))?, try_zeros(WHAT, of.n)?);
        others(&absolute, &mut own);
        // the diagonal of Cv(x0)
        own.iter_mut().zip(&absolute).for_each(|(own, x)| *own *= x);
        let (of_x0, of_xf) = (pushed(&of.moved, x0, r)?, pushed(&of.images, &of.xf, r)?);
        let (of_a, of_both, traces) = if of.rows {
            let (from_a, from_both) = rows(of, &own)?;
            let trace = |e: &[f64]| Ok(of.norms()?.iter().zip(e).map(|(m, e)| m * m * e).sum());
            (diagonal(of, &from_a)?, diagonal(of, &from_both)?, [trace(&from_a)?, trace(&from_both)?])
        } else {
            let trace = |d: &[f64]| of.tau.iter().zip(d).map(|(tau, d)| tau * d).sum();
            (columns(of, &squares)?, columns(of, &own)?, [trace(&squares), trace(&own)])
        };
        let of_first = [&of_x0, &of_xf].map(|c: &Vec<f64>| c.iter().step_by(r + 1).sum::<f64>());
        Ok(Self {
            covariances: [of_x0, of_xf, of_a, of_both],
            traces: [of_first[0], of_first[1], traces[0], traces[1]].map(|trace: f64| trace.max(0.0)),
        })
    }
}

/// `F Cv(w) F' = g sum_i |w_i| y_i y_i'` with `y_i = sign(w_i) F e_i` minus its mean, for the points `F e_i`.
fn pushed(points: &[f64], w: &[f64], r: usize) -> Result<Vec<f64>> {
    let g = one_norm(w);
    if g == 0.0 {
        return try_zeros(WHAT, r * r);
    }
    let hit = w.iter().zip(points.chunks_exact(r)).filter(|(w, _)| **w != 0.0);
    let mut y = try_collect(WHAT, hit.flat_map(|(w, point)| point.iter().map(move |p| sign(*w) * p)))?;
    let weights = try_collect(WHAT, w.iter().filter(|w| **w != 0.0).map(|w| w.abs()))?;
    // the heaviest is subtracted first, and is then exactly 0, so that the squares keep their relative accuracy
    let heaviest = (1..weights.len()).fold(0, |k, i| if weights[i] > weights[k] { i } else { k });
    let first = try_copy(WHAT, &y[heaviest * r..(heaviest + 1) * r])?;
    let mut mean: Vec<f64> = try_zeros(WHAT, r)?;
    for (point, weight) in y.chunks_exact_mut(r).zip(&weights) {
        for ((p, first), mean) in point.iter_mut().zip(&first).zip(&mut mean) {
            *p -= first;
            *mean += weight * *p / g;
        }
    }
    y.chunks_exact_mut(r).for_each(|point| point.iter_mut().zip(&mean).for_each(|(p, mean)| *p -= mean));
    let mut left = transposed(&y, r)?;
    left.chunks_exact_mut(weights.len())
        .for_each(|row| row.iter_mut().zip(&weights).for_each(|(v, weight)| *v *= g * weight));
    times(&left, &y, weights.len())
}

/// `M T M'` for `T = sum_j d_j Cv(a_j)`: off the diagonal `-A diag(d) A'`.
fn columns(of: &Image, d: &[f64]) -> Result<Vec<f64>> {
    let (n, lines) = (of.n, transposed(&of.a, of.n)?);
    let left = try_collect(WHAT, of.a.iter().zip(d.iter().cycle()).map(|(v, d)| -v * d))?;
    let mut total = times(&left, &lines, n)?;
    let (mut absolute, mut apart): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
    total.iter_mut().step_by(n + 1).for_each(|v| *v = 0.0);
    for (line, d) in lines.chunks_exact(n).zip(d) {
        absolute.iter_mut().zip(line).for_each(|(to, v)| *to = v.abs());
        others(&absolute, &mut apart);
        let terms = absolute.iter().zip(&apart).map(|(v, apart)| v * apart * d);
        total.iter_mut().step_by(n + 1).zip(terms).for_each(|(to, term)| *to += term);
    }
    times(&times(&transposed(&of.images, of.rank())?, &total, n)?, &of.images, n)
}

/// `M diag(e) M'`
fn diagonal(of: &Image, e: &[f64]) -> Result<Vec<f64>> {
    let mut left = transposed(&of.images, of.rank())?;
    left.chunks_exact_mut(of.n).for_each(|row| row.iter_mut().zip(e).for_each(|(v, e)| *v *= e));
    times(&left, &of.images, of.n)
}

/// The variances of every row of `A^s x0` and of `(A^s - A)(x0^s - x0)`; rows are independent of each other.
fn rows(of: &Image, own: &[f64]) -> Result<(Vec<f64>, Vec<f64>)> {
    let n = of.n;
    let (mut from_a, mut from_both): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
    let (mut values, mut apart): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
    for (i, row) in of.a.chunks_exact(n).enumerate() {
        // rho sum_j |a_j| y_j^2, y_j = sign(a_j) x_j minus its mean
        let mut signed = pushed(&of.x0, row, 1)?;
        from_a[i] = signed.pop().unwrap_or(0.0);
        // sum_j |a_j| (rho - |a_j|) Cv_jj - sum_{j != k} a_j a_k Cv_jk, Cv_jk = -x_j x_k
        values.iter_mut().zip(row).for_each(|(to, v)| *to = v.abs());
        others(&values, &mut apart);
        let first: f64 = values.iter().zip(&apart).zip(own).map(|((v, apart), own)| v * apart * own).sum();
        values.iter_mut().zip(row).zip(&of.x0).for_each(|((to, v), x)| *to = v * x);
        others(&values, &mut apart);
        from_both[i] = first + values.iter().zip(&apart).map(|(v, apart)| v * apart).sum::<f64>();
    }
    Ok((from_a, from_both))
}
