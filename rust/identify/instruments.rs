//! Data with instruments, for states measured with error: what lies in their span, and what does not.

use crate::control::singular;
use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_copy, try_zeros};
use crate::parallel::Stop;

use super::least_squares::{WHAT, add, fit, lengths};

/// `inside' inside = [Z Y]' P [Z Y]`, P the projector on the instruments; `outside`: I - P.
#[derive(Debug, Clone)]
pub(crate) struct Projected {
    pub inside: Vec<f64>,
    pub outside: Vec<f64>,
    pub rank: usize,
    pub size: usize,
    pub width: usize,
}

impl Projected {
    /// From the triangle (side, side) of `[zeta Z Y]` with `count` columns of zeta, of any rank.
    pub fn new(triangle: &[f64], side: usize, count: usize, size: usize) -> Result<Self> {
        let width = side - count;
        let top = || triangle.chunks_exact(side).take(count);
        let square = try_collect(WHAT, top().flat_map(|row| &row[..count]).copied())?;
        let lengths = lengths(&square, count, count)?;
        let scaled = try_collect(WHAT, square.iter().enumerate().map(|(at, v)| v / lengths[at % count]))?;
        let found = singular(&scaled, count, count)?;
        let least = size.max(count) as f64 * f64::EPSILON * found.s[0];
        let rank = found.s.iter().filter(|s| **s > least).count();
        let mut inside = try_zeros(WHAT, checked_len(WHAT, rank, width)?)?;
        for (to, u) in inside.chunks_exact_mut(width).zip(found.u.chunks_exact(count)) {
            top().zip(u).for_each(|(row, u)| add(to, *u, &row[count..]));
        }
        let mut outside = try_collect(WHAT, triangle.chunks_exact(side).flat_map(|row| &row[count..]).copied())?;
        for (t, left) in outside.chunks_exact_mut(width).take(count).enumerate() {
            inside.chunks_exact(width).enumerate().for_each(|(k, row)| add(left, -found.u[k * count + t], row));
        }
        Ok(Self { inside, outside, rank, size, width })
    }

    /// Two-stage least squares: `Y P Z' (Z P Z')^+`.
    pub fn two_stages(&self, d: usize, stop: &Stop) -> Result<Vec<f64>> {
        if self.rank == 0 {
            return try_zeros(WHAT, (self.width - d) * d);
        }
        let rows = try_copy(WHAT, &self.inside)?;
        Ok(fit(&rows, self.width, d, self.rank, 1, stop)?.model)
    }
}
