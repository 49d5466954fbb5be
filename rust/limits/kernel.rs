//! Dense kernels for small matrices: lines padded by zeros to whole groups of [`LANES`] numbers, so that no loop has a
//! remainder. They give the same bits on every processor.

use super::bounds::Bounds;
use crate::simd::LANES;
pub(super) use crate::simd::dispatch::{Work, widest};

/// A function with its body compiled for each width of registers.
macro_rules! kernel {
    ($(#[$doc:meta])* fn $name:ident<$life:lifetime>($($arg:ident: $kind:ty),* $(,)?) -> $out:ty $body:block) => {
        $(#[$doc])*
        pub(super) fn $name<$life>($($arg: $kind),*) -> $out {
            struct Kernel<$life> { $($arg: $kind),* }
            impl<$life> Work for Kernel<$life> {
                type Out = $out;
                #[inline(always)]
                fn run(self) -> $out {
                    let Self { $($arg),* } = self;
                    $body
                }
            }
            widest(Kernel { $($arg),* })
        }
    };
}
pub(super) use kernel;

/// The length of a line of `n` entries.
pub(crate) fn padded(n: usize) -> usize {
    n.next_multiple_of(LANES)
}

/// The first entry of the group of entry `i`.
pub(super) fn group(i: usize) -> usize {
    i - i % LANES
}

/// `<x, y>`, both of whole groups.
#[inline(always)]
pub(super) fn dot(x: &[f64], y: &[f64]) -> f64 {
    dots([x], y)[0]
}

/// `<x_c, y>`, all of whole groups.
#[inline(always)]
fn dots<const C: usize>(x: [&[f64]; C], y: &[f64]) -> [f64; C] {
    let y = y.as_chunks::<LANES>().0;
    let x = x.map(|x| &x.as_chunks::<LANES>().0[..y.len()]);
    let mut s = [[0.0; LANES]; C];
    for (t, y) in y.iter().enumerate() {
        for c in 0..C {
            for l in 0..LANES {
                s[c][l] += x[c][t][l] * y[l];
            }
        }
    }
    s.map(|s| ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])))
}

