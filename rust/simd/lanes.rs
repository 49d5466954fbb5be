//! How wide a step of the generator is.

/// Interleaved xoshiro256++ generators per chunk. Part of the stream's definition.
pub const LANES: usize = 8;
