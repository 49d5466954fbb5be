//! The readings of Algorithm 1 that do not converge, kept for comparison: both average the control of the latest
//! *realizations*, `v <- (1 - t) v + t B^+ (Ef - EA E0)`.

use super::estimator::Estimator;
use crate::error::Result;
use crate::memory::try_zeros;

/// `v = B^+ (goal - free)`, the running averages of `Ef` and of `EA E0`, in the units of the slots.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Raw {
    pub(super) goal: Vec<f64>,
    pub(super) free: Vec<f64>,
}

impl Raw {
    pub(super) fn none() -> Self {
        Self { goal: Vec::new(), free: Vec::new() }
    }

    /// The differences of the first realizations.
    pub(super) fn of(slots: &[Estimator; 3]) -> Result<Self> {
        let n = slots[0].run.length;
        let mut made = Self { goal: try_zeros("a stream", n)?, free: try_zeros("a stream", n)? };
        made.average(1.0, slots);
        Ok(made)
    }

    /// One step; a triple of realizations has two nonzero numbers.
    pub(super) fn average(&mut self, t: f64, slots: &[Estimator; 3]) {
        if t == 0.0 {
            return;
        }
        let u = 1.0 - t;
        self.goal.iter_mut().chain(&mut self.free).for_each(|v| *v *= u);
        let [x0, xf, a] = slots;
        self.goal[xf.raw[0] as usize] += t * xf.raw_value(0);
        let column = x0.raw[0] as usize;
        self.free[a.raw[column] as usize] += t * (a.raw_value(column) * x0.raw_value(0));
    }
}
