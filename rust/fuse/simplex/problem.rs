//! Problems and solutions. A problem is checked once, here.

use crate::named::named;

use std::fmt;
use std::time::Duration;

/// The purpose of memory, in error messages.
pub(crate) const SEARCH: &str = "the search for weights";

/// Sample indices, sample-major: entry `i * lines + j` is the place of the nonzero of realization `i` in line `j`.
#[derive(Clone, Copy, Debug)]
pub enum IndexView<'a> {
    U8(&'a [u8]),
    U16(&'a [u16]),
    U32(&'a [u32]),
}

impl IndexView<'_> {
    fn len(&self) -> usize {
        match self {
            Self::U8(r) => r.len(),
            Self::U16(r) => r.len(),
            Self::U32(r) => r.len(),
        }
    }

    fn largest(&self) -> usize {
        match self {
            Self::U8(r) => r.iter().max().map_or(0, |&v| usize::from(v)),
            Self::U16(r) => r.iter().max().map_or(0, |&v| usize::from(v)),
            Self::U32(r) => r.iter().max().map_or(0, |&v| v as usize),
        }
    }
}

/// Why a problem is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Invalid {
    /// An array has the wrong number of entries.
    Length { name: &'static str, expected: usize, found: usize },
    /// No realizations, no lines, or lines of no entries.
    Empty,
    /// An index is not below `length`.
    Index { found: usize, length: usize },
    /// A number is not finite, or a line weight is negative.
    Value { name: &'static str },
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { name, expected, found } => write!(f, "`{name}` must have {expected} entries, got {found}"),
            Self::Empty => write!(f, "the ensemble must have at least one realization and one entry"),
            Self::Index { found, length } => write!(f, "every index must be below {length}, got {found}"),
            Self::Value { name } => write!(f, "`{name}` must be finite, and line weights nonnegative"),
        }
    }
}

impl std::error::Error for Invalid {}

/// Realizations with one nonzero per line, in sign-free form.
///
/// Realization `i` has the value `g[j]` at place `R_ij` of line `j`; `target` is line-major, `lines x length`, with the
/// signs of the law divided out: `sign_k * t_k` on the support of the law, the raw value elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct SingletonProblem<'a> {
    pub(super) indices: IndexView<'a>,
    pub(super) length: usize,
    pub(super) g: &'a [f64],
    pub(super) target: &'a [f64],
}

impl<'a> SingletonProblem<'a> {
    /// Checks sizes, indices and values.
    ///
    /// # Errors
    ///
    /// [`Invalid`], naming the argument.
    pub fn new(
        indices: IndexView<'a>,
        size: usize,
        lines: usize,
        length: usize,
        g: &'a [f64],
        target: &'a [f64],
    ) -> Result<Self, Invalid> {
        if size == 0 || lines == 0 || length == 0 {
            return Err(Invalid::Empty);
        }
        check_length("indices", size.saturating_mul(lines), indices.len())?;
        check_length("g", lines, g.len())?;
        check_length("target", lines.saturating_mul(length), target.len())?;
        if indices.largest() >= length {
            return Err(Invalid::Index { found: indices.largest(), length });
        }
        if !g.iter().all(|g| g.is_finite() && *g >= 0.0) {
            return Err(Invalid::Value { name: "g" });
        }
        check_finite("target", target)?;
        Ok(Self { indices, length, g, target })
    }
}

/// Dense realizations, `samples` is `size x dim`, row-major.
#[derive(Clone, Copy, Debug)]
pub struct DenseProblem<'a> {
    pub(super) samples: &'a [f64],
    pub(super) size: usize,
    pub(super) target: &'a [f64],
}

