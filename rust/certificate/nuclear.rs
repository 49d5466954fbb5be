//! The largest `||sum_j M_j Gamma c_j||` over a spectral ball of `Gamma`.
//!
//! By duality it is the largest nuclear norm of `N(l) = sum_j M_j' l c_j'` over unit vectors `l` for
//! `||Gamma||_2 <= 1`, and `||N||_* <= ||N T^(-1/2)||_F ||T^(1/2)||_F`, so that for every `T > 0` it is at most
//!
//! ```text
//! nuc(T) = sqrt(tr T lam_max(sum_ij (c_i' T^-1 c_j) M_i M_j')).
//! ```
//!
//! `T = S(X)^(1/2)`, `S(X) = sum_ij tr(M_i' X M_j) c_i c_j'`, where `X` takes the steps of Frank and Wolfe (1956)
//! towards the largest `tr S(X)^(1/2)` over `X >= 0` of trace 1, which is the least of `nuc`. It decides when to stop,
//! and nothing else: each `nuc(T)` is an upper bound.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use crate::error::Result;
use crate::identify::{Symmetric, squares};
use crate::memory::{checked_len, try_copy, try_zeros};

pub(super) const WHAT: &str = "a certificate of several steps";
/// What is added to T, relative to its mean eigenvalue, so that it has an inverse.
const RIDGE: f64 = 1e-9;
/// Eigenvalues of S below this share of the largest are rounding, which a root would make large.
const NOTHING: f64 = 1e-13;
/// For the rounding of `nuc(T)`, relative.
const ROUNDING: f64 = 1e-9;

/// When to stop: after so many steps, or when no T is better by this share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Effort {
    pub rounds: usize,
    pub tolerance: f64,
}

/// How long to look for a better bound of the last state.
pub(super) const EFFORT: Effort = Effort { rounds: 10, tolerance: 1e-3 };

/// `M_0, .., M_{k-1}` (k, rows n), their norms, and the coordinates of `c_{k-1}, .., c_0`, r of each.
pub(super) struct Terms<'a> {
    pub matrices: &'a [f64],
    pub norms: &'a [f64],
    pub c: &'a [f64],
    pub rows: usize,
    pub n: usize,
    pub r: usize,
}

