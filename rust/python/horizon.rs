//! The best inputs of a horizon, and how far others are from them.

use numpy::{PyArray1, PyArray2, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods, ndarray};
use pyo3::prelude::*;

use super::convert::{array1, array2, key, slice};
use super::draws::scheme;
use super::limited::{BoxControl, RowsControl};
use super::limits::{seconds, signs, to_best};
use super::run::run;
use super::shared::Shared;
use super::simulate::EstimateArgument;
use crate::Result;
use crate::limits::horizon::{Around, Cause, Given, Horizon, Loop, Part, Radii, Runs, Solved, Task};
use crate::limits::{RowsSolution, Solution, Until};
use crate::memory::{try_collect, try_copy};
use crate::simulate::Plans;

const WHAT: &str = "the control within limits";

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;

/// Entries row by row, whatever their order in memory.
fn values<D: ndarray::Dimension>(array: &PyReadonlyArray<'_, f64, D>) -> Result<Vec<f64>> {
    match array.as_slice() {
        Ok(values) if array.is_c_contiguous() => try_copy(WHAT, values),
        _ => try_collect(WHAT, array.as_array().iter().copied()),
    }
}

/// The fields of the package's `Task` that the core needs.
#[derive(FromPyObject)]
pub(super) struct TaskArgument<'py> {
    low: Matrix<'py>,
    high: Matrix<'py>,
    stage: Matrix<'py>,
    terminal: Matrix<'py>,
    reference: Matrix<'py>,
    #[pyo3(attribute("R"))]
    r: Option<Matrix<'py>>,
    rate: Option<Vector<'py>>,
    previous: Option<Vector<'py>>,
    state_low: Option<Matrix<'py>>,
    state_high: Option<Matrix<'py>>,
    soft: Option<f64>,
}

impl TaskArgument<'_> {
    /// With another reference and R where they are given.
    fn task(&self, reference: Option<&Matrix<'_>>, r: Option<&Matrix<'_>>) -> Result<Task> {
        let rate = match (&self.rate, &self.previous) {
            (Some(rate), Some(previous)) => Some((values(rate)?, values(previous)?)),
            _ => None,
        };
        let states = match (&self.state_low, &self.state_high) {
            (Some(low), Some(high)) => Some((values(low)?, values(high)?)),
            _ => None,
        };
        Ok(Task {
            low: values(&self.low)?,
            high: values(&self.high)?,
            stage: values(&self.stage)?,
            terminal: values(&self.terminal)?,
            reference: values(reference.unwrap_or(&self.reference))?,
            r: r.or(self.r.as_ref()).map(values).transpose()?,
            rate,
            states,
            soft: self.soft,
        })
    }
}

/// A system and a task.
#[pyclass(frozen, name = "Horizon", module = "stochens_rs._core")]
pub(super) struct PyHorizon {
    inner: Horizon,
    /// Elementary operations of a condensed problem.
    cost: f64,
}

fn cost(h: &Horizon) -> f64 {
    let (n, m, steps) = h.size();
    let d = (steps * m) as f64;
    let condensed = if h.long() { 0.0 } else { d * d * (h.rows() as f64 + 10.0 * d) };
    condensed + 300.0 * steps as f64 * ((2 * n + m) as f64).powi(3)
}

fn made(py: Python<'_>, a: &Matrix<'_>, b: &Matrix<'_>, c: Option<&Vector<'_>>, task: Task) -> PyResult<Horizon> {
    let (n, m) = b.as_array().dim();
    let steps = task.reference.len() / n.max(1);
    let (a, b) = (values(a)?, values(b)?);
    let c = c.map(values).transpose()?;
    let work = 4.0 * (steps * n * n * (n + m)) as f64;
    run(py, work, |_| Horizon::new(a, b, c.as_deref(), n, task))
}

