//! Saves a data stream as sections and loads it, bit for bit; loaded numbers are checked as in [`super::state`].

use super::data::{DataStream, Feed, GROUPS, size};
use super::geometry::{Geometry, NAMES};
use crate::error::Result;
use crate::fuse::distance;
use crate::storage::{LARGEST, Sections, damaged};

/// Version of the sections. Others are refused, because their steps may differ in the last bits.
const FORMAT: u64 = 4;

impl DataStream {
    /// Everything that the next update depends on.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn to_sections(&self) -> Result<Sections> {
        let mut out = Sections::default();
        let known = |feed: &Feed| u64::from(feed.target.is_some());
        let [x0, xf, a] = &self.feeds;
        let (n, m) = (self.geometry.n as u64, self.geometry.m as u64);
        out.put_u64("format", &[FORMAT, n, m, known(x0), known(xf), known(a)])?;
        out.put_f64("B", &self.geometry.b)?;
        for (name, feed) in NAMES.iter().zip(&self.feeds) {
            out.put_u64(format!("{name}.count"), &[feed.count])?;
            out.put_f64(format!("{name}.range"), &[feed.deviation, feed.spread])?;
            out.put_f64(format!("{name}.mean"), &feed.mean)?;
            out.put_f64(format!("{name}.first"), &feed.first)?;
            out.put_f64(format!("{name}.low"), &feed.low)?;
            out.put_f64(format!("{name}.high"), &feed.high)?;
            out.put_f64(format!("{name}.groups"), &feed.groups)?;
            out.put_f64(format!("{name}.fused"), &feed.estimate)?;
            out.put_f64(format!("{name}.aim"), feed.target.as_deref().unwrap_or_default())?;
        }
        Ok(out)
    }

    /// The stream that [`DataStream::to_sections`] saved.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for `state` if the sections cannot come from a stream.
    pub fn from_sections(mut from: Sections) -> Result<Self> {
        let format = from.take_u64("format", None)?;
        let (n, m, known) = match format[..] {
            [FORMAT, n, m, x0, xf, a]
                if (1..=LARGEST).contains(&n) && (1..=LARGEST).contains(&m) && x0 < 2 && xf < 2 && a < 2 =>
            {
                (n as usize, m as usize, [x0, xf, a].map(|known| known == 1))
            }
            _ => return Err(damaged("of format 4", format!("{format:?}"))),
        };
        let geometry = Geometry::new(from.take_f64("B", Some(n * m))?, n, m)?;
        let mut made = Self::new(geometry, [None, None, None])?;
        for ((feed, name), known) in made.feeds.iter_mut().zip(NAMES).zip(known) {
            let dim = feed.mean.len();
            let kept = if known { dim } else { 0 };
            feed.count = from.take_u64(&format!("{name}.count"), Some(1))?[0];
            let spread = from.take_f64(&format!("{name}.range"), Some(2))?;
            (feed.deviation, feed.spread) = (spread[0], spread[1]);
            feed.mean = from.take_f64(&format!("{name}.mean"), Some(dim))?;
            feed.first = from.take_f64(&format!("{name}.first"), Some(dim))?;
            feed.low = from.take_f64(&format!("{name}.low"), Some(dim - kept))?;
            feed.high = from.take_f64(&format!("{name}.high"), Some(dim - kept))?;
            feed.groups = from.take_f64(&format!("{name}.groups"), Some(GROUPS * (dim - kept)))?;
            feed.estimate = from.take_f64(&format!("{name}.fused"), Some(kept))?;
            let target = from.take_f64(&format!("{name}.aim"), Some(kept))?;
            feed.target = known.then_some(target);
            // ||E_i - E_1|| <= spread for all i, so the means are within spread of E_1, and the deviation is at most
            // spread sqrt(N)
            let slack = 1.0 + 1e-6;
            let near = |v: &[f64]| distance(v, &feed.first) <= slack * feed.spread + 1e-6 * size(v);
            // the first realization lies between low and high, and both are within the spread of it
            let inside = |((low, high), first): ((&f64, &f64), &f64)| {
                (0.0..=feed.spread).contains(&(first - low)) && (0.0..=feed.spread).contains(&(high - first))
            };
            let fits = near(&feed.mean)
                && feed.low.iter().zip(&feed.high).zip(&feed.first).all(inside)
                && (!known || near(&feed.estimate))
                && feed.groups.chunks_exact(dim).take(feed.count.min(GROUPS as u64) as usize).all(near)
                && (0.0..=slack * feed.spread * (feed.count as f64).sqrt()).contains(&feed.deviation)
                && feed.count < 1 << 62
                && (feed.count > 1 || feed.spread == 0.0);
            if !fits {
                return Err(damaged("a state with means among the realizations", format!("others for {name:?}")));
            }
        }
        from.finish()?;
        Ok(made)
    }
}
