//! How far a control is from the best one.

use super::bounds::Bounds;
use super::quadratic::Status;

/// The gap of an optimal result, relative to `J(u)`.
const OPTIMAL: f64 = 1e-9;
/// Squares of rounding relative to the size of `J` before anything cancels: what is below is 0.
pub(super) const NOTHING: f64 = 1e-20;
/// `(16 eps)^2`: what rounding of the residuals can hide of a `J` that is 0.
const HIDDEN: f64 = 256.0 * f64::EPSILON * f64::EPSILON;

/// How far `J(u)` is from the minimum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Certificate {
    pub(super) objective: f64,
    pub(super) gap: f64,
    pub(super) frank_wolfe: f64,
    pub(super) distance: f64,
}

impl Default for Certificate {
    fn default() -> Self {
        let none = f64::INFINITY;
        Self { objective: none, gap: none, frank_wolfe: none, distance: none }
    }
}

impl Certificate {
    /// Takes the square of a bound of the distance.
    pub(super) fn improve(&mut self, squared: f64) {
        self.gap = self.gap.min(squared);
        self.distance = self.distance.min(squared.sqrt());
    }

    /// `J >= 0`: no gap is larger than `J(u)`, of which `scale` is the size before anything cancels.
    pub(super) fn at_least_nothing(&mut self, scale: f64) {
        self.improve(self.objective + HIDDEN * scale);
    }

    /// Whether the gap is that of an optimal result, by a `share` of the tolerance.
    pub(super) fn optimal(&self, scale: f64, share: f64) -> bool {
        self.gap <= share * OPTIMAL * self.objective + NOTHING * scale
    }
}

/// `max <J'(u), u - v>` over the limits.
pub(super) fn frank_wolfe(bounds: Bounds<'_>, u: &[f64], g: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (i, (u, g)) in u.iter().zip(g).enumerate() {
        if *g != 0.0 {
            let to = if *g > 0.0 { bounds.low[i] } else { bounds.high[i] };
            sum += if to == *u { 0.0 } else { 2.0 * g * (u - to) };
        }
    }
    sum
}

/// The status of a gap, relative to `J(u)`; `scale`: the size of `J` before anything cancels.
pub(super) fn status(early: Option<Status>, found: &Certificate, scale: f64) -> Status {
    match early {
        _ if found.optimal(scale, 1.0) => Status::Optimal,
        Some(status) => status,
        None => Status::Inaccurate,
    }
}
