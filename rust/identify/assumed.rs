//! What is assumed of the data, and what is asked of a region: nothing is ever inferred.

use crate::named::named;

/// Whether all states and inputs of the pairs are independent of all noise of the outcomes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Design {
    /// They are.
    Independent,
    /// They may depend on earlier noise, as in every run of more than one step.
    Adaptive,
}

named!(Design { Independent => "independent", Adaptive => "adaptive" });

/// The law of the noise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Noise {
    /// Gaussian.
    Gaussian,
    /// `E exp(l' w) <= exp(l' Sigma l / 2)` given the past, or bounded by its known size.
    SubGaussian,
}

named!(Noise { Gaussian => "gaussian", SubGaussian => "sub-gaussian" });

/// The covariance (n, n) of the noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Covariance<'a> {
    /// One unknown matrix.
    Full,
    /// An unknown diagonal matrix.
    Diagonal,
    /// An unknown multiple of I.
    Scalar,
    /// This matrix; for other noise than Gaussian an upper bound.
    Known(&'a [f64]),
}

/// Design and noise of the data.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assumed<'a> {
    /// Of states and inputs.
    pub design: Design,
    /// Its law.
    pub noise: Noise,
    /// Its covariance.
    pub covariance: Covariance<'a>,
    /// `(sum ||Sigma^(-1/2) r||^2 / N)^(1/2)` at most, of what the model leaves out beside the noise.
    pub tail: f64,
}

impl Assumed<'_> {
    /// Whether the exact laws of least squares hold.
    pub(crate) fn exact(&self) -> bool {
        self.design == Design::Independent && self.noise == Noise::Gaussian
    }
}

/// For Gaussian noise of unknown covariance with any design.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RegionMethod {
    /// The smaller of both, each with `delta / 2`.
    Auto,
    /// Small, but infinite with few pairs.
    Mixture,
    /// Finite once there are n more pairs than unknowns, wide, and valid for all N at once.
    Universal,
}

named!(RegionMethod { Auto => "auto", Mixture => "mixture", Universal => "universal" });

/// What is asked of a region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wish<'a> {
    /// The probability that it does not contain the true model, in (0, 1).
    pub delta: f64,
    /// One part for each row instead of one for all.
    pub components: bool,
    /// Columns (d, r), fixed without a look at the outcomes, that span all z asked for.
    pub directions: Option<&'a [f64]>,
    /// Steps of noise to come that are covered too.
    pub future: usize,
    /// Whether the Frobenius norm is bounded as well.
    pub frobenius: bool,
    /// See [`RegionMethod`].
    pub method: RegionMethod,
    /// Whether the region of [`RegionMethod::Mixture`] holds for all N at once.
    pub anytime: bool,
}

impl Wish<'_> {
    /// A region of all rows that does not contain the true model with probability `delta`.
    #[must_use]
    pub const fn new(delta: f64) -> Self {
        let (directions, method) = (None, RegionMethod::Auto);
        Self { delta, components: false, directions, future: 0, frobenius: false, method, anytime: false }
    }
}
