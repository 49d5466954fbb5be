//! Types for which every bit pattern is a value.

#![allow(unsafe_code, reason = "a promise that the compiler cannot check")]

/// Types for which every bit pattern, zeros in particular, is a value.
///
/// # Safety
/// Every bit pattern must be a value, and there must be no padding.
pub unsafe trait Pod: Copy + Default + Send + Sync + 'static {}
// SAFETY: numbers.
unsafe impl Pod for u8 {}
// SAFETY: as above.
unsafe impl Pod for u16 {}
// SAFETY: as above.
unsafe impl Pod for u32 {}
// SAFETY: as above.
unsafe impl Pod for u64 {}
// SAFETY: as above.
unsafe impl Pod for usize {}
// SAFETY: as above.
unsafe impl Pod for f64 {}
// SAFETY: as above.
unsafe impl Pod for [f64; 2] {}
// SAFETY: as above.
unsafe impl Pod for [f64; 3] {}
// SAFETY: as above.
unsafe impl Pod for [f64; 8] {}
