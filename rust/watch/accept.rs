//! Whether two logs in open loop are of one plant.

use faer::{MatMut, MatRef};

use crate::error::{Error, Result};
use crate::identify::{Fitted, cholesky, roy_quantile, spectral_norm, whiten};
use crate::memory::try_zeros;
use crate::parallel::Stop;
use crate::vector::dot;

use super::frame::WHAT;

/// The exact test of two logs.
#[derive(Debug, Clone, Copy)]
pub struct OpenLoop {
    /// `lmax((S_1 + S_2)^-1 D K^-1 D')`.
    pub statistic: f64,
    /// Its quantile at the level, by Roy's law.
    pub limit: f64,
    /// Rank of the second regressors, and degrees of freedom.
    pub sizes: (usize, usize),
}

/// The regressors of both logs independent of all noise, Gaussian of one covariance: for one plant
///
/// ```text
/// lmax((S_1 + S_2)^-1 D K^-1 D') ~ Roy(n, r, N_1 - d + N_2 - r),   D = (H_2 - H_1) U,   K = U' (V_2^+ + V_1^-1) U
/// ```
///
/// with U a basis of the range of `Z_2`, of rank r: any number of pairs, also inputs that never moved.
///
/// # Errors
/// [`Error::Value`] where the first log does not determine the model, or too few degrees are left; [`Error::Memory`].
pub fn open_loop(one: &Fitted, other: &Fitted, level: f64, threads: usize, stop: &Stop) -> Result<OpenLoop> {
    let (n, d, r) = (one.rows.len(), one.columns.len(), other.rank());
    let degrees = one.degrees() + other.degrees();
    if one.rank() < d || r == 0 || degrees < n {
        let found = format!("rank {} of {d}, {r}, and {degrees} degrees of freedom", one.rank());
        return Err(Error::Value { name: "runs", expected: "enough for the test of two logs", found });
    }
    // U = root_2': K = I + G G', G = root_2 white_1'
    let mut k = try_zeros::<f64>(WHAT, r * r)?;
    let mut g = try_zeros::<f64>(WHAT, r * d)?;
    for (to, root) in g.chunks_exact_mut(d).zip(other.root.chunks_exact(d)) {
        to.iter_mut().zip(one.white.chunks_exact(d)).for_each(|(to, w)| *to = dot(root, w));
    }
    for (at, to) in k.iter_mut().enumerate() {
        let (i, j) = (at / r, at % r);
        *to = f64::from(u8::from(i == j)) + dot(&g[i * d..(i + 1) * d], &g[j * d..(j + 1) * d]);
    }
    let mut shape = try_zeros::<f64>(WHAT, n * n)?;
    shape.iter_mut().zip(one.residual.iter().zip(&other.residual)).for_each(|(to, (a, b))| *to = a + b);
    let lost = || Error::Numerical("the residuals of both logs are singular".into());
    let (of_k, of_s) = (cholesky(&k, r)?.ok_or_else(lost)?, cholesky(&shape, n)?.ok_or_else(lost)?);
    let mut off = try_zeros::<f64>(WHAT, n * r)?;
    for (i, row) in off.chunks_exact_mut(r).enumerate() {
        let (a, b) = (&other.model[i * d..(i + 1) * d], &one.model[i * d..(i + 1) * d]);
        for (to, root) in row.iter_mut().zip(other.root.chunks_exact(d)) {
            *to = a.iter().zip(b).zip(root).map(|((a, b), z)| (a - b) * z).sum();
        }
    }
    let mut both = MatMut::from_row_major_slice_mut(&mut off, n, r);
    whiten(MatRef::from_row_major_slice(&of_k, r, r), both.as_mut().transpose_mut());
    whiten(MatRef::from_row_major_slice(&of_s, n, n), both);
    let statistic = spectral_norm(&off, n, r)?.powi(2);
    Ok(OpenLoop { statistic, limit: roy_quantile(n, r, degrees, level, threads, stop)?, sizes: (r, degrees) })
}
