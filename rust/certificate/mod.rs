//! How far the true system may be from where a model says that a control leads, in the event that it is in a region.
//!
//! ```
//! use std::sync::Arc;
//! use stochens::{Stop, certificate, region::{Part, PartOf, Region}};
//! // x(k+1) = a x(k) + b u(k) around a = 1/2, b = 1, from V = diag(4, 16)
//! let (white, root) = ((&[[0.5, 0.0], [0.0, 0.25]]).into(), (&[[2.0, 0.0], [0.0, 4.0]]).into());
//! let (missing, shape) = (None, (&[[1.0]]).into());
//! let part = PartOf { rows: &[0], columns: &[0, 1], white, root, missing, ratio: 1.0, shape, factor: 0.04 };
//! let region = Region::new(&[[0.5, 1.0]], 1, vec![Arc::new(Part::new(part)?)], None, false)?;
//! let errors = certificate::trajectory(&region, &[3.0], &[0.0, 0.0], 0.0, None, (false, &Stop::new()))?;
//! assert_eq!(errors.states, [3.0, 1.5, 0.75]);
//! assert!((errors.radii[1] - 0.3).abs() < 1e-14); // sqrt(.04) ||(3, 0)||, in the norm of V^-1
//! # Ok::<(), stochens::Error>(())
//! ```

mod carried;
mod drawn_misses;
mod near;
mod near_followed;
mod next_runs;
mod noise;
mod nuclear;
mod outputs;
mod pilot;
mod plan;
mod powers;
mod reference;
mod second;
mod several_steps;
mod spend;
mod trajectory;
mod weighted;

pub use drawn_misses::{PlannedRun, drawn_misses};
pub use near::Near;
pub use near_followed::{Course, NearRows};
pub use next_runs::{DesignedRuns, Goal, NextRuns, next_runs};
pub use noise::{Gaussian, ToCome};
pub use outputs::{Along, OutputTube, Outputs, outputs};
pub use pilot::{Event, LaterPairs, MainRuns, Pilot, Simulation};
pub use plan::{ControlError, Endpoints, Plan, Way, certify};
pub use reference::{Reference, Shares};
pub use trajectory::{Errors, followed, states, trajectory};

#[cfg(test)]
mod tests;
