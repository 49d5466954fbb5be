//! Results of a stream: the control, the estimates, and their distances from the targets.

use super::estimator::Estimator;
use super::stream::{Config, Lines, Room, Stream};
use super::trace::Entry;
use crate::control::Best;
use crate::error::Result;
use crate::memory::try_zeros;
use crate::vector::{dot, norm};

impl Stream {
    /// `z` with `v = B^+ z`: `Ff - FA F0`.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn difference(&self) -> Result<Vec<f64>> {
        let mut out = try_zeros("the difference", self.geometry.n)?;
        self.difference_in(&mut out);
        Ok(out)
    }

    fn difference_in(&self, out: &mut [f64]) {
        let [x0, xf, a] = &self.slots;
        xf.entries(0, out);
        out.iter_mut().zip(&self.products.ff).for_each(|(f, y)| *f = *f * xf.scale - y * x0.scale * a.scale);
    }

    /// The control `v`, computed from the estimates, with its rounding.
    ///
    /// # Errors
    /// [`crate::Error::Overflow`] if it is not representable, [`crate::Error::Memory`].
    pub fn control(&self) -> Result<Best> {
        let n = self.geometry.n;
        let [x0, xf, columns] = self.estimates()?;
        let mut a = try_zeros("A by rows", n * n)?;
        for (j, column) in columns.chunks_exact(n).enumerate() {
            column.iter().enumerate().for_each(|(i, value)| a[i * n + j] = *value);
        }
        self.geometry.best(&a, &x0, &xf)
    }

    /// `||F - E*||` for `x0`, `xf`, `A`, from the entries.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn residuals(&self) -> Result<[f64; 3]> {
        let [mut line, mut off, ..] = Room::lines(self.geometry.n)?;
        let mut residual = |slot: &Estimator| slot.squared_error([&mut line, &mut off]).sqrt() * slot.scale;
        Ok([0, 1, 2].map(|k| residual(&self.slots[k])))
    }

    /// `||FA - A|| ||F0||`, from numbers that every step updates.
    pub(super) fn matrix_part(&self) -> f64 {
        let a = &self.slots[2];
        a.run.state.er.max(0.0).sqrt() * a.scale * (norm(&self.start.f) * self.slots[0].scale)
    }

    /// A bound on `||B (v - v*)||`, and its value for the control in doubles, in `O(n^2)`. The bound is
    /// `||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||` with what rounding may add.
    ///
    /// # Errors
    /// As [`Stream::control`].
    pub fn certificate(&self) -> Result<(f64, f64)> {
        let mut room = Room::lines(self.geometry.n)?;
        let (bound, _) = self.certificate_in(&mut room);
        let [line, .., apart, _] = &mut room;
        apart.iter_mut().zip(&self.control()?.shift).for_each(|(y, shift)| *y += shift);
        Ok((bound, self.geometry.projected_norm(apart, line)))
    }

    /// The bound alone.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub(super) fn bound(&self) -> Result<f64> {
        Ok(self.certificate_in(&mut Room::lines(self.geometry.n)?).0)
    }

    /// The bound, and the value without rounding, `||P [(Ff - FA F0) - (xf - A x0)]||`, from differences that do not
    /// cancel; these are left in the fifth of the lines.
    pub(super) fn certificate_in(&self, room: &mut Lines) -> (f64, f64) {
        let [x0, xf, a] = &self.slots;
        let n = self.geometry.n;
        let [line, off, start, moved, apart, matrix] = room;
        x0.visit([line, off], |_, line, off| {
            start.copy_from_slice(line);
            moved.copy_from_slice(off);
        });
        // (Ff - xf) - A (F0 - x0), and (FA - A) F0
        let mut er = 0.0;
        apart.fill(0.0);
        matrix.fill(0.0);
        a.visit([line, off], |j, _, off| {
            er += dot(off, off);
            let (f, d) = (start[j], moved[j]);
            matrix.iter_mut().zip(off).for_each(|(y, off)| *y += off * f);
            apart.iter_mut().zip(&a.law.values()[j * n..(j + 1) * n]).for_each(|(y, a)| *y -= a * d);
        });
        let mut goal = 0.0;
        xf.visit([line, off], |_, _, off| {
            goal = norm(off) * xf.scale;
            apart.iter_mut().zip(off).for_each(|(y, off)| *y = *y * x0.scale + off * xf.scale);
        });
        let bound = self.geometry.projected_norm(apart, line) + er.sqrt() * a.scale * (norm(start) * x0.scale);
        // sums of n + 3 terms (Higham, Accuracy and Stability of Numerical Algorithms (2002), 3.1)
        let terms = (n + 8) as f64 * f64::EPSILON;
        let sums = terms * (bound + goal + self.size_a * (norm(moved) * x0.scale));
        self.difference_in(line);
        let bound = bound + sums + self.geometry.rounding(apart, line);
        apart.iter_mut().zip(&*matrix).for_each(|(y, off)| *y -= off * a.scale * x0.scale);
        (bound, self.geometry.projected_norm(apart, line))
    }

    /// The estimates of `x0`, `xf`, `A` (column by column).
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn estimates(&self) -> Result<[Vec<f64>; 3]> {
        let estimate = |slot: &Estimator| -> Result<Vec<f64>> {
            let mut values = slot.estimate()?;
            values.iter_mut().for_each(|v| *v *= slot.scale);
            Ok(values)
        };
        let [x0, xf, a] = &self.slots;
        Ok([estimate(x0)?, estimate(xf)?, estimate(a)?])
    }

    /// Realizations used so far, for `x0`, `xf`, `A`.
    pub fn counts(&self) -> [u64; 3] {
        [0, 1, 2].map(|k| self.slots[k].count())
    }

    /// Steps taken.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The largest relative rounding error of `FA F0` that a refresh has corrected.
    pub fn drift(&self) -> f64 {
        self.drift
    }

    /// The recorded steps.
    pub fn trace(&self) -> &[Entry] {
        &self.trace
    }

    /// States.
    pub fn n(&self) -> usize {
        self.geometry.n
    }

    /// The options of the stream.
    pub fn config(&self) -> Config {
        self.config
    }
}
