//! Identification from measured pairs `y = Theta z + w`: what loops over data, draws or replicates.
//!
//! The same in plain NumPy is in `python/stochens_rs/reference/`.

mod beta_model;
mod distributions;
mod estimate_law;
mod largest_root;
mod legendre;
mod levels;
mod normal_norm;
mod quantiles;
mod replicates;
mod residual_tests;
mod robust_control;
mod side_by_side;
mod signs;
mod symmetric;
mod triangle;
mod weighted_sums;

pub use beta_model::DRAWS;
pub use distributions::{chi2_quantile, chi2_upper, f_upper, noncentrality_limit};
pub(crate) use distributions::{level, positive_root, root};
pub(crate) use estimate_law::covariance_root;
pub use estimate_law::{EstimateLaw, NoiseLaw};
pub use levels::{least_squares_level, one_noise, sphere_level};
pub use normal_norm::normal_quantile;
pub use quantiles::{
    diagonal_quantile, joint_radii, log_multigamma, row_quantile, roy_quantile, scalar_quantile, smallest_quantile,
    trace_quantile, wishart_quantile,
};
pub use replicates::{Centre, residual_models, weighted_models};
pub use residual_tests::{Residuals, STATISTICS, residual_p_values, residuals};
pub use robust_control::robust_control;
pub use signs::{sign_radii, sign_statistics};
pub(crate) use symmetric::{Symmetric, spectral_norm};
pub use triangle::{triangle, update};
pub use weighted_sums::{Pairs, Weights};
