//! What pivoting and the interior point ask of a problem, whatever its structure: `J(u) = ||M u - y||^2 + u' R u` with
//! `H = M'M + R` and half gradients `g = J'(u) / 2 = M'(M u - y) + R u`.

use std::time::{Duration, Instant};

use super::bounds::Bounds;
use crate::error::{Error, Result};
use crate::named::named;
use crate::parallel::Stop;

/// Time after a limit for work that has it to end on its own.
const GRACE: Duration = Duration::from_millis(100);

pub(super) trait Quadratic {
    fn size(&self) -> usize;

    /// Computes what all of the following needs, unless it is there.
    fn prepare(&mut self, until: Until<'_>) -> Result<()>;

    /// `diag H`
    fn curvature(&self) -> &[f64];

    /// The size of `J` to which gaps and rounding are relative: `J(0)` or smaller.
    fn scale(&self) -> f64;

    /// The minimiser of `J` over the inputs with `held = 0`, given the others. False if it is not unique to rounding.
    fn face(&mut self, held: &[i8], u: &mut [f64], until: Until<'_>) -> Result<bool>;

    /// `v <- H_FF^{-1} v` on the free inputs `F` of the last face, 0 elsewhere.
    fn correct(&mut self, v: &mut [f64]);

    /// `g` for pivoting just after [`Self::face`], and `||u||_H^2`.
    fn pull(&mut self, u: &[f64], g: &mut [f64]) -> f64;

    /// `J(u)`, and `g` from the residual.
    fn slope(&mut self, u: &[f64], g: &mut [f64]) -> f64;

    /// Factors `H + diag(diagonal)` for the inputs with `held = 0`, beside the face; false if it is not positive
    /// definite to rounding.
    fn barrier(&mut self, held: &[i8], diagonal: &[f64], until: Until<'_>) -> Result<bool>;

    /// `v <- (H + diag)^{-1} v` by the last [`Self::barrier`], 0 elsewhere.
    fn newton(&mut self, v: &mut [f64]);

    /// An upper bound of `e' H^{-1} e` over the inputs with `held = 0`; infinite where `H` is singular to rounding.
    fn dual_norm(&mut self, held: &[i8], e: &[f64], until: Until<'_>) -> Result<f64>;

    /// Whether [`Self::dual_norm`] takes no factorization.
    fn dual_at_hand(&self, _held: &[i8]) -> bool {
        false
    }

    /// A control to begin with, inside the limits; `held` names inputs that stay at their limit.
    fn guess(&mut self, bounds: Bounds<'_>, held: &[i8], u: &mut [f64], until: Until<'_>) -> Result<()>;
}

/// How a computation ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
#[must_use = "the control may not be the best one, or break a limit"]
pub enum Status {
    /// The gap is at most `1e-9 J(u)`, or rounding of what `J(u)` is before anything cancels.
    Optimal,
    /// The gap is larger.
    #[default]
    Inaccurate,
    /// The time limit came first.
    Limit,
    /// The caller asked to stop.
    Interrupted,
    /// No control keeps the limits on states.
    Infeasible,
    /// A limit on a state is broken, and it is not known whether all can be kept.
    Undecided,
}

named!(Status {
    Optimal => "optimal",
    Inaccurate => "optimal_inaccurate",
    Limit => "user_limit",
    Interrupted => "interrupted",
    Infeasible => "infeasible",
    Undecided => "undecided",
});

/// What found the control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Method {
    /// Block principal pivoting.
    #[default]
    Pivoting,
    /// The interior point, and pivoting from its limits.
    Interior,
    /// Either with orthogonal factors.
    Refinement,
}

named!(Method { Pivoting => "pivoting", Interior => "interior point", Refinement => "refinement" });

/// What ends a computation before its tolerance.
#[derive(Debug, Clone, Copy)]
pub struct Until<'a> {
    pub(crate) stop: &'a Stop,
    deadline: Option<Instant>,
}

impl<'a> Until<'a> {
    /// A stop, or `time` from now.
    #[must_use]
    pub fn new(stop: &'a Stop, time: Option<Duration>) -> Self {
        Self { stop, deadline: time.and_then(|time| Instant::now().checked_add(time)) }
    }

    /// The time left.
    pub(crate) fn left(&self) -> Option<Duration> {
        self.deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()))
    }

    pub(crate) fn reached(&self) -> Option<Status> {
        if self.stop.requested() {
            Some(Status::Interrupted)
        } else if self.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            Some(Status::Limit)
        } else {
            None
        }
    }

    /// [`Error::Interrupted`] once there is a reason to end; loops call this every few milliseconds of work.
    pub(crate) fn check(&self) -> Result<()> {
        if self.reached().is_some() { Err(Error::Interrupted) } else { Ok(()) }
    }

    /// For a thread that waits for work which looks at the clock itself.
    pub(super) fn overdue(&self) -> bool {
        self.stop.requested_after_a_wait() || self.deadline.is_some_and(|deadline| deadline.elapsed() > GRACE)
    }

    /// What the status is after [`Error::Interrupted`].
    pub(crate) fn ended(&self) -> Status {
        self.reached().unwrap_or(Status::Interrupted)
    }
}
