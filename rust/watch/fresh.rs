//! What changed: the pairs after an alarm, or of a new log, against the region.
//!
//! With `M = sum w z'` and `V = sum z z'` of pairs after a stopping time, P and kappa known there, and noise that is
//! sub-Gaussian with proxy `Sbar`, with probability `1 - alpha` for all lengths of the set, all l and q at once
//!
//! ```text
//! |l' (H - Theta_1) q| <= sqrt(l' Sbar l) r(q),   r(q) = min_k sqrt(2 c_k) ||(V + kappa_k P)^(1/2) V^-1 q||
//! ```
//!
//! by the mixture over the sphere. What is further off than this and the region proves the change, however it was found.

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{cholesky, null_space, sphere_level};
use crate::memory::{checked_len, try_collect, try_copy, try_filled, try_zeros};

use super::frame::{Frame, WHAT, WIDER};
use crate::control::singular;

/// Pairs of the mixtures: sets of about these lengths are measured best.
const MIXTURES: [f64; 3] = [5.0, 50.0, 500.0];
/// Of the largest: directions of z that are as good as absent. Any limit is valid, as the others are orthogonal to them.
const ABSENT: f64 = 1e-9;
/// Rounds of the search for a violation, from each row.
const ROUNDS: usize = 12;

/// The pairs, as a triangle of `(P^(-1/2) z, e)`.
#[derive(Debug, Clone)]
pub struct Fresh {
    triangle: Vec<f64>,
    row: Vec<f64>,
    kappas: Vec<f64>,
    size: u64,
}

/// What a set of columns or rows explains: the largest violation by all others, above 1 a proof that it does not.
pub type Change = f64;

/// What the pairs say.
#[derive(Debug)]
pub struct Look {
    /// The estimate (n, d) of the rows that are watched, in their units; nan where the pairs do not determine a column.
    pub estimate: Vec<f64>,
    /// The estimate is within this of the system (n, d), and the region adds this for a system of it (n, d).
    pub radius: [Vec<f64>; 2],
    /// The largest violation of the region; above 1 the system is outside.
    pub outside: Change,
    /// The same without each of the groups of columns, and without each row.
    pub columns: Vec<Change>,
    /// See `columns`.
    pub rows: Vec<Change>,
    /// What the gain of each column is now in parts of that of C (d), along the direction of the old one, its radius, and what the
    /// region adds for a system of it.
    pub gains: [Vec<f64>; 3],
    /// `white` (rank, d) and `factor` of the set of systems that these pairs allow: `||(Theta - H) ..||^2 <= factor Sbar`.
    pub white: Vec<f64>,
    /// `root` (rank, d) with `white root' = I`.
    pub root: Vec<f64>,
    /// See `white`.
    pub factor: f64,
}

impl Fresh {
    /// An empty set for regressors of this frame; `kappas` other than the usual are for tests.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn new(frame: &Frame, kappas: Option<&[f64]>) -> Result<Self> {
        let k = frame.n() + frame.width();
        let kappas = try_copy(WHAT, kappas.unwrap_or(&MIXTURES))?;
        Ok(Self { triangle: try_zeros(WHAT, checked_len(WHAT, k, k)?)?, row: try_zeros(WHAT, k)?, kappas, size: 0 })
    }

    /// Takes a pair in, by rotations; nothing is allocated.
    pub fn add(&mut self, frame: &Frame, z: &[f64], e: &[f64]) {
        let (d, k) = (frame.width(), self.row.len());
        for (to, row) in self.row.iter_mut().zip(frame.scaled.chunks_exact(d)) {
            *to = row.iter().zip(z).map(|(a, b)| a * b).sum();
        }
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
        self.size += 1;
    }

    /// The number of pairs.
    #[must_use]
    pub fn size(&self) -> u64 {
        self.size
    }

    /// The triangle, to go on from.
    #[must_use]
    pub fn triangle(&self) -> &[f64] {
        &self.triangle
    }

    /// Goes on from a triangle of so many pairs.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn resume(&mut self, triangle: &[f64], size: u64) -> Result<()> {
        if triangle.len() != self.triangle.len() || triangle.iter().any(|v| !v.is_finite()) {
            let found = triangle.len().to_string();
            let expected = format!("{} finite numbers", self.triangle.len());
            return Err(Error::Shape { name: "triangle", expected, found });
        }
        self.triangle.copy_from_slice(triangle);
        self.size = size;
        Ok(())
    }

    /// What the pairs prove, together with probability `1 - alpha` and in the event of the region; `groups` of columns.
    ///
    /// # Errors
    /// [`Error::Value`] for an alpha outside of (0, 1), [`Error::Numerical`], [`Error::Memory`].
    pub fn look(&self, frame: &Frame, alpha: f64, groups: &[Vec<usize>]) -> Result<Look> {
        Search::new(self, frame, alpha)?.look(groups)
    }
}

