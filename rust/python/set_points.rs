//! Set points of models of readings.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, slice, view};
use super::region::PyRegion;
use super::run::run;
use super::window::PyWindow;
use crate::limits::{Learned, Policy, SetPoint, SetPointTask, SetPoints};
use crate::memory::{try_copy, try_zeros};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Row<'py> = Bound<'py, PyArray1<f64>>;
type Made<'py> = Bound<'py, PyArray2<f64>>;
/// Constants at the inputs, how much more each sensor reads, and whether two of these are wrong.
type Found = (Option<Vec<f64>>, Vec<Option<f64>>, bool);

const WHAT: &str = "a set point";

/// The points of rest of a model.
#[pyclass(frozen, module = "stochens_rs._core", name = "SetPoints")]
pub(super) struct PySetPoints(Arc<SetPoints>);

#[pymethods]
impl PySetPoints {
    /// Of a model `theta`; `unit` has the sizes of outputs and inputs.
    #[new]
    fn new(window: &Bound<'_, PyWindow>, theta: Matrix<'_>, unit: Vector<'_>) -> PyResult<Self> {
        Ok(Self(Arc::new(SetPoints::new(window.get().0, view("theta", &theta)?, slice("unit", &unit)?)?)))
    }

    /// Whether some feedback can hold the outputs.
    #[getter]
    fn can_be_held(&self) -> PyResult<bool> {
        Ok(self.0.can_be_held()?)
    }

    /// What one unit of a constant input adds to the next reading (p, m).
    #[getter]
    fn of_inputs<'py>(&self, py: Python<'py>) -> PyResult<Made<'py>> {
        let (p, m) = self.0.sizes();
        array2(py, self.0.of_inputs()?, p, m)
    }

    /// The nearest one to a target; nan where an output is free, which stays at `now` if it integrates, and where an
    /// input is chosen.
    fn at(
        &self,
        py: Python<'_>,
        target: Vector<'_>,
        weights: Matrix<'_>,
        now: Vector<'_>,
        limits: (Vector<'_>, Vector<'_>),
        given: Vector<'_>,
    ) -> PyResult<PySetPoint> {
        let wish = SetPointTask {
            target: slice("target", &target)?,
            weights: view("weights", &weights)?,
            now: slice("now", &now)?,
            low: slice("low", &limits.0)?,
            high: slice("high", &limits.1)?,
            given: slice("given", &given)?,
        };
        let point = run(py, 1e6, |_| self.0.at(&wish))?;
        Ok(PySetPoint { points: Arc::clone(&self.0), point })
    }

    /// `(f*, size)` of all targets given: no system of the region rests there within the limits if `f* > 0`; -inf: not
    /// known.
    fn lacking(
        &self,
        py: Python<'_>,
        region: &Bound<'_, PyRegion>,
        target: Vector<'_>,
        limits: (Vector<'_>, Vector<'_>),
    ) -> PyResult<(f64, f64)> {
        let (target, low, high) = (slice("target", &target)?, slice("low", &limits.0)?, slice("high", &limits.1)?);
        let region = &region.get().0;
        run(py, 1e6, |stop| self.0.lacking(region, target, low, high, stop))
    }

    /// What explains a `bias` of the mean of so many `calls`, learned with `gain`, at rest at (y, u); None: nothing to
    /// explain.
    fn causes(
        &self,
        py: Python<'_>,
        region: &Bound<'_, PyRegion>,
        learned: (Vector<'_>, usize, Matrix<'_>, Matrix<'_>, Vector<'_>),
        level: f64,
    ) -> PyResult<Option<Found>> {
        let ((bias, calls, gain, noise, rest), region) = (learned, &region.get().0);
        let (bias, rest) = (slice("bias", &bias)?, slice("rest", &rest)?);
        let learned = Learned { bias, calls, gain: view("gain", &gain)?, noise: view("noise", &noise)?, rest };
        let found = run(py, 1e6, |_| self.0.causes(region, &learned, level))?;
        Ok(found.map(|found| (found.constants, found.sensors, found.two)))
    }

    /// Directions of the outputs in these sizes, (any, p), of which at most `least` leaves in a step.
    fn integrating<'py>(&self, py: Python<'py>, sizes: Vector<'_>, least: f64) -> PyResult<Made<'py>> {
        let found = self.0.integrating(slice("sizes", &sizes)?, least)?;
        let (rows, p) = (found.len() / self.0.sizes().0, self.0.sizes().0);
        array2(py, found, rows, p)
    }
}

