//! `g = max_{|z| = 1} ||E (z I - A0)^-1 D||`: a lower bound by frequencies, and a proved upper bound.

use faer::linalg::solvers::Solve;
use faer::{Mat, c64};

use crate::error::Result;
use crate::parallel::Stop;

use super::data::{Closed, Matrix, Uncertain, scaled};
use super::lemma::{Solved, least};
use super::spectrum::eigenvalues;
use super::verify::{Claim, verify};

/// Entries of a response up to which its singular values are computed.
const DIRECT: usize = 400;
/// Local maxima over the grid of angles that are refined.
const REFINED: usize = 3;

/// Where the response is largest, with its singular vectors.
#[derive(Debug, Clone)]
pub(super) struct Peak {
    pub g: f64,
    pub left: Mat<c64>,
    pub right: Mat<c64>,
}

fn complex(a: &Matrix) -> Mat<c64> {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| c64::new(a[(i, j)], 0.0))
}

/// The response at `z`; of a large one by power iteration from `right`.
fn response((a0, e, d): (&Mat<c64>, &Mat<c64>, &Mat<c64>), z: c64, right: &Mat<c64>) -> Peak {
    let n = a0.nrows();
    let lu = Mat::from_fn(n, n, |i, j| if i == j { z - a0[(i, j)] } else { -a0[(i, j)] }).partial_piv_lu();
    if e.nrows() * d.ncols() <= DIRECT {
        // exactly: power iteration may stay at a smaller singular value
        let whole = e * lu.solve(d);
        let finite = (0..whole.ncols()).all(|j| (0..whole.nrows()).all(|i| whole[(i, j)].norm().is_finite()));
        if let Some(svd) = finite.then(|| whole.thin_svd().ok()).flatten() {
            let column = |v: faer::MatRef<'_, c64>| v.subcols(0, 1).to_owned();
            return Peak { g: svd.S().column_vector()[0].re, left: column(svd.U()), right: column(svd.V()) };
        }
    }
    let (mut found, mut right) = (0.0f64, right.clone());
    let mut left = Mat::zeros(e.nrows(), 1);
    for round in 0..60 {
        let y = e * lu.solve(d * &right);
        let g = y.norm_l2();
        if !(g > 0.0 && g.is_finite()) {
            found = if g == 0.0 { 0.0 } else { f64::INFINITY };
            break;
        }
        left = Mat::from_fn(y.nrows(), 1, |i, _| y[(i, 0)] / g);
        let back = d.adjoint() * lu.solve_adjoint(e.adjoint() * &left);
        let size = back.norm_l2();
        right = Mat::from_fn(back.nrows(), 1, |i, _| back[(i, 0)] / size);
        let done = round > 2 && (size - found).abs() <= 1e-7 * size;
        found = size;
        if done {
            break;
        }
    }
    Peak { g: found, left, right }
}

/// The largest response on the circle `|z| = t`, that of the loop `A0 / t`, `D / t`: over a grid of angles, those of
/// the eigenvalues of A0 among them, refined around the best.
pub(super) fn peak(data: &Uncertain, closed: &Closed, t: f64, stop: &Stop) -> Result<Peak> {
    let (e, d) = (complex(&closed.outputs()), complex(&closed.inputs(data)));
    // no vector of a system with simple numbers is orthogonal to this one
    let start =
        Mat::from_fn(d.ncols(), 1, |i, _| c64::new(1.0 + (1.7 * i as f64).sin() / 2.0, (2.3 * i as f64).cos() / 3.0));
    if e.nrows() == 0 || d.ncols() == 0 {
        return Ok(Peak { g: 0.0, left: Mat::zeros(e.nrows(), 1), right: start });
    }
    let a0 = complex(&closed.a0);
    let at_angle = |angle: f64, from: &Mat<c64>| response((&a0, &e, &d), c64::from_polar(t, angle), from);
    let mut angles = Vec::new();
    angles.extend([0.0, std::f64::consts::PI]);
    (0..12).for_each(|k| angles.push(std::f64::consts::PI * 1e-3f64.powf(f64::from(k) / 12.0)));
    (1..24).for_each(|k| angles.push(std::f64::consts::PI * f64::from(k) / 24.0));
    let mut own = eigenvalues(&closed.a0)?;
    own.sort_by(|a, b| b.re.hypot(b.im).total_cmp(&a.re.hypot(a.im)));
    angles.extend(own.iter().take(24).map(|value| value.im.abs().atan2(value.re)));
    angles.sort_by(f64::total_cmp);
    let mut responses = Vec::new();
    for angle in &angles {
        stop.check()?;
        responses.push(at_angle(*angle, &start));
    }
    let g = |k: usize| responses[k].g;
    let top = |k: &usize| (*k == 0 || g(*k) >= g(*k - 1)) && (*k + 1 == angles.len() || g(*k) >= g(*k + 1));
    let mut tops = Vec::new();
    tops.extend((0..angles.len()).filter(top));
    tops.sort_by(|a, b| g(*b).total_cmp(&g(*a)));
    let mut best = responses[tops.first().copied().unwrap_or(0)].clone();
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    for k in tops.into_iter().take(REFINED) {
        let (mut low, mut high) = (angles[k.saturating_sub(1)], angles[(k + 1).min(angles.len() - 1)]);
        let (mut one, mut other) = (high - golden * (high - low), low + golden * (high - low));
        let (mut first, mut second) = (at_angle(one, &responses[k].right), at_angle(other, &responses[k].right));
        for _ in 0..20 {
            if first.g > second.g {
                (high, other, one) = (other, one, other - golden * (other - low));
                (first, second) = (at_angle(one, &first.right), first);
            } else {
                (low, one, other) = (one, other, one + golden * (high - one));
                (first, second) = (second.clone(), at_angle(other, &second.right));
            }
        }
        for found in [first, second] {
            best = if found.g > best.g { found } else { best };
        }
    }
    Ok(best)
}

