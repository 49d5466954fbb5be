//! Given systems, each run once: `x^s(k+1) = A_s x^s(k) + B_s u(k) + c_s`.

use super::block::{RUNS, Row, States};
use super::moments::{Ensemble, Second, Sums, Tree};
use crate::error::{Error, Result, require_finite, sized};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::{Stop, for_each_chunk};

pub(super) const WHAT: &str = "the runs of the systems";

/// `N` systems with n states and m inputs, the columns of one after another, and their inputs.
#[derive(Debug, Clone, Copy)]
pub struct Systems<'a> {
    /// States.
    pub n: usize,
    /// Inputs.
    pub m: usize,
    /// `N n n` entries.
    pub a: &'a [f64],
    /// `N n m` entries.
    pub b: &'a [f64],
    /// `N n` entries, if there are offsets.
    pub c: Option<&'a [f64]>,
    /// n entries for all systems, or `N n`.
    pub x0: &'a [f64],
    /// `u(0), u(1), ...`, m entries each, the same for all systems.
    pub u: &'a [f64],
}

impl Systems<'_> {
    /// Mean and covariance over the systems at the times `0 .. K`; the runs themselves only with `keep`.
    ///
    /// Deviations from the run of the first system are added up. Its distance from the mean is at most `sqrt(N - 1)`
    /// standard deviations, so that a variance has a relative rounding error of `N` units at most, wherever the runs
    /// are. Systems are taken in fixed blocks, so that the number of threads changes nothing.
    ///
    /// # Errors
    /// [`Error::Shape`] if the arrays do not fit together, [`Error::NonFinite`], [`Error::Overflow`] if a state or a
    /// second moment is not finite, [`Error::Memory`], [`Error::Interrupted`] after a stop.
    pub fn run(&self, second: Second, keep: bool, threads: usize, stop: &Stop) -> Result<Ensemble> {
        let size = self.checked()?;
        let center = self.first(stop)?;
        let (n, one) = (self.n, center.len());
        let mut kept: Vec<f64> = try_zeros(WHAT, if keep { checked_len(WHAT, size, one)? } else { 0 })?;
        let tree = Tree::new();
        let mut parts = kept.chunks_mut(RUNS.saturating_mul(one));
        let blocks = (0..size.div_ceil(RUNS)).map(|index| (index, parts.next().unwrap_or_default()));
        for_each_chunk(blocks, threads, stop, |(index, part)| {
            let mut sums = Sums::new(&center, n, second)?;
            let count = RUNS.min(size - index * RUNS);
            let mut block: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, n, RUNS)?)?;
            let (mut x, mut next) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
            let rows = block.as_chunks_mut::<RUNS>().0;
            for k in 0..=self.steps() {
                for s in 0..count {
                    stop.check()?;
                    if k == 0 {
                        next.copy_from_slice(self.start(index * RUNS + s));
                    } else {
                        x.iter_mut().zip(&*rows).for_each(|(to, row): (&mut f64, &Row)| *to = row[s]);
                        self.step(index * RUNS + s, k - 1, &x, &mut next);
                    }
                    rows.iter_mut().zip(&next).for_each(|(row, v)| row[s] = *v);
                    if keep {
                        part[s * one + k * n..s * one + (k + 1) * n].copy_from_slice(&next);
                    }
                }
                sums.add(k, &States::Rows(rows), count);
            }
            tree.insert(index, sums);
            Ok(())
        })?;
        tree.finish(size, kept)
    }

    /// The number of systems.
    pub(super) fn checked(&self) -> Result<usize> {
        let (n, m) = (self.n, self.m);
        let square = checked_len(WHAT, n, n)?;
        let size = self.a.len().checked_div(square).unwrap_or(0);
        let fits = |name, values: &[f64], len: usize| {
            sized(name, values.len(), len)?;
            require_finite(name, values)
        };
        if size == 0 || m == 0 {
            return Err(Error::Shape { name: "A", expected: "a system at least".into(), found: "none".into() });
        }
        fits("A", self.a, checked_len(WHAT, size, square)?)?;
        fits("B", self.b, checked_len(WHAT, checked_len(WHAT, size, n)?, m)?)?;
        fits("c", self.c.unwrap_or_default(), if self.c.is_some() { size * n } else { 0 })?;
        fits("x0", self.x0, if self.x0.len() == n { n } else { size * n })?;
        fits("u", self.u, self.steps() * m)?;
        Ok(size)
    }

    pub(super) fn steps(&self) -> usize {
        self.u.len() / self.m
    }

    fn start(&self, s: usize) -> &[f64] {
        let n = self.n;
        if self.x0.len() == n { self.x0 } else { &self.x0[s * n..(s + 1) * n] }
    }

    /// One step of system s. The terms are added in the order of the columns, as in the exact trajectory.
    fn step(&self, s: usize, k: usize, x: &[f64], next: &mut [f64]) {
        let (n, m) = (self.n, self.m);
        let (a, b) = (&self.a[s * n * n..(s + 1) * n * n], &self.b[s * n * m..(s + 1) * n * m]);
        let u = &self.u[k * m..(k + 1) * m];
        next.fill(0.0);
        for (v, column) in x.iter().zip(a.chunks_exact(n)).chain(u.iter().zip(b.chunks_exact(n))) {
            next.iter_mut().zip(column).for_each(|(to, entry)| *to += v * entry);
        }
        if let Some(c) = self.c {
            next.iter_mut().zip(&c[s * n..]).for_each(|(to, c)| *to += c);
        }
    }

    /// The run of the first system.
    fn first(&self, stop: &Stop) -> Result<Vec<f64>> {
        let mut states = try_zeros(WHAT, checked_len(WHAT, self.steps() + 1, self.n)?)?;
        self.path(0, &mut states, stop)?;
        Ok(states)
    }

    /// The run of system s, not finite from where it overflows.
    pub(super) fn path(&self, s: usize, states: &mut [f64], stop: &Stop) -> Result<()> {
        let n = self.n;
        states[..n].copy_from_slice(self.start(s));
        for k in 0..self.steps() {
            stop.check()?;
            let (past, future) = states.split_at_mut((k + 1) * n);
            self.step(s, k, &past[k * n..], &mut future[..n]);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `N` systems of two states and one input, none like the other.
    fn numbers(count: usize, seed: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * 7919 + seed) as f64).sin() / 2.0).collect()
    }

    #[test]
    fn threads_change_nothing_and_the_moments_are_those_of_the_runs() {
        let (size, stop) = (3 * RUNS + 5, Stop::new());
        let (a, b, c) = (numbers(4 * size, 1), numbers(2 * size, 2), numbers(2 * size, 3));
        let (x0, u) = (numbers(2 * size, 4), numbers(6, 5));
        let given = Systems { n: 2, m: 1, a: &a, b: &b, c: Some(&c), x0: &x0, u: &u };
        for second in [Second::Diagonal, Second::Full] {
            let found = given.run(second, true, 1, &stop).unwrap();
            for threads in [2, 3, 8] {
                assert_eq!(given.run(second, true, threads, &stop).unwrap(), found);
            }
            for at in 0..14 {
                let values = found.runs.iter().skip(at).step_by(14);
                let mean = values.clone().sum::<f64>() / size as f64;
                let square = values.map(|v| (v - mean).powi(2)).sum::<f64>() / (size as f64 - 1.0);
                assert!((found.mean[at] - mean).abs() < 1e-15 * size as f64);
                assert!((found.variance.as_ref().unwrap()[at] - square).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn two_systems_by_hand() {
        let given = Systems { n: 1, m: 1, a: &[2.0, 3.0], b: &[1.0, -1.0], c: None, x0: &[1.0], u: &[4.0] };
        let found = given.run(Second::Diagonal, true, 1, &Stop::new()).unwrap();
        assert_eq!(found.runs, [1.0, 6.0, 1.0, -1.0]);
        assert_eq!((found.mean, found.variance), (vec![1.0, 2.5], Some(vec![0.0, 24.5])));
    }

    #[test]
    fn wrong_shapes_overflow_and_a_stop_are_errors() {
        let stop = Stop::new();
        let run = |a: &[f64], b: &[f64], c: Option<&[f64]>, x0: &[f64], u: &[f64]| {
            Systems { n: 1, m: 1, a, b, c, x0, u }.run(Second::Full, false, 2, &stop)
        };
        let two = &[1.0, 1.0][..];
        for (a, b, c, x0) in [
            (&[][..], &[][..], None, two),
            (two, &[1.0][..], None, two),
            (two, two, Some(&[1.0][..]), two),
            (two, two, None, &[1.0, 1.0, 1.0][..]),
        ] {
            assert!(matches!(run(a, b, c, x0, &[0.0]), Err(Error::Shape { .. })), "{a:?} {b:?} {c:?} {x0:?}");
        }
        assert!(matches!(run(two, two, None, two, &[f64::NAN]), Err(Error::NonFinite { name: "u", .. })));
        let grows = run(&[1.0, 1e200], two, None, two, &[0.0, 0.0]);
        assert_eq!(grows, Err(Error::Overflow { what: "a state of the ensemble" }));
        assert!(matches!(run(&[1.0, 1e200], two, None, two, &[0.0]), Err(Error::Overflow { .. })));
        stop.request();
        assert_eq!(run(two, two, None, two, &[0.0]), Err(Error::Interrupted));
    }
}
