//! Which bets are made, fixed before the first step.

use crate::error::Result;
use crate::memory::{try_copy, try_extend, try_push, try_zeros};

use super::frame::{Frame, WHAT};

/// Shifts of the mean at the root mean square of z, in deviations of the noise.
const SHIFTS: [f64; 4] = [0.15, 0.5, 1.5, 5.0];

/// Which systems the bets hold for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Null {
    /// One of the region, the same in each block.
    Constant,
    /// Of the region in each step; it may move in it at will. The sum of the penalties of all steps takes the place of the
    /// smaller penalty of a block.
    Moving,
}

/// What a bet is on: the row of a watched direction, or the gain of a column, along a column of z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bet {
    /// The entry (row, column) of Theta.
    Entry(usize, usize),
    /// A constant that is added to this row.
    Load(usize),
    /// The gain of this column.
    Gain(usize),
}

/// Bets `l (g' z)` with `g' z` an entry of z or 1, in both directions; struct of arrays.
#[derive(Debug, Clone)]
pub struct Bank {
    /// What each bet is on.
    pub bets: Vec<Bet>,
    /// The directions of e (any, n), of length 1.
    pub directions: Vec<f64>,
    /// `|B' l|` of each direction and part (any, parts).
    pub spreads: Vec<f64>,
    /// The direction of each bet.
    pub direction: Vec<usize>,
    /// The entry of z of each bet; the number of entries for 1.
    pub column: Vec<usize>,
    /// Its amplitude at a shift of 1.
    pub unit: Vec<f64>,
    /// Its shift where the gain rises by all of itself, or the load by a deviation.
    pub whole: Vec<f64>,
    /// Amplitudes in units of `unit`.
    pub shifts: Vec<f64>,
    /// How many of them are also made over blocks: the first ones.
    pub small: usize,
    /// Steps of short blocks, and short blocks in a long one.
    pub blocks: (usize, usize),
}

impl Bank {
    /// All entries, the gain of each of the columns `gains`, and loads of each row where no column is 1.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn new(frame: &Frame, gains: &[usize], intercept: bool) -> Result<Self> {
        let (n, d) = (frame.n(), frame.width());
        let mut bank = Self {
            bets: Vec::new(),
            directions: Vec::new(),
            spreads: Vec::new(),
            direction: Vec::new(),
            column: Vec::new(),
            unit: Vec::new(),
            whole: Vec::new(),
            shifts: try_copy(WHAT, &SHIFTS)?,
            small: 2,
            blocks: (8, 8),
        };
        for i in 0..n {
            // Sbar^-1 e_i: in the units of e the column i of L^-1
            let mut l = try_zeros(WHAT, n)?;
            l.iter_mut().enumerate().for_each(|(k, to)| *to = frame.back[k * n + i]);
            let at = bank.along(frame, &l)?;
            for j in 0..d {
                let load = intercept && j + 1 == d;
                bank.bet(if load { Bet::Load(i) } else { Bet::Entry(i, j) }, (at, j), frame.sizes[j], 1.0)?;
            }
            if !intercept {
                bank.bet(Bet::Load(i), (at, d), 1.0, 1.0)?;
            }
        }
        for j in gains {
            let mut l = try_zeros(WHAT, n)?;
            for (i, to) in l.iter_mut().enumerate() {
                *to = (0..=i).map(|k| frame.back[i * n + k] * frame.centre[k * d + j]).sum();
            }
            let size = l.iter().map(|v| v * v).sum::<f64>().sqrt();
            if size > 0.0 {
                let at = bank.along(frame, &l)?;
                bank.bet(Bet::Gain(*j), (at, *j), frame.sizes[*j], size)?;
            }
        }
        Ok(bank)
    }

    /// A new direction, brought to length 1.
    fn along(&mut self, frame: &Frame, l: &[f64]) -> Result<usize> {
        let size = l.iter().map(|v| v * v).sum::<f64>().sqrt();
        let (at, before) = (self.directions.len() / frame.n(), self.directions.len());
        try_extend(WHAT, &mut self.directions, l.iter().map(|v| v / size))?;
        let mut spreads = try_zeros(WHAT, frame.count())?;
        frame.spreads(&self.directions[before..], &mut spreads);
        try_extend(WHAT, &mut self.spreads, spreads)?;
        Ok(at)
    }

    fn bet(&mut self, of: Bet, (direction, column): (usize, usize), size: f64, whole: f64) -> Result<()> {
        try_push(WHAT, &mut self.bets, of)?;
        try_push(WHAT, &mut self.direction, direction)?;
        try_push(WHAT, &mut self.column, column)?;
        try_push(WHAT, &mut self.whole, whole)?;
        try_push(WHAT, &mut self.unit, 1.0 / size)
    }

    /// The steps of a long block.
    #[must_use]
    pub fn long(&self) -> usize {
        self.blocks.0 * self.blocks.1
    }
}
