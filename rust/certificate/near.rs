//! The certificate of a plan near a reference that was fixed before the noise of the data.
//!
//! With the model H of [`Pilot`], `c_j = T z(j)` along a plan and `p_j = K - 1 - j`, the error is
//!
//! ```text
//! e(K) = - sum_j A^p_j S^(1/2) Gamma c_j + sum_j A^p_j Delta_x e(j),    Delta_x = - S^(1/2) Gamma T_x.
//! ```
//!
//! Along the plan of the pilot for a task fixed beforehand, `g_j = (R^-1)' z0(j)` and the pilot's A0 do not depend on
//! Gamma: `F = sum_j A0^p_j S^(1/2) Gamma g_j` is Gaussian of covariance `C0 = sum_jk (g_j' g_k) A0^p_j S A0^p_k'`,
//! exactly. So for every s, every plan, start and target at once, with `q` the quantile of `||F||`,
//!
//! ```text
//! ||x(K) - xf|| <= ||xh(K) - xf|| + |s| q + mismatch(s) + rest
//! mismatch(s) = the largest ||sum_j A^p_j S^(1/2) Gamma c_j - s A0^p_j S^(1/2) Gamma g_j|| over the bounds of Gamma
//! rest        = spectral wcs(A^p_j S^(1/2), b_j),    b_j >= ||T_x e(j)||.
//! ```
//!
//! `b_j` is that of [`super::several_steps`], of which the first order is that of the same split of `T_x e(j)`, with a
//! quantile of its own, where that is smaller. Without noise the rest is also bounded by its second order, see
//! [`super::second`]. Noise of the run to come adds `sum_p A0^p w` to F, which is independent of it, with s = 1;
//! `drift`, the quantile of `sum_p (A^p - A0^p) w`, to the mismatch; and `nu_j` to `b_j`.

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
use super::plan::Endpoints;
use super::powers::{Powers, deviations, first_order, in_units, largest_difference, product, products};
use super::reference::{Reference, Shares};
use super::second::Later;
use super::several_steps::{Radii, Seen, norms, several_steps};
use super::trajectory::states;
use super::weighted::Followed;

/// What holds near a reference: `target`, `tube` and `components` are each a statement of its own.
#[derive(Debug, Clone)]
pub struct Near {
    /// `||x(K) - xf|| <= target = reach + quantile + mismatch + rest`.
    pub target: f64,
    /// `||xh(K) - xf||`.
    pub reach: f64,
    /// `|s| q`.
    pub quantile: f64,
    /// `mismatch(s)`, with the drift of noise to come.
    pub mismatch: f64,
    /// What is not of first order.
    pub rest: f64,
    /// `||x(k) - predicted[k]|| <= tube[k]` for all k (K + 1).
    pub tube: Vec<f64>,
    /// `|x(K) - xf|_i <= components[i]` for all i (n).
    pub components: Vec<f64>,
}

/// `A^p root`, p < K.
fn powers(a: &[f64], root: &[f64], n: usize, count: usize) -> Result<Powers> {
    let mut found = Powers::new(n, n, count)?;
    let mut power = try_copy(WHAT, root)?;
    for _ in 0..count {
        let next = product(a, &power, n, n, n)?;
        found.push(&power)?;
        power = next;
    }
    Ok(found)
}

/// Everything of first order of one plan and one reference.
struct Work<'a> {
    n: usize,
    d: usize,
    event: &'a Event,
    shares: Shares,
    /// `A^p S^(1/2)` and `A0^p S^(1/2)`.
    own: Powers,
    pilot: Powers,
    /// First-order parts of the plan and of the reference.
    plan: Vec<Vec<f64>>,
    reference: Vec<Vec<f64>>,
    /// With noise to come: the covariances of `sum_{p<k} A0^p w` and of `sum_{p<k} (A^p - A0^p) w`, k = 1..K.
    through: Vec<Vec<f64>>,
    drift: Vec<Vec<f64>>,
    s: f64,
    /// The s for what depends on no unit of the states: components, and `T_x e(j)`.
    even: f64,
}

