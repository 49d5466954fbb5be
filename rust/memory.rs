//! Allocation of arrays whose size depends on the input: [`Error::Memory`] where `vec!` and `collect` would abort.
//!
//! Nothing else in this crate allocates such an array (`clippy.toml` forbids the other ways); small things of bounded
//! size, such as a message or the name of a thread, are allocated as usual. Dependencies that allocate run under
//! [`covered`].

use std::alloc::{Layout, alloc_zeroed};
use std::cell::Cell;
use std::sync::OnceLock;

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::{Error, Result};
use crate::pod::Pod;

fn refused<T>(what: &'static str, len: usize) -> Error {
    Error::Memory { what, bytes: len as u128 * size_of::<T>() as u128 }
}

/// `a * b` as a length, or [`Error::Memory`] when it does not fit into the address space.
pub(crate) fn checked_len(what: &'static str, a: usize, b: usize) -> Result<usize> {
    a.checked_mul(b).ok_or(Error::Memory { what, bytes: a as u128 * b as u128 })
}

/// Zeros from the system, which clears pages when they are first used: writing gigabytes here could not be interrupted.
#[allow(unsafe_code, reason = "no safe function gives zeros or says that there are none")]
pub(crate) fn try_zeros<T: Pod>(what: &'static str, len: usize) -> Result<Vec<T>> {
    let layout = Layout::array::<T>(len).map_err(|_| refused::<T>(what, len))?;
    if layout.size() == 0 {
        return Ok(Vec::new());
    }
    // SAFETY: the size is not zero.
    let start = unsafe { alloc_zeroed(layout) };
    if start.is_null() {
        return Err(refused::<T>(what, len));
    }
    // SAFETY: the global allocator gave `start` for the layout of `len` values, and zeros are values of plain `T`.
    Ok(unsafe { Vec::from_raw_parts(start.cast(), len, len) })
}

/// Room for `len` values.
pub(crate) fn try_room<T>(what: &'static str, len: usize) -> Result<Vec<T>> {
    let mut room = Vec::new();
    room.try_reserve_exact(len).map_err(|_| refused::<T>(what, len))?;
    Ok(room)
}

/// `len` times the same value.
pub(crate) fn try_filled<T: Clone>(what: &'static str, value: T, len: usize) -> Result<Vec<T>> {
    let mut filled = try_room(what, len)?;
    filled.resize(len, value);
    Ok(filled)
}

/// A copy.
pub(crate) fn try_copy<T: Copy>(what: &'static str, values: &[T]) -> Result<Vec<T>> {
    let mut copy = try_room(what, values.len())?;
    copy.extend_from_slice(values);
    Ok(copy)
}

/// Appends one value.
pub(crate) fn try_push<T>(what: &'static str, to: &mut Vec<T>, value: T) -> Result<()> {
    to.try_reserve(1).map_err(|_| refused::<T>(what, to.len().saturating_add(1)))?;
    to.push(value);
    Ok(())
}

/// Appends values.
pub(crate) fn try_extend<T>(what: &'static str, to: &mut Vec<T>, values: impl IntoIterator<Item = T>) -> Result<()> {
    let values = values.into_iter();
    if let Some(most) = values.size_hint().1 {
        to.try_reserve(most).map_err(|_| refused::<T>(what, to.len().saturating_add(most)))?;
        to.extend(values); // there are no more than they say
        return Ok(());
    }
    values.into_iter().try_for_each(|value| try_push(what, to, value))
}

/// All values, in room for the upper size hint.
pub(crate) fn try_collect<T>(what: &'static str, values: impl IntoIterator<Item = T>) -> Result<Vec<T>> {
    let values = values.into_iter();
    let mut all = try_room(what, values.size_hint().1.unwrap_or(0))?;
    try_extend(what, &mut all, values)?;
    Ok(all)
}

/// All values, or the first error.
pub(crate) fn try_collect_all<T>(what: &'static str, values: impl IntoIterator<Item = Result<T>>) -> Result<Vec<T>> {
    let values = values.into_iter();
    let mut all = try_room(what, values.size_hint().1.unwrap_or(0))?;
    for value in values {
        try_push(what, &mut all, value?)?;
    }
    Ok(all)
}

/// Runs `work`, whose failed allocations would abort, after a trial allocation of `bytes` bytes that is freed at once.
/// Another thread may take the memory in between; this one does not.
pub(crate) fn covered<T>(what: &'static str, bytes: u128, work: impl FnOnce() -> T) -> Result<T> {
    let len = usize::try_from(bytes).map_err(|_| Error::Memory { what, bytes })?;
    drop(try_room::<u8>(what, len)?);
    #[cfg(test)]
    let _watch = tests::Cover::watch(len);
    Ok(work())
}

/// Allocates the buffers that `faer` keeps per thread, so that later matrix products on this thread allocate nothing.
pub(crate) fn room_for_products() -> Result<()> {
    thread_local!(static THERE: Cell<bool> = const { Cell::new(false) });
    const SIDE: usize = 64; // large enough that `faer` packs, which smaller products do without
    if THERE.get() {
        return Ok(());
    }
    let what = "the product of matrices";
    let (factor, mut out) = (try_zeros::<f64>(what, SIDE * SIDE)?, try_zeros::<f64>(what, SIDE * SIDE)?);
    let factor = MatRef::from_row_major_slice(&factor, SIDE, SIDE);
    let out = MatMut::from_row_major_slice_mut(&mut out, SIDE, SIDE);
    covered(what, 2 * last_cache() + (4 << 20), || matmul(out, Accum::Replace, factor, factor, 1.0, Par::Seq))?;
    THERE.set(true);
    Ok(())
}

/// Bytes of the last-level cache (32 MiB if unknown): `faer`'s buffers take at most twice as much.
fn last_cache() -> u128 {
    static BYTES: OnceLock<u128> = OnceLock::new();
    *BYTES.get_or_init(|| {
        let size = std::fs::read_to_string("/sys/devices/system/cpu/cpu0/cache/index3/size").unwrap_or_default();
        let kib = size.trim().strip_suffix('K').and_then(|kib| kib.parse::<u128>().ok());
        kib.map_or(32 << 20, |kib| kib << 10)
    })
}

#[cfg(test)]
pub(crate) mod tests;
