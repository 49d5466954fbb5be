//! Tail bounds by formulas.

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use super::convert::slice;
use super::error::{InputError, ShapeError};
use super::run::run;
use crate::tails::{FusedControl, Inequality, Lines, Norm, Problem};

type Matrix<'py> = PyReadonlyArray2<'py, f64>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;
/// `(A, B, x0, xf, rows, control, paired)`
type Told<'py> = (Matrix<'py>, Matrix<'py>, Vector<'py>, Vector<'py>, bool, bool, bool);

enum Setting {
    Lines(Lines),
    Control(Box<FusedControl>),
}

/// The numbers of lines (k, n) and a norm, or of a control problem.
#[pyclass(frozen, module = "stochens_rs._core", name = "TailBounds")]
pub(super) struct PyTailBounds {
    of: Setting,
    /// What it was made of, for copies.
    made_of: Py<PyTuple>,
}

#[pymethods]
impl PyTailBounds {
    #[new]
    #[pyo3(signature = (*made_of))]
    fn new(py: Python<'_>, made_of: Bound<'_, PyTuple>) -> PyResult<Self> {
        let of = if made_of.len() == 2 {
            let (lines, norm): (Matrix<'_>, String) = made_of.extract()?;
            let (n, values, norm) = (lines.as_array().dim().1, slice("lines", &lines)?, norm_of(&norm)?);
            let cost = (values.len() * n.min(values.len() / n.max(1))) as f64;
            Setting::Lines(run(py, cost, |_| Lines::new(values, n, norm))?)
        } else {
            let (a, b, x0, xf, rows, control, paired): Told<'_> = made_of.extract()?;
            let (a, b) = (slice("A", &a)?, slice("B", &b)?);
            let (x0, xf) = (slice("x0", &x0)?, slice("xf", &xf)?);
            let cost = 10.0 * (a.len() * x0.len()) as f64;
            let of = Problem { a, b, x0, xf, rows, control, paired };
            Setting::Control(Box::new(run(py, cost, |_| FusedControl::new(of))?))
        };
        Ok(Self { of, made_of: made_of.unbind() })
    }

    fn __getnewargs__(&self, py: Python<'_>) -> Py<PyTuple> {
        self.made_of.clone_ref(py)
    }

    #[getter]
    fn unit(&self) -> f64 {
        match &self.of {
            Setting::Lines(of) => of.unit,
            Setting::Control(of) => of.image.unit,
        }
    }

    /// The largest possible error, for rates `1 / size`.
    fn cap(&self, rates: Vec<f64>) -> PyResult<f64> {
        Ok(match &self.of {
            Setting::Lines(of) => of.cap(),
            Setting::Control(of) => of.cap(three(&rates)?),
        })
    }

    /// The error that is exceeded with probability `exp(-level)` at most.
    fn radius(&self, py: Python<'_>, name: &str, rates: Vec<f64>, level: f64) -> PyResult<f64> {
        let unknown = || InputError::new_err(format!("`name` must be a bound of this quantity, got '{name}'"));
        let by = inequality(name).ok_or_else(unknown)?;
        let found = match &self.of {
            Setting::Lines(of) => of.radius(by, rates.first().copied().unwrap_or(0.0), level),
            Setting::Control(of) => {
                let rates = three(&rates)?;
                run(py, (of.image.n * of.image.n) as f64, |_| of.radius(by, rates, level))?
            }
        };
        found.ok_or_else(unknown)
    }
}

fn norm_of(name: &str) -> PyResult<Norm> {
    match name {
        "1" => Ok(Norm::One),
        "2" | "Frobenius" => Ok(Norm::Frobenius),
        "spectral" => Ok(Norm::Spectral),
        other => Err(InputError::new_err(format!("`norm` must be '1', '2', 'Frobenius' or 'spectral', got '{other}'"))),
    }
}

fn inequality(name: &str) -> Option<Inequality> {
    match name {
        "Bernstein" => Some(Inequality::Bernstein),
        "Bousquet" => Some(Inequality::Bousquet),
        "McDiarmid" => Some(Inequality::McDiarmid),
        "Weissman" => Some(Inequality::Weissman),
        "systematic" => Some(Inequality::Systematic),
        _ => None,
    }
}

fn three(rates: &[f64]) -> PyResult<[f64; 3]> {
    rates.try_into().map_err(|_| ShapeError::new_err(format!("`rates` must be 3 numbers, got {}", rates.len())))
}
