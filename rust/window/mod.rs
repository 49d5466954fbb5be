//! Models from readings of a part of the states: `y(t+1) = Theta z_t + w(t+1)`, z_t a window of what was read and put
//! in.
//!
//! ```text
//! lags      z = (y_t .. y_{t-p+1}, u_{t-D} .. u_{t-D-p+1}, [1])
//! filters   z = (xi^1 .. xi^r of y, xi^1 .. xi^r of u_{.-D}, [1]),
//!           xi^1_t = a xi^1_{t-1} + (1 - a) s_t,  xi^j_t = a xi^j_{t-1} + (1 - a) xi^{j-1}_{t-1},  all xi_0 = s_0
//! ```
//!
//! `a = 0` is r lags; for `a > 0` the span is that of r Laguerre functions. The same in plain NumPy is in
//! `tests/python/twin/windows.py`.
//!
//! # A loop from readings
//!
//! ```
//! use stochens::limits::horizon::{Horizon, RecedingHorizon, Task};
//! use stochens::limits::{SetPointTask, SetPoints, Until};
//! use stochens::region::{Aim, Bias, Readings};
//! use stochens::window::{Filter, Kind, Window};
//! use stochens::{MatrixView, Stop};
//! // the model y(t+1) = .9 y(t) + .5 u(t), noise of .01, |u| <= 1: the state of its window is y(t)
//! let (theta, noise, stop) = ([[0.9, 0.5]], [[1e-4]], Stop::new());
//! let window = Window::new(1, 1, Kind::Lags(1), 0, false, 0)?;
//! // where y rests at 1, and how that moves with a constant load e: (y, u) = place + of_bias e
//! let points = SetPoints::new(window, &theta, &[1.0, 1.0])?;
//! let (low, high, weights) = ([-1.0], [1.0], (&[[1.0]]).into());
//! let wish = SetPointTask { target: &[1.0], weights, now: &[0.0], low: &low, high: &high, given: &[f64::NAN] };
//! let rest = points.at(&wish)?;
//! // which readings are true, and the load: it may move by as much as .1 of the input in a step
//! let bias = Bias::learned(MatrixView::new(&points.of_inputs()?, 1, 1)?, &[0.1], &noise)?;
//! let aim = Aim { of_bias: vec![rest.of_bias[1]], limits: [vec![rest.place[1]], low.into(), high.into()] };
//! let filter = Filter::new(window, &theta, &noise, &[0.0], &[1.0, 1.0])?;
//! let mut readings = Readings::new(filter, &theta, None, bias, aim, 3)?;
//! // plans of 10 steps to the point of rest
//! let model = window.linear(&theta)?.matrix;
//! let [a, b] = [0, 1].map(|j| MatrixView::new(&model, 1, 2).and_then(|whole| whole.columns(j..j + 1)));
//! let (low, high, reference) = ((&[[-1.0]; 10]).into(), (&[[1.0]; 10]).into(), (&[[0.0]; 10]).into());
//! let (stage, terminal, r) = ((&[[1.0]]).into(), (&[[10.0]]).into(), Some((&[[0.1]]).into()));
//! let task = Task { low, high, stage, terminal, reference, r, ..Task::default() };
//! let mut plans = RecedingHorizon::new(Horizon::new(a?, b?, None, task)?, &stop)?;
//!
//! let (mut y, mut u, mut load, mut runs) = (0.0, 0.0, vec![0.0], false);
//! for t in 0..60 {
//!     let step = readings.step(&[y], &[t != 20], &[u], &load, runs)?; // the reading at t = 20 is lost
//!     load.copy_from_slice(&step.bias);
//!     runs = step.runs;
//!     if let (true, Some(now)) = (runs, readings.window()) {
//!         let [ys, us] = [0, 1].map(|i| rest.place[i] + rest.of_bias[i] * load[0]);
//!         plans.about(&[us], &[ys])?;
//!         u = us + plans.solve(&[now.x[0] - ys], Until::new(&stop, None))?.control[0];
//!     }
//!     y = 0.9 * y + 0.5 * u + 0.1; // the plant, under a load that the model does not have
//! }
//! assert!((load[0] - 0.1).abs() < 1e-6 && (y - 1.0).abs() < 1e-6);
//! # Ok::<(), stochens::Error>(())
//! ```
//!
//! A [`crate::region::Gate`] in place of `None` holds false readings back.

mod burn;
mod far_cells;
mod filter;
mod identified;
mod linear;
mod log_tests;
mod order;
mod past;
mod rest;
mod rivals;
mod shape;
mod workspace;

pub use filter::{Contents, Filter};
pub use identified::{Identified, Simulated};
pub use linear::Linear;
pub use log_tests::{Declarations, Log, declared_tests};
pub use order::Past;
pub use rest::Rest;
pub use shape::{Kind, Window};
pub(crate) use workspace::Workspace;
