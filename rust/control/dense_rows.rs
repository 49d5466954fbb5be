//! Controls of realizations without structure: a block of `y`, reading every entry once, then one matrix product.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::realizations::{Entity, Realized};
use crate::error::Result;
use crate::memory::{room_for_products, try_zeros};
use crate::parallel::Stop;
use crate::prefetch::prefetch;

/// Entries of `A` between two checks of the stop flag: well below a millisecond.
const STEP: usize = 1 << 18;

/// The controls of the realizations from `first` on, as many as `out` has rows for; `transposed` is `(B^+)^T`.
pub(super) fn controls(
    realized: &Realized<'_>,
    first: usize,
    transposed: &[f64],
    m: usize,
    out: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let n = realized.n;
    let count = out.len() / m;
    room_for_products()?;
    let mut y = try_zeros("the controls", count * n)?;
    differences(realized, first, &mut y, stop)?;
    // U = Y (B^+)^T
    matmul(
        MatMut::from_row_major_slice_mut(out, count, m),
        Accum::Replace,
        MatRef::from_row_major_slice(&y, count, n),
        MatRef::from_row_major_slice(transposed, n, m),
        1.0,
        Par::Seq,
    );
    Ok(())
}

/// `y^s = xf^s - A^s x0^s`, from zeros.
fn differences(realized: &Realized<'_>, first: usize, y: &mut [f64], stop: &Stop) -> Result<()> {
    let n = realized.n;
    let a = match (&realized.x0, &realized.a) {
        (Entity::Dense(x0), Entity::Exact(a)) => {
            let count = y.len() / n;
            stop.check()?;
            y.chunks_exact_mut(n).enumerate().for_each(|(at, y)| set_goal(realized, first + at, y));
            // Y = Xf - X0 A^T
            matmul(
                MatMut::from_row_major_slice_mut(y, count, n),
                Accum::Add,
                MatRef::from_row_major_slice(&x0.values()[first * n..(first + count) * n], count, n),
                MatRef::from_row_major_slice(a, n, n).transpose(),
                -1.0,
                Par::Seq,
            );
            return Ok(());
        }
        (Entity::Dense(_) | Entity::Exact(_), Entity::Dense(a)) => a,
        _ => return few_differences(realized, first, y, stop),
    };
    for (at, y) in y.chunks_exact_mut(n).enumerate() {
        if at % (STEP / (n * n) + 1) == 0 {
            stop.check()?;
        }
        let s = first + at;
        set_goal(realized, s, y);
        let x = match &realized.x0 {
            Entity::Dense(x0) => x0.row(s),
            Entity::Exact(x0) => x0,
            Entity::Singletons { .. } => &[], // excluded above
        };
        subtract_product(a.row(s), x, y);
    }
    Ok(())
}

/// `y = xf^s`, over zeros.
fn set_goal(realized: &Realized<'_>, s: usize, y: &mut [f64]) {
    match &realized.xf {
        Entity::Exact(xf) => y.copy_from_slice(xf),
        Entity::Dense(xf) => y.copy_from_slice(xf.row(s)),
        Entity::Singletons { .. } => realized.goal(s, |i, v| y[i] += v),
    }
}

/// The same, contribution by contribution, if there are few.
fn few_differences(realized: &Realized<'_>, first: usize, y: &mut [f64], stop: &Stop) -> Result<()> {
    for (at, y) in y.chunks_exact_mut(realized.n).enumerate() {
        stop.check()?;
        realized.contributions(first + at, |i, v| y[i] += v);
    }
    Ok(())
}

/// Prefetch distance in entries of `A`: one page of 4 KiB, the limit of the hardware prefetcher.
const AHEAD: usize = 512;

/// Doubles in one cache line.
const CACHE_LINE: usize = 8;

/// Most entries to prefetch for one row or small matrix: with more, the prefetches delayed the loads they should have
/// helped (measured).
const ASK: usize = 128;

/// Prefetches as many entries as `values` has, `AHEAD` further on.
#[inline(always)]
fn prefetch_as_many(values: &[f64]) {
    if values.len() <= ASK {
        (0..values.len()).step_by(CACHE_LINE).for_each(|k| prefetch(values, AHEAD + k));
    }
}