/// `y += sum_c a_c x_c`, all of whole groups.
#[inline(always)]
pub(super) fn add<const C: usize>(a: [f64; C], x: [&[f64]; C], y: &mut [f64]) {
    let y = y.as_chunks_mut::<LANES>().0;
    let mut groups: [&[[f64; LANES]]; C] = [&[]; C];
    for c in 0..C {
        groups[c] = &x[c].as_chunks::<LANES>().0[..y.len()];
    }
    for (t, y) in y.iter_mut().enumerate() {
        let mut sum = *y;
        for c in 0..C {
            for l in 0..LANES {
                sum[l] += a[c] * groups[c][t][l];
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

/// Entries of rows up to which they stay in the nearest cache, and sums are taken group by group.
const NEAR: usize = 2048;

/// `out += sum_i w_i row_i` over rows of the length of `out`, from entry `from` on; the `w_i` are `stride` apart.
#[inline(always)]
pub(super) fn add_rows(rows: &[f64], weights: &[f64], stride: usize, out: &mut [f64], from: usize) {
    let ld = out.len();
    if rows.len() <= NEAR {
        let mut at = from;
        while at + 2 * LANES <= ld {
            add_groups::<2>(rows, weights, stride, out, at);
            at += 2 * LANES;
        }
        if at < ld {
            add_groups::<1>(rows, weights, stride, out, at);
        }
        return;
    }
    let count = rows.len() / ld;
    let out = &mut out[from..];
    let mut i = 0;
    while i + 4 <= count {
        let (w, x) = (&weights[i * stride..], &rows[i * ld..(i + 4) * ld]);
        let x = [&x[from..ld], &x[ld + from..2 * ld], &x[2 * ld + from..3 * ld], &x[3 * ld + from..]];
        add([w[0], w[stride], w[2 * stride], w[3 * stride]], x, out);
        i += 4;
    }
    while i < count {
        add([weights[i * stride]], [&rows[i * ld + from..(i + 1) * ld]], out);
        i += 1;
    }
}

/// The `G` groups from entry `at` on of [`add_rows`]: their sums stay in registers.
#[inline(always)]
fn add_groups<const G: usize>(rows: &[f64], weights: &[f64], stride: usize, out: &mut [f64], at: usize) {
    let ld = out.len();
    let to = &mut out[at..at + G * LANES].as_chunks_mut::<LANES>().0[..G];
    let mut sums = [[0.0; LANES]; G];
    sums.copy_from_slice(to);
    for (row, w) in rows.chunks_exact(ld).zip(weights.iter().step_by(stride)) {
        let row = &row[at..at + G * LANES].as_chunks::<LANES>().0[..G];
        for g in 0..G {
            for l in 0..LANES {
                sums[g][l] += w * row[g][l];
            }
        }
    }
    to.copy_from_slice(&sums);
}

kernel! {
    /// `out = rows v`, where row `i` has zeros before column `i`.
    fn triangular_times<'a>(rows: &'a [f64], v: &'a [f64], out: &'a mut [f64]) -> () {
        for (i, (out, row)) in out.iter_mut().zip(rows.chunks_exact(v.len())).enumerate() {
            *out = dot(&row[group(i)..], &v[group(i)..]);
        }
    }
}

kernel! {
    /// `out = sum_i w_i line_i` of lines as long as `out`; of a symmetric matrix its product with `w`, as fast as it is
    /// read.
    fn combined<'a>(lines: &'a [f64], w: &'a [f64], out: &'a mut [f64]) -> () {
        out.fill(0.0);
        add_rows(lines, w, 1, out, 0);
    }
}

kernel! {
    /// `residual = rows v - y` and `out += rows' residual`, a few rows at a time: they are read once. `triangular`: row
    /// `i` has zeros before column `i`.
    fn add_gradient<'a>(
        rows: &'a [f64], v: &'a [f64], y: &'a [f64], triangular: bool, residual: &'a mut [f64], out: &'a mut [f64],
    ) -> () {
        let ld = v.len();
        for (b, (rows, (residual, y))) in
            rows.chunks(LANES * ld).zip(residual.chunks_mut(LANES).zip(y.chunks(LANES))).enumerate()
        {
            let from = if triangular { LANES * b } else { 0 };
            let (mut fours, mut to) = (rows.chunks_exact(4 * ld), residual.iter_mut());
            for four in &mut fours {
                let rows = [0, 1, 2, 3].map(|i| &four[i * ld + from..(i + 1) * ld]);
                dots(rows, &v[from..]).into_iter().zip(&mut to).for_each(|(dot, to)| *to = dot);
            }
            fours.remainder().chunks_exact(ld).zip(to).for_each(|(row, to)| *to = dot(&row[from..], &v[from..]));
            residual.iter_mut().zip(y).for_each(|(to, y)| *to -= y);
            add_rows(rows, residual, 1, out, from);
        }
    }
}

kernel! {
    /// `out += sign rows v`
    fn add_times<'a>(rows: &'a [f64], v: &'a [f64], sign: f64, out: &'a mut [f64]) -> () {
        for (out, row) in out.iter_mut().zip(rows.chunks_exact(v.len())) {
            *out += sign * dot(row, v);
        }
    }
}

kernel! {
    /// `out += rows' w`
    fn add_transposed<'a>(rows: &'a [f64], w: &'a [f64], triangular: bool, out: &'a mut [f64]) -> () {
        if triangular {
            let block = LANES * out.len();
            for (b, (rows, w)) in rows.chunks(block).zip(w.chunks(LANES)).enumerate() {
                add_rows(rows, w, 1, out, LANES * b);
            }
        } else {
            add_rows(rows, w, 1, out, 0);
        }
    }
}

kernel! {
    /// `y += a x`
    fn add_line<'a>(a: f64, x: &'a [f64], y: &'a mut [f64]) -> () {
        axpy(a, x, y);
    }
}

/// `out += sum w line_i` over the given `(i, w)`.
pub(super) fn add_lines(lines: &[f64], ld: usize, weights: impl Iterator<Item = (usize, f64)>, out: &mut [f64]) {
    let line = |i: usize| &lines[i * ld..(i + 1) * ld];
    let (mut some, mut count) = ([(0, 0.0); 4], 0);
    for next in weights {
        some[count] = next;
        count += 1;
        if count == some.len() {
            add_four(some.map(|(_, w)| w), some.map(|(i, _)| line(i)), out);
            count = 0;
        }
    }
    some[..count].iter().for_each(|&(i, w)| add_line(w, line(i), out));
}

kernel! {
    /// `y += sum_c a_c x_c`
    fn add_four<'a>(a: [f64; 4], x: [&'a [f64]; 4], y: &'a mut [f64]) -> () {
        add(a, x, y);
    }
}

