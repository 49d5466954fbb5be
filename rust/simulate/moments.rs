//! Means and covariances over runs, without storing the runs.
//!
//! The sums are over deviations from the exact trajectory, which is the mean, so nothing cancels. Sums of fixed groups
//! of runs are added in a fixed binary tree. The result does not depend on the number of threads, and its rounding
//! error grows only with the logarithm of the number of runs.

use std::collections::HashMap;
use std::sync::Mutex;

use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, MatMut, MatRef, Par};

use super::block::{RUNS, Row, States};
use crate::error::{Error, Result};
use crate::memory::{checked_len, room_for_products, try_collect, try_zeros};

/// The second moments to compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Second {
    /// Variances: n numbers per time.
    Diagonal,
    /// Covariances: n^2 numbers per time.
    Full,
}

/// Moments of `count` runs; arrays are `(K + 1) * n`, the covariance `(K + 1) * n * n`.
#[derive(Debug, Clone, PartialEq)]
pub struct Ensemble {
    /// The mean over the runs.
    pub mean: Vec<f64>,
    /// The unbiased variance over the runs; `None` for one run.
    pub variance: Option<Vec<f64>>,
    /// The unbiased covariance over the runs; `None` for one run, or if only variances are wanted.
    pub covariance: Option<Vec<f64>>,
    /// The runs themselves, `count * (K + 1) * n`, if they are kept; otherwise empty.
    pub runs: Vec<f64>,
}

/// `sum d` and `sum d d^T` (or its diagonal) for every time, `d = x - center`.
pub(super) struct Sums<'a> {
    center: &'a [f64],
    n: usize,
    second: Second,
    sum: Vec<f64>,
    squares: Vec<f64>,
    /// deviations of one block, or of one run
    scratch: Vec<f64>,
}

impl<'a> Sums<'a> {
    /// Zero sums; `center` has n entries for every time.
    pub(super) fn new(center: &'a [f64], n: usize, second: Second) -> Result<Self> {
        if second == Second::Full {
            room_for_products()?;
        }
        let (what, width) = ("the sums over the runs", if second == Second::Full { n } else { 1 });
        Ok(Self {
            center,
            n,
            second,
            sum: try_zeros(what, center.len())?,
            squares: try_zeros(what, checked_len(what, center.len(), width)?)?,
            scratch: try_zeros(what, if second == Second::Full { checked_len(what, n, RUNS)? } else { n })?,
        })
    }

    /// Adds the states of the first `count` runs of a block at time `k`.
    pub(super) fn add(&mut self, k: usize, states: &States, count: usize) {
        match (self.second, states) {
            (Second::Diagonal, States::Rows(rows)) => self.add_rows(k, rows, count),
            (Second::Diagonal, States::Singles { indices, values }) => {
                self.add_singles(k, &indices[..count], &values[..count]);
            }
            (Second::Full, _) => self.add_products(k, states, count),
        }
    }

    fn add_rows(&mut self, k: usize, rows: &[Row], count: usize) {
        let at = k * self.n..(k + 1) * self.n;
        let sums = self.sum[at.clone()].iter_mut().zip(&mut self.squares[at.clone()]);
        for ((row, center), (sum, square)) in rows.iter().zip(&self.center[at]).zip(sums) {
            let (mut first, mut second) = ([0.0; 8], [0.0; 8]);
            let (eights, rest) = row[..count].as_chunks::<8>();
            for eight in eights {
                for l in 0..8 {
                    let d = eight[l] - center;
                    first[l] += d;
                    second[l] += d * d;
                }
            }
            for (l, x) in rest.iter().enumerate() {
                let d = x - center;
                first[l] += d;
                second[l] += d * d;
            }
            *sum += first.iter().sum::<f64>();
            *square += second.iter().sum::<f64>();
        }
    }

    /// Runs that hit a state deviate by their value there; the others by minus the center.
    fn add_singles(&mut self, k: usize, indices: &[u32], values: &[f64]) {
        let at = k * self.n..(k + 1) * self.n;
        let (center, sum, square) = (&self.center[at.clone()], &mut self.sum[at.clone()], &mut self.squares[at]);
        let count = values.len() as f64;
        for ((c, sum), square) in center.iter().zip(sum.iter_mut()).zip(square.iter_mut()) {
            *sum -= count * c;
            *square += count * (c * c);
        }
        for (&i, v) in indices.iter().zip(values) {
            let i = i as usize;
            sum[i] += v;
            square[i] += v * (v - 2.0 * center[i]);
        }
    }