/// The pairs in the coordinates of `z`.
struct Search<'a> {
    frame: &'a Frame,
    /// `L^-1 (H - C)` (n, d).
    off: Vec<f64>,
    /// `||A q||^2` of each mixture: A (mixtures, rank, d), with the level in it.
    forms: Vec<Vec<f64>>,
    /// `A'A` (mixtures, d, d), and `W'W` of each part.
    squares: Vec<Vec<f64>>,
    own: Vec<Vec<f64>>,
    /// Directions of z that are absent, as rows (absent, d).
    absent: Vec<f64>,
    levels: Vec<f64>,
    /// `root` of each mixture.
    roots: Vec<Vec<f64>>,
}

impl<'a> Search<'a> {
    fn new(of: &Fresh, frame: &'a Frame, alpha: f64) -> Result<Self> {
        let (n, d, k) = (frame.n(), frame.width(), of.row.len());
        let mut left = try_zeros(WHAT, d * d)?;
        for (i, row) in left.chunks_exact_mut(d).enumerate() {
            row.copy_from_slice(&of.triangle[i * k..i * k + d]);
        }
        let svd = singular(&left, d, d)?;
        let least = ABSENT * svd.s.first().copied().unwrap_or(0.0);
        let rank = svd.s.iter().filter(|s| **s > least).count();
        // rows v_i' P^(-1/2) of z
        let mut along = try_zeros::<f64>(WHAT, d * d)?;
        for (to, v) in along.chunks_exact_mut(d).zip(svd.v.chunks_exact(d)) {
            for (v, row) in v.iter().zip(frame.scaled.chunks_exact(d)) {
                to.iter_mut().zip(row).for_each(|(to, w)| *to += v * w);
            }
        }
        let mut back = try_zeros::<f64>(WHAT, d * d)?;
        for (to, v) in back.chunks_exact_mut(d).zip(svd.v.chunks_exact(d)) {
            for (v, row) in v.iter().zip(frame.unscaled.chunks_exact(d)) {
                to.iter_mut().zip(row).for_each(|(to, w)| *to += v * w);
            }
        }
        let mut off = try_zeros::<f64>(WHAT, n * d)?;
        for (q, (u, row)) in svd.u.chunks_exact(d).zip(along.chunks_exact(d)).take(rank).enumerate() {
            for i in 0..n {
                let h = u.iter().enumerate().map(|(t, u)| u * of.triangle[t * k + d + i]).sum::<f64>() / svd.s[q];
                off[i * d..(i + 1) * d].iter_mut().zip(row).for_each(|(to, a)| *to += h * a);
            }
        }
        let (mut forms, mut levels, mut squares, mut roots) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for kappa in &of.kappas {
            let ld = svd.s.iter().map(|s| (s * s / kappa).ln_1p()).sum::<f64>();
            let level = 2.0 * sphere_level(n, ld, alpha / of.kappas.len() as f64)? * WIDER;
            let [mut form, mut root] = [try_copy(WHAT, &along[..rank * d])?, try_copy(WHAT, &back[..rank * d])?];
            for (q, (row, other)) in form.chunks_exact_mut(d).zip(root.chunks_exact_mut(d)).enumerate() {
                let (s, wider) = (svd.s[q] * svd.s[q], svd.s[q].hypot(kappa.sqrt()));
                row.iter_mut().for_each(|v| *v *= wider * level.sqrt() / s);
                other.iter_mut().for_each(|v| *v *= s / wider);
            }
            roots.push(root);
            squares.push(gram(&form, d)?);
            forms.push(form);
            levels.push(level);
        }
        let mut own = Vec::new();
        for ends in frame.begins.windows(2) {
            own.push(gram(&frame.white[ends[0] * d..ends[1] * d], d)?);
        }
        Ok(Self { frame, off, forms, squares, own, absent: try_copy(WHAT, &along[rank * d..])?, levels, roots })
    }

