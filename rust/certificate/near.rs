//! The certificate of a plan near a reference that was fixed before the noise of the data.
//!
//! With the model H of [`Pilot`], `c_j = T z(j)` along a plan and `p_j = K - 1 - j`, the error is
//!
//! ```text
//! e(K) = - sum_j A^p_j S^(1/2) Gamma c_j + sum_j A^p_j Delta_x e(j),    Delta_x = - S^(1/2) Gamma T_x.
//! ```
//!
//! Along the plan of the pilot for a task fixed beforehand, `g_j = (R^-1)' z0(j)` and the pilot's A0 do not depend on Gamma:
//! `F = sum_j A0^p_j S^(1/2) Gamma g_j` is Gaussian of covariance `C0 = sum_jk (g_j' g_k) A0^p_j S A0^p_k'`, exactly. So for every
//! s, every plan, start and target at once, with `q` the quantile of `||F||`,
//!
//! ```text
//! ||x(K) - xf|| <= ||xh(K) - xf|| + |s| q + mismatch(s) + rest
//! mismatch(s) = the largest ||sum_j A^p_j S^(1/2) Gamma c_j - s A0^p_j S^(1/2) Gamma g_j|| over the bounds of Gamma
//! rest        = spectral wcs(A^p_j S^(1/2), b_j),    b_j >= ||T_x e(j)||.
//! ```
//!
//! `b_j` is that of [`super::several_steps`], or what the same split of `T_x e(j)` gives with a quantile of its own. Noise of the
//! run to come adds `sum_p A0^p w` to F, which is independent of it, with s = 1; `drift`, the quantile of
//! `sum_p (A^p - A0^p) w`, to the mismatch; and `nu_j` to `b_j`.

use crate::error::{Error, Result};
use crate::fuse::{distance, norm};
use crate::identify::{
    Symmetric, chi2_upper, coarse_normal_quantile, covariance_root, normal_quantile, smallest, spectral_norm,
};
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Region, times};

use super::noise::Gaussian;
use super::nuclear::EFFORT;
use super::pilot::{Event, Pilot, WHAT};
use super::plan::Task;
use super::powers::{Powers, first_order, largest_difference, product};
use super::reference::{Reference, Shares};
use super::several_steps::{Radii, Seen, Steps, norms, several_steps};
use super::trajectory::states;

/// Shares of noise and of a declared difference that are tried: see `Difference::joined`.
const SHARES: [f64; 5] = [1.0 / 16.0, 0.25, 1.0, 4.0, 16.0];

/// What holds near a reference: `target`, `tube` and `components` are each a statement of its own.
#[derive(Debug, Clone)]
pub struct Near {
    /// `||x(K) - xf|| <= target = reach + quantile + mismatch + rest + difference`.
    pub target: f64,
    /// `||xh(K) - xf||`.
    pub reach: f64,
    /// `|s| q`.
    pub quantile: f64,
    /// `mismatch(s)`, with the drift of noise to come.
    pub mismatch: f64,
    /// What is not of first order.
    pub rest: f64,
    /// The declared difference of an older plant, of first order.
    pub difference: f64,
    /// `||x(k) - predicted[k]|| <= tube[k]` for all k (K + 1).
    pub tube: Vec<f64>,
    /// `|x(K) - xf|_i <= components[i]` for all i (n).
    pub components: Vec<f64>,
}

/// `to += weight (X Y' + Y X') / 2` of (rows, cols).
fn add_products(to: &mut [f64], weight: f64, [x, y]: [&[f64]; 2], rows: usize, cols: usize) {
    for i in 0..rows {
        for j in 0..=i {
            let along = |x: &[f64], y: &[f64], i: usize, j: usize| -> f64 {
                x[i * cols..(i + 1) * cols].iter().zip(&y[j * cols..(j + 1) * cols]).map(|(a, b)| a * b).sum()
            };
            let value = weight * (along(x, y, i, j) + along(y, x, i, j)) / 2.0;
            to[i * rows + j] += value;
            if i != j {
                to[j * rows + i] += value;
            }
        }
    }
}

