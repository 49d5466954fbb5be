//! A member of the region whose loop is unstable, by ascent of the spectral radius.

use faer::linalg::solvers::Solve;
use faer::{Mat, c64};

use crate::error::Result;
use crate::parallel::Stop;

use super::data::{Closed, Matrix, Uncertain, finite, in_units, lost, scaled};
use super::norm::Peak;
use super::spectrum::{eigen, radius};

/// A spectral radius above this is one of an unstable loop.
const UNSTABLE: f64 = 1.0 + 1e-9;

/// `max <G, X>` over `||G||_2 <= rho`, `||G||_F <= phi`, and the factors by which the singular values of X are clipped:
/// with `s_1 >= s_2 >= ..` those of G are `min(rho, c s_i)`.
pub(super) fn clipped(s: &[f64], rho: f64, phi: f64) -> (f64, Vec<f64>) {
    let mut g = Vec::new();
    let kept = s.iter().filter(|v| **v > 0.0).count();
    g.resize(s.len(), 0.0);
    if rho * (kept as f64).sqrt() <= phi {
        g[..kept].fill(rho);
    } else {
        for j in 0..kept {
            let rest: f64 = s[j..kept].iter().map(|v| v * v).sum();
            let c = ((phi * phi - rho * rho * j as f64).max(0.0) / rest).sqrt();
            if c * s[j] <= rho {
                g[..j].fill(rho);
                (j..kept).for_each(|i| g[i] = c * s[i]);
                break;
            }
        }
    }
    (s.iter().zip(&g).map(|(s, g)| s * g).sum(), g)
}

fn furthest(x: &Matrix, rho: f64, phi: f64) -> Result<Matrix> {
    let svd = x.thin_svd().map_err(lost)?;
    let (s, mut values) = (svd.S().column_vector(), Vec::new());
    (0..s.nrows()).for_each(|i| values.push(s[i]));
    let (_, g) = clipped(&values, rho, phi);
    let left = Mat::from_fn(x.nrows(), g.len(), |i, j| svd.U()[(i, j)] * g[j]);
    Ok(left * svd.V().transpose())
}

/// `[A B c]` (n, d) in the units of the data, and its spectral radius; None where none was found.
pub(super) fn unstable(
    data: &Uncertain,
    closed: &Closed,
    peak: Option<&Peak>,
    stop: &Stop,
) -> Result<Option<Vec<f64>>> {
    let mut starts: Vec<Vec<Matrix>> = Vec::new();
    let blocks = |of: &dyn Fn(usize, usize, usize) -> f64| {
        let mut all = Vec::new();
        for (p, piece) in data.pieces.iter().enumerate() {
            all.push(Mat::from_fn(piece.rows.len(), closed.e[p].nrows(), |i, j| of(p, i, j)));
        }
        all
    };
    starts.push(blocks(&|_, _, _| 0.0));
    if let Some(peak) = peak {
        let (mut above, mut below) = (Vec::new(), Vec::new());
        let (mut a, mut b) = (0, 0);
        for (piece, e) in data.pieces.iter().zip(&closed.e) {
            above.push(a);
            below.push(b);
            (a, b) = (a + e.nrows(), b + piece.rows.len());
        }
        for quarter in 0..4 {
            let turn = c64::from_polar(1.0, std::f64::consts::FRAC_PI_4 * f64::from(quarter));
            let entry = |p: usize, i: usize, j: usize| {
                (turn * peak.right[(below[p] + i, 0)] * peak.left[(above[p] + j, 0)].conj()).re
            };
            starts.push(blocks(&entry));
        }
    }
    for seed in 1..5 {
        starts.push(blocks(&|p, i, j| ((1 + p + 7 * i + 13 * j) as f64 * f64::from(seed) * 0.731).sin()));
    }
    for start in starts {
        if let Some(found) = climb(data, closed, start, stop)? {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

fn climb(data: &Uncertain, closed: &Closed, mut direction: Vec<Matrix>, stop: &Stop) -> Result<Option<Vec<f64>>> {
    let mut before = 0.0;
    for _ in 0..30 {
        stop.check()?;
        let (mut a, mut theta) = (closed.a0.clone(), Mat::<f64>::zeros(data.n, data.region.d));
        for ((piece, e), x) in data.pieces.iter().zip(&closed.e).zip(&direction) {
            if x.nrows() == 0 || x.ncols() == 0 || !finite(x) {
                continue;
            }
            let g = &piece.root * scaled(&furthest(x, piece.rho, data.phi)?, 1.0 - 1e-6);
            let (loops, model) = (&g * e, &g * &piece.w);
            for (i, row) in piece.rows.iter().enumerate() {
                (0..data.n).for_each(|j| a[(*row, j)] += loops[(i, j)]);
                (0..data.region.d).for_each(|j| theta[(*row, j)] += model[(i, j)]);
            }
        }
        let (values, vectors) = eigen(&a)?;
        let at = (0..data.n).max_by(|&i, &j| values[i].norm_sqr().total_cmp(&values[j].norm_sqr())).unwrap_or(0);
        let lead = values[at];
        if lead.norm() > UNSTABLE {
            let own = in_region(data, &theta);
            // as the user will see it
            let mut loops = Mat::zeros(data.n, data.n);
            let (d, k) = (data.region.d, in_units(&closed.k, &data.ones(data.m), &data.back()));
            for i in 0..data.n {
                for j in 0..data.n {
                    let input: f64 = (0..data.m).map(|q| own[i * d + data.n + q] * k[(q, j)]).sum();
                    loops[(i, j)] = own[i * d + j] + input;
                }
            }
            if data.region.holds(&own)? && radius(&loops)? > UNSTABLE {
                return Ok(Some(own));
            }
        }
        if lead.norm() <= before * (1.0 + 1e-10) {
            return Ok(None);
        }
        before = lead.norm();
        // d |l|^2 / 2 = <G, Re(conj(l) D' conj(y) (E x)')>, y the left eigenvector with y* x = 1
        let unit = Mat::from_fn(data.n, 1, |i, _| c64::new(f64::from(u8::from(i == at)), 0.0));
        let y = vectors.partial_piv_lu().solve_adjoint(&unit);
        for (p, piece) in data.pieces.iter().enumerate() {
            let count = piece.rows.len();
            let in_root =
                |i: usize| -> c64 { (0..count).map(|q| y[(piece.rows[q], 0)].conj() * piece.root[(q, i)]).sum() };
            let out = |j: usize| -> c64 { (0..data.n).map(|q| vectors[(q, at)] * closed.e[p][(j, q)]).sum() };
            direction[p] = Mat::from_fn(count, closed.e[p].nrows(), |i, j| (lead.conj() * in_root(i) * out(j)).re);
        }
    }
    Ok(None)
}

/// The centre plus this difference, in the units of the data.
fn in_region(data: &Uncertain, difference: &Matrix) -> Vec<f64> {
    let (n, d) = (data.n, data.region.d);
    let mut own = Vec::new();
    for i in 0..n {
        for j in 0..d {
            let column = data.unit.get(j).copied().unwrap_or(1.0);
            let by = if j < n { data.unit[i] / column } else { data.unit[i] };
            own.push(data.region.centre[i * d + j] + by * difference[(i, j)]);
        }
    }
    own
}
