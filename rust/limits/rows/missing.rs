//! What limits on states lack that cannot be met: a linear program, and a bound from its multipliers.

use super::assembly::{Aim, FAR, Kind};
use super::search::Search;
use super::task::{Excess, WHAT};
use crate::error::{Error, Result};
use crate::limits::quadratic::Until;
use crate::memory::try_zeros;

/// Inputs that large, relative to those found, are not asked whether they would meet limits on states.
const LARGE: f64 = 1e6;

impl Search<'_, '_> {
    /// A control with the least largest excess of limits on states in units of each, its states, this excess, and
    /// whether it is certain that there must be one: for `v >= 0` with sum 1 and any `w`,
    /// `min_u v' (C u - c) + w' (rates) <=` every excess.
    pub(super) fn least(&mut self, until: Until<'_>) -> Result<(Vec<f64>, Vec<f64>, Excess, bool)> {
        let task = self.task;
        let (program, rows) = task.whole(Aim::Least, FAR[1])?;
        let point = program.solve(until)?;
        self.iterations += point.iterations;
        let (mut u, mut x, mut found, _) = task.read(&point, &rows, Aim::Least)?;
        if u.iter().chain(found[1..].iter().flatten()).any(|v| !v.is_finite()) {
            return Err(Error::Numerical("no control with the least excess".into()));
        }
        let mut g = try_zeros(WHAT, u.len())?;
        self.settle(&mut u, &mut x)?;
        let sum: f64 = found[Kind::State as usize].iter().map(|v| v.abs()).sum();
        let mut least = 0.0;
        for (kind, _) in task.kinds().into_iter().skip(1) {
            for (i, v) in found[kind as usize].iter_mut().enumerate() {
                let (low, high) = task.limits(kind, i);
                *v /= sum.max(f64::MIN_POSITIVE);
                let limit = if *v > 0.0 { high } else { low };
                if limit.is_finite() {
                    least += *v * (task.value(kind, i, &u, &x) - limit);
                } else {
                    *v = 0.0;
                }
            }
        }
        task.pull(&found[Kind::State as usize], &mut g)?;
        task.pull_rows(&found, &mut g);
        let most = u.iter().enumerate().fold(1.0f64, |most, (i, u)| most.max(u.abs() / task.unit(Kind::Input, i)));
        for (i, (u, g)) in u.iter().zip(&g).enumerate() {
            let large = LARGE * most * task.unit(Kind::Input, i);
            let to = if *g > 0.0 { task.bounds().low[i].max(-large) } else { task.bounds().high[i].min(large) };
            least -= g * (u - to);
        }
        let amount = task.excess(&u, &x)?;
        Ok((u, x, amount, least > 0.0))
    }
}
