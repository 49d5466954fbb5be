//! Weights on the simplex for realizations `E_1 .. E_N`: uniform, accumulated and sequential least squares.
//!
//! Accumulated least squares (ALSE) minimises `||sum_i w_i E_i - E*||` over `w >= 0, sum w = 1` in the 2-norm
//! (Frobenius for matrices): by a formula for singleton vectors, and for matrices whose columns have weights of their
//! own ([`closed_form()`]), by a certified solver for everything else ([`alse()`]). Sequential least squares (SLSE)
//! takes one line search per realization ([`slse()`]). The target `E*` is always an argument: a nominal model or a
//! held-out estimate.

mod alse;
mod closed_form;
mod dense;
mod line_search;
mod method;
mod path;
mod simplex;
mod slse;
mod slse_dense;
mod slse_run;
mod slse_sample;
mod slse_tables;
mod uniform;

pub use alse::{CertifiedWeights, Realizations, Settings, WeightStatus, alse, alse_prefixes, second_opinion};
pub use closed_form::{ClosedForm, Gap, closed_form, project_on_simplex};
pub use dense::Dense;
pub use method::{Fusion, Samples};
pub use path::{Path, alse_path, uniform_dense, uniform_path};
pub use slse::{Sequential, slse, slse_each};
pub use slse_dense::slse_dense;
pub use uniform::{Weights, uniform};

pub use crate::scaled::distance;

pub(crate) use line_search::step_towards;
pub(crate) use slse_run::Run;
pub(crate) use slse_tables::Apart;

pub(crate) use crate::scaled::{norm, power_of_two_scale};
