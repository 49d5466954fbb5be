//! The random words of one block of runs, taken in order.

use crate::stream::{CHUNK, Key, Lanes, Purpose};

/// Words made at a time: a multiple of the lanes that divides a chunk.
const REFILL: usize = 256;

/// Most words of one call.
pub(super) const MOST: usize = 32;

/// The words `0, 1, 2, ...` of the line `block`, each given once.
pub(super) struct Words<'a> {
    key: &'a Key,
    block: usize,
    /// words made so far
    made: usize,
    lanes: Option<Lanes>,
    buffer: [u64; MOST + REFILL],
    /// what is left of the buffer
    left: std::ops::Range<usize>,
}

impl<'a> Words<'a> {
    pub(super) fn new(key: &'a Key, block: usize) -> Self {
        Self { key, block, made: 0, lanes: None, buffer: [0; MOST + REFILL], left: 0..0 }
    }

    /// The next `count <= MOST` words.
    #[inline]
    pub(super) fn take(&mut self, count: usize) -> &[u64] {
        if self.left.len() < count {
            self.refill();
        }
        let from = self.left.start;
        self.left.start += count;
        &self.buffer[from..from + count]
    }

    /// Appends [`REFILL`] words to the rest, which is shorter than [`MOST`].
    fn refill(&mut self) {
        if self.made.is_multiple_of(CHUNK) {
            self.lanes = Some(self.key.lanes_for(Purpose::Runs, self.block, self.made / CHUNK));
        }
        let rest = self.left.len();
        self.buffer.copy_within(self.left.clone(), 0);
        if let Some(lanes) = &mut self.lanes {
            lanes.fill(&mut self.buffer[rest..rest + REFILL]);
        }
        self.made += REFILL;
        self.left = 0..rest + REFILL;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_come_in_order_whatever_is_taken_at_a_time() {
        let key = Key([5; 32]);
        let expected: Vec<u64> = (0..3)
            .flat_map(|chunk| {
                let mut words = vec![0; CHUNK];
                key.lanes_for(Purpose::Runs, 9, chunk).fill(&mut words);
                words
            })
            .collect();
        let mut words = Words::new(&key, 9);
        let mut at = 0;
        for count in (0..=MOST).cycle().take(2200) {
            assert_eq!(words.take(count), &expected[at..at + count]);
            at += count;
        }
        assert!(at > 2 * CHUNK);
    }
}
