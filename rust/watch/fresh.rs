//! What changed: the pairs after an alarm, or of a new log, against the region.
//!
//! With `M = sum w z'` and `V = sum z z'` of pairs after a stopping time, P and kappa known there, and noise that is
//! sub-Gaussian with proxy `Sbar`, with probability `1 - alpha` for all lengths of the set, all l and q at once
//!
//! ```text
//! |l' (H - Theta_1) q| <= sqrt(l' Sbar l) r(q),   r(q) = min_k sqrt(2 c_k) ||(V + kappa_k P)^(1/2) V^-1 q||
//! ```
//!
//! by the mixture over the sphere. What is further off than this and the region proves the change, however it was
//! found.

use faer::{ColMut, MatMut, MatRef};

use crate::control::singular;
use crate::error::Result;
use crate::fuse::norm;
use crate::identify::{cholesky, null_space, sphere_level, whiten};
use crate::memory::{checked_len, try_collect, try_copy, try_extend, try_filled, try_push, try_zeros};
use crate::vector::{axpy, dot};

use super::frame::{Frame, WHAT, WIDER};

/// Pairs of the mixtures: sets of about these lengths are measured best.
pub(super) const MIXTURES: [f64; 3] = [5.0, 50.0, 500.0];
/// Of the largest: directions of z that are as good as absent. Any limit is valid, as the others are orthogonal to
/// them.
const ABSENT: f64 = 1e-9;
/// In units of the data of the region: what is smaller is absent, too, and squares stay numbers.
const TINY: f64 = 1e-100;
/// Shares of the new pairs in a bound, between which the search for a violation chooses.
const SHARES: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];

/// The pairs, as a triangle of `(P^(-1/2) z, e)`.
#[derive(Debug, Clone)]
pub struct Fresh {
    triangle: Vec<f64>,
    row: Vec<f64>,
    kappas: Vec<f64>,
    size: f64,
}

/// What the pairs say.
#[derive(Debug)]
pub struct Look {
    /// The estimate (outputs, d), nan where the pairs do not determine a column, or the row is not watched; it is
    /// within this of the system; and what the region adds for a system of it.
    pub entries: [Vec<f64>; 3],
    /// The largest violation of the region: of all, without each of the groups of columns, and without each row. Above
    /// 1 a proof that the system is outside, and that these columns or this row alone do not explain it.
    pub violations: Vec<f64>,
    /// What the gain of each column is now in parts of that of C (d), along the direction of the old one, and both
    /// radii.
    pub gains: [Vec<f64>; 3],
    /// `white` (d, d), `root` with `white root' = I`, and `factor` of the set that these pairs allow:
    /// `(H - Theta) V (H - Theta)' <= factor Sbar`, `V = root' root`. Empty where they do not determine all of z, or
    /// not all rows are watched.
    pub allowed: (Vec<f64>, Vec<f64>, f64),
}

impl Fresh {
    /// An empty set for regressors of this frame; `kappas` other than the usual are for tests.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn new(frame: &Frame, kappas: Option<&[f64]>) -> Result<Self> {
        let k = frame.sizes.0 + frame.sizes.1;
        let kappas = try_copy(WHAT, kappas.unwrap_or(&MIXTURES))?;
        Ok(Self { triangle: try_zeros(WHAT, checked_len(WHAT, k, k)?)?, row: try_zeros(WHAT, k)?, kappas, size: 0.0 })
    }

    /// Takes a pair in, by rotations; nothing is allocated.
    pub fn add(&mut self, frame: &Frame, z: &[f64], e: &[f64]) {
        let (d, k) = (z.len(), self.row.len());
        self.row.iter_mut().zip(frame.scaled.chunks_exact(d)).for_each(|(to, row)| *to = dot(row, z));
        self.row[d..].copy_from_slice(e);
        for (i, own) in self.triangle.chunks_exact_mut(k).enumerate() {
            let size = own[i].hypot(self.row[i]);
            if size == 0.0 {
                continue;
            }
            let (c, s) = (own[i] / size, self.row[i] / size);
            for (a, b) in own[i..].iter_mut().zip(&mut self.row[i..]) {
                (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
            }
        }
        self.size += 1.0;
    }

    /// The number of pairs.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.size
    }

    /// Begins anew.
    pub fn clear(&mut self) {
        self.triangle.fill(0.0);
        self.size = 0.0;
    }

    pub(super) fn triangle(&mut self) -> &mut Vec<f64> {
        &mut self.triangle
    }

    pub(super) fn resume(&mut self, size: f64) {
        self.size = size;
    }

    /// What the pairs prove, together with probability `1 - alpha` and in the event of the region; `groups` of columns.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for an alpha outside of (0, 1), [`crate::Error::Numerical`], [`crate::Error::Memory`].
    pub fn look(&self, frame: &Frame, alpha: f64, groups: &[Vec<usize>]) -> Result<Look> {
        Search::new(self, frame, alpha)?.look(groups)
    }
}

