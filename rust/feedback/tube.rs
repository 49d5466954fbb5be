//! How far the states of any member are from those of the centre, under `u = ub + K (x - xb)`, for all time.

use faer::Mat;

use crate::error::{Error, Result};
use crate::identify::normal_quantile;
use crate::memory::{checked_len, covered};
use crate::parallel::Stop;

use super::certificate::{Status, weighted};
use super::data::{Matrix, WHAT, in_units, largest, lost, matrix, scaled, size_of, stacked, trace};
use super::lemma::least;
use super::loops::{Loop, bytes, squares};
use super::member::clipped;
use super::verify::{Claim, verify_alone};

/// For the rounding of all that is not verified, relative.
const ROUNDING: f64 = 1e-6;
/// Shares of the way from 1 to the spectral radius, of the rates that are tried.
const RATES: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 0.93];
/// Steps beyond those asked for, until the states are below `REST` of their start.
const LONGER: usize = 500;
const REST: f64 = 1e-3;
/// Most operations for the sharper bound.
const WORK: f64 = 4e9;

/// A run that is asked about, in the units of the data.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// The state of the centre at first (n).
    pub x0: &'a [f64],
    /// Steps K.
    pub steps: usize,
    /// Inputs of a plan (P, m), before `u = K x`; may be empty.
    pub plan: &'a [f64],
    /// `||x(0) - x0||` is at most this.
    pub start: f64,
    /// Bound of the covariance of Gaussian noise (n, n), and the probability that is given away for it.
    pub noise: Option<(&'a [f64], f64)>,
}

/// Bounds for all members of the region at once; rows are states, then inputs.
#[derive(Debug, Clone)]
pub struct Tube {
    /// Those of the centre (K + 1, n + m).
    pub nominal: Vec<f64>,
    /// What the error of the model adds (K + 1, n + m).
    pub model: Vec<f64>,
    /// What an uncertain start adds (K + 1, n + m).
    pub start: Vec<f64>,
    /// Both in the 2-norm of the states (K + 1).
    pub radii: Vec<f64>,
    /// What noise adds in each of the K steps (n + m), with its probability for all of them together.
    pub noise: Vec<f64>,
    /// The same in the 2-norm of the states.
    pub noise_radius: f64,
    /// `||x(j)||` is at most this for all j >= k, without noise (K + 1 or more); infinite without a bound for all time.
    pub later: Vec<f64>,
    /// `|x_i|` and `|u_j|` are at most this for all time, without noise (n + m).
    pub reach: Vec<f64>,
}

/// What holds of the loop at the rate `t`.
struct Level {
    t: f64,
    /// `||c|| / (1 - theta)` and `theta` times that, for `c_k t^-k`.
    size: f64,
    second: f64,
    /// `sqrt(h' L h)` for each row, and of the 2-norm.
    rows: Vec<f64>,
    norm: f64,
    /// The same of an uncertain start.
    start: Option<(Vec<f64>, f64)>,
    /// `sup_k ||xb_{P + k}|| t^-k`.
    centre: f64,
}

impl Loop {
    fn gramian(&self, a: &Matrix, x: &Matrix, lambda: f64) -> Option<Matrix> {
        let n = self.data.n;
        [1e-9, 1e-7, 1e-5, 1e-3].iter().find_map(|slack| {
            let mut h = scaled(x, 1.0 + slack);
            let more = slack * (trace(x) / n as f64).max(f64::MIN_POSITIVE);
            (0..n).for_each(|i| h[(i, i)] += more);
            let y = least(a, &Mat::zeros(n, n), &h, lambda).found()?;
            verify_alone(a, &Claim { y: &y, x: Some(x), alpha: 1.0, lambda, by: 1.0 }).then_some(y)
        })
    }

    /// States and inputs of the unit ball, as rows (n + m, n) in the units of the loop.
    pub(super) fn rows(&self) -> Matrix {
        let unit = &self.data.unit;
        let states = Mat::from_fn(self.data.n, self.data.n, |i, j| if i == j { unit[i] } else { 0.0 });
        stacked([&states, &self.closed.k], self.data.n)
    }

