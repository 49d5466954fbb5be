//! Models by instruments that a pilot model simulates.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::error::InputError;
use super::region::places;
use super::run::run;
use crate::certificate::{Covariance, Event, Pilot, Reference, Runs, Shares, Simulation, Task};
use crate::memory::try_copy;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

const WHAT: &str = "a model by instruments";

/// The covariance of the noise (n, n), or what is known of it: "scalar", "diagonal" or "full".
#[derive(FromPyObject)]
enum Known<'py> {
    Matrix(Matrix<'py>),
    Kind(String),
}

impl Known<'_> {
    fn covariance(&self, n: usize) -> PyResult<Covariance<'_>> {
        match self {
            Self::Matrix(known) if known.as_array().dim() == (n, n) => Ok(Covariance::Known(slice("S", known)?)),
            Self::Kind(kind) if kind == "scalar" => Ok(Covariance::Scalar),
            Self::Kind(kind) if kind == "diagonal" => Ok(Covariance::Diagonal),
            Self::Kind(kind) if kind == "full" => Ok(Covariance::Full),
            _ => Err(InputError::new_err(format!("`S` must be ({n}, {n}), 'scalar', 'diagonal' or 'full'"))),
        }
    }
}

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

/// `(white, root, ratio)` of the region, `(spectral, frobenius)`, and the bound of the covariance.
type FoundEvent<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, f64, f64, f64, Bound<'py, PyArray2<f64>>);

/// `(target, reach, quantile, mismatch, rest, tube, components)`.
type FoundNear<'py> = (f64, f64, f64, f64, f64, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

impl PyPilot {
    fn event(&self, py: Python<'_>, known: &Known<'_>, radii: f64, noise: f64, both: bool) -> PyResult<Event> {
        let covariance = known.covariance(self.n)?;
        let cost = 1e4 * (self.n * self.d) as f64;
        run(py, cost, |stop| self.pilot.event(covariance, (radii, noise), both, stop))
    }
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
        let runs = Runs { rows: slice("rows", &rows)?, lengths: &lengths, n, m: width.saturating_sub(2 * n) };
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

    #[getter]
    fn determined(&self) -> bool {
        self.pilot.determined()
    }

    /// What holds with probability `1 - radii - noise`.
    fn region<'py>(
        &self,
        py: Python<'py>,
        known: Known<'_>,
        radii: f64,
        noise: f64,
        both: bool,
    ) -> PyResult<FoundEvent<'py>> {
        let event = self.event(py, &known, radii, noise, both)?;
        let (white, root, ratio) = self.pilot.lengths();
        Ok((
            array2(py, try_copy(WHAT, white)?, self.d, self.d)?,
            array2(py, try_copy(WHAT, root)?, self.d, self.d)?,
            ratio,
            event.spectral,
            event.frobenius,
            array2(py, event.covariance, self.n, self.n)?,
        ))
    }

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
        let task = Task {
            x0: slice("x0", &x0)?,
            rho0: 0.0,
            xf: slice("xf", &xf)?,
            predicted: slice("predicted", &predicted)?,
        };
        let inputs = slice("inputs", &inputs)?;
        let shares = Shares::new(delta, matches!(known, Known::Matrix(_)), noise, steps)?;
        let event = self.event(py, &known, shares.radii, shares.covariance, true)?;
        let cost = 30.0 * (steps * steps) as f64 * self.d.pow(3) as f64 + 1e6 * steps as f64;
        let found = run(py, cost, |stop| self.pilot.near(&reference.0, task, inputs, &event, shares, stop))?;
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
