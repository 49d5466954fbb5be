//! Work limits: passes over the data, wall time, and a request to stop, checked together.

use std::time::{Duration, Instant};

use crate::parallel::Stop;

/// Why a computation ended before its tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Limit {
    Work,
    Time,
    Stop,
}

/// Entries touched between two readings of the clock (below 0.1 ms at 0.3 ns each).
const POLL: f64 = 2e5;

/// Counts entries touched; one *pass* is one product with `S` and one with `S^T` over all samples.
pub(crate) struct Budget<'a> {
    stop: &'a Stop,
    deadline: Option<Instant>,
    pass: f64,
    max: f64,
    spent: f64,
    polled: f64,
    limit: Option<Limit>,
}

impl<'a> Budget<'a> {
    pub fn new(stop: &'a Stop, time: Option<Duration>, max_passes: usize, entries: usize) -> Self {
        let pass = 2.0 * entries.max(1) as f64;
        let deadline = time.and_then(|t| Instant::now().checked_add(t));
        Self { stop, deadline, pass, max: max_passes as f64 * pass, spent: 0.0, polled: f64::NEG_INFINITY, limit: None }
    }

    /// Counts `samples * entries` touched entries `half_passes` times; `true` when a limit has been reached.
    pub fn charge(&mut self, half_passes: usize, samples: usize, entries: usize) -> bool {
        // A small constant for the vector operations around a product.
        self.spent += half_passes as f64 * (samples * entries) as f64;
        if self.spent - self.polled > POLL {
            self.polled = self.spent;
            self.poll();
        }
        self.limit.is_some()
    }

    /// Checks for a stop and reads the clock; `true` when a limit has been reached.
    pub fn poll(&mut self) -> bool {
        if self.limit.is_none() {
            self.limit = self.reached();
        }
        self.limit.is_some()
    }

    fn reached(&self) -> Option<Limit> {
        if self.stop.requested() {
            Some(Limit::Stop)
        } else if self.deadline.is_some_and(|d| Instant::now() >= d) {
            Some(Limit::Time)
        } else if self.spent >= self.max {
            Some(Limit::Work)
        } else {
            None
        }
    }

    pub fn limit(&self) -> Option<Limit> {
        self.limit
    }

    pub fn exhausted(&self) -> bool {
        self.limit.is_some()
    }

    /// Passes spent so far.
    pub fn passes(&self) -> f64 {
        self.spent / self.pass
    }
}
