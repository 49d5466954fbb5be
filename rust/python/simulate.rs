//! Exact and random trajectories, and the closed loop. Matrices come as lines: `a` and `b` are transposed.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::control::PyBest;
use super::convert::{array1, array2, key, law, method, slice, view};
use super::draws::scheme;
use super::error::InputError;
use super::run::run;
use crate::fuse::Fusion;
use crate::memory::try_copy;
use crate::simulate::{self, Average, ClosedLoop, Drawn, Ensemble, Exact, Model, PlanEntity, Plans, Second, Systems};
use crate::tails::Norm;

type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;
/// `(mean, variance, covariance, runs)`: `(K + 1, n)`, then flat or absent.
type Moments<'py> = (Array2<'py>, Option<Array2<'py>>, Option<Array1<'py>>, Array1<'py>);

fn model(
    a: &PyReadonlyArray2<'_, f64>,
    b: &PyReadonlyArray2<'_, f64>,
    x0: &PyReadonlyArray2<'_, f64>,
    u: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Model> {
    Ok(Model::new(law(a)?, law(b)?, law(x0)?, try_copy("the inputs", slice("u", u)?)?)?)
}

fn second(full: bool) -> Second {
    if full { Second::Full } else { Second::Diagonal }
}

/// Elementary operations of one step with whole matrices.
fn products(a: &PyReadonlyArray2<'_, f64>, b: &PyReadonlyArray2<'_, f64>) -> f64 {
    (a.as_array().len() + b.as_array().len()) as f64
}

fn moments(py: Python<'_>, ensemble: Ensemble, n: usize) -> PyResult<Moments<'_>> {
    let times = ensemble.mean.len() / n;
    let variance = ensemble.variance.map(|v| array2(py, v, times, n)).transpose()?;
    let covariance = ensemble.covariance.map(|c| array1(py, c)).transpose()?;
    Ok((array2(py, ensemble.mean, times, n)?, variance, covariance, array1(py, ensemble.runs)?))
}

/// `A_d` and `B_d` for inputs that are constant over each step.
#[pyfunction]
pub(super) fn zero_order_hold<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    dt: f64,
) -> PyResult<(Array2<'py>, Array2<'py>)> {
    let ((n, m), lines) = (b.as_array().dim(), (view("A", &a)?, view("B", &b)?));
    let cost = 60.0 * ((n + m) as f64).powi(3);
    let (own, inputs) = run(py, cost, |_| simulate::zero_order_hold(lines.0, lines.1, dt))?;
    Ok((array2(py, own, n, n)?, array2(py, inputs, n, m)?))
}

/// The exact states `x(0), ..., x(K)` (K + 1, n).
#[pyfunction]
pub(super) fn trajectory<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    x0: PyReadonlyArray2<'py, f64>,
    u: PyReadonlyArray2<'py, f64>,
) -> PyResult<Array2<'py>> {
    let model = model(&a, &b, &x0, &u)?;
    let cost = model.steps() as f64 * products(&a, &b);
    let states = run(py, cost, |stop| model.trajectory(stop))?;
    array2(py, states, model.steps() + 1, model.n())
}

/// Moments of `size` independent runs, or of `replicates` trajectories of averages of `size` realizations; `drawn` says
/// whether `A`, `B` and `x0` are drawn.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn simulate_runs<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    x0: PyReadonlyArray2<'py, f64>,
    u: PyReadonlyArray2<'py, f64>,
    drawn: (bool, bool, bool),
    size: usize,
    replicates: Option<usize>,
    full: bool,
    keep: bool,
    key: &[u8],
    threads: usize,
) -> PyResult<Moments<'py>> {
    let (model, key) = (model(&a, &b, &x0, &u)?, self::key(key)?);
    let drawn = Drawn { a: drawn.0, b: drawn.1, x0: drawn.2 };
    let steps = (model.steps() + 1) as f64;
    let ensemble = if let Some(replicates) = replicates {
        let cost = 200.0 * steps * replicates as f64 * products(&a, &b);
        run(py, cost, |stop| {
            simulate::mean_field(&model, drawn, size as u64, replicates, second(full), keep, &key, threads, stop)
        })?
    } else {
        let (n, m) = (model.n() as f64, b.as_array().dim().0 as f64);
        let step = 2.0 * (n + m) + if drawn.a { 0.0 } else { n * n } + if full { n * n } else { 0.0 };
        // the steps, the exact trajectory, and one alias table per line
        let cost = steps * (size as f64 * step + products(&a, &b)) + 30.0 * products(&a, &b);
        run(py, cost, |stop| simulate::runs(&model, drawn, size, second(full), keep, &key, threads, stop))?
    };
    moments(py, ensemble, model.n())
}

/// Moments of the runs of given systems from `x0` (1, n) or (N, n): transposed, `a` (N, n n) and `b` (N, m n); `c` (N,
/// n).
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn simulate_systems<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    c: Option<PyReadonlyArray2<'py, f64>>,
    x0: PyReadonlyArray2<'py, f64>,
    u: PyReadonlyArray2<'py, f64>,
    full: bool,
    keep: bool,
    threads: usize,
) -> PyResult<Moments<'py>> {
    let (n, (steps, m)) = (x0.as_array().dim().1, u.as_array().dim());
    let systems = Systems {
        n,
        m,
        a: slice("A", &a)?,
        b: slice("B", &b)?,
        c: c.as_ref().map(|c| slice("c", c)).transpose()?,
        x0: slice("x0", &x0)?,
        u: slice("u", &u)?,
    };
    let width = if full { n } else { 1 };
    let cost = 2.0 * (steps + 1) as f64 * (products(&a, &b) + (a.as_array().dim().0 * n * width) as f64);
    let ensemble = run(py, cost, |stop| systems.run(second(full), keep, threads, stop))?;
    moments(py, ensemble, n)
}

