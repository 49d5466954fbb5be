//! Estimates in files: the triangle of their data, from which they are made again.

use super::estimate::{Data, Estimate};
use crate::error::Result;
use crate::memory::checked_len;
use crate::parallel::Stop;
use crate::storage::{Saved, Sections, damaged};

const FORMAT: u64 = 1;
/// Most pairs: numbers up to here are doubles.
const MOST: u64 = 1 << 53;

impl Saved for Estimate {
    const KIND: &'static str = "core.estimate";

    fn put(&self, to: &mut Sections) -> Result<()> {
        let (offset, known) = (self.d > self.n + self.m, self.known.as_deref());
        let sizes = [self.n as u64, self.m as u64, u64::from(offset), u64::from(known.is_some())];
        to.put_u64("estimate", &[FORMAT, sizes[0], sizes[1], sizes[2], sizes[3]])?;
        to.put_u64("pairs", &[self.size as u64])?;
        to.put_f64("triangle", &self.triangle)?;
        to.put_f64("known", known.unwrap_or_default())
    }

    fn take(from: &mut Sections, stop: &Stop) -> Result<Self> {
        let [n, m, offset, known] = from.take_sizes("estimate", FORMAT)?;
        let pairs = from.take_u64("pairs", Some(1))?[0];
        let size = usize::try_from(pairs).ok().filter(|_| pairs <= MOST);
        let size = size.ok_or_else(|| damaged("a state of at most 2^53 pairs", pairs.to_string()))?;
        let width = 2 * n + m + offset;
        let triangle = from.take_f64("triangle", Some(checked_len("a state", width, width)?))?;
        let known = known == 1;
        let entries = if known { checked_len("a state", n, width - n)? } else { 0 };
        let entries = from.take_reals("known", Some(entries))?; // NaN where it is to be estimated
        let known = known.then_some(&entries[..]);
        Self::new(Data { triangle: &triangle, size, n, m, offset: offset == 1, known }, stop)
    }
}
