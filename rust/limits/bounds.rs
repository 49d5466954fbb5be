//! Lower and upper limits, and which of them a control has reached.

use crate::error::{Error, Result, sized};

/// `low <= u <= high`; infinite where there is no limit.
#[derive(Debug, Clone, Copy)]
pub struct Bounds<'a> {
    pub(crate) low: &'a [f64],
    pub(crate) high: &'a [f64],
}

impl<'a> Bounds<'a> {
    /// Limits of `d` inputs.
    ///
    /// # Errors
    /// [`Error::Shape`], and [`Error::Value`] for NaN, for `low > high`, and for a side that leaves nothing.
    pub fn new(low: &'a [f64], high: &'a [f64], d: usize) -> Result<Self> {
        for (name, side) in [("low", low), ("high", high)] {
            sized(name, side.len(), d)?;
        }
        for (i, (&l, &h)) in low.iter().zip(high).enumerate() {
            if !(l <= h && l < f64::INFINITY && h > f64::NEG_INFINITY) {
                let found = format!("[{l}, {h}] for input {i}");
                return Err(Error::Value {
                    name: "low",
                    expected: "at most `high`, with a number between them",
                    found,
                });
            }
        }
        Ok(Self { low, high })
    }

    #[inline(always)]
    pub(crate) fn clip(&self, i: usize, v: f64) -> f64 {
        // adding zero makes 0 of -0
        v.max(self.low[i]).min(self.high[i]) + 0.0
    }

    pub(super) fn fixed(&self, i: usize) -> bool {
        self.low[i] == self.high[i]
    }

    /// The limit that `held` names, nothing for 0.
    pub(super) fn at(&self, i: usize, held: i8) -> Option<f64> {
        match held {
            0 => None,
            ..0 => Some(self.low[i]),
            1.. => Some(self.high[i]),
        }
    }

    /// Where `u` is at a limit; a fixed input by the sign of the slope.
    #[inline(always)]
    pub(super) fn reached(&self, i: usize, u: f64, slope: f64) -> i8 {
        match (u == self.low[i], u == self.high[i]) {
            (true, true) => {
                if slope > 0.0 {
                    -1
                } else {
                    1
                }
            }
            (true, false) => -1,
            (false, true) => 1,
            (false, false) => 0,
        }
    }
}
