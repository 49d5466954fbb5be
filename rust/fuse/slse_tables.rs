//! The two numbers of every entry that a step of SLSE reads: `h_k` and `g a_k` (see [`super::slse_run`]).
//!
//! Two tables while both fit into a first-level cache, where two loads are cheapest; otherwise one table of pairs, so
//! that one cache line has both.

#![allow(unsafe_code, reason = "a bounds check per entry costs a fourth of a step; indices are checked block by block")]

use super::slse_sample::Sample;
use crate::error::Result;
use crate::huge_pages::Buffer;
use crate::memory::try_zeros;
use crate::sample::Index;

pub(super) const WHAT: &str = "a sequential fit";

/// `h` and `g a`, entry by entry.
pub(crate) trait Tables: Sized {
    /// `h = 0`, and `g a` from the `a` of all entries in lines of `length`.
    fn new(length: usize, gamma: &[f64], a: impl Iterator<Item = f64>) -> Result<Self>;

    /// `h_k` from one entry up to another.
    fn h(&self, from: usize, to: usize) -> impl Iterator<Item = f64>;

    /// Number of entries.
    fn len(&self) -> usize;

    /// `(h_k, g a_k)`
    fn get(&self, k: usize) -> (f64, f64);

    /// `h_k`, to be changed.
    fn h_mut(&mut self, k: usize) -> &mut f64;

    /// The first `reach` entries, without bounds checks.
    fn view(&mut self, reach: usize) -> impl View;

    /// `(sum_j h, sum_j g a)` over the entries that a realization hits.
    #[inline(always)]
    fn gather<I: Index>(&mut self, sample: Sample<'_, I>) -> (f64, f64) {
        let view = self.view(sample.reach());
        // SAFETY: the positions of a sample are below its reach.
        sample.sums(|k| unsafe { view.get(k) })
    }

    /// Adds `step g_j^2` to `h` at the entries that the realization hits.
    #[inline(always)]
    fn scatter<I: Index>(&mut self, sample: Sample<'_, I>, g2: &[f64], step: f64) {
        let mut view = self.view(sample.reach());
        // SAFETY: as in `gather`.
        sample.positions().zip(g2).for_each(|(k, g2)| unsafe { view.add(k, step * g2) });
    }

    /// [`Self::scatter`] of one realization, then [`Self::gather`] of the next, in one pass: the loads of the second do
    /// not wait for the last store of the first.
    #[inline(always)]
    fn scatter_and_gather<I: Index>(
        &mut self,
        sample: Sample<'_, I>,
        g2: &[f64],
        step: f64,
        next: Sample<'_, I>,
    ) -> (f64, f64) {
        let mut view = self.view(sample.reach());
        // SAFETY: as in `gather`; `add_and_sum` makes sure that the next sample has the same lines.
        sample.add_and_sum(
            next,
            g2,
            &mut view,
            |view, k, g2| unsafe { view.add(k, step * g2) },
            |view, k| unsafe { view.get(k) },
        )
    }
}

/// The entries below some reach.
pub(crate) trait View {
    /// `(h_k, g a_k)`
    ///
    /// # Safety
    /// `k` is below the reach.
    unsafe fn get(&self, k: usize) -> (f64, f64);

    /// `h_k += value`
    ///
    /// # Safety
    /// `k` is below the reach.
    unsafe fn add(&mut self, k: usize, value: f64);
}

impl View for (&mut [f64], &[f64]) {
    #[inline(always)]
    unsafe fn get(&self, k: usize) -> (f64, f64) {
        // SAFETY: both slices end at the reach.
        unsafe { (*self.0.get_unchecked(k), *self.1.get_unchecked(k)) }
    }

    #[inline(always)]
    unsafe fn add(&mut self, k: usize, value: f64) {
        // SAFETY: as above.
        unsafe { *self.0.get_unchecked_mut(k) += value };
    }
}

impl View for &mut [[f64; 2]] {
    #[inline(always)]
    unsafe fn get(&self, k: usize) -> (f64, f64) {
        // SAFETY: the slice ends at the reach.
        unsafe { (*self.get_unchecked(k)).into() }
    }