kernel! {
    /// `out = A B`, or `A' B`, in lines of `ld`; `A` in lines of `la` has `inner` columns, or rows.
    fn small_product<'a>(
        a: &'a [f64], la: usize, transposed: bool, inner: usize, b: &'a [f64], out: &'a mut [f64], ld: usize,
    ) -> () {
        for (i, out) in out.chunks_exact_mut(ld).enumerate() {
            out.fill(0.0);
            let (weights, stride) = if transposed { (&a[i..], la) } else { (&a[i * la..], 1) };
            add_rows(&b[..inner * ld], weights, stride, out, 0);
        }
    }
}

kernel! {
    /// Sweeps of coordinate descent over the inputs with `held = 0`, until one leaves the limits reached as they are:
    /// `u` inside the limits, `g` its half gradient.
    fn descend<'a>(
        h: &'a [f64], curvature: &'a [f64], held: &'a [i8], bounds: Bounds<'a>, sweeps: usize, u: &'a mut [f64],
        g: &'a mut [f64],
    ) -> () {
        let ld = g.len();
        for _ in 0..sweeps {
            let mut same = true;
            for (i, u) in u.iter_mut().enumerate() {
                if held[i] == 0 {
                    let moved = bounds.clip(i, *u - g[i] / curvature[i]);
                    if moved != *u {
                        axpy(moved - *u, &h[i * ld..(i + 1) * ld], g);
                        same &= bounds.reached(i, *u, 0.0) == bounds.reached(i, moved, 0.0);
                        *u = moved;
                    }
                }
            }
            if same {
                break;
            }
        }
    }
}

kernel! {
    /// `x <- (L L')^{-1} x`
    fn solved<'a>(l: &'a [f64], ld: usize, inverse: &'a [f64], x: &'a mut [f64]) -> () {
        forward(l, ld, inverse, x);
        backward(l, ld, inverse, x);
    }
}

/// The block of `L` at the diagonal, column by column, and its `inverse`; zeros where the last one is smaller.
#[inline(always)]
fn diagonal_block(lines: &[f64], ld: usize, from: usize, inverse: &[f64]) -> ([[f64; LANES]; LANES], [f64; LANES]) {
    let (mut block, mut inverses) = ([[0.0; LANES]; LANES], [0.0; LANES]);
    for ((to, line), (to_inverse, inverse)) in
        block.iter_mut().zip(lines.chunks_exact(ld)).zip(inverses.iter_mut().zip(inverse))
    {
        to.copy_from_slice(&line[from..from + LANES]);
        *to_inverse = *inverse;
    }
    (block, inverses)
}

/// `x <- L^{-1} x`
#[inline(always)]
fn forward(l: &[f64], ld: usize, inverse: &[f64], x: &mut [f64]) {
    for (b, (lines, inverse)) in l.chunks(LANES * ld.max(1)).zip(inverse.chunks(LANES)).enumerate() {
        let from = LANES * b;
        let (block, inverse) = diagonal_block(lines, ld, from, inverse);
        let (here, below) = x[from..ld].split_at_mut(LANES);
        let mut v: [f64; LANES] = std::array::from_fn(|i| here[i]);
        for c in 0..LANES {
            v[c] *= inverse[c];
            for i in c + 1..LANES {
                v[i] -= block[c][i] * v[c];
            }
        }
        here.copy_from_slice(&v);
        if !below.is_empty() {
            let columns = std::array::from_fn(|c| &lines[c * ld + from + LANES..(c + 1) * ld]);
            add(v.map(|v| -v), columns, below);
        }
    }
}

/// `x <- L'^{-1} x`
#[inline(always)]
fn backward(l: &[f64], ld: usize, inverse: &[f64], x: &mut [f64]) {
    const HALF: usize = LANES / 2;
    for (b, (lines, inverse)) in l.chunks(LANES * ld.max(1)).zip(inverse.chunks(LANES)).enumerate().rev() {
        let from = LANES * b;
        let (block, inverse) = diagonal_block(lines, ld, from, inverse);
        let (here, below) = x[from..ld].split_at_mut(LANES);
        if !below.is_empty() {
            for (lines, here) in lines.chunks_exact(HALF * ld).zip(here.chunks_exact_mut(HALF)) {
                let sums: [f64; HALF] =
                    dots(std::array::from_fn(|c| &lines[c * ld + from + LANES..(c + 1) * ld]), below);
                here.iter_mut().zip(sums).for_each(|(x, sum)| *x -= sum);
            }
        }
        let mut v: [f64; LANES] = std::array::from_fn(|i| here[i]);
        for i in (0..LANES).rev() {
            v[i] *= inverse[i];
            for c in 0..i {
                v[c] -= block[c][i] * v[i];
            }
        }
        here.copy_from_slice(&v);
    }
}