/// `A^p root`, p < K.
fn powers(a: &[f64], root: &[f64], n: usize, count: usize) -> Result<Powers> {
    let mut found = Powers::new(n, n, count)?;
    let mut power = try_copy(WHAT, root)?;
    for _ in 0..count {
        let next = product(a, &power, n, n, n)?;
        found.push(power)?;
        power = next;
    }
    Ok(found)
}

/// Everything of one plan and one reference.
struct Work<'a> {
    n: usize,
    d: usize,
    event: &'a Event,
    shares: Shares,
    /// Of the plan without a reference.
    steps: Steps,
    /// The radius that `steps` are for.
    spectral: f64,
    /// `A^p S^(1/2)` where those of `steps` are others, and what the difference of an older plant does: see `Difference::linear`.
    older: Option<(Powers, Vec<f64>, Vec<f64>)>,
    /// `A0^p S^(1/2)`.
    pilot: Powers,
    /// First-order parts of the plan and of the reference.
    plan: Vec<Vec<f64>>,
    reference: Vec<Vec<f64>>,
    /// With noise to come: the covariances of `sum_{p<k} A0^p w` and of `sum_{p<k} (A^p - A0^p) w`, k = 1..K.
    through: Vec<Vec<f64>>,
    drift: Vec<Vec<f64>>,
    s: f64,
    /// `b_j`, j < K.
    b: Vec<f64>,
}

