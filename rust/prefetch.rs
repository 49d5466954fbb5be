//! Prefetching where the processor does not do it by itself, or not far enough ahead.

#![allow(unsafe_code, reason = "a hint to the processor takes a pointer, and reads nothing")]

/// Prefetches `values[at]`; a hint only, so `at` may be beyond the end.
#[inline(always)]
pub(crate) fn prefetch<T>(values: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: SSE, which every x86-64 has; nothing is read, for any address.
    unsafe {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        _mm_prefetch::<_MM_HINT_T0>(values.as_ptr().wrapping_add(at).cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, at);
}
