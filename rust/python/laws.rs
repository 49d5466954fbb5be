//! The laws of the errors of identified models: quantiles, limits, levels.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use super::convert::{array1, array2, slice};
use super::run::{UNTIL_STOPPED, run};
use crate::identify;
use crate::region::{CoordinateNoise, Mixture, Place, between};

/// Quantiles of sizes, a level and a number of threads.
macro_rules! quantiles {
    ($($(#[$doc:meta])* $name:ident($($size:ident),*) -> $out:ty;)*) => {$(
        $(#[$doc])*
        #[pyfunction]
        pub(super) fn $name(py: Python<'_>, $($size: usize,)* delta: f64, threads: usize) -> PyResult<$out> {
            run(py, UNTIL_STOPPED, |stop| identify::$name($($size,)* delta, threads, stop))
        }
    )*};
}

quantiles! {
    /// `q` with `P(largest root of E_nu^-1 G G' <= q) = 1 - delta`, `G` (n, d).
    roy_quantile(n, d, nu) -> f64;
    /// `q` with `P(largest root of G G' <= q) = 1 - delta`, `G` (n, d).
    wishart_quantile(n, d) -> f64;
    /// `a` with `P(smallest eigenvalue of W_n(I, size) < a) = delta`.
    smallest_quantile(n, size) -> f64;
    /// `q` with `P(largest root of G G' <= q chi2_{n nu}) = 1 - delta`.
    scalar_quantile(n, d, nu) -> f64;
    /// `q` of the largest root of `C^-1/2 G G' C^-1/2`, `C` diagonal of independent chi2_nu; drawn.
    diagonal_quantile(n, d, nu) -> f64;
    /// `q` of `tr(E_nu^-1 G G')`; drawn.
    trace_quantile(n, d, nu) -> f64;
    /// `(spectral, frobenius)`: radii that hold together with probability `1 - delta`; drawn.
    joint_radii(n, d, nu) -> (f64, f64);
}

/// `q` of `max_i ||g_i||^2 / chi2_nu`.
#[pyfunction]
pub(super) fn row_quantile(n: usize, d: usize, nu: usize, delta: f64) -> PyResult<f64> {
    Ok(identify::row_quantile(n, d, nu, delta)?)
}

/// `t` with `P(||x|| > t) <= delta` for normal x of this covariance (n, n).
#[pyfunction]
pub(super) fn normal_quantile(py: Python<'_>, covariance: PyReadonlyArray2<'_, f64>, delta: f64) -> PyResult<f64> {
    let (n, values) = (covariance.as_array().nrows(), slice("covariance", &covariance)?);
    run(py, UNTIL_STOPPED, |_| identify::normal_quantile(values, n, delta))
}

/// `x` with `P(F_{a,b} > x) = delta`.
#[pyfunction]
pub(super) fn f_upper(delta: f64, a: f64, b: f64) -> PyResult<f64> {
    Ok(identify::f_upper(delta, a, b)?)
}

/// The fields of the package's `Hull`.
#[derive(FromPyObject)]
pub(super) struct HullArgument {
    distance2: f64,
    off2: f64,
    along: f64,
    k: usize,
    face: usize,
    p: usize,
}

impl HullArgument {
    fn get(&self) -> Place {
        let Self { distance2, off2, along, k, face, p } = *self;
        Place { distance: distance2, off: off2, along, k, face, p }
    }
}

/// The fields of the package's `Noise`.
#[derive(FromPyObject)]
pub(super) struct NoiseArgument {
    variance: Option<f64>,
    rss: f64,
    degrees: usize,
    rows: usize,
}

impl NoiseArgument {
    fn get(&self) -> CoordinateNoise {
        match (self.variance, self.rows) {
            (Some(variance), _) => CoordinateNoise::Known(variance),
            (None, 1) => CoordinateNoise::Estimated { rss: self.rss, degrees: self.degrees },
            (None, count) => CoordinateNoise::Rows { count, degrees: self.degrees },
        }
    }
}

/// A root of a covariance, `root root' = S`; the rounding of each row is relative to its own size.
#[pyfunction]
pub(super) fn covariance_root<'py>(
    py: Python<'py>,
    covariance: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (n, covariance) = (covariance.as_array().dim().0, slice("covariance", &covariance)?);
    array2(py, run(py, (covariance.len() * n) as f64, |_| identify::covariance_root(covariance, n))?, n, n)
}

/// Where data t (p,) lie from models (M, p) mixed by weights (M,): the mixture, and the numbers of the `Hull` of a
/// `FusedModel`.
#[pyfunction]
#[expect(clippy::type_complexity, reason = "one tuple per call, named in the stub")]
pub(super) fn hull_position<'py>(
    py: Python<'py>,
    models: PyReadonlyArray2<'py, f64>,
    t: PyReadonlyArray1<'py, f64>,
    weights: PyReadonlyArray1<'py, f64>,
) -> PyResult<(Bound<'py, PyArray1<f64>>, (f64, f64, f64, usize, usize, usize, f64))> {
    let (models, t, weights) = (slice("models", &models)?, slice("t", &t)?, slice("weights", &weights)?);
    let found = run(py, 10.0 * (models.len() * weights.len()) as f64, |_| Mixture::new(models, t, weights))?;
    let Place { distance, off, along, k, face, p } = found.place;
    Ok((array1(py, found.point)?, (distance, off, along, k, face, p, found.largest)))
}

