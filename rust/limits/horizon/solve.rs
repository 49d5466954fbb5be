//! The best inputs of a horizon.

use super::map::{Horizon, Kept, WHAT};
use super::pivoting::Pivoting;
use crate::error::{Error, Result, sized};
use crate::limits::bounds::Bounds;
use crate::limits::linear::{form, least_eigenvalue, norm, product, singular_values};
use crate::limits::quadratic::{Status, Until};
use crate::limits::riccati::closed::{Followed, followed_control};
use crate::limits::riccati::{Recursion, Steps, horizon_control};
use crate::limits::rows::{KINDS, Rows, RowsSolution, rows_control};
use crate::limits::solve::{Most, Solution, box_control, checked_warm};
use crate::limits::solver::Solver;
use crate::memory::{checked_len, try_copy, try_filled, try_zeros};
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
    /// How to follow the inputs, where the system grows over the steps.
    pub followed: Option<Followed>,
}

/// An input within this share of its size from a limit begins another search at that limit.
const CLOSE: f64 = 1e-4;

/// Inputs with what it takes to follow them.
fn followed((found, followed): (Solution, Followed)) -> RowsSolution {
    RowsSolution { found, followed: Some(followed), ..RowsSolution::default() }
}

/// `values` (rows, columns) in the corner of a matrix (more, wider) of `none`, or the corner of it.
fn padded(values: &[f64], rows: usize, columns: usize, more: usize, wider: usize, none: f64) -> Result<Vec<f64>> {
    let mut all = try_filled(WHAT, none, checked_len(WHAT, more, wider)?)?;
    let count = columns.min(wider);
    for (to, from) in all.chunks_exact_mut(wider).zip(values.chunks_exact(columns)).take(rows) {
        to[..count].copy_from_slice(&from[..count]);
    }
    Ok(all)
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

    /// A sign for each limit of a loop: how many.
    pub(super) fn signs(&self) -> usize {
        self.kinds().iter().map(|(len, _)| len).sum()
    }

    /// The best inputs from `x0` within the limits, or with `free` without them, begun at the limits that `warm` names
    /// where there are those of inputs alone.
    ///
    /// # Errors
    /// As [`rows_control`].
    pub fn best(&self, x0: &[f64], free: bool, warm: Option<&[i8]>, until: Until<'_>) -> Result<RowsSolution> {
        let d = self.steps * self.m;
        let sides = if free { [f64::NEG_INFINITY, f64::INFINITY] } else { [0.0; 2] };
        let none = if free { Some((try_filled(WHAT, sides[0], d)?, try_filled(WHAT, sides[1], d)?)) } else { None };
        let (low, high) = none.as_ref().map_or((&self.task.low, &self.task.high), |(low, high)| (low, high));
        let bounds = Bounds::new(low, high, d)?;
        if self.grows
            && let Some(found) = self.growing(x0, free, bounds, warm, until)?
        {
            return Ok(found);
        }
        let boxed = |found| self.unsure(RowsSolution { found, ..RowsSolution::default() });
        if !self.long() && (free || self.boxed()) {
            let (y, cost) = (self.aim(x0)?, self.cost()?);
            return box_control(self.map()?, &y, Self::penalty(&cost), bounds, warm, until).map(boxed);
        }
        let reference = self.wanted()?;
        let steps = self.problem(x0, &reference);
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
        let states = shifted.as_ref().map(|(low, high)| (&low[..], &high[..]));
        let rows = Rows { states, ..self.task.rows() };
        rows_control(&steps, bounds, rows, until).map(|found| self.unsure(found))
    }

    fn problem<'a>(&'a self, x0: &'a [f64], reference: &'a [f64]) -> Steps<'a> {
        let Kept { stage, terminal, .. } = &self.task;
        Steps { a: &self.a, b: &self.b, x0, reference, stage, terminal, r: &self.r }
    }

    /// Where the system grows, a certificate of the inputs alone says nothing of it.
    fn unsure(&self, mut all: RowsSolution) -> RowsSolution {
        if self.grows {
            let found = &mut all.found;
            (found.gap, found.distance, found.frank_wolfe) = (f64::INFINITY, f64::INFINITY, f64::INFINITY);
            if found.status == Status::Optimal {
                found.status = Status::Inaccurate;
            }
        }
        all
    }

    /// The best inputs with their states, over which the system grows; the offset is one more state, which stays 1.
    /// None where an input has no weight at some step.
    fn growing(
        &self,
        x0: &[f64],
        free: bool,
        bounds: Bounds<'_>,
        warm: Option<&[i8]>,
        until: Until<'_>,
    ) -> Result<Option<RowsSolution>> {
        let (n, m) = (self.n, self.m);
        let p = n + usize::from(self.c.is_some());
        let square = |q: &[f64]| padded(q, n, n, p, p, 0.0);
        let (mut a, b, start) = (square(&self.a)?, padded(&self.b, n, m, p, m, 0.0)?, padded(x0, 1, n, 1, p, 1.0)?);
        if let Some(c) = &self.c {
            c.iter().enumerate().for_each(|(i, c)| a[i * p + n] = *c);
            a[n * p + n] = 1.0;
        }
        let (stage, terminal) = (square(&self.task.stage)?, square(&self.task.terminal)?);
        let reference = padded(&self.task.reference, self.steps, n, self.steps, p, 0.0)?;
        let steps =
            Steps { a: &a, b: &b, x0: &start, reference: &reference, stage: &stage, terminal: &terminal, r: &self.r };
        let mut best = None;
        if free || self.boxed() {
            let warm = warm.filter(|_| !free);
            best = followed_control(&steps, bounds, warm, until)?.map(followed);
            if best.as_ref().is_some_and(|best| best.found.status != Status::Inaccurate) {
                return self.without_offset(best, p);
            }
        }
        let mut sides = None;
        if let (Some((low, high)), false) = (&self.task.states, free) {
            let side = |side: &[f64], none| padded(side, self.steps, n, self.steps, p, none);
            sides = Some((side(low, f64::NEG_INFINITY)?, side(high, f64::INFINITY)?));
        }
        let rows = Rows {
            rate: self.task.rate.as_ref().filter(|_| !free).map(|(rate, previous)| (&rate[..], &previous[..])),
            states: sides.as_ref().map(|(low, high)| (&low[..], &high[..])),
            soft: if free { None } else { self.task.soft },
            grows: true,
        };
        match rows_control(&steps, bounds, rows, until) {
            Ok(found) if best.as_ref().is_none_or(|best| found.found.gap < best.found.gap) => best = Some(found),
            Ok(_) => {}
            Err(Error::Numerical(_) | Error::Interrupted) => {}
            Err(other) => return Err(other),
        }
        // another search, from the limits that these inputs are at but for rounding
        if let Some(RowsSolution { found, .. }) = best.as_ref().filter(|best| best.found.status == Status::Inaccurate)
            && (free || self.boxed())
        {
            let side = |(i, u): (usize, &f64)| {
                let close = CLOSE * u.abs();
                i8::from(bounds.high[i] - u <= close) - i8::from(u - bounds.low[i] <= close)
            };
            let sides = crate::memory::try_collect("the limits", found.control.iter().enumerate().map(side))?;
            let again = followed_control(&steps, bounds, Some(&sides), until)?.map(followed);
            best = again.filter(|again| again.found.gap < found.gap).or(best);
        }
        self.without_offset(best, p)
    }

    /// The same of the states alone.
    fn without_offset(&self, mut all: Option<RowsSolution>, p: usize) -> Result<Option<RowsSolution>> {
        let (n, m) = (self.n, self.m);
        if let Some(RowsSolution { rows, followed: Some(followed), .. }) = &mut all
            && p > n
        {
            followed.states = padded(&followed.states, self.steps, p, self.steps, n, 0.0)?;
            followed.feedback = padded(&followed.feedback, self.steps * m, p, self.steps * m, n, 0.0)?;
            for kind in rows.iter_mut().filter(|kind| kind.len() == self.steps * p) {
                *kind = padded(kind, self.steps, p, self.steps, n, 0.0)?;
            }
        }
        Ok(all)
    }

    /// The best inputs from `x0`, with what their limits cost.
    ///
    /// # Errors
    /// As [`Self::best`].
    pub fn solve(&self, x0: &[f64], until: Until<'_>) -> Result<Solved> {
        let RowsSolution { found, missing, followed, .. } = self.best(x0, false, None, until)?;
        let state_active = match (&self.task.states, &followed) {
            (Some(limits), Some(followed)) => Some(self.state_sides(&followed.states, limits)?),
            (Some(limits), None) => Some(self.state_sides(&self.states(x0, &found.control)?, limits)?),
            (None, _) => None,
        };
        let ended = |status| matches!(status, Status::Limit | Status::Interrupted);
        let mut least = if ended(found.status) { f64::NAN } else { found.objective };
        if !ended(found.status) && (found.active.iter().any(|side| *side != 0) || !self.boxed()) {
            let free = self.best(x0, true, None, until)?.found;
            least = if ended(free.status) { f64::NAN } else { free.objective };
        }
        // NaN stays NaN
        let missed = if least >= found.objective { 0.0 } else { found.objective - least };
        Ok(Solved { found, missed, missing, state_active, followed })
    }

    fn state_sides(&self, x: &[f64], (low, high): &(Vec<f64>, Vec<f64>)) -> Result<Vec<i8>> {
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
#[derive(Debug)]
pub struct RecedingHorizon {
    horizon: Horizon,
    /// The limits of inputs and states as they were given, and the reference.
    given: [Vec<f64>; 4],
    /// Inputs that are not chosen (K, m), nan for the others, and the point that inputs and states count from.
    fixed: Vec<f64>,
    point: (Vec<f64>, Vec<f64>),
    /// Whether these changed since the last call.
    moved: bool,
    reference: Vec<f64>,
    /// `(x, F_k (r(k) - reference(k)))`, for one map of both, where there was another reference.
    ahead: Option<Vec<f64>>,
    found: Solution,
    way: Way,
}

/// How a loop finds its plans.
#[derive(Debug)]
enum Way {
    /// One map for all states, where the limits are those of single inputs.
    Inputs(Box<Solver>),
    /// One table for all states, where there are others.
    Rows(Box<Pivoting>),
    /// By the recursion of Riccati, where there are many steps and limits of single inputs.
    Steps(Box<Recursion>),
    /// Anew, from these limits if they are those of inputs alone.
    Anew(Option<Vec<i8>>),
}

impl RecedingHorizon {
    /// Everything that does not depend on the state is computed here, with a first call that is forgotten.
    ///
    /// # Errors
    /// As [`Solver::new`].
    pub fn new(horizon: Horizon, stop: &Stop) -> Result<Self> {
        let d = horizon.steps * horizon.m;
        let mut way = Way::Anew(None);
        if let Some(mut table) = Pivoting::new(&horizon)? {
            let mut first = Solution::sized(d)?;
            // a previous input from where no limit can be kept has its error in the calls
            let _ = table.solve(&horizon, &try_zeros(WHAT, horizon.n)?, Until::new(stop, None), &mut first);
            table.resume(None);
            way = Way::Rows(Box::new(table));
        } else if !horizon.long() && horizon.boxed() && !horizon.map()?.is_empty() {
            let (cost, state, target) = (horizon.cost()?, horizon.state()?, horizon.target()?);
            let bounds = Bounds::new(&horizon.task.low, &horizon.task.high, d)?;
            let goal = (&state[..], &target[..]);
            let solver = Solver::new(horizon.map()?, Horizon::penalty(&cost), bounds, horizon.m, goal, stop)?;
            way = Way::Inputs(Box::new(solver));
        } else if horizon.long() && horizon.boxed() && !horizon.grows {
            let (x0, reference) = (try_zeros(WHAT, horizon.n)?, horizon.wanted()?);
            let recursion = Recursion::new(&horizon.problem(&x0, &reference), Until::new(stop, None))?;
            way = Way::Steps(Box::new(recursion));
        }
        let task = &horizon.task;
        let (below, above) = task.states.as_ref().map_or((&[][..], &[][..]), |(low, high)| (&low[..], &high[..]));
        let given =
            [try_copy(WHAT, &task.low)?, try_copy(WHAT, &task.high)?, try_copy(WHAT, below)?, try_copy(WHAT, above)?];
        let (reference, fixed) = (try_copy(WHAT, &task.reference)?, try_filled(WHAT, f64::NAN, d)?);
        let point = (try_zeros(WHAT, horizon.m)?, try_zeros(WHAT, horizon.n)?);
        let found = Solution::sized(d)?;
        Ok(Self { found, given, fixed, point, moved: false, reference, ahead: None, horizon, way })
    }

    /// Whether one map serves all states, as where there are limits of single inputs alone and not too many steps.
    #[must_use]
    pub fn condensed(&self) -> bool {
        matches!(self.way, Way::Inputs(_))
    }

    /// `u(-1)` (m) from now on, if the task has rates: pass the input that was applied after each [`Self::solve`]. It
    /// counts from the point of [`Self::about`], as all inputs do.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`]; then all is as before.
    pub fn follow(&mut self, previous: &[f64]) -> Result<()> {
        self.horizon.follow(previous)
    }

    /// From now on inputs have these values in the steps of each plan (K, m), whatever their limits; nan where one is
    /// chosen. Limits of rates hold for them, too: give those that jump an infinite one.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`] for an infinite one; then all is as before.
    pub fn fix(&mut self, values: &[f64]) -> Result<()> {
        sized("values", values.len(), self.fixed.len())?;
        if values.iter().any(|value| value.is_infinite()) {
            return Err(Error::Value { name: "values", expected: "numbers, or nan", found: "an infinite one".into() });
        }
        self.fixed.copy_from_slice(values);
        self.moved = true;
        Ok(())
    }

    /// From now on plans follow these states r(1) .. r(K), (K, n).
    ///
    /// The first call makes a map for all references, which allocates.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], as [`Solver::new`].
    pub fn toward(&mut self, reference: &[f64], stop: &Stop) -> Result<()> {
        let Self { horizon, reference: first, ahead, way, .. } = self;
        let n = horizon.n;
        sized("reference", reference.len(), first.len())?;
        crate::error::require_finite("reference", reference)?;
        if let Way::Inputs(solver) = way {
            if ahead.is_none() {
                // y = target - state x + F (r - reference)
                let (state, rows) = (horizon.state()?, horizon.rows());
                let mut wider = try_zeros(WHAT, checked_len(WHAT, rows, n + rows)?)?;
                for (i, (to, from)) in wider.chunks_exact_mut(n + rows).zip(state.chunks_exact(n)).enumerate() {
                    to[..n].copy_from_slice(from);
                    to[n + i] = -1.0;
                }
                let (cost, target, d) = (horizon.cost()?, horizon.target()?, horizon.steps * horizon.m);
                let bounds = Bounds::new(&horizon.task.low, &horizon.task.high, d)?;
                let goal = (&wider[..], &target[..]);
                let mut new = Solver::new(horizon.map()?, Horizon::penalty(&cost), bounds, horizon.m, goal, stop)?;
                new.resume(solver.warm().map(|warm| try_copy(WHAT, warm)).transpose()?)?;
                (**solver, *ahead) = (new, Some(try_zeros(WHAT, n + rows)?));
            }
            let mut to = ahead.iter_mut().flatten().skip(n);
            for (k, (r, first)) in reference.chunks_exact(n).zip(first.chunks_exact(n)).enumerate() {
                let root = &horizon.roots[usize::from(k + 1 == horizon.steps)];
                for (row, to) in root.chunks_exact(n).zip(to.by_ref()) {
                    *to = row.iter().zip(r.iter().zip(first)).map(|(f, (r, first))| f * (r - first)).sum();
                }
            }
        }
        if let Way::Rows(table) = way {
            table.toward(reference, first, n)?;
        }
        horizon.task.reference.copy_from_slice(reference);
        Ok(())
    }

    /// From now on inputs and states are those away from this point: the limits as they were given, less it.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`]; then all is as before.
    pub fn about(&mut self, inputs: &[f64], states: &[f64]) -> Result<()> {
        for (name, of, len) in [("inputs", inputs, self.horizon.m), ("states", states, self.horizon.n)] {
            sized(name, of.len(), len)?;
            crate::error::require_finite(name, of)?;
        }
        self.point.0.copy_from_slice(inputs);
        self.point.1.copy_from_slice(states);
        self.moved = true;
        Ok(())
    }

    /// The limits that were given, or the inputs that are fixed, less the point.
    fn limit(&mut self) {
        if !std::mem::take(&mut self.moved) {
            return;
        }
        let Self { horizon, given, fixed, point, way, .. } = self;
        for (to, given) in [&mut horizon.task.low, &mut horizon.task.high].into_iter().zip(&given[..2]) {
            for ((to, side), (fixed, by)) in to.iter_mut().zip(given).zip(fixed.iter().zip(point.0.iter().cycle())) {
                *to = if fixed.is_nan() { *side } else { *fixed } - by;
            }
        }
        if let Some((low, high)) = &mut horizon.task.states {
            for (to, given) in [low, high].into_iter().zip(&given[2..]) {
                to.iter_mut().zip(given).zip(point.1.iter().cycle()).for_each(|((to, side), by)| *to = side - by);
            }
        }
        if let Way::Inputs(solver) = way {
            solver.limit(&horizon.task.low, &horizon.task.high);
        }
    }

    /// The best inputs from `x`. After an error, all is as before.
    ///
    /// Without allocations and threads where one map, one table or one recursion serves all states, unless hard limits
    /// of states cannot be met, or rounding hides the best and there is no time limit: an interior point decides then.
    /// By design these are solved anew in each call, with memory of their own: systems that grow (1e4-fold over the
    /// steps), and more than 1500 inputs and limited states with limits of rates or states, which Clarabel takes, on a
    /// thread of its own.
    ///
    /// # Errors
    /// As [`Horizon::best`].
    pub fn solve(&mut self, x: &[f64], until: Until<'_>) -> Result<&Solution> {
        self.limit();
        let Self { horizon, found, way, ahead, .. } = self;
        match way {
            Way::Inputs(solver) => {
                let Some(ahead) = ahead else { return solver.solve(x, until) };
                crate::error::require_finite("x", x)?;
                ahead.iter_mut().zip(x).for_each(|(to, x)| *to = *x);
                return solver.solve(ahead, until);
            }
            Way::Rows(table) => {
                let sure = table.solve(horizon, x, until, found)?;
                if sure || horizon.soft() && until.left().is_some() {
                    return Ok(found);
                }
                let other = horizon.best(x, false, None, until)?;
                if !matches!(other.found.status, Status::Limit | Status::Interrupted) {
                    table.follow(&other.found.control, signs(&other));
                    *found = other.found;
                }
            }
            Way::Steps(recursion) => {
                let Kept { low, high, reference, .. } = &horizon.task;
                recursion.solve(x, (reference, &horizon.drift), Bounds { low, high }, until, found)?;
            }
            Way::Anew(warm) => {
                let later = warm.as_ref().map(|warm| horizon.later(warm)).transpose()?;
                let other = horizon.best(x, false, later.as_deref().filter(|_| horizon.boxed()), until)?;
                *warm = Some(crate::memory::try_collect(WHAT, signs(&other))?);
                *found = other.found;
            }
        }
        Ok(found)
    }

    /// The work of a call at most, where one map or one table serves all states; where hard limits of states cannot be
    /// met, an interior point adds to it. The next call begins as before.
    ///
    /// # Errors
    /// As [`Solver::new`].
    pub fn most(&mut self) -> Result<Option<Most>> {
        self.limit();
        match &mut self.way {
            Way::Inputs(solver) => solver.most().map(Some),
            Way::Rows(table) => table.most(&self.horizon).map(Some),
            Way::Steps(_) | Way::Anew(_) => Ok(None),
        }
    }

    /// The limits at which the next call begins, before the shift.
    pub fn warm(&self) -> Option<&[i8]> {
        match &self.way {
            Way::Inputs(solver) => solver.warm(),
            Way::Rows(table) => table.signs(),
            Way::Steps(recursion) => recursion.warm.last(),
            Way::Anew(warm) => warm.as_deref(),
        }
    }

    /// Sets them.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn resume(&mut self, warm: Option<Vec<i8>>) -> Result<()> {
        checked_warm(warm.as_deref(), self.horizon.signs())?;
        match &mut self.way {
            Way::Inputs(solver) => return solver.resume(warm),
            Way::Rows(table) => table.resume(warm.as_deref()),
            Way::Steps(recursion) => return recursion.warm.resume(warm.as_deref()),
            Way::Anew(there) => *there = warm,
        }
        Ok(())
    }
}

/// The active limits, by kind.
fn signs(all: &RowsSolution) -> impl Iterator<Item = i8> {
    let sign = |v: &f64| if *v == 0.0 { 0 } else { v.signum() as i8 };
    all.found.active.iter().copied().chain(all.rows.iter().flatten().map(sign))
}

impl Horizon {
    /// Whether there is a plan that keeps all hard limits.
    fn soft(&self) -> bool {
        self.task.states.is_none() || self.task.soft.is_some()
    }

    /// Active limits one step later, the last step once more; for each kind of limits.
    fn later(&self, warm: &[i8]) -> Result<Vec<i8>> {
        let mut warm = try_copy(WHAT, warm)?;
        let mut rest = &mut warm[..];
        for (len, width) in self.kinds() {
            let (kind, others) = rest.split_at_mut(len);
            kind.copy_within(width.min(len).., 0);
            rest = others;
        }
        Ok(warm)
    }
}