    fn look(mut self, groups: &[Vec<usize>]) -> Result<Look> {
        let (frame, n, d) = (self.frame, self.frame.n(), self.frame.width());
        let every = try_collect(WHAT, 0..n)?;
        let outside = self.largest(&[], &every)?;
        let mut columns = try_zeros(WHAT, groups.len())?;
        for (to, group) in columns.iter_mut().zip(groups) {
            *to = self.largest(group, &every)?;
        }
        let mut rows = try_zeros(WHAT, n)?;
        for (i, to) in rows.iter_mut().enumerate() {
            *to = self.largest(&[], &try_collect(WHAT, (0..n).filter(|k| *k != i))?)?;
        }
        let mut estimate = try_copy(WHAT, &frame.centre)?;
        let mut radius = [try_filled(WHAT, f64::INFINITY, n * d)?, try_filled(WHAT, f64::INFINITY, n * d)?];
        let inf = || try_filled(WHAT, f64::INFINITY, d);
        let mut gains = [try_filled(WHAT, f64::NAN, d)?, inf()?, inf()?];
        let (mut q, mut l) = (try_zeros(WHAT, d)?, try_zeros(WHAT, n)?);
        for j in 0..d {
            q.fill(0.0);
            q[j] = 1.0;
            let seen = self.determined(&q);
            for i in 0..n {
                // l = e_i is L' e_i in the units of e
                l.copy_from_slice(&frame.root[i * n..(i + 1) * n]);
                let at = i * d + j;
                estimate[at] = if seen { frame.centre[at] + self.along(&l, &q) } else { f64::NAN };
                if seen {
                    (radius[0][at], radius[1][at]) = self.radii(&l, &q);
                }
            }
            // l = Sbar^-1 C e_j is L^-1 C e_j there
            for (i, to) in l.iter_mut().enumerate() {
                *to = (0..=i).map(|k| frame.back[i * n + k] * frame.centre[k * d + j]).sum();
            }
            let size: f64 = l.iter().map(|v| v * v).sum();
            if seen && size > 0.0 {
                let (new, old) = self.radii(&l, &q);
                (gains[0][j], gains[1][j], gains[2][j]) = (1.0 + self.along(&l, &q) / size, new / size, old / size);
            }
        }
        let best = if self.absent.is_empty() { self.best_mixture(d) } else { None };
        let (mut white, mut root, mut factor) = (Vec::new(), Vec::new(), f64::INFINITY);
        if let Some(k) = best {
            (white, root, factor) = (self.forms.swap_remove(k), self.roots.swap_remove(k), self.levels[k]);
            white.iter_mut().for_each(|v| *v /= factor.sqrt());
        }
        Ok(Look { estimate, radius, outside, columns, rows, gains, white, root, factor })
    }

    /// The mixture with the smallest set of systems, by the sum of squares over units of z.
    fn best_mixture(&self, d: usize) -> Option<usize> {
        let trace = |k: usize| {
            self.squares[k].iter().step_by(d + 1).zip(&self.frame.sizes).map(|(v, s)| v * s * s).sum::<f64>()
        };
        (0..self.forms.len()).min_by(|a, b| trace(*a).total_cmp(&trace(*b)))
    }

    /// Whether q has no part in the directions that are absent.
    fn determined(&self, q: &[f64]) -> bool {
        let size: f64 = norm(q.iter().zip(&self.frame.sizes).map(|(q, s)| q / s));
        self.absent.chunks_exact(q.len()).all(|row| dot(row, q).abs() <= 1e-6 * size.min(norm(row.iter().copied())))
    }

    /// `l' (H - C) q`.
    fn along(&self, l: &[f64], q: &[f64]) -> f64 {
        self.off.chunks_exact(q.len()).zip(l).map(|(row, l)| l * dot(row, q)).sum()
    }

    /// `||l|| r(q)`, and what the region allows.
    fn radii(&self, l: &[f64], q: &[f64]) -> (f64, f64) {
        let (d, n) = (q.len(), l.len());
        let r = self.forms.iter().map(|form| norm(form.chunks_exact(d).map(|row| dot(row, q))));
        let new = norm(l.iter().copied()) * r.fold(f64::INFINITY, f64::min);
        let mut old = 0.0;
        for (p, ends) in self.frame.begins.windows(2).enumerate() {
            let lengths = self.frame.white[ends[0] * d..ends[1] * d].chunks_exact(d).map(|row| dot(row, q));
            old += self.spread(p, l, n) * norm(lengths);
        }
        (WIDER * new, WIDER * old)
    }

