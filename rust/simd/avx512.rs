//! Eight xoshiro256++ lanes in one register of 512 bits, and tables of up to 32 cells in four.

use std::arch::x86_64::*;

use super::LANES;

/// Largest table of [`lookup_in_registers`], in cells.
pub(super) const IN_REGISTERS: usize = 32;

/// `a ^ b ^ c` as a truth table.
const XOR3: i32 = 0x96;

/// The next words of eight lanes.
#[target_feature(enable = "avx512f")]
pub(super) fn fill(state: &mut [[u64; LANES]; 4], steps: &mut [[u64; LANES]]) {
    let [mut s0, mut s1, mut s2, mut s3] = state.each_ref().map(|row| load(row));
    for step in steps {
        let out = _mm512_add_epi64(_mm512_rol_epi64::<23>(_mm512_add_epi64(s0, s3)), s0);
        // SAFETY: `step` has the 64 bytes that are written; the instruction asks for no alignment.
        unsafe { _mm512_storeu_si512(step.as_mut_ptr().cast(), out) };
        let t = _mm512_slli_epi64::<17>(s1);
        // the six assignments of one step, each from the old values
        (s0, s1, s2, s3) = (
            _mm512_ternarylogic_epi64::<XOR3>(s0, s1, s3),
            _mm512_ternarylogic_epi64::<XOR3>(s0, s1, s2),
            _mm512_ternarylogic_epi64::<XOR3>(s0, s2, t),
            _mm512_rol_epi64::<45>(_mm512_xor_si512(s1, s3)),
        );
    }
    for (row, register) in state.iter_mut().zip([s0, s1, s2, s3]) {
        // SAFETY: `row` has the 64 bytes that are written.
        unsafe { _mm512_storeu_si512(row.as_mut_ptr().cast(), register) };
    }
}

/// One index per word from a table that fits into registers, 16 words at a time; returns how many are done.
#[target_feature(enable = "avx512f")]
pub(super) fn lookup_in_registers<I: Copy>(
    cells: &[u64],
    words: &[u64],
    out: &mut [I],
    index: impl Fn(u32) -> I + Copy,
) -> usize {
    if cells.is_empty() {
        return 0;
    }
    let last = cells.len() - 1; // 2^k - 1: the bits that choose the cell
    let mask = _mm512_set1_epi32(last as i32);
    // a smaller table is repeated, so that the bits above its mask change nothing
    let part = |first: usize| load(&std::array::from_fn(|i| cells[(first + i) & last]));
    let (alias_low, threshold_low) = halves(part(0), part(8));
    let (alias_high, threshold_high) = halves(part(16), part(24));
    let rounds = words.as_chunks::<16>().0.iter().zip(out.as_chunks_mut::<16>().0);
    let done = 16 * rounds.len();
    for (words, out) in rounds {
        let (eights, _) = words.as_chunks::<LANES>();
        let (cell, coin) = halves(load(&eights[0]), load(&eights[1]));
        let threshold = _mm512_permutex2var_epi32(threshold_low, cell, threshold_high);
        let alias = _mm512_permutex2var_epi32(alias_low, cell, alias_high);
        // coin < threshold keeps the cell
        let keep = _mm512_cmplt_epu32_mask(coin, threshold);
        let chosen = _mm512_mask_and_epi32(alias, keep, cell, mask);
        *out = match size_of::<I>() {
            1 => {
                // SAFETY: 16 bytes either way, and any bytes are a value of either type.
                let bytes: [u8; 16] = unsafe { std::mem::transmute(_mm512_cvtepi32_epi8(chosen)) };
                bytes.map(|i| index(i.into()))
            }
            _ => {
                // SAFETY: 64 bytes either way, and any bytes are a value of either type.
                let values: [u32; 16] = unsafe { std::mem::transmute(chosen) };
                values.map(index)
            }
        };
    }
    done
}

/// The low and the high halves of sixteen words, in order.
#[inline]
#[target_feature(enable = "avx512f")]
fn halves(first: __m512i, second: __m512i) -> (__m512i, __m512i) {
    let low = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
    let high = _mm512_or_si512(low, _mm512_set1_epi32(1));
    (_mm512_permutex2var_epi32(first, low, second), _mm512_permutex2var_epi32(first, high, second))
}

#[inline]
#[target_feature(enable = "avx512f")]
fn load(eight: &[u64; LANES]) -> __m512i {
    // SAFETY: `eight` has the 64 bytes that are read; the instruction asks for no alignment.
    unsafe { _mm512_loadu_si512(eight.as_ptr().cast()) }
}
