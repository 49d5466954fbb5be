//! Controls from realizations: `u = B^+ (xf - A x0)`, one per realization or fused.
//!
//! *Product* fusion averages every entity first, `u = B^+ (xf_hat - A_hat x0_hat)`; *diagonal* fusion averages the
//! per-realization controls. They are different estimators with the same mean; product fusion is never worse.

mod batch;
mod best;
mod dense_rows;
mod exact;
mod pairs;
mod products;
mod pseudoinverse;
mod realizations;
mod singleton_rows;
mod steps;

pub use batch::Memory;
pub use best::{Best, Factors, best_control};
pub use exact::{Beside, ExactControl, Factored, Reach};
pub use pairs::Motion;
pub(crate) use products::{times, transposed};
pub use pseudoinverse::{Pseudoinverse, pseudoinverse};
pub(crate) use pseudoinverse::{Singular, singular, singular_values, symmetric_norm};
pub use realizations::{Entity, Realized};
pub(crate) use steps::steps_control;
