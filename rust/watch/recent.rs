//! What an alarm keeps of the calls before it.

use crate::error::Result;
use crate::memory::{checked_len, try_zeros};

use super::frame::WHAT;

/// Calls before an alarm in which its onset is looked for.
const RECENT: usize = 1000;

/// The last calls before an alarm: readings and the inputs that had acted, nan where one is missing.
#[derive(Debug)]
pub(super) struct Recent {
    width: usize,
    rows: Vec<f64>,
    calls: usize,
}

impl Recent {
    pub fn new(width: usize) -> Result<Self> {
        Ok(Self { width, rows: try_zeros(WHAT, checked_len(WHAT, RECENT, width)?)?, calls: 0 })
    }

    pub fn push(&mut self, row: impl Iterator<Item = f64>) {
        let begin = self.calls % RECENT * self.width;
        for (to, v) in self.rows[begin..begin + self.width].iter_mut().zip(row) {
            *to = if v.is_finite() { v } else { f64::NAN };
        }
        self.calls += 1;
    }

    pub fn clear(&mut self) {
        self.calls = 0;
    }

    pub fn len(&self) -> usize {
        self.calls.min(RECENT)
    }

    /// One of them, the oldest first.
    pub fn row(&self, k: usize) -> &[f64] {
        let begin = (self.calls - self.len() + k) % RECENT * self.width;
        &self.rows[begin..begin + self.width]
    }

    pub fn iter(&self) -> impl Iterator<Item = &[f64]> {
        (0..self.len()).map(|k| self.row(k))
    }
}
