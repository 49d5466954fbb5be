//! Every error of the core as an exception of the package.

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::{PyErr, import_exception};

use crate::Error;

import_exception!(stochens_rs.exceptions, InputError);
import_exception!(stochens_rs.exceptions, InternalError);
import_exception!(stochens_rs.exceptions, NonFiniteError);
import_exception!(stochens_rs.exceptions, ResourceError);
import_exception!(stochens_rs.exceptions, ShapeError);
import_exception!(stochens_rs.exceptions, SolverError);

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        let message = error.to_string();
        match error {
            Error::Shape { .. } => ShapeError::new_err(message),
            Error::NonFinite { .. } | Error::Overflow { .. } => NonFiniteError::new_err(message),
            Error::Value { .. } => InputError::new_err(message),
            Error::Memory { bytes, .. } => ResourceError::new_err((message, bytes)),
            Error::Numerical(_) => SolverError::new_err(message),
            Error::Interrupted => PyKeyboardInterrupt::new_err(()),
        }
    }
}

/// A panic's message as an [`InternalError`]: users of `except Exception` must not miss it.
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