    /// Bounds along a run. All are infinite unless the gain is certified.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn tube(&self, run: Run<'_>, stop: &Stop) -> Result<Tube> {
        let (n, m) = (self.data.n, self.data.m);
        let square = run.noise.is_none_or(|(covariance, _)| covariance.len() == n * n);
        if run.x0.len() != n || !square {
            let (expected, found) = (format!("{n} entries, as the noise"), run.x0.len().to_string());
            return Err(Error::Shape { name: "x0", expected, found });
        }
        if !run.plan.len().is_multiple_of(m) || run.plan.len() / m > run.steps {
            let expected = format!("at most {} rows of {m}", run.steps);
            return Err(Error::Shape { name: "inputs", expected, found: format!("{} entries", run.plan.len()) });
        }
        let parts: usize = self.data.pieces.iter().zip(&self.closed.e).map(|(p, e)| p.rows.len() * e.nrows()).sum();
        let table = checked_len(WHAT, 10 * (n + m), run.steps + LONGER)? as u128 * 8;
        covered(WHAT, bytes(n, self.data.region.d) + table + 32 * (n * (parts + n)) as u128, || {
            self.tube_of(run, parts, stop)
        })?
    }

    fn tube_of(&self, run: Run<'_>, parts: usize, stop: &Stop) -> Result<Tube> {
        let data = &self.data;
        let (n, m, rows) = (data.n, data.m, self.rows());
        let planned = run.plan.len() / m;
        let forever = data.c.is_none();
        // c of the steps of the plan, or of all steps if the loop does not come to rest at 0
        let summed = if forever { planned } else { run.steps };
        let mut way = Way { of: self, x: Mat::from_fn(n, 1, |i, _| run.x0[i] / data.unit[i]), plan: run.plan, k: 0 };
        let (mut first, mut rested, mut known) = (Vec::new(), way.x.clone(), true);
        for k in 0..=run.steps.max(summed) {
            if k == summed {
                rested = way.x.clone();
            }
            let (c, determined) = way.forcing();
            known &= determined || k >= run.steps;
            if k < summed {
                first.push(c);
            }
            way.step();
        }
        let certified = self.certificate.status == Status::Certified && known;
        let mut levels = Vec::new();
        if certified {
            for share in RATES {
                stop.check()?;
                let t = 1.0 - share * (1.0 - self.certificate.radius);
                levels.extend(self.level(t, &first, &rested, forever, run.start, &rows, stop)?);
            }
        }
        let size = crate::fuse::norm(run.x0.iter().copied()) + run.start;
        let after = |k: usize| {
            let least = |level: &Level| {
                let own = level.norm * level.size + level.start.as_ref().map_or(0.0, |start| start.1);
                level.t.powi(k as i32) * own + level.t.powi((k - summed) as i32) * level.centre
            };
            levels.iter().map(least).fold(f64::INFINITY, f64::min)
        };
        let mut end = run.steps;
        if forever && !levels.is_empty() {
            while end < run.steps + LONGER && after(end + 1) > REST * size {
                end += 1;
            }
        }
        let sharp = (end * n * n) as f64 * (parts + 1) as f64 <= WORK;
        let mut found = self.along(run, end, &levels, sharp, &rows, stop)?;
        let beyond = if forever { after(end + 1) } else { f64::INFINITY };
        let mut later = beyond;
        found.later.iter_mut().rev().for_each(|v| {
            later = later.max(*v);
            *v = later;
        });
        // |h'x| <= ||h|| ||x||, h in the units of the data
        for (i, reach) in found.reach.iter_mut().enumerate() {
            let own = |j: usize| rows[(i, j)] / data.unit[j];
            *reach = reach.max(crate::fuse::norm((0..n).map(own)) * beyond);
        }
        if let Some((covariance, eps)) = run.noise {
            let back = data.back();
            let y = self.smallest(&in_units(&matrix(covariance, n, n), &back, &back), 1.0, &rows);
            let quantile = normal_quantile(&[1.0], 1, eps / ((n + m) * run.steps.max(1)) as f64)? * (1.0 + ROUNDING);
            let y = y.filter(|_| self.certificate.status == Status::Certified);
            found.noise.fill(f64::INFINITY);
            found.noise_radius = f64::INFINITY;
            if let Some(y) = y {
                found.noise.iter_mut().zip(squares(&y, &rows)).for_each(|(to, square)| *to = quantile * square.sqrt());
                found.noise_radius = quantile * trace(&in_units(&y, &data.unit, &data.unit)).sqrt();
            }
        }
        Ok(found)
    }

    #[expect(clippy::too_many_arguments, reason = "what a level depends on")]
    fn level(
        &self,
        t: f64,
        first: &[Vec<f64>],
        rested: &Matrix,
        forever: bool,
        start: f64,
        rows: &Matrix,
        stop: &Stop,
    ) -> Result<Option<Level>> {
        let (data, lambda) = (&self.data, t * t);
        let theta = if t == 1.0 { self.certificate.norm } else { weighted(data, &self.closed, t, stop)? };
        if theta >= 1.0 {
            return Ok(None);
        }
        let (e, d) = (self.closed.outputs(), scaled(&self.closed.inputs(data), 1.0 / t));
        let (a, back) = (&self.closed.a0, self.closed.a0.transpose().to_owned());
        let Some(l) = self.gramian(a, &super::data::symmetric(&(&d * d.transpose())), lambda) else { return Ok(None) };
        let along = |x: &Matrix| {
            let gramian = self.gramian(&back, &super::data::symmetric(x), lambda)?;
            Some((rested.transpose() * gramian * rested)[(0, 0)].max(0.0))
        };
        let own = Mat::from_fn(data.n, data.n, |i, j| if i == j { data.unit[i].powi(2) } else { 0.0 });
        let (rest, centre) =
            if forever { (along(&(e.transpose() * &e)), along(&own)) } else { (Some(0.0), Some(f64::INFINITY)) };
        let (Some(rest), Some(centre)) = (rest, centre) else { return Ok(None) };
        let weight = |k: usize| t.powi(-(k as i32));
        let squared: f64 =
            first.iter().enumerate().map(|(k, c)| (crate::fuse::norm(c.iter().copied()) * weight(k)).powi(2)).sum();
        let size = (squared + rest * weight(first.len()).powi(2)).sqrt() * (1.0 + ROUNDING) / (1.0 - theta);
        let start = if start > 0.0 {
            let x = Mat::from_fn(data.n, data.n, |i, j| if i == j { (start / data.unit[i]).powi(2) } else { 0.0 });
            let Some(y) = self.smallest(&x, lambda, rows) else { return Ok(None) };
            Some(self.sizes(&y, rows)?)
        } else {
            None
        };
        let (rows, norm) = self.sizes(&l, rows)?;
        Ok(Some(Level { t, size, second: theta * size, rows, norm, start, centre: centre.sqrt() * (1.0 + ROUNDING) }))
    }

    /// `sqrt(h'Yh)` for each row, and `sqrt(lam_max(Y))` in the units of the data.
    fn sizes(&self, y: &Matrix, rows: &Matrix) -> Result<(Vec<f64>, f64)> {
        let mut found = squares(y, rows);
        found.iter_mut().for_each(|v| *v = v.sqrt() * (1.0 + ROUNDING));
        let norm = largest(&super::data::symmetric(&in_units(y, &self.data.unit, &self.data.unit)))?;
        Ok((found, norm.sqrt() * (1.0 + ROUNDING)))
    }

    /// The bounds step by step, to `end`; without a level they are infinite from the first step on.
    fn along(
        &self,
        run: Run<'_>,
        end: usize,
        levels: &[Level],
        sharp: bool,
        rows: &Matrix,
        stop: &Stop,
    ) -> Result<Tube> {
        let data = &self.data;
        let (n, q) = (data.n, data.n + data.m);
        let mut tube = Tube {
            nominal: Vec::new(),
            model: Vec::new(),
            start: Vec::new(),
            radii: Vec::new(),
            noise: Vec::new(),
            noise_radius: 0.0,
            later: Vec::new(),
            reach: Vec::new(),
        };
        tube.noise.resize(q, 0.0);
        tube.reach.resize(q, 0.0);
        let mut way = Way { of: self, x: Mat::from_fn(n, 1, |i, _| run.x0[i] / data.unit[i]), plan: run.plan, k: 0 };
        // sum_j (c_j)_i A0^(k-1-j) D, side by side for all i, of each part
        let (mut sums, mut roots) = (Vec::new(), Vec::new());
        for (piece, e) in data.pieces.iter().zip(&self.closed.e) {
            let mut root = Mat::<f64>::zeros(n, piece.rows.len());
            for (i, row) in piece.rows.iter().enumerate() {
                (0..piece.rows.len()).for_each(|j| root[(*row, j)] = piece.root[(i, j)]);
            }
            sums.push(Mat::<f64>::zeros(n, if sharp { piece.rows.len() * e.nrows() } else { 0 }));
            roots.push(root);
        }
        let d = self.closed.inputs(data);
        let (forcing, mut l) = (&d * d.transpose(), Mat::<f64>::zeros(n, n));
        for k in 0..=end {
            stop.check()?;
            let u = way.input();
            let power = |level: &Level| level.t.powi(k as i32);
            let least = |f: &dyn Fn(&Level) -> f64| levels.iter().map(f).fold(f64::INFINITY, f64::min);
            // causal sums at t = 1, where `L_k` is that of k steps
            let partial = levels.iter().find(|level| level.t == 1.0);
            let (mut own, mut whole) = (squares(&l, rows), 0.0);
            own.iter_mut().for_each(|v| *v = v.sqrt() * (1.0 + ROUNDING));
            if partial.is_some() {
                whole =
                    largest(&super::data::symmetric(&in_units(&l, &data.unit, &data.unit)))?.sqrt() * (1.0 + ROUNDING);
            }
            let (mut model, mut start) = ([0.0f64, 0.0], Vec::new());
            let mut squared = 0.0;
            for h in 0..q {
                let plain = partial.map_or(f64::INFINITY, |level| own[h] * level.size);
                let second = partial.map_or(f64::INFINITY, |level| own[h] * level.second);
                let mut bound = plain.min(least(&|level| power(level) * level.rows[h] * level.size));
                if sharp && !levels.is_empty() {
                    let mut linear = 0.0;
                    for ((piece, e), sum) in data.pieces.iter().zip(&self.closed.e).zip(&sums) {
                        linear += first_order(
                            &rows.subrows(h, 1).to_owned(),
                            sum,
                            (e.nrows(), piece.rows.len()),
                            piece.rho,
                            data.phi,
                        )?;
                    }
                    let second = second.min(least(&|level| power(level) * level.rows[h] * level.second));
                    bound = bound.min(linear * (1.0 + ROUNDING) + second);
                }
                let bound = if k == 0 { 0.0 } else { bound };
                let first = least(&|level| level.start.as_ref().map_or(0.0, |start| power(level) * start.0[h]));
                let length = || crate::fuse::norm((0..n).map(|j| rows[(h, j)] / data.unit[j]));
                start.push(match k {
                    _ if run.start <= 0.0 => 0.0,
                    0 => first.min(run.start * length()),
                    _ => first,
                });
                if h < n {
                    squared += bound * bound;
                }
                if k <= run.steps {
                    tube.model.push(bound);
                }
                let nominal = if h < n { way.x[(h, 0)] * data.unit[h] } else { u[(h - n, 0)] };
                if k <= run.steps {
                    tube.nominal.push(nominal);
                }
                tube.reach[h] = tube.reach[h].max(nominal.abs() + bound + start[h]);
            }
            model[0] = squared.sqrt();
            model[1] = partial.map_or(f64::INFINITY, |level| whole * level.size);
            model[1] = model[1].min(least(&|level| power(level) * level.norm * level.size));
            if let ([piece], [sum], [e], true) =
                (data.pieces.as_slice(), sums.as_slice(), self.closed.e.as_slice(), sharp && k > 0)
            {
                // ||vec(G)|| <= phi
                let phi = data.phi.min(piece.rho * (piece.rows.len().min(e.nrows()) as f64).sqrt());
                let square = super::data::symmetric(&in_units(&(sum * sum.transpose()), &data.unit, &data.unit));
                let second = partial.map_or(f64::INFINITY, |level| whole * level.second);
                let second = second.min(least(&|level| power(level) * level.norm * level.second));
                model[1] = model[1].min(phi * largest(&square)?.sqrt() * (1.0 + ROUNDING) + second);
            }
            let first = least(&|level| level.start.as_ref().map_or(0.0, |start| power(level) * start.1));
            let first = if run.start > 0.0 { first } else { 0.0 };
            let radius = if k == 0 { first.min(run.start) } else { model[0].min(model[1]) + first };
            if k <= run.steps {
                tube.radii.push(radius);
                tube.start.extend_from_slice(&start);
            }
            tube.later.push(crate::fuse::norm((0..n).map(|i| way.x[(i, 0)] * data.unit[i])) + radius);
            if sharp {
                let mut at = 0;
                let (c, _) = way.forcing();
                for ((sum, root), (e, t)) in sums.iter_mut().zip(&roots).zip(self.closed.e.iter().zip(&self.closed.t)) {
                    let rank = e.nrows();
                    let mut next = &self.closed.a0 * &*sum;
                    for i in 0..rank {
                        for j in 0..root.ncols() {
                            (0..n).for_each(|a| next[(a, i * root.ncols() + j)] += c[at + i] * t.sqrt() * root[(a, j)]);
                        }
                    }
                    *sum = next;
                    at += rank;
                }
            }
            l = &self.closed.a0 * &l * self.closed.a0.transpose() + &forcing;
            way.step();
        }
        Ok(tube)
    }
}

