//! Averages of realizations, drawn as counts.

use rand::Rng;
use rand::rngs::ChaCha8Rng;

use crate::Scheme;
use crate::error::{Error, Result};
use crate::memory::{try_extend, try_room};
use crate::sample::{Chance, Law, chances, deal, line_systematic};

use super::sizes::WHAT;

/// The law of an average of realizations, a vector or the lines of a matrix.
#[derive(Debug, Clone)]
pub struct Average {
    pub(super) law: Law,
    chances: Vec<Chance>,
    pub(super) size: u64,
    pub(super) scheme: Scheme,
}

impl Average {
    /// The average of `size` realizations of `law`.
    ///
    /// # Errors
    /// [`Error::Value`] for a `size` outside `1 ..= 2^53`, [`Error::Memory`].
    pub fn new(law: Law, size: u64, scheme: Scheme) -> Result<Self> {
        if size == 0 || size > 1 << 53 {
            return Err(Error::Value { name: "size", expected: "in [1, 2^53]", found: size.to_string() });
        }
        let mut all = try_room(WHAT, law.values().len())?;
        for j in 0..law.lines() {
            try_extend(WHAT, &mut all, chances(law.line(j), law.gamma()[j])?)?;
        }
        Ok(Self { law, chances: all, size, scheme })
    }

    fn chances(&self, j: usize) -> &[Chance] {
        &self.chances[j * self.law.length()..(j + 1) * self.law.length()]
    }

    /// `visit(i, value)` for the nonzero entries of the average of line `j`.
    pub(super) fn line(&self, j: usize, rng: &mut ChaCha8Rng, mut visit: impl FnMut(usize, f64)) -> Result<()> {
        let (line, g, size) = (self.law.line(j), self.law.gamma()[j], self.size as f64);
        let visit = |i: usize, count: u64| visit(i, g.copysign(line[i]) * (count as f64 / size));
        match self.scheme {
            Scheme::Iid => deal(self.chances(j), self.size, rng, visit),
            Scheme::Systematic => {
                line_systematic(line, self.size, rng.next_u64(), visit);
                Ok(())
            }
        }
    }

    /// `visit(i, count)` for the entries hit by `some` of the `size` realizations of line `j`, chosen at random.
    pub(super) fn part(
        &self,
        j: usize,
        some: u64,
        rng: &mut ChaCha8Rng,
        left: &mut [u64],
        mut visit: impl FnMut(usize, u64),
    ) -> Result<()> {
        if self.scheme == Scheme::Iid {
            return deal(self.chances(j), some, rng, visit);
        }
        // the order of a systematic sample is random: draw from its counts without replacement
        left.fill(0);
        line_systematic(self.law.line(j), self.size, rng.next_u64(), |i, count| left[i] = count);
        let mut total: u64 = left.iter().sum();
        for _ in 0..some.min(total) {
            let mut at = ((u128::from(rng.next_u64()) * u128::from(total)) >> 64) as u64;
            let Some(i) = left.iter().position(|&count| {
                let here = at < count;
                at = at.wrapping_sub(if here { 0 } else { count });
                here
            }) else {
                break;
            };
            left[i] -= 1;
            total -= 1;
            visit(i, 1);
        }
        Ok(())
    }
}

/// An entity of a control: exact, or an average that every run draws.
#[derive(Debug, Clone)]
pub enum PlanEntity {
    /// Exact entries, of a matrix column by column.
    Fixed(Vec<f64>),
    /// An average of realizations.
    Drawn(Average),
}

impl PlanEntity {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Fixed(values) => values.len(),
            Self::Drawn(average) => average.law.values().len(),
        }
    }

    /// The vector in one run.
    pub(super) fn vector(&self, rng: &mut ChaCha8Rng, out: &mut [f64]) -> Result<()> {
        match self {
            Self::Fixed(values) => out.copy_from_slice(values),
            Self::Drawn(average) => {
                out.fill(0.0);
                average.line(0, rng, |i, value| out[i] = value)?;
            }
        }
        Ok(())
    }
}
