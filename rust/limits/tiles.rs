//! Products, factors and inverses of small symmetric matrices, four lines of the result at a time: each number read is
//! used four times, and sums stay in registers. The same bits on every processor, as in [`super::kernel`].

use super::kernel::{Work, add, group, kernel, widest};
use crate::simd::LANES;

/// Lines of a tile.
const LINES: usize = 4;

type Tile = [[f64; LANES]; LINES];

/// `sum_k w_kc x_kt` over rows `k` of `ld` entries: `c` over the lines of the tile, from entry `at` of each row of `w`,
/// and `t` over the group from entry `from` on of each row of `x`.
#[inline(always)]
fn tile(w: &[f64], at: usize, x: &[f64], from: usize, ld: usize) -> Tile {
    let mut sum = [[0.0; LANES]; LINES];
    for (w, x) in w.chunks_exact(ld).zip(x.chunks_exact(ld)) {
        let (w, x) = (&w[at..at + LINES], &x[from..from + LANES]);
        for c in 0..LINES {
            for l in 0..LANES {
                sum[c][l] += w[c] * x[l];
            }
        }
    }
    sum
}

/// `apply(entry, sum)` over the lines of a tile.
#[inline(always)]
fn put(tile: &Tile, lines: &mut [f64], ld: usize, from: usize, apply: impl Fn(&mut f64, f64)) {
    for (line, sum) in lines.chunks_exact_mut(ld).zip(tile) {
        line[from..from + LANES].iter_mut().zip(sum).for_each(|(to, sum)| apply(to, *sum));
    }
}

kernel! {
    /// `h = rows' rows`, `d` lines of the length `ld` of a row.
    fn gram<'a>(rows: &'a [f64], d: usize, ld: usize, h: &'a mut [f64]) -> () {
        for (b, lines) in h.chunks_mut(LINES * ld).enumerate() {
            for from in (group(LINES * b)..ld).step_by(LANES) {
                put(&tile(rows, LINES * b, rows, from, ld), lines, ld, from, |to, sum| *to = sum);
            }
        }
        mirror(h, d, ld);
    }
}

/// Entries left of the diagonal from those right of it.
pub(super) fn mirror(h: &mut [f64], d: usize, ld: usize) {
    for first in (0..d).step_by(LANES) {
        for i in first..d {
            for j in first..(first + LANES).min(i) {
                h[i * ld + j] = h[j * ld + i];
            }
        }
    }
}

kernel! {
    /// `L L' = A`: the lower triangle of `A` column by column, in lines of `ld`. The diagonal of `L` is kept as its
    /// `inverse`; its place and those above it in the group hold zeros, so that solves work on whole groups. False if a
    /// pivot is not above rounding.
    fn factored<'a>(a: &'a mut [f64], n: usize, ld: usize, inverse: &'a mut [f64]) -> bool {
        let mut start = 0;
        while start < n {
            let (done, rest) = a.split_at_mut(start * ld);
            let lines = &mut rest[..LINES.min(n - start) * ld];
            let left = group(start);
            let mut least = [0.0; LINES];
            for (c, line) in lines.chunks_exact(ld).enumerate() {
                least[c] = f64::EPSILON * n as f64 * line[start + c];
            }
            for from in (left..ld).step_by(LANES) {
                put(&tile(done, start, done, from, ld), lines, ld, from, |to, sum| *to -= sum);
            }
            for (c, &least) in least.iter().enumerate().take(lines.len() / ld) {
                let (before, now) = lines.split_at_mut(c * ld);
                let (j, column) = (start + c, &mut now[left..ld]);
                for x in before.chunks_exact(ld) {
                    add([-x[j]], [&x[left..]], column);
                }
                let pivot = column[j - left];
                if !(pivot > least && pivot < f64::INFINITY) {
                    return false;
                }
                inverse[j] = 1.0 / pivot.sqrt();
                column.iter_mut().for_each(|v| *v *= inverse[j]);
                column[..j - left].fill(0.0);
                column[j - left] = 0.0;
            }
            start += LINES;
        }
        true
    }
}

kernel! {
    /// `out = (L L')^{-1}` of `n` lines, from [`factored`]; `x` takes `L^{-1}` row by row; lines are padded by zeros.
    fn inverted<'a>(
        l: &'a [f64], n: usize, ld: usize, inverse: &'a [f64], x: &'a mut [f64], out: &'a mut [f64],
    ) -> () {
        x.fill(0.0);
        // X_k = (e_k - sum_{j<k} L_kj X_j) / L_kk
        for start in (0..n).step_by(LINES) {
            let (done, rest) = x.split_at_mut(start * ld);
            let lines = &mut rest[..LINES.min(n - start) * ld];
            for from in (0..start).step_by(LANES) {
                let sum = tile(&l[from * ld..start * ld], start, &done[from * ld..], from, ld);
                put(&sum, lines, ld, from, |to, sum| *to = -sum);
            }
            let upto = group(start) + LANES;
            for c in 0..lines.len() / ld {
                let (before, now) = lines.split_at_mut(c * ld);
                let (k, now) = (start + c, &mut now[..upto]);
                for (j, x) in before.chunks_exact(ld).enumerate() {
                    add([-l[(start + j) * ld + k]], [&x[..upto]], now);
                }
                now[k] = 1.0;
                now.iter_mut().for_each(|v| *v *= inverse[k]);
            }
        }
        // X'X, of which row k of X has k + 1 entries
        for (b, lines) in out.chunks_mut(LINES * ld).enumerate() {
            for from in (group(LINES * b)..ld).step_by(LANES) {
                let x = &x[from * ld..];
                put(&tile(x, LINES * b, x, from, ld), lines, ld, from, |to, sum| *to = sum);
            }
        }
        mirror(out, n, ld);
    }
}
