//! Realizations as messages of a few bits: which entry, and its sign.
//!
//! The message of one line is the code `2 i + s` in `ceil(log2(2 length))` bits, with the index `i`, and `s = 1` where the
//! entry is negative. Messages follow each other without gaps, the lowest bit first; zeros fill up the last byte.

use super::{Indices, Law, Singletons, with_indices};
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_room, try_zeros};
use crate::sample::Index as _;

const WHAT: &str = "the messages";

/// Bits of a message about a line of `length` entries (at most `2^31`).
pub fn message_bits(length: usize) -> u32 {
    u64::BITS - (2 * length.max(1) as u64 - 1).leading_zeros()
}

/// Bytes of `size` realizations.
fn bytes_of(size: usize, lines: usize, length: usize) -> Result<usize> {
    let bits = checked_len(WHAT, checked_len(WHAT, size, lines)?, message_bits(length) as usize)?;
    Ok(bits.div_ceil(8))
}

impl Singletons {
    /// All realizations as messages.
    ///
    /// # Errors
    /// [`Error::Memory`].
    ///
    /// # Example
    /// ```
    /// use stochens::{Key, Law, Scheme, Singletons, Stop, sample};
    /// let law = Law::new(vec![3.0, -1.0, 0.0, 2.0], 1, 4)?;
    /// let draws = sample(&law.into(), 1000, Scheme::Iid, &Key([7; 32]), 1, &Stop::new())?;
    /// let sent = draws.to_bytes()?;
    /// assert_eq!(sent.len(), 375); // three bits each
    /// let read = Singletons::from_bytes(&sent, &[6.0], 4, 1000)?;
    /// assert_eq!(read.indices(), draws.indices());
    /// # Ok::<(), stochens::Error>(())
    /// ```
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let (lines, length, values) = (self.law().lines(), self.law().length(), self.law().values());
        let bits = message_bits(length);
        let mut sent = try_room(WHAT, bytes_of(self.size(), lines, length)?)?;
        let (mut rest, mut filled) = (0_u64, 0);
        with_indices!(&**self.indices(), indices => {
            for realization in indices.chunks_exact(lines).take(self.size()) {
                for (line, index) in values.chunks_exact(length).zip(realization) {
                    let i = index.get();
                    rest |= (2 * i as u64 + u64::from(line[i] < 0.0)) << filled;
                    filled += bits;
                    while filled >= 8 {
                        sent.push(rest as u8);
                        rest >>= 8;
                        filled -= 8;
                    }
                }
            }
        });
        if filled > 0 {
            sent.push(rest as u8);
        }
        Ok(sent)
    }

    /// Reads `size` realizations of lines of `length` entries, whose 1-norms are `norms`.
    ///
    /// The mean of the law is that of the messages: beside the norms, nothing else is known of it.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] for what no sender with these norms has written.
    pub fn from_bytes(sent: &[u8], norms: &[f64], length: usize, size: usize) -> Result<Self> {
        let (lines, bits) = (norms.len(), message_bits(length));
        let expected = bytes_of(size, lines, length)?;
        if sent.len() != expected {
            let expected = format!("{expected} bytes for {size} realizations of {lines} messages of {bits} bits");
            return Err(Error::Shape { name: "data", expected, found: format!("{} bytes", sent.len()) });
        }
        let refused = |expected, found| Err(Error::Value { name: "data", expected, found });
        if let Some(norm) = norms.iter().find(|g| !(**g >= 0.0 && g.is_finite())) {
            return Err(Error::Value { name: "norm", expected: "finite and >= 0", found: norm.to_string() });
        }
        let mut values: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, lines, length)?)?;
        let mut indices = Indices::zeros(length, size * lines)?;
        let (mut rest, mut filled, mut bytes) = (0_u64, 0, sent.iter());
        with_indices!(&mut indices, out => {
            for (k, to) in out.iter_mut().enumerate() {
                while filled < bits {
                    rest |= u64::from(bytes.next().copied().unwrap_or_default()) << filled;
                    filled += 8;
                }
                let code = rest & ((1 << bits) - 1);
                rest >>= bits;
                filled -= bits;
                let (i, sign) = ((code >> 1) as usize, if code & 1 == 1 { -1.0 } else { 1.0 });
                if i >= length {
                    return refused("indices of entries", format!("{i} for {length} entries"));
                }
                let hits = &mut values[k % lines * length + i];
                if *hits * sign < 0.0 {
                    return refused("of one sender, whose entries have one sign", format!("entry {i} with both signs"));
                }
                *hits += sign;
                *to = crate::sample::Index::new(i as u32);
            }
        });
        if rest != 0 {
            return refused("filled up with zeros", "other bits at its end".into());
        }
        // g (hits / N): the 1-norm of a line is g again
        for (line, g) in values.chunks_exact_mut(length).zip(norms) {
            line.iter_mut().for_each(|v| *v *= g / size as f64);
        }
        Self::new(Law::new(values, lines, length)?.into(), indices, size)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Key, Scheme, Stop, sample};

    #[test]
    fn a_message_has_as_few_bits_as_tell_all_codes_apart() {
        let known = [(1, 1), (2, 2), (3, 3), (4, 3), (100, 8), (128, 8), (129, 9), (1 << 31, 32)];
        assert!(known.iter().all(|&(length, bits)| message_bits(length) == bits));
    }

    #[test]
    fn what_was_sent_is_read() {
        for (lines, length) in [(1, 1), (1, 5), (3, 7), (2, 300), (1, 70_000)] {
            let entries = (0..lines * length).map(|k| ((k * 37 % 11) as f64 - 5.0) * 1e-3).collect();
            let law = std::sync::Arc::new(Law::new(entries, lines, length).unwrap());
            let draws = sample(&law, 501, Scheme::Iid, &Key([3; 32]), 1, &Stop::new()).unwrap();
            let sent = draws.to_bytes().unwrap();
            let read = Singletons::from_bytes(&sent, law.gamma(), length, 501).unwrap();
            assert_eq!(read.indices(), draws.indices());
            let (mine, theirs) = (read.law().atoms().unwrap(), law.atoms().unwrap());
            assert!(mine.iter().zip(&theirs).all(|(a, b)| *a == 0.0 || (a - b).abs() < 1e-12 * b.abs()));
            assert!(Singletons::from_bytes(&sent[1..], law.gamma(), length, 501).is_err());
        }
    }

    #[test]
    fn what_nobody_has_sent_is_refused() {
        assert!(Singletons::from_bytes(&[0b01_00], &[1.0], 2, 2).is_err(), "both signs");
        assert!(Singletons::from_bytes(&[0b110], &[1.0], 3, 1).is_err(), "no such entry");
        assert!(Singletons::from_bytes(&[0b1000], &[1.0], 3, 1).is_err(), "bits at the end");
        for norm in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(Singletons::from_bytes(&[0], &[norm], 3, 1).is_err());
        }
    }
}