#[pymethods]
impl PyHorizon {
    #[new]
    #[pyo3(signature = (a, b, c, task, reference=None, r=None))]
    fn new(
        py: Python<'_>,
        a: Matrix<'_>,
        b: Matrix<'_>,
        c: Option<Vector<'_>>,
        task: TaskArgument<'_>,
        reference: Option<Matrix<'_>>,
        r: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let inner = made(py, &a, &b, c.as_ref(), task.task(reference.as_ref(), r.as_ref())?)?;
        let cost = cost(&inner);
        Ok(Self { inner, cost })
    }

    /// R (m, m), given or chosen.
    #[getter]
    fn r<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        let m = self.inner.size().1;
        array2(py, try_copy(WHAT, self.inner.r())?, m, m)
    }

    #[getter]
    fn long(&self) -> bool {
        self.inner.long()
    }

    /// Rows of the map.
    #[getter]
    fn rows(&self) -> usize {
        self.inner.rows()
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

    /// The best control alone.
    fn best(&self, py: Python<'_>, x0: Vector<'_>, time_limit: Option<f64>) -> PyResult<Py<RowsControl>> {
        let (x0, limit) = (slice("x0", &x0)?, seconds(time_limit));
        let status = |found: &RowsSolution| found.found.status;
        let found = to_best(py, self.cost, status, |stop| self.inner.best(x0, false, None, Until::new(stop, limit)))?;
        RowsControl::of(py, found)
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

    /// How far `u` is from the best control of a system around this one.
    fn apart(
        &self,
        py: Python<'_>,
        around: AroundArgument<'_>,
        states: Matrix<'_>,
        u: Matrix<'_>,
        alpha: f64,
        gap: f64,
    ) -> PyResult<Apart> {
        let (states, u) = (slice("states", &states)?, slice("u", &u)?);
        let around = around.get()?;
        run(py, self.cost, |_| self.inner.apart(&around, states, u, alpha, gap)).map(Apart)
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

fn given<'a>(name: &str, (lines, drawn): &'a EstimateArgument<'_>) -> PyResult<Given<'a>> {
    let drawn = match drawn {
        None => None,
        Some((size, name)) => Some((*size, scheme(name)?)),
    };
    Ok(Given { lines: slice(name, lines)?, length: lines.as_array().dim().1, drawn })
}

/// What the package keeps of a control within limits.
#[derive(FromPyObject)]
pub(super) struct GivenControl<'py> {
    u: Matrix<'py>,
    gap: f64,
    distance: f64,
    objective: f64,
}

impl GivenControl<'_> {
    fn solution(&self) -> PyResult<Solution> {
        let control = try_copy(WHAT, slice("u", &self.u)?)?;
        Ok(Solution::of(control, self.gap, self.distance, self.objective))
    }
}

/// A distance of the target, simulated radii, or a distance from the best control.
#[derive(FromPyObject)]
enum CauseArgument {
    Distance(f64),
    Radii(f64, f64, f64),
    Apart(Py<Apart>),
}

/// Where the true A and B are.
#[derive(FromPyObject)]
struct AroundArgument<'py> {
    radii: [f64; 2],
    shifts: Option<(Matrix<'py>, Matrix<'py>)>,
    parts: Vec<(f64, Matrix<'py>, f64, f64)>,
}

impl AroundArgument<'_> {
    fn get(&self) -> PyResult<Around<'_>> {
        let mut parts = Vec::new();
        for (factor, s, of_a, of_b) in &self.parts {
            let part = Part { factor: *factor, s: slice("S", s)?, lengths: [*of_a, *of_b] };
            crate::memory::try_push(WHAT, &mut parts, part)?;
        }
        let shifts = match &self.shifts {
            Some((a, b)) => Some([slice("shifts", a)?, slice("shifts", b)?]),
            None => None,
        };
        Ok(Around { radii: self.radii, shifts, parts })
    }
}

/// Bounds of the distance from the best control.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct Apart(crate::limits::horizon::Apart);

#[pymethods]
impl Apart {
    #[getter]
    fn state(&self) -> f64 {
        self.0.state
    }

    #[getter]
    fn weighted(&self) -> f64 {
        self.0.weighted
    }

    #[getter]
    fn distance(&self) -> f64 {
        self.0.distance
    }

    #[getter]
    fn control(&self) -> f64 {
        self.0.control
    }

