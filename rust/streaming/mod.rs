//! The sequential algorithm: estimates of `x0`, `xf`, `A` and the control from them, updated with every realization.
//!
//! [`Stream`] draws its own realizations and fits them to their means by sequential least squares. One slot `i` moves
//! per step, `F_i <- (1 - t) F_i + t E`, and `v <- (1 - t) v + t v'` with `v'` from `E` in that
//! slot and the fused values in the other two. Since `(xf, x0, A) -> B^+ (xf - A x0)` is affine in each slot, that is
//!
//! `v = B^+ (Ff - FA F0)`,
//!
//! so only `FA F0` is kept up to date, in `O(n)` per step, and `B^+` is applied when `v` is asked for. With
//! `P = B B^+`, `v* = B^+ (xf - A x0)`,
//!
//! `||B (v - v*)|| <= ||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||`
//!
//! is the certificate of the stopping rule. [`DataStream`] takes realizations from outside.

mod advance;
mod confidence;
mod data;
mod data_state;
mod estimator;
mod geometry;
mod products;
mod read;
mod state;
mod stream;
mod trace;
mod typical;

pub use advance::{Budget, End, Rule};
pub use confidence::mean_radius;
pub use data::DataStream;
pub use geometry::Geometry;
pub use stream::{Config, Order, Stream, StreamLaws};
pub use trace::Entry;
