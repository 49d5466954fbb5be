//! Regions of window models: the linear system that they are of, and tubes of outputs.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::region::PyRegion;
use super::run::run;
use crate::certificate::{self, Along, OutputTube};
use crate::memory::try_copy;
use crate::region::{Entering, Region};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
type Array1<'py> = Bound<'py, PyArray1<f64>>;
type Array2<'py> = Bound<'py, PyArray2<f64>>;
/// `[A B c]`, J, G and the number of inputs.
pub(super) type System<'py> = (Matrix<'py>, Matrix<'py>, Matrix<'py>, usize);
/// Radii (K + 1) and components (K + 1, p).
type Radii<'py> = (Array1<'py>, Array2<'py>);

const WHAT: &str = "a region of a window";

pub(super) fn entering<'a>((matrix, entering, noise, m): &'a System<'_>) -> PyResult<Entering<'a>> {
    Ok(Entering {
        m: *m,
        matrix: slice("matrix", matrix)?,
        entering: slice("entering", entering)?,
        noise: slice("noise", noise)?,
    })
}

/// The same region with a bound of the covariance of its noise.
pub(super) fn with_noise(region: &Region, covariance: Option<&Matrix<'_>>) -> PyResult<Region> {
    let covariance = covariance.map(|values| slice("covariance", values)).transpose()?;
    Ok(region.clone().with_noise(covariance.map(|values| try_copy(WHAT, values)).transpose()?)?)
}

/// The region of `[A B c]`, and the bound of the covariance of its noise.
#[pyfunction]
pub(super) fn entered_region<'py>(
    py: Python<'py>,
    region: &Bound<'_, PyRegion>,
    system: System<'_>,
    covariance: Option<Matrix<'_>>,
) -> PyResult<(PyRegion, Option<Array2<'py>>)> {
    let found = with_noise(&region.get().0, covariance.as_ref())?.entered(entering(&system)?)?;
    let n = found.centre().len() / found.width();
    let noise = found.noise().map(|noise| array2(py, try_copy(WHAT, noise)?, n, n)).transpose()?;
    Ok((PyRegion(found), noise))
}

fn handed<'py>(py: Python<'py>, tube: OutputTube) -> PyResult<Radii<'py>> {
    let (rows, cols) = (tube.radii.len(), tube.components.len() / tube.radii.len());
    Ok((array1(py, tube.radii)?, array2(py, tube.components, rows, cols)?))
}

/// Windows and outputs along a plan whose inputs may be off by `apart`, the tube of the mean, and that of readings for
/// noise of `(covariance, probability)`.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub(super) fn output_tube<'py>(
    py: Python<'py>,
    region: &Bound<'_, PyRegion>,
    system: System<'_>,
    x0: Vector<'_>,
    inputs: Matrix<'_>,
    gain: Option<Matrix<'_>>,
    noise: Option<(Matrix<'_>, f64)>,
    apart: Option<Matrix<'_>>,
) -> PyResult<(Array2<'py>, Array2<'py>, Radii<'py>, Option<Radii<'py>>)> {
    let region = with_noise(&region.get().0, noise.as_ref().map(|noise| &noise.0))?;
    let (n, steps) = (x0.len()?, inputs.as_array().dim().0);
    let along = Along {
        x0: slice("x0", &x0)?,
        inputs: slice("inputs", &inputs)?,
        gain: gain.as_ref().map(|gain| slice("gain", gain)).transpose()?,
        apart: apart.as_ref().map(|apart| slice("apart", apart)).transpose()?,
    };
    let (system, level) = (entering(&system)?, noise.as_ref().map(|noise| noise.1));
    let cost = 20.0 * (steps * steps) as f64 * (n + region.width()).pow(3) as f64;
    let found = run(py, cost, |stop| certificate::outputs(&region, system, along, level, stop))?;
    let p = found.predicted.len() / steps.max(1);
    Ok((
        array2(py, found.states, steps + 1, n)?,
        array2(py, found.predicted, steps, p)?,
        handed(py, found.mean)?,
        found.readings.map(|tube| handed(py, tube)).transpose()?,
    ))
}
