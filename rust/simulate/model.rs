//! The problem that is simulated, and its exact solution.

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::Stop;
use crate::sample::Law;

/// Which entities are drawn; the others are exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Drawn {
    /// Fresh realizations of `A` at every step.
    pub a: bool,
    /// Fresh realizations of `B` at every step.
    pub b: bool,
    /// A realization of `x0` at the start.
    pub x0: bool,
}

/// A system, its inputs and its initial state. The lines of the matrices are their columns.
#[derive(Debug, Clone)]
pub struct Model {
    a: Law,
    b: Law,
    x0: Law,
    inputs: Vec<f64>,
    steps: usize,
}

impl Model {
    /// `a`: n lines of n entries, `b`: m lines of n, `x0`: one line of n; `inputs`: `u(0), u(1), ...`, m entries each.
    ///
    /// # Errors
    /// [`Error::Shape`] if these do not fit together, [`Error::NonFinite`] for an input that is not finite.
    pub fn new(a: Law, b: Law, x0: Law, inputs: Vec<f64>) -> Result<Self> {
        let (n, m) = (a.lines(), b.lines());
        for (name, law, lines) in [("A", &a, n), ("B", &b, m), ("x0", &x0, 1)] {
            if (law.lines(), law.length()) != (lines, n) {
                return Err(Error::Shape {
                    name,
                    expected: format!("{lines} lines of {n} entries"),
                    found: format!("{} of {}", law.lines(), law.length()),
                });
            }
        }
        if !inputs.len().is_multiple_of(m) {
            let found = format!("{} entries", inputs.len());
            return Err(Error::Shape { name: "u", expected: format!("{m} entries per step"), found });
        }
        require_finite("u", &inputs)?;
        let steps = inputs.len() / m;
        Ok(Self { a, b, x0, inputs, steps })
    }

    /// States.
    pub fn n(&self) -> usize {
        self.a.lines()
    }

    /// Number of steps `K`; there are `K + 1` states.
    pub fn steps(&self) -> usize {
        self.steps
    }

    pub(super) fn a(&self) -> &Law {
        &self.a
    }

    pub(super) fn b(&self) -> &Law {
        &self.b
    }

    pub(super) fn x0(&self) -> &Law {
        &self.x0
    }

    /// `u(k)`.
    pub(super) fn input(&self, k: usize) -> &[f64] {
        let m = self.b.lines();
        &self.inputs[k * m..(k + 1) * m]
    }

    /// The exact `x(0), ..., x(K)`, n entries each.
    ///
    /// # Errors
    /// [`Error::Overflow`] if a state is not finite, [`Error::Memory`], [`Error::Interrupted`] after a stop.
    pub fn trajectory(&self, stop: &Stop) -> Result<Vec<f64>> {
        let (n, what) = (self.n(), "the trajectory");
        let times = self.steps.saturating_add(1);
        let mut states: Vec<f64> = try_zeros(what, checked_len(what, times, n)?)?;
        states[..n].copy_from_slice(self.x0.values());
        for k in 0..self.steps {
            let (past, future) = states.split_at_mut((k + 1) * n);
            let (x, next) = (&past[k * n..], &mut future[..n]);
            add_product(&self.a, x, next, stop)?;
            add_product(&self.b, self.input(k), next, stop)?;
            if !next.iter().all(|v| v.is_finite()) {
                return Err(Error::Overflow { what });
            }
        }
        Ok(states)
    }
}

/// `out += sum_j v_j m_j`, with the lines `m_j` in order.
pub(super) fn add_product(matrix: &Law, v: &[f64], out: &mut [f64], stop: &Stop) -> Result<()> {
    for (j, &v) in v.iter().enumerate() {
        if j % 64 == 0 {
            stop.check()?;
        }
        for (out, entry) in out.iter_mut().zip(matrix.line(j)) {
            *out += v * entry;
        }
    }
    Ok(())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A system given by its columns.
    pub(in crate::simulate) fn model(a: &[f64], b: &[f64], x0: &[f64], inputs: &[f64]) -> Model {
        let n = x0.len();
        let law = |values: &[f64]| Law::new(values.to_vec(), values.len() / n, n).unwrap();
        Model::new(law(a), law(b), law(x0), inputs.to_vec()).unwrap()
    }

    #[test]
    fn two_steps_by_hand() {
        // A = [[1, 3], [2, -1]], B = (1, -1)^T
        let found = model(&[1.0, 2.0, 3.0, -1.0], &[1.0, -1.0], &[1.0, 1.0], &[0.0, 2.0]).trajectory(&Stop::new());
        assert_eq!(found.unwrap(), [1.0, 1.0, 4.0, 1.0, 9.0, 5.0]);
    }

    #[test]
    fn wrong_shapes_and_overflow_are_refused() {
        let law = |len, lines: usize| Law::new(vec![1.0; len], lines, len / lines).unwrap();
        for (a, b, x0, inputs) in [(4, (2, 1), 3, 1), (4, (3, 1), 2, 1), (6, (2, 1), 2, 1), (4, (4, 2), 2, 3)] {
            let found = Model::new(law(a, 2), law(b.0, b.1), law(x0, 1), vec![1.0; inputs]);
            assert!(matches!(found, Err(Error::Shape { .. })), "{a} {b:?} {x0} {inputs}");
        }
        let found = model(&[1e200], &[1.0], &[1e200], &[0.0]).trajectory(&Stop::new());
        assert_eq!(found, Err(Error::Overflow { what: "the trajectory" }));
    }
}
