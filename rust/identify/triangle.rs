//! Measured pairs as one triangle: `R` of `[Z Y] = Q R`, the rows of `Z` and `Y` being regressors and outcomes.
//!
//! Rows are taken in blocks that fit a fast cache; `[R; block]` is made triangular again by Householder's reflections.
//! `R' R = [Z Y]' [Z Y]` is never formed: it squares the condition number.

use crate::error::{Error, Result};
use crate::fuse::power_of_two_scale;
use crate::memory::{checked_len, try_copy, try_filled, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::simd::dispatch::{Work, widest};

const WHAT: &str = "a triangle";

/// Rows that one thread reduces at a time; their triangles are merged in order, whatever thread made them.
const CHUNK: usize = 1 << 15;
/// Sums have this many partial sums, so that they are the same on every processor.
const LANES: usize = 8;
/// Rows below which a block is not worth while.
const FEW: usize = 6;
/// Of squares, where every column has an entry above 1e-100 in size.
const NOTHING: f64 = 1e-280;

/// The `k x k` upper triangle `R` with a diagonal `>= 0` of `rows` (`N x k`, row by row): `R' R = rows' rows`.
///
/// Columns are scaled by powers of two where squares would leave the range of doubles.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
pub fn triangle(rows: &[f64], k: usize, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
    let scales = checked_scales(&[rows], k, stop)?;
    let (chunk, square) = (checked_len(WHAT, CHUNK, k)?, checked_len(WHAT, k, k)?);
    let chunks = rows.len().div_ceil(chunk).max(1);
    let mut triangles = try_zeros(WHAT, checked_len(WHAT, chunks, square)?)?;
    for_each_chunk(rows.chunks(chunk).zip(triangles.chunks_mut(square)), threads, stop, |(rows, r)| {
        absorb_rows(r, rows, k, &scales, stop)
    })?;
    let ones = try_filled(WHAT, 1.0, k)?;
    let (r, others) = triangles.split_at_mut(square);
    for other in others.chunks_exact(square) {
        absorb_rows(r, other, k, &ones, stop)?;
    }
    triangles.truncate(square);
    unscale(&mut triangles, &scales)?;
    Ok(triangles)
}

/// Takes more `rows` into the triangle `r` (`k x k`).
///
/// # Errors
/// As [`triangle`]; `r` is undefined after one.
pub fn update(r: &mut [f64], rows: &[f64], k: usize, stop: &Stop) -> Result<()> {
    let scales = checked_scales(&[r, rows], k, stop)?;
    if scales.iter().any(|&s| s != 1.0) {
        r.chunks_exact_mut(k).flat_map(|row| row.iter_mut().zip(&scales)).for_each(|(v, s)| *v /= s);
    }
    absorb_rows(r, rows, k, &scales, stop)?;
    unscale(r, &scales)
}

fn unscale(r: &mut [f64], scales: &[f64]) -> Result<()> {
    r.chunks_exact_mut(scales.len()).flat_map(|row| row.iter_mut().zip(scales)).for_each(|(v, s)| *v *= s);
    if r.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(Error::Overflow { what: "the triangle of the data" }) }
}

/// For each column 1, or a power of two next to its largest entry where squares of it are out of range.
fn checked_scales(parts: &[&[f64]], k: usize, stop: &Stop) -> Result<Vec<f64>> {
    const SAFE: std::ops::RangeInclusive<f64> = 1e-100..=1e100;
    let mut largest = try_zeros(WHAT, k)?;
    for part in parts {
        if k == 0 || !part.len().is_multiple_of(k) {
            return Err(Error::Shape {
                name: "rows",
                expected: format!("rows of {k} entries, at least one"),
                found: format!("{} entries", part.len()),
            });
        }
        for (block, rows) in part.chunks(k << 10).enumerate() {
            stop.check()?;
            let mut sound = 0.0;
            for row in rows.chunks_exact(k) {
                for (m, v) in largest.iter_mut().zip(row) {
                    *m = v.abs().max(*m);
                    sound += v * 0.0; // NaN for one that is not finite
                }
            }
            if sound != 0.0 {
                let at = rows.iter().position(|v| !v.is_finite()).unwrap_or(0);
                return Err(Error::NonFinite { name: "rows", what: "entry", index: block * (k << 10) + at });
            }
        }
    }
    for m in &mut largest {
        *m = if *m == 0.0 || SAFE.contains(m) { 1.0 } else { power_of_two_scale([&*m]) };
    }
    Ok(largest)
}

/// `r <- R of [r; rows / scales]`.
fn absorb_rows(r: &mut [f64], rows: &[f64], k: usize, scales: &[f64], stop: &Stop) -> Result<()> {
    let size = rows.len() / k;
    if size < FEW {
        let mut left = try_copy(WHAT, rows)?;
        widest(Rows { r, rows: &mut left, scales });
        return Ok(());
    }
    // 24 KiB for a block of few columns; columns are its lines, padded by zeros to whole lanes
    let most = (3072 / k).clamp(32, 512).min(size).next_multiple_of(LANES);
    let mut block = try_zeros(WHAT, checked_len(WHAT, k, most)?)?;
    for rows in rows.chunks(most * k) {
        stop.check()?;
        let height = (rows.len() / k).next_multiple_of(LANES);
        let block = &mut block[..k * height];
        widest(Block { r, rows, scales, columns: block, height });
    }
    Ok(())
}