/// The pairs in the coordinates of `z`.
struct Search<'a> {
    frame: &'a Frame,
    /// `L^-1 (H - C)` (n, d).
    off: Vec<f64>,
    /// `r(q) = ||A q||` of each mixture (rank, d), its root and level.
    forms: Vec<(Vec<f64>, Vec<f64>, f64)>,
    /// Directions of z that are absent, as rows (absent, d).
    absent: Vec<f64>,
}

impl<'a> Search<'a> {
    fn new(of: &Fresh, frame: &'a Frame, alpha: f64) -> Result<Self> {
        let ((n, d), k) = (frame.sizes, of.row.len());
        let svd = singular(&try_collect(WHAT, (0..d * d).map(|at| of.triangle[at / d * k + at % d]))?, d, d)?;
        let least = (ABSENT * svd.s.first().copied().unwrap_or(0.0)).max(TINY);
        let rank = svd.s.iter().filter(|s| **s > least).count();
        // rows v_i' P^(-1/2) of z, and v_i' P^(1/2)'
        let [mut along, mut back] = [try_zeros::<f64>(WHAT, d * d)?, try_zeros::<f64>(WHAT, d * d)?];
        for at in 0..d * d {
            axpy(svd.v[at], &frame.scaled[at % d * d..][..d], &mut along[at / d * d..][..d]);
            axpy(svd.v[at], &frame.unscaled[at % d * d..][..d], &mut back[at / d * d..][..d]);
        }
        let mut off = try_zeros::<f64>(WHAT, n * d)?;
        for at in 0..n * rank {
            let (i, q) = (at / rank, at % rank);
            let h: f64 = (0..d).map(|t| svd.u[q * d + t] * of.triangle[t * k + d + i]).sum();
            axpy(h / svd.s[q], &along[q * d..][..d], &mut off[i * d..][..d]);
        }
        let mut forms = Vec::new();
        for kappa in &of.kappas {
            let ld = svd.s.iter().map(|s| (s * s / kappa).ln_1p()).sum::<f64>();
            let level = 2.0 * sphere_level(n, ld, alpha / of.kappas.len() as f64)? * WIDER;
            let wider = |at: usize| svd.s[at / d].hypot(kappa.sqrt()) / svd.s[at / d].powi(2);
            let form = try_collect(WHAT, (0..rank * d).map(|at| along[at] * wider(at) * level.sqrt()))?;
            let root = try_collect(WHAT, (0..rank * d).map(|at| back[at] / wider(at)))?;
            try_push(WHAT, &mut forms, (form, root, level))?;
        }
        Ok(Self { frame, off, forms, absent: try_copy(WHAT, &along[rank * d..])? })
    }

