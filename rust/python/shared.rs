//! An object that changes, used by one thread at a time.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::time::Duration;

use pyo3::prelude::*;

use super::error::InputError;
use super::run::run;
use crate::parallel::here;
use crate::{Error, Result, Stop};

/// Longest pause between two checks of a thread that waits for its turn.
const PAUSE: Duration = Duration::from_millis(5);

/// The turn is kept in atomics, because a forked child can always read them; a lock that another thread of the parent
/// held at the fork would stay locked in the child for ever.
pub(super) struct Shared<S> {
    /// What messages call it.
    name: &'static str,
    inner: Mutex<S>,
    /// The thread whose turn it is, 0 for none; only this thread locks `inner`, and so never waits for it.
    turn: AtomicUsize,
    /// The process of that thread; written before the turn is taken.
    process: AtomicU32,
}

impl<S: Send> Shared<S> {
    pub(super) const fn new(name: &'static str, inner: S) -> Self {
        Self { name, inner: Mutex::new(inner), turn: AtomicUsize::new(0), process: AtomicU32::new(0) }
    }

    /// Waits for the turn of this thread and runs `work`, of rough cost `cost`, without the interpreter lock.
    ///
    /// Signal handlers may run on this thread during `work`. If one uses the same object, it would wait for itself, so
    /// it gets an error; so does a child that was forked during a call of another thread, whose turn never ends there.
    pub(super) fn with<T: Send>(
        &self,
        py: Python<'_>,
        cost: f64,
        work: impl FnOnce(&mut S, &Stop) -> Result<T> + Send,
    ) -> PyResult<T> {
        let turn = self.turn.load(Ordering::Acquire);
        if turn != 0 && self.process.load(Ordering::Acquire) != std::process::id() {
            return Err(InputError::new_err(format!(
                "`{}` was in use by a thread when this process was forked: use it in the parent process, or load a \
                 saved state here",
                self.name
            )));
        }
        if turn == here() {
            return Err(InputError::new_err(format!(
                "`{}` is in use on this thread: a signal handler cannot use it during a call",
                self.name
            )));
        }
        // waiting may be long, so it checks for signals
        let cost = if turn == 0 { cost } else { f64::INFINITY };
        run(py, cost, |stop| {
            let _turn = self.wait(stop)?;
            let unusable = |_| Error::Numerical(format!("an internal error has left this {} unusable", self.name));
            work(&mut *self.inner.lock().map_err(unusable)?, stop)
        })
    }

    fn wait(&self, stop: &Stop) -> Result<Turn<'_, S>> {
        self.process.store(std::process::id(), Ordering::Release);
        let mut pause = Duration::from_micros(20);
        while self.turn.compare_exchange(0, here(), Ordering::AcqRel, Ordering::Acquire).is_err() {
            if stop.requested_after_a_wait() {
                return Err(Error::Interrupted);
            }
            std::thread::sleep(pause);
            pause = PAUSE.min(2 * pause);
        }
        Ok(Turn(self))
    }
}

/// The turn ends when this is dropped.
struct Turn<'a, S: Send>(&'a Shared<S>);

impl<S: Send> Drop for Turn<'_, S> {
    fn drop(&mut self) {
        self.0.turn.store(0, Ordering::Release);
    }
}