impl Work<'_> {
    fn noisy(&self) -> bool {
        self.shares.noise > 0.0
    }

    /// Finds the covariances of noise to come.
    fn add_noise(&mut self) -> Result<()> {
        let n = self.n;
        let [mut through, mut drift] = [try_zeros(WHAT, n * n)?, try_zeros(WHAT, n * n)?];
        let outside = self.older.as_ref().map_or(&self.steps.outside, |(outside, ..)| outside);
        for (m, l) in outside.matrices.iter().zip(&self.pilot.matrices) {
            let apart = try_collect(WHAT, m.iter().zip(l).map(|(m, l)| m - l))?;
            add_products(&mut through, 1.0, [l, l], n, n);
            add_products(&mut drift, 1.0, [&apart, &apart], n, n);
            self.through.push(try_copy(WHAT, &through)?);
            self.drift.push(try_copy(WHAT, &drift)?);
        }
        Ok(())
    }

    /// Finds `b_j`: `T_x e(j)` split as the target is, or as it is without a reference; given `T_x` and `(R^-1)'_x` (d, n).
    fn between(&mut self, [tx, t0x]: [&[f64]; 2], stop: &Stop) -> Result<()> {
        let (n, d, s, count) = (self.n, self.d, self.s, self.plan.len());
        if self.older.is_some() {
            self.b = try_copy(WHAT, &self.steps.rest[..count])?;
            return Ok(());
        }
        let level = self.shares.between / (count.max(2) as f64 - 1.0);
        self.b.push(0.0);
        for j in 1..count {
            stop.check()?;
            let seen = product(t0x, &self.reference[j - 1], d, n, d * n)?;
            let plan = product(tx, &self.plan[j - 1], d, n, d * n)?;
            let apart = try_collect(WHAT, plan.iter().zip(&seen).map(|(a, b)| a - s * b))?;
            let mut found = self.factor() * spectral_norm(&apart, d, d * n)? + self.steps.noise[j];
            found += self.event.spectral * self.steps.inside.cauchy_schwarz(&self.b)?;
            let crude = self.steps.rest[j];
            if found < crude {
                let mut covariance = try_zeros(WHAT, d * d)?;
                add_products(&mut covariance, 1.0, [&seen, &seen], d, d * n);
                found += s.abs() * coarse_normal_quantile(&covariance, d, level)?;
            }
            self.b.push(found.min(crude));
        }
        Ok(())
    }

    /// `mismatch(s)` of k steps, first order by the norm of Frobenius.
    fn mismatch(&self, k: usize) -> Result<f64> {
        Ok(self.factor() * spectral_norm(&self.unlike(k)?, self.n, self.d * self.n)?)
    }

    /// `spectral wcs` of k steps.
    fn rest(&mut self, k: usize) -> Result<f64> {
        Ok(self.spectral * self.steps.outside.cauchy_schwarz(&self.b[..k])?)
    }

    /// What the difference of an older plant adds over k steps.
    fn difference(&self, k: usize) -> f64 {
        self.older.as_ref().map_or(0.0, |(_, sizes, _)| sizes[k])
    }

    /// A bound of `||e(k)||`, one of K that hold together.
    fn step(&mut self, k: usize) -> Result<f64> {
        let (n, count) = (self.n, self.plan.len() as f64);
        let quantile = self.s.abs() * coarse_normal_quantile(&self.covariance(k)?, n, self.shares.reference / count)?;
        let mut first = quantile + self.mismatch(k)? + self.difference(k);
        if self.noisy() {
            first += coarse_normal_quantile(&self.drift[k - 1], n, self.shares.noise / 2.0 / count)?;
        } else {
            first = first.min(self.steps.linear[k]);
        }
        Ok(first + self.rest(k)?)
    }

    /// Bounds of `|e(K)|_i`, which hold together: first order of a row exactly.
    fn components(&self) -> Result<Vec<f64>> {
        let (n, width, count) = (self.n, self.d * self.n, self.plan.len());
        let quantile = |level: f64| Ok::<_, Error>(chi2_upper(level / n as f64, 1.0)?.sqrt());
        let times_deviation = self.s.abs() * quantile(self.shares.reference)?;
        let (covariance, apart) = (self.covariance(count)?, self.unlike(count)?);
        let row = |of: &[f64], i: usize| -> Result<f64> {
            let (frobenius, nuclear) = norms(&of[i * width..(i + 1) * width], n)?;
            Ok(times(self.event.frobenius, frobenius).min(times(self.event.spectral, nuclear)))
        };
        let mut found = try_zeros(WHAT, n)?;
        for (i, to) in found.iter_mut().enumerate() {
            let mut first = times_deviation * covariance[i * (n + 1)].sqrt() + row(&apart, i)?;
            if self.noisy() {
                first += quantile(self.shares.noise / 2.0)? * self.drift[count - 1][i * (n + 1)].sqrt();
            } else {
                first = first.min(row(&self.plan[count - 1], i)?);
            }
            let each = self.steps.outside.matrices.iter().rev().zip(&self.b);
            let rest: f64 = each.map(|(m, b)| times(norm(m[i * n..(i + 1) * n].iter().copied()), *b)).sum();
            let difference = self.older.as_ref().map_or(0.0, |(.., rows)| rows[i]);
            *to = first + difference + self.spectral * rest;
        }
        Ok(found)
    }

    /// `sum_j c_j' (x) M_j - s sum_j g_j' (x) L_j` (n, d n).
    fn unlike(&self, k: usize) -> Result<Vec<f64>> {
        try_collect(WHAT, self.plan[k - 1].iter().zip(&self.reference[k - 1]).map(|(a, b)| a - self.s * b))
    }

    /// `min(frobenius, spectral sqrt(min(n, d)))`: the bound of `||sum M Gamma c||` over that of a Kronecker sum.
    fn factor(&self) -> f64 {
        self.event.frobenius.min(self.event.spectral * (self.n.min(self.d) as f64).sqrt())
    }

    /// The covariance of F, with noise to come of `sum A0^p w` too.
    fn covariance(&self, k: usize) -> Result<Vec<f64>> {
        let (n, first) = (self.n, self.reference[k - 1].as_slice());
        let mut found =
            if self.through.is_empty() { try_zeros(WHAT, n * n)? } else { try_copy(WHAT, &self.through[k - 1])? };
        add_products(&mut found, 1.0, [first, first], n, self.d * n);
        Ok(found)
    }

    /// The s in [-1, 2] of the smallest `|s| q + mismatch(s)`, first order by the norm of Frobenius.
    ///
    /// By `D = plan - reference`: `plan - s reference = D + (1 - s) reference`, without cancellation near s = 1.
    fn best(&self, q: f64) -> Result<f64> {
        let (n, k, factor) = (self.n, self.plan.len(), self.factor());
        let (apart, first) = (self.unlike(k)?, self.reference[k - 1].as_slice()); // here s = 1
        let mut grams = [try_zeros(WHAT, n * n)?, try_zeros(WHAT, n * n)?, try_zeros(WHAT, n * n)?];
        add_products(&mut grams[0], 1.0, [&apart, &apart], n, self.d * n);
        add_products(&mut grams[1], 2.0, [&apart, first], n, self.d * n);
        add_products(&mut grams[2], 1.0, [first, first], n, self.d * n);
        let mut small = Symmetric::new(n)?;
        let (s, _) = smallest(-1.0, 2.0, |s| {
            let left = 1.0 - s;
            for (at, to) in small.matrix.iter_mut().enumerate() {
                *to = grams[0][at] + left * (grams[1][at] + left * grams[2][at]);
            }
            Ok(s.abs() * q + factor * small.largest()?.max(0.0).sqrt())
        })?;
        Ok(s)
    }
}

