//! One realization as positions in a table, and sums over these positions.

use crate::sample::Index;

/// One realization in tables of lines with `length` entries: it hits the positions `j length + R_j`.
///
/// Only [`Sample::all`] makes one, after it has checked that every `R_j` is below `length`.
#[derive(Clone, Copy)]
pub(crate) struct Sample<'a, I> {
    indices: &'a [I],
    length: usize,
}

impl<'a, I: Index> Sample<'a, I> {
    /// The realizations of a block of indices, `lines` each.
    pub(super) fn all(block: &'a [I], lines: usize, length: usize) -> impl Iterator<Item = Self> {
        let max = block.iter().fold(I::default(), |max, &r| r.max(max)).get();
        assert!(max < length, "an index of a sample is {max}, beyond a line of {length} entries");
        block.chunks_exact(lines).map(move |indices| Self { indices, length })
    }

    /// `lines length`: above all positions; computing it does not overflow.
    #[inline(always)]
    pub(super) fn reach(self) -> usize {
        self.indices.len() * self.length
    }

    /// The positions, line by line; all are below [`Self::reach`], so nothing overflows.
    #[inline(always)]
    pub(super) fn positions(self) -> impl Iterator<Item = usize> {
        let mut base = 0_usize;
        self.indices.iter().map(move |r| {
            let k = base.wrapping_add(r.get());
            base = base.wrapping_add(self.length);
            k
        })
    }

    /// Sums of a pair over the positions, four lines at a time, so that an addition does not wait for the one before.
    #[inline(always)]
    pub(super) fn sums(self, pair: impl Fn(usize) -> (f64, f64)) -> (f64, f64) {
        let (mut x, mut y) = ([0.0; 4], [0.0; 4]);
        let mut base = 0_usize;
        let (fours, rest) = self.indices.as_chunks::<4>();
        for four in fours {
            for lane in 0..4 {
                let (xk, yk) = pair(base.wrapping_add(four[lane].get()));
                x[lane] += xk;
                y[lane] += yk;
                base = base.wrapping_add(self.length);
            }
        }
        for r in rest {
            let (xk, yk) = pair(base.wrapping_add(r.get()));
            x[0] += xk;
            y[0] += yk;
            base = base.wrapping_add(self.length);
        }
        ((x[0] + x[1]) + (x[2] + x[3]), (y[0] + y[1]) + (y[2] + y[3]))
    }

    /// `add` at the positions of this realization, and [`Self::sums`] of the next, which has as many lines. Both take
    /// the same four lines in turn, so that a line has its new values before it is read. All positions are below
    /// [`Self::reach`].
    #[inline(always)]
    pub(super) fn add_and_sum<T: ?Sized>(
        self,
        next: Self,
        g2: &[f64],
        table: &mut T,
        add: impl Fn(&mut T, usize, f64),
        pair: impl Fn(&T, usize) -> (f64, f64),
    ) -> (f64, f64) {
        assert!(next.length == self.length && next.indices.len() == self.indices.len());
        let (mut x, mut y) = ([0.0; 4], [0.0; 4]);
        let mut base = 0_usize;
        let (fours, rest) = self.indices.as_chunks::<4>();
        let (next_fours, next_rest) = next.indices.as_chunks::<4>();
        let (g2_fours, g2_rest) = g2.as_chunks::<4>();
        for ((four, next), g2) in fours.iter().zip(next_fours).zip(g2_fours) {
            let bases = [0, 1, 2, 3].map(|lane| base.wrapping_add(self.length.wrapping_mul(lane)));
            for lane in 0..4 {
                add(table, bases[lane].wrapping_add(four[lane].get()), g2[lane]);
            }
            for lane in 0..4 {
                let (xk, yk) = pair(table, bases[lane].wrapping_add(next[lane].get()));
                x[lane] += xk;
                y[lane] += yk;
            }
            base = base.wrapping_add(self.length.wrapping_mul(4));
        }
        for ((r, next), g2) in rest.iter().zip(next_rest).zip(g2_rest) {
            add(table, base.wrapping_add(r.get()), *g2);
            let (xk, yk) = pair(table, base.wrapping_add(next.get()));
            x[0] += xk;
            y[0] += yk;
            base = base.wrapping_add(self.length);
        }
        ((x[0] + x[1]) + (x[2] + x[3]), (y[0] + y[1]) + (y[2] + y[3]))
    }
}

/// `sum_j g_j^2` in the order of [`Sample::sums`], so that the inner product of a realization with itself is its
/// squared norm to the last bit.
pub(super) fn squared_norm(g2: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (fours, rest) = g2.as_chunks::<4>();
    for four in fours {
        sums.iter_mut().zip(four).for_each(|(sum, g2)| *sum += g2);
    }
    rest.iter().for_each(|g2| sums[0] += g2);
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}
