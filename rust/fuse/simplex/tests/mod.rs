//! The solver against independent solutions, and on hard and degenerate problems.

mod common;
mod oracles;
mod peer;
mod stress;