    #[getter]
    fn excess(&self) -> f64 {
        self.0.excess
    }
}

/// The best control of a horizon.
#[pyclass(frozen, module = "stochens_rs._core")]
pub(super) struct HorizonControl {
    solved: Solved,
    n: usize,
    m: usize,
    steps: usize,
}

#[pymethods]
impl HorizonControl {
    #[getter]
    fn u<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        array2(py, try_copy(WHAT, &self.solved.found.control)?, self.steps, self.m)
    }

    #[getter]
    fn active<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i8>>> {
        super::arrays::array(py, try_copy(WHAT, &self.solved.found.active)?, [self.steps, self.m])
    }

    #[getter]
    fn multipliers<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py>> {
        array2(py, try_copy(WHAT, &self.solved.found.multipliers)?, self.steps, self.m)
    }

    #[getter]
    fn state_active<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<i8>>>> {
        let Some(sides) = &self.solved.state_active else { return Ok(None) };
        super::arrays::array(py, try_copy(WHAT, sides)?, [self.steps, self.n]).map(Some)
    }

    #[getter]
    fn gap(&self) -> f64 {
        self.solved.found.gap
    }

    #[getter]
    fn distance(&self) -> f64 {
        self.solved.found.distance
    }

    #[getter]
    fn objective(&self) -> f64 {
        self.solved.found.objective
    }

    #[getter]
    fn missed(&self) -> f64 {
        self.solved.missed
    }

    #[getter]
    fn status(&self) -> &'static str {
        self.solved.found.status.as_str()
    }

    #[getter]
    fn missing(&self) -> f64 {
        self.solved.missing
    }
}

/// The best inputs from one state after another.
#[pyclass(frozen, name = "Loop", module = "stochens_rs._core")]
pub(super) struct PyLoop {
    inner: Shared<Loop>,
    cost: f64,
}

#[pymethods]
impl PyLoop {
    #[new]
    fn new(
        py: Python<'_>,
        a: Matrix<'_>,
        b: Matrix<'_>,
        c: Option<Vector<'_>>,
        task: TaskArgument<'_>,
    ) -> PyResult<Self> {
        let horizon = made(py, &a, &b, c.as_ref(), task.task(None, None)?)?;
        let cost = cost(&horizon);
        let made = run(py, cost, |stop| Loop::new(horizon, stop))?;
        // one map for all states leaves a factorization
        let cost = if made.condensed() { (task.low.as_array().len() as f64).powi(3) } else { cost };
        Ok(Self { inner: Shared::new("loop", made), cost })
    }

    /// Whether one map serves all states.
    #[getter]
    fn condensed(&self, py: Python<'_>) -> PyResult<bool> {
        self.inner.with(py, 0.0, |inner, _| Ok(inner.condensed()))
    }

    fn solve(&self, py: Python<'_>, x: Vector<'_>, time_limit: Option<f64>) -> PyResult<BoxControl> {
        let (x, limit) = (slice("x", &x)?, seconds(time_limit));
        Ok(BoxControl(self.inner.with(py, self.cost, |inner, stop| inner.solve(x, Until::new(stop, limit)))?))
    }

    /// The input that is applied now.
    fn follow(&self, py: Python<'_>, previous: Vector<'_>) -> PyResult<()> {
        let previous = slice("previous", &previous)?;
        self.inner.with(py, 0.0, |inner, _| {
            inner.follow(previous);
            Ok(())
        })
    }

    fn warm<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray1<i8>>>> {
        let copy = |inner: &mut Loop, _: &crate::Stop| inner.warm().map(|warm| try_copy("a start", warm)).transpose();
        self.inner.with(py, 0.0, copy)?.map(|warm| array1(py, warm)).transpose()
    }

    fn resume(&self, py: Python<'_>, warm: Option<PyReadonlyArray1<'_, i8>>) -> PyResult<()> {
        let copy = signs(&warm)?.map(|warm| try_copy("a start", warm)).transpose()?;
        self.inner.with(py, 0.0, |inner, _| inner.resume(copy))
    }
}
