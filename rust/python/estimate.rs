//! Models from triangles, and least squares of their rows.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, getters, slice};
use super::error::InputError;
use super::fitted::{PyFitted, copied};
use super::region::PyRegion;
use super::run::{UNTIL_STOPPED, run};
use crate::identify::{self, Assumed, Covariance, Data, Design, Estimate, Magnitudes, Noise, RegionMethod, Wish};
use crate::memory::{try_collect, try_room};
use crate::region::Region;

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

const WHAT: &str = "least squares";

/// A model from the triangle of its data.
#[pyclass(frozen, module = "stochens_rs._core", name = "Estimate")]
pub(super) struct PyEstimate(pub(super) Arc<Estimate>);

getters! {
    PyEstimate {
        rank: usize = |own| own.0.rank();
        size: usize = |own| own.0.size;
    }

    #[new]
    #[pyo3(signature = (triangle, size, n, m, offset, known=None))]
    fn new(
        py: Python<'_>,
        triangle: Matrix<'_>,
        size: usize,
        n: usize,
        m: usize,
        offset: bool,
        known: Option<Matrix<'_>>,
    ) -> PyResult<Self> {
        let known = known.as_ref().map(|known| slice("known", known)).transpose()?;
        let triangle = slice("triangle", &triangle)?;
        let of = Data { triangle, size, n, m, offset, known };
        let cost = 30.0 * ((n + m) as f64).powi(3) * if known.is_some() { n as f64 } else { 1.0 };
        Ok(Self(Arc::new(run(py, cost, |stop| Estimate::new(of, stop))?)))
    }

    #[getter(Theta)]
    fn model<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        copied(py, &self.0.model, self.0.n, self.0.model.len() / self.0.n)
    }

    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.0.covariance()?.map(|found| array2(py, found, self.0.n, self.0.n)).transpose()
    }

    /// All rows at once, or each of them.
    #[getter]
    fn blocks(&self) -> PyResult<Vec<PyFitted>> {
        let mut found = try_room(WHAT, self.0.blocks.len())?;
        found.extend(self.0.blocks.iter().map(|block| PyFitted(Arc::clone(block))));
        Ok(found)
    }

    /// The estimate from so many pairs, if data go on like those so far.
    fn after(&self, py: Python<'_>, size: usize, times: f64) -> PyResult<Self> {
        Ok(Self(Arc::new(run(py, UNTIL_STOPPED, |stop| self.0.after(size, times, stop))?)))
    }

    #[pyo3(signature = (assumed, units, delta, components, directions, future, frobenius, method, anytime, threads, tail=0.0))]
    #[expect(clippy::too_many_arguments, reason = "what is assumed, and what is asked")]
    fn region(
        &self,
        py: Python<'_>,
        assumed: (&str, &str, &str, Option<Matrix<'_>>),
        units: UnitsOf<'_>,
        delta: f64,
        components: bool,
        directions: Option<Matrix<'_>>,
        future: usize,
        frobenius: bool,
        method: &str,
        anytime: bool,
        threads: usize,
        tail: f64,
    ) -> PyResult<PyRegion> {
        let (design, noise, word, known) = &assumed;
        let covariance = covariance(word, known.as_ref())?;
        let design = if *design == "independent" { Design::Independent } else { Design::Adaptive };
        let noise = match *noise {
            "gaussian" => Noise::Gaussian,
            "sub-gaussian" | "bounded" => Noise::SubGaussian,
            other => return Err(InputError::new_err(format!("`noise` has no region of this kind, got '{other}'"))),
        };
        let method = match method {
            "mixture" => RegionMethod::Mixture,
            "universal" => RegionMethod::Universal,
            _ => RegionMethod::Auto,
        };
        let directions = directions.as_ref().map(|q| slice("directions", q)).transpose()?;
        let wish = Wish { delta, components, directions, future, frobenius, method, anytime };
        let assumed = Assumed { design, noise, covariance, tail };
        let units = match &units {
            UnitsOf::First(first) => Magnitudes::First(&first.get().0),
            UnitsOf::Expected(scale) => Magnitudes::Expected(slice("scale", scale)?),
        };
        let region =
            run(py, UNTIL_STOPPED, |stop| Region::from_data(&self.0, assumed, wish, units, threads, stop))?;
        Ok(PyRegion(region))
    }
}

/// Sizes of states and inputs that were expected, or the estimate of the first part of the data.
#[derive(FromPyObject)]
enum UnitsOf<'py> {
    First(Bound<'py, PyEstimate>),
    Expected(Vector<'py>),
}

/// A covariance by its name, or the known one.
pub(super) fn covariance<'a>(word: &str, known: Option<&'a Matrix<'_>>) -> PyResult<Covariance<'a>> {
    let known = known.map(|known| slice("covariance", known)).transpose()?;
    match (word, known) {
        ("full", None) => Ok(Covariance::Full),
        ("diagonal", None) => Ok(Covariance::Diagonal),
        ("scalar", None) => Ok(Covariance::Scalar),
        ("known", Some(known)) => Ok(Covariance::Known(known)),
        (other, _) => Err(InputError::new_err(format!("`covariance` must be of a known kind, got '{other}'"))),
    }
}

/// What the event of a region of any design refers to: the mixtures, and the noise of the prior behind them.
#[pyfunction]
pub(super) fn mixtures(py: Python<'_>) -> PyResult<Bound<'_, PyArray1<f64>>> {
    array1(py, try_collect(WHAT, identify::MIXTURES.into_iter().chain([identify::PRIOR_NOISE]))?)
}
