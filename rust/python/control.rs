//! Exact controls, and the controls of realizations.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, slice};
use super::error::{InputError, ShapeError};
use super::realizations::EntityArgument;
use super::run::{run, run_unstoppable};
use crate::control::{self, ExactControl, Factored, Realized};
use crate::memory::try_copy;

const WHAT: &str = "a control";
type Vector<'py> = Bound<'py, PyArray1<f64>>;
type Matrix<'py> = Bound<'py, PyArray2<f64>>;

fn vector<'py>(py: Python<'py>, values: &[f64]) -> PyResult<Vector<'py>> {
    array1(py, try_copy(WHAT, values)?)
}

/// `B = U diag(s) V^T` with the numerical rank as inner size.
#[pyclass(frozen, module = "stochens_rs._core", name = "Factors")]
pub(super) struct PyFactors(pub(super) Arc<Factored>);

getters! {
    PyFactors {
        s<'py>: PyResult<Vector<'py>> = |own, py| vector(py, own.0.s());
        singular_values<'py>: PyResult<Vector<'py>> = |own, py| vector(py, &own.0.parts.singular_values);
        rank: usize = |own| own.0.parts.rank;
        off: f64 = |own| own.0.off();
    }

    #[new]
    fn new(py: Python<'_>, b: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let (rows, cols) = b.as_array().dim();
        let values = try_copy("B", slice("B", &b)?)?;
        let cost = 10.0 * (rows * cols * rows.min(cols)) as f64;
        Ok(Self(Arc::new(run_unstoppable(py, cost, move || Factored::new(values, rows, cols))?)))
    }

    #[getter(B)]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Matrix<'py>> {
        array2(py, try_copy(WHAT, &self.0.matrix)?, self.0.rows, self.0.cols)
    }

    #[getter(U)]
    fn left<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array2(py, try_copy(WHAT, &self.0.parts.basis)?, self.0.parts.rank, self.0.rows)?.getattr("T")
    }

    #[getter(V)]
    fn right<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array2(py, try_copy(WHAT, &self.0.parts.right)?, self.0.parts.rank, self.0.cols)?.getattr("T")
    }

    #[getter]
    fn inverse<'py>(&self, py: Python<'py>) -> PyResult<Matrix<'py>> {
        array2(py, try_copy(WHAT, &self.0.parts.matrix)?, self.0.cols, self.0.rows)
    }
}

