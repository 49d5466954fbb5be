//! A set of models `Theta = [A B c]` that contains the true one, and what it says of one step.
//!
//! ```text
//! (Theta - C) V (Theta - C)' <= factor S        for all rows at once, or row by row
//! ```
//!
//! with C the centre. What several steps add is in [`crate::certificate`].

mod entering;
mod from_data;
mod hull;
mod models;
mod part;
mod projection;
mod readings;
mod saved;

pub use entering::Entering;
pub use hull::{CoordinateNoise, Mixture, Place, between};
pub use models::Region;
pub use part::{Part, PartOf};
pub use projection::DIRECTIONS;
pub use readings::{Aim, Bias, Gate, Readings, Step};

pub(crate) use part::times;

#[cfg(test)]
pub(crate) mod tests;
