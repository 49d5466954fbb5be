//! Eight xoshiro256++ lanes and eight alias draws at once, in registers of 256 bits.

use std::arch::x86_64::*;

use super::LANES;

/// Largest table of [`lookup_in_registers`], in cells.
pub(super) const IN_REGISTERS: usize = 16;

/// The next words of eight lanes.
#[target_feature(enable = "avx2")]
pub(super) fn fill(state: &mut [[u64; LANES]; 4], steps: &mut [[u64; LANES]]) {
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

/// Scalar loads from the table, then eight comparisons at once. Gathers are no faster, and slow on patched processors;
/// prefetching the cells of large tables was slower (measured).
#[target_feature(enable = "avx2")]
pub(super) fn lookup<I: Copy>(cells: &[u64], words: &[u64], out: &mut [I], index: impl Fn(u32) -> I + Copy) -> usize {
    if cells.is_empty() {
        return 0;
    }
    let last = cells.len() - 1; // 2^k - 1: the bits that choose the cell
    let mask = _mm256_set1_epi32(last as i32);
    let eights = words.as_chunks::<8>().0.iter().zip(out.as_chunks_mut::<8>().0);
    let done = 8 * eights.len();
    for (words, out) in eights {
        let [e0, e1, e2, e3, e4, e5, e6, e7] = words.map(|word| cells[word as usize & last] as i64);
        let (cell, coin) = halves(load(words, 0), load(words, 4));
        let (alias, threshold) = halves(_mm256_set_epi64x(e3, e2, e1, e0), _mm256_set_epi64x(e7, e6, e5, e4));
        // coin < threshold keeps the cell
        let keep = _mm256_cmpgt_epi32(signed(threshold), signed(coin));
        let chosen = _mm256_blendv_epi8(alias, _mm256_and_si256(cell, mask), keep);
        *out = match size_of::<I>() {
            1 => in_order_u8(chosen).map(|i| index(i.into())),
            _ => in_order(chosen).map(index),
        };
    }
    done
}

/// [`lookup`] without memory access: 16 thresholds in two registers, 16 aliases in one; 32 words at a time.
#[target_feature(enable = "avx2")]
pub(super) fn lookup_in_registers<I: Copy>(
    cells: &[u64],
    words: &[u64],
    out: &mut [I],
    index: impl Fn(u32) -> I + Copy,
) -> usize {
    if cells.is_empty() {
        return 0;
    }
    let last = cells.len() - 1;
    // a smaller table is repeated, so that the bits above its mask change nothing
    let thresholds: [u64; 8] = std::array::from_fn(|i| {
        let [low, high] = [2 * i, 2 * i + 1].map(|cell| cells[cell & last] >> 32);
        low | high << 32
    });
    let (low, high) = (signed(load(&thresholds, 0)), signed(load(&thresholds, 4)));
    let aliases = u128::from_le_bytes(std::array::from_fn(|i| cells[i & last] as u8));
    let aliases = _mm256_setr_epi64x(aliases as i64, (aliases >> 64) as i64, aliases as i64, (aliases >> 64) as i64);
    let mask = _mm256_set1_epi32(last as i32);
    // the cells of eight words, and -1 where the coin keeps the cell
    let toss = |words: &[u64; 8]| {
        let (cell, coin) = halves(load(words, 0), load(words, 4));
        let bit3 = _mm256_slli_epi32::<28>(cell); // the sign chooses between the two registers
        let threshold = _mm256_blendv_ps(
            _mm256_castsi256_ps(_mm256_permutevar8x32_epi32(low, cell)),
            _mm256_castsi256_ps(_mm256_permutevar8x32_epi32(high, cell)),
            _mm256_castsi256_ps(bit3),
        );
        let keep = _mm256_cmpgt_epi32(_mm256_castps_si256(threshold), signed(coin));
        (_mm256_and_si256(cell, mask), keep)
    };
    let rounds = words.as_chunks::<32>().0.iter().zip(out.as_chunks_mut::<32>().0);
    let done = 32 * rounds.len();
    for (words, out) in rounds {
        let (eights, _) = words.as_chunks::<8>();
        let ((c0, k0), (c1, k1)) = (toss(&eights[0]), toss(&eights[1]));
        let ((c2, k2), (c3, k3)) = (toss(&eights[2]), toss(&eights[3]));
        let cell = _mm256_packs_epi16(_mm256_packs_epi32(c0, c1), _mm256_packs_epi32(c2, c3));
        let keep = _mm256_packs_epi16(_mm256_packs_epi32(k0, k1), _mm256_packs_epi32(k2, k3));
        let chosen = _mm256_blendv_epi8(_mm256_shuffle_epi8(aliases, cell), cell, keep);
        // the lower half holds the words 0 1 4 5 of every eight, the upper one 2 3 6 7
        let (first, second) = (_mm256_castsi256_si128(chosen), _mm256_extracti128_si256::<1>(chosen));
        let bytes = [_mm_unpacklo_epi16(first, second), _mm_unpackhi_epi16(first, second)];
        // SAFETY: 32 bytes either way, and any bytes are a value of either type.
        let bytes: [u8; 32] = unsafe { std::mem::transmute(bytes) };
        *out = bytes.map(|i| index(i.into()));
    }
    done
}

/// The low and the high halves of eight words, both in the order 0 1 4 5, 2 3 6 7.
#[inline]
#[target_feature(enable = "avx2")]
fn halves(first: __m256i, second: __m256i) -> (__m256i, __m256i) {
    let (first, second) = (_mm256_castsi256_ps(first), _mm256_castsi256_ps(second));
    let low = _mm256_shuffle_ps::<0b10_00_10_00>(first, second);
    let high = _mm256_shuffle_ps::<0b11_01_11_01>(first, second);
    (_mm256_castps_si256(low), _mm256_castps_si256(high))
}

/// Maps unsigned numbers so that a signed comparison orders them.
#[inline]
#[target_feature(enable = "avx2")]
fn signed(values: __m256i) -> __m256i {
    _mm256_xor_si256(values, _mm256_set1_epi32(i32::MIN))
}

/// Undoes the order of [`halves`].
#[inline]
#[target_feature(enable = "avx2")]
fn in_order(eight: __m256i) -> [u32; 8] {
    let sorted = _mm256_permutevar8x32_epi32(eight, _mm256_setr_epi32(0, 1, 4, 5, 2, 3, 6, 7));
    // SAFETY: 32 bytes either way, and any bytes are a value of either type.
    unsafe { std::mem::transmute(sorted) }
}

/// [`in_order`] for values below 256.
#[inline]
#[target_feature(enable = "avx2")]
fn in_order_u8(eight: __m256i) -> [u8; 8] {
    // the low bytes of each half to their places, -1 for a zero; then the halves together
    let places = _mm256_setr_epi8(
        0, 4, -1, -1, 8, 12, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, //
        -1, -1, 0, 4, -1, -1, 8, 12, -1, -1, -1, -1, -1, -1, -1, -1,
    );
    let moved = _mm256_shuffle_epi8(eight, places);
    let bytes = _mm_or_si128(_mm256_castsi256_si128(moved), _mm256_extracti128_si256::<1>(moved));
    _mm_cvtsi128_si64(bytes).to_le_bytes()
}

/// `y -= A x` in short rows, four at a time; see [`super::subtract_short`].
#[target_feature(enable = "avx2")]
pub(super) fn subtract_short<const FOURS: usize>(a: &[f64], n: usize, x: &[[f64; 4]; FOURS], y: &mut [f64]) -> usize {
    let mut fours = [_mm256_setzero_pd(); FOURS];
    for (four, x) in fours.iter_mut().zip(x) {
        *four = four_of(x);
    }
    let ys = y.as_chunks_mut::<4>().0.iter_mut().zip(a.chunks_exact(4 * n));
    let done = 4 * ys.len();
    for (y, rows) in ys {
        let mut sums = [_mm256_setzero_pd(); 4];
        for (r, sum) in sums.iter_mut().enumerate() {
            let row = &rows[r * n..][..n];
            let (whole, last) = (&row.as_chunks::<4>().0[..FOURS - 1], row.last_chunk::<4>());
            let Some(last) = last else { return 0 }; // n >= 4
            let mut s = _mm256_setzero_pd();
            for i in 0..FOURS {
                let four = if i + 1 < FOURS { &whole[i] } else { last };
                let product = _mm256_mul_pd(four_of(four), fours[i]);
                s = if i == 0 { product } else { _mm256_add_pd(s, product) };
            }
            *sum = s;
        }
        // (s_0 + s_1), (s_2 + s_3) of every row, then their sums
        let (low, high) = (_mm256_hadd_pd(sums[0], sums[1]), _mm256_hadd_pd(sums[2], sums[3]));
        let (left, right) = (_mm256_permute2f128_pd::<0x20>(low, high), _mm256_permute2f128_pd::<0x31>(low, high));
        let rest = _mm256_sub_pd(four_of(y), _mm256_add_pd(left, right));
        // SAFETY: `y` has the 32 bytes that are written; the instruction asks for no alignment.
        unsafe { _mm256_storeu_pd(y.as_mut_ptr(), rest) };
    }
    done
}

/// Four doubles.
#[inline]
#[target_feature(enable = "avx2")]
fn four_of(values: &[f64; 4]) -> __m256d {
    // SAFETY: `values` has the 32 bytes that are read; the instruction asks for no alignment.
    unsafe { _mm256_loadu_pd(values.as_ptr()) }
}