/// The verdict, `residual`, `relative`, `lower`, `upper`, `size`, rank and condition.
type Reach = (&'static str, f64, f64, f64, f64, f64, usize, f64);
/// Of the control its error, what that is relative to, the norm of that and the rounding; of the state; the residual.
type Beside = ((f64, &'static str, f64, f64), (f64, &'static str, f64, f64), f64);

/// The best control from x0 to xf over `steps` steps; with `free` the one that adds `xf` to it in one step.
#[pyclass(frozen, subclass, module = "stochens_rs._core", name = "Best")]
pub(super) struct PyBest(pub(super) ExactControl);

getters! {
    PyBest {
        factors: PyFactors = |own| PyFactors(Arc::clone(&own.0.factors));
        /// The control in the order of time, (m K,).
        u<'py>: PyResult<Vector<'py>> = |own, py| array1(py, own.0.reversed(&own.0.best.control)?);
        free<'py>: PyResult<Vector<'py>> = |own, py| vector(py, &own.0.best.free);
        needed<'py>: PyResult<Vector<'py>> = |own, py| vector(py, &own.0.best.needed);
        missed<'py>: PyResult<Vector<'py>> = |own, py| vector(py, &own.0.best.residual);
        reached<'py>: PyResult<Vector<'py>> = |own, py| vector(py, &own.0.reached);
        off: f64 = |own| own.0.off;
        gap: f64 = |own| own.0.gap;
        unsure: f64 = |own| own.0.unsure;
        upper: f64 = |own| own.0.best.upper;
        control_rounding: f64 = |own| own.0.best.control_rounding;
        state_rounding: f64 = |own| own.0.best.state_rounding;
    }

    #[new]
    #[pyo3(signature = (a, b, x0, xf, steps, free=None))]
    fn new(
        py: Python<'_>,
        a: PyReadonlyArray2<'_, f64>,
        b: PyReadonlyArray2<'_, f64>,
        x0: PyReadonlyArray1<'_, f64>,
        xf: PyReadonlyArray1<'_, f64>,
        steps: usize,
        free: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let (n, m) = b.as_array().dim();
        let lengths = [x0.len(), xf.len(), free.as_ref().map_or(n, |free| free.len())];
        if a.as_array().dim() != (n, n) || lengths != [n; 3] || steps == 0 || n == 0 || m == 0 {
            return Err(ShapeError::new_err(format!(
                "`A`, `B`, `x0` and `xf` must fit together, got n = {n}, m = {m}"
            )));
        }
        let (a, b, x0, xf) = (slice("A", &a)?, slice("B", &b)?, slice("x0", &x0)?, slice("xf", &xf)?);
        let free = free.as_ref().map(|free| slice("free", free)).transpose()?;
        let width = m.saturating_mul(steps);
        let cost = 200.0 * (n * (n + width)) as f64 + 10.0 * (n * width * n.min(width)) as f64;
        Ok(Self(run(py, cost, |stop| match free {
            Some(free) => ExactControl::added(b, free, xf, stop),
            None => ExactControl::new(a, b, x0, xf, steps, stop),
        })?))
    }

    fn amplified(&self, state: f64) -> f64 {
        self.0.amplified(state)
    }

    /// The part of a control, in the order of time, without effect on the state, in the order of `C_K`.
    fn aside<'py>(&self, py: Python<'py>, u: PyReadonlyArray1<'py, f64>) -> PyResult<Vector<'py>> {
        array1(py, self.0.aside(self.control(&u)?)?)
    }

    fn reach(&self) -> PyResult<Reach> {
        let (best, factors, reach) = (&self.0.best, &self.0.factors.parts, self.0.reach()?);
        let bounds = (best.lower, best.upper, best.size);
        let (rank, condition) = (factors.rank, factors.condition);
        Ok((reach.verdict, reach.residual, reach.relative, bounds.0, bounds.1, bounds.2, rank, condition))
    }

    /// What an error of the "control" or of the "state" is relative to, and the norm of that.
    fn compared(&self, quantity: &str, x0: PyReadonlyArray1<'_, f64>) -> PyResult<(&'static str, f64)> {
        Ok(self.0.compared(quantity == "control", self.state(&x0)?)?)
    }

    /// Another control, in the order of time.
    fn beside(&self, py: Python<'_>, u: PyReadonlyArray1<'_, f64>, x0: PyReadonlyArray1<'_, f64>) -> PyResult<Beside> {
        let (u, x0) = (self.control(&u)?, self.state(&x0)?);
        let cost = 20.0 * (self.0.a.len() + self.0.b.len()) as f64 * self.0.steps as f64;
        let found = run(py, cost, |_| self.0.beside(u, x0))?;
        Ok((found.control, found.state, found.residual))
    }

    /// Bounds of drawn errors with what rounding can add; `largest` bounds the norm of an error of the wish.
    fn with_rounding(&self, state: f64, control: f64, largest: f64) -> (f64, f64) {
        self.0.with_rounding([state, control], largest).into()
    }
}

impl PyBest {
    fn control<'a>(&self, u: &'a PyReadonlyArray1<'_, f64>) -> PyResult<&'a [f64]> {
        sized("u", u, self.0.factors.cols)
    }

    fn state<'a>(&self, x0: &'a PyReadonlyArray1<'_, f64>) -> PyResult<&'a [f64]> {
        sized("x0", x0, self.0.n)
    }
}

fn sized<'a>(name: &str, values: &'a PyReadonlyArray1<'_, f64>, expected: usize) -> PyResult<&'a [f64]> {
    let found = slice(name, values)?;
    if found.len() == expected {
        Ok(found)
    } else {
        Err(ShapeError::new_err(format!("`{name}` must have {expected} entries, got {}", found.len())))
    }
}

/// `B^+ (xf^s - A^s x0^s)` for every realization, given `B^+` (m, n), into `out` (size, m); `fresh`: it has never been
/// written.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "three entities and what belongs to them")]
pub(super) fn realization_controls<'py>(
    py: Python<'py>,
    out: &Bound<'py, PyArray2<f64>>,
    fresh: bool,
    pinv: PyReadonlyArray2<'py, f64>,
    x0: EntityArgument<'py>,
    xf: EntityArgument<'py>,
    a: EntityArgument<'py>,
    rows: bool,
    threads: usize,
) -> PyResult<()> {
    let (m, n) = pinv.as_array().dim();
    let values = slice("pinv", &pinv)?;
    let realized = Realized::new(x0.entity("x0", false)?, xf.entity("xf", false)?, a.entity("A", rows)?, n)?;
    let cost = realized.size() as f64 * ((m * n) as f64 + realized.cost());
    let taken = |_| InputError::new_err("`out` is in use by another call: every thread needs its own array");
    let mut out = out.try_readwrite().map_err(taken)?;
    let out = out.as_slice_mut().map_err(|_| ShapeError::new_err("`out` must be C-contiguous"))?;
    let memory = if fresh { control::Memory::Fresh } else { control::Memory::Used };
    run(py, cost, |stop| realized.controls_into(values, m, out, memory, threads, stop))
}

/// The mean of `xf^s - A^s x0^s` over the paired realizations (n,).
#[pyfunction]
pub(super) fn mean_difference<'py>(
    py: Python<'py>,
    n: usize,
    x0: EntityArgument<'py>,
    xf: EntityArgument<'py>,
    a: EntityArgument<'py>,
    rows: bool,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let realized = Realized::new(x0.entity("x0", false)?, xf.entity("xf", false)?, a.entity("A", rows)?, n)?;
    let cost = realized.size() as f64 * realized.cost();
    let mean = run(py, cost, |stop| realized.mean(stop))?;
    array1(py, mean)
}
