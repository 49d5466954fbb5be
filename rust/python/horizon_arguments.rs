//! The arguments of the calls of a horizon.

use numpy::{PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods, ndarray};
use pyo3::prelude::*;

use super::convert::slice;
use super::draws::scheme;
use super::horizon_results::Apart;
use super::run::run;
use super::simulate::EstimateArgument;
use crate::Result;
use crate::limits::Solution;
use crate::limits::horizon::{DrawnEntity, Horizon, Task};
use crate::matrix::MatrixView;
use crate::memory::{try_collect, try_copy};

const WHAT: &str = "the control within limits";

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

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
    pub(super) low: Matrix<'py>,
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
    pub(super) fn task(&self, reference: Option<&Matrix<'_>>, r: Option<&Matrix<'_>>) -> Result<Task> {
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

pub(super) fn cost(h: &Horizon) -> f64 {
    let (n, m, steps) = h.size();
    let d = (steps * m) as f64;
    let condensed = if h.long() { 0.0 } else { d * d * (h.rows() as f64 + 10.0 * d) };
    condensed + 300.0 * steps as f64 * ((2 * n + m) as f64).powi(3)
}

pub(super) fn made(
    py: Python<'_>,
    a: &Matrix<'_>,
    b: &Matrix<'_>,
    c: Option<&Vector<'_>>,
    task: Task,
) -> PyResult<Horizon> {
    let (n, m) = b.as_array().dim();
    let steps = task.reference.len() / n.max(1);
    let (a, b) = (values(a)?, values(b)?);
    let c = c.map(values).transpose()?;
    let work = 4.0 * (steps * n * n * (n + m)) as f64;
    run(py, work, |_| Horizon::new(MatrixView::of(&a, n), MatrixView::of(&b, m), c.as_deref(), task))
}

pub(super) fn given<'a>(name: &str, (lines, drawn): &'a EstimateArgument<'_>) -> PyResult<DrawnEntity<'a>> {
    let drawn = match drawn {
        None => None,
        Some((size, name)) => Some((*size, scheme(name)?)),
    };
    Ok(DrawnEntity { lines: slice(name, lines)?, length: lines.as_array().dim().1, drawn })
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
    pub(super) fn solution(&self) -> PyResult<Solution> {
        let control = try_copy(WHAT, slice("u", &self.u)?)?;
        Ok(Solution::of(control, self.gap, self.distance, self.objective))
    }
}

/// A distance of the target, simulated radii, or a distance from the best control.
#[derive(FromPyObject)]
pub(super) enum CauseArgument {
    Distance(f64),
    Radii(f64, f64, f64),
    Apart(Py<Apart>),
}