/// `(states (runs (K + 1), n), inputs (runs K, m), optimal)` of `runs` runs after a reference; `factors` are
/// `(U^T, V^T, s)` of `B`. Zeros follow the first state of a run whose squared error is not finite.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn track<'py>(
    py: Python<'py>,
    a: PyReadonlyArray2<'py, f64>,
    b: PyReadonlyArray2<'py, f64>,
    x0: PyReadonlyArray1<'py, f64>,
    reference: PyReadonlyArray2<'py, f64>,
    factors: (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray1<'py, f64>),
    size: u64,
    method: &str,
    feedback: bool,
    sample_states: bool,
    runs: usize,
    key: &[u8],
    threads: usize,
) -> PyResult<(Array2<'py>, Array2<'py>, bool)> {
    let (key, method) = (self::key(key)?, self::method(method)?);
    let given = ClosedLoop {
        a: law(&a)?.into(),
        b: law(&b)?,
        x0: slice("x0", &x0)?,
        reference: slice("reference", &reference)?,
        basis: slice("factors", &factors.0)?,
        right: slice("factors", &factors.1)?,
        singular_values: slice("factors", &factors.2)?,
        size,
        method,
        feedback,
        sample_states,
    };
    let (n, m, times) = (a.as_array().dim().0, b.as_array().dim().0, reference.as_array().dim().0);
    let draws = if method == Fusion::Uniform { 100.0 } else { f64::INFINITY };
    let cost = draws * (runs * times) as f64 * products(&a, &b);
    let found = run(py, cost, |stop| given.run(runs, &key, threads, stop))?;
    let states = array2(py, found.states, runs * times, n)?;
    Ok((states, array2(py, found.inputs, runs * (times - 1), m)?, found.optimal))
}

/// An exact entity as its lines, or `(size, scheme)` if every run draws an average of realizations.
pub(super) type EstimateArgument<'py> = (PyReadonlyArray2<'py, f64>, Option<(u64, String)>);

fn estimate(name: &str, (lines, drawn): &EstimateArgument<'_>) -> PyResult<PlanEntity> {
    Ok(match drawn {
        None => PlanEntity::Fixed(try_copy("an estimate", slice(name, lines)?)?),
        Some((size, scheme)) => PlanEntity::Drawn(Average::new(law(lines)?, *size, self::scheme(scheme)?)?),
    })
}

/// `(state, control)` errors (runs, 2) of simulated plans beside the best one. A fixed `A` and lines of columns are
/// transposed; `rows` says that the lines are rows.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn simulate_plans<'py>(
    py: Python<'py>,
    x0: EstimateArgument<'py>,
    xf: EstimateArgument<'py>,
    a: EstimateArgument<'py>,
    rows: bool,
    paired: bool,
    best: &Bound<'py, PyBest>,
    runs: usize,
    cost: f64,
    key: &[u8],
    threads: usize,
) -> PyResult<Array2<'py>> {
    let plans = Plans::new(estimate("x0", &x0)?, estimate("xf", &xf)?, estimate("A", &a)?, rows, paired)?;
    let best = &best.get().0;
    let exact = if best.steps > 1 {
        Exact::Steps { b: &best.b, c: &best.factors.matrix, v: &best.best.control }
    } else {
        let basis = &best.factors.parts.basis;
        Exact::OneStep { basis, singular_values: best.factors.s(), y: &best.best.needed }
    };
    let key = self::key(key)?;
    let errors = run(py, cost * runs as f64, |stop| plans.errors(exact, runs, &key, threads, stop))?;
    array2(py, errors, runs, 2)
}

/// Errors (runs,) of simulated averages of `size` realizations; `norm` is "1", "2" or "spectral".
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn simulate_estimates<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f64>,
    size: u64,
    scheme: &str,
    norm: &str,
    runs: usize,
    cost: f64,
    key: &[u8],
    threads: usize,
) -> PyResult<Array1<'py>> {
    let average = Average::new(law(&values)?, size, self::scheme(scheme)?)?;
    let norm = match norm {
        "1" => Norm::One,
        "2" => Norm::Frobenius,
        "spectral" => Norm::Spectral,
        other => return Err(InputError::new_err(format!("`norm` must be '1', '2' or 'spectral', got '{other}'"))),
    };
    let key = self::key(key)?;
    let errors =
        run(py, cost * runs as f64, |stop| simulate::estimate_errors(&average, norm, runs, &key, threads, stop))?;
    array1(py, errors)
}

/// How many of so many errors may exceed a bound for `delta`.
#[pyfunction]
pub(super) fn exceedances(runs: usize, delta: f64) -> Option<usize> {
    simulate::exceedances(runs, delta)
}

/// Bounds of the next errors, from drawn ones (runs, errors).
#[pyfunction]
pub(super) fn drawn_bounds(py: Python<'_>, errors: PyReadonlyArray2<'_, f64>, delta: f64) -> PyResult<Vec<f64>> {
    let (columns, errors) = (errors.as_array().dim().1, slice("errors", &errors)?);
    run(py, 10.0 * errors.len() as f64, |_| simulate::drawn_bounds(errors, columns, delta))
}
