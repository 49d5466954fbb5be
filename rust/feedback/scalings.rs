//! How large the channels may be, and the multipliers of their proof: hints by frequencies, proved afterwards.

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side, c64};

use crate::error::Result;
use crate::parallel::Stop;

use super::blocks::Blocks;
use super::data::{Matrix, filled, gathered, lost};
use super::spectrum::eigenvalues;

/// The channels at one angle, with the region closed around them: a proof at this angle needs
/// `T > P + Q (S^-1 - N)^-1 Q*`, `S = T gamma^2`.
struct Reduced {
    p: Mat<c64>,
    q: Mat<c64>,
    n: Mat<c64>,
}

/// What is found for channels of gamma `c_j` times a common one: the largest common one, and multipliers for it.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub gamma: f64,
    pub t: Vec<f64>,
}

/// Parts of what the frequencies allow that are tried, and how much larger than that the proof is solved.
const SHARES: [f64; 8] = [0.9995, 0.998, 0.99, 0.97, 0.9, 0.7, 0.4, 0.1];
/// Rounds over the channels, each by itself.
const ROUNDS: usize = 2;
/// Channels above which all have one multiplier in units of what is allowed of each by itself.
const MANY: usize = 8;

fn complex(a: &Matrix) -> Mat<c64> {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| c64::new(a[(i, j)], 0.0))
}

/// The lower triangle L with `L L* = I - a a*`.
fn lower(a: &Mat<c64>) -> Option<Mat<c64>> {
    let room = Mat::<c64>::identity(a.nrows(), a.nrows()) - a * a.adjoint();
    room.llt(Side::Lower).ok().map(|l| l.L().to_owned())
}

fn solved(l: &Mat<c64>, mut a: Mat<c64>) -> Mat<c64> {
    solve_lower_triangular_in_place(l.as_ref(), a.as_mut(), Par::Seq);
    a
}

fn angles(a: &Matrix) -> Result<Vec<f64>> {
    let mut all = Vec::new();
    all.extend([0.0, std::f64::consts::PI]);
    (0..16).for_each(|k| all.push(std::f64::consts::PI * 1e-4f64.powf(f64::from(k) / 16.0)));
    (1..24).for_each(|k| all.push(std::f64::consts::PI * f64::from(k) / 24.0));
    let mut own = eigenvalues(a)?;
    own.sort_by(|a, b| b.norm().total_cmp(&a.norm()));
    all.extend(own.iter().take(24).map(|value| value.im.abs().atan2(value.re)));
    all.sort_by(f64::total_cmp);
    all.dedup();
    Ok(all)
}

/// The matrices of the loop as complex numbers.
struct Response<'a> {
    of: &'a Blocks,
    a: Matrix,
    /// `[rho D, B]`, C, D.
    inputs: Mat<c64>,
    c: Mat<c64>,
    d: Mat<c64>,
}

impl<'a> Response<'a> {
    fn new(of: &'a Blocks) -> Self {
        let (own, b) = (&of.inputs, of.b());
        let all = Mat::from_fn(of.n, own.ncols() + b.ncols(), |i, j| {
            if j < own.ncols() { own[(i, j)] } else { b[(i, j - own.ncols())] }
        });
        Self { of, a: of.a(), inputs: complex(&all), c: complex(&of.c()), d: complex(&of.d()) }
    }

    /// None where the region alone is too large.
    fn at(&self, angle: f64) -> Option<Reduced> {
        let (n, z) = (self.of.n, c64::from_polar(1.0, angle));
        let lu =
            Mat::from_fn(n, n, |i, j| c64::new(-self.a[(i, j)], 0.0) + if i == j { z } else { c64::new(0.0, 0.0) });
        let whole = &self.c * lu.partial_piv_lu().solve(&self.inputs);
        let (r, left) = (self.of.count(), self.of.inputs.ncols());
        let (l, k) = (whole.nrows() - r, whole.ncols() - left);
        let sound = (0..whole.ncols()).all(|j| (0..whole.nrows()).all(|i| whole[(i, j)].norm().is_finite()));
        if !sound {
            return None;
        }
        let first = whole.submatrix(0, 0, r, left).to_owned();
        let across = whole.submatrix(0, left, r, k) + self.d.subrows(0, r);
        let back = whole.submatrix(r, 0, l, left).to_owned();
        let own = whole.submatrix(r, left, l, k) + self.d.subrows(r, l);
        let triangle = lower(&first)?;
        let (y, w) = (solved(&triangle, across), solved(&triangle, &first * back.adjoint()));
        Some(Reduced { p: &back * back.adjoint() + w.adjoint() * &w, q: own + w.adjoint() * &y, n: y.adjoint() * &y })
    }
}

