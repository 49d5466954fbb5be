//! Loops `u = K x` that are proved for every system of a [`crate::region::Region`], and gains for them.
//!
//! With `Theta = C + D G W`, `||G|| <= rho`, the loop is `A_G = A0 + D G E`, `A0 = C [I; K]`, `E = W [I; K]`. All of
//! them are stable with one Lyapunov function exactly if `rho ||E (z I - A0)^-1 D||_inf < 1` (bounded-real lemma;
//! matrix S-lemma of van Waarde, Camlibel and Mesbahi 2022), and the proof is one matrix `Q > 0`:
//!
//! ```text
//! [Q - rho^2 S, 0; 0, I] - F Q F' > 0,    F = [A0; E],
//! ```
//!
//! which `verify` checks with all of its rounding counted.
//!
//! ```
//! use std::sync::Arc;
//! use stochens::{Stop, feedback::{Loop, Verdict}, region::{Part, PartOf, Region}};
//! // x(k+1) = 1.2 x(k) + u(k), both coefficients within a circle of radius .3
//! let (eye, missing, shape) = ((&[[1.0, 0.0], [0.0, 1.0]]).into(), None, (&[[1.0]]).into());
//! let part = PartOf { rows: &[0], columns: &[0, 1], white: eye, root: eye, missing, ratio: 1.0, shape, factor: 0.09 };
//! let region = Region::new(&[[1.2, 1.0]], 1, vec![Arc::new(Part::new(part)?)], None, false)?;
//! let found = Loop::new(&region, &[[-0.9]], &Stop::new())?;
//! assert_eq!(found.certificate().status, Verdict::Certified);
//! assert!((found.certificate().norm - 0.5766).abs() < 1e-3); // .3 sqrt(1 + .9^2) / (1 - .3)
//! # Ok::<(), stochens::Error>(())
//! ```

mod along;
mod attraction;
mod blocks;
mod certificate;
mod data;
mod doubling;
mod errors;
mod first_order;
mod gains;
mod keeping;
mod late;
mod lemma;
mod loops;
mod margins;
mod member;
mod norm;
mod preview;
mod rest;
mod riccati;
mod rounding;
mod saturation;
mod saved;
mod scalings;
mod spectrum;
mod tube;
mod unmoved;
mod verify;
mod way;

pub use certificate::{Certificate, Verdict};
pub use data::Misfit;
pub use gains::{Gain, eigenvalues, guaranteed, least_squares, widest};
pub use keeping::{Judged, Keeper, Short};
pub use late::Recorder;
pub use loops::Loop;
pub use margins::{Margin, Margins};
pub use preview::Preview;
pub use rounding::Filters;
pub use tube::{Run, Tube};
pub use unmoved::unmoved;

#[cfg(test)]
mod tests;