/// Rows to be taken in one by one.
struct Rows<'a> {
    r: &'a mut [f64],
    rows: &'a mut [f64],
    scales: &'a [f64],
}

impl Work for Rows<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        for row in self.rows.chunks_exact_mut(self.scales.len()) {
            rotate(self.r, row, self.scales);
        }
    }
}

/// Rows to be taken in at once, with room for their columns.
struct Block<'a> {
    r: &'a mut [f64],
    rows: &'a [f64],
    scales: &'a [f64],
    columns: &'a mut [f64],
    height: usize,
}

impl Work for Block<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        absorb(self.r, self.rows, self.scales, self.columns, self.height);
    }
}

/// One row: rotations take its entries into the diagonal (Givens).
#[inline(always)]
fn rotate(r: &mut [f64], row: &mut [f64], scales: &[f64]) {
    let k = scales.len();
    row.iter_mut().zip(scales).for_each(|(v, scale)| *v /= scale);
    for j in 0..k {
        let line = &mut r[j * k + j..(j + 1) * k];
        let left = &mut row[j..];
        let squares = left[0] * left[0];
        if squares < NOTHING {
            continue;
        }
        let size = 1.0 / (line[0] * line[0] + squares).sqrt();
        let (c, s) = (line[0] * size, left[0] * size);
        for (line, left) in line.iter_mut().zip(left) {
            (*line, *left) = (c * *line + s * *left, c * *left - s * *line);
        }
    }
}

/// One block. For column `j` the reflection `I - tau v v'`, `v = (r_jj - s, column)`, `s = ||(r_jj, column)||`,
/// `tau = 2 / v'v = 1 / (s (s - r_jj))`, takes it to `(s, 0)` (Golub and Van Loan 2013, 5.1.3).
#[inline(always)]
fn absorb(r: &mut [f64], rows: &[f64], scales: &[f64], block: &mut [f64], height: usize) {
    let k = scales.len();
    for (j, (column, scale)) in block.chunks_exact_mut(height).zip(scales).enumerate() {
        let (filled, padding) = column.split_at_mut(rows.len() / k);
        let inverse = 1.0 / scale;
        filled.iter_mut().zip(rows.chunks_exact(k)).for_each(|(to, row)| *to = row[j] * inverse);
        padding.fill(0.0);
    }
    for j in 0..k {
        let (done, rest) = block.split_at_mut((j + 1) * height);
        let v = &done[j * height..];
        let [squares] = products(v, [v]);
        if squares < NOTHING {
            continue;
        }
        let (diagonal, row) = r[j * k + j..(j + 1) * k].split_at_mut(1);
        let size = (diagonal[0] * diagonal[0] + squares).sqrt();
        let head = -squares / (diagonal[0] + size); // r_jj - s without cancellation
        let tau = -1.0 / (size * head);
        diagonal[0] = size;
        let mut fours = rest.chunks_exact_mut(4 * height);
        let mut entries = row.chunks_exact_mut(4);
        for (four, entries) in fours.by_ref().zip(entries.by_ref()) {
            let (first, second) = four.split_at_mut(2 * height);
            let (a, b) = first.split_at_mut(height);
            let (c, d) = second.split_at_mut(height);
            let w = products(v, [a, b, c, d]);
            let w: [f64; 4] = std::array::from_fn(|i| tau * (head * entries[i] + w[i]));
            entries.iter_mut().zip(w).for_each(|(entry, w)| *entry -= w * head);
            subtract(v, w, [a, b, c, d]);
        }
        for (column, entry) in fours.into_remainder().chunks_exact_mut(height).zip(entries.into_remainder()) {
            let w = tau * (head * *entry + products(v, [column])[0]);
            *entry -= w * head;
            subtract(v, [w], [column]);
        }
    }
}

/// `v' column` for each column.
#[inline(always)]
fn products<const C: usize>(v: &[f64], columns: [&[f64]; C]) -> [f64; C] {
    let v = v.as_chunks::<LANES>().0;
    let columns = columns.map(|column| &column.as_chunks::<LANES>().0[..v.len()]);
    let mut sums = [[0.0; LANES]; C];
    for (t, v) in v.iter().enumerate() {
        for (sum, column) in sums.iter_mut().zip(columns) {
            let column = &column[t];
            for l in 0..LANES {
                sum[l] += v[l] * column[l];
            }
        }
    }
    sums.map(|[a, b, c, d, e, f, g, h]| ((a + b) + (c + d)) + ((e + f) + (g + h)))
}

/// `column -= w v` for each column.
#[inline(always)]
fn subtract<const C: usize>(v: &[f64], w: [f64; C], columns: [&mut [f64]; C]) {
    for (column, w) in columns.into_iter().zip(w) {
        column.iter_mut().zip(v).for_each(|(to, v)| *to -= w * v);
    }
}

#[cfg(test)]
mod tests;
