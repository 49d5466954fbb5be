//! `N` realizations as indices, and sums over them.

use std::sync::Arc;

use super::law::Law;
use crate::error::{Error, Result};
use crate::memory::{try_collect, try_zeros};
use crate::parallel::Stop;
use crate::pod::Pod;

/// Realizations between two checks of the stop flag: well below a millisecond per line.
const BLOCK: usize = 1 << 14;

/// An unsigned integer that stores the index of an entry in its line.
pub trait Index: Pod + Ord {
    /// The index as stored; the caller has checked that it fits.
    fn new(index: u32) -> Self;
    /// The index as a position.
    fn get(self) -> usize;
}

macro_rules! impl_index {
    ($($t:ty),*) => {$(
        impl Index for $t {
            #[inline(always)]
            fn new(index: u32) -> Self {
                index as $t
            }
            #[inline(always)]
            fn get(self) -> usize {
                self as usize
            }
        }
    )*};
}
impl_index!(u8, u16, u32);

/// The indices of a sample in the narrowest of three widths; entry `i * lines + j` belongs to sample `i`, line `j`.
#[derive(Debug, PartialEq, Eq)]
pub enum Indices {
    /// Lines of at most 256 entries.
    U8(Vec<u8>),
    /// Lines of at most 65 536 entries.
    U16(Vec<u16>),
    /// Longer lines.
    U32(Vec<u32>),
}

/// Runs one generic expression on whichever index slice is there.
macro_rules! with_indices {
    ($indices:expr, $slice:ident => $body:expr) => {
        match $indices {
            $crate::sample::Indices::U8($slice) => $body,
            $crate::sample::Indices::U16($slice) => $body,
            $crate::sample::Indices::U32($slice) => $body,
        }
    };
}
pub(crate) use with_indices;

impl Indices {
    /// `len` zeros, of the width that lines of `length` entries need.
    ///
    /// # Errors
    /// [`crate::Error::Memory`] if they do not fit.
    pub(crate) fn zeros(length: usize, len: usize) -> Result<Self> {
        const WHAT: &str = "the indices of a sample";
        Ok(if length <= 1 << 8 {
            Self::U8(try_zeros(WHAT, len)?)
        } else if length <= 1 << 16 {
            Self::U16(try_zeros(WHAT, len)?)
        } else {
            Self::U32(try_zeros(WHAT, len)?)
        })
    }

    /// How many indices there are.
    pub fn len(&self) -> usize {
        with_indices!(self, v => v.len())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes of one index.
    pub fn width(&self) -> usize {
        match self {
            Self::U8(_) => 1,
            Self::U16(_) => 2,
            Self::U32(_) => 4,
        }
    }

    fn max(&self) -> usize {
        with_indices!(self, v => v.iter().max().map_or(0, |m| m.get()))
    }
}

/// `size` realizations of one law. Cheap to clone and to cut: the indices are shared.
#[derive(Debug, Clone)]
pub struct Singletons {
    law: Arc<Law>,
    indices: Arc<Indices>,
    size: usize,
}

impl Singletons {
    /// Realizations with the given indices (`size * lines` of them, each below the law's length).
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] if the indices do not belong to the law.
    pub fn new(law: Arc<Law>, indices: Indices, size: usize) -> Result<Self> {
        if size.checked_mul(law.lines()) != Some(indices.len()) {
            return Err(Error::Shape {
                name: "indices",
                expected: format!("{size} x {} entries", law.lines()),
                found: format!("{} entries", indices.len()),
            });
        }
        let max = indices.max();
        if max >= law.length() {
            return Err(Error::Value {
                name: "indices",
                expected: "below the length of a line",
                found: max.to_string(),
            });
        }
        // no realization of the law hits an entry of probability zero
        let lines = law.lines();
        let impossible = with_indices!(&indices, v => v.iter().enumerate().find_map(|(at, r)| {
            let j = at % lines;
            (law.gamma()[j] > 0.0 && law.line(j)[r.get()] == 0.0).then(|| r.get())
        }));
        if let Some(r) = impossible {
            let expected = "at nonzero entries (a zero entry is never hit)";
            return Err(Error::Value { name: "indices", expected, found: r.to_string() });
        }
        Ok(Self::from_parts(law, Arc::new(indices), size))
    }

    pub(super) fn from_parts(law: Arc<Law>, indices: Arc<Indices>, size: usize) -> Self {
        Self { law, indices, size }
    }

    /// The law the realizations were drawn from.
    pub fn law(&self) -> &Arc<Law> {
        &self.law
    }

    /// How many realizations there are.
    pub fn size(&self) -> usize {
        self.size
    }

    /// The shared index array; the first `size * lines` entries belong to this sample.
    pub fn indices(&self) -> &Arc<Indices> {
        &self.indices
    }

    /// The first `size` realizations (all of them if there are fewer), without a copy.
    #[must_use]
    pub fn prefix(&self, size: usize) -> Self {
        Self { law: Arc::clone(&self.law), indices: Arc::clone(&self.indices), size: size.min(self.size) }
    }

    /// How many realizations hit each entry, line by line. A zero line counts its first entry.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after a stop.
    pub fn counts(&self, stop: &Stop) -> Result<Vec<u64>> {
        let mut counts = try_zeros("the counts", self.law.values().len())?;
        self.add_counts(0, self.size, &mut counts, stop)?;
        Ok(counts)
    }

    /// Adds the hits of the realizations `from..to`.
    pub(crate) fn add_counts(&self, from: usize, to: usize, counts: &mut [u64], stop: &Stop) -> Result<()> {
        let (lines, length) = (self.law.lines(), self.law.length());
        with_indices!(&*self.indices, indices => {
            for block in indices[from * lines..to * lines].chunks(BLOCK * lines) {
                stop.check()?;
                for sample in block.chunks_exact(lines) {
                    let mut base = 0;
                    for r in sample {
                        counts[base + r.get()] += 1;
                        base += length;
                    }
                }
            }
        });
        Ok(())
    }

    /// `sum_i w_i E_i`, line by line; `weights` has one entry per realization.
    ///
    /// # Errors
    /// [`Error::Interrupted`] after a stop.
    pub fn combine(&self, weights: &[f64], stop: &Stop) -> Result<Vec<f64>> {
        let (lines, length) = (self.law.lines(), self.law.length());
        let mut sums: Vec<f64> = try_zeros("a combination", self.law.values().len())?;
        with_indices!(&*self.indices, indices => {
            for (block, weights) in indices.chunks(BLOCK * lines).zip(weights.chunks(BLOCK)) {
                stop.check()?;
                for (sample, &w) in block.chunks_exact(lines).zip(weights) {
                    let mut base = 0;
                    for r in sample {
                        sums[base + r.get()] += w;
                        base += length;
                    }
                }
            }
        });
        for (sum, atom) in sums.iter_mut().zip(self.law.atoms()?) {
            *sum *= atom;
        }
        Ok(sums)
    }

    /// `<r, E_i>` for every realization, given `r` line by line.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn correlate(&self, r: &[f64]) -> Result<Vec<f64>> {
        let (lines, length) = (self.law.lines(), self.law.length());
        let mut table = self.law.atoms()?;
        table.iter_mut().zip(r).for_each(|(to, r)| *to *= r);
        with_indices!(&*self.indices, indices => {
            let samples = indices.chunks_exact(lines).take(self.size);
            let product = samples.map(|sample| table.chunks_exact(length).zip(sample).map(|(line, r)| line[r.get()]).sum());
            try_collect("the inner products", product)
        })
    }
}