impl<'a> DenseProblem<'a> {
    /// Checks sizes and values.
    ///
    /// # Errors
    ///
    /// [`Invalid`], naming the argument.
    pub fn new(samples: &'a [f64], size: usize, target: &'a [f64]) -> Result<Self, Invalid> {
        if size == 0 || target.is_empty() {
            return Err(Invalid::Empty);
        }
        check_length("samples", size.saturating_mul(target.len()), samples.len())?;
        check_finite("samples", samples)?;
        check_finite("target", target)?;
        Ok(Self { samples, size, target })
    }
}

fn check_length(name: &'static str, expected: usize, found: usize) -> Result<(), Invalid> {
    if expected == found { Ok(()) } else { Err(Invalid::Length { name, expected, found }) }
}

fn check_finite(name: &'static str, values: &[f64]) -> Result<(), Invalid> {
    if values.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(Invalid::Value { name }) }
}

/// Tolerance, limits and options.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Tolerance on the gap, relative to `||target||^2` (to `sum g^2` if the target is zero).
    pub tol: f64,
    /// Most passes over the data, one product with `S` and one with `S^T` each.
    pub max_passes: usize,
    /// Wall time after which the best point is returned.
    pub time_limit: Option<Duration>,
    /// `sum w <= 1` instead of `sum w = 1`.
    pub subsimplex: bool,
    /// Number of threads, which share the samples; more than one is faster only above about a million indices.
    pub threads: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { tol: 1e-9, max_passes: 200_000, time_limit: None, subsimplex: false, threads: 1 }
    }
}

/// The end of the search, judged by the gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[must_use = "the weights may not be the best ones"]
pub enum WeightStatus {
    /// The gap is at most `tol ||E*||^2` (`tol` times the squared norm of a realization where `E* = 0`).
    Optimal,
    /// The best weights found, with a larger gap.
    OptimalInaccurate,
    /// The best weights when the caller's time or passes ran out.
    UserLimit,
    /// The best weights when the caller asked to stop.
    Interrupted,
}

named!(WeightStatus {
    Optimal => "optimal",
    OptimalInaccurate => "optimal_inaccurate",
    UserLimit => "user_limit",
    Interrupted => "interrupted",
});

/// The algorithm that found the weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing to do: the start was optimal.
    Start,
    /// One line only: closed form.
    ClosedForm,
    /// Projected Newton-CG.
    NewtonCg,
    /// One semismooth Newton solve.
    Direct,
    /// Proximal point method.
    Augmented,
    /// Active set method with a factor.
    ActiveSet,
}

named!(Phase {
    Start => "start",
    ClosedForm => "closed form",
    NewtonCg => "projected newton-cg",
    Direct => "semismooth newton",
    Augmented => "augmented lagrangian",
    ActiveSet => "active set",
});

/// Algorithm, cost and sizes.
#[derive(Clone, Copy, Debug)]
pub struct Info {
    pub phase: Phase,
    /// The weights were found on a subset of the realizations and certified on all.
    pub sifted: bool,
    pub passes: f64,
    pub newton_steps: usize,
    pub cg_steps: usize,
    /// `gap` divided by the reference of the tolerance; neither overflows nor vanishes.
    pub relative_gap: f64,
    /// Dimension of the affine hull of the realizations.
    pub dimension: usize,
}

/// Weights with their certificate: `objective - gap <= min <= objective`.
#[derive(Clone, Debug)]
pub struct Solution {
    /// One weight per realization, nonnegative, sum 1 (at most 1 if `subsimplex`).
    pub weights: Vec<f64>,
    /// `max_i <grad f, w - e_i>`, `f = ||S w - target||^2`, recomputed from the data.
    pub gap: f64,
    /// `||S w - target||^2`
    pub objective: f64,
    /// Proved lower bound on the minimum.
    pub lower_bound: f64,
    /// Its root: a lower bound on `||S w - target||`; neither overflows nor vanishes.
    pub least_error: f64,
    /// The target lies in the hull, so `||S w - target||` is rounding error.
    pub exact: bool,
    pub status: WeightStatus,
    pub info: Info,
    /// Nonzero entries of the target that no realization hits.
    pub unseen: usize,
}
