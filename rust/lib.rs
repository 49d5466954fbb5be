//! Control of a linear system that you know only in part.
//!
//! The system is `x(k+1) = A x(k) + B u(k)`; `x0`, `xf` and `A` are known through realizations whose average approaches
//! them. This crate
//!
//! 1. **samples** realizations ([`sample()`]): one index per vector or per column, `E = g sign(w_I) e_I` with
//!    `P(I = i) = |w_i| / g`, `g = ||w||_1`;
//! 2. **fuses** them with weights on the simplex ([`fuse`]): uniform, accumulated least squares (ALSE),
//!    `min_w ||sum_i w_i E_i - E*||^2`, and sequential least squares (SLSE);
//! 3. **computes controls** ([`control`]) `u = B^+ (xf - A x0)`, one per realization or fused;
//! 4. **simulates** ([`simulate`]) what a control does, exactly and with fresh realizations at every step;
//! 5. does 1-3 as a **stream** ([`streaming`]), with a certificate as stopping rule, whose state is saved in files
//!    ([`storage`]).
//! 6. **identifies** `A` and `B` from measured pairs ([`identify`]): least squares, and the laws of its error;
//! 7. makes a **region** of models from data, says what it contains ([`region`]), and where a control leads the true
//!    system ([`certificate`]);
//! 8. computes **controls within limits** ([`limits`]), with a certificate, in loops anew at every state
//!    ([`limits::horizon::RecedingHorizon`]), and **gains** that are proved for a region ([`feedback`]);
//! 9. makes models of **windows** of readings and inputs where states are not measured ([`window`]);
//! 10. finds one **command for a fleet** of units ([`fleet`]), and bounds what a fresh unit risks;
//! 11. **bounds** the errors of averages of realizations by formulas ([`tails`]);
//! 12. **reads** tables of measured runs from CSV files ([`table`]);
//! 13. **watches** a loop in use: an alarm that is false no more often than promised ([`watch`]).
//!
//! The modules are listed in the order of the data, `stream -> sample -> fuse -> control -> simulate`, and use only
//! earlier ones. Arrays of a law are stored line by line (see [`Law`]). The feature `python` adds the extension module.
//!
//! ```
//! use stochens::{Key, Law, Scheme, Stop, fuse, sample};
//! let w = vec![3.0, -1.0, 0.5, 0.0, 2.0];
//! let draws = sample(&Law::new(w.clone(), 1, 5)?.into(), 500, Scheme::Iid, &Key([1; 32]), 1, &Stop::new())?;
//! let alse = fuse::closed_form(&draws, &w, fuse::Weights::Simplex, &Stop::new())?;
//! assert!(alse.objective < 1e-20); // every nonzero component has been seen: the fit is exact
//! # Ok::<(), stochens::Error>(())
//! ```
//!
//! From measured pairs to a plan with a certificate:
//!
//! ```
//! use stochens::identify::{Assumed, Covariance, Design, Estimate, Noise, Magnitudes, Wish};
//! use stochens::{Stop, certificate, region::Region};
//! // 40 pairs of y = x / 2 + u + w, |w| <= .01
//! let at = |of: fn(f64) -> f64| -> [[f64; 1]; 40] { std::array::from_fn(|k| [of(k as f64)]) };
//! let (x, u) = (at(f64::cos), at(|k| (1.7 * k).sin()));
//! let y = at(|k| k.cos() / 2.0 + (1.7 * k).sin() + 0.01 * (2.9 * k).sin());
//! let stop = Stop::new();
//! let estimate = Estimate::from_pairs(&x, &u, &y, 1, &stop)?;
//! let covariance = Covariance::Known(&[1e-4]);
//! let assumed = Assumed { design: Design::Adaptive, noise: Noise::SubGaussian, covariance, tail: 0.0 };
//! let region = Region::from_data(&estimate, assumed, Wish::new(0.05), Magnitudes::Expected(&[1.0, 1.0]), 1, &stop)?;
//! assert!(region.contains(&[[0.5, 1.0]])? && !region.contains(&[[0.6, 1.0]])?);
//! // the control by the model from x0 = 1 to xf = 2, and how far the true system ends from there
//! let ([x0, xf], [a, b]) = ([1.0, 2.0], [estimate.model[0], estimate.model[1]]);
//! let u = (xf - a * x0) / b;
//! let task = certificate::Endpoints { x0: &[x0], rho0: 0.0, xf: &[xf], predicted: &[x0, a * x0 + b * u] };
//! let way = certificate::Way { region: &region, inputs: &[u], to_come: None, compares: false };
//! let plan = certificate::certify(task, &[way], None, (false, &stop))?;
//! assert!((x0 / 2.0 + u - xf).abs() <= plan.target && plan.target < 0.03);
//! # Ok::<(), stochens::Error>(())
//! ```
//!
//! The best inputs within limits, again at every state: [`limits::horizon::RecedingHorizon`], a loop at 1 kHz. A gain
//! that is proved for every system of a region, and what it survives: [`feedback::Loop`], [`feedback::Loop::margins`].
//! A loop from readings that may be lost or false, under loads that no one measures: [the example of `window`](window).
//! Estimates, regions and loops are files with [`storage::Saved`]; matrices are a [`MatrixView`], such as
//! `&[[1.0, 0.1], [0.0, 1.0]]`.
//! Three programs are in `examples/`: `certified_gain`, `kilohertz_loop` and `fleet`.

#![deny(missing_docs, unsafe_code)]
#![warn(missing_debug_implementations)]
#![cfg_attr(test, allow(clippy::disallowed_methods, clippy::disallowed_macros))]

pub mod certificate;
mod compensated;
pub mod control;
mod error;
mod fault;
pub mod feedback;
pub mod fleet;
pub mod fuse;
pub mod identify;
pub mod limits;
mod matrix;
mod memory;
mod named;
mod nontemporal;
mod parallel;
mod pod;
#[cfg(feature = "python")]
#[allow(missing_docs, reason = "the Python side is documented in the package")]
mod python;
pub mod region;
pub mod sample;
mod scaled;
mod simd;
pub mod simulate;
pub mod storage;
mod stream;
pub mod streaming;
pub mod table;
pub mod tails;
mod vector;
pub mod watch;
pub mod window;

pub use error::{Error, Obstacle, Result};
pub use matrix::MatrixView;
pub use parallel::Stop;
pub use sample::{Law, Scheme, Singletons, sample};
pub use simd::LANES;
pub use stream::{CHUNK, Key, Purpose};

#[cfg(doctest)]
#[doc = include_str!("README.md")]
struct Readme;
