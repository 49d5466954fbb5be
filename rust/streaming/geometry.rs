//! `B` with its pseudoinverse, applied through the singular vectors, and the projector onto its range.

use crate::control::{Best, Factors, Motion, best_control, pseudoinverse};
use crate::error::{Error, Result};
use crate::fuse::power_of_two_scale;
use crate::memory::try_zeros;
use crate::parallel::Stop;
use crate::vector::{dot, norm};

/// Prefixes of the saved arrays of the three entities.
pub(super) const NAMES: [&str; 3] = ["x0", "xf", "A"];

/// `B` with its singular vectors; the left ones are an orthonormal basis of its range.
#[derive(Debug)]
pub struct Geometry {
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) b: Vec<f64>,
    basis: Vec<f64>,
    /// The right singular vectors, vector by vector.
    right: Vec<f64>,
    singular_values: Vec<f64>,
    /// How far the factored matrix can be from `B`, `(2 max(n, m) + 4) eps ||B||` (LAPACK Users' Guide, 4.9).
    off: f64,
    /// The largest entry of the pseudoinverse.
    gain: f64,
}

impl Geometry {
    /// For `B` with `n` rows and `m` columns, row by row.
    ///
    /// # Errors
    /// As [`pseudoinverse`]; [`Error::Shape`] if the entries are not `n m`.
    pub fn new(b: Vec<f64>, n: usize, m: usize) -> Result<Self> {
        if n == 0 || m == 0 || n.checked_mul(m) != Some(b.len()) {
            let expected = format!("{n} x {m} entries, at least one");
            return Err(Error::Shape { name: "B", expected, found: b.len().to_string() });
        }
        let p = pseudoinverse(&b, n, m)?;
        let gain = p.matrix.iter().fold(0.0f64, |largest, entry| largest.max(entry.abs()));
        let off = (2 * n.max(m) + 4) as f64 * f64::EPSILON * p.singular_values.first().copied().unwrap_or(0.0);
        Ok(Self { n, m, b, basis: p.basis, right: p.right, singular_values: p.singular_values, off, gain })
    }

    /// States and inputs.
    pub fn size(&self) -> (usize, usize) {
        (self.n, self.m)
    }

    /// The rank of `B`.
    pub fn rank(&self) -> usize {
        self.basis.len() / self.n
    }

    /// The refined control `B^+ (xf - A x0)` for the given doubles, A row by row, with its rounding.
    ///
    /// # Errors
    /// [`Error::Overflow`] if it is not representable, [`Error::Memory`].
    pub fn best(&self, a: &[f64], x0: &[f64], xf: &[f64]) -> Result<Best> {
        let motion = Motion { a, b: &self.b, n: self.n, m: self.m, steps: 1 };
        let factors =
            Factors { basis: &self.basis, right: &self.right, singular_values: &self.singular_values, gap: self.gap() };
        let best = best_control(&motion, &factors, x0, xf, &Stop::new())?;
        let finite = best.control.iter().all(|u| u.is_finite());
        if finite { Ok(best) } else { Err(Error::Overflow { what: "the control" }) }
    }

    /// A lower bound of the least singular value of `B` that is not 0; infinite for rank 0.
    fn gap(&self) -> f64 {
        self.rank().checked_sub(1).map_or(f64::INFINITY, |last| self.singular_values[last] - self.off)
    }

    /// What rounding adds to `||P z||`, and to `||B v||` for the control v of a wish `z` that is handed out in doubles,
    /// in a bound: `||P z|| <= ||P_hat z|| + t ||z||`, `t = off / gap` (Wedin, BIT 13 (1973) 217-232; 0 where the range
    /// is the whole space), and `||B (v - v*)|| <= eps ||B||_F ||v||`, as `v` is `v*` rounded to doubles.
    pub fn rounding(&self, z: &[f64], wish: &[f64]) -> f64 {
        if self.rank() == 0 {
            return 0.0;
        }
        let gap = self.gap();
        if gap <= 0.0 {
            return f64::INFINITY;
        }
        let turned = if self.rank() == self.n { 0.0 } else { (self.off / gap).min(1.0) };
        let unit = power_of_two_scale(wish);
        let coordinate = |(q, s): (&[f64], &f64)| q.iter().zip(wish).map(|(q, z)| q * (z / unit)).sum::<f64>() / s;
        let along = self.basis.chunks_exact(self.n).zip(&self.singular_values).map(coordinate);
        let control = along.fold(0.0f64, |sum, c| sum + c * c).sqrt() * unit;
        // ||v|| <= (1 + 2 t) ||v_hat|| + 2 off / gap^2 ||z||
        let size = (1.0 + 2.0 * turned) * control + 2.0 * (self.off / gap) * (scaled_norm(wish) / gap);
        let whole = self.singular_values.iter().map(|s| s / self.singular_values[0]).fold(0.0, |sum, s| sum + s * s);
        turned * scaled_norm(z) + f64::EPSILON * whole.sqrt() * (self.singular_values[0] * size)
    }

    /// `B^+ z = sum_k right_k <basis_k, z> / sigma_k`.
    ///
    /// # Errors
    /// [`Error::Overflow`] if that is not representable.
    pub fn control(&self, z: &[f64]) -> Result<Vec<f64>> {
        let mut u = try_zeros("the control", self.m)?;
        let directions = self.right.chunks_exact(self.m).zip(self.basis.chunks_exact(self.n));
        for ((vector, direction), sigma) in directions.zip(&self.singular_values) {
            let coordinate = dot(direction, z) / sigma;
            u.iter_mut().zip(vector).for_each(|(u, v)| *u += coordinate * v);
        }
        if u.iter().all(|u: &f64| u.is_finite()) { Ok(u) } else { Err(Error::Overflow { what: "the control" }) }
    }

    /// `||P z||`.
    /// `room` has as many entries as `z`, and is written to.
    pub fn projected_norm(&self, z: &[f64], room: &mut [f64]) -> f64 {
        let scale = power_of_two_scale(z);
        room.iter_mut().zip(z).for_each(|(to, z)| *to = z / scale);
        if self.rank() == self.n {
            return norm(room) * scale; // P = I
        }
        let squares = self.basis.chunks_exact(self.n).map(|q| dot(q, room)).fold(0.0, |sum, c| sum + c * c);
        squares.sqrt() * scale
    }

    /// The largest entry that `B^+ z` can have for `||z||_1 <= size`.
    pub(super) fn largest_control(&self, size: f64) -> f64 {
        self.gain * size
    }
}

/// `||z||` without overflow.
pub(super) fn scaled_norm(z: &[f64]) -> f64 {
    let unit = power_of_two_scale(z);
    z.iter().fold(0.0f64, |sum, z| sum + (z / unit) * (z / unit)).sqrt() * unit
}
