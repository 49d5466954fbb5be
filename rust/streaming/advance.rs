//! Runs of many steps, until a rule or a limit is met.

use std::time::Instant;

use super::stream::Stream;
use crate::error::Result;
use crate::fuse::norm;
use crate::named::named;
use crate::parallel::Stop;

/// The stopping rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// The certificate is at most the tolerance, and so `||B (v - v*)||` is. Checked every `n` steps.
    Certificate,
    /// `||v_new - v_old||` is at most the tolerance, as printed in the paper. It is 0 whenever a realization does not
    /// improve the estimate, whatever the error.
    Printed,
}

named!(Rule { Certificate => "certificate", Printed => "printed" });

/// Limits of a run.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    /// Steps of this run.
    pub steps: u64,
    /// The rule and its tolerance.
    pub tolerance: Option<(Rule, f64)>,
    /// The time when the run ends.
    pub deadline: Option<Instant>,
}

/// The reason why a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
#[must_use = "the rule may not be satisfied"]
pub enum End {
    /// The rule is satisfied.
    Converged,
    /// All steps are taken.
    Steps,
    /// The deadline has passed.
    Time,
}

named!(End { Converged => "converged", Steps => "max_steps", Time => "time_limit" });

impl Stream {
    /// Takes steps until a limit is met; between two steps the state is complete.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] after a stop, [`crate::Error::Memory`]; with the steps taken so far.
    pub fn advance(&mut self, limits: &Budget, stop: &Stop) -> Result<End> {
        let n = self.n() as u64;
        let look_every = (1 << 17) / n + 1; // well below a millisecond
        for taken in 0..limits.steps {
            if taken.is_multiple_of(look_every) {
                stop.check()?;
                if limits.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                    return Ok(End::Time);
                }
            }
            match limits.tolerance {
                None => {
                    self.step();
                }
                Some((Rule::Certificate, tolerance)) => {
                    self.step();
                    // the second part alone costs O(1)
                    if self.steps().is_multiple_of(n) && self.matrix_part() <= tolerance && self.bound()? <= tolerance {
                        return Ok(End::Converged);
                    }
                }
                Some((Rule::Printed, tolerance)) => {
                    let before = self.difference()?;
                    self.step();
                    let mut change = self.difference()?;
                    change.iter_mut().zip(&before).for_each(|(new, old)| *new -= old);
                    let moved = self.geometry.control(&change)?;
                    if norm(moved.iter().copied()) <= tolerance {
                        return Ok(End::Converged);
                    }
                }
            }
        }
        Ok(End::Steps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::streaming::stream::tests::{every_config, stream};

    #[test]
    fn limits_end_a_run_and_a_stop_leaves_a_stream() {
        for config in every_config() {
            let (mut one, mut many) = (stream(5, config), stream(5, config));
            let limits = Budget { steps: 300, tolerance: None, deadline: None };
            assert_eq!(one.advance(&limits, &Stop::new()), Ok(End::Steps));
            let stop = Stop::new();
            stop.request();
            assert_eq!(many.advance(&limits, &stop), Err(Error::Interrupted));
            let late = Budget { deadline: Some(Instant::now()), ..limits };
            assert_eq!(many.advance(&late, &Stop::new()), Ok(End::Time));
            for steps in [0, 1, 99, 200] {
                assert_eq!(many.advance(&Budget { steps, ..limits }, &Stop::new()), Ok(End::Steps));
            }
            assert_eq!(one.to_sections().unwrap(), many.to_sections().unwrap());
        }
    }

    #[test]
    fn the_certificate_is_met_and_the_printed_rule_means_nothing() {
        let config = every_config()[0];
        let mut sound = stream(5, config);
        let tolerance = 1e-2 * sound.certificate().unwrap().0;
        let limits = Budget { steps: u64::MAX, tolerance: Some((Rule::Certificate, tolerance)), deadline: None };
        assert_eq!(sound.advance(&limits, &Stop::new()), Ok(End::Converged));
        let (certificate, error) = sound.certificate().unwrap();
        assert!(error <= certificate && certificate <= tolerance);
        let mut printed = stream(5, config);
        let limits = Budget { tolerance: Some((Rule::Printed, 1e-12)), ..limits };
        assert_eq!(printed.advance(&limits, &Stop::new()), Ok(End::Converged));
        assert!(printed.steps() < 100 && printed.certificate().unwrap().1 > 10.0 * tolerance);
    }
}