impl Reduced {
    /// For channels of gamma `c_j` times a common one: `S_j = T_j c_j^2 gamma^2`.
    fn scaled(&self, rows: &[f64]) -> Self {
        let l = rows.len();
        let p = Mat::from_fn(l, l, |i, j| self.p[(i, j)] * (rows[i] * rows[j]));
        let q = Mat::from_fn(l, self.q.ncols(), |i, j| self.q[(i, j)] * rows[i]);
        Self { p, q, n: self.n.clone() }
    }

    /// `gamma^-2` with `S` of the channels.
    fn least(&self, s: &[f64], (outs, ins): (&[usize], &[usize])) -> f64 {
        let (l, k) = (outs.len(), ins.len());
        if l == 1 && k == 1 {
            let room = 1.0 / s[0] - self.n[(0, 0)].re;
            let sum = (self.p[(0, 0)].re + self.q[(0, 0)].norm_sqr() / room) / s[0];
            return if room > 0.0 { sum } else { f64::INFINITY };
        }
        let mut room = Mat::from_fn(k, k, |i, j| -(self.n[(i, j)] + self.n[(j, i)].conj()) * 0.5);
        (0..k).for_each(|j| room[(j, j)] += 1.0 / s[ins[j]]);
        let Ok(triangle) = room.llt(Side::Lower) else { return f64::INFINITY };
        let half = solved(&triangle.L().to_owned(), self.q.adjoint().to_owned());
        let sum = &self.p + half.adjoint() * &half;
        let root = |i: usize| s[outs[i]].sqrt();
        let sum = Mat::from_fn(l, l, |i, j| (sum[(i, j)] + sum[(j, i)].conj()) * (0.5 / root(i) / root(j)));
        sum.self_adjoint_eigenvalues(Side::Lower).map_or(f64::INFINITY, |all| all.last().map_or(0.0, |v| v.max(0.0)))
    }
}

/// Where a function of one number is least, and that value: a grid and golden sections.
fn least((low, high): (f64, f64), count: usize, mut f: impl FnMut(f64) -> f64) -> (f64, f64) {
    let (step, mut best) = ((high - low) / count as f64, (low, f64::INFINITY));
    for k in 0..=count {
        let x = low + step * k as f64;
        let found = f(x);
        best = if found < best.1 { (x, found) } else { best };
    }
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    let (mut left, mut right) = ((best.0 - step).max(low), (best.0 + step).min(high));
    for _ in 0..if count > 20 { 18 } else { 8 } {
        let (one, other) = (right - golden * (right - left), left + golden * (right - left));
        let (first, second) = (f(one), f(other));
        for (x, found) in [(one, first), (other, second)] {
            best = if found < best.1 { (x, found) } else { best };
        }
        if first < second { right = other } else { left = one }
    }
    best
}

