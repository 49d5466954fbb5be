//! The trace of a stream: few steps, at growing distances, so that memory is bounded for any number of steps.

/// One recorded step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entry {
    /// Number of steps so far.
    pub step: u64,
    /// The certificate.
    pub certificate: f64,
    /// `||B (v - v*)||`.
    pub error: f64,
    /// The step size `t` of that step (1 at the start).
    pub size: f64,
}

/// Whether a step is recorded: the first 16, then 8 in every octave. At most `16 + 8 * 60` in all.
///
/// This depends on the number of the step only, so one long run and several short ones give the same trace.
pub fn on_grid(step: u64) -> bool {
    let bits = u64::BITS - step.leading_zeros();
    step.trailing_zeros() + 4 >= bits
}

#[cfg(test)]
mod tests {
    use super::on_grid;

    #[test]
    fn dense_at_first_and_then_eight_per_octave() {
        let found: Vec<u64> = (0..=40).filter(|&k| on_grid(k)).collect();
        let expected: Vec<u64> = (0..=16).chain([18, 20, 22, 24, 26, 28, 30, 32, 36, 40]).collect();
        assert_eq!(found, expected);
        for octave in 5..20 {
            assert_eq!((1u64 << octave..2 << octave).filter(|&k| on_grid(k)).count(), 8);
        }
        assert!(on_grid(1 << 63) && on_grid(15 << 60) && !on_grid(u64::MAX));
    }
}