    fn add_products(&mut self, k: usize, states: &States, count: usize) {
        let n = self.n;
        let center = &self.center[k * n..(k + 1) * n];
        let deviations = self.scratch.as_chunks_mut::<RUNS>().0;
        match states {
            States::Rows(rows) => {
                for ((to, row), c) in deviations.iter_mut().zip(*rows).zip(center) {
                    *to = row.map(|x| x - c);
                }
            }
            States::Singles { indices, values } => {
                deviations.iter_mut().zip(center).for_each(|(to, c)| *to = [-c; RUNS]);
                for (s, (&i, v)) in indices.iter().zip(*values).enumerate() {
                    deviations[i as usize][s] = v - center[i as usize];
                }
            }
        }
        for (row, sum) in deviations.iter_mut().zip(&mut self.sum[k * n..]) {
            row[count..].fill(0.0);
            let mut lanes = [0.0; 8];
            row.as_chunks::<8>().0.iter().for_each(|eight| (0..8).for_each(|l| lanes[l] += eight[l]));
            *sum += lanes.iter().sum::<f64>();
        }
        let d = MatRef::from_row_major_slice(&self.scratch, n, RUNS);
        let out = MatMut::from_column_major_slice_mut(&mut self.squares[k * n * n..(k + 1) * n * n], n, n);
        use BlockStructure::{Rectangular, TriangularLower};
        matmul(out, TriangularLower, Accum::Add, d, Rectangular, d.transpose(), Rectangular, 1.0, Par::Seq);
    }

    /// Adds one run at time `k`.
    pub(super) fn add_one(&mut self, k: usize, x: &[f64]) {
        let n = self.n;
        let center = &self.center[k * n..(k + 1) * n];
        let d = &mut self.scratch[..n];
        d.iter_mut().zip(x.iter().zip(center)).for_each(|(d, (x, c))| *d = x - c);
        self.sum[k * n..].iter_mut().zip(&*d).for_each(|(sum, d)| *sum += d);
        match self.second {
            Second::Diagonal => self.squares[k * n..].iter_mut().zip(&*d).for_each(|(sum, d)| *sum += d * d),
            Second::Full => {
                for (j, column) in self.squares[k * n * n..].chunks_exact_mut(n).take(n).enumerate() {
                    column[j..].iter_mut().zip(&d[j..]).for_each(|(sum, di)| *sum += di * d[j]);
                }
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        self.sum.iter_mut().zip(&other.sum).for_each(|(a, b)| *a += b);
        self.squares.iter_mut().zip(&other.squares).for_each(|(a, b)| *a += b);
    }

    /// Mean, variance and covariance of `count` runs.
    fn finish(mut self, count: usize, runs: Vec<f64>) -> Result<Ensemble> {
        let (n, size) = (self.n, count as f64);
        let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
        if !finite(&self.sum) {
            return Err(Error::Overflow { what: "a state of the ensemble" });
        }
        let mean: Vec<f64> = try_collect("the mean", self.center.iter().zip(&self.sum).map(|(c, sum)| c + sum / size))?;
        if count == 1 {
            return Ok(Ensemble { mean, variance: None, covariance: None, runs });
        }
        // before clipping, which would hide a NaN
        if !finite(&self.squares) || !finite(&mean) {
            return Err(Error::Overflow { what: "a second moment of the ensemble" });
        }
        // (sum d d^T - (sum d)(sum d)^T / N) / (N - 1); the second term corrects for the distance of the mean from the
        // center
        let unbiased = |square: f64, a: f64, b: f64| (square - a * (b / size)) / (size - 1.0);
        let mut variance: Vec<f64> = try_zeros("the variance", mean.len())?;
        for (k, (variance, sum)) in variance.chunks_exact_mut(n).zip(self.sum.chunks_exact(n)).enumerate() {
            if self.second == Second::Diagonal {
                let squares = &self.squares[k * n..];
                for (i, to) in variance.iter_mut().enumerate() {
                    *to = unbiased(squares[i], sum[i], sum[i]).max(0.0);
                }
                continue;
            }
            let squares = &mut self.squares[k * n * n..(k + 1) * n * n];
            for j in 0..n {
                for i in j..n {
                    let value = unbiased(squares[j * n + i], sum[i], sum[j]);
                    let value = if i == j { value.max(0.0) } else { value };
                    (squares[j * n + i], squares[i * n + j]) = (value, value);
                }
                variance[j] = squares[j * n + j];
            }
        }
        let covariance = (self.second == Second::Full).then_some(self.squares);
        Ok(Ensemble { mean, variance: Some(variance), covariance, runs })
    }
}

/// Sums of the leaves `0, 1, ...`, added as they arrive: node `(l, i)` is the sum of `(l-1, 2i)` and `(l-1, 2i+1)`.
pub(super) struct Tree<'a>(Mutex<HashMap<(u32, usize), Sums<'a>>>);

impl<'a> Tree<'a> {
    pub(super) fn new() -> Self {
        Self(Mutex::new(HashMap::new()))
    }

