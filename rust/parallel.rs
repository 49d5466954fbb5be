//! Work on independent chunks with scoped threads, and a way to stop it.
//!
//! Threads are born and joined inside the call: there is no pool to outlive a `fork`, nothing to initialise at import,
//! and when a thread cannot be had the calling thread does the work alone. A chunk, never a thread, owns its random
//! stream and its part of the output, so results do not depend on the number of threads.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::error::{Error, Result};

/// A request to stop, shared between the caller and a running computation.
#[derive(Debug, Default)]
pub struct Stop(AtomicBool);

impl Stop {
    /// No request yet.
    pub const fn new() -> Self {
        Self(AtomicBool::new(false))
    }

    /// Ask the computation to end at its next check.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether a stop was asked for.
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// The flag itself, for loops that want to poll it.
    pub fn flag(&self) -> &AtomicBool {
        &self.0
    }

    /// [`Error::Interrupted`] once a stop was asked for; loops call this every few milliseconds of work.
    pub fn check(&self) -> Result<()> {
        if self.requested() { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// Calls `work` once for every chunk, on up to `threads` threads; the first error wins and ends the others.
pub fn for_each_chunk<T, I, F>(chunks: I, threads: usize, stop: &Stop, work: F) -> Result<()>
where
    T: Send,
    I: Iterator<Item = T> + Send,
    F: Fn(T) -> Result<()> + Sync,
{
    let queue = Mutex::new(chunks);
    let failed: Mutex<Option<Error>> = Mutex::new(None);
    let drain = || loop {
        let next = queue.lock().ok().and_then(|mut chunks| chunks.next());
        let Some(chunk) = next else { return };
        if let Err(error) = stop.check().and_then(|()| work(chunk)) {
            if let (Ok(mut first), Ok(mut chunks)) = (failed.lock(), queue.lock()) {
                first.get_or_insert(error);
                chunks.by_ref().for_each(drop); // empty the queue: the other threads end after their chunk
            }
            return;
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads {
            // EAGAIN under a process limit is no reason to fail: this thread drains the queue below.
            if std::thread::Builder::new().spawn_scoped(scope, drain).is_err() {
                break;
            }
        }
        drain();
    });
    match failed.into_inner() {
        Ok(Some(error)) => Err(error),
        _ => Ok(()),
    }
}

/// Takes what only one of two threads may run: the new one, or the caller when no thread was to be had.
pub(crate) fn take<F>(slot: &Mutex<Option<F>>) -> Option<F> {
    slot.lock().ok().and_then(|mut work| work.take())
}

/// Runs `work`, which cannot look at a stop flag, on a thread of its own; after a stop the caller leaves at once with
/// [`Error::Interrupted`] and the thread ends by itself. `work` owns its data for that reason.
pub(crate) fn detached<T, F>(name: &str, stop: &Stop, work: F) -> Result<T>
where
    T: Send + 'static,
    F: FnOnce() -> Result<T> + Send + 'static,
{
    let (send, receive) = channel();
    let slot = Arc::new(Mutex::new(Some(work)));
    let theirs = Arc::clone(&slot);
    let spawned = std::thread::Builder::new().name(name.into()).spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| take(&theirs).map(|work| work())));
        let lost = || Some(Err(Error::Numerical("a solver panicked on this problem".into())));
        send.send(result.unwrap_or_else(|_| lost())).ok() // nobody listens after a stop
    });
    if spawned.is_err() {
        // no thread to be had: do it here, and be deaf for as long as it takes
        return take(&slot).map_or_else(|| Err(Error::Interrupted), |work| work());
    }
    loop {
        match receive.recv_timeout(Duration::from_millis(20)) {
            Ok(Some(result)) => return result,
            Err(RecvTimeoutError::Timeout) if stop.requested() => return Err(Error::Interrupted),
            Err(RecvTimeoutError::Timeout) => {}
            Ok(None) | Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::Numerical("the solver's thread ended without a result".into()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chunk_is_visited_once_for_any_number_of_threads() {
        for threads in [1, 2, 8] {
            let mut data = vec![0u32; 1000];
            for_each_chunk(data.chunks_mut(7), threads, &Stop::new(), |chunk| {
                chunk.iter_mut().for_each(|v| *v += 1);
                Ok(())
            })
            .unwrap();
            assert!(data.iter().all(|&v| v == 1));
        }
    }

    #[test]
    fn an_error_and_a_stop_reach_the_caller() {
        let stop = Stop::new();
        let result =
            for_each_chunk(0..100, 2, &stop, |i| if i == 5 { Err(Error::Numerical("five".into())) } else { Ok(()) });
        assert_eq!(result, Err(Error::Numerical("five".into())));
        stop.request();
        assert_eq!(for_each_chunk(0..100, 2, &stop, |_| Ok(())), Err(Error::Interrupted));
    }
}