impl Pilot {
    /// The certificate of the plan `inputs` (K, m) near a reference of as many steps; `noise`: with noise of the run to come.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`] for an uncertain x0, which has none, [`Error::Overflow`] for states of the model that
    /// leave the range of doubles, [`Error::Memory`], [`Error::Interrupted`].
    pub fn near(
        &self,
        reference: &Reference,
        task: Task<'_>,
        inputs: &[f64],
        event: &Event,
        shares: Shares,
        stop: &Stop,
    ) -> Result<Near> {
        room_for_products()?;
        let (n, steps) = (self.n, reference.g.len() / self.d);
        let fits = task.xf.len() == n && task.predicted.len() == (steps + 1) * n && inputs.len() == steps * self.m;
        if !fits {
            let (expected, found) = (format!("{steps} steps as the reference"), format!("{} inputs", inputs.len()));
            return Err(Error::Shape { name: "inputs", expected, found });
        }
        if task.rho0 != 0.0 {
            let found = task.rho0.to_string();
            return Err(Error::Value { name: "the radius around x0", expected: "0 near a reference", found });
        }
        let region = self.within(event)?;
        let at = states(&region, task.x0, inputs)?;
        let reach = distance(&at[steps * n..], task.xf);
        let unbounded = || -> Result<Near> {
            let infinite = f64::INFINITY;
            let (mut tube, components) = (try_filled(WHAT, infinite, steps + 1)?, try_filled(WHAT, infinite, n)?);
            tube[0] = distance(&at[..n], &task.predicted[..n]);
            Ok(Near {
                target: infinite,
                reach,
                quantile: infinite,
                mismatch: infinite,
                rest: infinite,
                difference: infinite,
                tube,
                components,
            })
        };
        if !region.radius().is_finite() {
            return unbounded();
        }
        match self.bounded(reference, task, (&region, &at, inputs), (event, shares), stop) {
            Ok(found) if found.target.is_finite() => Ok(found),
            Ok(_) | Err(Error::Overflow { .. }) => unbounded(),
            Err(error) => Err(error),
        }
    }

