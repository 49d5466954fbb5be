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

/// [`dense`] without looking for NaN and infinity: the gate has, and controls are bound by reading the entries once.
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
    /// The entity as the core takes it; `rows` says how a matrix's draws are laid out.
    pub(super) fn entity(&self, name: &str, rows: bool) -> PyResult<Entity<'_>> {
        Ok(match self {
            Self::Draws(draws) => Entity::Singletons { draws: draws.inner.clone(), rows },
            Self::Exact(values) => Entity::Exact(slice(name, values)?),
            Self::Dense(samples) => Entity::Dense(finite_dense(samples)?),
        })
    }
}
