//! The one kernel that needs wider registers than the baseline wheel may assume: eight xoshiro256++ lanes at once.
//!
//! The same integer operations as [`crate::stream`]'s portable loop, hence the same words; a test compares them.

#![allow(unsafe_code, reason = "vector loads and stores take pointers; every one stays inside an array it borrows")]

use std::arch::x86_64::{
    __m256i, _mm256_add_epi64, _mm256_loadu_si256, _mm256_or_si256, _mm256_slli_epi64, _mm256_srli_epi64,
    _mm256_storeu_si256, _mm256_xor_si256,
};

use crate::stream::LANES;

/// Fills `steps` and returns true, or returns false where the processor has no AVX2.
pub(crate) fn fill(state: &mut [[u64; LANES]; 4], steps: &mut [[u64; LANES]]) -> bool {
    if !std::arch::is_x86_feature_detected!("avx2") {
        return false;
    }
    // SAFETY: the processor has just said that it knows the instructions.
    unsafe { fill_avx2(state, steps) };
    true
}

#[target_feature(enable = "avx2")]
fn fill_avx2(state: &mut [[u64; LANES]; 4], steps: &mut [[u64; LANES]]) {
    let [s0, s1, s2, s3] = state;
    let mut low = [load(s0, 0), load(s1, 0), load(s2, 0), load(s3, 0)];
    let mut high = [load(s0, 4), load(s1, 4), load(s2, 4), load(s3, 4)];
    for step in steps {
        store(step, 0, next(&mut low));
        store(step, 4, next(&mut high));
    }
    for (row, (low, high)) in state.iter_mut().zip(low.into_iter().zip(high)) {
        store(row, 0, low);
        store(row, 4, high);
    }
}

/// One step of four lanes of xoshiro256++.
#[inline]
#[target_feature(enable = "avx2")]
fn next([s0, s1, s2, s3]: &mut [__m256i; 4]) -> __m256i {
    let sum = _mm256_add_epi64(*s0, *s3);
    let turned = _mm256_or_si256(_mm256_slli_epi64::<23>(sum), _mm256_srli_epi64::<41>(sum));
    let out = _mm256_add_epi64(turned, *s0);
    let t = _mm256_slli_epi64::<17>(*s1);
    *s2 = _mm256_xor_si256(*s2, *s0);
    *s3 = _mm256_xor_si256(*s3, *s1);
    *s1 = _mm256_xor_si256(*s1, *s2);
    *s0 = _mm256_xor_si256(*s0, *s3);
    *s2 = _mm256_xor_si256(*s2, t);
    *s3 = _mm256_or_si256(_mm256_slli_epi64::<45>(*s3), _mm256_srli_epi64::<19>(*s3));
    out
}

#[inline]
#[target_feature(enable = "avx2")]
fn load(row: &[u64; LANES], at: usize) -> __m256i {
    let four = &row[at..at + 4];
    // SAFETY: `four` has the 32 bytes that are read; the instruction asks for no alignment.
    unsafe { _mm256_loadu_si256(four.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx2")]
fn store(row: &mut [u64; LANES], at: usize, value: __m256i) {
    let four = &mut row[at..at + 4];
    // SAFETY: `four` has the 32 bytes that are written; the instruction asks for no alignment.
    unsafe { _mm256_storeu_si256(four.as_mut_ptr().cast(), value) }
}