    #[inline(always)]
    unsafe fn add(&mut self, k: usize, value: f64) {
        // SAFETY: as above.
        unsafe { self.get_unchecked_mut(k)[0] += value };
    }
}

/// Two tables of equal length.
pub(crate) struct Apart {
    pub(crate) h: Vec<f64>,
    pub(super) a: Vec<f64>,
}

impl Tables for Apart {
    fn new(length: usize, gamma: &[f64], mut a: impl Iterator<Item = f64>) -> Result<Self> {
        let len = gamma.len() * length;
        let mut tables = Self { h: try_zeros(WHAT, len)?, a: try_zeros(WHAT, len)? };
        for (line, g) in tables.a.chunks_exact_mut(length).zip(gamma) {
            line.iter_mut().zip(&mut a).for_each(|(ga, a)| *ga = g * a);
        }
        Ok(tables)
    }

    fn h(&self, from: usize, to: usize) -> impl Iterator<Item = f64> {
        self.h[from..to].iter().copied()
    }

    fn len(&self) -> usize {
        self.h.len()
    }

    fn get(&self, k: usize) -> (f64, f64) {
        (self.h[k], self.a[k])
    }

    fn h_mut(&mut self, k: usize) -> &mut f64 {
        &mut self.h[k]
    }

    #[inline(always)]
    fn view(&mut self, reach: usize) -> impl View {
        (&mut self.h[..reach], &self.a[..reach])
    }
}

/// One table of pairs, in large pages if available, because steps read it at random.
pub(super) struct Beside(Buffer<[f64; 2]>);

impl Tables for Beside {
    fn new(length: usize, gamma: &[f64], mut a: impl Iterator<Item = f64>) -> Result<Self> {
        let mut pairs = Buffer::unset(WHAT, gamma.len() * length)?;
        for (line, g) in pairs.chunks_exact_mut(length).zip(gamma) {
            // every pair gets a value, even if there are too few targets
            line.iter_mut().for_each(|pair| *pair = [0.0, g * a.next().unwrap_or(0.0)]);
        }
        Ok(Self(pairs))
    }

    fn h(&self, from: usize, to: usize) -> impl Iterator<Item = f64> {
        self.0[from..to].iter().map(|pair| pair[0])
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn get(&self, k: usize) -> (f64, f64) {
        self.0[k].into()
    }

    fn h_mut(&mut self, k: usize) -> &mut f64 {
        &mut self.0[k][0]
    }

    #[inline(always)]
    fn view(&mut self, reach: usize) -> impl View {
        &mut self.0[..reach]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One pass gives the bits of two, for any number of lines modulo 4, and if both realizations hit the same entries.
    #[test]
    fn one_pass_gives_the_bits_of_two() {
        fn compare<T: Tables>(lines: usize) {
            let length = 3;
            let number = |k: usize| 0.1 + (k as f64 * 0.754_877).fract();
            let gamma: Vec<f64> = (0..lines).map(number).collect();
            let indices: Vec<u8> = (0..20 * lines).map(|k| (k * k % 11 % length) as u8).collect();
            let samples: Vec<_> = Sample::all(&indices, lines, length).collect();
            let tables = || T::new(length, &gamma, (0..lines * length).map(number)).unwrap();
            let (mut one, mut two) = (tables(), tables());
            for (at, &sample) in samples.iter().enumerate() {
                let next = samples[if at % 3 == 0 { at } else { (at + 7) % samples.len() }];
                let (x, y) = one.scatter_and_gather(sample, &gamma, number(at), next);
                two.scatter(sample, &gamma, number(at));
                let (u, v) = two.gather(next);
                assert_eq!((x.to_bits(), y.to_bits()), (u.to_bits(), v.to_bits()), "{lines} lines, step {at}");
                assert!((0..one.len()).all(|k| one.get(k) == two.get(k)));
            }
        }
        for lines in 1..=9 {
            compare::<Apart>(lines);
            compare::<Beside>(lines);
        }
    }
}
