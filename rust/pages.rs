//! Large pages for large results: a fresh page costs the system about as much as filling it costs the sampler.

#![allow(unsafe_code, reason = "one call to the system, which changes no byte of the memory it is told about")]

/// Asks for large pages where a result begins to need many (the system hands out pages of 2 MiB, or of 4 KiB).
const MANY: usize = 4 << 20;

/// Tells the system that `memory`, not written so far, will be filled as a whole. Only advice: it may be ignored.
#[cfg(target_os = "linux")]
pub(crate) fn advise<T>(memory: &mut [T]) {
    use std::ffi::{c_int, c_void};
    unsafe extern "C" {
        fn madvise(address: *mut c_void, length: usize, advice: c_int) -> c_int;
    }
    const MADV_HUGEPAGE: c_int = 14;
    const PAGE: usize = 1 << 16; // the largest page of any supported processor: an address has to be a multiple
    let bytes = size_of_val(memory);
    if bytes < MANY {
        return;
    }
    let start = memory.as_mut_ptr().cast::<u8>();
    let skip = start.align_offset(PAGE);
    // SAFETY: skip < PAGE < bytes, hence the range lies inside `memory`, which is borrowed for the call; this advice changes
    // neither contents nor validity of any address, and an error (an old system) leaves all as it was.
    unsafe { madvise(start.add(skip).cast(), bytes - skip, MADV_HUGEPAGE) };
}

/// Tells the system that `memory`, not written so far, will be filled as a whole. Only advice: it may be ignored.
#[cfg(not(target_os = "linux"))]
pub(crate) fn advise<T>(_: &mut [T]) {}
