//! Realizations and entities of a control problem as they come from the package.

use numpy::PyReadonlyArray2;
use pyo3::prelude::*;

use super::convert::slice;
use super::draws::Draws;
use crate::control::Entity;
use crate::fuse::Dense;

/// Realizations as they come from the package: `Draws`, or the rows of a two-dimensional array.
#[derive(FromPyObject)]
pub(super) enum Realizations<'py> {
    Draws(PyRef<'py, Draws>),
    Dense(PyReadonlyArray2<'py, f64>),
}

/// The rows of a two-dimensional array as dense realizations.
pub(super) fn dense<'a>(array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<Dense<'a>> {
    let (size, dim) = array.as_array().dim();
    Ok(Dense::new(slice("samples", array)?, size, dim)?)
}

/// [`dense`] without a check for NaN and infinity, which `_base/validation.py` has made: reading the entries is most of
/// the time here.
fn finite_dense<'a>(array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<Dense<'a>> {
    let (size, dim) = array.as_array().dim();
    Ok(Dense::of_finite(slice("samples", array)?, size, dim)?)
}

/// An entity of a control problem: `Draws`, rows of a two-dimensional array, or exact (one-dimensional).
#[derive(FromPyObject)]
pub(super) enum EntityArgument<'py> {
    Draws(PyRef<'py, Draws>),
    Exact(numpy::PyReadonlyArray1<'py, f64>),
    Dense(PyReadonlyArray2<'py, f64>),
}

impl EntityArgument<'_> {
    /// The entity for the core; `rows`: the lines of a matrix's draws are its rows.
    pub(super) fn entity(&self, name: &str, rows: bool) -> PyResult<Entity<'_>> {
        Ok(match self {
            Self::Draws(draws) => Entity::Singletons { draws: draws.inner.clone(), rows },
            Self::Exact(values) => Entity::Exact(slice(name, values)?),
            Self::Dense(samples) => Entity::Dense(finite_dense(samples)?),
        })
    }
}
