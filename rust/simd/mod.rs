//! Wider registers than the baseline wheel may assume, chosen at run time: `dispatch` compiles portable code for each
//! width; the others are written for one.

#![allow(unsafe_code, reason = "vector loads and stores take pointers; every one stays inside an array it borrows")]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
pub(crate) mod dispatch;
#[cfg(target_arch = "x86_64")]
mod x86_64;

#[cfg(target_arch = "x86_64")]
pub(crate) use x86_64::{fill, lookup, subtract_short};

/// Interleaved xoshiro256++ generators per chunk. Part of the stream's definition.
pub const LANES: usize = 8;
