//! One error type for invalid input and for what stops a computation.
//!
//! How a computation *ended* (optimal, inaccurate, ...) is not an error: it is a status on the result.

use std::fmt;
use std::path::PathBuf;

use crate::fault::Fault;

/// `std::result::Result` with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Why a call was refused or stopped; every message names the argument, the rule and what was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of each variant says what its fields are")]
pub enum Error {
    /// An array has the wrong shape, or two arrays do not fit together.
    #[error("`{name}` must have {expected}, got {found}")]
    Shape { name: &'static str, expected: String, found: String },

    /// An entry, or a quantity computed from the entries, is NaN or infinite.
    #[error(
        "`{name}` has a non-finite {what} at flat index {index}: entries must be finite and their 1-norms representable"
    )]
    NonFinite { name: &'static str, what: &'static str, index: usize },

    /// A result is too large for a double.
    #[error("{what} overflows: scale the problem down")]
    Overflow { what: &'static str },

    /// A scalar argument lies outside its range.
    #[error("`{name}` must be {expected}, got {found}")]
    Value { name: &'static str, expected: &'static str, found: String },

    /// The memory for a result cannot be allocated.
    #[error("{what} needs {bytes} bytes, which cannot be allocated")]
    Memory { what: &'static str, bytes: u128 },

    /// A factorization or a solver failed on valid input.
    #[error("{0}")]
    Numerical(String),

    /// There is no gain, or rounding decides whether there is one.
    #[error("{0}")]
    NoGain(Obstacle),

    /// A file is not the table that was to be read.
    #[error("{path} {fault}")]
    File { path: String, fault: String },

    /// A file is not a usable state file, nor is the previous generation, if that was tried.
    #[error("{path:?} {fault}{}", previous.as_ref().map_or_else(String::new, |why| format!("; and {why}")))]
    State { path: PathBuf, fault: Fault, previous: Option<String> },

    /// Another writer holds the lock of the state file.
    #[error("{path:?} is locked by another writer")]
    Locked { path: PathBuf },

    /// An operation on a file failed; `code` is the system's error number (errno), if any.
    #[error("cannot {action} {path:?}: {reason}")]
    Os { action: &'static str, path: PathBuf, code: Option<i32>, reason: String },

    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// Why there is no gain that stabilises at the least cost, or none was found.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the message of each variant says what its fields are")]
pub enum Obstacle {
    /// No input moves a mode of A that does not decay.
    Unreached { value: (f64, f64), states: Vec<usize> },
    /// A mode on the unit circle has no cost.
    Unseen { value: (f64, f64), states: Vec<usize> },
    /// No gain was found that stabilises; `reach` is that of the mode of A next to being out of reach.
    Unstabilised { reach: f64 },
    /// The gain that was found does not satisfy the equation.
    Rounding { residual: f64 },
}

impl Obstacle {
    /// The cause, with the names of the states.
    #[must_use]
    pub fn in_words(&self, name: impl Fn(usize) -> String) -> String {
        let mode = |(re, im): &(f64, f64), states: &[usize]| {
            let mut text = format!("with the eigenvalue {re:.9}");
            text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
            if *im != 0.0 {
                text += &format!(" +- {:.6}i", im.abs());
            }
            for (at, i) in states.iter().enumerate() {
                text += if at == 0 { ", largest in " } else { ", " };
                text += &name(*i);
            }
            text
        };
        let cause = match self {
            Self::Unreached { value, states } => {
                format!("the inputs do not move the mode of A {}, which does not decay", mode(value, states))
            }
            Self::Unseen { value, states } => {
                let mode = mode(value, states);
                format!("Q gives no weight to the mode {mode}, which then stays: weigh one of these states")
            }
            Self::Unstabilised { reach } => format!(
                "rounding decides whether the inputs stabilise the system; the mode that they move least is moved by {reach:.1e} \
                 of the size of A and B"
            ),
            Self::Rounding { residual } => {
                format!("rounding decides: the best one leaves {residual:.1e} of the cost in its equation")
            }
        };
        format!("no gain was found: {cause}")
    }
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.in_words(|i| format!("x[{i}]")))
    }
}

/// As many entries as `expected`.
pub(crate) fn sized(name: &'static str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::Shape { name, expected: format!("{expected} entries"), found: found.to_string() })
}

/// The index of the first NaN or infinity becomes an error that names `name`.
pub(crate) fn require_finite(name: &'static str, values: &[f64]) -> Result<()> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(Error::NonFinite { name, what: "entry", index }),
        None => Ok(()),
    }
}
