//! Tests of the core through its public interface, in one binary.

mod contracts;
mod oracles;
