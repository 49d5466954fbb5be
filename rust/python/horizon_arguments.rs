//! The arguments of the calls of a horizon.

use numpy::{PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::convert::slice;
use super::draws::scheme;
use super::horizon_results::Apart;
use super::run::run;
use super::simulate::EstimateArgument;
use crate::fleet::Limits;
use crate::limits::Solution;
use crate::limits::horizon::{DrawnEntity, Horizon, Task};
use crate::matrix::MatrixView;
use crate::memory::{try_collect, try_copy};

const WHAT: &str = "the control within limits";

type Matrix<'py> = PyReadonlyArray2<'py, f64>;

/// A copy row by row, whatever the order in memory, and how wide its rows are: A and B are columns of one array.
pub(super) struct Entries(pub(super) Vec<f64>, usize);

impl<'py> FromPyObject<'_, 'py> for Entries {
    type Error = PyErr;

    fn extract(given: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        let array = given.extract::<PyReadonlyArrayDyn<'py, f64>>()?;
        let columns = array.shape().last().copied().unwrap_or(0);
        Ok(Self(try_collect(WHAT, array.as_array().iter().copied())?, columns))
    }
}

impl Entries {
    fn view(&self) -> MatrixView<'_> {
        MatrixView::of(&self.0, self.1)
    }
}

fn pair<'a>(first: &'a Option<Entries>, second: &'a Option<Entries>) -> Option<(&'a [f64], &'a [f64])> {
    Some((&first.as_ref()?.0, &second.as_ref()?.0))
}

/// The fields of the package's `Task` that the core needs.
#[derive(FromPyObject)]
pub(super) struct TaskArgument {
    pub(super) low: Entries,
    high: Entries,
    pub(super) stage: Entries,
    pub(super) terminal: Entries,
    pub(super) reference: Entries,
    #[pyo3(attribute("R"))]
    r: Option<Entries>,
    rate: Option<Entries>,
    previous: Option<Entries>,
    state_low: Option<Entries>,
    state_high: Option<Entries>,
    soft: Option<f64>,
}

impl TaskArgument {
    /// With another reference and R where they are given.
    pub(super) fn task<'a>(&'a self, reference: Option<&'a Entries>, r: Option<&'a Entries>) -> Task<'a> {
        Task {
            low: self.low.view(),
            high: self.high.view(),
            stage: self.stage.view(),
            terminal: self.terminal.view(),
            reference: reference.unwrap_or(&self.reference).view(),
            r: r.or(self.r.as_ref()).map(Entries::view),
            rate: pair(&self.rate, &self.previous),
            states: self.state_low.as_ref().zip(self.state_high.as_ref()).map(|(low, high)| (low.view(), high.view())),
            soft: self.soft,
        }
    }

    /// The limits of a fleet.
    pub(super) fn limits(&self) -> Limits<'_> {
        Limits {
            low: &self.low.0,
            high: &self.high.0,
            rate: pair(&self.rate, &self.previous),
            states: pair(&self.state_low, &self.state_high),
            r: self.r.as_ref().map_or(&[], |r| &r.0),
        }
    }
}

pub(super) fn cost(h: &Horizon) -> f64 {
    let (n, m, steps) = h.size();
    let d = (steps * m) as f64;
    let condensed = if h.long() { 0.0 } else { d * d * (h.rows() as f64 + 10.0 * d) };
    condensed + 300.0 * steps as f64 * ((2 * n + m) as f64).powi(3)
}

pub(super) fn made(py: Python<'_>, a: &Entries, b: &Entries, c: Option<&Entries>, task: Task<'_>) -> PyResult<Horizon> {
    let (n, m) = b.view().shape();
    let work = 4.0 * (task.reference.shape().0 * n * n * (n + m)) as f64;
    run(py, work, |_| Horizon::new(a.view(), b.view(), c.map(|c| &c.0[..]), task))
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
