//! Limits that noisy runs of every member keep with a stated probability, for plans that begin anew at measured states.
//!
//! A plan from x follows `u = v + K (x - xb)`, xb the states of the centre, and `v = K xb` behind it. On the event of
//! the region a row h of states or inputs is off by at most `model(k) + noise`, with `c(j) = W z(j)` along the plan:
//!
//! ```text
//! model(k) = sqrt(h'L_k h) (sum_(j<k) ||c_j||^2)^(1/2) / (1 - theta),    noise = zeta sqrt(h'Y h),
//! ```
//!
//! or the exact first order with theta times that. The noise between a start j and a step k does not depend on the
//! plan, so that zeta is the quantile for the union over all pairs j < k <= T and all sides of limits: plans may begin
//! whenever they like. A plan is accepted if it keeps limits that are tighter by both, until all later states are
//! inside for good.

use std::sync::Arc;

use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;

use crate::error::{Error, Result, sized};
use crate::identify::normal_quantile;
use crate::memory::{covered, try_copy};
use crate::parallel::Stop;

use super::certificate::Verdict;
use super::data::{Matrix, WHAT, entries, in_units, matrix, stacked, symmetric};
use super::first_order::FirstOrder;
use super::loops::{Loop, bytes, forms, squares};
use super::tube::ROUNDING;

/// Steps with a bound of their own; later ones share the limit of all.
const STEPS: usize = 400;
/// Steps behind a plan after which it counts as one that does not come to rest.
const LATE: usize = 5000;

/// What a plan lacks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Short {
    /// The row: states, inputs, and those below.
    pub row: usize,
    /// The step.
    pub step: usize,
    /// By how much the tighter limit is missed.
    pub amount: f64,
    /// What it is tighter by for the error of the model.
    pub model: f64,
    /// The same for noise.
    pub noise: f64,
}

/// Whether a plan is accepted.
#[derive(Debug, Clone)]
pub struct Judged {
    /// The worst row and step where it is not.
    pub short: Option<Short>,
    /// What the error of the model adds at most along the plan (n + m + r).
    pub model: Vec<f64>,
    /// Whether it would not be accepted for any smaller `model` either.
    pub surely: bool,
}

/// Limits to be kept.
#[derive(Debug)]
pub struct Keeper {
    of: Arc<Loop>,
    rows: Matrix,
    /// The rows below states and inputs, of these.
    below: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
    noise: Vec<f64>,
    /// `sqrt(h'L_k h) / (1 - theta)`, and for all k at the end.
    forced: Vec<Vec<f64>>,
    /// `sqrt(h'Q h)`.
    level: Vec<f64>,
    /// Row by row, as calls are short: `[A B]`, K, W of all parts, and matrices g whose `g'g` is `sum_j A0'^j E'E A0^j`
    /// and `Q^-1`.
    centre: Vec<f64>,
    gain: Vec<f64>,
    white: Vec<f64>,
    rest: Vec<f64>,
    inverse: Vec<f64>,
}

/// `to = M z`.
fn times(m: &[f64], z: &[f64], to: &mut [f64]) {
    for (to, row) in to.iter_mut().zip(m.chunks_exact(z.len())) {
        *to = row.iter().zip(z).map(|(a, b)| a * b).sum();
    }
}

/// `||g x||^2`.
fn square(g: &[f64], x: &[f64]) -> f64 {
    g.chunks_exact(x.len()).map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum::<f64>().powi(2)).sum()
}

