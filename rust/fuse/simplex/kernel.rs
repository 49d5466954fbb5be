//! The two inner loops: read a table at the indices of one sample, add a weight there.
//!
//! Plain scalar loads: AVX gathers were slower, and reads without bounds checks not faster than four samples at a time
//! (measured).

use crate::sample::Index;

/// `out[i] = sum_j table[j * length + rows_ij]` for the samples in `rows`, `lines` indices each.
///
/// Four samples at a time: one bounds check on the line serves four reads, and the four sums are independent.
pub(crate) fn gather<I: Index>(rows: &[I], lines: usize, length: usize, table: &[f64], out: &mut [f64]) {
    let (fours, tail) = out.as_chunks_mut::<4>();
    let (blocks, tail_rows) = rows.split_at(fours.len() * 4 * lines);
    for (rows, out) in blocks.chunks_exact(4 * lines).zip(fours) {
        let (ab, cd) = rows.split_at(2 * lines);
        let ((a, b), (c, d)) = (ab.split_at(lines), cd.split_at(lines));
        let mut sums = [0.0; 4];
        for ((((line, a), b), c), d) in table.chunks_exact(length).zip(a).zip(b).zip(c).zip(d) {
            sums[0] += line[a.get()];
            sums[1] += line[b.get()];
            sums[2] += line[c.get()];
            sums[3] += line[d.get()];
        }
        *out = sums;
    }
    for (row, out) in tail_rows.chunks_exact(lines).zip(tail) {
        *out = row.iter().zip(table.chunks_exact(length)).map(|(r, line)| line[r.get()]).sum();
    }
}

/// `out[j * length + row_j] += w` for every line `j`, four lines together.
#[inline]
pub(crate) fn scatter<I: Index>(row: &[I], length: usize, w: f64, out: &mut [f64]) {
    let (fours, tail) = row.as_chunks::<4>();
    let mut lines = out.chunks_exact_mut(4 * length);
    for (r, four) in fours.iter().zip(lines.by_ref()) {
        let (ab, cd) = four.split_at_mut(2 * length);
        let ((a, b), (c, d)) = (ab.split_at_mut(length), cd.split_at_mut(length));
        a[r[0].get()] += w;
        b[r[1].get()] += w;
        c[r[2].get()] += w;
        d[r[3].get()] += w;
    }
    for (r, line) in tail.iter().zip(lines.into_remainder().chunks_exact_mut(length)) {
        line[r.get()] += w;
    }
}
