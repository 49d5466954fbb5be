//! Trajectories for given inputs: exact, random runs, mean fields, runs of several systems, and a closed loop with
//! estimates.
//!
//! ```text
//! x(k+1) = A x(k) + B u(k),                  k = 0 .. K-1
//! runs:        x^s(k+1) = A_k^s x^s(k) + B_k^s u(k)     every run s and every step k draws its own A_k^s, B_k^s
//! mean field:  F(k+1)   = A^_k F(k) + B^_k u(k)         A^_k, B^_k: averages of `size` realizations, fresh at every step
//! ```
//!
//! No realization is used twice. The runs are independent, and a run's matrices are independent of its state, so that
//! both means are the exact trajectory (paper, Definition 2.1, with index maps that are injective in run and step). One
//! realization used at all times would give a biased mean.

mod block;
mod closed_loop;
mod drawn_bounds;
mod hold;
mod mean_field;
mod model;
mod moments;
mod plans;
mod runs;
mod systems;
mod validation;
mod words;

pub use closed_loop::{ClosedLoop, ReferenceRuns};
pub use drawn_bounds::{drawn_bounds, exceedances};
pub use hold::zero_order_hold;
pub use mean_field::mean_field;
pub use model::{Drawn, Model};
pub use moments::{Ensemble, Second};
pub use plans::{Average, Exact, PlanEntity, Plans, estimate_errors};
pub use runs::runs;
pub use systems::Systems;
pub use validation::{Predicted, Scores, mean_miss, noise_deviations, order_statistic, weighted_order_statistic};
