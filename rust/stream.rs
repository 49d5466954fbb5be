//! Random streams, version 1: the only place where generators are created.
//!
//! A 256-bit [`Key`] and a `(purpose, line)` pair name a ChaCha8 stream. Index draws come from chunks of [`CHUNK`]
//! words; a chunk is produced by eight interleaved xoshiro256++ lanes whose states are read from that ChaCha8 stream at
//! `chunk * 256` bytes. Draw `i` of a line is therefore a pure function of `(key, line, i)`: the same for any number of
//! threads, any order of the chunks and any total size.

use rand::rngs::ChaCha8Rng;
use rand::{Rng, SeedableRng};
use sha2::{Digest, Sha256};

use crate::simd::LANES;

/// Words (= draws) in a chunk of one line. Part of the stream's definition.
pub const CHUNK: usize = 16_384;

/// Use of a stream; part of its identity, so that no two uses share words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Independent index draws.
    Draws = 0,
    /// The single offset of a systematic sample.
    Offset = 1,
    /// The order in which a systematic sample's indices are dealt out.
    Permutation = 2,
    /// Multinomial counts without realizations.
    Counts = 3,
    /// The words of a block of simulated runs; the line is the block.
    Runs = 4,
    /// The counts of a mean-field trajectory; the line is the replicate.
    MeanField = 5,
    /// The averages of a simulated plan; the line is the run.
    Plans = 6,
    /// The draws behind a simulated quantile; the line is the law and the chunk of draws.
    Roots = 7,
    /// Replicates of measured data; the line is the block of replicates.
    Replicates = 8,
}

/// 256 bits from which every stream of a call is derived.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Key(pub [u8; 32]);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Key(")?;
        self.0.iter().take(8).try_for_each(|byte| write!(f, "{byte:02x}"))?;
        write!(f, "..)")
    }
}

impl Key {
    /// The key of the independent stream called `name`: `sha256("stochens child v1\0" + key + utf8(name))`.
    #[must_use]
    pub fn child(&self, name: &str) -> Self {
        Self(
            Sha256::new()
                .chain_update(b"stochens child v1\0")
                .chain_update(self.0)
                .chain_update(name)
                .finalize()
                .into(),
        )
    }

    /// The ChaCha8 stream of `line` for `purpose`, at position 0.
    #[must_use]
    pub fn stream(&self, purpose: Purpose, line: usize) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::from_seed(self.0);
        rng.set_stream((purpose as u64) << 56 | line as u64);
        rng
    }

    /// Fills `out` with the first words of index draws of `line`, one per draw; for measuring the least cost of a draw.
    pub fn words(&self, line: usize, out: &mut [u64]) {
        for (chunk, out) in out.chunks_mut(CHUNK).enumerate() {
            self.lanes(line, chunk).fill(out);
        }
    }

    /// The word generator of one chunk of index draws of `line`.
    pub(crate) fn lanes(&self, line: usize, chunk: usize) -> Lanes {
        self.lanes_for(Purpose::Draws, line, chunk)
    }

    /// The word generator of one chunk of `line` for any purpose.
    pub(crate) fn lanes_for(&self, purpose: Purpose, line: usize, chunk: usize) -> Lanes {
        let mut rng = self.stream(purpose, line);
        rng.set_word_pos(chunk as u128 * (LANES * 8) as u128); // a ChaCha word has 4 bytes, a lane's state 32
        let mut bytes = [0u8; LANES * 32];
        rng.fill_bytes(&mut bytes);
        let mut state = [[0u64; LANES]; 4];
        for (at, eight) in bytes.chunks_exact(8).enumerate() {
            let mut word = [0u8; 8];
            word.copy_from_slice(eight);
            state[at % 4][at / 4] = u64::from_le_bytes(word);
        }
        Lanes { state }
    }
}

/// Eight xoshiro256++ generators that step together; word `i` comes from lane `i % 8`.
#[derive(Clone)]
pub(crate) struct Lanes {
    state: [[u64; LANES]; 4],
}

