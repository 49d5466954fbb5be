//! Regions of models, and the certificates that follow.

use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::convert::{array1, array2, getters, slice, view};
use super::error::ShapeError;
use super::fitted::{PyFitted, copied, places as as_places};
use super::run::run;
use crate::certificate::{self, ControlError, Endpoints, Gaussian, ToCome, Way};
use crate::error::require_finite;
use crate::memory::{try_copy, try_room};
use crate::region::{DIRECTIONS, Part, PartOf, Region};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

const WHAT: &str = "a region of models";

/// `(Theta - C) V (Theta - C)' <= factor S` for some rows and columns.
#[pyclass(frozen, module = "stochens_rs._core", name = "RegionPart")]
pub(super) struct PyPart(Arc<Part>);

pub(super) fn places(name: &str, values: &PyReadonlyArray1<'_, i64>) -> PyResult<Vec<usize>> {
    let view = values.as_array();
    let mut found = try_room(WHAT, view.len())?;
    for value in view {
        let place = usize::try_from(*value);
        found.push(place.map_err(|_| ShapeError::new_err(format!("`{name}` must be at least 0, got {value}")))?);
    }
    Ok(found)
}

getters! {
    PyPart {
        rows<'py>: PyResult<Bound<'py, PyArray1<i64>>> = |own, py| as_places(py, own.0.of().rows);
        columns<'py>: PyResult<Bound<'py, PyArray1<i64>>> = |own, py| as_places(py, own.0.of().columns);
        white<'py>: PyResult<Bound<'py, PyArray2<f64>>> = |own, py| own.with_columns(py, &own.0.white);
        root<'py>: PyResult<Bound<'py, PyArray2<f64>>> = |own, py| own.with_columns(py, &own.0.root);
        ratio: f64 = |own| own.0.of().ratio;
        factor: f64 = |own| own.0.of().factor;
        radius: f64 = |own| own.0.radius();
    }

    #[new]
    #[expect(clippy::too_many_arguments, reason = "the fields of the record")]
    fn new(
        rows: PyReadonlyArray1<'_, i64>,
        columns: PyReadonlyArray1<'_, i64>,
        white: Matrix<'_>,
        root: Matrix<'_>,
        missing: Matrix<'_>,
        ratio: f64,
        shape: Matrix<'_>,
        factor: f64,
    ) -> PyResult<Self> {
        let (rows, columns) = (places("rows", &rows)?, places("columns", &columns)?);
        let of = PartOf {
            rows: &rows,
            columns: &columns,
            white: view("white", &white)?,
            root: view("root", &root)?,
            missing: Some(view("missing", &missing)?),
            ratio,
            shape: view("S", &shape)?,
            factor,
        };
        for (name, values) in [("white", &white), ("root", &root), ("missing", &missing), ("S", &shape)] {
            require_finite(name, slice(name, values)?)?;
        }
        Ok(Self(Arc::new(Part::new(of)?)))
    }

    /// Around least squares, widened by its rounding.
    #[staticmethod]
    fn around(fitted: &PyFitted, shape: Matrix<'_>, factor: f64) -> PyResult<Self> {
        let shape = slice("S", &shape)?;
        require_finite("S", shape)?;
        Ok(Self(Arc::new(Part::around(&fitted.0, shape, factor)?)))
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyTuple>)> {
        let names = ["rows", "columns", "white", "root", "missing", "ratio", "S", "factor"];
        let mut fields = try_room(WHAT, names.len())?;
        for name in names {
            fields.push(slf.getattr(name)?);
        }
        Ok((slf.get_type().into_any(), PyTuple::new(slf.py(), fields)?))
    }

    #[getter]
    fn missing<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let Part { columns, missing, .. } = &*self.0;
        copied(py, missing, columns.len(), missing.len().checked_div(columns.len()).unwrap_or(0))
    }

    #[getter(S)]
    fn shape<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let Part { rows, shape, .. } = &*self.0;
        copied(py, shape, rows.len(), rows.len())
    }

    #[getter]
    fn deviations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        array1(py, try_copy(WHAT, self.0.deviations())?)
    }

    fn length(&self, z: Vector<'_>) -> PyResult<f64> {
        let z = slice("z", &z)?;
        if self.0.columns.iter().any(|j| *j >= z.len()) {
            return Err(ShapeError::new_err(format!("`z` must have an entry for each column, got {}", z.len())));
        }
        Ok(self.0.length(z))
    }

    fn reach(&self, from: usize, to: usize) -> PyResult<f64> {
        Ok(self.0.reach(from, to)?)
    }
}

