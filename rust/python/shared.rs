//! An object that changes, used by one thread at a time.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::ThreadId;

use pyo3::prelude::*;

use super::error::InputError;
use super::run::run;
use crate::parallel::WAIT;
use crate::{Error, Result, Stop};

pub(super) struct Shared<S> {
    inner: Mutex<S>,
    /// The thread whose turn it is; `inner` is locked in its turn only, and so without waiting.
    turn: Mutex<Option<ThreadId>>,
    over: Condvar,
}

impl<S: Send> Shared<S> {
    pub(super) const fn new(inner: S) -> Self {
        Self { inner: Mutex::new(inner), turn: Mutex::new(None), over: Condvar::new() }
    }

    /// Runs `work`, of rough cost `cost`, when this thread's turn has come, without the interpreter.
    ///
    /// Work that looks for signals runs their handlers on this thread: one that uses the same object would wait for
    /// itself, and gets an error.
    pub(super) fn with<T: Send>(
        &self,
        py: Python<'_>,
        cost: f64,
        work: impl FnOnce(&mut S, &Stop) -> Result<T> + Send,
    ) -> PyResult<T> {
        let here = std::thread::current().id();
        let turn = *self.turn();
        if turn == Some(here) {
            return Err(InputError::new_err(
                "`stream` is at work on this thread: a signal handler cannot use it meanwhile",
            ));
        }
        // waiting may take long
        let cost = if turn.is_some() { f64::INFINITY } else { cost };
        run(py, cost, |stop| {
            let _turn = self.wait(here, stop)?;
            let unusable = |_| Error::Numerical("a defect has left this stream unusable".into());
            work(&mut *self.inner.lock().map_err(unusable)?, stop)
        })
    }

    fn turn(&self) -> MutexGuard<'_, Option<ThreadId>> {
        self.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait(&self, here: ThreadId, stop: &Stop) -> Result<Turn<'_, S>> {
        let mut turn = self.turn();
        while turn.is_some() {
            turn = self.over.wait_timeout(turn, WAIT).unwrap_or_else(PoisonError::into_inner).0;
            if turn.is_some() {
                drop(turn); // handlers may want to know it
                if stop.requested_after_a_wait() {
                    return Err(Error::Interrupted);
                }
                turn = self.turn();
            }
        }
        *turn = Some(here);
        Ok(Turn(self))
    }
}

/// It is over when this is dropped.
struct Turn<'a, S: Send>(&'a Shared<S>);

impl<S: Send> Drop for Turn<'_, S> {
    fn drop(&mut self) {
        *self.0.turn() = None;
        self.0.over.notify_one();
    }
}
