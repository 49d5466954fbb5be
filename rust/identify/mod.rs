//! Identification from measured pairs `y = Theta z + w`: what loops over data, draws or replicates.
//!
//! The same in plain NumPy is in `tests/python/twin/`.

mod assumed;
mod battery;
mod beta_model;
mod confidence_radii;
mod distributions;
mod estimate;
mod estimate_law;
mod kept;
mod largest_root;
mod least_squares;
mod legendre;
mod levels;
mod normal_norm;
mod quantiles;
mod residual_tests;
mod saved;
mod span;
mod symmetric;
mod triangle;
mod units;

pub use assumed::{Assumed, Covariance, Design, Noise, RegionMethod, Wish};
pub use battery::{Declared, Explained, Given, Test, battery, noise_tests};
pub use beta_model::DRAWS;
pub(crate) use confidence_radii::{By, Radius, adaptive, independent};
pub use distributions::{chi2_quantile, chi2_upper, f_upper, noncentrality_limit};
pub(crate) use distributions::{level, positive_root, root};
pub use estimate::{Data, Estimate};
pub use estimate_law::{Centre, EstimateLaw, NoiseLaw};
pub use least_squares::{Fitted, fit};
pub(crate) use least_squares::{SLACK, lengths, null_space};
pub(crate) use levels::smallest;
pub use levels::{least_squares_level, one_noise, sphere_level};
pub(crate) use normal_norm::coarse_normal_quantile;
pub use normal_norm::normal_quantile;
pub use quantiles::{
    diagonal_quantile, joint_radii, log_multigamma, row_quantile, roy_quantile, scalar_quantile, smallest_quantile,
    trace_quantile, wishart_quantile,
};
pub use residual_tests::{STATISTICS, residual_checks};
pub use span::Span;
pub(crate) use symmetric::{Symmetric, cholesky, covariance_root, log_determinant, spectral_norm, squares, whiten};
pub use triangle::{triangle, update};
pub(crate) use units::Measured;
pub use units::{MIXTURES, Magnitudes, PRIOR_NOISE, first_pairs};
