//! What the mean of the squared misses takes: its moments, and its gradient from the residuals.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::units::{Room, Units, WHAT};
use crate::error::{Error, Result};
use crate::identify::update;
use crate::memory::{checked_len, room_for_products, try_room, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::simd::LANES;
use crate::simd::dispatch::{Work, widest};
use crate::vector::{axpy, dot};

/// Rows of `G_s` that are multiplied at a time.
const ROWS: usize = 256;

/// `mean_s ||G_s u - b_s||_Q^2 = u'Hu - 2 f'u + constant`.
#[derive(Debug)]
pub struct Moments {
    /// `H = mean_s G_s'Q G_s`, `(d, d)`.
    pub h: Vec<f64>,
    /// `f = mean_s G_s'Q b_s`
    pub f: Vec<f64>,
    /// `mean_s b_s'Q b_s`
    pub constant: f64,
}

/// `Q^1/2 [G_s b_s]` of units one below the other.
struct Filler {
    room: Room,
    map: Vec<f64>,
    target: Vec<f64>,
}

impl Filler {
    fn new(units: &Units<'_>) -> Result<Self> {
        let (d, q) = (units.inputs(), units.rows());
        let map = try_zeros(WHAT, checked_len(WHAT, q, d)?)?;
        Ok(Self { room: Room::new(units)?, map, target: try_zeros(WHAT, q)? })
    }

    /// Units from `first` on, as many as `rows` has room for; what is behind the target stays.
    fn fill(&mut self, units: &Units<'_>, first: usize, stride: usize, rows: &mut [f64]) {
        widest(Fill { filler: self, units, first, stride, rows });
    }
}

struct Fill<'a> {
    filler: &'a mut Filler,
    units: &'a Units<'a>,
    first: usize,
    stride: usize,
    rows: &'a mut [f64],
}

impl Work for Fill<'_> {
    type Out = ();

    #[inline(always)]
    fn run(self) {
        let Filler { room, map, target } = self.filler;
        let (d, q) = (self.units.inputs(), self.units.rows());
        for (i, rows) in self.rows.chunks_exact_mut(q * self.stride).enumerate() {
            self.units.map(self.first + i, room, map, target);
            let parts = map.chunks_exact(d).zip(target.iter());
            for (row, (map, target)) in rows.chunks_exact_mut(self.stride).zip(parts) {
                row[..d].copy_from_slice(map);
                row[d] = *target;
            }
        }
    }
}

/// The moments: chunks of units in their order, so the same bits for any number of threads.
///
/// # Errors
/// [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
pub fn moments(units: &Units<'_>, threads: usize, stop: &Stop) -> Result<Moments> {
    let (d, q, chunk) = (units.inputs(), units.rows(), units.chunk());
    // the target is column d; whole groups, with zeros behind it, make the product faster
    let side = (d + 1).next_multiple_of(LANES);
    let len = checked_len(WHAT, side, side)?;
    let mut parts = try_room(WHAT, units.size.div_ceil(chunk))?;
    for _ in 0..units.size.div_ceil(chunk) {
        parts.push(try_zeros::<f64>(WHAT, len)?);
    }
    let at_once = (ROWS / q.max(1)).max(1);
    let threads = units.threads(threads, units.work() + (units.size * q) as f64 * len as f64);
    for_each_chunk(parts.iter_mut().enumerate(), threads, stop, |(block, sums)| {
        room_for_products()?;
        let mut filler = Filler::new(units)?;
        let mut rows = try_zeros(WHAT, checked_len(WHAT, at_once * q, side)?)?;
        let last = units.size.min((block + 1) * chunk);
        let mut s = block * chunk;
        while s < last {
            stop.check()?;
            let count = at_once.min(last - s);
            filler.fill(units, s, side, &mut rows[..count * q * side]);
            s += count;
            let rows = MatRef::from_row_major_slice(&rows[..count * q * side], count * q, side);
            let sums = MatMut::from_row_major_slice_mut(sums, side, side);
            matmul(sums, Accum::Add, rows.transpose(), rows, 1.0, Par::Seq);
        }
        Ok(())
    })?;
    let (first, others) = parts.split_at_mut(1);
    let sums = &mut first[0];
    others.iter().for_each(|part| axpy(1.0, part, sums));
    let share = 1.0 / units.size as f64;
    sums.iter_mut().for_each(|v| *v *= share);
    let mut h = try_zeros(WHAT, d * d)?;
    for i in 0..d {
        for j in 0..=i {
            h[i * d + j] = sums[i * side + j];
            h[j * d + i] = h[i * d + j];
        }
    }
    let mut f = try_zeros(WHAT, d)?;
    f.copy_from_slice(&sums[d * side..][..d]);
    let constant = sums[d * side + d];
    match h.iter().chain(&f).all(|v| v.is_finite()) && constant.is_finite() {
        true => Ok(Moments { h, f, constant }),
        false => Err(Error::Overflow { what: "the mean of the squared misses" }),
    }
}

