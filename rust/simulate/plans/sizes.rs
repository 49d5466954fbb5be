//! How simulated runs are divided, and what they are called in errors.

pub(super) const WHAT: &str = "a simulated run";

/// Runs that a thread takes at a time.
pub(super) const CHUNK: usize = 16;
