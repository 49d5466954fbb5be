//! The best inputs of K steps of `x(k+1) = A x(k) + B u(k) + c`, and how far other inputs are from them.
//!
//! With `x(k) = A^k x0 + f(k) + sum_{j<k} A^(k-1-j) B u(j)` and `F_k'F_k = Q_k`, the cost
//! `J(u) = sum_{k=1..K} ||x(k) - r(k)||_{Q_k}^2 + ||u(k-1)||_R^2` is `||M u - y||^2 + u'R u` for
//! `M = [F_k A^(k-1-j) B]` and `y = [F_k (r(k) - f(k))] - [F_k A^k] x0`.

mod condensed;
mod draws;
mod errors;
mod map;
mod pivoting;
mod solve;
mod suboptimality;

#[cfg(test)]
mod tests;

pub use condensed::Condensed;
pub use draws::{DrawnEntity, Runs};
pub use errors::{Cause, Radii};
pub use map::{Horizon, Task};
pub use solve::{RecedingHorizon, Solved};
pub use suboptimality::Apart;