impl Keeper {
    /// Limits (n + m + r), of states, inputs and the rows `below` (r, n + m) of both, `low < 0 < high`, for `calls`
    /// steps with Gaussian noise of at most this covariance (n, n); `eps` is given away for it. None where there is no
    /// bound.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`], [`Error::Numerical`], [`Error::Memory`].
    pub fn new(
        of: Arc<Loop>,
        (limits, below): ((&[f64], &[f64]), &[f64]),
        covariance: &[f64],
        eps: f64,
        calls: usize,
    ) -> Result<Option<Self>> {
        let (n, q, d) = (of.data.n, of.data.n + of.data.m, of.data.region.d);
        let ((low, high), r) = (limits, below.len() / q);
        if low.len() != q + r || high.len() != q + r || below.len() != r * q || covariance.len() != n * n {
            let found = format!("{}, {} and {}", low.len(), high.len(), covariance.len());
            return Err(Error::Shape {
                name: "limits",
                expected: format!("{q} entries, one more for each row below, and {n} x {n} of noise"),
                found,
            });
        }
        let Some(proof) = of.proof.as_ref().filter(|_| {
            of.certificate.status == Verdict::Certified && of.data.c.is_none() && of.data.misfits.is_empty()
        }) else {
            return Ok(None);
        };
        covered(WHAT, bytes(n, d) + 16 * (STEPS * (q + r)) as u128, || {
            let (own, back, theta) = (of.rows(), of.data.back(), of.certificate.norm);
            let rows = stacked([&own, &(matrix(below, r, q) * &own)], n);
            let (a, inputs, outputs) = (&of.closed.a0, of.closed.inputs(&of.data), of.closed.outputs());
            let forcing = symmetric(&(&inputs * inputs.transpose()));
            let all = of.gramian(a, &forcing, 1.0);
            let rest = of.gramian(&a.transpose().to_owned(), &symmetric(&(outputs.transpose() * &outputs)), 1.0);
            let asked = symmetric(&in_units(&matrix(covariance, n, n), &back, &back));
            let still = covariance.iter().all(|v| *v == 0.0);
            let y = if still { Some(Mat::zeros(n, n)) } else { of.smallest(&asked, 1.0, &rows) };
            let (Some(all), Some(rest), Some(y)) = (all, rest, y) else { return Ok(None) };
            if theta >= 1.0 {
                return Ok(None);
            }
            let sizes = |mut squares: Vec<f64>, by: f64| {
                squares.iter_mut().for_each(|v| *v = by * v.sqrt() * (1.0 + ROUNDING));
                squares
            };
            let by = 1.0 / (1.0 - theta);
            let (mut forced, mut l) = (Vec::new(), Mat::<f64>::zeros(n, n));
            for _ in 0..STEPS {
                forced.push(sizes(forms(&l, &rows), by));
                l = a * &l * a.transpose() + &forcing;
            }
            forced.push(sizes(squares(&all, &rows), by));
            let sides = low.iter().chain(high).filter(|v| v.is_finite()).count();
            let pairs = calls as f64 * (calls as f64 + 1.0) / 2.0;
            // P(|N| > zeta) = 2 eps / (sides pairs): one side each
            let zeta = normal_quantile(&[1.0], 1, (2.0 * eps / (sides.max(1) as f64 * pairs)).min(0.999))?;
            let (noise, level) = (sizes(squares(&y, &rows), zeta), sizes(squares(proof, &rows), 1.0));
            let inverse = proof.partial_piv_lu().inverse();
            let (low, high, below) = (try_copy(WHAT, low)?, try_copy(WHAT, high)?, try_copy(WHAT, below)?);
            let (mut centre, mut white) = (Vec::new(), Vec::new());
            for i in 0..n {
                centre.extend((0..n).map(|j| of.data.a[(i, j)]));
                centre.extend((0..q - n).map(|j| of.data.b[(i, j)]));
            }
            for (piece, t) in of.data.pieces.iter().zip(&of.closed.t) {
                let part = &piece.w;
                (0..part.nrows()).for_each(|i| white.extend((0..q).map(|j| part[(i, j)] / t.sqrt())));
            }
            let (gain, inverse, rest) =
                (entries(&of.closed.k), entries(&inverse), entries(&rest.transpose().to_owned()));
            let of = Arc::clone(&of);
            Ok(Some(Self { rows, below, low, high, noise, forced, level, centre, gain, white, rest, inverse, of }))
        })?
    }

    /// What noise adds at most to each row (n + m + r).
    #[must_use]
    pub fn noise(&self) -> &[f64] {
        &self.noise
    }

    /// `z = (x, u)` along the centre at first, and what goes one step further.
    fn begin(&self, x0: &[f64], plan: &[f64]) -> Result<Vec<f64>> {
        let data = &self.of.data;
        if x0.len() != data.n || !plan.len().is_multiple_of(data.m) {
            let (expected, found) = (format!("{} entries, plans of {}", data.n, data.m), x0.len().to_string());
            return Err(Error::Shape { name: "x", expected, found });
        }
        let mut z = Vec::new();
        z.extend(x0.iter().zip(&data.unit).map(|(x, unit)| x / unit));
        z.resize(data.n + data.m, 0.0);
        self.act(&mut z, plan, 0);
        Ok(z)
    }

    /// u of step k into z.
    fn act(&self, z: &mut [f64], plan: &[f64], k: usize) {
        let (x, u) = z.split_at_mut(self.of.data.n);
        match plan.chunks_exact(u.len()).nth(k) {
            Some(row) => u.copy_from_slice(row),
            None => times(&self.gain, x, u),
        }
    }

    /// z of step `k` from that of the step before.
    fn step(&self, z: &mut [f64], next: &mut [f64], plan: &[f64], k: usize) {
        times(&self.centre, z, next);
        z[..next.len()].copy_from_slice(next);
        self.act(z, plan, k);
    }

    /// Row h of z, in the units of the data.
    fn value(&self, h: usize, z: &[f64]) -> f64 {
        let own = |i: usize| z[i] * self.of.data.unit.get(i).copied().unwrap_or(1.0);
        let below = h.checked_sub(z.len()).and_then(|h| self.below.chunks_exact(z.len()).nth(h));
        below.map_or_else(|| own(h), |row| row.iter().enumerate().map(|(i, v)| v * own(i)).sum())
    }

