//! Block principal pivoting, the interior point as its safeguard, and the certificate of what they find.
//!
//! Pivoting (Judice and Pires 1994) minimises over the free inputs, exchanges every input that violates its limit or
//! the sign of its multiplier, and repeats. It may cycle: once the number of violations has not fallen for a few
//! rounds, the interior point takes over, and its limits are where pivoting ends.

use super::bounds::Bounds;
use super::certificate::{Certificate, frank_wolfe};
use super::interior::{self, Interior};
use super::quadratic::{Method, Quadratic, Status, Until};
use crate::error::{Error, Result};
use crate::memory::try_zeros;

const WHAT: &str = "a control within limits";

/// Most rounds of pivoting, and after the interior point.
const PIVOTS: usize = 15;
const LAST_PIVOTS: usize = 5;
/// Of a search, at most: twice pivoting, the interior point, and pivoting from its limits.
pub(super) const FACTORIZATIONS: usize = 2 * PIVOTS + interior::MOST + LAST_PIVOTS;
/// Rounds without fewer violations after which pivoting ends.
const PATIENCE: usize = 4;
/// Gaps relative to `J(0) + J(u)`: where refinement ends, and from where more is tried.
const EXACT: f64 = 1e-14;
const GOOD: f64 = 5e-13;
/// Dual residual, relative to `J(0)`, from which no correction is tried.
pub(super) const NEGLIGIBLE: f64 = 1e-22;
/// Rounding of the root of J from which no dual residual is believed, relative to that of `J(0) + J(u)`.
const UNKNOWN: f64 = 1e-6;
/// Rounding of a gradient, in units of its size.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Memory of a search, and its best control.
#[derive(Debug, Default)]
pub(super) struct Search {
    pub(super) u: Vec<f64>,
    pub(super) g: Vec<f64>,
    pub(super) held: Vec<i8>,
    pub(super) fixed: Vec<i8>,
    v: Vec<f64>,
    step: Vec<f64>,
    e: Vec<f64>,
    interior: Interior,
    pub(super) certificate: Certificate,
    pub(super) factorizations: usize,
    pub(super) method: Method,
}

enum End {
    Done,
    Stuck,
    Early(Status),
}

impl Search {
    pub(super) fn new(d: usize) -> Result<Self> {
        let zeros = || try_zeros(WHAT, d);
        Ok(Self {
            u: zeros()?,
            g: zeros()?,
            held: try_signs(d)?,
            fixed: try_signs(d)?,
            v: zeros()?,
            step: zeros()?,
            e: zeros()?,
            ..Self::default()
        })
    }

    /// Memory for what is asked for at its first use.
    pub(super) fn reserve(&mut self) -> Result<()> {
        self.interior = Interior::new(self.u.len())?;
        Ok(())
    }

    /// Searches from the limits that `warm` names, or from a guess; then `u`, `g` and `certificate` are those of the
    /// best control found.
    pub(super) fn run(
        &mut self,
        q: &mut impl Quadratic,
        bounds: Bounds<'_>,
        warm: Option<&[i8]>,
        until: Until<'_>,
    ) -> Result<Option<Status>> {
        (self.certificate, self.factorizations, self.method) = Default::default();
        q.prepare(until)?;
        self.begin(q, bounds, warm, until)?;
        let method = self.method;
        let mut end = self.pivot(q, bounds, until, PIVOTS)?;
        if warm.is_some() && matches!(end, End::Stuck) {
            self.begin(q, bounds, None, until)?;
            end = self.pivot(q, bounds, until, PIVOTS - self.factorizations.min(PIVOTS - LAST_PIVOTS))?;
        }
        let early = match end {
            End::Done => {
                self.refine(q, bounds, until, method, false)?;
                self.sharpen(q, bounds, until)?;
                None
            }
            End::Stuck => {
                self.verify(q, bounds, until, method, true)?;
                None
            }
            End::Early(status) => {
                self.verify(q, bounds, until, method, true)?;
                Some(status)
            }
        };
        if early.is_some() || good(&self.certificate, q.scale()) {
            return Ok(early);
        }
        self.safeguard(q, bounds, until)
    }

