//! Models from readings of a part of the states: `y(t+1) = Theta z_t + w(t+1)`, z_t a window of what was read and put in.
//!
//! ```text
//! lags      z = (y_t .. y_{t-p+1}, u_{t-D} .. u_{t-D-p+1}, [1])
//! filters   z = (xi^1 .. xi^r of y, xi^1 .. xi^r of u_{.-D}, [1]),
//!           xi^1_t = a xi^1_{t-1} + (1 - a) s_t,  xi^j_t = a xi^j_{t-1} + (1 - a) xi^{j-1}_{t-1},  all xi_0 = s_0
//! ```
//!
//! `a = 0` is r lags; for `a > 0` the span is that of r Laguerre functions. The same in plain NumPy is in
//! `tests/python/twin/windows.py`.

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
