//! One door for all work: the interpreter is released, Ctrl-C is seen, a panic becomes an exception.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

use super::error::from_panic;
use crate::{Result, Stop};

/// Elementary operations (about a nanosecond each) below which a call simply runs: looking for signals would cost more.
const SHORT: f64 = 1e7;

/// How often a long call looks for signals.
const POLL: Duration = Duration::from_millis(50);

/// Runs `work` without the interpreter lock; `cost` is its rough number of elementary operations.
///
/// Every loop of the core checks for a stop at least every few milliseconds; in long work these checks ask Python for
/// signals as well, now and then. After Ctrl-C the work ends.
pub(super) fn run<T, F>(py: Python<'_>, cost: f64, work: F) -> PyResult<T>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    if cost < SHORT {
        return py.detach(|| guarded(&Stop::new(), work));
    }
    let (result, signal) = watched(py, work)?;
    signal.map_or(result, Err)
}

/// [`run`] for long work that answers a stop with the best it has: after Ctrl-C that is returned, beside the exception.
/// Whatever else a signal handler raises ends the call as in [`run`], and so does Python after a second Ctrl-C.
pub(super) fn run_to_best<T, F>(py: Python<'_>, work: F) -> PyResult<(T, Option<PyErr>)>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    let (result, signal) = watched(py, work)?;
    match signal {
        Some(signal) if !signal.is_instance_of::<PyKeyboardInterrupt>(py) => Err(signal),
        signal => result.map(|best| (best, signal)),
    }
}

fn guarded<T>(stop: &Stop, work: impl FnOnce(&Stop) -> Result<T>) -> PyResult<T> {
    match catch_unwind(AssertUnwindSafe(|| work(stop))) {
        Ok(result) => result.map_err(PyErr::from),
        Err(payload) => Err(from_panic(&*payload)),
    }
}

/// The result of `work`, and the exception of a signal handler that asked it to stop.
///
/// The work stays on this thread: on another one it has been seen to take twice as long.
fn watched<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&Stop) -> Result<T> + Send,
) -> PyResult<(PyResult<T>, Option<PyErr>)> {
    if !on_main_thread(py)? {
        return Ok((py.detach(|| guarded(&Stop::new(), work)), None)); // no other thread is told of signals
    }
    let raised = Arc::new(Mutex::new(None));
    let to = Arc::clone(&raised);
    let stop = Stop::watching(POLL, move || {
        let signal = Python::attach(|py| py.check_signals()).err();
        let stop = signal.is_some();
        if let Ok(mut to) = to.lock() {
            *to = signal;
        }
        stop
    });
    let result = py.detach(|| guarded(&stop, work));
    let signal = raised.lock().map_or(None, |mut raised| raised.take());
    Ok((result, signal))
}

/// Whether Python calls its signal handlers on this thread.
fn on_main_thread(py: Python<'_>) -> PyResult<bool> {
    let threading = py.import("threading")?;
    let here: u64 = threading.call_method0("get_ident")?.extract()?;
    let main: Option<u64> = threading.call_method0("main_thread")?.getattr("ident")?.extract()?;
    Ok(main == Some(here))
}
