//! Outputs of a plan that is followed with a feedback, near a reference that was fixed before the noise of the data.
//!
//! With the notation of [`super::second`] and `h'e1_k = <Gamma, X_k>`, z a normal quantile of all steps and rows
//! together, of which the last step has the larger share, for every s
//!
//! ```text
//! |<Gamma, X_k>| <= |s| z ||X0_k||_F + min(spectral ||X_k - s X0_k||_*, frobenius ||X_k - s X0_k||_F).
//! ```
//!
//! In front of the state is the output of the step, on which nothing acts: `D = [I; G] S^(1/2)`. Noise of the run is
//! that of [`super::carried`].

use crate::error::{Error, Result};
use crate::identify::{chi2_upper, covariance_root};
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_filled, try_zeros};
use crate::parallel::Stop;
use crate::region::{Entering, times};

use super::carried::Carried;
use super::pilot::{Event, Pilot, WHAT};
use super::powers::{Powers, product};
use super::reference::Shares;
use super::second::Later;
use super::several_steps::norms;
use super::weighted::Followed;

/// Most operations for bounds of second order of all steps; above only the last has one.
const WORK: f64 = 1e9;

/// The share of the last step among all quantiles of normal rows: what is asked about most. Fixed, not tuned on data.
const LAST: f64 = 0.8;

/// A plan, what follows it, and the system that it is of.
#[derive(Debug, Clone, Copy)]
pub struct Course<'a> {
    /// At the centre.
    pub system: Entering<'a>,
    /// K (m, n) of `u(k) + K (x(k) - xh(k))`; none in open loop.
    pub gain: Option<&'a [f64]>,
    /// The state at first (n).
    pub x0: &'a [f64],
    /// The inputs (K, m).
    pub inputs: &'a [f64],
}

/// Bounds of outputs off the plan, all together.
#[derive(Debug, Clone)]
pub struct NearRows {
    /// Of the mean of each output (K + 1, p).
    pub model: Vec<f64>,
    /// What the noise of the run adds (K + 1, p).
    pub noise: Vec<f64>,
}

impl NearRows {
    /// Without a bound behind the first step.
    fn unbounded(steps: usize, p: usize) -> Result<Self> {
        let mut model = try_filled(WHAT, f64::INFINITY, checked_len(WHAT, steps + 1, p)?)?;
        model[..p].fill(0.0);
        let noise = try_zeros(WHAT, model.len())?;
        Ok(Self { model, noise })
    }
}

/// The closed loop of `(y; x)`, and what its error sees along the plan.
struct Built {
    a: Vec<f64>,
    seen: Vec<f64>,
    c: Vec<f64>,
}

