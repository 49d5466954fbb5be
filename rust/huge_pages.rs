//! Memory for large results, in large pages.
//!
//! To provide a fresh page of 4 KiB takes the system about as long as the sampler needs to fill it; a page of 2 MiB
//! takes a tenth of that per byte. The allocator gives no large pages, so they are mapped here. Small results, and
//! systems without large pages, get a plain vector or plain pages. Of freed mappings, at most 72 MiB are kept for the
//! next sample of the same size. They are not cleared: the new owner writes all of it.

#![allow(unsafe_code, reason = "mmap, madvise and munmap are called directly")]

use crate::error::Result;
use crate::memory::try_zeros;
use crate::pod::Pod;

/// A fixed number of values, in a vector or in a mapping.
pub struct Buffer<T: Pod>(Memory<T>);

enum Memory<T: Pod> {
    Vector(Vec<T>),
    #[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
    Pages(linux::Pages<T>),
}

impl<T: Pod> Buffer<T> {
    /// `len` values, zeros or left over from an earlier use.
    ///
    /// # Errors
    /// [`crate::Error::Memory`] if they cannot be allocated.
    pub(crate) fn unset(what: &'static str, len: usize) -> Result<Self> {
        #[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
        let pages = linux::Pages::unset(len).map(Memory::Pages);
        #[cfg(not(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64"))))]
        let pages = None;
        let memory = pages.map_or_else(|| try_zeros(what, len).map(Memory::Vector), Ok)?;
        #[cfg_attr(not(test), expect(unused_mut, reason = "tests fill it"))]
        let mut buffer = Self(memory);
        #[cfg(test)]
        // SAFETY: as many values as there are, and any bytes are one.
        unsafe {
            buffer.as_mut_ptr().write_bytes(0x7f, len); // so that code which relies on zeros fails
        }
        Ok(buffer)
    }
}

impl<T: Pod> From<Vec<T>> for Buffer<T> {
    fn from(values: Vec<T>) -> Self {
        Self(Memory::Vector(values))
    }
}

impl<T: Pod> std::ops::Deref for Buffer<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.0 {
            Memory::Vector(values) => values,
            #[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
            Memory::Pages(pages) => pages.values(),
        }
    }
}

impl<T: Pod> std::ops::DerefMut for Buffer<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.0 {
            Memory::Vector(values) => values,
            #[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
            Memory::Pages(pages) => pages.values_mut(),
        }
    }
}

impl<T: Pod + PartialEq> PartialEq for Buffer<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: Pod + Eq> Eq for Buffer<T> {}

impl<T: Pod + std::fmt::Debug> std::fmt::Debug for Buffer<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        (**self).fmt(f)
    }
}

#[cfg(all(target_os = "linux", any(target_arch = "x86_64", target_arch = "aarch64")))]
mod linux {
    use std::ffi::{c_int, c_long, c_void};
    use std::marker::PhantomData;
    use std::ptr::NonNull;
    use std::sync::Mutex;

    use super::Pod;

    /// Bytes of a large page (x86-64, and aarch64 with pages of 4 KiB), and of the smallest result that uses one.
    const LARGE: usize = 2 << 20;
    const WORTH: usize = LARGE / 4;

    // the values of Linux on these two architectures
    const PROT_READ_WRITE: c_int = 1 | 2;
    const MAP_PRIVATE_ANONYMOUS: c_int = 0x02 | 0x20;
    const MADV_HUGEPAGE: c_int = 14;

    unsafe extern "C" {
        fn mmap(at: *mut c_void, len: usize, access: c_int, flags: c_int, file: c_int, offset: c_long) -> *mut c_void;
        fn munmap(at: *mut c_void, len: usize) -> c_int;
        fn madvise(at: *mut c_void, len: usize, advice: c_int) -> c_int;
    }

    /// Freed mappings, oldest first, at most [`KEEP`] bytes. Only `try_lock`: the process may have been forked while
    /// another thread held the lock.
    static SPARE: Mutex<Vec<Mapping>> = Mutex::new(Vec::new());
    const KEEP: usize = 72 << 20; // a result of 64 MiB and some more; C allocators keep about as much

    /// `bytes` bytes at `base`, owned, and initialized: zeros from the system, or plain values written since.
    struct Mapping {
        base: NonNull<c_void>,
        bytes: usize,
    }

    // SAFETY: the mapping is owned like the memory of a vector: plain bytes move and are shared between threads.
    unsafe impl Send for Mapping {}
    // SAFETY: as above; `&Mapping` gives access to nothing.
    unsafe impl Sync for Mapping {}

