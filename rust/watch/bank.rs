//! Which bets are made, fixed before the first step.

use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_extend, try_push};
use crate::vector::norm as size;

use super::frame::{Frame, WHAT};

/// Shifts of the mean at the root mean square of z, in deviations of the noise.
const SHIFTS: [f64; 4] = [0.15, 0.5, 1.5, 5.0];

/// Which systems the bets hold for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Null {
    /// One of the region, the same in each block.
    Constant,
    /// Of the region in each step; it may move in it at will. The sum of the penalties of all steps takes the place of
    /// the smaller penalty of a block.
    Moving,
}

/// Bets `l (g' z)` with `g' z` an entry of z or 1, in both directions; plain arrays.
#[derive(Debug, Clone)]
pub struct Bank {
    /// The directions l of e (any, n), of length 1: of each row, and behind them of the gains.
    pub directions: Vec<f64>,
    /// `|B' l|` of each direction and part (any, parts).
    pub spreads: Vec<f64>,
    /// The direction of each bet.
    pub direction: Vec<usize>,
    /// The entry of z of each bet; the number of entries for 1.
    pub column: Vec<usize>,
    /// Its amplitude at a shift of 1.
    pub unit: Vec<f64>,
    /// The shift of a gain that is twice as large; 1 for loads, and 0 for others: no one asks for them.
    pub whole: Vec<f64>,
    /// Amplitudes in units of `unit`, of which the first `small` are also made over blocks.
    pub shifts: Vec<f64>,
    /// See `shifts`.
    pub small: usize,
    /// Steps of short and long blocks, the second a multiple of the first.
    pub blocks: [usize; 2],
}

impl Bank {
    /// All entries, the gain of each of the columns `gains`, and loads of each row, which are the last column with an
    /// `intercept`.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn new(frame: &Frame, gains: std::ops::Range<usize>, intercept: bool) -> Result<Self> {
        let ((n, d), shifts) = (frame.sizes, try_copy(WHAT, &SHIFTS)?);
        let [directions, spreads, unit, whole] = [const { Vec::new() }; 4];
        let (direction, column) = (Vec::new(), Vec::new());
        let mut bank = Self { directions, spreads, direction, column, unit, whole, shifts, small: 2, blocks: [8, 64] };
        let load = d - usize::from(intercept);
        for i in 0..n {
            // Sbar^-1 e_i is L^-1 e_i in the units of e
            let l = frame.whitened(|k| f64::from(u8::from(k == i)))?;
            for j in 0..=load {
                bank.bet(frame, &l, (i, j), f64::from(u8::from(j == load)))?;
            }
        }
        for j in gains {
            let l = frame.whitened(|k| frame.centre[k * d + j])?;
            let at = bank.directions.len() / n;
            if size(&l) > 0.0 {
                bank.bet(frame, &l, (at, j), size(&l))?;
            }
        }
        Ok(bank)
    }

    fn bet(&mut self, frame: &Frame, l: &[f64], (at, column): (usize, usize), whole: f64) -> Result<()> {
        if self.directions.len() == at * l.len() {
            let l = try_collect(WHAT, l.iter().map(|v| v / size(l)))?;
            try_extend(WHAT, &mut self.spreads, (0..frame.norms.len()).map(|p| frame.spread(p, &l)))?;
            try_extend(WHAT, &mut self.directions, l)?;
        }
        try_push(WHAT, &mut self.direction, at)?;
        try_push(WHAT, &mut self.column, column)?;
        try_push(WHAT, &mut self.whole, whole)?;
        try_push(WHAT, &mut self.unit, 1.0 / frame.scale.get(column).unwrap_or(&1.0))
    }
}
