//! A problem given by its matrix.

mod faces;

use std::cell::Cell;

use crate::error::{Error, Result, require_finite};
use crate::limits::factor::{Factor, squared};
use crate::limits::kernel::{add_transposed, padded};
use crate::limits::quadratic::{Quadratic, Until};
use crate::memory::{checked_len, try_copy, try_room, try_zeros};
use crate::vector;

const WHAT: &str = "a control within limits";

/// Condition of a face above which its solution is corrected by its residual at once.
const ILL: f64 = 1e8;

/// `M` (rows, d) and the diagonal of `R`, with `H` and memory for its faces; lines are padded.
#[derive(Debug, Default)]
pub(super) struct Dense {
    pub(super) d: usize,
    pub(super) ld: usize,
    pub(super) m: Vec<f64>,
    /// `m` has zeros below its diagonal.
    pub(super) triangular: bool,
    pub(super) r: Vec<f64>,
    /// No eigenvalue of `H` is smaller: the least entry of `R`.
    pub(super) least: f64,
    /// `M'M + R`, from [`Quadratic::prepare`] on.
    pub(super) h: Vec<f64>,
    prepared: bool,
    curvature: Vec<f64>,
    pub(super) y: Vec<f64>,
    /// A part of `J` that no input changes.
    pub(super) rest: f64,
    /// `M'y`
    f: Vec<f64>,
    residual: Vec<f64>,
    free: Vec<usize>,
    /// `J(0)`
    zero: f64,
    work: Vec<f64>,
    second: Vec<f64>,
    third: Vec<f64>,
    pub(super) factor: Factor,
    /// For the interior point and the certificate, with the inputs it belongs to; from the first use on.
    other: Factor,
    others: Vec<usize>,
    /// `other` is of `H` itself.
    pub(super) whole: bool,
    /// `H^{-1}`, in lines like `H`, its Frobenius norm; whether it serves for all faces, and whether that was tried.
    inverse: Vec<f64>,
    size: f64,
    inverted: bool,
    tried: bool,
    /// As large as `inverse`.
    spare: Vec<f64>,
    /// `H^{-1} M'y`, from the first face on that uses it.
    centre: Vec<f64>,
    /// Zeros.
    none: Vec<f64>,
    /// Faces since the last `M`, and whether `factor` is of `H` itself.
    faces: usize,
    unlimited: bool,
    /// The limits of the last face are few: `factor` is of the block of `H^{-1}` that belongs to them.
    by_inverse: bool,
    ill: bool,
}

/// Entries of `H` up to which a thread keeps the memory of its last problem: the system takes as long to provide fresh
/// pages as the solver needs to fill them.
const KEPT: usize = 1 << 19;

thread_local!(static LAST: Cell<Option<Dense>> = const { Cell::new(None) });

impl Dense {
    /// Memory that [`Self::keep`] has kept, or new; [`Self::set`] and [`Self::aim`] leave nothing of what it held.
    pub(super) fn again(rows: usize, d: usize) -> Result<Self> {
        match LAST.take() {
            Some(last) if (last.y.len(), last.d) == (rows, d) => Ok(last),
            _ => Self::new(rows, d),
        }
    }

    /// Keeps the memory for the next problem of this thread.
    pub(super) fn keep(self) {
        if self.h.len() <= KEPT && self.m.len() <= KEPT {
            LAST.set(Some(self));
        }
    }

    /// Memory for problems of `rows` and `d`.
    pub(super) fn new(rows: usize, d: usize) -> Result<Self> {
        let ld = padded(d);
        let zeros = |len| try_zeros(WHAT, len);
        Ok(Self {
            d,
            ld,
            m: zeros(checked_len(WHAT, rows, ld)?)?,
            r: zeros(ld)?,
            h: zeros(checked_len(WHAT, d, ld)?)?,
            curvature: zeros(d)?,
            y: zeros(rows)?,
            f: zeros(ld)?,
            residual: zeros(rows)?,
            free: try_room(WHAT, d)?,
            work: zeros(ld)?,
            second: zeros(ld)?,
            third: zeros(ld)?,
            factor: Factor::new(d)?,
            ..Self::default()
        })
    }

