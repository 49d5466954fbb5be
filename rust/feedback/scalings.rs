//! How large the channels may be, and the multipliers of their proof: hints by frequencies, proved afterwards.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par, Side, c64};

use crate::error::{Error, Result};
use crate::parallel::Stop;

use super::blocks::Blocks;
use super::data::{Matrix, WHAT, filled, gathered, lost};
use super::spectrum::eigenvalues;

/// The channels at one angle, with the region closed around them: a proof at this angle needs
/// `T > P + Q (S^-1 - N)^-1 Q*`, `S = T gamma^2`.
#[derive(Clone)]
pub(super) struct Reduced {
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
pub(super) const SHARES: [f64; 8] = [0.9995, 0.998, 0.99, 0.97, 0.9, 0.7, 0.4, 0.1];
/// Angles between neighbours nearer than this are not looked at.
const NEAR: f64 = 1e-5;
/// Rounds of finer angles.
pub(super) const ROUNDS_OF_ANGLES: usize = 3;
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
struct Response {
    a: Matrix,
    /// Rows of the parts, and columns.
    parts: (usize, usize),
    /// `[rho D, B]`, C, D.
    inputs: Mat<c64>,
    c: Mat<c64>,
    d: Mat<c64>,
}

impl Response {
    fn new(of: &Blocks) -> Self {
        let (own, b) = (&of.inputs, of.b());
        let all = Mat::from_fn(of.n, own.ncols() + b.ncols(), |i, j| {
            if j < own.ncols() { own[(i, j)] } else { b[(i, j - own.ncols())] }
        });
        let parts = (of.count(), own.ncols());
        Self { a: of.a(), parts, inputs: complex(&all), c: complex(&of.c()), d: complex(&of.d()) }
    }

    /// None where the region alone is too large.
    fn at(&self, angle: f64) -> Option<Reduced> {
        let (n, z) = (self.a.nrows(), c64::from_polar(1.0, angle));
        let lu =
            Mat::from_fn(n, n, |i, j| c64::new(-self.a[(i, j)], 0.0) + if i == j { z } else { c64::new(0.0, 0.0) });
        let whole = &self.c * lu.partial_piv_lu().solve(&self.inputs);
        let (r, left) = self.parts;
        let (l, k) = (whole.nrows() - r, whole.ncols() - left);
        let sound = (0..whole.ncols()).all(|j| (0..whole.nrows()).all(|i| whole[(i, j)].norm().is_finite()));
        if !sound {
            return None;
        }
        let first = whole.submatrix(0, 0, r, left).to_owned();
        let across = whole.submatrix(0, left, r, k) + self.d.subrows(0, r);
        let back = whole.submatrix(r, 0, l, left).to_owned();
        let own = whole.submatrix(r, left, l, k) + self.d.subrows(r, l);
        Reduced::new(&first, across, &back, own)
    }
}

/// R with `R R* = a` for a small `a >= 0`.
fn root(a: &Mat<c64>) -> Option<Mat<c64>> {
    let found = a.self_adjoint_eigen(Side::Lower).ok()?;
    let (values, vectors) = (found.S().column_vector(), found.U());
    Some(Mat::from_fn(a.nrows(), a.nrows(), |i, j| vectors[(i, j)] * values[j].re.max(0.0).sqrt()))
}

impl Reduced {
    /// None where the region alone is too large.
    fn new(first: &Mat<c64>, across: Mat<c64>, back: &Mat<c64>, own: Mat<c64>) -> Option<Self> {
        let triangle = lower(first)?;
        let (y, w) = (solved(&triangle, across), solved(&triangle, first * back.adjoint()));
        Some(Self { p: back * back.adjoint() + w.adjoint() * &w, q: own + w.adjoint() * &y, n: y.adjoint() * &y })
    }

