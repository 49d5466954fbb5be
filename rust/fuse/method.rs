//! The methods of fusion: their names, and what each makes of realizations.

use super::{Dense, Sequential, slse, slse_dense, uniform_dense, uniform_path};
use crate::error::{Error, Result};
use crate::parallel::Stop;
use crate::sample::Singletons;

/// Fusion of realizations into an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fusion {
    /// Their average.
    Uniform,
    /// Accumulated least squares: [`super::alse()`] and [`super::closed_form()`].
    Alse,
    /// Sequential least squares.
    Slse {
        /// Whether every step is followed by one towards the running average.
        safeguard: bool,
    },
}

/// Realizations of either kind.
#[derive(Debug, Clone, Copy)]
pub enum Samples<'a> {
    /// Each with one nonzero entry in a line.
    Drawn(&'a Singletons),
    /// Without structure.
    Dense(&'a Dense<'a>),
}

impl Fusion {
    /// All methods by their names.
    pub const NAMED: [(&'static str, Self); 4] = [
        ("uniform", Self::Uniform),
        ("alse", Self::Alse),
        ("slse", Self::Slse { safeguard: false }),
        ("slse-safeguarded", Self::Slse { safeguard: true }),
    ];

    /// Fuses the first `k` realizations for each `k` in the increasing `sizes`, and keeps what is made of the last
    /// ones.
    ///
    /// # Errors
    /// [`Error::Value`] for [`Self::Alse`], which has settings; [`Error::Interrupted`] after a stop, [`Error::Memory`].
    pub fn fuse(
        self,
        samples: Samples<'_>,
        target: &[f64],
        sizes: &[usize],
        keep_estimates: bool,
        stop: &Stop,
    ) -> Result<Sequential> {
        let last = sizes.last().copied().unwrap_or(0);
        match (self, samples) {
            (Self::Uniform, Samples::Drawn(draws)) => uniform_path(draws, target, sizes, keep_estimates, stop),
            (Self::Uniform, Samples::Dense(dense)) => uniform_dense(dense, target, sizes, keep_estimates, stop),
            (Self::Slse { safeguard }, Samples::Drawn(draws)) => {
                slse(&draws.prefix(last), target, safeguard, sizes, keep_estimates, stop)
            }
            (Self::Slse { safeguard }, Samples::Dense(dense)) => {
                slse_dense(&dense.prefix(last), target, safeguard, sizes, keep_estimates, stop)
            }
            (Self::Alse, _) => {
                Err(Error::Value { name: "method", expected: "one without a solver", found: "'alse'".into() })
            }
        }
    }
}
