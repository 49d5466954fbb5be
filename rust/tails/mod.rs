//! Tail bounds on the errors of averages of realizations: a setting times an inequality.
//!
//! A setting is what the error is of: [`Lines`] of a vector or a matrix, or a [`FusedControl`]. It is known by a few
//! numbers, which the formulas of `inequalities` combine with *rates*, `1 / size` of every entity (0 for one known
//! exactly), and a *level* `L = log(1 / delta)`. All numbers are in a unit of the setting, in which nothing overflows.
//!
//! The exact variances that they bound are those of a [`Sampling`] and of what comes from an [`Averaged`] matrix.

mod control;
mod covariance;
mod fractions;
mod image;
mod inequalities;
mod lines;
mod moments;
mod sizes;
#[cfg(test)]
mod tests;

pub use control::FusedControl;
pub use covariance::{Averaged, Sampling, final_covariance, fused_covariance, trajectory_covariances};
pub use image::{Image, Problem};
pub use inequalities::Inequality;
pub use lines::{Lines, Norm};