impl PyPart {
    fn with_columns<'py>(&self, py: Python<'py>, values: &[f64]) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let columns = self.0.of().columns.len();
        copied(py, values, values.len().checked_div(columns).unwrap_or(0), columns)
    }
}

/// What several steps add up to.
#[pyclass(frozen, module = "stochens_rs._core", name = "Errors")]
pub(super) struct PyErrors {
    errors: certificate::Errors,
    n: usize,
}

getters! {
    PyErrors {
        radii<'py>: PyResult<Bound<'py, PyArray1<f64>>> = |own, py| array1(py, try_copy(WHAT, &own.errors.radii)?);
        linear<'py>: PyResult<Bound<'py, PyArray1<f64>>> = |own, py| array1(py, try_copy(WHAT, &own.errors.linear)?);
        rest<'py>: PyResult<Bound<'py, PyArray1<f64>>> = |own, py| array1(py, try_copy(WHAT, &own.errors.rest)?);
    }

    #[getter]
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let values = try_copy(WHAT, &self.errors.states)?;
        array2(py, values, self.errors.states.len() / self.n, self.n)
    }

    #[getter]
    fn components<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        array1(py, try_copy(WHAT, self.errors.components())?)
    }
}

/// Noise to come: `(radius, root)`, or `(root, end, before)` for Gaussian noise.
#[derive(FromPyObject)]
pub(super) enum Noise<'py> {
    Sized(f64, Matrix<'py>),
    Gaussian(Matrix<'py>, f64, f64),
}

fn to_come<'a>(noise: &'a Option<Noise<'_>>) -> PyResult<Option<ToCome<'a>>> {
    Ok(match noise {
        None => None,
        Some(Noise::Sized(radius, root)) => {
            Some(ToCome::Sized { radius: *radius, root: slice("noise to come", root)? })
        }
        Some(Noise::Gaussian(root, end, before)) => {
            let root = slice("noise to come", root)?;
            Some(ToCome::Gaussian(Gaussian { root, end: *end, before: *before }))
        }
    })
}

/// A set of models that contains the true one.
#[pyclass(frozen, module = "stochens_rs._core", name = "Region")]
pub(super) struct PyRegion(pub(super) Region);

impl PyRegion {
    /// Elementary operations of a certificate of so many steps.
    fn cost(&self, steps: usize) -> f64 {
        10.0 * (steps * steps) as f64 * self.0.width().pow(3) as f64
    }
}

getters! {
    PyRegion {
        frobenius: Option<f64> = |own| own.0.frobenius;
        radius: f64 = |own| own.0.radius();
    }

    #[new]
    fn new(
        centre: Matrix<'_>,
        m: usize,
        parts: &Bound<'_, PyTuple>,
        frobenius: Option<f64>,
        future: bool,
    ) -> PyResult<Self> {
        let mut all = try_room(WHAT, parts.len())?;
        for part in parts {
            all.push(Arc::clone(&part.cast::<PyPart>()?.get().0));
        }
        Ok(Self(Region::new(view("centre", &centre)?, m, all, frobenius, future)?))
    }

    #[getter]
    fn centre<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (centre, d) = (self.0.centre(), self.0.width());
        copied(py, centre, centre.len() / d, d)
    }

    #[getter]
    fn parts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let mut all = try_room(WHAT, self.0.parts().len())?;
        all.extend(self.0.parts().iter().map(|part| PyPart(Arc::clone(part))));
        PyTuple::new(py, all)
    }

    #[getter]
    fn noise<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.0.noise().map(|noise| copied(py, noise, noise.len().isqrt(), noise.len().isqrt())).transpose()
    }

    fn bound(&self, z: Vector<'_>, noise: bool) -> PyResult<f64> {
        Ok(self.0.bound(slice("z", &z)?, noise)?)
    }

    fn component_bounds<'py>(&self, py: Python<'py>, z: Vector<'_>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        array1(py, self.0.component_bounds(slice("z", &z)?)?)
    }

    fn entry_bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let found = self.0.entry_bounds()?;
        let rows = found.len() / self.0.width();
        array2(py, found, rows, self.0.width())
    }

    fn spread(&self, from: usize, to: usize) -> PyResult<f64> {
        Ok(self.0.spread(from, to)?)
    }

    fn contains(&self, theta: Matrix<'_>) -> PyResult<bool> {
        Ok(self.0.contains(view("Theta", &theta)?)?)
    }

    /// Corners (directions, 2), or None where there is no edge.
    fn projection<'py>(
        &self,
        py: Python<'py>,
        one: (usize, usize),
        other: (usize, usize),
    ) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        self.0.projection(one, other)?.map(|corners| array2(py, corners, DIRECTIONS, 2)).transpose()
    }

    fn errors(
        &self,
        py: Python<'_>,
        x0: Vector<'_>,
        inputs: Matrix<'_>,
        rho0: f64,
        noise: Option<Noise<'_>>,
    ) -> PyResult<PyErrors> {
        let (x0, given, noise) = (slice("x0", &x0)?, slice("inputs", &inputs)?, to_come(&noise)?);
        let cost = self.cost(inputs.as_array().dim().0);
        let errors = run(py, cost, |stop| certificate::trajectory(&self.0, x0, given, rho0, noise, (false, stop)))?;
        Ok(PyErrors { errors, n: x0.len() })
    }
}

