//! Cholesky factor of a small symmetric positive definite matrix, lower triangle packed by rows.
//!
//! Left-looking and blocked: rows are contiguous, so every update is a bundle of row-by-row scalar products that vectorises
//! without intrinsics.

/// Columns factored together.
const BLOCK: usize = 48;
/// Depth of one bundle of scalar products; two rows of it fit the first cache many times.
const DEPTH: usize = 256;

/// First entry of row `i`.
fn row(i: usize) -> usize {
    i * (i + 1) / 2
}

/// `M = L L^T`
pub(crate) struct Factor {
    lower: Vec<f64>,
    size: usize,
}

impl Factor {
    /// Factors the packed lower triangle `matrix` in place; `None` if a pivot is not positive.
    pub fn new(mut matrix: Vec<f64>, size: usize) -> Option<Self> {
        let mut panel = vec![0.0; BLOCK * size];
        for start in (0..size).step_by(BLOCK) {
            let end = (start + BLOCK).min(size);
            let width = end - start;
            // The rows of the diagonal block, copied so that the rows below can be updated against them.
            for (k, i) in (start..end).enumerate() {
                panel[k * size..k * size + start].copy_from_slice(&matrix[row(i)..row(i) + start]);
            }
            // A_ij -= sum_{p < start} L_ip L_jp
            for first in (start..size).step_by(2) {
                let second = (first + 1).min(size - 1);
                let mut sums = [[0.0; BLOCK]; 2];
                for depth in (0..start).step_by(DEPTH) {
                    let span = depth..(depth + DEPTH).min(start);
                    let a = &matrix[row(first) + span.start..row(first) + span.end];
                    let b = &matrix[row(second) + span.start..row(second) + span.end];
                    let [out_a, out_b] = &mut sums;
                    bundle(a, b, &panel[span.start..], size, &mut out_a[..width], &mut out_b[..width], span.len());
                }
                for (i, sums) in [(first, &sums[0]), (second, &sums[1])].into_iter().take(1 + second - first) {
                    let stop = end.min(i + 1);
                    for (a, s) in matrix[row(i) + start..row(i) + stop].iter_mut().zip(sums) {
                        *a -= s;
                    }
                }
            }
            // The diagonal block, then the rows below against it: L_ij = (A_ij - sum_{p < j} L_ip L_jp) / L_jj
            let mut corner = [[0.0; BLOCK]; BLOCK];
            for i in start..size {
                let (offset, stop) = (row(i) + start, end.min(i + 1));
                let line = &mut matrix[offset..offset + stop - start];
                for j in 0..line.len() {
                    let (before, rest) = line.split_at_mut(j);
                    let Some(value) = rest.first_mut() else { continue };
                    if start + j == i {
                        let pivot = *value - super::vector::dot(before, before);
                        if !(pivot > 0.0 && pivot.is_finite()) {
                            return None;
                        }
                        *value = pivot.sqrt();
                    } else {
                        *value = (*value - super::vector::dot(before, &corner[j][..j])) / corner[j][j];
                    }
                }
                if i < end {
                    corner[i - start][..line.len()].copy_from_slice(line);
                }
            }
        }
        Some(Self { lower: matrix, size })
    }

    /// `x <- M^{-1} x`
    pub fn solve(&self, x: &mut [f64]) {
        // L y = x
        for i in 0..self.size {
            let line = &self.lower[row(i)..row(i + 1)];
            let (before, rest) = x.split_at_mut(i);
            if let (Some(v), Some(pivot)) = (rest.first_mut(), line.last()) {
                *v = (*v - super::vector::dot(&line[..i], before)) / pivot;
            }
        }
        // L^T x = y
        for i in (0..self.size).rev() {
            let line = &self.lower[row(i)..row(i + 1)];
            let (before, rest) = x.split_at_mut(i);
            if let (Some(v), Some(pivot)) = (rest.first_mut(), line.last()) {
                *v /= pivot;
                super::vector::axpy(-*v, &line[..i], before);
            }
        }
    }
}

/// `out_a[k] += <a, c_k>`, `out_b[k] += <b, c_k>` for the rows `c_k = panel[k * stride..][..depth]`, four at a time.
fn bundle(a: &[f64], b: &[f64], panel: &[f64], stride: usize, out_a: &mut [f64], out_b: &mut [f64], depth: usize) {
    let width = out_a.len();
    let line = |k: usize| &panel[k * stride..k * stride + depth];
    let mut k = 0;
    while k + 4 <= width {
        let c = [line(k), line(k + 1), line(k + 2), line(k + 3)];
        let (sum_a, sum_b) = two_by_four(a, b, c);
        for t in 0..4 {
            out_a[k + t] += sum_a[t];
            out_b[k + t] += sum_b[t];
        }
        k += 4;
    }
    while k < width {
        out_a[k] += super::vector::dot(a, line(k));
        out_b[k] += super::vector::dot(b, line(k));
        k += 1;
    }
}

#[inline(always)]
fn two_by_four(a: &[f64], b: &[f64], c: [&[f64]; 4]) -> ([f64; 4], [f64; 4]) {
    let (a2, a_tail) = a.as_chunks::<2>();
    let (b2, b_tail) = b.as_chunks::<2>();
    let ((c0, t0), (c1, t1)) = (c[0].as_chunks::<2>(), c[1].as_chunks::<2>());
    let ((c2, t2), (c3, t3)) = (c[2].as_chunks::<2>(), c[3].as_chunks::<2>());
    let (mut sa, mut sb) = ([[0.0; 2]; 4], [[0.0; 2]; 4]);
    for (((((a, b), c0), c1), c2), c3) in a2.iter().zip(b2).zip(c0).zip(c1).zip(c2).zip(c3) {
        for l in 0..2 {
            sa[0][l] += a[l] * c0[l];
            sa[1][l] += a[l] * c1[l];
            sa[2][l] += a[l] * c2[l];
            sa[3][l] += a[l] * c3[l];
            sb[0][l] += b[l] * c0[l];
            sb[1][l] += b[l] * c1[l];
            sb[2][l] += b[l] * c2[l];
            sb[3][l] += b[l] * c3[l];
        }
    }
    let (mut out_a, mut out_b) = (sa.map(|s| s[0] + s[1]), sb.map(|s| s[0] + s[1]));
    if let (Some(a), Some(b)) = (a_tail.first(), b_tail.first()) {
        for (k, t) in [t0, t1, t2, t3].into_iter().enumerate() {
            if let Some(t) = t.first() {
                out_a[k] += a * t;
                out_b[k] += b * t;
            }
        }
    }
    (out_a, out_b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_random_matrix_is_solved_to_rounding() {
        for size in [1, 2, 5, 47, 48, 49, 97, 301] {
            let entry =
                |i: usize, j: usize| if i == j { size as f64 } else { ((i * 7 + j * 13) % 11) as f64 / 11.0 - 0.3 };
            let matrix: Vec<f64> =
                (0..size).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|(i, j)| entry(i, j)).collect();
            let x: Vec<f64> = (0..size).map(|i| (i as f64).sin()).collect();
            let mut b: Vec<f64> =
                (0..size).map(|i| (0..size).map(|j| entry(i.max(j), i.min(j)) * x[j]).sum()).collect();
            Factor::new(matrix, size).unwrap().solve(&mut b);
            for (b, x) in b.iter().zip(&x) {
                assert!((b - x).abs() < 1e-12, "size {size}: {b} {x}");
            }
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        assert!(Factor::new(vec![1.0, 2.0, 1.0], 2).is_none());
    }
}
