//! Dense kernels for small matrices: lines padded by zeros to whole groups of [`LANES`] numbers, so that no loop has a
//! remainder. They give the same bits on every processor.

use crate::lanes::LANES;

#[cfg(target_arch = "x86_64")]
pub(crate) use crate::wide::widest;

#[cfg(not(target_arch = "x86_64"))]
pub(crate) fn widest<T>(work: impl FnOnce() -> T) -> T {
    work()
}

/// The length of a line of `n` entries.
pub(super) fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// The first entry of the group of entry `i`.
fn group(i: usize) -> usize {
    i - i % LANES
}

/// `<x, y>`, both of whole groups.
#[inline(always)]
pub(super) fn dot(x: &[f64], y: &[f64]) -> f64 {
    let mut s = [0.0; LANES];
    for (x, y) in x.as_chunks::<LANES>().0.iter().zip(y.as_chunks::<LANES>().0) {
        for l in 0..LANES {
            s[l] += x[l] * y[l];
        }
    }
    ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]))
}

/// `y += sum_c a_c x_c`, all of whole groups.
#[inline(always)]
fn add<const C: usize>(a: [f64; C], x: [&[f64]; C], y: &mut [f64]) {
    let x = x.map(|x| x.as_chunks::<LANES>().0);
    let y = y.as_chunks_mut::<LANES>().0;
    let x = x.map(|x| &x[..y.len()]);
    for (t, y) in y.iter_mut().enumerate() {
        let mut sum = *y;
        for c in 0..C {
            for l in 0..LANES {
                sum[l] += a[c] * x[c][t][l];
            }
        }
        *y = sum;
    }
}

/// `y += a x`
#[inline(always)]
pub(super) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    add([a], [x], y);
}

/// `out += sum_i w_i row_i` over rows of the length of `out`.
#[inline(always)]
fn add_rows(rows: &[f64], weights: impl Fn(usize) -> f64, out: &mut [f64], from: usize) {
    let ld = out.len();
    let count = rows.len() / ld;
    let row = |i: usize| &rows[i * ld + from..(i + 1) * ld];
    let mut i = 0;
    while i + 4 <= count {
        let four = [i, i + 1, i + 2, i + 3];
        add(four.map(&weights), four.map(row), &mut out[from..]);
        i += 4;
    }
    while i < count {
        add([weights(i)], [row(i)], &mut out[from..]);
        i += 1;
    }
}

/// `out = rows v`; `triangular`: row `i` has zeros before column `i`.
pub(super) fn times(rows: &[f64], v: &[f64], triangular: bool, out: &mut [f64]) {
    widest(|| {
        for (i, (out, row)) in out.iter_mut().zip(rows.chunks_exact(v.len())).enumerate() {
            let from = if triangular { group(i) } else { 0 };
            *out = dot(&row[from..], &v[from..]);
        }
    });
}

/// `out += rows' w`
pub(super) fn add_transposed(rows: &[f64], w: &[f64], triangular: bool, out: &mut [f64]) {
    widest(|| {
        let block = LANES * out.len();
        if triangular {
            for (b, (rows, w)) in rows.chunks(block).zip(w.chunks(LANES)).enumerate() {
                add_rows(rows, |i| w[i], out, LANES * b);
            }
        } else {
            add_rows(rows, |i| w[i], out, 0);
        }
    });
}

/// `out += sum w line_i` over the given `(i, w)`.
pub(super) fn add_lines(lines: &[f64], ld: usize, weights: impl Iterator<Item = (usize, f64)>, out: &mut [f64]) {
    widest(|| weights.for_each(|(i, w)| axpy(w, &lines[i * ld..(i + 1) * ld], out)));
}

/// `h = rows' rows`, `d` lines of the length `ld` of a row.
pub(super) fn gram(rows: &[f64], d: usize, ld: usize, h: &mut [f64]) {
    widest(|| {
        for (i, line) in h.chunks_exact_mut(ld).enumerate() {
            line.fill(0.0);
            add_rows(rows, |r| rows[r * ld + i], line, group(i));
        }
        for i in 0..d {
            for j in 0..i {
                h[i * ld + j] = h[j * ld + i];
            }
        }
    });
}

/// `L L' = A`: the lower triangle of `A` column by column, in lines of `ld`. The diagonal of `L` is kept as its
/// `inverse`; its place and those above it in the group hold zeros, so that solves work on whole groups. False if a pivot
/// is not above rounding.
#[inline(always)]
pub(super) fn cholesky(a: &mut [f64], n: usize, ld: usize, inverse: &mut [f64]) -> bool {
    for j in 0..n {
        let from = group(j);
        let (done, rest) = a.split_at_mut(j * ld);
        let column = &mut rest[from..ld];
        let at = j - from;
        let least = f64::EPSILON * n as f64 * column[at];
        let earlier = |k: usize| &done[k * ld + from..(k + 1) * ld];
        let mut k = 0;
        while k + 4 <= j {
            let four = [k, k + 1, k + 2, k + 3].map(earlier);
            add(four.map(|column| -column[at]), four, column);
            k += 4;
        }
        while k < j {
            add([-earlier(k)[at]], [earlier(k)], column);
            k += 1;
        }
        let pivot = column[at];
        if !(pivot > least && pivot < f64::INFINITY) {
            return false;
        }
        inverse[j] = 1.0 / pivot.sqrt();
        column.iter_mut().for_each(|v| *v *= inverse[j]);
        column[..=at].fill(0.0);
    }
    true
}

/// `x <- L^{-1} x`
#[inline(always)]
pub(super) fn forward(l: &[f64], ld: usize, inverse: &[f64], x: &mut [f64]) {
    for (k, inverse) in inverse.iter().enumerate() {
        x[k] *= inverse;
        let from = group(k);
        axpy(-x[k], &l[k * ld + from..(k + 1) * ld], &mut x[from..ld]);
    }
}

/// `x <- L'^{-1} x`
#[inline(always)]
pub(super) fn backward(l: &[f64], ld: usize, inverse: &[f64], x: &mut [f64]) {
    for (k, inverse) in inverse.iter().enumerate().rev() {
        let from = group(k);
        x[k] = (x[k] - dot(&l[k * ld + from..(k + 1) * ld], &x[from..ld])) * inverse;
    }
}
