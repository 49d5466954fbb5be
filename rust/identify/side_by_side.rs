//! The small systems of eight replicates, side by side in the lanes of a register.

use super::weighted_sums::LANES;
use crate::simd::dispatch::Work;

/// Of the pivots, which are near 1: below, a replicate has no estimate.
const SINGULAR: f64 = 1e-10;

/// One entry of eight matrices.
pub(super) type Eight = [f64; LANES];

/// Eight models `H + (V^-1 right)' white`, one after the other in `models`; without `squares`, `V = I`.
pub(super) struct Eightfold<'a> {
    /// The lower halves of `V = sum k q q'`, packed by rows; overwritten.
    pub squares: Option<&'a mut [Eight]>,
    /// `sum k q e'` (rank, n); overwritten.
    pub right: &'a mut [Eight],
    /// `H` (n, d).
    pub model: &'a [f64],
    /// (rank, d).
    pub white: &'a [f64],
    pub n: usize,
    pub models: &'a mut [f64],
}

impl Work for Eightfold<'_> {
    /// Which replicates have an estimate.
    type Out = [bool; LANES];

    #[inline(always)]
    fn run(self) -> Self::Out {
        let Self { squares, right, model, white, n, models } = self;
        let mut sound = [true; LANES];
        if let Some(lower) = squares {
            let rank = right.len() / n;
            sound = factor(lower, rank);
            substitute(lower, rank, n, right);
        }
        write_models(right, model, white, n, models);
        sound
    }
}

/// `L` of `L L'` in place of the lower half, with the reciprocals of its diagonal; which have no small pivot.
#[inline(always)]
fn factor(a: &mut [Eight], rank: usize) -> [bool; LANES] {
    let mut sound = [true; LANES];
    for i in 0..rank {
        let (done, row) = a.split_at_mut(i * (i + 1) / 2);
        for j in 0..=i {
            let other = &done[(j * (j + 1) / 2).min(done.len())..];
            let mut value = row[j];
            for k in 0..j {
                let b = if j < i { &other[k] } else { &row[k] };
                for l in 0..LANES {
                    value[l] -= row[k][l] * b[l];
                }
            }
            for l in 0..LANES {
                row[j][l] = if j < i {
                    value[l] * other[j][l]
                } else {
                    sound[l] &= value[l] >= SINGULAR;
                    1.0 / value[l].sqrt()
                };
            }
        }
    }
    sound
}

/// `(L L')^-1` times the columns of `right` (rank, n).
#[inline(always)]
fn substitute(lower: &[Eight], rank: usize, n: usize, right: &mut [Eight]) {
    for i in 0..rank {
        let (done, row) = right.split_at_mut(i * n);
        let (factors, pivot) = lower[i * (i + 1) / 2..].split_at(i);
        eliminate(&mut row[..n], done, &pivot[0], factors.iter());
    }
    for i in (0..rank).rev() {
        let (row, below) = right[i * n..].split_at_mut(n);
        let factors = (i + 1..rank).map(|j| &lower[j * (j + 1) / 2 + i]);
        eliminate(row, below, &lower[i * (i + 1) / 2 + i], factors);
    }
}

/// `row <- (row - sum_j factor_j rows_j) pivot`.
#[inline(always)]
fn eliminate<'a>(row: &mut [Eight], rows: &[Eight], pivot: &Eight, factors: impl Iterator<Item = &'a Eight> + Clone) {
    let n = row.len();
    let (fours, rest) = row.as_chunks_mut::<4>();
    let done = 4 * fours.len();
    for (at, four) in fours.iter_mut().enumerate() {
        eliminate_part(four, &rows[(4 * at).min(rows.len())..], n, pivot, factors.clone());
    }
    let (twos, ones) = rest.as_chunks_mut::<2>();
    for two in twos {
        eliminate_part(two, &rows[done.min(rows.len())..], n, pivot, factors.clone());
    }
    for one in ones.as_chunks_mut::<1>().0 {
        eliminate_part(one, &rows[(n - 1).min(rows.len())..], n, pivot, factors.clone());
    }
}

/// The same for `W` neighbouring entries, which stay in registers; every `n`-th entry of `rows` begins theirs.
#[inline(always)]
fn eliminate_part<'a, const W: usize>(
    part: &mut [Eight; W],
    rows: &[Eight],
    n: usize,
    pivot: &Eight,
    factors: impl Iterator<Item = &'a Eight>,
) {
    let mut sums = *part;
    for (j, factor) in factors.enumerate() {
        if let Some(row) = rows[j * n..].first_chunk::<W>() {
            for (sum, row) in sums.iter_mut().zip(row) {
                for l in 0..LANES {
                    sum[l] -= factor[l] * row[l];
                }
            }
        }
    }
    for sum in &mut sums {
        for l in 0..LANES {
            sum[l] *= pivot[l];
        }
    }
    *part = sums;
}

/// `H + right' white` of each of eight, one after the other.
#[inline(always)]
fn write_models(right: &[Eight], model: &[f64], white: &[f64], n: usize, models: &mut [f64]) {
    let d = model.len() / n;
    for i in 0..n {
        let mut c = 0;
        while c + 4 <= d {
            write_part::<4>(right, model, white, (n, d), (i, c), models);
            c += 4;
        }
        while c < d {
            write_part::<1>(right, model, white, (n, d), (i, c), models);
            c += 1;
        }
    }
}

/// `W` neighbouring entries from `(i, c)` on.
#[inline(always)]
fn write_part<const W: usize>(
    right: &[Eight],
    model: &[f64],
    white: &[f64],
    (n, d): (usize, usize),
    (i, c): (usize, usize),
    models: &mut [f64],
) {
    let mut sums = [[0.0; LANES]; W];
    for (w, sum) in sums.iter_mut().enumerate() {
        *sum = [model[i * d + c + w]; LANES];
    }
    for (row, white) in right.chunks_exact(n).zip(white.chunks_exact(d)) {
        let (factor, white) = (&row[i], &white[c..c + W]);
        for (sum, white) in sums.iter_mut().zip(white) {
            for l in 0..LANES {
                sum[l] += factor[l] * white;
            }
        }
    }
    for (l, model) in models.chunks_exact_mut(n * d).enumerate() {
        let to = &mut model[i * d + c..i * d + c + W];
        to.iter_mut().zip(&sums).for_each(|(to, sum)| *to = sum[l]);
    }
}
