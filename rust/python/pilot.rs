//! Models by instruments that a pilot model simulates.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::estimate::covariance;
use super::region::{PyRegion, places};
use super::run::{UNTIL_STOPPED, run};
use crate::certificate::{Endpoints, MainRuns, Pilot, Reference, Shares, Simulation};
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