    fn begin(
        &mut self,
        q: &mut impl Quadratic,
        bounds: Bounds<'_>,
        warm: Option<&[i8]>,
        until: Until<'_>,
    ) -> Result<()> {
        for i in 0..q.size() {
            // an input that changes nothing stays where it is nearest to 0
            let idle = q.curvature()[i] == 0.0;
            self.fixed[i] = if bounds.fixed(i) || idle { 1 } else { 0 };
            self.v[i] = bounds.clip(i, 0.0);
        }
        match warm {
            Some(warm) => {
                for (i, held) in self.held.iter_mut().enumerate() {
                    let there = bounds.at(i, warm[i]).is_some_and(f64::is_finite);
                    *held = if self.fixed[i] != 0 {
                        1
                    } else if there {
                        warm[i]
                    } else {
                        0
                    };
                }
            }
            None => {
                q.guess(bounds, &self.fixed, &mut self.v, until)?;
                for (i, held) in self.held.iter_mut().enumerate() {
                    *held = if self.fixed[i] != 0 { 1 } else { bounds.reached(i, self.v[i], 0.0) };
                }
            }
        }
        Ok(())
    }

    /// `v` with every held input at its limit.
    fn hold(&mut self, bounds: Bounds<'_>) {
        for (i, v) in self.v.iter_mut().enumerate() {
            if self.fixed[i] != 0 {
                *v = bounds.clip(i, 0.0);
            } else if let Some(limit) = bounds.at(i, self.held[i]) {
                *v = limit + 0.0;
            }
        }
    }

    fn pivot(&mut self, q: &mut impl Quadratic, bounds: Bounds<'_>, until: Until<'_>, most: usize) -> Result<End> {
        let (mut least, mut waits) = (usize::MAX, 0);
        for _ in 0..most {
            if let Some(status) = until.reached() {
                return Ok(End::Early(status));
            }
            self.hold(bounds);
            self.factorizations += 1;
            if !q.face(&self.held, &mut self.v, until)? {
                return Ok(End::Stuck);
            }
            let squared = q.pull(&self.v, &mut self.step);
            let rounding = ROUNDING * (q.scale().sqrt() + squared.max(0.0).sqrt());
            let count = self.exchange(bounds, q.curvature(), rounding);
            if count == 0 {
                return Ok(End::Done);
            }
            if count < least {
                (least, waits) = (count, 0);
            } else {
                waits += 1;
                if waits >= PATIENCE {
                    break;
                }
            }
        }
        Ok(End::Stuck)
    }

    /// Exchanges what violates its limit or its sign by more than rounding; the number of these.
    fn exchange(&mut self, bounds: Bounds<'_>, curvature: &[f64], rounding: f64) -> usize {
        let mut count = 0;
        for i in (0..curvature.len()).filter(|&i| self.fixed[i] == 0) {
            let (v, g, root) = (self.v[i], self.step[i], curvature[i].sqrt());
            let now = match self.held[i] {
                0 if v < bounds.low[i] - rounding / root => -1,
                0 if v > bounds.high[i] + rounding / root => 1,
                -1 if g < -rounding * root => 0,
                1 if g > rounding * root => 0,
                same => same,
            };
            count += usize::from(now != self.held[i]);
            self.held[i] = now;
        }
        count
    }

    /// Corrects the free inputs by the gradient from the residual, if there is something to gain.
    fn refine(
        &mut self,
        q: &mut impl Quadratic,
        bounds: Bounds<'_>,
        until: Until<'_>,
        method: Method,
        dual: bool,
    ) -> Result<()> {
        self.verify(q, bounds, until, method, dual)?;
        let scale = q.scale() + self.certificate.objective;
        if self.certificate.gap > EXACT * scale && self.v == self.u && q.dual_at_hand(&self.fixed) {
            // far limits make the other bound large where a correction gains nothing
            self.step.copy_from_slice(&self.g);
            let squared = self.dual_residual(q, bounds, scale, until)?;
            if squared <= NEGLIGIBLE * scale {
                self.certificate.improve(squared);
                return Ok(());
            }
        }
        if self.certificate.gap > EXACT * scale {
            self.hold(bounds);
            if self.v == self.u {
                self.step.copy_from_slice(&self.g);
            } else {
                q.slope(&self.v, &mut self.step);
            }
            q.correct(&mut self.step);
            self.v.iter_mut().zip(&self.step).for_each(|(v, step)| *v -= step);
            self.verify(q, bounds, until, method, dual)?;
        }
        Ok(())
    }

    /// The dual residual of the best control, where the gap is not small without it.
    fn sharpen(&mut self, q: &mut impl Quadratic, bounds: Bounds<'_>, until: Until<'_>) -> Result<()> {
        if !good(&self.certificate, q.scale()) {
            self.v.copy_from_slice(&self.u);
            self.step.copy_from_slice(&self.g);
            let scale = q.scale() + self.certificate.objective;
            let squared = self.dual_residual(q, bounds, scale, until)?;
            self.certificate.improve(squared);
        }
        Ok(())
    }

