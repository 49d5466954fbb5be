//! Every error of the core as an exception of the package.

use std::io::ErrorKind;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::{PyErr, import_exception};

use crate::Error;

import_exception!(stochens_rs.exceptions, InputError);
import_exception!(stochens_rs.exceptions, InputTypeError);
import_exception!(stochens_rs.exceptions, InternalError);
import_exception!(stochens_rs.exceptions, NonFiniteError);
import_exception!(stochens_rs.exceptions, ResourceError);
import_exception!(stochens_rs.exceptions, ShapeError);
import_exception!(stochens_rs.exceptions, SolverError);
import_exception!(stochens_rs.exceptions, StateError);
import_exception!(stochens_rs.exceptions, StateIOError);
import_exception!(stochens_rs.exceptions, StateLockedError);
import_exception!(stochens_rs.exceptions, StateNotFoundError);

/// Errno for an `OSError` of which the system gave no number: "invalid argument" on every platform.
const EINVAL: i32 = 22;

/// Errno of `BlockingIOError`, "try again".
const EAGAIN: i32 = if cfg!(any(target_os = "linux", target_os = "android", windows)) { 11 } else { 35 };

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        let message = error.to_string();
        match error {
            Error::Shape { .. } => ShapeError::new_err(message),
            Error::NonFinite { .. } | Error::Overflow { .. } => NonFiniteError::new_err(message),
            Error::Value { .. } | Error::File { .. } => InputError::new_err(message),
            Error::Memory { bytes, .. } => ResourceError::new_err((message, bytes)),
            Error::Numerical(_) | Error::NoGain(_) => SolverError::new_err(message),
            Error::State { .. } => StateError::new_err(message),
            Error::Locked { path } => {
                StateLockedError::new_err((EAGAIN, "another writer has locked this state", path.into_os_string()))
            }
            Error::Os { action, path, code, reason } => {
                // On Windows `code` is a Windows error, the fourth argument there and ignored elsewhere.
                let errno = code.unwrap_or(EINVAL);
                let arguments = (errno, format!("cannot {action}: {reason}"), path.into_os_string(), errno);
                match code.map(|code| std::io::Error::from_raw_os_error(code).kind()) {
                    Some(ErrorKind::NotFound) => StateNotFoundError::new_err(arguments),
                    _ => StateIOError::new_err(arguments),
                }
            }
            Error::Interrupted => PyKeyboardInterrupt::new_err(()),
        }
    }
}

/// A panic as an [`InternalError`], a subclass of `Exception`, so that `except Exception` catches it.
pub(super) fn from_panic(payload: &(dyn std::any::Any + Send)) -> PyErr {
    let text = payload
        .downcast_ref::<&str>()
        .map(ToString::to_string)
        .or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".into());
    InternalError::new_err(format!(
        "internal error in stochens {} (please report it): {text}",
        env!("CARGO_PKG_VERSION")
    ))
}