/// A point of rest, and the rows that hold it.
#[pyclass(frozen, module = "stochens_rs._core", name = "SetPoint")]
pub(super) struct PySetPoint {
    points: Arc<SetPoints>,
    point: SetPoint,
}

getters! {
    PySetPoint {
        /// Outputs and inputs.
        place<'py>: PyResult<Row<'py>> = |own, py| array1(py, try_copy(WHAT, &own.point.place)?);
        /// Inputs that are held by a limit.
        at_limit: Vec<usize> = |own| own.point.at_limit.clone();
        /// Outputs that are held exactly, whatever constant acts.
        exact: Vec<bool> = |own| own.point.exact.clone();
    }

    /// What a constant in the equation adds to them (p + m, p).
    #[getter]
    fn of_bias<'py>(&self, py: Python<'py>) -> PyResult<Made<'py>> {
        array2(py, try_copy(WHAT, &self.point.of_bias)?, self.point.place.len(), self.points.sizes().0)
    }

    /// What it adds to the state of the window at rest (n, p).
    #[getter]
    fn states_of_bias<'py>(&self, py: Python<'py>) -> PyResult<Made<'py>> {
        let found = self.points.states_of_bias(&self.point)?;
        let p = self.points.sizes().0;
        let n = found.len() / p;
        array2(py, found, n, p)
    }

    /// Where all systems of a region rest: (shift, half, norm), or None.
    fn spread<'py>(
        &self,
        py: Python<'py>,
        region: &Bound<'_, PyRegion>,
    ) -> PyResult<Option<(Row<'py>, Row<'py>, f64)>> {
        let found = self.points.spread(&self.point, &region.get().0)?;
        found.map(|found| Ok((array1(py, found.shift)?, array1(py, found.half)?, found.norm))).transpose()
    }

    /// State and input while the target is `step` away and moves by `slope` a step, and inputs are `given` away, with a
    /// `bias`.
    fn moving<'py>(
        &self,
        py: Python<'py>,
        bias: Vector<'_>,
        step: Vector<'_>,
        slope: Vector<'_>,
        given: Vector<'_>,
    ) -> PyResult<(Row<'py>, Row<'py>)> {
        let moves = [slice("step", &step)?, slice("slope", &slope)?];
        let mut to = self.points.moved()?;
        self.points.moving(&self.point, slice("bias", &bias)?, moves, slice("given", &given)?, &mut to)?;
        let inputs = try_copy(WHAT, &to.place[self.points.sizes().0..])?;
        Ok((array1(py, to.x)?, array1(py, inputs)?))
    }

    /// The input of a `law`, of its gain, what is added, rate, low and high, about the point as it moves; None: it
    /// overflows.
    fn input<'py>(
        &self,
        py: Python<'py>,
        x: Vector<'_>,
        bias: Vector<'_>,
        moves: (Vector<'_>, Vector<'_>, Vector<'_>),
        law: (Matrix<'_>, Vector<'_>, Vector<'_>, Vector<'_>, Vector<'_>),
        acted: Vector<'_>,
    ) -> PyResult<Option<Row<'py>>> {
        let ((step, slope, given), (gain, more, rate, low, high)) = (moves, law);
        let moves = [slice("step", &step)?, slice("slope", &slope)?];
        let (mut to, (p, m)) = (self.points.moved()?, self.points.sizes());
        self.points.moving(&self.point, slice("bias", &bias)?, moves, slice("given", &given)?, &mut to)?;
        let law = Policy {
            gain: slice("gain", &gain)?,
            more: slice("more", &more)?,
            rate: slice("rate", &rate)?,
            low: slice("low", &low)?,
            high: slice("high", &high)?,
        };
        let mut u = try_zeros(WHAT, m)?;
        let finite = law.input(slice("x", &x)?, (&to.x, &to.place[p..]), slice("acted", &acted)?, &mut u)?;
        finite.then(|| array1(py, u)).transpose()
    }
}
