//! Saves a stream as sections and loads it, bit for bit. Shapes, ranges, and whether the numbers belong together are
//! checked before a stream is made of them.

use super::estimator::Estimator;
use super::geometry::{Geometry, NAMES};
use super::products::Products;
use super::stream::{Config, Order, Stream, StreamLaws};
use super::trace::{Entry, on_grid};
use crate::error::Result;
use crate::fuse::distance;
use crate::memory::{try_collect, try_copy};
use crate::storage::{LARGEST, Sections, damaged};
use crate::stream::Key;
use crate::vector::norm;

/// Version of the sections. Others are refused, because their steps may differ in the last bits.
const FORMAT: u64 = 3;

const ORDERS: [Order; 3] = [Order::Random, Order::RoundRobin, Order::Gain];

impl Stream {
    /// Everything that the next step depends on.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn to_sections(&self) -> Result<Sections> {
        let mut out = Sections::default();
        let order = ORDERS.iter().position(|o| *o == self.config.order).unwrap_or(0) as u64;
        let (n, m) = (self.geometry.n as u64, self.geometry.m as u64);
        out.put_u64("format", &[FORMAT, n, m, u64::from(self.config.safeguard), order])?;
        out.put_u8("keys", self.keys.map(|key| key.0).as_flattened())?;
        out.put_f64("B", &self.geometry.b)?;
        let [c0, cf, ca] = self.counts();
        out.put_u64("steps", &[self.steps, c0, cf, ca])?;
        for (name, slot) in NAMES.iter().zip(&self.slots) {
            out.put_f64(*name, slot.law.values())?;
            let s = &slot.run.state;
            out.put_f64(format!("{name}.state"), &[slot.run.c, slot.run.b, s.ff, s.al, s.er, s.fs, s.ss, s.sa])?;
            out.put_f64(format!("{name}.fused"), &slot.run.tables.h)?;
            out.put_f64(format!("{name}.hits"), &slot.run.hits)?;
        }
        out.put_f64("products", &self.products.ff)?;
        out.put_f64("prod.sum", self.products.sums.as_flattened())?;
        out.put_f64("drift", &[self.drift])?;
        out.put_u64("trace.k", &try_collect("a state", self.trace.iter().map(|e| e.step))?)?;
        let values = try_collect("a state", self.trace.iter().map(|e| [e.certificate, e.error, e.size]))?;
        out.put_f64("trace.v", values.as_flattened())?;
        Ok(out)
    }

    /// The stream that [`Stream::to_sections`] saved.
    ///
    /// [`crate::Error::Value`] for `state` if the sections cannot come from a stream; the message says which one and
    /// why. For `B` and the laws, the errors of [`Stream::new`].
    /// `B` or the laws violate is named as when a stream is made.
    pub fn from_sections(mut from: Sections) -> Result<Self> {
        let format = from.take_u64("format", None)?;
        let (n, m, config) = match format[..] {
            [FORMAT, n, m, safeguard, order]
                if (1..=LARGEST).contains(&n) && (1..=LARGEST).contains(&m) && safeguard < 2 && order < 3 =>
            {
                (n as usize, m as usize, Config { safeguard: safeguard == 1, order: ORDERS[order as usize] })
            }
            _ => return Err(damaged("of format 3", format!("{format:?}"))),
        };
        let bytes = from.take_u8("keys", 128)?;
        let mut keys = [Key([0; 32]); 4];
        keys.iter_mut().zip(bytes.as_chunks::<32>().0).for_each(|(key, bytes)| key.0 = *bytes);
        let geometry = Geometry::new(from.take_f64("B", Some(n * m))?, n, m)?;
        let [x0, xf, a] = [n, n, n * n];
        let laws = StreamLaws {
            x0: from.take_f64("x0", Some(x0))?,
            xf: from.take_f64("xf", Some(xf))?,
            a: from.take_f64("A", Some(a))?,
            keys,
        };
        let mut stream = Self::unstarted(geometry, laws, config)?;
        let steps = from.take_u64("steps", Some(4))?;
        let total = steps[1..].iter().try_fold(0u64, |sum, count| sum.checked_add(*count));
        if steps[1..].contains(&0) || total != steps[0].checked_add(3) || steps[0] >= 1 << 62 {
            return Err(damaged("a state with 3 realizations and 1 per step", format!("{steps:?}")));
        }
        stream.steps = steps[0];
        if config.order == Order::Random {
            stream.choice.seek(stream.steps);
        }
        for (k, slot) in stream.slots.iter_mut().enumerate() {
            load_slot(slot, NAMES[k], steps[k + 1], config, &mut from)?;
        }
        stream.start.update(&stream.slots[0]);
        stream.load_products(&mut from)?;
        stream.drift = from.take_f64("drift", Some(1))?[0];
        if stream.drift < 0.0 {
            return Err(damaged("a state with a drift >= 0", stream.drift.to_string()));
        }
        stream.load_trace(&mut from)?;
        from.finish()?;
        Ok(stream)
    }

    fn load_products(&mut self, from: &mut Sections) -> Result<()> {
        let n = self.n();
        let sums = if self.config.safeguard { 3 * n } else { 0 };
        let ff = from.take_f64("products", Some(n))?;
        let sums = from.take_f64("prod.sum", Some(sums))?;
        self.products = Products { ff, sums: try_copy("a state", sums.as_chunks::<3>().0)? };
        let fresh = Products::direct(&self.slots[2], &self.start)?;
        let size = norm(&self.slots[2].estimate()?) * norm(&self.start.f);
        let sizes = fresh.sums.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
        let apart = distance(&fresh.ff, &self.products.ff) > 1e-6 * size
            || distance(fresh.sums.as_flattened(), self.products.sums.as_flattened()) > 1e-6 * sizes;
        if apart {
            return Err(damaged("a state with the products of its estimates", "others".into()));
        }
        Ok(())
    }

    fn load_trace(&mut self, from: &mut Sections) -> Result<()> {
        let at = from.take_u64("trace.k", None)?;
        let values = from.take_f64("trace.v", Some(at.len().saturating_mul(3)))?;
        let rising = at.windows(2).all(|pair| pair[0] < pair[1]);
        let within = at.iter().all(|step| *step <= self.steps && on_grid(*step));
        let possible =
            |&[certificate, error, size]: &[f64; 3]| certificate >= 0.0 && error >= 0.0 && (0.0..=1.0).contains(&size);
        let possible = values.as_chunks::<3>().0.iter().all(possible);
        if !rising || !within || !possible || at.first() != Some(&0) {
            return Err(damaged("a state with a trace of its steps", format!("{} entries", at.len())));
        }
        // increasing steps on the grid, so at most as many as there is room for
        self.trace.extend(at.iter().zip(values.as_chunks::<3>().0).map(|(&step, &[certificate, error, size])| Entry {
            step,
            certificate,
            error,
            size,
        }));
        Ok(())
    }
}

