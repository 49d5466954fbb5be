//! How far the states of any member are from those of the centre, under `u = ub + K (x - xb)`, for all time: what holds
//! at each rate of decay, and beyond the last step. The steps themselves are in `along`.

use faer::Mat;

use crate::error::{Error, Result};
use crate::identify::normal_quantile;
use crate::memory::{checked_len, covered, try_collect};
use crate::parallel::Stop;

use super::certificate::{Verdict, weighted};
use super::data::{Matrix, REPEATED, WHAT, in_units, largest, matrix, scaled, stacked, symmetric};
use super::lemma::least;
use super::loops::{Loop, bytes, squares};
use super::verify::{Claim, verify_alone};
use super::way::Way;

/// For the rounding of all that is not verified, relative.
pub(super) const ROUNDING: f64 = 1e-6;
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
    /// The set point (xs, us) of `u = us + K (x - xs)`, beside which the members rest.
    pub rest: Option<(&'a [f64], &'a [f64])>,
    /// Bound of the covariance of Gaussian noise (n, n), and the probability that is given away for it.
    pub noise: Option<(&'a [f64], f64)>,
}

/// Bounds for all members of the region at once; rows are states, then inputs.
#[derive(Debug, Clone)]
#[non_exhaustive]
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
    /// `||x(j)||`, of the distance from the point of rest, is at most this for all j >= k, without noise (K + 1 or
    /// more); infinite without a bound for all time.
    pub later: Vec<f64>,
    /// `|x_i|` and `|u_j|` are at most this for all time, without noise (n + m).
    pub reach: Vec<f64>,
}

/// What holds of the loop at the rate `t`.
pub(super) struct Level {
    pub t: f64,
    /// `||c|| / (1 - theta)` and `theta` times that, for `c_k t^-k`.
    pub size: f64,
    pub second: f64,
    /// `sqrt(h' L h)` for each row, and of the 2-norm.
    pub rows: Vec<f64>,
    pub norm: f64,
    /// The same of an uncertain start, and of the distance of the point of rest.
    pub start: Option<(Vec<f64>, f64)>,
    pub rest: Option<(Vec<f64>, f64)>,
    /// `sup_k ||xb_{P + k}|| t^-k`.
    pub centre: f64,
}