/// The radius around `point + share away` of what is within b of t and a of `point`.
#[pyfunction]
pub(super) fn hull_between(
    py: Python<'_>,
    b: f64,
    a: f64,
    away: PyReadonlyArray2<'_, f64>,
    share: f64,
    frobenius: bool,
) -> PyResult<f64> {
    let (columns, away) = (away.as_array().dim().1, slice("away", &away)?);
    run(py, (away.len() * columns) as f64, |_| between(b, a, away, columns, share, frobenius))
}

/// The share of least squares in the mixture with it.
#[pyfunction]
pub(super) fn hull_share(hull: HullArgument, noise: NoiseArgument) -> PyResult<f64> {
    Ok(hull.get().share(noise.get())?)
}

/// Whether an affine mixture is compatible with the data.
#[pyfunction]
pub(super) fn hull_explained(hull: HullArgument, noise: NoiseArgument) -> PyResult<Option<bool>> {
    Ok(hull.get().explained(noise.get())?)
}

/// A bound on `||(F - Theta) V^(1/2)||_F^2`.
#[pyfunction]
pub(super) fn hull_radius(
    py: Python<'_>,
    hull: HullArgument,
    noise: NoiseArgument,
    delta: f64,
    extra: usize,
) -> PyResult<f64> {
    run(py, 0.0, |_| hull.get().radius(noise.get(), delta, extra))
}

/// `c` with `1F1(1/2; n/2; c) = exp(ld / 2) / delta`.
#[pyfunction]
pub(super) fn sphere_level(n: usize, ld: f64, delta: f64) -> PyResult<f64> {
    Ok(identify::sphere_level(n, ld, delta)?)
}

/// `rho^2` of least squares for a mean over `J` mixtures.
#[pyfunction]
pub(super) fn least_squares_level(
    n: usize,
    ld: PyReadonlyArray1<'_, f64>,
    wider: PyReadonlyArray1<'_, f64>,
    delta: f64,
    frobenius: bool,
) -> PyResult<f64> {
    Ok(identify::least_squares_level(n, slice("ld", &ld)?, slice("wider", &wider)?, delta, frobenius)?)
}

/// `r` with `P(||w|| > r sigma) <= delta` for one sub-Gaussian `w` in `n` dimensions.
#[pyfunction]
pub(super) fn one_noise(n: usize, delta: f64) -> PyResult<f64> {
    Ok(identify::one_noise(n, delta)?)
}

/// `log Gamma_n(a)`.
#[pyfunction]
pub(super) fn log_multigamma(a: f64, n: usize) -> f64 {
    identify::log_multigamma(a, n)
}
