//! One door for all work: the interpreter is released, Ctrl-C is seen, a panic becomes an exception.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

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
    let guarded = || match catch_unwind(AssertUnwindSafe(|| work(&stop))) {
        Ok(result) => result.map_err(PyErr::from),
        Err(payload) => Err(from_panic(&*payload)),
    };
    if cost < SHORT {
        return py.detach(guarded);
    }
    py.detach(|| {
        let slot = Mutex::new(Some(guarded));
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
                            return Err(signal);
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
