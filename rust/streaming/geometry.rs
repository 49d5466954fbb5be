//! `B` with its pseudoinverse, applied through the singular vectors, and the projector onto its range.

use crate::control::pseudoinverse;
use crate::error::{Error, Result};
use crate::fuse::power_of_two_scale;
use crate::memory::try_zeros;
use crate::vector::{dot, norm};

/// `B` with its singular vectors; the left ones are an orthonormal basis of its range.
#[derive(Debug)]
pub struct Geometry {
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) b: Vec<f64>,
    basis: Vec<f64>,
    /// The right singular vectors over their singular values, vector by vector.
    inverse: Vec<f64>,
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
        let mut inverse = p.right;
        for (vector, sigma) in inverse.chunks_exact_mut(m).zip(&p.singular_values) {
            vector.iter_mut().for_each(|entry| *entry /= sigma);
        }
        Ok(Self { n, m, b, basis: p.basis, inverse, gain })
    }

    /// States and inputs.
    pub fn size(&self) -> (usize, usize) {
        (self.n, self.m)
    }

    /// The rank of `B`.
    pub fn rank(&self) -> usize {
        self.basis.len() / self.n
    }

    /// `B^+ z = sum_k right_k <basis_k, z> / sigma_k`.
    ///
    /// # Errors
    /// [`Error::Overflow`] if that is not representable.
    pub fn control(&self, z: &[f64]) -> Result<Vec<f64>> {
        let mut u = try_zeros("the control", self.m)?;
        for (vector, direction) in self.inverse.chunks_exact(self.m).zip(self.basis.chunks_exact(self.n)) {
            let coordinate = dot(direction, z);
            u.iter_mut().zip(vector).for_each(|(u, v)| *u += coordinate * v);
        }
        if u.iter().all(|u: &f64| u.is_finite()) { Ok(u) } else { Err(Error::Overflow { what: "the control" }) }
    }

    /// `||P z||`.
    /// `room` is scratch space with as many entries as `z`.
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