    impl Mapping {
        fn new(bytes: usize) -> Option<Self> {
            // SAFETY: a new private mapping at an address that the system chooses overlaps nothing.
            let base = unsafe { mmap(std::ptr::null_mut(), bytes, PROT_READ_WRITE, MAP_PRIVATE_ANONYMOUS, -1, 0) };
            if base.addr() == usize::MAX {
                return None; // MAP_FAILED
            }
            NonNull::new(base).map(|base| Self { base, bytes })
        }

        /// A freed mapping of this size, if any.
        fn spare(bytes: usize) -> Option<Self> {
            let mut spare = SPARE.try_lock().ok()?;
            let at = spare.iter().position(|mapping| mapping.bytes == bytes)?;
            Some(spare.remove(at))
        }

        /// Keeps it, in place of older ones, or unmaps it.
        fn retire(self) {
            if self.bytes > KEEP {
                return;
            }
            if let Ok(mut spare) = SPARE.try_lock() {
                spare.push(self);
                while spare.iter().map(|mapping| mapping.bytes).sum::<usize>() > KEEP {
                    drop(spare.remove(0));
                }
            }
        }
    }

    impl Drop for Mapping {
        fn drop(&mut self) {
            // SAFETY: the whole mapping of `new`, unmapped once; its owner has given it up.
            unsafe { munmap(self.base.as_ptr(), self.bytes) };
        }
    }

    /// `len` values at `start`, inside their own mapping.
    pub(super) struct Pages<T> {
        mapping: Option<Mapping>, // taken when dropped
        start: NonNull<T>,
        len: usize,
        values: PhantomData<T>,
    }

    // SAFETY: owned like a vector of plain `T`, which moves and is shared between threads.
    unsafe impl<T: Pod> Send for Pages<T> {}
    // SAFETY: as above; `&Pages` gives `&[T]` only.
    unsafe impl<T: Pod> Sync for Pages<T> {}

    impl<T: Pod> Pages<T> {
        /// `len` values, or None if they are too few or the system has no such memory.
        pub(super) fn unset(len: usize) -> Option<Self> {
            let used =
                len.checked_mul(size_of::<T>()).filter(|&used| used >= WORTH)?.checked_next_multiple_of(LARGE)?;
            let bytes = used.checked_add(LARGE)?; // so that a multiple of LARGE with `used` bytes lies inside
            if bytes > isize::MAX as usize {
                return None;
            }
            let spare = Mapping::spare(bytes);
            let used_before = spare.is_some();
            let mapping = spare.or_else(|| Mapping::new(bytes))?;
            let skip = mapping.base.addr().get().next_multiple_of(LARGE) - mapping.base.addr().get();
            // SAFETY: skip < LARGE and skip + used <= bytes: inside the mapping.
            let start = unsafe { mapping.base.byte_add(skip) };
            if !used_before {
                // SAFETY: the range lies in our mapping; the advice changes no contents, and may be refused.
                unsafe { madvise(start.as_ptr(), used, MADV_HUGEPAGE) };
            }
            Some(Self { mapping: Some(mapping), start: start.cast(), len, values: PhantomData })
        }

        pub(super) fn values(&self) -> &[T] {
            // SAFETY: `len` values fit into the `used` bytes from `start` on, which is aligned to LARGE; the mapping is
            // initialized, and any bytes are a value of plain `T`; it lives as long as `self`, and is written through `&mut self` only.
            unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) }
        }

        pub(super) fn values_mut(&mut self) -> &mut [T] {
            // SAFETY: as in `values`; `&mut self` makes the access exclusive.
            unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.len) }
        }
    }

    impl<T> Drop for Pages<T> {
        fn drop(&mut self) {
            if let Some(mapping) = self.mapping.take() {
                mapping.retire();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_of_every_size_keep_what_is_written() {
        for len in [0, 1, 1 << 10, (1 << 19) - 1, 1 << 19, (1 << 21) - 1, (1 << 21) + 1, 5_000_000] {
            for _ in 0..3 {
                let mut again = Buffer::<u16>::unset("a test", len).unwrap(); // may have been another's before
                again.fill(u16::MAX);
                assert!(again.len() == len && again.iter().all(|&v| v == u16::MAX));
            }
            let mut buffer = Buffer::<u16>::unset("a test", len).unwrap();
            buffer.iter_mut().enumerate().for_each(|(at, v)| *v = at as u16);
            let copy = std::thread::scope(|scope| scope.spawn(|| buffer.to_vec()).join().unwrap());
            assert_eq!(copy, *buffer);
            drop(buffer);
            assert!(copy.iter().enumerate().all(|(at, &v)| v == at as u16));
        }
    }

    #[test]
    fn what_cannot_be_had_is_an_error() {
        for len in [usize::MAX, usize::MAX / 4, isize::MAX as usize / 4, 1 << 50] {
            assert!(matches!(Buffer::<u32>::unset("a test", len), Err(crate::Error::Memory { what: "a test", .. })));
        }
    }
}
