//! The solver against independent answers, and against everything that is awkward.

mod common;
mod oracles;
mod peer;
mod stress;
