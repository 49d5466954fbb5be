//! Controls within limits: the least `J(u) = ||M u - y||^2 + u' R u` over `low <= u <= high`.
//!
//! Block principal pivoting finds which limits are reached, with an interior point as safeguard and orthogonal factors
//! where the problem is ill-conditioned. Every result says how far it can be from the minimum, computed from `M`, `R`,
//! `y` and the result alone: for the half gradient `g = M'(M u - y) + R u` and any `v` within the limits,
//! `||u - u*||_H^2 <= <g, u - v>` at its largest, and `||u - u*||_H^2 <= e' H^{-1} e` with `e` the part of `g` that no
//! limit balances, `H = M'M + R`.

mod batch;
mod bounds;
mod causes;
mod certificate;
mod dense;
mod dual;
mod factor;
pub mod horizon;
mod interior;
mod kernel;
mod linear;
mod orthogonal;
mod quadratic;
mod riccati;
mod rows;
mod search;
mod set_points;
mod solve;
mod solver;
mod tables;
mod tiles;

#[cfg(test)]
mod tests;

pub use batch::{Batch, box_batch};
pub use bounds::Bounds;
pub use causes::{Causes, Learned};
pub(crate) use factor::{Factor, squared};
pub(crate) use kernel::padded;
pub use linear::root;
pub(crate) use linear::{Decomposition, decomposition, eigen};
pub use quadratic::{Method, Status, Until};
pub use riccati::closed::{Followed, followed_control};
pub use riccati::{Steps, horizon_control};
pub use rows::{Rows, RowsSolution, rows_control};
pub use set_points::{Moved, Policy, SetPoint, SetPointTask, SetPoints, Spread};
pub use solve::{Most, Penalty, Solution, box_control};
pub use solver::Solver;
