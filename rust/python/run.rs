//! One door for all work: the interpreter is released, Ctrl-C is seen, a panic becomes an exception.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

use super::error::from_panic;
use crate::parallel::take;
use crate::{Result, Stop};

/// Elementary operations (about a nanosecond each) below which a call simply runs: a thread would cost more.
const SHORT: f64 = 1e7;

/// How often a long call looks for signals.
const POLL: Duration = Duration::from_millis(50);

/// Runs `work` without the interpreter lock; `cost` is its rough number of elementary operations.
///
/// Long work runs on a thread of its own while this one waits and asks Python for signals, which only the main thread can
/// see. After Ctrl-C the work is told to stop and joined: every loop of the core checks at least every few milliseconds.
pub(super) fn run<T, F>(py: Python<'_>, cost: f64, work: F) -> PyResult<T>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    let stop = Stop::new();
    if cost < SHORT {
        return py.detach(guarded(&stop, work));
    }
    attended(py, &stop, guarded(&stop, work), Err)
}

/// [`run`] for long work that answers a stop with the best it has: after Ctrl-C that is returned, beside the exception. A
/// second Ctrl-C, and whatever else a signal handler raises, ends the call as in [`run`].
pub(super) fn run_to_best<T, F>(py: Python<'_>, work: F) -> PyResult<(T, Option<PyErr>)>
where
    T: Send,
    F: FnOnce(&Stop) -> Result<T> + Send,
{
    let stop = Stop::new();
    let mut kept = None;
    let result = attended(py, &stop, guarded(&stop, work), |signal| {
        let first = kept.is_none();
        if !first || !Python::attach(|py| signal.is_instance_of::<PyKeyboardInterrupt>(py)) {
            return Err(signal);
        }
        kept = Some(signal);
        Ok(())
    })?;
    Ok((result, kept))
}

fn guarded<'a, T, F>(stop: &'a Stop, work: F) -> impl FnOnce() -> PyResult<T> + use<'a, T, F>
where
    F: FnOnce(&Stop) -> Result<T>,
{
    move || match catch_unwind(AssertUnwindSafe(|| work(stop))) {
        Ok(result) => result.map_err(PyErr::from),
        Err(payload) => Err(from_panic(&*payload)),
    }
}

/// Runs `work` on a thread and looks for signals; one of them raises `stop`, and `after` says whether to wait for the
/// result all the same.
fn attended<T: Send>(
    py: Python<'_>,
    stop: &Stop,
    work: impl FnOnce() -> PyResult<T> + Send,
    mut after: impl FnMut(PyErr) -> PyResult<()> + Send,
) -> PyResult<T> {
    py.detach(|| {
        let slot = Mutex::new(Some(work));
        let (send, receive) = channel();
        std::thread::scope(|scope| {
            let slot = &slot;
            let theirs = move || take(slot).map(|work| send.send(work()));
            if std::thread::Builder::new().spawn_scoped(scope, theirs).is_err() {
                // no thread to be had: do it here, and be deaf to signals for as long as it takes
                return take(slot).map_or_else(|| Err(from_panic(&"the work vanished")), |work| work());
            }
            loop {
                match receive.recv_timeout(POLL) {
                    Ok(result) => return result,
                    Err(RecvTimeoutError::Timeout) => {
                        if let Err(signal) = Python::attach(|py| py.check_signals()) {
                            stop.request();
                            after(signal)?;
                        }
                    }
                    Err(RecvTimeoutError::Disconnected) => {
                        return Err(from_panic(&"the worker thread vanished"));
                    }
                }
            }
        })
    })
}