impl Work<'_> {
    fn noisy(&self) -> bool {
        self.shares.noise > 0.0
    }

    /// Finds the covariances of noise to come.
    fn add_noise(&mut self) -> Result<()> {
        let n = self.n;
        let [mut through, mut drift] = [try_zeros(WHAT, n * n)?, try_zeros(WHAT, n * n)?];
        let add = |to: &mut [f64], m: &[f64]| -> Result<()> {
            to.iter_mut().zip(products([m, m], n)?).for_each(|(to, v)| *to += v);
            Ok(())
        };
        for (m, l) in self.own.all().zip(self.pilot.all()) {
            add(&mut through, l)?;
            add(&mut drift, &try_collect(WHAT, m.iter().zip(l).map(|(m, l)| m - l))?)?;
            self.through.push(try_copy(WHAT, &through)?);
            self.drift.push(try_copy(WHAT, &drift)?);
        }
        Ok(())
    }

    /// Bounds of `||T_x e(j)||` of first order by the same split, j < K, given `T_x` and `(R^-1)'_x` (d, n); 0 for the
    /// last.
    fn between(&self, [tx, t0x]: [&[f64]; 2], stop: &Stop) -> Result<Vec<f64>> {
        let (n, d, s, count) = (self.n, self.d, self.even, self.plan.len());
        let level = self.shares.between / (count.max(2) as f64 - 1.0);
        let mut found = try_zeros(WHAT, count + 1)?;
        for (j, to) in found.iter_mut().enumerate().take(count).skip(1) {
            stop.check()?;
            let seen = product(t0x, &self.reference[j - 1], d, n, d * n)?;
            let plan = product(tx, &self.plan[j - 1], d, n, d * n)?;
            let apart = try_collect(WHAT, plan.iter().zip(&seen).map(|(a, b)| a - s * b))?;
            *to = self.factor() * spectral_norm(&apart, d, d * n)?;
            *to += s.abs() * coarse_normal_quantile(&products([&seen, &seen], d)?, d, level)?;
        }
        Ok(found)
    }

    /// `mismatch(s)` of k steps, first order by the norm of Frobenius.
    fn mismatch(&self, k: usize) -> Result<f64> {
        Ok(self.factor() * spectral_norm(&self.unlike(k, self.s)?, self.n, self.d * self.n)?)
    }

    /// A bound of the first order of `||e(k)||`, one of K that hold together.
    fn step(&self, k: usize) -> Result<f64> {
        let (n, count) = (self.n, self.plan.len() as f64);
        let quantile = self.s.abs() * coarse_normal_quantile(&self.covariance(k)?, n, self.shares.reference / count)?;
        let mut first = quantile + self.mismatch(k)?;
        if self.noisy() {
            first += coarse_normal_quantile(&self.drift[k - 1], n, self.shares.noise / 2.0 / count)?;
        }
        Ok(first)
    }

    /// Bounds of `|e(K)|_i`, which hold together, from those of what is not of first order: first order of a row
    /// exactly.
    fn components(&self, rest: &[f64]) -> Result<Vec<f64>> {
        let (n, width, count) = (self.n, self.d * self.n, self.plan.len());
        let quantile = |level: f64| Ok::<_, Error>(chi2_upper(level / n as f64, 1.0)?.sqrt());
        let times_deviation = self.even.abs() * quantile(self.shares.reference)?;
        let times_drift = if self.noisy() { quantile(self.shares.noise / 2.0)? } else { 0.0 };
        let (covariance, apart) = (self.covariance(count)?, self.unlike(count, self.even)?);
        // or `enough`, if that is not above the norm of Frobenius
        let row = |of: &[f64], i: usize, enough: f64| -> Result<f64> {
            let of = &of[i * width..(i + 1) * width];
            if times(self.event.spectral, norm(of.iter().copied())) >= enough {
                return Ok(enough);
            }
            let (frobenius, nuclear) = norms(of, n)?;
            Ok(times(self.event.frobenius, frobenius).min(times(self.event.spectral, nuclear)).min(enough))
        };
        let mut found = try_zeros(WHAT, n)?;
        for (i, (to, rest)) in found.iter_mut().zip(rest).enumerate() {
            let mut first = times_deviation * covariance[i * (n + 1)].sqrt() + row(&apart, i, f64::INFINITY)?;
            if self.noisy() {
                first += times_drift * self.drift[count - 1][i * (n + 1)].sqrt();
            } else {
                first = row(&self.plan[count - 1], i, first)?;
            }
            *to = first + rest;
        }
        Ok(found)
    }

    /// `sum_j c_j' (x) M_j - s sum_j g_j' (x) L_j` (n, d n).
    fn unlike(&self, k: usize, s: f64) -> Result<Vec<f64>> {
        try_collect(WHAT, self.plan[k - 1].iter().zip(&self.reference[k - 1]).map(|(a, b)| a - s * b))
    }

    /// `min(frobenius, spectral sqrt(min(n, d)))`: the bound of `||sum M Gamma c||` over that of a Kronecker sum.
    fn factor(&self) -> f64 {
        self.event.frobenius.min(self.event.spectral * (self.n.min(self.d) as f64).sqrt())
    }

    /// The covariance of F, with noise to come of `sum A0^p w` too.
    fn covariance(&self, k: usize) -> Result<Vec<f64>> {
        let (n, first) = (self.n, self.reference[k - 1].as_slice());
        let mut found = products([first, first], n)?;
        if let Some(through) = self.through.get(k - 1) {
            found.iter_mut().zip(through).for_each(|(to, v)| *to += v);
        }
        Ok(found)
    }

    /// The s in [-1, 2] of the smallest `|s| q + mismatch(s)`, first order by the norm of Frobenius, in these units of
    /// the states.
    ///
    /// By `D = plan - reference`: `plan - s reference = D + (1 - s) reference`, without cancellation near s = 1.
    fn best(&self, q: f64, units: &[f64]) -> Result<f64> {
        let (n, k, factor) = (self.n, self.plan.len(), self.factor());
        let [mut apart, mut first] = [self.unlike(k, 1.0)?, try_copy(WHAT, &self.reference[k - 1])?];
        for of in [&mut apart, &mut first] {
            of.chunks_exact_mut(self.d * n).zip(units).for_each(|(row, unit)| row.iter_mut().for_each(|v| *v /= unit));
        }
        let mut grams =
            [products([&apart, &apart], n)?, products([&apart, &first], n)?, products([&first, &first], n)?];
        for i in 0..n {
            for j in 0..=i {
                let twice = grams[1][i * n + j] + grams[1][j * n + i];
                grams[1][i * n + j] = twice; // the lower half is read
            }
        }
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
    /// The certificate of the plan `inputs` (K, m) near a reference of as many steps; `noise`: with noise of the run to
    /// come.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`] for an uncertain x0, which has none, [`Error::Overflow`] for states of the
    /// model that leave the range of doubles, [`Error::Memory`], [`Error::Interrupted`].
    pub fn near(
        &self,
        reference: &Reference,
        task: Endpoints<'_>,
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
        task: Endpoints<'_>,
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
        let mut c = try_room(WHAT, checked_len(WHAT, count, d)?)?;
        for (x, u) in at.chunks_exact(n).zip(inputs.chunks_exact(self.m)) {
            c.extend(product(&self.t, &region.regressor(x, u)?, d, d, 1)?);
        }
        let mut work = Work {
            n,
            d,
            event,
            shares,
            own: powers(&a, &root, n, count)?,
            pilot: powers(&a0, &root, n, count)?,
            plan: first_order(&a, &root, &c, n, d)?,
            reference: first_order(&a0, &root, &reference.g, n, d)?,
            through: try_room(WHAT, count)?,
            drift: try_room(WHAT, count)?,
            s: 1.0,
            even: 1.0,
        };
        if noisy {
            work.add_noise()?;
        }
        let mut covariance = work.covariance(count)?;
        let q = normal_quantile(&covariance, n, shares.reference)?;
        if !noisy {
            let units = deviations(&event.covariance, n)?;
            in_units(&mut covariance, &units);
            work.s = work.best(q, &try_filled(WHAT, 1.0, n)?)?;
            work.even = work.best(coarse_normal_quantile(&covariance, n, shares.reference)?, &units)?;
        }
        // the target: q at its whole level, and the first order over the spectral ball too
        let (mut quantile, mut mismatch) = (work.s.abs() * q, work.mismatch(count)?);
        let scaled = try_collect(WHAT, reference.g.iter().map(|g| work.s * g))?;
        let largest = largest_difference([&work.own, &work.pilot], [&c, &scaled], EFFORT, mismatch / event.spectral)?;
        mismatch = mismatch.min(event.spectral * largest);
        let mut first = try_zeros(WHAT, count + 1)?;
        for (k, to) in first.iter_mut().enumerate().skip(1) {
            stop.check()?;
            *to = work.step(k)?;
        }

        let inner = work.between([&columns(&self.t)?, &columns(&self.t0)?], stop)?;
        // with noise to come the first order of the plan alone does not count
        let mut outer = if noisy { try_zeros(WHAT, count + 1)? } else { try_copy(WHAT, &first)? };
        if !noisy {
            outer[count] = outer[count].max(quantile + mismatch);
        }
        let besides = [Some(outer.as_slice()), Some(inner.as_slice())];
        let (spectral, frobenius) = (event.spectral, event.frobenius);
        let radii = Radii { spectral, frobenius, rho0: 0.0, noise: false, to_come, within: true, besides, apart: None };
        let steps = several_steps(region, &root, at, inputs, radii, Seen { rows: n, gain: None }, stop)?;
        if noisy {
            mismatch += normal_quantile(&work.drift[count - 1], n, half)?;
        } else if steps.linear[count] < quantile + mismatch {
            (quantile, mismatch) = (0.0, steps.linear[count]); // s = 0
        }
        let (mut back, mut rows) = (try_copy(WHAT, &steps.back)?, try_filled(WHAT, f64::INFINITY, n)?);
        if shares.later > 0.0 {
            let (seen, seen0) = (columns(&self.t)?, columns(&self.t0)?);
            let mut kernel = Powers::new(d, n, count)?;
            for m in work.own.all() {
                kernel.push(&product(&seen, m, d, n, n)?)?;
            }
            let followed =
                |a, seen, c| Followed { a, error: &root, seen, kernel: &kernel, c, radii: (spectral, frobenius) };
            let (own, other) = (followed(&a, &seen, &c), followed(&a0, &seen0, &reference.g));
            if let Some(mut later) = Later::new([&own, &other], (n, n), (shares.later, n), stop)? {
                for (k, to) in back.iter_mut().enumerate().skip(1) {
                    let powers = (k == count).then_some([&work.own, &work.pilot]);
                    *to = to.min(later.step(k, steps.outside.square(k - 1), powers, &mut rows)?);
                }
            }
        }
        let mut tube = try_room(WHAT, count + 1)?;
        for (k, (x, predicted)) in at.chunks_exact(n).zip(task.predicted.chunks_exact(n)).enumerate() {
            let first = if noisy { first[k] } else { first[k].min(steps.linear[k]) };
            tube.push(distance(x, predicted) + first + back[k]);
        }
        let mut later = try_room(WHAT, n)?; // what is not of first order of each row of the last state
        for i in 0..n {
            let each = steps.outside.all().zip(steps.rest[..count].iter().rev());
            let sum: f64 = each.map(|(m, b)| times(norm(m[i * n..(i + 1) * n].iter().copied()), *b)).sum();
            later.push((event.spectral * sum).min(rows[i]));
        }
        let (rest, mut components) = (back[count], work.components(&later)?);
        let off = at[count * n..].iter().zip(task.xf).map(|(x, xf)| (x - xf).abs());
        components.iter_mut().zip(off).for_each(|(to, off)| *to += off);
        let reach = distance(&at[count * n..], task.xf);
        let target = reach + quantile + mismatch + rest;
        Ok(Near { target, reach, quantile, mismatch, rest, tube, components })
    }
}
