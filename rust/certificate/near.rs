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
use crate::identify::{Symmetric, chi2_upper, coarse_normal_quantile, normal_quantile, smallest, spectral_norm};
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::times;

use super::noise::{Gaussian, root_of};
use super::nuclear::Effort;
use super::pilot::{Event, Pilot, WHAT};
use super::plan::Task;
use super::powers::{Powers, largest_difference, product};
use super::reference::{Reference, Shares};
use super::several_steps::{Radii, Steps, several_steps};
use super::trajectory::{norms, states};

/// How long to look for a better bound over the spectral ball.
const EFFORT: Effort = Effort { rounds: 10, tolerance: 1e-3 };

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

/// First-order parts of all steps: `sum_{j<k} c_j' (x) M_{k-1-j}` (n, d n) for k = 1..K.
fn first_order(a: &[f64], root: &[f64], c: &[f64], n: usize, d: usize) -> Result<Vec<Vec<f64>>> {
    let width = checked_len(WHAT, d, n)?;
    let mut all = try_room(WHAT, c.len() / d)?;
    let mut now = try_zeros(WHAT, checked_len(WHAT, n, width)?)?;
    for c in c.chunks_exact(d) {
        now = product(a, &now, n, n, width)?;
        for (row, root) in now.chunks_exact_mut(width).zip(root.chunks_exact(n)) {
            for (to, c) in row.chunks_exact_mut(n).zip(c) {
                to.iter_mut().zip(root).for_each(|(to, root)| *to += c * root);
            }
        }
        all.push(try_copy(WHAT, &now)?);
    }
    Ok(all)
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

/// Everything of one plan and one reference.
struct Work<'a> {
    n: usize,
    d: usize,
    event: &'a Event,
    /// Those of the plan and of the reference.
    plan: Vec<Vec<f64>>,
    reference: Vec<Vec<f64>>,
    /// With noise to come: the covariances of `sum_{p<k} A0^p w` and of `sum_{p<k} (A^p - A0^p) w`, k = 1..K.
    through: Vec<Vec<f64>>,
    drift: Vec<Vec<f64>>,
    s: f64,
}

