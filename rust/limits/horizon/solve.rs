//! The best inputs of a horizon.

use super::map::{Horizon, WHAT};
use crate::error::{Error, Result};
use crate::limits::bounds::Bounds;
use crate::limits::linear::{form, least_eigenvalue, norm, product, singular_values};
use crate::limits::quadratic::{Status, Until};
use crate::limits::riccati::{Steps, horizon_control};
use crate::limits::rows::{KINDS, Rows, RowsSolution, rows_control};
use crate::limits::solve::{Solution, box_control};
use crate::limits::solver::Solver;
use crate::memory::{try_copy, try_extend, try_filled, try_zeros};
use crate::parallel::Stop;

/// Relative rounding of a value beside its limit.
pub(super) const ROUNDING: f64 = 1e-12;

/// The best inputs, and what their limits cost.
#[derive(Debug, Clone)]
pub struct Solved {
    /// The inputs and their certificate.
    pub found: Solution,
    /// `J(u)` less the least J without limits; 0 if none is active, NaN if the computation ended before.
    pub missed: f64,
    /// By how much hard limits of states cannot be met.
    pub missing: f64,
    /// -1 where a state is at its lower limit or below to rounding, 1 at the upper or above; none without such limits.
    pub state_active: Option<Vec<i8>>,
}

impl Horizon {
    /// `J(u)` from `x0`, with the weight of soft limits.
    ///
    /// # Errors
    /// As [`Self::states`].
    pub fn objective(&self, x0: &[f64], u: &[f64]) -> Result<f64> {
        let x = self.states(x0, u)?;
        let mut off = try_copy(WHAT, &x)?;
        off.iter_mut().zip(&self.task.reference).for_each(|(x, r)| *x -= r);
        let weighted = self.weighted(&off)?;
        let of_inputs: f64 = u.chunks_exact(self.m).map(|u| form(&self.r, u)).sum();
        let mut value = of_inputs + weighted.iter().map(|v| v * v).sum::<f64>();
        if let (Some(soft), Some((low, high))) = (self.task.soft, &self.task.states) {
            let beyond = x.iter().zip(low.iter().zip(high)).map(|(x, (l, h))| (x - h).max(0.0) + (l - x).max(0.0));
            value += soft * beyond.map(|v| v * v).sum::<f64>();
        }
        Ok(value)
    }

    /// How many limits there are of each kind, and in each step.
    fn kinds(&self) -> [(usize, usize); KINDS] {
        let count = |there, width| (if there { self.steps * width } else { 0 }, width);
        [count(true, self.m), count(self.task.rate.is_some(), self.m), count(self.task.states.is_some(), self.n)]
    }

    /// The best inputs from `x0` within the limits, or with `free` without them, begun at the limits that `warm` names.
    ///
    /// # Errors
    /// As [`rows_control`].
    pub fn best(&self, x0: &[f64], free: bool, warm: Option<&[i8]>, until: Until<'_>) -> Result<RowsSolution> {
        let d = self.steps * self.m;
        let sides = if free { [f64::NEG_INFINITY, f64::INFINITY] } else { [0.0; 2] };
        let none = if free { Some((try_filled(WHAT, sides[0], d)?, try_filled(WHAT, sides[1], d)?)) } else { None };
        let (low, high) = none.as_ref().map_or((&self.task.low, &self.task.high), |(low, high)| (low, high));
        let bounds = Bounds::new(low, high, d)?;
        let boxed = |found| RowsSolution { found, rows: Default::default(), missing: 0.0, excess: 0.0 };
        if !self.long() && (free || self.boxed()) {
            let (y, cost) = (self.aim(x0)?, self.cost()?);
            return box_control(self.map()?, &y, Self::penalty(&cost), bounds, warm, until).map(boxed);
        }
        let reference = self.wanted()?;
        let steps = Steps {
            a: &self.a,
            b: &self.b,
            x0,
            reference: &reference,
            stage: &self.task.stage,
            terminal: &self.task.terminal,
            r: &self.r,
        };
        if free || self.boxed() {
            return horizon_control(&steps, bounds, warm, until).map(boxed);
        }
        // limits of x less what c does
        let mut shifted = None;
        if let Some((low, high)) = &self.task.states {
            let less = |side: &[f64]| -> Result<Vec<f64>> {
                let mut side = try_copy(WHAT, side)?;
                side.iter_mut().zip(&self.drift).for_each(|(side, f)| *side -= f);
                Ok(side)
            };
            shifted = Some((less(low)?, less(high)?));
        }
        let rows = Rows {
            rate: self.task.rate.as_ref().map(|(rate, previous)| (&rate[..], &previous[..])),
            states: shifted.as_ref().map(|(low, high)| (&low[..], &high[..])),
            soft: self.task.soft,
        };
        rows_control(&steps, bounds, rows, warm, until)
    }

    /// The best inputs from `x0`, with what their limits cost.
    ///
    /// # Errors
    /// As [`Self::best`].
    pub fn solve(&self, x0: &[f64], until: Until<'_>) -> Result<Solved> {
        let RowsSolution { found, missing, .. } = self.best(x0, false, None, until)?;
        let state_active = match &self.task.states {
            Some(limits) => Some(self.state_sides(x0, &found.control, limits)?),
            None => None,
        };
        let ended = |status| matches!(status, Status::Limit | Status::Interrupted);
        let mut least = if ended(found.status) { f64::NAN } else { found.objective };
        if !ended(found.status) && (found.active.iter().any(|side| *side != 0) || !self.boxed()) {
            let free = self.best(x0, true, None, until)?.found;
            least = if ended(free.status) { f64::NAN } else { free.objective };
        }
        // NaN stays NaN
        let missed = if least >= found.objective { 0.0 } else { found.objective - least };
        Ok(Solved { found, missed, missing, state_active })
    }