/// `R` (d + 1, d + 1) with `R'R = sum_s [Q^1/2 (G_s b_s)]'[...]`: the moments without squares, for an ill-conditioned
/// `H`.
///
/// # Errors
/// [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
pub fn moments_root(units: &Units<'_>, stop: &Stop) -> Result<Vec<f64>> {
    let (q, side) = (units.rows(), units.inputs() + 1);
    let mut r = try_zeros(WHAT, checked_len(WHAT, side, side)?)?;
    let at_once = (4 * ROWS).max(side).div_ceil(q);
    let mut rows = try_zeros(WHAT, checked_len(WHAT, at_once * q, side)?)?;
    let mut filler = Filler::new(units)?;
    for first in (0..units.size).step_by(at_once) {
        let count = at_once.min(units.size - first);
        let some = &mut rows[..count * q * side];
        filler.fill(units, first, side, some);
        update(&mut r, some, side, stop)?;
    }
    Ok(r)
}

/// `||Q^1/2 G_s||_F^2` of every unit.
///
/// # Errors
/// [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
pub fn gains(units: &Units<'_>, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
    let (q, side, chunk) = (units.rows(), units.inputs() + 1, units.chunk());
    let mut found = try_zeros(WHAT, units.size)?;
    let threads = units.threads(threads, units.work() * q as f64 / units.n as f64);
    for_each_chunk(found.chunks_mut(chunk).enumerate(), threads, stop, |(block, out)| {
        let mut filler = Filler::new(units)?;
        let mut rows = try_zeros(WHAT, checked_len(WHAT, q, side)?)?;
        for (i, gain) in out.iter_mut().enumerate() {
            filler.fill(units, block * chunk + i, side, &mut rows);
            *gain = dot(&filler.map, &filler.map);
        }
        Ok(())
    })?;
    match found.iter().all(|gain| gain.is_finite()) {
        true => Ok(found),
        false => Err(Error::Overflow { what: "the map of a unit" }),
    }
}

/// `mean_s ||G_s u - b_s||_Q^2` and `mean_s G_s'Q (G_s u - b_s)`, from the residuals of all units.
///
/// # Errors
/// [`Error::Overflow`], [`Error::Memory`], [`Error::Interrupted`].
pub fn slope(units: &Units<'_>, u: &[f64], threads: usize, stop: &Stop) -> Result<(f64, Vec<f64>)> {
    let (d, chunk) = (units.inputs(), units.chunk());
    let count = units.size.div_ceil(chunk);
    let mut parts = try_zeros(WHAT, checked_len(WHAT, count, d + 1)?)?;
    let threads = units.threads(threads, 2.0 * units.work());
    for_each_chunk(parts.chunks_exact_mut(d + 1).enumerate(), threads, stop, |(block, sums)| {
        let mut room = Room::new(units)?;
        let mut residual = try_zeros(WHAT, units.rows())?;
        let (gradient, square) = sums.split_at_mut(d);
        for s in block * chunk..units.size.min((block + 1) * chunk) {
            units.residual(s, u, None, &mut room, &mut residual);
            square[0] += dot(&residual, &residual);
            units.pull(s, &residual, &mut room, gradient);
        }
        Ok(())
    })?;
    let mut sums = try_zeros(WHAT, d + 1)?;
    parts.chunks_exact(d + 1).for_each(|part| axpy(1.0, part, &mut sums));
    let share = 1.0 / units.size as f64;
    sums.iter_mut().for_each(|v| *v *= share);
    if !sums.iter().all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: "the mean of the squared misses" });
    }
    let square = sums[d];
    sums.truncate(d);
    Ok((square, sums))
}
