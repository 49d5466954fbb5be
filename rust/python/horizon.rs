//! The best inputs of a horizon, and how far others are from them.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, key, slice};
use super::horizon_arguments::{CauseArgument, Entries, GivenControl, TaskArgument, cost, given, made};
use super::horizon_results::{Apart, HorizonControl};
use super::limits::{seconds, to_best};
use super::region::PyRegion;
use super::run::run;
use super::simulate::EstimateArgument;
use crate::limits::Until;
use crate::limits::horizon::{Cause, Condensed, Horizon, Radii, Runs, Solved};
use crate::memory::try_copy;
use crate::simulate::Plans;

const WHAT: &str = "the control within limits";

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;

/// A system and a task.
#[pyclass(frozen, name = "Horizon", module = "stochens_rs._core")]
pub(super) struct PyHorizon {
    inner: Horizon,
    /// Elementary operations of a condensed problem.
    cost: f64,
}

getters! {
    PyHorizon {
        long: bool = |own| own.inner.long();
        /// Rows of the map.
        rows: usize = |own| own.inner.rows();
    }

    #[new]
    #[pyo3(signature = (a, b, c, task, reference=None, r=None))]
    fn new(
        py: Python<'_>,
        a: Entries,
        b: Entries,
        c: Option<Entries>,
        task: TaskArgument,
        reference: Option<Entries>,
        r: Option<Entries>,
    ) -> PyResult<Self> {
        let inner = made(py, &a, &b, c.as_ref(), task.task(reference.as_ref(), r.as_ref()))?;
        let cost = cost(&inner);
        Ok(Self { inner, cost })
    }

    /// R (m, m), given or chosen.
    #[getter]
    fn r<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        let m = self.inner.size().1;
        array2(py, try_copy(WHAT, self.inner.r())?, m, m)
    }

    /// The lower triangle of `H^-1` row by row, F (m K, n) and g (m K): the best inputs without limits are `F x0 + g`.
    /// Limited states follow behind the inputs.
    fn condensed<'py>(&self, py: Python<'py>) -> PyResult<(Array1<'py>, Array2<'py>, Array1<'py>)> {
        let n = self.inner.size().0;
        let Condensed { inverse, map, offset } = run(py, self.cost, |_| self.inner.condensed())?;
        Ok((array1(py, inverse)?, array2(py, map, offset.len(), n)?, array1(py, offset)?))
    }

    /// `M` (rows, m K), `state` (rows, n) and `target` (rows,).
    fn weighted<'py>(&self, py: Python<'py>) -> PyResult<(Array2<'py>, Array2<'py>, Array1<'py>)> {
        let (n, m, steps) = self.inner.size();
        let (map, state, target) = run(py, self.cost, |_| {
            Ok((try_copy(WHAT, self.inner.map()?)?, self.inner.state()?, self.inner.target()?))
        })?;
        let rows = self.inner.rows();
        Ok((array2(py, map, rows, m * steps)?, array2(py, state, rows, n)?, array1(py, target)?))
    }

    /// `A^p B` (K, n m) for p = 0 .. K-1.
    fn pushes<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        let (n, m, steps) = self.inner.size();
        array2(py, try_copy(WHAT, self.inner.pushes())?, steps, n * m)
    }

    /// Roots of the weights of the stages and of the last step, (rank, n).
    fn roots<'py>(&self, py: Python<'py>) -> PyResult<(Array2<'py>, Array2<'py>)> {
        let n = self.inner.size().0;
        let made = |root: &[f64]| array2(py, try_copy(WHAT, root)?, root.len() / n, n);
        let [stage, terminal] = self.inner.roots();
        Ok((made(stage)?, made(terminal)?))
    }

    /// `||M||_F`, and of what `x0` and `xf` are multiplied by.
    fn norms(&self) -> PyResult<[f64; 3]> {
        Ok(self.inner.norms()?)
    }

    /// `||Q_1|| .. ||Q_K||`; with `soft` of what bounds the curvature with soft limits.
    fn weights<'py>(&self, py: Python<'py>, soft: bool) -> PyResult<Array1<'py>> {
        array1(py, self.inner.weights(soft)?)
    }

    fn objective(&self, x0: Vector<'_>, u: Matrix<'_>) -> PyResult<f64> {
        Ok(self.inner.objective(slice("x0", &x0)?, slice("u", &u)?)?)
    }

    /// The largest distance from inputs within the limits of single inputs.
    fn farthest(&self, u: Matrix<'_>) -> PyResult<f64> {
        Ok(self.inner.farthest(slice("u", &u)?))
    }

    fn in_two_norm(&self, py: Python<'_>, distance: f64) -> PyResult<(f64, f64)> {
        run(py, self.cost, |_| self.inner.in_two_norm(distance))
    }

    fn solve(&self, py: Python<'_>, x0: Vector<'_>, time_limit: Option<f64>) -> PyResult<HorizonControl> {
        let (x0, limit) = (slice("x0", &x0)?, seconds(time_limit));
        let status = |solved: &Solved| solved.found.status;
        let solved = to_best(py, self.cost, status, |stop| self.inner.solve(x0, Until::new(stop, limit)))?;
        let (n, m, steps) = self.inner.size();
        Ok(HorizonControl { solved, n, m, steps })
    }

    /// A Frank-Wolfe gap of `u` with these states, and the norm of what no limit balances of half of the gradient.
    fn optimality(&self, states: Matrix<'_>, u: Matrix<'_>, gap: f64) -> PyResult<(f64, f64)> {
        Ok(self.inner.optimality(slice("states", &states)?, slice("u", &u)?, gap)?)
    }

    /// The least eigenvalue of `G'QG + R`.
    fn least(&self, py: Python<'_>) -> PyResult<f64> {
        run(py, self.cost, |_| self.inner.least())
    }

    /// Bounds of the errors of `u`: what nothing random gives; or the distance of the target and `r^ - x^`; or radii.
    #[pyo3(signature = (x0, given, cause=None, off=None))]
    fn error(
        &self,
        py: Python<'_>,
        x0: Vector<'_>,
        given: GivenControl<'_>,
        cause: Option<CauseArgument>,
        off: Option<Matrix<'_>>,
    ) -> PyResult<(f64, f64, f64, f64)> {
        let (x0, given) = (slice("x0", &x0)?, given.solution()?);
        let off = off.as_ref().map(|off| slice("off", off)).transpose()?;
        let cause = match (cause, off) {
            (None, _) => Cause::Known,
            (Some(CauseArgument::Distance(distance)), off) => Cause::Target(distance, off.unwrap_or(&[])),
            (Some(CauseArgument::Radii(state, control, excess)), _) => Cause::Drawn([state, control, excess]),
            (Some(CauseArgument::Apart(apart)), _) => Cause::Map(apart.get().0),
        };
        let found = run(py, self.cost, |stop| self.inner.error(x0, &given, &cause, Until::new(stop, None)))?;
        let Radii { state, control, excess, missed } = found;
        Ok((state, control, excess, missed))
    }

    /// How far states in a tube around these (K, n) are from them in the norm of Q; `sure` is the state before one
    /// step.
    fn alpha(
        &self,
        py: Python<'_>,
        region: &PyRegion,
        tube: Vector<'_>,
        states: Matrix<'_>,
        u: Matrix<'_>,
        sure: Option<Vector<'_>>,
    ) -> PyResult<f64> {
        let (tube, states, u) = (slice("tube", &tube)?, slice("states", &states)?, slice("u", &u)?);
        let sure = sure.as_ref().map(|sure| slice("x0", sure)).transpose()?;
        run(py, self.cost, |_| self.inner.alpha(&region.0, tube, states, u, sure))
    }

    /// How far `u` is from the best control of a system of the region.
    fn apart(
        &self,
        py: Python<'_>,
        region: &PyRegion,
        states: Matrix<'_>,
        u: Matrix<'_>,
        alpha: f64,
        gap: f64,
    ) -> PyResult<Apart> {
        let (states, u) = (slice("states", &states)?, slice("u", &u)?);
        run(py, self.cost, |_| self.inner.apart(&region.0, states, u, alpha, gap)).map(Apart)
    }

    /// `||Q^(1/2) (G - G^)||` for these bounds of `||A - A^||` and `||B - B^||`.
    fn map_radius(&self, py: Python<'_>, radii: [f64; 2]) -> PyResult<f64> {
        run(py, self.cost, |_| self.inner.map_radius(radii, &self.inner.weights(true)?))
    }

    /// How far states (K + 1, n) computed with another A are from those of this one.
    fn along(&self, py: Python<'_>, states: Matrix<'_>, errors: [f64; 3]) -> PyResult<f64> {
        let states = slice("states", &states)?;
        run(py, self.cost, |_| self.inner.along(states, errors))
    }

    /// How far the target moves.
    fn moved_target(&self, py: Python<'_>, errors: [f64; 3], a: Matrix<'_>, x0: Vector<'_>) -> PyResult<f64> {
        let estimate = [slice("A", &a)?, slice("x0", &x0)?];
        run(py, self.cost, |_| self.inner.moved_target(errors, estimate))
    }

    /// How far the target moves in each run.
    #[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
    fn moved_targets<'py>(
        &self,
        py: Python<'py>,
        entities: [EstimateArgument<'py>; 3],
        rows: bool,
        paired: bool,
        x0: Vector<'py>,
        xf: Vector<'py>,
        runs: usize,
        cost: f64,
        key: &[u8],
        threads: usize,
    ) -> PyResult<Array1<'py>> {
        let [first, second, third] = &entities;
        let given = [given("x0", first)?, given("xf", second)?, given("A", third)?];
        let (values, key) = ([slice("x0", &x0)?, slice("xf", &xf)?], self::key(key)?);
        let of_runs = Runs { count: runs, key: &key, threads };
        let found =
            run(py, cost * runs as f64, |stop| self.inner.moved_targets(given, (rows, paired), values, of_runs, stop))?;
        array1(py, found)
    }

    /// Errors (runs, 3) of the controls of drawn estimates.
    #[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
    fn drawn_errors<'py>(
        &self,
        py: Python<'py>,
        entities: [EstimateArgument<'py>; 3],
        rows: bool,
        x0: Vector<'py>,
        follows: bool,
        auto: bool,
        runs: usize,
        cost: f64,
        key: &[u8],
        threads: usize,
    ) -> PyResult<Array2<'py>> {
        let [first, second, third] = &entities;
        let [start, goal, a] = [given("x0", first)?, given("xf", second)?, given("A", third)?];
        let plans = Plans::new(start.estimate()?, goal.estimate()?, a.estimate()?, rows, false)?;
        let (x0, key) = (slice("x0", &x0)?, self::key(key)?);
        let of_runs = Runs { count: runs, key: &key, threads };
        let found =
            run(py, cost * runs as f64, |stop| self.inner.drawn_errors(&plans, x0, (follows, auto), of_runs, stop))?;
        array2(py, found, runs, 3)
    }
}