impl Lanes {
    /// The next eight words, one from each lane.
    #[inline(always)]
    pub(crate) fn step(&mut self) -> [u64; LANES] {
        let [s0, s1, s2, s3] = &mut self.state;
        let mut out = [0u64; LANES];
        for l in 0..LANES {
            // xoshiro256++ (Blackman and Vigna, 2019)
            out[l] = s0[l].wrapping_add(s3[l]).rotate_left(23).wrapping_add(s0[l]);
            let t = s1[l] << 17;
            s2[l] ^= s0[l];
            s3[l] ^= s1[l];
            s1[l] ^= s2[l];
            s0[l] ^= s3[l];
            s2[l] ^= t;
            s3[l] = s3[l].rotate_left(45);
        }
        out
    }

    /// Fills a block; its length is rounded up to whole steps, so blocks but the last must be multiples of eight.
    pub(crate) fn fill(&mut self, words: &mut [u64]) {
        let (steps, rest) = words.as_chunks_mut::<LANES>();
        #[cfg(target_arch = "x86_64")]
        let done = crate::simd::fill(&mut self.state, steps);
        #[cfg(not(target_arch = "x86_64"))]
        let done = false;
        if !done {
            steps.iter_mut().for_each(|step| *step = self.step());
        }
        if !rest.is_empty() {
            rest.copy_from_slice(&self.step()[..rest.len()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::Xoshiro256PlusPlus;

    #[test]
    fn lanes_are_xoshiro256plusplus_on_chacha8_bytes() {
        let key = Key(std::array::from_fn(|i| i as u8));
        let mut lanes = key.lanes(3, 2);
        let mut bytes = vec![0u8; 3 * 256];
        key.stream(Purpose::Draws, 3).fill_bytes(&mut bytes);
        let mut singles: Vec<_> =
            bytes[512..].chunks_exact(32).map(|seed| Xoshiro256PlusPlus::from_seed(seed.try_into().unwrap())).collect();
        for _ in 0..5 {
            let expected: Vec<u64> = singles.iter_mut().map(|rng| rng.next_u64()).collect();
            assert_eq!(lanes.step().to_vec(), expected);
        }
    }

    #[test]
    fn wide_registers_give_the_same_words() {
        let key = Key([9; 32]);
        let (mut any, mut portable) = (key.lanes(0, 0), key.lanes(0, 0));
        for len in [8, 1024, 16, 5] {
            let mut words = vec![0; len];
            any.fill(&mut words);
            for eight in words.chunks(LANES) {
                assert_eq!(*eight, portable.step()[..eight.len()]);
            }
        }
    }

    #[test]
    fn purposes_lines_and_keys_have_different_streams() {
        let first = |key: Key, purpose, line| key.stream(purpose, line).next_u64();
        let (a, b) = (Key([0; 32]), Key([1; 32]));
        let mut words = Vec::new();
        for key in [a, b] {
            for purpose in [
                Purpose::Draws,
                Purpose::Offset,
                Purpose::Permutation,
                Purpose::Counts,
                Purpose::Runs,
                Purpose::MeanField,
                Purpose::Plans,
            ] {
                words.extend((0..100).map(|line| first(key, purpose, line)));
            }
        }
        let total = words.len();
        words.sort_unstable();
        words.dedup();
        assert_eq!(words.len(), total);
    }

    /// What `Key.child` of the Python package gives.
    #[test]
    fn children_are_those_of_the_package() {
        let first = |key: Key, name| key.child(name).0[..8].to_vec();
        assert_eq!(
            first(Key(std::array::from_fn(|i| i as u8)), "step-12"),
            [0xc3, 0x93, 0x14, 0x57, 0x5d, 0xa4, 0x10, 0x83]
        );
        assert_eq!(first(Key([0; 32]), ""), [0xca, 0x9e, 0xd4, 0xfa, 0xff, 0x3d, 0xa6, 0x48]);
    }

    /// The first words of the stream of the zero key: a change here changes all results for given keys.
    #[test]
    fn value_stability() {
        let mut rng = Key([0; 32]).stream(Purpose::Draws, 0);
        // ChaCha8 with a zero key and nonce starts 3e00ef2f 895f40d6 (published test vector, bytes in order).
        let mut bytes = [0u8; 8];
        rng.fill_bytes(&mut bytes);
        assert_eq!(bytes, [0x3e, 0x00, 0xef, 0x2f, 0x89, 0x5f, 0x40, 0xd6]);
    }
}