    /// Adds a leaf; the order of the calls does not matter.
    pub(super) fn insert(&self, leaf: usize, mut sums: Sums<'a>) {
        let (mut level, mut index) = (0, leaf);
        loop {
            let Ok(mut nodes) = self.0.lock() else { return };
            let Some(mut sibling) = nodes.remove(&(level, index ^ 1)) else {
                nodes.insert((level, index), sums);
                return;
            };
            drop(nodes); // other threads may continue meanwhile
            if index % 2 == 0 {
                sums.merge(&sibling);
            } else {
                sibling.merge(&sums);
                sums = sibling;
            }
            (level, index) = (level + 1, index / 2);
        }
    }

    /// The nodes left are the binary digits of the number of leaves; they are added from the right.
    pub(super) fn finish(self, count: usize, runs: Vec<f64>) -> Result<Ensemble> {
        let mut nodes = try_collect("the sums over the runs", self.0.into_inner().unwrap_or_default())?;
        nodes.sort_unstable_by_key(|((level, _), _)| *level);
        let total = nodes.into_iter().map(|(_, sums)| sums).reduce(|right, mut left| {
            left.merge(&right);
            left
        });
        match total {
            Some(total) => total.finish(count, runs),
            None => Err(Error::Numerical("no runs were simulated".into())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and covariance of the columns of `rows` by the textbook's two passes.
    fn two_passes(rows: &[Row], count: usize) -> (Vec<f64>, Vec<f64>) {
        let n = rows.len();
        let mean: Vec<f64> = rows.iter().map(|row| row[..count].iter().sum::<f64>() / count as f64).collect();
        let covariance = (0..n * n).map(|at| {
            let (i, j) = (at / n, at % n);
            let products = (0..count).map(|s| (rows[i][s] - mean[i]) * (rows[j][s] - mean[j]));
            products.sum::<f64>() / (count as f64 - 1.0)
        });
        (mean.clone(), covariance.collect())
    }

    #[test]
    fn all_ways_to_add_give_the_textbook_moments() {
        let indices: [u32; RUNS] = std::array::from_fn(|s| (s * s % 3) as u32);
        let values: Row = std::array::from_fn(|s| 1e3 + (s as f64).sin());
        let rows: Vec<Row> =
            (0..3).map(|i| std::array::from_fn(|s| if indices[s] == i { values[s] } else { 0.0 })).collect();
        let center = [400.0, 500.0, 0.0];
        for count in [2, 7, 8, RUNS] {
            let (mean, covariance) = two_passes(&rows, count);
            for second in [Second::Diagonal, Second::Full] {
                for way in 0..3 {
                    let mut sums = Sums::new(&center, 3, second).unwrap();
                    match way {
                        0 => sums.add(0, &States::Rows(&rows), count),
                        1 => sums.add(0, &States::Singles { indices: &indices, values: &values }, count),
                        _ => (0..count).for_each(|s| sums.add_one(0, &[rows[0][s], rows[1][s], rows[2][s]])),
                    }
                    let found = sums.finish(count, Vec::new()).unwrap();
                    let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12 * 1e6);
                    assert!(close(&found.mean, &mean), "{second:?} {way} {count}");
                    let variance = found.variance.unwrap();
                    assert!(
                        close(&variance, &[covariance[0], covariance[4], covariance[8]]),
                        "{second:?} {way} {count}"
                    );
                    assert_eq!(found.covariance.is_some(), second == Second::Full);
                    assert!(found.covariance.is_none_or(|found| close(&found, &covariance)), "{way} {count}");
                }
            }
        }
    }

    #[test]
    fn leaves_may_come_in_any_order() {
        let center = [0.0];
        let total = |order: &[usize]| {
            let tree = Tree::new();
            for &leaf in order {
                let mut sums = Sums::new(&center, 1, Second::Diagonal).unwrap();
                sums.add_one(0, &[1.0 / (leaf as f64 + 3.0)]);
                tree.insert(leaf, sums);
            }
            tree.finish(order.len(), Vec::new()).unwrap()
        };
        let sorted = total(&(0..13).collect::<Vec<_>>());
        let exact: f64 = (0..13).map(|leaf| 1.0 / (f64::from(leaf) + 3.0)).sum::<f64>() / 13.0;
        assert!((sorted.mean[0] - exact).abs() < 1e-15);
        assert_eq!(total(&[12, 3, 0, 7, 1, 11, 2, 6, 5, 4, 10, 8, 9]), sorted);
    }
}