    /// `|B' l|` of a part.
    fn spread(&self, p: usize, l: &[f64], n: usize) -> f64 {
        let reach = &self.frame.reach[p * n * n..(p + 1) * n * n];
        norm((0..n).map(|j| (0..n).map(|i| l[i] * reach[i * n + j]).sum::<f64>()))
    }

    /// The largest `l'(H - C) q / (||l|| r(q) + sum_p |B'l| ||W q||)` found over l in these rows and q without these columns, by
    /// turns: for one of both, `(sum_i a_i)^2 <= sum_i a_i^2 / t_i`, `t_i` the share of a_i before.
    fn largest(&self, without: &[usize], rows: &[usize]) -> Result<f64> {
        let (n, d) = (self.frame.n(), self.frame.width());
        let mut fixed = try_copy(WHAT, &self.absent)?;
        for j in without {
            fixed.resize(fixed.len() + d, 0.0);
            let last = fixed.len() - d;
            fixed[last + j] = 1.0 / self.frame.sizes[*j];
        }
        // q = D t, D the sizes of z, t orthogonal to what is fixed
        for row in fixed.chunks_exact_mut(d) {
            row.iter_mut().zip(&self.frame.sizes).for_each(|(v, size)| *v /= size);
            let length = norm(row.iter().copied());
            row.iter_mut().for_each(|v| *v /= length);
        }
        let basis = complement(&fixed, d)?;
        let free = basis.len() / d;
        if free == 0 || rows.is_empty() {
            return Ok(0.0);
        }
        let basis = try_collect(WHAT, basis.iter().enumerate().map(|(at, v)| v / self.frame.sizes[at / free]))?;
        let mut of_rows = try_zeros(WHAT, n * rows.len())?;
        for (at, to) in of_rows.iter_mut().enumerate() {
            *to = self.frame.root[rows[at % rows.len()] * n + at / rows.len()];
        }
        let mut best: f64 = 0.0;
        for start in 0..rows.len() {
            let mut l = try_collect(WHAT, (0..n).map(|i| of_rows[i * rows.len() + start]))?;
            let mut q = try_zeros(WHAT, d)?;
            let mut shares: Option<Vec<f64>> = None;
            for _ in 0..ROUNDS {
                let aim = try_collect(WHAT, (0..d).map(|j| (0..n).map(|i| l[i] * self.off[i * d + j]).sum::<f64>()))?;
                let weights = try_collect(
                    WHAT,
                    (0..self.own.len() + 1).map(|p| {
                        let size = if p == 0 { norm(l.iter().copied()) } else { self.spread(p - 1, &l, n) };
                        size * size / shares.as_ref().map_or(1.0, |shares| shares[p])
                    }),
                )?;
                let k = self.smallest_form(&q).unwrap_or(0);
                let mut form = try_zeros::<f64>(WHAT, d * d)?;
                for (square, weight) in [&self.squares[k]].into_iter().chain(&self.own).zip(&weights) {
                    form.iter_mut().zip(square).for_each(|(to, v)| *to += weight * v);
                }
                let Some(found) = least(&form, &basis, d, &aim)? else { break };
                q = found;
                shares = self.shares(&l, &q)?;
                let aim = try_collect(WHAT, self.off.chunks_exact(d).map(|row| dot(row, &q)))?;
                let Some(own) = shares.as_ref() else { break };
                let mut form = try_zeros::<f64>(WHAT, n * n)?;
                let (r, lengths) = self.lengths(&q)?;
                form.iter_mut().step_by(n + 1).for_each(|v| *v = r * r / own[0]);
                for (p, length) in lengths.iter().enumerate() {
                    let reach = &self.frame.reach[p * n * n..(p + 1) * n * n];
                    for (at, to) in form.iter_mut().enumerate() {
                        let (a, b) = (&reach[at / n * n..][..n], &reach[at % n * n..][..n]);
                        *to += length * length / own[p + 1] * dot(a, b);
                    }
                }
                let Some(found) = least(&form, &of_rows, n, &aim)? else { break };
                l = found;
                shares = self.shares(&l, &q)?;
                let (new, old) = self.radii(&l, &q);
                let ratio = self.along(&l, &q) / (new + old);
                if ratio.is_finite() {
                    best = best.max(ratio);
                }
            }
        }
        Ok(best)
    }