    /// A copy with memory of its own.
    pub(super) fn try_clone(&self) -> Result<Self> {
        let mut copy = Self::new(self.y.len(), self.d)?;
        copy.m.copy_from_slice(&self.m);
        copy.r.copy_from_slice(&self.r);
        copy.h.copy_from_slice(&self.h);
        copy.curvature.copy_from_slice(&self.curvature);
        (copy.inverse, copy.size) = (try_copy(WHAT, &self.inverse)?, self.size);
        (copy.prepared, copy.inverted, copy.tried) = (self.prepared, self.inverted, self.tried);
        (copy.triangular, copy.least) = (self.triangular, self.least);
        Ok(copy)
    }

    /// Takes the diagonal of `R`, and `M` as [`Self::set_above`].
    pub(super) fn set(&mut self, m: &[f64], r: &[f64]) -> Result<()> {
        require_finite("R", r)?;
        self.r[..self.d].copy_from_slice(r);
        self.least = r.iter().copied().fold(f64::INFINITY, f64::min);
        self.set_above(m)
    }

    /// Takes the first rows of `M`.
    pub(super) fn set_above(&mut self, m: &[f64]) -> Result<()> {
        let (d, ld) = (self.d, self.ld);
        for (line, row) in self.m.chunks_exact_mut(ld.max(1)).zip(m.chunks_exact(d.max(1))) {
            line[..d].copy_from_slice(row);
        }
        (self.prepared, self.inverted, self.tried, self.whole) = (false, false, false, false);
        (self.faces, self.unlimited) = (0, false);
        Ok(())
    }

    fn square(&mut self, until: Until<'_>) -> Result<()> {
        let (d, ld) = (self.d, self.ld);
        squared(&self.m, d, ld, &mut self.h, until)?;
        for i in 0..d {
            let entry = &mut self.h[i * ld + i];
            *entry += self.r[i];
            self.curvature[i] = *entry;
        }
        self.prepared = true;
        if self.curvature.iter().all(|v| v.is_finite()) {
            Ok(())
        } else {
            require_finite("M", &self.m)?;
            Err(Error::Overflow { what: "the square of `M`" })
        }
    }

    /// Takes `y`.
    pub(super) fn aim(&mut self, y: &[f64]) -> Result<()> {
        self.f.fill(0.0);
        add_transposed(&self.m, y, self.triangular, &mut self.f);
        self.centre.clear();
        self.aimed(y)
    }

    /// Takes `y`, whose `M'y` is there.
    pub(super) fn aimed(&mut self, y: &[f64]) -> Result<()> {
        self.y.copy_from_slice(y);
        self.zero = vector::dot(&self.y, &self.y) + self.rest;
        if self.zero.is_finite() && self.f.iter().all(|v| v.is_finite()) {
            Ok(())
        } else {
            require_finite("M", &self.m)?;
            require_finite("y", y)?;
            Err(Error::Overflow { what: "the square of `y`" })
        }
    }

    /// `H^{-1}`, if it is kept.
    pub(super) fn inverse(&self) -> Option<&[f64]> {
        self.inverted.then_some(&self.inverse)
    }

    /// Keeps `H^{-1}` if the condition of `H` is small enough for it.
    pub(super) fn invert(&mut self, until: Until<'_>) -> Result<()> {
        self.prepare(until)?;
        let (d, ld, h) = (self.d, self.ld, &self.h);
        self.tried = true;
        let there = std::mem::take(&mut self.unlimited);
        let column = |j: usize, to: &mut [f64]| to.copy_from_slice(&h[j * ld + j..j * ld + d]);
        if !(there || self.factor.set(d, column, until)?) || self.factor.condition() > ILL {
            return Ok(());
        }
        for memory in [&mut self.inverse, &mut self.spare] {
            if memory.is_empty() {
                *memory = try_zeros(WHAT, self.h.len())?;
            }
        }
        self.factor.inverted(&mut self.spare, &mut self.inverse)?;
        // cond(H) <= ||H||_F ||H^{-1}||_F
        self.size = vector::norm(&self.inverse);
        self.inverted = self.size * vector::norm(&self.h) <= ILL;
        Ok(())
    }
}