    /// One of several channels of one row and one column each.
    pub fn only(&self, i: usize) -> Self {
        let one = |a: &Mat<c64>| a.submatrix(i, i, 1, 1).to_owned();
        Self { p: one(&self.p), q: one(&self.q), n: one(&self.n) }
    }

    /// At the negative angle.
    pub fn conjugate(&self) -> Self {
        let of = |a: &Mat<c64>| a.conjugate().to_owned();
        Self { p: of(&self.p), q: of(&self.q), n: of(&self.n) }
    }

    /// With `z = .. + own q`.
    pub fn with_own(&self, own: f64) -> Self {
        let mut found = self.clone();
        (0..self.q.nrows()).for_each(|i| found.q[(i, i)] += own);
        found
    }

    /// With `q = centre z + q'`, and q' in place of q a function of z, of z with this `filter`.
    pub fn shifted(&self, filter: c64, centre: c64) -> Option<Self> {
        if self.q.nrows() == 1 {
            let (p, n) = (self.p[(0, 0)].re * filter.norm_sqr(), self.n[(0, 0)].re);
            let (q, open) = (self.q[(0, 0)] * filter, c64::ONE - centre * self.q[(0, 0)] * filter);
            let room = open.norm_sqr() - n * p * centre.norm_sqr();
            let one = |value: c64| Mat::from_fn(1, 1, |_, _| value);
            let (p, n, more) = (p / room, n / room, centre.conj() * (n * p / room));
            let found = Self { p: one(c64::new(p, 0.0)), q: one((q + more) / open), n: one(c64::new(n, 0.0)) };
            return (room > 0.0).then_some(found);
        }
        let own = Mat::from_fn(self.q.nrows(), self.q.ncols(), |i, j| self.q[(i, j)] * filter);
        let each = |a: Mat<c64>, by: c64| Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] * by);
        let eye = Mat::<c64>::identity(own.nrows(), own.ncols());
        let closed = (&eye - each(own.clone(), centre)).partial_piv_lu();
        let (back, own) = (closed.solve(each(root(&self.p)?, filter)), closed.solve(own));
        let half = root(&self.n)?.adjoint().to_owned();
        let across = &half * (eye + each(own.clone(), centre));
        Self::new(&each(&half * &back, centre), across, &back, own)
    }

    /// For channels of gamma `c_j` times a common one: `S_j = T_j c_j^2 gamma^2`.
    fn scaled(mut self, rows: &[f64]) -> Self {
        for (i, row) in rows.iter().enumerate() {
            (0..rows.len()).for_each(|j| self.p[(i, j)] *= row * rows[j]);
            (0..self.q.ncols()).for_each(|j| self.q[(i, j)] *= *row);
        }
        self
    }

    /// `gamma^-2` with `S` of the channels, or `most` if it is below that.
    fn least(&self, s: &[f64], (outs, ins): (&[usize], &[usize]), most: f64, work: &mut Work) -> f64 {
        let (l, k) = (outs.len(), ins.len());
        if l == 1 && k == 1 {
            let room = 1.0 / s[0] - self.n[(0, 0)].re;
            let sum = (self.p[(0, 0)].re + self.q[(0, 0)].norm_sqr() / room) / s[0];
            return if room > 0.0 { sum } else { f64::INFINITY };
        }
        if work.above(self, s, (outs, ins), most) {
            return most;
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

/// The space of a Cholesky factor.
struct Work {
    whole: Mat<c64>,
    memory: MemBuffer,
}

impl Work {
    fn new(size: usize) -> Result<Self> {
        let scratch = cholesky_in_place_scratch::<c64>(size, Par::Seq, Default::default());
        let bytes = scratch.unaligned_bytes_required() as u128;
        let memory = MemBuffer::try_new(scratch).map_err(|_| Error::Memory { what: WHAT, bytes })?;
        Ok(Self { whole: Mat::zeros(size, size), memory })
    }

    /// Whether `[S^-1 - N, Q*; Q, most S - P] > 0`: `gamma^-2` is below `most`.
    fn above(&mut self, of: &Reduced, s: &[f64], (outs, ins): (&[usize], &[usize]), most: f64) -> bool {
        let k = ins.len();
        for (j, channel) in ins.iter().enumerate() {
            (j..k).for_each(|i| self.whole[(i, j)] = -of.n[(i, j)]);
            self.whole[(j, j)] += 1.0 / s[*channel];
            (0..outs.len()).for_each(|i| self.whole[(k + i, j)] = of.q[(i, j)]);
        }
        for (j, channel) in outs.iter().enumerate() {
            (j..outs.len()).for_each(|i| self.whole[(k + i, k + j)] = -of.p[(i, j)]);
            self.whole[(k + j, k + j)] += most * s[*channel];
        }
        let stack = MemStack::new(&mut self.memory);
        cholesky_in_place(self.whole.as_mut(), Default::default(), Par::Seq, stack, Default::default()).is_ok()
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

/// The largest first, so that the others need no eigenvalues.
fn by_size(all: Vec<Reduced>, mut size: impl FnMut(&[Reduced]) -> f64) -> Vec<Reduced> {
    let mut sizes = gathered(all.into_iter().map(|one| (size(std::slice::from_ref(&one)), one)));
    sizes.sort_by(|a, b| b.0.total_cmp(&a.0));
    gathered(sizes.into_iter().map(|one| one.1))
}

/// What channels do at the angles that were looked at.
pub(super) struct Field {
    response: Response,
    at: Vec<(f64, Reduced)>,
}

/// Channels made of those of a field, at an angle; None where the region is too large for them.
pub(super) type View<'a> = &'a dyn Fn(f64, &Reduced) -> Option<Reduced>;

/// Which channels are asked for: the parts of the common size, the channel of each row and of each column, and rounds
/// of finer angles around the largest.
#[derive(Clone, Copy)]
pub(super) struct Asked<'a> {
    pub shares: &'a [f64],
    pub outs: &'a [usize],
    pub ins: &'a [usize],
    pub rounds: usize,
    /// Whether the factors are complex, so that an angle and its negative differ.
    pub both: bool,
}

impl Field {
    /// None where the region alone is too large.
    pub fn new(of: &Blocks, stop: &Stop) -> Result<Option<Self>> {
        let (response, mut at) = (Response::new(of), Vec::new());
        for angle in angles(&response.a).map_err(lost)? {
            stop.check()?;
            let Some(one) = response.at(angle) else { return Ok(None) };
            at.push((angle, one));
        }
        Ok(Some(Self { response, at }))
    }

    /// Angles between the neighbours of this one.
    fn finer(&mut self, at: usize) -> Option<()> {
        let (low, high) = (self.at[at.saturating_sub(1)].0, self.at[(at + 1).min(self.at.len() - 1)].0);
        for k in 1..if high - low > NEAR { 12 } else { 1 } {
            let angle = low + (high - low) * f64::from(k) / 12.0;
            self.at.push((angle, self.response.at(angle)?));
        }
        self.at.sort_by(|a, b| a.0.total_cmp(&b.0));
        Some(())
    }

    /// The channels.
    pub fn count(&self) -> usize {
        self.at.first().map_or(0, |one| one.1.q.nrows())
    }

    /// Whether the region is not too large for what is seen at all angles.
    pub fn stands(&self, view: View<'_>) -> bool {
        self.at.iter().all(|(angle, one)| view(*angle, one).is_some())
    }

    /// The largest common size of the channels.
    pub fn hint(&mut self, of: Asked<'_>, view: View<'_>, stop: &Stop) -> Result<Option<Found>> {
        let shares = of.shares;
        let rows = gathered(of.outs.iter().map(|j| shares[*j]));
        let seen = |at: &[(f64, Reduced)]| {
            let mut all = Vec::new();
            for (angle, one) in at {
                all.push(view(*angle, one)?.scaled(&rows));
                if of.both {
                    all.push(view(-*angle, &one.conjugate())?.scaled(&rows));
                }
            }
            Some(all)
        };
        let Some(mut all) = seen(&self.at) else { return Ok(None) };
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
        let s_of = |logs: &[f64]| gathered(logs.iter().zip(&unit).map(|(log, unit)| unit * 10f64.powf(*log)));
        let mut work = Work::new(of.outs.len() + of.ins.len())?;
        let mut size = |all: &[Reduced], logs: &[f64]| {
            let s = s_of(logs);
            all.iter().fold(0.0f64, |most, one| {
                let v = one.least(&s, (of.outs, of.ins), most, &mut work);
                if v <= most { most } else { v }
            })
        };
        all = by_size(all, |one| size(one, &filled(count, -1.0)));
        for round in 0..of.rounds {
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
            if round + 1 == of.rounds || count > MANY {
                break;
            }
            // finer around the largest
            let each =
                gathered(seen(&self.at).unwrap_or_default().iter().map(|one| size(std::slice::from_ref(one), &logs)));
            let worst = (0..each.len()).max_by(|a, b| each[*a].total_cmp(&each[*b]));
            if self.finer(worst.unwrap_or(0) / if of.both { 2 } else { 1 }).is_none() {
                return Ok(None);
            }
            let Some(finer) = seen(&self.at) else { return Ok(None) };
            all = by_size(finer, |one| size(one, &logs));
        }
        let level = size(&all, &logs).max(1e-200);
        let gamma = level.sqrt().recip();
        let t = gathered((0..count).map(|j| unit[j] * 10f64.powf(logs[j]) / (shares[j] * shares[j]) * level));
        Ok(Some(Found { gamma, t }))
    }
}

/// The largest common size of the channels at the angles; None where the region alone is too large.
pub(super) fn hint(of: &Blocks, shares: &[f64], stop: &Stop) -> Result<Option<Found>> {
    let Some(mut field) = Field::new(of, stop)? else { return Ok(None) };
    let asked = Asked { shares, outs: &of.outs, ins: &of.ins, rounds: ROUNDS_OF_ANGLES, both: false };
    field.hint(asked, &|_, one| Some(one.clone()), stop)
}

/// The largest common size of channels that is proved, with its multipliers; 0 where none is. `most` is enough.
pub(super) fn largest(of: &Blocks, shares: &[f64], most: f64, stop: &Stop) -> Result<(Found, Option<Matrix>)> {
    certified(of, shares, hint(of, shares, stop)?, most, stop)
}

/// The same, of what was found.
pub(super) fn certified(
    of: &Blocks,
    shares: &[f64],
    found: Option<Found>,
    most: f64,
    stop: &Stop,
) -> Result<(Found, Option<Matrix>)> {
    let none = Found { gamma: 0.0, t: filled(shares.len(), 1.0) };
    let Some(found) = found else { return Ok((none, None)) };
    for share in SHARES {
        stop.check()?;
        if let Some((found, root)) = proof_at(of, shares, &found, (share * found.gamma).min(most)) {
            return Ok((found, Some(root)));
        }
    }
    Ok((none, None))
}

/// The proof of a common size below that which was found.
pub(super) fn proof_at(of: &Blocks, shares: &[f64], found: &Found, gamma: f64) -> Option<(Found, Matrix)> {
    let more = (found.gamma / gamma).min(4.0);
    // between the least T and S / gamma^2
    let t = gathered(found.t.iter().map(|t| t * more));
    let gammas = gathered(shares.iter().map(|c| c * gamma));
    let room = (more - 1.0).min(0.5);
    let root = [0.4, 0.05].iter().find_map(|part| of.proof(&gammas, &t, (None, 1.0), 1.0 + part * room))?;
    Some((Found { gamma, t }, root))
}