/// Lowers the norm by the multipliers of several parts: `d log g / d log t_p = (||right_p||^2 - ||left_p||^2) / 2`.
pub(super) fn balanced(data: &Uncertain, mut closed: Closed, stop: &Stop) -> Result<(Closed, Peak)> {
    let mut best = peak(data, &closed, 1.0, stop)?;
    if data.pieces.len() < 2 {
        return Ok((closed, best));
    }
    let (mut now, mut chosen, rounds) = (best.clone(), closed.t.clone(), if data.n <= 30 { 40 } else { 8 });
    for round in 0..rounds {
        let (mut above, mut below) = (0, 0);
        let step = 1.5 * 0.9f64.powi(round);
        for (p, piece) in data.pieces.iter().enumerate() {
            let part = |v: &Mat<c64>, from: usize, count: usize| -> f64 {
                (from..from + count).map(|i| v[(i, 0)].norm_sqr()).sum()
            };
            let (rank, rows) = (closed.e[p].nrows(), piece.rows.len());
            closed.t[p] *= (step * (part(&now.left, above, rank) - part(&now.right, below, rows))).exp();
            (above, below) = (above + rank, below + rows);
        }
        now = peak(data, &closed, 1.0, stop)?;
        if now.g < best.g {
            (best, chosen) = (now.clone(), closed.t.clone());
        }
    }
    closed.t = chosen;
    Ok((closed, best))
}

/// The root of `Q` for the uncertainty `by` times as large and the loop `A0 / t`, `D / t`, solved with `slack` times
/// that and verified; and whether the recursion broke down.
pub(super) fn proof(data: &Uncertain, closed: &Closed, t: f64, by: f64, slack: f64) -> (Option<Matrix>, bool) {
    let (e, d) = (closed.outputs(), scaled(&closed.inputs(data), by * slack));
    match least(&closed.a0, Some(&e), &(&d * d.transpose()), t * t, (1e-3 * (slack - 1.0), data.lift)) {
        Solved::Found(root) => {
            let claim = Claim { root: &root, x: None, alpha: 1.0, lambda: t * t, by };
            (verify(data, closed, &claim).then_some(root), false)
        }
        Solved::Broken => (None, true),
        Solved::Slow => (None, false),
    }
}

/// A proved upper bound of `rho g` on the circle `|z| = t`, where `g` is a lower one: to .1 % where rounding allows,
/// and infinite where there is no proof.
pub(super) fn bound(data: &Uncertain, closed: &Closed, t: f64, g: f64) -> f64 {
    if !g.is_finite() {
        return f64::INFINITY;
    }
    let least = g.max(1e-9);
    for more in [1e-3, 4e-3, 0.02, 0.1, 0.5, 2.0, 10.0] {
        let by = 1.0 / (least * (1.0 + more));
        if proof(data, closed, t, by, 1.0 + 0.5 * more).0.is_some() {
            return least * (1.0 + more);
        }
    }
    f64::INFINITY
}
