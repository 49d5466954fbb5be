//! An object that changes, behind a lock, so that any thread may use it.

use std::sync::{Mutex, PoisonError};
use std::thread::ThreadId;

use pyo3::prelude::*;

use super::error::InputError;
use super::run::run;
use crate::{Error, Result, Stop};

pub(super) struct Shared<S> {
    inner: Mutex<S>,
    /// The thread that has the lock.
    holder: Mutex<Option<ThreadId>>,
}

impl<S: Send> Shared<S> {
    pub(super) const fn new(inner: S) -> Self {
        Self { inner: Mutex::new(inner), holder: Mutex::new(None) }
    }

    /// Runs `work`, of rough cost `cost`, on what the lock guards, without the interpreter.
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
        if *self.holder.lock().unwrap_or_else(PoisonError::into_inner) == Some(here) {
            return Err(InputError::new_err(
                "`stream` is at work on this thread: a signal handler cannot use it meanwhile",
            ));
        }
        run(py, cost, |stop| {
            let unusable = |_| Error::Numerical("a defect has left this stream unusable".into());
            let mut inner = self.inner.lock().map_err(unusable)?;
            let _held = Held::new(&self.holder, here);
            work(&mut inner, stop)
        })
    }
}

/// Notes who holds the lock, for as long as it lives.
struct Held<'a>(&'a Mutex<Option<ThreadId>>);

impl<'a> Held<'a> {
    fn new(holder: &'a Mutex<Option<ThreadId>>, thread: ThreadId) -> Self {
        *holder.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        Self(holder)
    }
}

impl Drop for Held<'_> {
    fn drop(&mut self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}