    fn look(self, groups: &[Vec<usize>]) -> Result<Look> {
        let (frame, (n, d)) = (self.frame, self.frame.sizes);
        let mut violations = try_collect(WHAT, [self.largest(&[], None)?])?;
        for group in groups {
            try_push(WHAT, &mut violations, self.largest(group, None)?)?;
        }
        for row in 0..frame.outputs {
            let own = frame.rows.iter().position(|one| *one == row); // one that is not watched explains nothing
            let found = own.map_or(Ok(violations[0]), |i| self.largest(&[], Some(i)))?;
            try_push(WHAT, &mut violations, found)?;
        }
        let filled = |count: usize| {
            Ok::<_, crate::Error>([
                try_filled(WHAT, f64::NAN, count)?,
                try_filled(WHAT, f64::INFINITY, count)?,
                try_filled(WHAT, f64::INFINITY, count)?,
            ])
        };
        let (mut entries, mut gains, mut q) = (filled(frame.outputs * d)?, filled(d)?, try_zeros(WHAT, d)?);
        for j in 0..d {
            q.fill(0.0);
            q[j] = 1.0;
            if !self.absent.chunks_exact(d).all(|row| row[j].abs() <= 1e-12 / frame.scale[j]) {
                continue;
            }
            for i in 0..n {
                let (at, l) = (frame.rows[i] * d + j, &frame.root[i * n..(i + 1) * n]); // l = e_i is L' e_i in the units of e
                entries[0][at] = frame.centre[i * d + j] + self.along(l, &q);
                (entries[1][at], entries[2][at]) = self.radii(l, &q);
            }
            let l = frame.whitened(|k| frame.centre[k * d + j])?; // Sbar^-1 C e_j there
            let size = dot(&l, &l);
            if size > 0.0 {
                let (new, old) = self.radii(&l, &q);
                (gains[0][j], gains[1][j], gains[2][j]) = (1.0 + self.along(&l, &q) / size, new / size, old / size);
            }
        }
        // the mixture with the smallest set, in the units of z
        let trace =
            |form: &[f64]| form.iter().enumerate().map(|(at, v)| (v * frame.scale[at % d]).powi(2)).sum::<f64>();
        let best = self.forms.into_iter().min_by(|a, b| trace(&a.0).total_cmp(&trace(&b.0)));
        let known = self.absent.is_empty() && n == frame.outputs;
        let allowed = best.filter(|of| known && of.0.iter().all(|v| v.is_finite())).map(|(mut form, root, level)| {
            form.iter_mut().for_each(|v| *v /= level.sqrt());
            (form, root, level)
        });
        Ok(Look { entries, violations, gains, allowed: allowed.unwrap_or((Vec::new(), Vec::new(), f64::INFINITY)) })
    }

    /// `l' (H - C) q`.
    fn along(&self, l: &[f64], q: &[f64]) -> f64 {
        self.off.chunks_exact(q.len()).zip(l).map(|(row, l)| l * dot(row, q)).sum()
    }

    /// `||l|| r(q)`, and what the region allows.
    fn radii(&self, l: &[f64], q: &[f64]) -> (f64, f64) {
        let length = |rows: &[f64]| norm(rows.chunks_exact(q.len()).map(|row| dot(row, q)));
        let r = self.forms.iter().map(|form| length(&form.0)).fold(f64::INFINITY, f64::min);
        let own =
            |p: usize| length(&self.frame.white[self.frame.begins[p] * q.len()..self.frame.begins[p + 1] * q.len()]);
        let old = (0..self.frame.norms.len()).map(|p| self.frame.spread(p, l) * own(p)).sum::<f64>();
        (WIDER * norm(l.iter().copied()) * r, WIDER * old)
    }

