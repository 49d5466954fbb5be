//! What a state file is held to.

/// The format's version that is written, and the only one that is read.
pub const VERSION: u64 = 2;

/// No file is longer than this; less where addresses are short.
pub const MAX_BYTES: u64 = if usize::BITS < 64 { 1 << 30 } else { 1 << 34 };
