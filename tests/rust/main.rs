//! Tests of the core through its public interface, in one binary.

#![allow(clippy::disallowed_methods, clippy::disallowed_macros, reason = "tests may end where there is no memory")]

mod contracts;
mod examples;
mod oracles;