    /// Which mixture is best along q; None for q = 0.
    fn smallest_form(&self, q: &[f64]) -> Option<usize> {
        let size = |k: usize| norm(self.forms[k].chunks_exact(q.len()).map(|row| dot(row, q)));
        let found = (0..self.forms.len()).min_by(|a, b| size(*a).total_cmp(&size(*b)));
        found.filter(|k| size(*k) > 0.0)
    }

    /// `r(q)`, and the length of q in each part.
    fn lengths(&self, q: &[f64]) -> Result<(f64, Vec<f64>)> {
        let d = q.len();
        let r = self.forms.iter().map(|form| norm(form.chunks_exact(d).map(|row| dot(row, q))));
        let own = self.frame.begins.windows(2).map(|ends| {
            norm(self.frame.white[ends[0] * d..ends[1] * d].chunks_exact(d).map(|row| dot(row, q)))
        });
        Ok((r.fold(f64::INFINITY, f64::min), try_collect(WHAT, own)?))
    }

    /// The shares of the terms of the bound, none of them 0.
    fn shares(&self, l: &[f64], q: &[f64]) -> Result<Option<Vec<f64>>> {
        let (r, lengths) = self.lengths(q)?;
        let first = norm(l.iter().copied()) * r;
        let parts = lengths.iter().enumerate().map(|(p, length)| self.spread(p, l, l.len()) * length);
        let mut shares = try_collect(WHAT, [first].into_iter().chain(parts))?;
        let sum: f64 = shares.iter().sum();
        shares.iter_mut().for_each(|v| *v = (*v / sum).max(1e-6));
        Ok((sum > 0.0 && sum.is_finite()).then_some(shares))
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `A'A` (d, d).
fn gram(a: &[f64], d: usize) -> Result<Vec<f64>> {
    let mut found = try_zeros::<f64>(WHAT, checked_len(WHAT, d, d)?)?;
    for row in a.chunks_exact(d) {
        for (to, v) in found.chunks_exact_mut(d).zip(row) {
            to.iter_mut().zip(row).for_each(|(to, w)| *to += v * w);
        }
    }
    Ok(found)
}

/// A basis (d, free) of what is orthogonal to these rows of length 1.
fn complement(rows: &[f64], d: usize) -> Result<Vec<f64>> {
    let count = rows.len() / d;
    let mut padded = try_zeros(WHAT, d * d.max(count))?;
    padded[..rows.len()].copy_from_slice(rows);
    let found = singular(&padded, d.max(count), d)?;
    Ok(null_space(&found.v, &found.s, d, 1e-9)?.1)
}

/// `x = B t` with the largest `aim'x` for `x' form x` = 1, but for its length: `t = (B' form B)^-1 B' aim`; B (rows, any).
fn least(form: &[f64], basis: &[f64], rows: usize, aim: &[f64]) -> Result<Option<Vec<f64>>> {
    let free = basis.len() / rows;
    let column = |k: usize| basis.iter().copied().skip(k).step_by(free);
    let mut inner = try_zeros::<f64>(WHAT, free * free)?;
    let mut image = try_zeros::<f64>(WHAT, rows)?;
    for k in 0..free {
        for (to, row) in image.iter_mut().zip(form.chunks_exact(rows)) {
            *to = row.iter().zip(column(k)).map(|(a, b)| a * b).sum();
        }
        for i in 0..free {
            inner[i * free + k] = column(i).zip(&image).map(|(a, b)| a * b).sum();
        }
    }
    inner.iter_mut().step_by(free + 1).for_each(|v| *v *= 1.0 + 1e-12);
    let Some(root) = cholesky(&inner, free)? else { return Ok(None) };
    let mut t = try_collect(WHAT, (0..free).map(|k| column(k).zip(aim).map(|(a, b)| a * b).sum::<f64>()))?;
    for i in 0..free {
        t[i] = (t[i] - dot(&root[i * free..i * free + i], &t[..i])) / root[i * (free + 1)];
    }
    for i in (0..free).rev() {
        let done: f64 = (i + 1..free).map(|k| root[k * free + i] * t[k]).sum();
        t[i] = (t[i] - done) / root[i * (free + 1)];
    }
    let found = try_collect(WHAT, basis.chunks_exact(free).map(|row| dot(row, &t)))?;
    let size = norm(found.iter().copied());
    Ok((size > 0.0 && size.is_finite()).then(|| found.iter().map(|v| v / size)).map(|v| try_collect(WHAT, v)).transpose()?)
}
