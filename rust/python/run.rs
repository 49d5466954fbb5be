//! All calls of the core: the interpreter lock is released, Ctrl-C is handled, a panic becomes an exception.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

use super::error::from_panic;
use crate::parallel::detached;
use crate::{Error, Result, Stop};

/// Elementary operations (about a nanosecond each, so 10 ms) up to which a call does not check for signals.
const SHORT: f64 = 1e7;

/// Elementary operations (0.1 s) from which work that cannot be stopped runs on its own thread.
const LONG: f64 = 1e8;

/// The cost of work that runs until it is done or stopped.
pub(super) const UNTIL_STOPPED: f64 = 1e9;

/// How often a long call looks for signals.
const POLL: Duration = Duration::from_millis(50);

/// Runs `work` without the interpreter lock; `cost` is its rough number of elementary operations.
///
/// The loops of the core check for a stop every few milliseconds; in long work, these checks also ask Python for
/// signals every [`POLL`]. After Ctrl-C the work ends.
pub(super) fn run<T, F>(py: Python<'_>, cost: f64, work: F) -> PyResult<T>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    let mut kept = Kept::Work(work);
    let done = run_kept(py, cost, &mut |stop| kept.finish(stop));
    done.and_then(|()| kept.result())
}

fn run_kept(py: Python<'_>, cost: f64, work: Work<'_>) -> PyResult<()> {
    if cost < SHORT {
        return py.detach(|| guarded(&Stop::new(), work));
    }
    let (result, signals) = watched(py, work);
    signals.into_iter().next().map_or(result, Err)
}

/// Work of any type, which keeps its result: what surrounds it is then compiled once, not for each of a hundred types.
type Work<'a> = &'a mut (dyn FnMut(&Stop) -> Result<()> + Send);

enum Kept<F, T> {
    Work(F),
    Result(T),
    Neither,
}

impl<T, F: FnOnce(&Stop) -> Result<T>> Kept<F, T> {
    fn finish(&mut self, stop: &Stop) -> Result<()> {
        if let Self::Work(work) = std::mem::replace(self, Self::Neither) {
            *self = Self::Result(work(stop)?);
        }
        Ok(())
    }

    fn result(self) -> PyResult<T> {
        match self {
            Self::Result(result) => Ok(result),
            _ => Err(Error::Numerical("a call ended without a result".into()).into()),
        }
    }
}

/// [`run`] for work that cannot be stopped: if it is long, it runs on a thread that Ctrl-C leaves behind.
pub(super) fn run_unstoppable<T: Send + 'static>(
    py: Python<'_>,
    cost: f64,
    work: impl FnOnce() -> Result<T> + Send + 'static,
) -> PyResult<T> {
    run(py, cost, |stop| if cost < LONG { work() } else { detached("stochens-work", stop, work) })
}

/// [`run`] for long work that returns its best result after a stop: Ctrl-C gives this result and the exception. A
/// second Ctrl-C, or another exception from a signal handler, ends the call as in [`run`].
pub(super) fn run_to_best<T, F>(py: Python<'_>, work: F) -> PyResult<(T, Option<PyErr>)>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    let mut kept = Kept::Work(work);
    let (result, mut signals) = watched(py, &mut |stop| kept.finish(stop));
    let last = signals.pop();
    match last {
        Some(signal) if !signals.is_empty() || !signal.is_instance_of::<PyKeyboardInterrupt>(py) => Err(signal),
        last => result.and_then(|()| Ok((kept.result()?, last))),
    }
}

fn guarded(stop: &Stop, work: Work<'_>) -> PyResult<()> {
    match catch_unwind(AssertUnwindSafe(|| work(stop))) {
        Ok(result) => result.map_err(PyErr::from),
        Err(payload) => Err(from_panic(&*payload)),
    }
}

/// The result of `work`, and the exceptions of signal handlers meanwhile; the first of these requests the stop.
///
/// The work stays on this thread: on another, it took up to twice as long. Each look for signals takes the interpreter
/// lock, which other threads may hold for some milliseconds. It finds signals on Python's main thread only.
fn watched(py: Python<'_>, work: Work<'_>) -> (PyResult<()>, Vec<PyErr>) {
    let raised = Arc::new(Mutex::new(Vec::new()));
    let to = Arc::clone(&raised);
    let stop = Stop::watching(POLL, move || {
        let signal = Python::attach(|py| py.check_signals()).err();
        let stop = signal.is_some();
        to.lock().unwrap_or_else(PoisonError::into_inner).extend(signal);
        stop
    });
    let result = py.detach(|| guarded(&stop, work));
    let signals = std::mem::take(&mut *raised.lock().unwrap_or_else(PoisonError::into_inner));
    (result, signals)
}