/// The largest common size of the channels at the angles; None where the region alone is too large.
pub(super) fn hint(of: &Blocks, shares: &[f64], stop: &Stop) -> Result<Option<Found>> {
    let response = Response::new(of);
    let mut grid = angles(&response.a).map_err(lost)?;
    let rows = gathered(of.outs.iter().map(|j| shares[*j]));
    let mut all = Vec::new();
    for angle in &grid {
        stop.check()?;
        let Some(one) = response.at(*angle) else { return Ok(None) };
        all.push(one.scaled(&rows));
    }
    let count = shares.len();
    // S in units of what is allowed, each channel by itself
    let mut unit = filled(count, f64::INFINITY);
    for one in &all {
        for (j, channel) in of.ins.iter().enumerate() {
            unit[*channel] = unit[*channel].min(1.0 / one.n[(j, j)].re.max(1e-300));
        }
    }
    for (j, unit) in unit.iter_mut().enumerate() {
        *unit = if *unit < 1e290 { *unit } else { shares[j] * shares[j] };
    }
    let mut logs = filled(count, 0.0);
    let size = |all: &[Reduced], logs: &[f64]| {
        let s = gathered(logs.iter().zip(&unit).map(|(log, unit)| unit * 10f64.powf(*log)));
        all.iter().map(|one| one.least(&s, (&of.outs, &of.ins))).fold(
            0.0f64,
            |most, v| {
                if v <= most { most } else { v }
            },
        )
    };
    for round in 0..3 {
        stop.check()?;
        let mut best = if round == 0 { f64::INFINITY } else { size(&all, &logs) };
        let fine = if count == 1 { 24 } else { 10 };
        let (log, found) = least((-9.0, 0.0), fine, |log| size(&all, &filled(count, log)));
        if found < best {
            (logs, best) = (filled(count, log), found);
        }
        for _ in 0..if (2..=MANY).contains(&count) { ROUNDS } else { 0 } {
            for j in 0..count {
                let (from, at) = (logs.clone(), logs[j]);
                let with = |log: f64| {
                    let mut one = from.clone();
                    one[j] = log;
                    one
                };
                let (log, found) = least((at - 1.5, (at + 1.5).min(1.0)), 4, |log| size(&all, &with(log)));
                if found < best {
                    (logs, best) = (with(log), found);
                }
            }
        }
        if round == 2 || count > MANY {
            break;
        }
        // finer around the largest
        let worst = (0..all.len()).max_by(|a, b| size(&all[*a..=*a], &logs).total_cmp(&size(&all[*b..=*b], &logs)));
        let at = worst.unwrap_or(0);
        let (low, high) = (grid[at.saturating_sub(1)], grid[(at + 1).min(grid.len() - 1)]);
        for k in 1..12 {
            let angle = low + (high - low) * f64::from(k) / 12.0;
            let Some(one) = response.at(angle) else { return Ok(None) };
            grid.push(angle);
            all.push(one.scaled(&rows));
        }
        let mut order = gathered(0..grid.len());
        order.sort_by(|a, b| grid[*a].total_cmp(&grid[*b]));
        grid = gathered(order.iter().map(|k| grid[*k]));
        let mut old = gathered(all.into_iter().map(Some));
        all = gathered(order.iter().filter_map(|k| old[*k].take()));
    }
    let level = size(&all, &logs).max(1e-200);
    let gamma = level.sqrt().recip();
    let t = gathered((0..count).map(|j| unit[j] * 10f64.powf(logs[j]) / (shares[j] * shares[j]) * level));
    Ok(Some(Found { gamma, t }))
}

/// The largest common size of channels that is proved, with its multipliers; 0 where none is. `most` is enough.
pub(super) fn largest(of: &Blocks, shares: &[f64], most: f64, stop: &Stop) -> Result<(Found, Option<Matrix>)> {
    let none = Found { gamma: 0.0, t: filled(shares.len(), 1.0) };
    let Some(found) = hint(of, shares, stop)? else { return Ok((none, None)) };
    for share in SHARES {
        stop.check()?;
        let gamma = (share * found.gamma).min(most);
        let more = (found.gamma / gamma).min(4.0);
        // between the least T and S / gamma^2
        let t = gathered(found.t.iter().map(|t| t * more));
        let gammas = gathered(shares.iter().map(|c| c * gamma));
        let room = (more - 1.0).min(0.5);
        for slack in [1.0 + 0.4 * room, 1.0 + 0.05 * room] {
            if let Some(root) = of.proof(&gammas, &t, (None, 1.0), slack) {
                return Ok((Found { gamma, t }, Some(root)));
            }
        }
    }
    Ok((none, None))
}