/// `max <G, X>` of one part, `X = sum_j D' A0'^(k-1-j) h c_j'`, whose entries are those of `h sum`.
fn first_order(h: &Matrix, sum: &Matrix, (rank, rows): (usize, usize), rho: f64, phi: f64) -> Result<f64> {
    let line = h * sum;
    if rank == 0 || rows == 0 {
        return Ok(0.0);
    }
    let unit = size_of(&line);
    let x = Mat::from_fn(rank, rows, |i, j| line[(0, i * rows + j)] / unit);
    Ok(unit * clipped(&x.singular_values().map_err(lost)?, rho, phi).0)
}

/// The centre along the run.
struct Way<'a> {
    of: &'a Loop,
    x: Matrix,
    plan: &'a [f64],
    k: usize,
}

impl Way<'_> {
    fn input(&self) -> Matrix {
        let m = self.of.data.m;
        match self.plan.chunks_exact(m).nth(self.k) {
            Some(row) => Mat::from_fn(m, 1, |j, _| row[j]),
            None => &self.of.closed.k * &self.x,
        }
    }

    /// `T^(-1/2) W z` of all parts, and whether the data determine `Theta z`.
    fn forcing(&self) -> (Vec<f64>, bool) {
        let (data, u) = (&self.of.data, self.input());
        let z = Mat::from_fn(data.region.d, 1, |i, _| match i {
            i if i < data.n => self.x[(i, 0)],
            i if i < data.n + data.m => u[(i - data.n, 0)],
            _ => 1.0,
        });
        let (mut c, mut own) = (Vec::new(), Vec::new());
        for (piece, t) in data.pieces.iter().zip(&self.of.closed.t) {
            let part = &piece.w * &z;
            c.extend((0..part.nrows()).map(|i| part[(i, 0)] / t.sqrt()));
        }
        own.extend((0..data.region.d).map(|i| z[(i, 0)] * data.unit.get(i).copied().unwrap_or(1.0)));
        (c, data.determined(&own))
    }

    fn step(&mut self) {
        let data = &self.of.data;
        let mut next = &data.a * &self.x + &data.b * self.input();
        if let Some(c) = &data.c {
            next += c;
        }
        self.x = next;
        self.k += 1;
    }
}