    /// The largest `l'(H - C) q / (||l|| r(q) + sum_p |B'l| ||W q||)` that is found, over q without these columns and l
    /// without a row: `(a + sum_p b_p)^2 <= a^2 / t + k sum_p b_p^2 / (1 - t)` with `|B'l| <= ||B|| ||l||` is a square
    /// of q, of which the best l and q are singular vectors. Any l and q would do.
    fn largest(&self, without: &[usize], row: Option<usize>) -> Result<f64> {
        let (frame, (n, d)) = (self.frame, self.frame.sizes);
        let mut fixed = try_copy(WHAT, &self.absent)?;
        for j in without {
            try_extend(WHAT, &mut fixed, (0..d).map(|k| f64::from(u8::from(k == *j)) / frame.scale[*j]))?;
        }
        // q is t in units of z; l_i is the product of l with column i of L^-1
        fixed.iter_mut().enumerate().for_each(|(at, v)| *v *= frame.scale[at % d]);
        let of_q = complement(&fixed, d)?;
        let barred = row.map_or(Ok(Vec::new()), |i| try_collect(WHAT, (0..n).map(|k| frame.back[k * n + i])))?;
        let of_l = complement(&barred, n)?;
        let (free, rows, parts) = (of_q.len() / d, of_l.len() / n, frame.norms.len() as f64);
        let mut best: f64 = 0.0;
        if free * rows == 0 {
            return Ok(best);
        }
        for (form, share) in self.forms.iter().flat_map(|form| SHARES.map(|share| (&form.0, share))) {
            let mut square = try_zeros::<f64>(WHAT, free * free)?;
            let mut add = |list: &[f64], weight: f64| -> Result<()> {
                for row in list.chunks_exact(d) {
                    let of = try_collect(
                        WHAT,
                        (0..free).map(|k| (0..d).map(|j| row[j] * frame.scale[j] * of_q[j * free + k]).sum::<f64>()),
                    )?;
                    square.chunks_exact_mut(free).zip(&of).for_each(|(to, v)| axpy(weight * v, &of, to));
                }
                Ok(())
            };
            add(form, 1.0 / share)?;
            for (p, size) in frame.norms.iter().enumerate() {
                add(&frame.white[frame.begins[p] * d..frame.begins[p + 1] * d], parts * size * size / (1.0 - share))?;
            }
            square.iter_mut().step_by(free + 1).for_each(|v| *v *= 1.0 + 1e-12);
            let Some(root) = cholesky(&square, free)? else { continue };
            // G = of_l' (H - C) of_q root^-T, row by row
            let mut g = try_zeros::<f64>(WHAT, rows * free)?;
            for (a, to) in g.chunks_exact_mut(free).enumerate() {
                for k in 0..free {
                    let entry = |i: usize| {
                        (0..d).map(|j| self.off[i * d + j] * frame.scale[j] * of_q[j * free + k]).sum::<f64>()
                    };
                    to[k] = (0..n).map(|i| of_l[i * rows + a] * entry(i)).sum();
                }
            }
            let root = MatRef::from_row_major_slice(&root, free, free);
            whiten(root, MatMut::from_row_major_slice_mut(&mut g, rows, free).transpose_mut());
            let svd = singular(&g, rows, free)?;
            let mut t = try_copy(WHAT, &svd.v[..free])?;
            // root'^-1: from the last entry to the first
            let last = ColMut::from_slice_mut(&mut t).reverse_rows_mut();
            whiten(root.transpose().reverse_rows_and_cols(), last.as_mat_mut());
            let q = try_collect(WHAT, (0..d).map(|j| frame.scale[j] * dot(&of_q[j * free..(j + 1) * free], &t)))?;
            let l = try_collect(WHAT, (0..n).map(|i| dot(&of_l[i * rows..(i + 1) * rows], &svd.u[..rows])))?;
            let (new, old) = self.radii(&l, &q);
            best = best.max(self.along(&l, &q) / (new + old)); // f64::max passes nan by
        }
        Ok(best)
    }
}

/// An orthonormal basis (d, free) of what is orthogonal to these rows, whatever their lengths are.
fn complement(rows: &[f64], d: usize) -> Result<Vec<f64>> {
    let count = d.max(rows.len() / d);
    let mut padded = try_zeros(WHAT, checked_len(WHAT, d, count)?)?;
    for (to, row) in padded.chunks_exact_mut(d).zip(rows.chunks_exact(d)) {
        let size = norm(row.iter().copied());
        to.iter_mut().zip(row).for_each(|(to, v)| *to = v / size);
    }
    let svd = singular(&padded, count, d)?;
    Ok(null_space(&svd.v, &svd.s, d, 1e-9)?.1)
}