impl Terms<'_> {
    fn each<'b>(&'b self, y: &'b [f64]) -> impl Iterator<Item = (&'b [f64], f64, &'b [f64])> {
        let matrices = self.matrices.chunks_exact(self.rows * self.n).zip(self.norms);
        y.chunks_exact(self.r).zip(matrices).map(|(y, (matrix, norm))| (matrix, *norm, y))
    }

    /// Room for `sum_j y_j' (x) M_j`, row by row.
    fn room(&self) -> Result<Vec<f64>> {
        try_zeros(WHAT, checked_len(WHAT, self.rows, self.r * self.n)?)
    }

    /// The squares `Z Z'` of `Z = sum_j y_j' (x) M_j` for other coordinates `y`, divided by the square of what is
    /// returned.
    fn squares(&self, y: &[f64], total: &mut [f64], to: &mut [f64]) -> Result<f64> {
        let (k, rows, r, each) = (self.norms.len(), self.rows, self.r, self.rows * self.n);
        let whole = MatMut::from_row_major_slice_mut(total, each, r);
        let matrices = MatRef::from_row_major_slice(self.matrices, k, each);
        matmul(whole, Accum::Replace, matrices.transpose(), MatRef::from_row_major_slice(y, k, r), 1.0, Par::Seq);
        let scale = crate::fuse::power_of_two_scale(&*total);
        total.iter_mut().for_each(|v| *v /= scale);
        squares(MatRef::from_row_major_slice(total, rows, self.n * r), to)?;
        Ok(scale)
    }

    /// `||sum_j c_j' (x) M_j||`.
    pub fn frobenius(&self) -> Result<f64> {
        let mut small = Symmetric::new(self.rows)?;
        let scale = self.squares(self.c, &mut self.room()?, &mut small.matrix)?;
        Ok(scale * small.largest()?.max(0.0).sqrt())
    }

    /// Flops of one round, roughly.
    fn cost(&self) -> f64 {
        let [rows, n, r, k] = [self.rows, self.n, self.r, self.norms.len()].map(|size| size as f64);
        rows * n * r * (k + rows) + 20.0 * (rows.powi(3) + r.powi(3))
    }

    /// An upper bound of the largest nuclear norm, infinite if there is no time for it; `enough` is a value that needs
    /// not be found.
    pub fn largest(&self, effort: Effort, enough: f64) -> Result<f64> {
        const MOST: f64 = 1e7;
        let (rows, n, r) = (self.rows, self.n, self.r);
        // in units in which no square leaves the range of doubles
        let scale = crate::fuse::power_of_two_scale(self.c);
        let mut c = try_copy(WHAT, self.c)?;
        c.iter_mut().for_each(|c| *c /= scale);
        let unit = self.norms.iter().copied().fold(0.0, f64::max);
        let enough = enough / unit / scale;
        let rounds = effort.rounds.min((effort.rounds as f64 * MOST / self.cost()) as usize);
        let square = checked_len(WHAT, r, r)?;
        let [mut s, mut turned] = [try_zeros(WHAT, square)?, try_zeros(WHAT, square)?];
        let (mut t, mut gram) = (Symmetric::new(r)?, Symmetric::new(rows)?);
        // T_0 = sum_j (||M_j|| / ||c_j||) c_j c_j': at most the weighted inequality of Cauchy and Schwarz
        for (_, norm, c) in self.each(&c) {
            let length = crate::fuse::norm(c.iter().copied());
            if norm * length > 0.0 {
                add_square(&mut t.matrix, c, norm / unit / length);
            }
        }
        let [mut y, mut line] = [try_zeros(WHAT, c.len())?, try_zeros(WHAT, checked_len(WHAT, n, r)?)?];
        let [mut directions, mut row] = [try_zeros(WHAT, checked_len(WHAT, rows, rows)?)?, try_zeros(WHAT, n)?];
        let (mut roots, mut total) = (try_zeros(WHAT, r)?, self.room()?);
        let mut best = f64::INFINITY;
        for round in 0..rounds {
            if round > 0 {
                t.matrix.copy_from_slice(&s);
            }
            let values = t.eigenpairs(&mut turned)?;
            let nothing = NOTHING * values.iter().copied().fold(0.0, f64::max);
            let kept = |v: &f64| if *v > nothing { *v } else { 0.0 };
            let root = |v: &f64| if round == 0 { kept(v) } else { kept(v).sqrt() };
            roots.iter_mut().zip(values).for_each(|(to, v)| *to = root(v));
            let trace: f64 = roots.iter().sum();
            let done = round > 0 && (best <= (1.0 + effort.tolerance) * trace || trace >= enough);
            if done || !(trace > 0.0 && trace.is_finite()) {
                break;
            }
            let (ridge, trace) = (trace * RIDGE / r as f64, trace * (1.0 + RIDGE));
            // y_j = T^(-1/2) c_j, but for a rotation
            let mut rough = 0.0;
            turned.chunks_exact_mut(r).zip(&roots).for_each(|(v, root)| {
                let size = (root + ridge).sqrt();
                v.iter_mut().for_each(|v| *v /= size);
            });
            let (all, k) = (MatRef::from_row_major_slice(&turned, r, r), self.norms.len());
            let to = MatMut::from_row_major_slice_mut(&mut y, k, r);
            matmul(to, Accum::Replace, MatRef::from_row_major_slice(&c, k, r), all.transpose(), 1.0, Par::Seq);
            for (y, norm) in y.chunks_exact(r).zip(self.norms) {
                rough += crate::fuse::norm(y.iter().copied()) * norm / unit;
            }
            let size = self.squares(&y, &mut total, &mut gram.matrix)? / unit;
            let values = gram.eigenpairs(&mut directions)?.iter().copied().enumerate();
            let (at, top) = values.fold((0, 0.0), |best, one| if one.1 > best.1 { one } else { best });
            let l = &directions[at * rows..(at + 1) * rows];
            let found = (trace * top).sqrt() * size;
            if !found.is_finite() {
                break;
            }
            let lost = r as f64 * f64::EPSILON * (r as f64 / RIDGE).sqrt();
            best = best.min(found * (1.0 + ROUNDING) + lost * trace.sqrt() * rough);
            // S <- S + 2 / (round + 2) (N(l)' N(l) - S)
            line.fill(0.0);
            for (matrix, _, c) in self.each(&c) {
                row.fill(0.0);
                for (matrix, l) in matrix.chunks_exact(n).zip(l) {
                    row.iter_mut().zip(matrix).for_each(|(row, m)| *row += l * m / unit);
                }
                for (line, m) in line.chunks_exact_mut(r).zip(&row) {
                    line.iter_mut().zip(c).for_each(|(line, c)| *line += m * c);
                }
            }
            let step = 2.0 / (round as f64 + 2.0);
            s.iter_mut().for_each(|v| *v *= 1.0 - step);
            line.chunks_exact(r).for_each(|line| add_square(&mut s, line, step));
        }
        Ok(best * unit * scale)
    }
}

/// `to += weight v v'`.
fn add_square(to: &mut [f64], v: &[f64], weight: f64) {
    for (to, a) in to.chunks_exact_mut(v.len()).zip(v) {
        to.iter_mut().zip(v).for_each(|(to, b)| *to += weight * a * b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: Effort = Effort { rounds: 40, tolerance: 1e-6 };

    /// Two rotations: `I` and a quarter turn, `c` the unit vectors. The largest nuclear norm is 2.
    #[test]
    fn a_known_largest_value() {
        let (matrices, c) = ([0.0, -1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0]);
        let terms = Terms { matrices: &matrices, norms: &[1.0, 1.0], c: &c, rows: 2, n: 2, r: 2 };
        let found = terms.largest(FULL, f64::INFINITY).unwrap();
        assert!((2.0..2.0 * (1.0 + 2e-9)).contains(&found), "{found}");
        assert!((terms.frobenius().unwrap() - 2f64.sqrt()).abs() < 1e-15);
    }

    /// One term: `||M|| ||c||`; nothing: 0 is not below it.
    #[test]
    fn one_term_and_none() {
        let (matrices, c) = ([3.0, 0.0, 0.0, 1.0], [2.0]);
        let terms = Terms { matrices: &matrices, norms: &[3.0], c: &c, rows: 2, n: 2, r: 1 };
        let found = terms.largest(FULL, f64::INFINITY).unwrap();
        assert!((6.0..6.0 * (1.0 + 2e-8)).contains(&found), "{found}");
        let nothing = Terms { c: &[0.0], ..terms };
        assert_eq!(nothing.largest(FULL, f64::INFINITY).unwrap(), f64::INFINITY);
    }
}