/// `y -= A x`. Short rows are taken four at a time; for long rows this was slower, because it reads memory in four
/// places.
#[inline(never)]
fn subtract_product(a: &[f64], x: &[f64], y: &mut [f64]) {
    match x.len() {
        4 => subtract_short::<1>(a, x, y),
        5..=8 => subtract_short::<2>(a, x, y),
        9..=12 => subtract_short::<3>(a, x, y),
        13..=16 => subtract_short::<4>(a, x, y),
        17..=20 => subtract_short::<5>(a, x, y),
        21..=24 => subtract_short::<6>(a, x, y),
        25..=28 => subtract_short::<7>(a, x, y),
        29..=32 => subtract_short::<8>(a, x, y),
        n => y.iter_mut().zip(a.chunks_exact(n)).for_each(|(y, row)| {
            prefetch_as_many(row);
            *y -= dot(row, x);
        }),
    }
}

/// The same for rows of `4 (FOURS - 1) < n <= 4 FOURS` entries: groups of four, then the last four of the row, which
/// may overlap the groups; `x` counts as zero in the overlap.
#[inline(always)]
fn subtract_short<const FOURS: usize>(a: &[f64], x: &[f64], y: &mut [f64]) {
    prefetch_as_many(a);
    let n = x.len();
    let (whole, _) = x.as_chunks::<4>();
    let mut fours = [[0.0; 4]; FOURS];
    fours.iter_mut().zip(&whole[..FOURS - 1]).for_each(|(four, x)| *four = *x);
    for k in 4 * (FOURS - 1)..n {
        fours[FOURS - 1][k + 4 - n] = x[k];
    }
    #[cfg(target_arch = "x86_64")]
    let done = crate::simd::subtract_short(a, n, &fours, y);
    #[cfg(not(target_arch = "x86_64"))]
    let done = 0;
    for (y, row) in y[done..].iter_mut().zip(a[done * n..].chunks_exact(n)) {
        *y -= short_dot(row, &fours);
    }
}

/// Four sums, lane by lane, then `(s_0 + s_1) + (s_2 + s_3)`: the order of additions in `crate::simd`.
#[inline(always)]
fn short_dot<const FOURS: usize>(row: &[f64], x: &[[f64; 4]; FOURS]) -> f64 {
    let last = row.len() - 4;
    let mut s = [0.0; 4];
    for (i, x) in x.iter().enumerate() {
        let at = (4 * i).min(last);
        for (k, (a, x)) in row[at..at + 4].iter().zip(x).enumerate() {
            s[k] = if i == 0 { a * x } else { s[k] + a * x };
        }
    }
    (s[0] + s[1]) + (s[2] + s[3])
}

/// `<a, b>` in eight independent sums, so that an addition does not wait for the one before.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a8, a_rest) = a.as_chunks::<8>();
    let (b8, b_rest) = b.as_chunks::<8>();
    let mut s = [0.0; 8];
    for (a, b) in a8.iter().zip(b8) {
        for k in 0..8 {
            s[k] += a[k] * b[k];
        }
    }
    let mut last = 0.0;
    for (a, b) in a_rest.iter().zip(b_rest) {
        last += a * b;
    }
    ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])) + last
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Key;

    /// A single row takes the portable loop, four rows together that of wider registers where available: same bits.
    /// With small integers, where no sum is rounded, both are exact.
    #[test]
    fn short_rows_give_the_same_bits_alone_and_together() {
        let mut lanes = Key([8; 32]).lanes(0, 0);
        for n in 1..=40 {
            let mut draw = |len: usize| -> Vec<f64> {
                let steps = std::iter::repeat_with(|| lanes.step()).take(len.div_ceil(8));
                steps.flatten().take(len).map(|word| (word >> 11) as f64 / 2.0_f64.powi(52) - 1.0).collect()
            };
            let (a, x, start) = (draw(n * n), draw(n), draw(n));
            let (mut together, mut alone) = (start.clone(), start);
            subtract_product(&a, &x, &mut together);
            alone.iter_mut().zip(a.chunks_exact(n)).for_each(|(y, row)| {
                subtract_product(row, &x, std::slice::from_mut(y));
            });
            assert_eq!(together, alone, "n = {n}");

            let whole = |v: &[f64]| -> Vec<f64> { v.iter().map(|v| (v * 1000.0).round()).collect() };
            let (a, x, mut y) = (whole(&a), whole(&x), vec![0.0; n]);
            subtract_product(&a, &x, &mut y);
            for (row, y) in a.chunks_exact(n).zip(&y) {
                let exact: i64 = row.iter().zip(&x).map(|(a, x)| *a as i64 * *x as i64).sum();
                assert_eq!(-exact, *y as i64, "n = {n}");
            }
        }
    }
}