    fn safeguard(&mut self, q: &mut impl Quadratic, bounds: Bounds<'_>, until: Until<'_>) -> Result<Option<Status>> {
        self.v.copy_from_slice(&self.u);
        self.held.copy_from_slice(&self.fixed);
        let moving = (&mut *self.v, &mut *self.step, &mut *self.held);
        let (done, early) = self.interior.run(q, bounds, moving, until)?;
        self.factorizations += done;
        self.verify(q, bounds, until, Method::Interior, true)?;
        if early.is_some() {
            return Ok(early);
        }
        match self.pivot(q, bounds, until, LAST_PIVOTS)? {
            End::Done => self.refine(q, bounds, until, Method::Interior, true)?,
            End::Stuck => self.verify(q, bounds, until, Method::Interior, true)?,
            End::Early(status) => return Ok(Some(status)),
        }
        Ok(None)
    }

    /// Clips `v`; it is the best control if its gap is smaller. `dual`: with the dual residual, where that is needed.
    fn verify(
        &mut self,
        q: &mut impl Quadratic,
        bounds: Bounds<'_>,
        until: Until<'_>,
        method: Method,
        dual: bool,
    ) -> Result<()> {
        for (i, v) in self.v.iter_mut().enumerate() {
            *v = bounds.clip(i, *v);
        }
        let objective = q.slope(&self.v, &mut self.step);
        if !objective.is_finite() {
            return Ok(());
        }
        let scale = q.scale() + objective;
        let frank_wolfe = frank_wolfe(bounds, &self.v, &self.step);
        let mut found = Certificate { objective, gap: frank_wolfe, frank_wolfe, distance: (frank_wolfe / 2.0).sqrt() };
        if dual && !good(&found, q.scale()) {
            found.improve(self.dual_residual(q, bounds, scale, until)?);
        }
        found.at_least_nothing(q.scale());
        let best = &self.certificate;
        // without a limit on some side the gap is infinite at first: there the later one is the corrected one, if it
        // does not cost more; of several exact ones the last is at its limits, where an interior point only comes close
        let lower = objective <= best.objective + EXACT * scale;
        let unknown = found.gap == f64::INFINITY && best.gap == f64::INFINITY && lower;
        if found.gap < best.gap || unknown || found.gap <= EXACT * scale {
            std::mem::swap(&mut self.u, &mut self.v);
            std::mem::swap(&mut self.g, &mut self.step);
            self.v.copy_from_slice(&self.u);
            (self.certificate, self.method) = (found, method);
        }
        Ok(())
    }

    /// `e' H^{-1} e` with `e` the half gradient where no limit balances it: `D^2` and `J(u) - min J` are at most this.
    fn dual_residual(
        &mut self,
        q: &mut impl Quadratic,
        bounds: Bounds<'_>,
        scale: f64,
        until: Until<'_>,
    ) -> Result<f64> {
        // ||M u - y|| is rounded by eps sum_i ||M_i|| |u_i|: where that is large, little is known of J(u)
        let sizes: f64 = self.v.iter().zip(q.curvature()).map(|(v, curvature)| v.abs() * curvature.sqrt()).sum();
        if f64::EPSILON * sizes > UNKNOWN * scale.sqrt() {
            return Ok(f64::INFINITY);
        }
        for (i, e) in self.e.iter_mut().enumerate() {
            let (at, g) = (bounds.reached(i, self.v[i], self.step[i]), self.step[i]);
            let balanced = self.fixed[i] != 0 || at < 0 && g >= 0.0 || at > 0 && g <= 0.0;
            *e = if balanced { 0.0 } else { g };
        }
        match q.dual_norm(&self.fixed, &self.e, until) {
            Err(Error::Interrupted) => Ok(f64::INFINITY), // no time for its factors: the other bound is left
            found => found,
        }
    }
}

impl Search {
    /// What is left to say where a stop came before any control was judged.
    pub(super) fn give_up(&mut self, q: &mut impl Quadratic, bounds: Bounds<'_>) {
        self.u.iter_mut().enumerate().for_each(|(i, u)| *u = bounds.clip(i, 0.0));
        let objective = q.slope(&self.u, &mut self.g);
        let frank_wolfe = frank_wolfe(bounds, &self.u, &self.g);
        self.certificate =
            Certificate { objective, gap: frank_wolfe, frank_wolfe, distance: (frank_wolfe / 2.0).sqrt() };
    }
}

/// Whether nothing more is tried: a tenth of the gap of an optimal result, and little beside `J(0)`.
pub(super) fn good(found: &Certificate, scale: f64) -> bool {
    found.gap <= GOOD * (scale + found.objective) && found.optimal(scale, 0.1)
}

fn try_signs(d: usize) -> Result<Vec<i8>> {
    crate::memory::try_filled(WHAT, 0, d)
}