impl Work<'_> {
    /// `sum_j c_j' (x) M_j - s sum_j g_j' (x) L_j` (n, d n).
    fn difference(&self, k: usize) -> Result<Vec<f64>> {
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
        let (apart, first) = (self.difference(k)?, self.reference[k - 1].as_slice()); // here s = 1
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
                tube,
                components,
            })
        };
        if !region.radius().is_finite() {
            return unbounded();
        }
        match self.bounded(reference, task, &at, inputs, (event, shares), stop) {
            Ok(found) if found.target.is_finite() => Ok(found),
            Ok(_) | Err(Error::Overflow { .. }) => unbounded(),
            Err(error) => Err(error),
        }
    }

    fn bounded(
        &self,
        reference: &Reference,
        task: Task<'_>,
        at: &[f64],
        inputs: &[f64],
        (event, shares): (&Event, Shares),
        stop: &Stop,
    ) -> Result<Near> {
        let (n, d, steps) = (self.n, self.d, inputs.len() / self.m);
        let between = steps.max(2) as f64 - 1.0;
        let (noisy, root) = (shares.noise > 0.0, root_of(&event.covariance, n)?);
        let future = Gaussian { root: &root, end: shares.noise / 2.0, before: shares.noise / 2.0 / between };
        let radii = Radii {
            spectral: event.spectral,
            frobenius: event.frobenius,
            rho0: 0.0,
            noise: false,
            to_come: noisy.then_some(future),
        };
        let region = self.within(event)?;
        let Steps { linear, rest: crude, noise: nu, mut outside, mut inside, .. } =
            several_steps(&region, &root, at, inputs, radii, stop)?;
        let mut c = try_room(WHAT, checked_len(WHAT, steps, d)?)?;
        for (x, u) in at.chunks_exact(n).zip(inputs.chunks_exact(self.m)) {
            c.extend(product(&self.t, &region.regressor(x, u)?, d, d, 1)?);
        }
        let [mut a, mut a0] = [try_room(WHAT, n * n)?, try_room(WHAT, n * n)?];
        self.h.chunks_exact(d).for_each(|row| a.extend_from_slice(&row[..n]));
        self.model.chunks_exact(d).for_each(|row| a0.extend_from_slice(&row[..n]));
        let mut pilot = Powers::new(n, n, steps)?; // A0^p S^(1/2)
        let mut power = try_copy(WHAT, &root)?;
        for _ in 0..steps {
            let next = product(&a0, &power, n, n, n)?;
            pilot.push(power)?;
            power = next;
        }
        let mut work = Work {
            n,
            d,
            event,
            plan: first_order(&a, &root, &c, n, d)?,
            reference: first_order(&a0, &root, &reference.g, n, d)?,
            through: try_room(WHAT, steps)?,
            drift: try_room(WHAT, steps)?,
            s: 1.0,
        };
        if noisy {
            let [mut through, mut drift] = [try_zeros(WHAT, n * n)?, try_zeros(WHAT, n * n)?];
            for (m, l) in outside.matrices.iter().zip(&pilot.matrices) {
                let apart = try_collect(WHAT, m.iter().zip(l).map(|(m, l)| m - l))?;
                add_products(&mut through, 1.0, [l, l], n, n);
                add_products(&mut drift, 1.0, [&apart, &apart], n, n);
                work.through.push(try_copy(WHAT, &through)?);
                work.drift.push(try_copy(WHAT, &drift)?);
            }
        }
        let q = normal_quantile(&work.covariance(steps)?, n, shares.reference)?;
        if !noisy {
            work.s = work.best(q)?;
        }
        let (s, factor) = (work.s, work.factor());

        // b_j: T_x e(j) split in the same way, or as it is without a reference
        let columns = |from: &[f64]| -> Result<Vec<f64>> {
            let mut x = try_room(WHAT, checked_len(WHAT, d, n)?)?;
            from.chunks_exact(d).for_each(|row| x.extend_from_slice(&row[..n]));
            Ok(x)
        };
        let (tx, t0x) = (columns(&self.t)?, columns(&self.t0)?);
        let mut b = try_room(WHAT, steps)?;
        b.push(0.0);
        for j in 1..steps {
            stop.check()?;
            let seen = product(&t0x, &work.reference[j - 1], d, n, d * n)?;
            let plan = product(&tx, &work.plan[j - 1], d, n, d * n)?;
            let apart = try_collect(WHAT, plan.iter().zip(&seen).map(|(a, b)| a - s * b))?;
            let mut first = factor * spectral_norm(&apart, d, d * n)? + nu[j];
            first += event.spectral * inside.cauchy_schwarz(&b)?;
            if first < crude[j] {
                let mut covariance = try_zeros(WHAT, d * d)?;
                add_products(&mut covariance, 1.0, [&seen, &seen], d, d * n);
                first += s.abs() * coarse_normal_quantile(&covariance, d, shares.between / between)?;
            }
            b.push(first.min(crude[j]));
        }

        // a bound for all k, of which the last has its own level too
        let mut tube = try_room(WHAT, steps + 1)?;
        let off = |k: usize| distance(&at[k * n..(k + 1) * n], &task.predicted[k * n..(k + 1) * n]);
        tube.push(off(0));
        let (mut mismatch, mut rest) = (0.0, 0.0);
        for k in 1..=steps {
            stop.check()?;
            rest = event.spectral * outside.cauchy_schwarz(&b[..k])?;
            mismatch = factor * spectral_norm(&work.difference(k)?, n, d * n)?;
            let level = shares.reference / steps as f64;
            let quantile = s.abs() * coarse_normal_quantile(&work.covariance(k)?, n, level)?;
            let mut drift = 0.0;
            if noisy {
                drift = coarse_normal_quantile(&work.drift[k - 1], n, shares.noise / 2.0 / steps as f64)?;
            }
            let first = quantile + mismatch + drift;
            tube.push(if noisy { first } else { first.min(linear[k]) } + rest + off(k));
        }
        let row_level = chi2_upper(shares.reference / n as f64, 1.0)?.sqrt();
        let mut components = try_filled(WHAT, 0.0, n)?;
        let (covariance, apart) = (work.covariance(steps)?, work.difference(steps)?);
        for (i, to) in components.iter_mut().enumerate() {
            let row = |of: &[f64]| -> Result<f64> {
                let (frobenius, nuclear) = norms(&of[i * d * n..(i + 1) * d * n], n)?;
                Ok(times(event.frobenius, frobenius).min(times(event.spectral, nuclear)))
            };
            let mut first = s.abs() * row_level * covariance[i * (n + 1)].sqrt() + row(&apart)?;
            if noisy {
                let drift = work.drift[steps - 1][i * (n + 1)];
                first += (chi2_upper(shares.noise / 2.0 / n as f64, 1.0)? * drift).sqrt();
            } else {
                first = first.min(row(&work.plan[steps - 1])?);
            }
            let each = outside.matrices.iter().rev().zip(&b);
            let back: f64 = each.map(|(m, b)| times(norm(m[i * n..(i + 1) * n].iter().copied()), *b)).sum();
            *to = (at[steps * n + i] - task.xf[i]).abs() + first + event.spectral * back;
        }

        // the target: q at its whole level, and the first order over the spectral ball
        let scaled = try_collect(WHAT, reference.g.iter().map(|g| s * g))?;
        let enough = mismatch / event.spectral;
        let spectral = largest_difference([&outside, &pilot], [&c, &scaled], EFFORT, enough)?;
        mismatch = mismatch.min(event.spectral * spectral);
        let mut quantile = s.abs() * q;
        if noisy {
            mismatch += normal_quantile(&work.drift[steps - 1], n, shares.noise / 2.0)?;
        } else if linear[steps] < quantile + mismatch {
            (quantile, mismatch) = (0.0, linear[steps]); // s = 0
        }
        let reach = distance(&at[steps * n..], task.xf);
        Ok(Near { target: reach + quantile + mismatch + rest, reach, quantile, mismatch, rest, tube, components })
    }
}