    fn state_sides(&self, x0: &[f64], u: &[f64], (low, high): &(Vec<f64>, Vec<f64>)) -> Result<Vec<i8>> {
        let x = self.states(x0, u)?;
        let mut near = try_zeros(WHAT, self.n)?;
        for row in x.chunks_exact(self.n) {
            near.iter_mut().zip(row).for_each(|(near, x): (&mut f64, _)| *near = near.max(ROUNDING * x.abs()));
        }
        let mut sides = try_filled(WHAT, 0, x.len())?;
        for (i, side) in sides.iter_mut().enumerate() {
            if x[i] >= high[i] - near[i % self.n] {
                *side = 1;
            } else if x[i] <= low[i] + near[i % self.n] {
                *side = -1;
            }
        }
        Ok(sides)
    }

    /// What `||u - v||_H <= distance` is for `||u - v||_2` and for the 2-norm of the difference of the last states.
    ///
    /// # Errors
    /// [`Error::Numerical`], [`Error::Memory`].
    pub fn in_two_norm(&self, distance: f64) -> Result<(f64, f64)> {
        let d = self.steps * self.m;
        let mut least = least_eigenvalue(&self.r, self.m)?;
        if !self.long() {
            let stacked = self.stacked()?;
            let values = singular_values(&stacked, d)?;
            if let (Some(first), Some(last)) = (values.first(), values.get(d - 1)) {
                let sure = last - (stacked.len() / d).max(d) as f64 * f64::EPSILON * first;
                least = least.max(if sure > 0.0 { sure * sure } else { 0.0 });
            }
        }
        let control = if least > 0.0 { distance / least.sqrt() } else { f64::INFINITY };
        let lowest = least_eigenvalue(&self.task.terminal, self.n)?;
        let state = product(norm(&self.pushes), control);
        Ok((control, if lowest > 0.0 { state.min(distance / lowest.sqrt()) } else { state }))
    }
}

/// The best inputs from one state after another, each begun at the limits of the one before, a step later.
pub struct Loop {
    horizon: Horizon,
    /// One map for all states, where the limits are those of single inputs.
    solver: Option<Solver>,
    warm: Option<Vec<i8>>,
}

impl Loop {
    /// Everything that does not depend on the state is computed here.
    ///
    /// # Errors
    /// As [`Solver::new`].
    pub fn new(horizon: Horizon, stop: &Stop) -> Result<Self> {
        let mut solver = None;
        if !horizon.long() && horizon.boxed() && !horizon.map()?.is_empty() {
            let (cost, state, target) = (horizon.cost()?, horizon.state()?, horizon.target()?);
            let bounds = Bounds::new(&horizon.task.low, &horizon.task.high, horizon.steps * horizon.m)?;
            let goal = (&state[..], &target[..]);
            solver = Some(Solver::new(horizon.map()?, Horizon::penalty(&cost), bounds, horizon.m, goal, stop)?);
        }
        Ok(Self { horizon, solver, warm: None })
    }

    /// Whether one map serves all states.
    pub fn condensed(&self) -> bool {
        self.solver.is_some()
    }

    /// `u(-1)` from now on, if the task has rates.
    pub fn follow(&mut self, previous: &[f64]) {
        self.horizon.follow(previous);
    }

    /// The best inputs from `x`. After an error, all is as before.
    ///
    /// # Errors
    /// As [`Horizon::best`].
    pub fn solve(&mut self, x: &[f64], until: Until<'_>) -> Result<Solution> {
        if let Some(solver) = &mut self.solver {
            return solver.solve(x, until);
        }
        let found = self.horizon.best(x, false, self.later()?.as_deref(), until)?;
        let mut warm = try_copy(WHAT, &found.found.active)?;
        let sign = |v: &f64| if *v == 0.0 { 0 } else { v.signum() as i8 };
        try_extend(WHAT, &mut warm, found.rows.iter().flatten().map(sign))?;
        self.warm = Some(warm);
        Ok(found.found)
    }

    /// The limits of the last call one step later, the last step once more; for each kind of limits.
    fn later(&self) -> Result<Option<Vec<i8>>> {
        let Some(warm) = &self.warm else { return Ok(None) };
        let mut warm = try_copy(WHAT, warm)?;
        let mut rest = &mut warm[..];
        for (len, width) in self.horizon.kinds() {
            let (kind, others) = rest.split_at_mut(len);
            kind.copy_within(width.min(len).., 0);
            rest = others;
        }
        Ok(Some(warm))
    }

    /// The limits at which the next call begins, before the shift.
    pub fn warm(&self) -> Option<&[i8]> {
        self.solver.as_ref().map_or(self.warm.as_deref(), Solver::warm)
    }

    /// Sets them.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn resume(&mut self, warm: Option<Vec<i8>>) -> Result<()> {
        if let Some(solver) = &mut self.solver {
            return solver.resume(warm);
        }
        let len = self.horizon.kinds().iter().map(|(len, _)| len).sum::<usize>();
        match warm {
            Some(warm) if warm.len() != len => {
                let found = format!("{} entries", warm.len());
                Err(Error::Shape { name: "warm", expected: format!("{len} entries"), found })
            }
            warm => {
                self.warm = warm;
                Ok(())
            }
        }
    }
}