impl Loop {
    /// The root of `L` with `A L A' / lambda + X <= L`, proved.
    pub(super) fn gramian(&self, a: &Matrix, x: &Matrix, lambda: f64) -> Option<Matrix> {
        // where nothing stirs up a state, as an input in filters behind a delay, with more of a lift
        let lifts = [self.data.lift, REPEATED];
        lifts.iter().flat_map(|lift| [1e-9, 1e-7, 1e-5, 1e-3].map(|slack| (slack, *lift))).find_map(|(slack, lift)| {
            let root = least(a, None, &scaled(x, 1.0 + slack), lambda, (slack, lift)).found()?;
            verify_alone(a, &Claim { root: &root, x: Some(x), alpha: 1.0, lambda, by: 1.0 }).then_some(root)
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
        let (n, q) = (self.data.n, self.data.n + self.data.m);
        let mut found = match run.rest {
            None => self.along_run(run, stop)?,
            Some((xs, us)) => {
                let (x, u) = self.centre_at_rest(xs, us)?;
                let begin = try_collect(WHAT, run.x0.iter().zip(&x).map(|(x0, x)| x0 - x))?;
                let mut found = self.along_run(Run { x0: &begin, rest: Some((&x, &u)), ..run }, stop)?;
                // the same inputs as a plan: what W z_s adds over K steps, sharper than its sum for ever
                let inputs = found.nominal.chunks_exact(q).take(run.steps).flat_map(|row| row[n..].iter().copied());
                let plan = try_collect(WHAT, inputs)?;
                let along = self.along_run(Run { plan: &plan, rest: None, noise: None, ..run }, stop)?;
                found.model.iter_mut().zip(along.model).for_each(|(to, other)| *to = to.min(other));
                found.radii.iter_mut().zip(along.radii).for_each(|(to, other)| *to = to.min(other));
                found
            }
        };
        let Tube { model, start, radii, noise, noise_radius, later, reach, .. } = &mut found;
        for bounds in [model, start, radii, noise, later, reach] {
            bounds.iter_mut().filter(|bound| bound.is_nan()).for_each(|bound| *bound = f64::INFINITY);
        }
        *noise_radius = if noise_radius.is_nan() { f64::INFINITY } else { *noise_radius };
        Ok(found)
    }

    /// Of a run about a set point `x0` and the states and inputs of the centre are differences from where the centre
    /// rests.
    fn along_run(&self, run: Run<'_>, stop: &Stop) -> Result<Tube> {
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
        let forever = data.c.is_none() || run.rest.is_some();
        // c of the steps of the plan, or of all steps if the loop does not come to rest at 0
        let summed = if forever { planned } else { run.steps };
        let mut way = Way {
            of: self,
            x: Mat::from_fn(n, 1, |i, _| run.x0[i] / data.unit[i]),
            plan: run.plan,
            k: 0,
            about_rest: run.rest.is_some(),
        };
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
        let beside = run.rest.map(|(xs, us)| self.spread_at_rest(xs, us)).transpose()?;
        let certified = self.certificate.status == Verdict::Certified && known && beside != Some(None);
        let (beside, mut levels) = (beside.flatten(), Vec::new());
        if certified {
            for share in RATES {
                stop.check()?;
                let t = 1.0 - share * (1.0 - self.certificate.radius);
                levels.extend(self.level(t, &first, &rested, forever, (run.start, beside.as_ref()), &rows, stop)?);
            }
        }
        let size = crate::fuse::norm(run.x0.iter().copied()) + run.start;
        let after = |k: usize| {
            let least = |level: &Level| {
                let begun = [&level.start, &level.rest].into_iter().flatten().map(|start| start.1).sum::<f64>();
                let own = level.norm * level.size + begun;
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
        // the exact first order is that of one constant member
        let sharp = (end * n * n) as f64 * (parts + 1) as f64 <= WORK && data.misfits.is_empty();
        let offset = run.rest.map(|(xs, us)| self.rest(xs, us)).transpose()?.unwrap_or_default();
        let mut found = self.along(run, &offset, end, &levels, sharp, &rows, stop)?;
        let beyond = if forever { after(end + 1) } else { f64::INFINITY };
        let mut later = beyond;
        found.later.iter_mut().rev().for_each(|v| {
            later = later.max(*v);
            *v = later;
        });
        // |h'x| <= ||h|| ||x||, h in the units of the data
        for (i, reach) in found.reach.iter_mut().enumerate() {
            let own = |j: usize| rows[(i, j)] / data.unit[j];
            let point = run.rest.and_then(|(xs, us)| xs.iter().chain(us).nth(i)).map_or(0.0, |v| v.abs());
            let point = point + offset.0.get(i).copied().unwrap_or(0.0);
            *reach = reach.max(point + crate::fuse::norm((0..n).map(own)) * beyond);
        }
        if let Some((covariance, eps)) = run.noise {
            let back = data.back();
            let root = self.smallest(&in_units(&matrix(covariance, n, n), &back, &back), 1.0, &rows);
            let quantile = normal_quantile(&[1.0], 1, eps / ((n + m) * run.steps.max(1)) as f64)? * (1.0 + ROUNDING);
            let root = root.filter(|_| self.certificate.status == Verdict::Certified);
            found.noise.fill(f64::INFINITY);
            found.noise_radius = f64::INFINITY;
            if let Some(root) = root {
                let sizes = squares(&root, &rows);
                found.noise.iter_mut().zip(sizes).for_each(|(to, square)| *to = quantile * square.sqrt());
                found.noise_radius = quantile * in_units(&root, &data.unit, &data.ones(n)).norm_l2();
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
        (start, beside): (f64, Option<&Matrix>),
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
        let Some(l) = self.gramian(a, &symmetric(&(&d * d.transpose())), lambda) else { return Ok(None) };
        let along =
            |x: &Matrix| Some((self.gramian(&back, &symmetric(x), lambda)?.transpose() * rested).squared_norm_l2());
        let own = Mat::from_fn(data.n, data.n, |i, j| if i == j { data.unit[i].powi(2) } else { 0.0 });
        let (rest, centre) =
            if forever { (along(&(e.transpose() * &e)), along(&own)) } else { (Some(0.0), Some(f64::INFINITY)) };
        let (Some(rest), Some(centre)) = (rest, centre) else { return Ok(None) };
        let weight = |k: usize| t.powi(-(k as i32));
        let squared: f64 =
            first.iter().enumerate().map(|(k, c)| (crate::fuse::norm(c.iter().copied()) * weight(k)).powi(2)).sum();
        let size = (squared + rest * weight(first.len()).powi(2)).sqrt() * (1.0 + ROUNDING) / (1.0 - theta);
        let ball = |i: usize, j: usize| if i == j { (start / data.unit[i]).powi(2) } else { 0.0 };
        let ball = (start > 0.0).then(|| Mat::from_fn(data.n, data.n, ball));
        let mut begun = [None, None];
        for (to, x) in begun.iter_mut().zip([ball.as_ref(), beside]) {
            if let Some(x) = x {
                let Some(root) = self.smallest(x, lambda, rows) else { return Ok(None) };
                *to = Some(self.sizes(&root, rows)?);
            }
        }
        let [start, rest] = begun;
        let (rows, norm) = self.sizes(&l, rows)?;
        Ok(Some(Level {
            t,
            size,
            second: theta * size,
            rows,
            norm,
            start,
            rest,
            centre: centre.sqrt() * (1.0 + ROUNDING),
        }))
    }

    /// `sqrt(h'Yh)` for each row, and `sqrt(lam_max(Y))` in the units of the data, from the root of Y.
    fn sizes(&self, root: &Matrix, rows: &Matrix) -> Result<(Vec<f64>, f64)> {
        let mut found = squares(root, rows);
        found.iter_mut().for_each(|v| *v = v.sqrt() * (1.0 + ROUNDING));
        let own = in_units(root, &self.data.unit, &self.data.ones(self.data.n));
        let norm = largest(&symmetric(&(&own * own.transpose())))?;
        Ok((found, norm.sqrt() * (1.0 + ROUNDING)))
    }
}
