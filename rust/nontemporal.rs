//! Two ways to store results: through the caches as usual, or past them (non-temporal stores).
//!
//! A usual store first reads the cache line that it changes. Most lines of a large result leave the caches before they
//! are read again, so half of that traffic is wasted. Stores past the caches are faster only if their inputs are
//! prefetched, and only where these are far apart: measured for 64 MiB of controls from sampled matrices, n = 100, m =
//! 50 took 3.6 ms with them and 7.6 ms without, n = 10, m = 4 took 6.2 ms and 4.5 ms.

#![allow(unsafe_code, reason = "these stores take pointers; every one stays inside an array it borrows")]

/// Results of at least this many bytes are stored past the caches: measured, writing and then reading once is faster
/// from here on, and slower below.
pub(crate) const LARGE: usize = 32 << 20;

/// A way to store results.
pub(crate) trait Writer {
    /// `to = values`
    fn write<const K: usize>(&self, to: &mut [f64; K], values: [f64; K]);

    /// Prefetches `values[at]`, which is read soon; any `at` is allowed.
    fn prefetch<T>(&self, values: &[T], at: usize);
}

/// Through the caches, as usual.
pub(crate) struct Through;

impl Writer for Through {
    #[inline(always)]
    fn write<const K: usize>(&self, to: &mut [f64; K], values: [f64; K]) {
        *to = values;
    }

    #[inline(always)]
    fn prefetch<T>(&self, _: &[T], _: usize) {}
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86_64::past;

/// Runs `work` with usual stores: on other architectures nothing faster is known.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn past(work: impl FnOnce(&Through)) {
    work(&Through);
}

/// With SSE2, which every x86-64 has; wider registers are not faster here.
#[cfg(target_arch = "x86_64")]
mod x86_64 {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_loadu_pd, _mm_prefetch, _mm_sfence, _mm_stream_pd, _mm_stream_si64};
    use std::marker::PhantomData;

    use super::Writer;

    /// Past the caches. Only on one thread, and only inside [`past`].
    pub(crate) struct Past(PhantomData<*const ()>);

    /// Runs `work`, which writes past the caches; what it writes may be read only after it has returned.
    pub(crate) fn past(work: impl FnOnce(&Past)) {
        work(&Past(PhantomData)); // dropped, and so fenced, also after a panic
    }

    impl Writer for Past {
        #[inline(always)]
        fn write<const K: usize>(&self, to: &mut [f64; K], values: [f64; K]) {
            if K.is_multiple_of(2) && to.as_ptr().addr().is_multiple_of(16) {
                for k in 0..K / 2 {
                    // SAFETY: 2 k + 1 < K, and the address is a multiple of 16; the drop of `Past` fences the stores.
                    unsafe { _mm_stream_pd(to.as_mut_ptr().add(2 * k), _mm_loadu_pd(values.as_ptr().add(2 * k))) };
                }
            } else {
                for (to, value) in to.iter_mut().zip(values) {
                    // SAFETY: `to` has the 8 bytes that are written; the drop of `Past` fences them.
                    unsafe { _mm_stream_si64(std::ptr::from_mut(to).cast(), value.to_bits().cast_signed()) };
                }
            }
        }

        #[inline(always)]
        fn prefetch<T>(&self, values: &[T], at: usize) {
            // SAFETY: SSE, which every x86-64 has; a hint, nothing is read, for any address.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(values.as_ptr().wrapping_add(at).cast()) };
        }
    }

    impl Drop for Past {
        fn drop(&mut self) {
            // SAFETY: SSE, which every x86-64 has.
            unsafe { _mm_sfence() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written<const K: usize>(offset: usize) -> Vec<f64> {
        let mut out = vec![-1.0; 4 * K + offset + 1];
        past(|past| {
            for (k, to) in out[offset..].as_chunks_mut::<K>().0.iter_mut().take(4).enumerate() {
                past.prefetch(&[0.0], k * 1000);
                past.write(to, std::array::from_fn(|j| (k * K + j) as f64));
            }
        });
        assert!(out[..offset].iter().chain(&out[offset + 4 * K..]).all(|&v| v == -1.0));
        out[offset..][..4 * K].to_vec()
    }

    /// For any length and any alignment to eight bytes; neighbouring values do not change.
    #[test]
    fn past_the_caches_arrive_the_same_values() {
        for offset in 0..4 {
            for values in [written::<1>(offset), written::<2>(offset), written::<3>(offset), written::<8>(offset)] {
                assert!(values.iter().enumerate().all(|(at, &v)| v == at as f64), "offset {offset}: {values:?}");
            }
        }
    }
}