    fn bounded(
        &self,
        reference: &Reference,
        task: Task<'_>,
        (region, at, inputs): (&Region, &[f64], &[f64]),
        (event, shares): (&Event, Shares),
        stop: &Stop,
    ) -> Result<Near> {
        let (n, d, count) = (self.n, self.d, inputs.len() / self.m);
        let (noisy, root) = (shares.noise > 0.0, covariance_root(&event.covariance, n)?);
        let half = shares.noise / 2.0;
        let future = Gaussian { root: &root, end: half, before: half / (count.max(2) as f64 - 1.0) };
        let columns = |from: &[f64]| -> Result<Vec<f64>> {
            let mut x = try_room(WHAT, checked_len(WHAT, from.len() / d, n)?)?;
            from.chunks_exact(d).for_each(|row| x.extend_from_slice(&row[..n]));
            Ok(x)
        };
        let (a, a0) = (columns(&self.h)?, columns(&self.model)?);
        let to_come = noisy.then_some(future);
        let along = |region: &Region, root: &[f64], spectral: f64, frobenius: f64| {
            let radii = Radii { spectral, frobenius, rho0: 0.0, noise: false, to_come };
            several_steps(region, root, at, inputs, radii, Seen { rows: n, gain: None }, stop)
        };
        let (spectral, steps, older) = match &self.difference {
            None => (event.spectral, along(region, &root, event.spectral, event.frobenius)?, None),
            Some(difference) => {
                let mut best = None;
                let mut least = f64::INFINITY;
                for factor in SHARES {
                    let joined = self.joined(difference, event, factor)?;
                    let root = covariance_root(&joined.parts[0].shape, n)?;
                    let mut steps = along(&joined, &root, 1.0, joined.frobenius())?;
                    let rest = steps.outside.cauchy_schwarz(&steps.rest[..count])?;
                    if best.is_none() || rest < least {
                        (best, least) = (Some(steps), rest);
                    }
                }
                let Some(steps) = best else { return Err(Error::Overflow { what: "the rest of a plan" }) };
                let (sizes, rows) = difference.linear(region, task.x0, inputs, stop)?;
                (1.0, steps, Some((powers(&a, &root, n, count)?, sizes, rows)))
            }
        };
        let mut c = try_room(WHAT, checked_len(WHAT, count, d)?)?;
        for (x, u) in at.chunks_exact(n).zip(inputs.chunks_exact(self.m)) {
            c.extend(product(&self.t, &region.regressor(x, u)?, d, d, 1)?);
        }
        let mut work = Work {
            n,
            d,
            event,
            shares,
            steps,
            spectral,
            older,
            pilot: powers(&a0, &root, n, count)?,
            plan: first_order(&a, &root, &c, n, d)?,
            reference: first_order(&a0, &root, &reference.g, n, d)?,
            through: try_room(WHAT, count)?,
            drift: try_room(WHAT, count)?,
            s: 1.0,
            b: try_room(WHAT, count)?,
        };
        if noisy {
            work.add_noise()?;
        }
        let q = normal_quantile(&work.covariance(count)?, n, shares.reference)?;
        if !noisy {
            work.s = work.best(q)?;
        }
        work.between([&columns(&self.t)?, &columns(&self.t0)?], stop)?;

        // the target: q at its whole level, and the first order over the spectral ball too
        let (mut quantile, mut mismatch) = (work.s.abs() * q, work.mismatch(count)?);
        let scaled = try_collect(WHAT, reference.g.iter().map(|g| work.s * g))?;
        let both = [work.older.as_ref().map_or(&work.steps.outside, |(outside, ..)| outside), &work.pilot];
        let spectral = largest_difference(both, [&c, &scaled], EFFORT, mismatch / event.spectral)?;
        mismatch = mismatch.min(event.spectral * spectral);
        let mut difference = work.difference(count);
        if noisy {
            mismatch += normal_quantile(&work.drift[count - 1], n, half)?;
        } else if work.steps.linear[count] < quantile + mismatch + difference {
            (quantile, mismatch, difference) = (0.0, work.steps.linear[count], 0.0); // s = 0
        }
        let (reach, rest) = (distance(&at[count * n..], task.xf), work.rest(count)?);
        let mut tube = try_room(WHAT, count + 1)?;
        for (k, (x, predicted)) in at.chunks_exact(n).zip(task.predicted.chunks_exact(n)).enumerate() {
            stop.check()?;
            tube.push(distance(x, predicted) + if k > 0 { work.step(k)? } else { 0.0 });
        }
        let mut components = work.components()?;
        let off = at[count * n..].iter().zip(task.xf).map(|(x, xf)| (x - xf).abs());
        components.iter_mut().zip(off).for_each(|(to, off)| *to += off);
        let target = reach + quantile + mismatch + rest + difference;
        Ok(Near { target, reach, quantile, mismatch, rest, difference, tube, components })
    }
}