impl Pilot {
    /// The bounds for `shares`, with noise of the run where they have a share for it; infinite where numbers leave the
    /// range of doubles. None where it would take too long, which only sizes decide.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn followed(
        &self,
        own: Course<'_>,
        reference: Course<'_>,
        event: &Event,
        shares: Shares,
        stop: &Stop,
    ) -> Result<Option<NearRows>> {
        match self.rows_of(own, reference, event, shares, stop) {
            Err(Error::Overflow { .. }) => NearRows::unbounded(own.inputs.len() / own.system.m, self.n).map(Some),
            found => found,
        }
    }

    fn rows_of(
        &self,
        own: Course<'_>,
        reference: Course<'_>,
        event: &Event,
        shares: Shares,
        stop: &Stop,
    ) -> Result<Option<NearRows>> {
        room_for_products()?;
        let (p, steps) = (self.n, own.inputs.len() / own.system.m.max(1));
        if reference.inputs.len() != own.inputs.len() || steps == 0 {
            let (expected, found) =
                (format!("{steps} steps as the plan"), format!("{} inputs", reference.inputs.len()));
            return Err(Error::Shape { name: "reference", expected, found });
        }
        let whole = p + own.x0.len();
        let ways = [self.built(own, &self.h, &self.t)?, self.built(reference, &self.model, &self.t0)?];
        let NearRows { mut model, mut noise } = NearRows::unbounded(steps, p)?;
        if !self.determined() || !event.covariance.iter().all(|v| v.is_finite()) || !event.spectral.is_finite() {
            return Ok(Some(NearRows { model, noise }));
        }
        let root = covariance_root(&event.covariance, p)?;
        let mut error = try_copy(WHAT, &root)?;
        error.extend(product(own.system.noise, &root, whole - p, p, p)?);
        let mut outside = [Powers::new(p, p, steps)?, Powers::new(p, p, steps)?];
        let mut kernel = Powers::new(self.d, p, steps)?;
        for (at, (way, outside)) in ways.iter().zip(&mut outside).enumerate() {
            let mut moved = try_copy(WHAT, &error)?;
            for _ in 0..steps {
                outside.push(&moved[..p * p])?;
                if at == 0 {
                    kernel.push(&product(&way.seen, &moved, self.d, whole, p)?)?;
                }
                moved = product(&way.a, &moved, whole, whole, p)?;
            }
        }
        let radii = (event.spectral, event.frobenius);
        let [own, other] = ways.each_ref().map(|way| Followed {
            a: &way.a,
            error: &error,
            seen: &way.seen,
            kernel: &kernel,
            c: &way.c,
            radii,
        });
        let mut behind = Later::new([&own, &other], (whole, p), (shares.later, steps * p), stop)?;
        if behind.is_none() && steps > 1 {
            return Ok(None);
        }
        let rows = (steps * p) as f64;
        // deviations of one of the rows at the last step, which has the most, and of one before
        let times = |share: f64| -> Result<[f64; 2]> {
            let last = if steps > 1 { LAST } else { 1.0 };
            let quantile = |share: f64, events: f64| Ok::<_, Error>(chi2_upper(share / events, 1.0)?.sqrt());
            let before = (1.0 - last) * share;
            let end = quantile(last * share, p as f64)?;
            Ok([end, if steps > 1 { quantile(before, rows - p as f64)? } else { end }])
        };
        let z = times(shares.reference)?;
        let all = rows * ((p * self.d) as f64).powi(3) <= WORK;
        let width = p * self.d;
        let mut first = [try_zeros(WHAT, whole * width)?, try_zeros(WHAT, whole * width)?];
        let mut later = try_zeros(WHAT, p)?;
        for (k, to) in model.chunks_exact_mut(p).enumerate().skip(1) {
            stop.check()?;
            first = [own.next(&first[0], k - 1, whole)?, other.next(&first[1], k - 1, whole)?];
            if let Some(behind) = &mut behind {
                let powers = (all || k == steps).then_some(outside.each_ref());
                behind.step(k, outside[0].square(k - 1), powers, &mut later)?;
            }
            for (i, (to, later)) in to.iter_mut().zip(&later).enumerate() {
                let [x, x0] = first.each_ref().map(|of| &of[i * width..(i + 1) * width]);
                *to = linear([x, x0], p, radii, z[usize::from(k < steps)])? + later;
            }
        }
        if shares.noise > 0.0 {
            let z = times(shares.noise)?;
            let mut carried = Carried::new((own.a, own.seen), &error, (event.spectral, &error), whole)?;
            for (k, to) in noise.chunks_exact_mut(p).enumerate().skip(1) {
                carried.step(true)?;
                let variances = carried.leading(p)?.1;
                to.iter_mut().zip(variances).for_each(|(to, v)| *to = z[usize::from(k < steps)] * v.sqrt());
            }
        }
        Ok(Some(NearRows { model, noise }))
    }

    fn built(&self, of: Course<'_>, coefficients: &[f64], white: &[f64]) -> Result<Built> {
        let (p, d, m) = (self.n, self.d, of.system.m);
        let (n, k) = of.system.sizes(p, d)?;
        let fits = of.x0.len() == n && m > 0 && of.inputs.len().is_multiple_of(m) && k >= n + m;
        if !fits || of.gain.is_some_and(|gain| gain.len() != m * n) {
            let found = format!("{} and {} entries", of.x0.len(), of.inputs.len());
            return Err(Error::Shape {
                name: "x0, inputs, gain",
                expected: format!("{n}, rows of {m}, {m} x {n}"),
                found,
            });
        }
        let mut joined = try_zeros(WHAT, checked_len(WHAT, k, n)?)?; // [I; K; 0]
        (0..n).for_each(|i| joined[i * (n + 1)] = 1.0);
        if let Some(gain) = of.gain {
            joined[n * n..n * n + gain.len()].copy_from_slice(gain);
        }
        let entered = product(of.system.entering, &joined, d, k, n)?;
        let whole = p + n;
        let behind = |of: &[f64], rows: usize| -> Result<Vec<f64>> {
            let mut wide = try_zeros(WHAT, checked_len(WHAT, rows, whole)?)?;
            wide.chunks_exact_mut(whole).zip(of.chunks_exact(n)).for_each(|(to, row)| to[p..].copy_from_slice(row));
            Ok(wide)
        };
        let mut both = product(coefficients, &entered, p, d, n)?;
        both.extend(product(of.system.matrix, &joined, n, k, n)?);
        let (a, seen) = (behind(&both, whole)?, behind(&product(white, &entered, d, d, n)?, d)?);
        let (mut at, mut c) = (try_filled(WHAT, 1.0, k)?, Vec::new());
        at[..n].copy_from_slice(of.x0);
        for u in of.inputs.chunks_exact(m) {
            at[n..n + m].copy_from_slice(u);
            c.extend(product(white, &product(of.system.entering, &at, d, k, 1)?, d, d, 1)?);
            let next = product(of.system.matrix, &at, n, k, 1)?;
            at[..n].copy_from_slice(&next);
        }
        if c.iter().chain(&a).chain(&seen).all(|v| v.is_finite()) {
            return Ok(Built { a, seen, c });
        }
        Err(Error::Overflow { what: "the states of a plan" })
    }
}

/// The least of the bounds of `<Gamma, X>` for some s.
fn linear([x, x0]: [&[f64]; 2], q: usize, (spectral, frobenius): (f64, f64), z: f64) -> Result<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let square = dot(x0, x0);
    let nearest = if square > 0.0 { dot(x, x0) / square } else { 0.0 };
    let mut least = f64::INFINITY;
    for s in [0.0, 0.5 * nearest, nearest, 1.0] {
        let apart = try_collect(WHAT, x.iter().zip(x0).map(|(a, b)| a - s * b))?;
        let (of_frobenius, nuclear) = norms(&apart, q)?;
        let worst = times(frobenius, of_frobenius).min(times(spectral, nuclear));
        least = least.min(s.abs() * z * square.sqrt() * (1.0 + 1e-9) + worst);
    }
    Ok(least)
}
