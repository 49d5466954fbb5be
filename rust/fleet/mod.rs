//! One command for many units: `x_s(k+1) = A_s x_s(k) + B_s u(k) + c_s`, and how much a fresh unit risks.
//!
//! The miss of a unit is `||x_s(K) - xf||_Q`, with the weighed inputs beside it: `(||.||_Q^2 + ||u||_R^2)^{1/2}`. With
//! `G_s` the map of the inputs and `b_s = xf - A_s^K x0 - ...` it is `||G_s u - b_s||_Q`. [`least_mean`] minimises
//! the mean of the squared misses, [`worst`] finds the least largest miss, with a lower bound from its dual that
//! believes no solver. The other functions bound, from the number of units and the size of a support alone, how often a
//! fresh unit of the same law misses more.

mod binomial;
mod chosen;
mod dual;
mod few;
mod held;
mod least_mean;
mod look;
mod mean;
mod missing;
mod program;
mod scaling;
mod scenario;
mod units;
mod within;
mod worst;

#[cfg(test)]
mod tests;

pub use few::{Few, alone, of_few};
pub use least_mean::{LeastMean, least_mean};
pub use mean::{Moments, moments, moments_root, slope};
pub use scenario::{at_most, compression, discarding, judged, rank, relaxed, required};
pub use units::Units;
pub use within::{Limits, misses};
pub use worst::{Worst, worst};
