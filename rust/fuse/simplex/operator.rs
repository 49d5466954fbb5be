//! The interface of an ensemble for the algorithms: products, subsets, a preconditioner.
//!
//! They take it as `dyn`: its methods are passes over realizations, and one copy of each algorithm serves all kinds.

use std::ops::Range;

use super::triangle::Triangle;
use crate::error::Result;

/// The linear map `S w = sum_i w_i E_i` of an ensemble of `size` realizations in a space of `dim` entries.
///
/// The last realization may be the zero matrix (`weights = "subsimplex"`: `sum w <= 1` is the simplex with one more,
/// empty, realization); the implementations carry it without storing it.
pub(crate) trait Operator: Sync {
    /// Number of realizations, the zero realization included.
    fn size(&self) -> usize;

    /// Number of entries of one realization.
    fn dim(&self) -> usize;

    /// Nonzero entries of one realization: the cost of one sample in one pass.
    fn entries(&self) -> usize;

    /// `out = S w`; entries of `w` that are zero cost nothing.
    fn apply(&self, w: &[f64], out: &mut [f64]) -> Result<()>;

    /// `out = S^T y`
    fn apply_transpose(&self, y: &[f64], out: &mut [f64]) -> Result<()>;

    /// `out = S S^T y`, returning `1^T S^T y`; one pass over the data where possible.
    fn normal(&self, y: &[f64], out: &mut [f64]) -> Result<f64>;

    /// The ensemble of the realizations `keep` (increasing), copied so that it is contiguous.
    fn subset(&self, keep: &[usize]) -> Result<Box<dyn Operator + '_>>;

    /// The first `first` realizations, and enough others that every entry is hit `min(copies, counts)` times;
    /// increasing, with the zero realization.
    fn covering(&self, first: usize, copies: f64, counts: &[f64]) -> Result<Vec<usize>>;

    /// `out[k] = <E_i, E_k>` for `k = 0..=i`, with `i + 1` entries in `out`; `table` is `dim` zeros, before and after.
    fn gram_row(&self, i: usize, table: &mut [f64], out: &mut [f64]);

    /// Adds `sum_i E_i E_i^T` over some of the realizations to `matrix`.
    fn add_outer(&self, samples: Range<usize>, matrix: &mut Triangle) -> Result<()>;

    /// `||E_i||^2`
    fn squared_norm(&self, i: usize) -> f64;

    /// The preconditioner of `S (I - 11^T/K) S^T + mu I` built from all realizations of this ensemble (`K = size`).
    fn block(&self, mu: f64) -> Result<Box<dyn Precondition>>;

    /// `S w - target` in compensated arithmetic, and `S w` rounded.
    fn residual_compensated(&self, w: &[f64], target: &[f64]) -> Result<Residual>;

    /// `<E_i, y>` as an unevaluated sum of two floating point numbers.
    fn value_compensated(&self, i: usize, y: &[f64]) -> (f64, f64);
}

/// An approximate inverse, applied to a residual.
pub(crate) trait Precondition {
    /// `out = M^{-1} r`
    fn solve(&self, r: &[f64], out: &mut [f64]);
}

/// `residual = S w - target` and `image = S w`, each rounded once.
pub(crate) struct Residual {
    pub residual: Vec<f64>,
    pub image: Vec<f64>,
}
