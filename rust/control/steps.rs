//! The minimum-norm control over several steps.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use super::pseudoinverse::pseudoinverse;
use crate::error::Result;

/// `u = C_K^+ (xf - A^K x0)` with `C_K = [A^{K-1} B, ..., A B, B]`: the controls of the `steps` steps, in time.
///
/// # Errors
/// As [`pseudoinverse`](super::pseudoinverse()).
pub(crate) fn steps_control(
    a: MatRef<'_, f64>,
    b: MatRef<'_, f64>,
    x0: &[f64],
    xf: &[f64],
    steps: usize,
) -> Result<Vec<f64>> {
    let (n, m) = (b.nrows(), b.ncols());
    let mut c = Mat::<f64>::zeros(n, m * steps);
    let mut free = Mat::from_fn(n, 1, |i, _| x0[i]);
    for k in (0..steps).rev() {
        let mut block = Mat::<f64>::zeros(n, m);
        if k + 1 == steps {
            block.copy_from(b);
        } else {
            matmul(&mut block, Accum::Replace, a, c.as_ref().subcols((k + 1) * m, m), 1.0, Par::Seq);
        }
        c.as_mut().subcols_mut(k * m, m).copy_from(&block);
        let mut next = Mat::<f64>::zeros(n, 1);
        matmul(&mut next, Accum::Replace, a, &free, 1.0, Par::Seq);
        free = next;
    }
    let rows: Vec<f64> = (0..n).flat_map(|i| (0..m * steps).map(move |j| (i, j))).map(|at| c[at]).collect();
    let inverse = pseudoinverse(&rows, n, m * steps)?.matrix;
    let missing: Vec<f64> = xf.iter().enumerate().map(|(i, xf)| xf - free[(i, 0)]).collect();
    Ok(inverse.chunks_exact(n).map(|row| row.iter().zip(&missing).map(|(p, d)| p * d).sum()).collect())
}
