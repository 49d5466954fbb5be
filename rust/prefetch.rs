//! Asking memory ahead of time for what a loop will read: more than the processor asks for by itself, or where it
//! cannot know.

#![allow(unsafe_code, reason = "a hint to the processor takes a pointer, and reads nothing")]

/// `values[at]` will be read soon. A hint: any `at` will do, also beyond the end.
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
