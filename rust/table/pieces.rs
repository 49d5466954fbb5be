//! Runs of a log as pairs of rows that are one step apart, the gaps inside them, and the rows that each has lost.

use crate::error::{Error, Result, sized};
use crate::memory::{try_collect, try_extend, try_push, try_room};

const WHAT: &str = "the pieces of a log";
/// Steps of a gap, so that no sum of them overflows.
const LONGEST: usize = if usize::BITS > 40 { (1_u64 << 40) as usize } else { usize::MAX >> 8 };

/// Runs and their pieces.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Pieces {
    lengths: Vec<usize>,
    gaps: Vec<[usize; 2]>,
    lost: Vec<usize>,
}

impl Pieces {
    /// Runs of so many pairs; gaps `[t, s]`, where s steps between the pairs t - 1 and t of one run have no pair; and
    /// how many rows of each run are lost.
    ///
    /// # Errors
    /// [`Error::Value`] for a run without a pair, a gap that is not inside a run or not behind the one before it, and
    /// for `lost` of another number of runs; [`Error::Memory`].
    pub fn new(lengths: Vec<usize>, gaps: Vec<[usize; 2]>, lost: Vec<usize>) -> Result<Self> {
        if lost.len() != lengths.len() {
            let found = format!("{} numbers for {} runs", lost.len(), lengths.len());
            return Err(Error::Value { name: "lost", expected: "a number for each run", found });
        }
        let all = lengths.iter().try_fold(0_usize, |all, &length| all.checked_add(length).filter(|_| length > 0));
        if all.is_none() {
            let found = format!("{} numbers", lengths.len());
            return Err(Error::Value { name: "lengths", expected: "numbers of at least 1 with a sum", found });
        }
        let (mut runs, mut end, mut before) = (lengths.iter(), 0, 0);
        for &[at, steps] in &gaps {
            while end < at {
                let Some(length) = runs.next() else { break };
                end += length;
            }
            if at <= before || at >= end || !(1..=LONGEST).contains(&steps) {
                let expected = "rows (pair behind it, steps) inside runs, in order";
                return Err(Error::Value { name: "gaps", expected, found: format!("({at}, {steps})") });
            }
            before = at;
        }
        Ok(Self { lengths, gaps, lost })
    }

