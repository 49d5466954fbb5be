//! Models by instruments that a pilot model simulates.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::estimate::covariance;
use super::outputs::{System, entering};
use super::region::{PyRegion, places};
use super::run::{UNTIL_STOPPED, run};
use crate::certificate::{Course, Endpoints, LaterPairs, MainRuns, Pilot, Reference, Shares, Simulation};
use crate::memory::try_copy;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

const WHAT: &str = "a model by instruments";

/// What is known of the covariance of the noise: "full", "diagonal", "scalar", or "known" with the matrix.
type Known<'py> = (String, Option<Matrix<'py>>);

/// The model `H` with the exact law of its error.
#[pyclass(frozen, module = "stochens_rs._core", name = "Pilot")]
pub(super) struct PyPilot {
    pilot: Pilot,
    n: usize,
    d: usize,
}

/// The pilot's plan for a task that was fixed before the noise of the data.
#[pyclass(frozen, module = "stochens_rs._core", name = "Reference")]
pub(super) struct PyReference(Reference);

/// `(target, reach, quantile, mismatch, rest, tube, components)`.
type FoundNear<'py> = (f64, f64, f64, f64, f64, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// The system, its first state, the inputs, and a gain.
type GivenCourse<'py> = (System<'py>, Vector<'py>, Matrix<'py>, Option<Matrix<'py>>);
type Followed<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

fn course<'a>((system, x0, inputs, gain): &'a GivenCourse<'_>) -> PyResult<Course<'a>> {
    Ok(Course {
        system: entering(system)?,
        gain: gain.as_ref().map(|gain| slice("gain", gain)).transpose()?,
        x0: slice("x0", x0)?,
        inputs: slice("inputs", inputs)?,
    })
}

#[pymethods]
impl PyPilot {
    #[new]
    fn new(
        py: Python<'_>,
        rows: Matrix<'_>,
        lengths: PyReadonlyArray1<'_, i64>,
        model: Matrix<'_>,
        feedback: Option<(Matrix<'_>, Matrix<'_>)>,
        threads: usize,
    ) -> PyResult<Self> {
        let ((pairs, width), (n, d)) = (rows.as_array().dim(), model.as_array().dim());
        let lengths = places("lengths", &lengths)?;
        let runs = MainRuns { rows: slice("rows", &rows)?, lengths: &lengths, n, m: width.saturating_sub(2 * n) };
        let feedback = match &feedback {
            None => None,
            Some((gain, dither)) => Some((slice("gain", gain)?, slice("dither", dither)?)),
        };
        let simulation = Simulation { model: slice("model", &model)?, feedback };
        let cost = (pairs * (2 * d + n).pow(2)) as f64;
        Ok(Self { pilot: run(py, cost, |stop| Pilot::new(runs, simulation, threads, stop))?, n, d })
    }

    /// Of pairs `(z, y)` with any feedback, behind `before` ones of this model and root of their squares.
    #[staticmethod]
    fn after(
        py: Python<'_>,
        rows: Matrix<'_>,
        model: Matrix<'_>,
        root: Matrix<'_>,
        before: usize,
        m: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let ((pairs, width), (n, d)) = (rows.as_array().dim(), model.as_array().dim());
        let (model, root) = (slice("model", &model)?, slice("root", &root)?);
        let of = LaterPairs { rows: slice("rows", &rows)?, model, root, before, m };
        let cost = (pairs * (d + width).pow(2)) as f64;
        Ok(Self { pilot: run(py, cost, |stop| Pilot::after(of, threads, stop))?, n, d })
    }

    #[getter]
    fn centre<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array2(py, try_copy(WHAT, self.pilot.centre())?, self.n, self.d)
    }

    /// T (d, d): `H - Theta = Sigma^(1/2) Gamma T`.
    #[getter]
    fn white<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        array2(py, try_copy(WHAT, self.pilot.white())?, self.d, self.d)
    }

    #[getter]
    fn determined(&self) -> bool {
        self.pilot.determined()
    }

    /// The models that contain the true one.
    fn region(&self, py: Python<'_>, known: Known<'_>, delta: f64, both: bool) -> PyResult<PyRegion> {
        let covariance = covariance(&known.0, known.1.as_ref())?;
        Ok(PyRegion(run(py, UNTIL_STOPPED, |stop| self.pilot.region(covariance, delta, both, stop))?))
    }

    /// From the inputs of a plan.
    fn reference(&self, x0: Vector<'_>, inputs: Matrix<'_>) -> PyResult<PyReference> {
        Ok(PyReference(Reference::new(&self.pilot, slice("x0", &x0)?, slice("inputs", &inputs)?)?))
    }

    /// Bounds of the model and of noise (K + 1, p) of a plan that is followed, beside that of the pilot; None if it is
    /// too large.
    fn followed<'py>(
        &self,
        py: Python<'py>,
        own: GivenCourse<'_>,
        reference: GivenCourse<'_>,
        known: Known<'_>,
        delta: f64,
        noise: bool,
    ) -> PyResult<Option<Followed<'py>>> {
        let shares = Shares::followed(delta, known.1.is_some(), noise)?;
        let covariance = covariance(&known.0, known.1.as_ref())?;
        let (steps, (own, reference)) = (own.2.as_array().dim().0, (course(&own)?, course(&reference)?));
        let found = run(py, UNTIL_STOPPED, |stop| {
            let event = self.pilot.event(covariance, (shares.radii, shares.covariance), true, stop)?;
            self.pilot.followed(own, reference, &event, shares, stop)
        })?;
        let Some(found) = found else { return Ok(None) };
        Ok(Some((array2(py, found.model, steps + 1, self.n)?, array2(py, found.noise, steps + 1, self.n)?)))
    }

    /// The certificate of a plan at `delta`.
    #[expect(clippy::too_many_arguments, reason = "one call, named in the stub")]
    fn near<'py>(
        &self,
        py: Python<'py>,
        reference: &PyReference,
        x0: Vector<'_>,
        xf: Vector<'_>,
        inputs: Matrix<'_>,
        predicted: Matrix<'_>,
        known: Known<'_>,
        delta: f64,
        noise: bool,
    ) -> PyResult<FoundNear<'py>> {
        let steps = inputs.as_array().dim().0;
        let task = Endpoints {
            x0: slice("x0", &x0)?,
            rho0: 0.0,
            xf: slice("xf", &xf)?,
            predicted: slice("predicted", &predicted)?,
        };
        let inputs = slice("inputs", &inputs)?;
        let shares = Shares::new(delta, known.1.is_some(), noise, steps)?;
        let covariance = covariance(&known.0, known.1.as_ref())?;
        let found = run(py, UNTIL_STOPPED, |stop| {
            let event = self.pilot.event(covariance, (shares.radii, shares.covariance), true, stop)?;
            self.pilot.near(&reference.0, task, inputs, &event, shares, stop)
        })?;
        Ok((
            found.target,
            found.reach,
            found.quantile,
            found.mismatch,
            found.rest,
            array1(py, found.tube)?,
            array1(py, found.components)?,
        ))
    }
}
