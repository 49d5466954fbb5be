//! Types that any bytes are values of.

#![allow(unsafe_code, reason = "a promise that the compiler cannot check")]

/// Types for which any bytes, zeros in particular, are a value.
///
/// # Safety
/// They are, and there is no padding between them.
pub unsafe trait Plain: Copy + Default + Send + Sync + 'static {}
// SAFETY: numbers.
unsafe impl Plain for u8 {}
// SAFETY: as above.
unsafe impl Plain for u16 {}
// SAFETY: as above.
unsafe impl Plain for u32 {}
// SAFETY: as above.
unsafe impl Plain for u64 {}
// SAFETY: as above.
unsafe impl Plain for usize {}
// SAFETY: as above.
unsafe impl Plain for f64 {}
// SAFETY: as above.
unsafe impl Plain for [f64; 2] {}
// SAFETY: as above.
unsafe impl Plain for [f64; 3] {}
// SAFETY: as above.
unsafe impl Plain for [f64; 8] {}