    /// Whether the data determine `Theta z`.
    fn determined(&self, z: &[f64]) -> bool {
        let (n, unit) = (self.of.data.n, &self.of.data.unit);
        let mut own = Vec::new();
        own.extend(z.iter().enumerate().map(|(i, v)| if i < n { v * unit[i] } else { *v }));
        self.of.data.determined(&own)
    }

    /// Whether every member keeps the limits under the `plan` (P, m) from `x0` and `u = K x` behind it; with `sharp` by
    /// the exact first order.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Interrupted`].
    pub fn judge(&self, x0: &[f64], plan: &[f64], sharp: bool, stop: &Stop) -> Result<Judged> {
        let (data, mut z) = (&self.of.data, self.begin(x0, plan)?);
        let (n, q, planned, theta) = (data.n, data.n + data.m, plan.len() / data.m, self.of.certificate.norm);
        let (mut c, mut next, mut largest) = (Vec::new(), Vec::new(), Vec::new());
        c.resize(self.white.len() / q, 0.0);
        next.resize(n, 0.0);
        let mut order = sharp.then(|| FirstOrder::new(&self.of));
        let (mut squared, mut short, mut worst, mut surely): (f64, Option<Short>, f64, bool) = (0.0, None, 0.0, false);
        let partial = data.region.parts.iter().any(|part| part.rank() < part.columns.len());
        largest.resize(self.low.len(), 0.0f64);
        for k in 0.. {
            let later = k >= planned;
            let whole = (squared + if later { square(&self.rest, &z[..n]) } else { 0.0 }).sqrt();
            let inside = if later { (square(&self.inverse, &z[..n]) * (1.0 + ROUNDING)).sqrt() } else { f64::INFINITY };
            let (table, end, mut resting) = (&self.forced[k.min(STEPS)], &self.forced[STEPS], later);
            for h in 0..self.low.len() {
                let (low, high) = (self.low[h], self.high[h]);
                if low == f64::NEG_INFINITY && high == f64::INFINITY {
                    continue;
                }
                // behind STEPS the sum runs over all steps
                let sum = if k < STEPS { squared.sqrt() } else { whole };
                let mut model = table[h] * sum;
                if let Some(order) = &order
                    && k > 0
                {
                    model = model.min(order.along(&self.rows.subrows(h, 1).to_owned())? + theta * model);
                }
                let noise = if k == 0 { 0.0 } else { self.noise[h] };
                let (off, value) = (model + noise, self.value(h, &z));
                largest[h] = largest[h].max(model);
                let amount = (value + off - high).max(low - value + off);
                surely |= (h >= n || k > 0) && amount > model + ROUNDING * high.min(-low);
                // an x(0) that is beyond its limits is no matter of the plan
                let counts = h >= n || k > 0;
                let share = amount / high.min(-low);
                if counts && (share > worst || share.is_nan()) {
                    worst = share;
                    short = Some(Short { row: h, step: k, amount, model, noise });
                }
                resting &= self.level[h] * inside + end[h] * whole + self.noise[h] <= high.min(-low);
            }
            if resting || k > planned + LATE || !worst.is_finite() {
                let unrested = Short { row: 0, step: k, amount: f64::INFINITY, model: f64::INFINITY, noise: 0.0 };
                let short = short.or(if resting { None } else { Some(unrested) });
                return Ok(Judged { short, model: largest, surely });
            }
            if k % 64 == 0 {
                stop.check()?;
            }
            if partial && !self.determined(&z) {
                squared = f64::INFINITY;
            }
            times(&self.white, &z, &mut c);
            squared += c.iter().map(|v| v * v).sum::<f64>();
            if let Some(order) = &mut order {
                order.push(&c);
            }
            self.step(&mut z, &mut next, plan, k + 1);
        }
        unreachable!("the loop ends by returning")
    }

    /// The input at `x`, `k` steps after the `plan` began at `x0`.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn follow(&self, x0: &[f64], plan: &[f64], k: usize, x: &[f64]) -> Result<Vec<f64>> {
        let (data, mut z, mut next) = (&self.of.data, self.begin(x0, plan)?, Vec::new());
        sized("x", x.len(), data.n)?;
        next.resize(data.n, 0.0);
        (1..=k).for_each(|k| self.step(&mut z, &mut next, plan, k));
        let (xb, u) = z.split_at(data.n);
        next.iter_mut().zip(x.iter().zip(&data.unit).zip(xb)).for_each(|(to, ((x, unit), xb))| *to = x / unit - xb);
        let mut found = Vec::new();
        found.resize(data.m, 0.0);
        times(&self.gain, &next, &mut found);
        found.iter_mut().zip(u).for_each(|(to, u)| *to += u);
        Ok(found)
    }
}
