//! One error type for invalid input and for what stops a computation.
//!
//! How a computation *ended* (optimal, inaccurate, ...) is not an error: it is a status on the result.

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

/// The index of the first NaN or infinity becomes an error that names `name`.
pub(crate) fn require_finite(name: &'static str, values: &[f64]) -> Result<()> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(Error::NonFinite { name, what: "entry", index }),
        None => Ok(()),
    }
}