/// A region, the inputs in its form, noise to come, and whether it compares with the best control.
type GivenWay<'py> = (Bound<'py, PyRegion>, Matrix<'py>, Option<Noise<'py>>, bool);
/// `(best, (target, reach, model_error, start), components, tube, bands, control, why)`; `why` no bound of the control
/// is known.
type Found<'py> = (
    usize,
    (f64, f64, f64, f64),
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Option<Bound<'py, PyArray2<f64>>>,
    f64,
    Option<&'static str>,
);

/// The inputs of the centre under a feedback about a plan with other states.
#[pyfunction]
pub(super) fn followed_inputs<'py>(
    py: Python<'py>,
    region: &Bound<'_, PyRegion>,
    x0: Vector<'_>,
    inputs: Matrix<'_>,
    planned: Matrix<'_>,
    gain: Matrix<'_>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (steps, m) = inputs.as_array().dim();
    let (x0, inputs) = (slice("x0", &x0)?, slice("inputs", &inputs)?);
    let made = certificate::followed(&region.get().0, x0, inputs, slice("planned", &planned)?, slice("gain", &gain)?)?;
    array2(py, made, steps, m)
}

/// The certificate of a plan from regions that hold in one event.
#[pyfunction]
pub(super) fn certify<'py>(
    py: Python<'py>,
    start: (Vector<'_>, f64),
    xf: Vector<'_>,
    predicted: Matrix<'_>,
    ways: Vec<GivenWay<'_>>,
    apart: Option<GivenWay<'_>>,
    every: bool,
) -> PyResult<Found<'py>> {
    let (x0, rho0) = start;
    let task =
        Endpoints { x0: slice("x0", &x0)?, rho0, xf: slice("xf", &xf)?, predicted: slice("predicted", &predicted)? };
    let (mut given, mut cost) = (try_room(WHAT, ways.len())?, 0.0);
    for way in &ways {
        cost += way.0.get().cost(way.1.as_array().dim().0);
        given.push(as_way(way)?);
    }
    let apart = apart.as_ref().map(as_way).transpose()?;
    let found = run(py, 2.0 * cost, |stop| certificate::certify(task, &given, apart, (every, stop)))?;
    let (steps, n) = predicted.as_array().dim();
    let (control, reason) = match found.control {
        None => (f64::INFINITY, Some("over several steps no bound of the control is known")),
        Some(ControlError::Within(value)) => (value, None),
        Some(ControlError::Many) => {
            (f64::INFINITY, Some("there are more inputs than states, so that many controls are as good"))
        }
        Some(ControlError::NoEffect) => {
            (f64::INFINITY, Some("within the error of the data some inputs may have no effect"))
        }
    };
    Ok((
        found.best,
        (found.target, found.reach, found.model_error, found.start),
        array1(py, found.components)?,
        array1(py, found.tube)?,
        if every { Some(array2(py, found.bands, steps, n)?) } else { None },
        control,
        reason,
    ))
}

fn as_way<'a>((region, inputs, noise, compares): &'a GivenWay<'_>) -> PyResult<Way<'a>> {
    let inputs = slice("inputs", inputs)?;
    Ok(Way { region: &region.get().0, inputs, to_come: to_come(noise)?, compares: *compares })
}