fn load_slot(slot: &mut Estimator, name: &str, count: u64, config: Config, from: &mut Sections) -> Result<()> {
    let entries = slot.run.tables.h.len();
    let state = from.take_f64(&format!("{name}.state"), Some(8))?;
    slot.run.tables.h = from.take_f64(&format!("{name}.fused"), Some(entries))?;
    slot.run.hits = from.take_f64(&format!("{name}.hits"), Some(if config.safeguard { entries } else { 0 }))?;
    // the latest realization is drawn again from its number
    slot.sequence.seek(count - 1);
    slot.raw.copy_from_slice(slot.sequence.draw());
    let run = &mut slot.run;
    let s = &mut run.state;
    [run.c, run.b, s.ff, s.al, s.er, s.fs, s.ss, s.sa] = state[..].try_into().map_err(|_| {
        damaged("a state with arrays of the right sizes", format!("{} numbers in {name:?}", state.len()))
    })?;
    if !(run.c > 0.0 && run.c <= 1.0 && run.b >= 0.0 && (config.safeguard || run.b == 0.0)) {
        return Err(damaged("a state with possible scale factors", format!("{} and {}", run.c, run.b)));
    }
    slot.check()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::Values;
    use crate::streaming::stream::tests::{every_config, stream};
    use proptest::prelude::*;

    #[test]
    fn there_and_back_bit_for_bit() {
        for config in every_config() {
            for steps in [0, 1, 127, 128, 257, 400] {
                let mut whole = stream(6, config);
                (0..steps).for_each(|_| {
                    whole.step();
                });
                let mut back = Stream::from_sections(whole.to_sections().unwrap()).unwrap();
                assert_eq!(back.to_sections().unwrap(), whole.to_sections().unwrap());
                (0..300).for_each(|_| {
                    assert_eq!(back.step(), whole.step());
                });
                assert_eq!(back.to_sections().unwrap(), whole.to_sections().unwrap());
                assert_eq!(back.control().unwrap().control, whole.control().unwrap().control);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            cases: ProptestConfig::default().cases.max(1000),
            failure_persistence: None,
            ..ProptestConfig::default()
        })]

        /// One number of a good state is replaced by any other: refused, or the stream works.
        #[test]
        fn any_damage_is_survived(which in 0usize..1 << 20, at in 0usize..1 << 20, bits: u64, config in 0usize..6) {
            let mut good = stream(4, every_config()[config]);
            (0..50).for_each(|_| {
                good.step();
            });
            let mut sections = good.to_sections().unwrap();
            let count = sections.0.len();
            match &mut sections.0[which % count].values {
                Values::Bytes(values) => { let values = values.to_mut(); let at = at % values.len(); values[at] = bits as u8; }
                Values::Integers(values) => { let values = values.to_mut(); let at = at % values.len(); values[at] = bits; }
                Values::Reals(values) if values.is_empty() => values.to_mut().push(1.0),
                Values::Reals(values) => { let values = values.to_mut(); let at = at % values.len(); values[at] = f64::from_bits(bits); }
            }
            if let Ok(mut stream) = Stream::from_sections(sections) {
                (0..600).for_each(|_| {
                    stream.step();
                });
                prop_assert!(stream.residuals().unwrap().iter().all(|r| r.is_finite()));
                prop_assert!(stream.certificate().unwrap().1.is_finite());
            }
        }
    }
}