    /// Runs of one set behind those of another.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn joined<'a>(parts: impl IntoIterator<Item = &'a Self>) -> Result<Self> {
        let (mut made, mut before) = (Self::default(), 0);
        for part in parts {
            try_extend(WHAT, &mut made.gaps, part.gaps.iter().map(|[at, steps]| [before + at, *steps]))?;
            try_extend(WHAT, &mut made.lengths, part.lengths.iter().copied())?;
            try_extend(WHAT, &mut made.lost, part.lost.iter().copied())?;
            before += part.size();
        }
        Ok(made)
    }

    /// The number of pairs of each run.
    pub fn lengths(&self) -> &[usize] {
        &self.lengths
    }

    /// The gaps `[t, s]`.
    pub fn gaps(&self) -> &[[usize; 2]] {
        &self.gaps
    }

    /// The number of rows that each run has lost.
    pub fn lost(&self) -> &[usize] {
        &self.lost
    }

    /// The number of pairs.
    pub fn size(&self) -> usize {
        self.lengths.iter().sum()
    }

    /// The first pair of each run.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn starts(&self) -> Result<Vec<usize>> {
        let mut end = 0;
        try_collect(
            WHAT,
            self.lengths.iter().map(|length| {
                end += length;
                end - length
            }),
        )
    }

    /// The run of each pair.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn runs(&self) -> Result<Vec<usize>> {
        let mut made = try_room(WHAT, self.size())?;
        for (run, &length) in self.lengths.iter().enumerate() {
            try_extend(WHAT, &mut made, std::iter::repeat_n(run, length))?;
        }
        Ok(made)
    }

    /// The place of each pair in its piece: 0 if it does not follow on the one before.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn places(&self) -> Result<Vec<usize>> {
        let mut made = try_room(WHAT, self.size())?;
        let mut gaps = self.gaps.iter().peekable();
        for &length in &self.lengths {
            let mut place = 0;
            for _ in 0..length {
                if gaps.next_if(|[at, _]| *at == made.len()).is_some() {
                    place = 0;
                }
                try_push(WHAT, &mut made, place)?;
                place += 1;
            }
        }
        Ok(made)
    }

    /// The number of steps without a pair before each pair.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn skipped(&self) -> Result<Vec<usize>> {
        let mut gaps = self.gaps.iter().peekable();
        try_collect(WHAT, (0..self.size()).map(|pair| gaps.next_if(|[at, _]| *at == pair).map_or(0, |gap| gap[1])))
    }

    /// What is left with some of the pairs, and of the runs that have one.
    ///
    /// # Errors
    /// [`Error::Shape`] if `kept` is not of the number of pairs; [`Error::Memory`].
    pub fn chosen(&self, kept: &[bool]) -> Result<Self> {
        sized("kept", kept.len(), self.size())?;
        let (mut made, mut pair, mut total) = (Self::default(), 0, 0);
        let mut gaps = self.gaps.iter().peekable();
        for (&length, &lost) in self.lengths.iter().zip(&self.lost) {
            let (mut own, mut steps) = (0, 0);
            for &keep in &kept[pair..pair + length] {
                steps += gaps.next_if(|[at, _]| *at == pair).map_or(0, |gap| gap[1]);
                pair += 1;
                if !keep {
                    steps += 1;
                    continue;
                }
                if own > 0 && steps > 0 {
                    try_push(WHAT, &mut made.gaps, [total, steps])?;
                }
                (own, total, steps) = (own + 1, total + 1, 0);
            }
            if own > 0 {
                try_push(WHAT, &mut made.lengths, own)?;
                try_push(WHAT, &mut made.lost, lost)?;
            }
        }
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_that_are_left_out_become_gaps() {
        let log = Pieces::new(Vec::from([4, 1, 3]), Vec::from([[2, 5], [6, 1]]), Vec::from([5, 0, 2])).unwrap();
        assert_eq!(log.places().unwrap(), [0, 1, 0, 1, 0, 0, 0, 1]);
        assert_eq!(log.runs().unwrap(), [0, 0, 0, 0, 1, 2, 2, 2]);
        assert_eq!(log.starts().unwrap(), [0, 4, 5]);
        assert_eq!(log.skipped().unwrap(), [0, 0, 5, 0, 0, 0, 1, 0]);
        // pair 1 and the gap behind it are one gap, run 1 is gone, and what was before the first pair of a run
        let left = log.chosen(&[true, false, true, true, false, false, true, true]).unwrap();
        assert_eq!(left, Pieces::new(Vec::from([3, 2]), Vec::from([[1, 6]]), Vec::from([5, 2])).unwrap());
        let both = Pieces::joined([&left, &log]).unwrap();
        assert_eq!(both.gaps(), [[1, 6], [7, 5], [11, 1]]);
        assert_eq!(both.chosen(&[[false; 5].as_slice(), &[true; 8]].concat()).unwrap(), log);
        assert!(log.chosen(&[true]).is_err());
    }

    #[test]
    fn gaps_are_inside_runs_and_in_order() {
        let made = |gaps: &[[usize; 2]]| Pieces::new(Vec::from([2, 2]), gaps.to_vec(), Vec::from([0, 0]));
        assert!(made(&[[1, 1], [3, LONGEST]]).is_ok());
        for wrong in [[0, 1], [2, 1], [4, 1], [9, 1], [1, 0], [1, LONGEST + 1]] {
            assert!(made(&[wrong]).is_err(), "{wrong:?}");
        }
        assert!(made(&[[3, 1], [1, 1]]).is_err());
        assert!(made(&[[1, 1], [1, 1]]).is_err());
        assert!(Pieces::new(Vec::from([2]), Vec::new(), Vec::new()).is_err());
        for wrong in [[0, 2], [usize::MAX, 2]] {
            assert!(Pieces::new(Vec::from(wrong), Vec::new(), Vec::from([0, 0])).is_err());
        }
    }
}
