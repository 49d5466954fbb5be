//! A region in the units of its noise: what all bets and the fresh set are measured in.

use std::sync::Arc;

use faer::{MatMut, MatRef};

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{cholesky, covariance_root, spectral_norm, whiten};
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_collect, try_extend, try_push, try_zeros};
use crate::region::{Part, Region};
use crate::vector::{dot, norm as size};

pub(super) const WHAT: &str = "a watch";
/// What is taken for a bound is larger by this: the rounding of what it is compared with.
pub(super) const WIDER: f64 = 1.0 + 1e-9;
/// Noise of a row, in parts of its readings, and variance in parts of its own that other rows leave: below these,
/// rounding.
const ROUNDING: f64 = 1e-15;
const TIED: f64 = 1e-12;
/// Noise whose square has few digits.
const LEAST: f64 = 1e-140;

/// `e = L^-1 (y - C z)`, `Sbar = L L'`; plain arrays.
#[derive(Debug, Clone)]
pub struct Frame {
    /// The number of rows n that are watched, and of regressors d.
    pub sizes: (usize, usize),
    /// The number of readings, and which of them are watched: a row without noise of its own, by rounding, is not.
    pub outputs: usize,
    /// See `outputs`.
    pub rows: Vec<usize>,
    /// C (n, d).
    pub centre: Vec<f64>,
    /// L (n, n), lower.
    pub root: Vec<f64>,
    /// `L^-1` (n, n), lower.
    pub back: Vec<f64>,
    /// W of all parts, one below the other (any, d): `||W z||` of a part is its length.
    pub white: Vec<f64>,
    /// Where the rows of each part begin, and the end.
    pub begins: Vec<usize>,
    /// `B' = (L^-1 S_r^(1/2))'` of each part (parts, n, n), and `||B||`.
    pub reach: Vec<f64>,
    /// See `reach`.
    pub norms: Vec<f64>,
    /// `P^(-1/2)` (d, d), P the mean of z z' in the data, or its diagonal.
    pub scaled: Vec<f64>,
    /// `P^(1/2)'` (d, d): `scaled unscaled' = I`.
    pub unscaled: Vec<f64>,
    /// The root mean squares (d) of z in the data.
    pub scale: Vec<f64>,
    pub(super) parts: Vec<Arc<Part>>,
    /// How many pairs the region is from.
    pub(super) pairs: f64,
}

impl Frame {
    /// Of a region of `pairs` pairs with this bound (n, n) of the covariance of the noise.
    ///
    /// # Errors
    /// [`Error::Value`] for a region that is unbounded, or noise that is rounding in all rows; [`Error::Memory`].
    pub fn new<'a>(region: &Region, noise: impl Into<MatrixView<'a>>, pairs: usize) -> Result<Self> {
        let (d, pairs) = (region.width(), pairs.max(1) as f64);
        let outputs = region.centre().len() / d;
        let (square, noise) = (checked_len(WHAT, d, d)?, noise.into().sized("noise", outputs, outputs)?);
        let wrong = |name, expected, found: &str| Error::Value { name, expected, found: found.into() };
        if !region.radius().is_finite() {
            return Err(wrong("region", "bounded", "another one"));
        }
        let mut scale = try_zeros::<f64>(WHAT, d)?;
        for part in region.parts() {
            let (of, width) = (part, part.columns.len().max(1));
            for (at, j) in of.columns.iter().enumerate() {
                scale[*j] = scale[*j].max(norm(of.root.iter().copied().skip(at).step_by(width)) / pairs.sqrt());
            }
        }
        let readings = |row: &[f64]| row.iter().zip(&scale).map(|(c, size)| (c * size).abs()).sum::<f64>();
        let sizes = try_collect(WHAT, region.centre().chunks_exact(d).map(readings))?;
        let rows = watched(&noise, &sizes)?;
        let n = rows.len();
        let own = checked_len(WHAT, n, n)?;
        let noise = try_collect(WHAT, (0..own).map(|at| noise[rows[at / n] * outputs + rows[at % n]]))?;
        let root = if n > 0 { cholesky(&noise, n)? } else { None };
        let root = root.ok_or_else(|| wrong("noise", "a bound above rounding for a reading", "none"))?;
        let mut back = try_zeros::<f64>(WHAT, own)?;
        back.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
        whiten(MatRef::from_row_major_slice(&root, n, n), MatMut::from_row_major_slice_mut(&mut back, n, n));
        let (mut begins, mut white) = (try_zeros(WHAT, 1)?, Vec::new());
        let (mut reach, mut norms) = (Vec::new(), Vec::new());
        for part in region.parts() {
            let (of, width) = (part, part.columns.len().max(1));
            for row in of.white.chunks_exact(width) {
                let mut wide = try_zeros(WHAT, d)?;
                of.columns.iter().zip(row).for_each(|(j, v)| wide[*j] = *v);
                try_extend(WHAT, &mut white, wide)?;
            }
            try_push(WHAT, &mut begins, white.len() / d)?;
            let mut shape = try_zeros(WHAT, own)?;
            for (at, v) in of.shape.iter().enumerate() {
                let place = |k: usize| rows.iter().position(|row| *row == of.rows[k]);
                if let (Some(i), Some(j)) = (place(at / of.rows.len()), place(at % of.rows.len())) {
                    shape[i * n + j] = of.factor * v;
                }
            }
            let half = covariance_root(&shape, n)?;
            let product = |at: usize| (0..n).map(|k| back[at % n * n + k] * half[k * n + at / n]).sum::<f64>();
            let turned = try_collect(WHAT, (0..own).map(product))?;
            try_push(WHAT, &mut norms, WIDER * spectral_norm(&turned, n, n)?)?;
            try_extend(WHAT, &mut reach, turned)?;
        }
        scale.iter_mut().filter(|v| **v == 0.0).for_each(|v| *v = 1.0);
        let [mut scaled, mut unscaled] = [try_zeros(WHAT, square)?, try_zeros(WHAT, square)?];
        scale.iter().enumerate().for_each(|(j, v)| (scaled[j * (d + 1)], unscaled[j * (d + 1)]) = (1.0 / v, *v));
        if let [part] = region.parts()
            && white.len() == square
            && part.root.len() == square
        {
            scaled.iter_mut().zip(&white).for_each(|(to, v)| *to = pairs.sqrt() * v);
            unscaled.iter_mut().zip(&part.root).for_each(|(to, v)| *to = v / pairs.sqrt());
        }
        let centre = try_collect(WHAT, (0..n * d).map(|at| region.centre()[rows[at / d] * d + at % d]))?;
        let (sizes, parts) = ((n, d), try_collect(WHAT, region.parts().iter().cloned())?);
        Ok(Self {
            sizes,
            outputs,
            rows,
            centre,
            root,
            back,
            white,
            begins,
            reach,
            norms,
            scaled,
            unscaled,
            scale,
            parts,
            pairs,
        })
    }

    /// `e` (n) and `W z` (any), and the lengths (parts) of z; false where a number is not finite, or z has a part in a
    /// direction that the data do not determine.
    pub fn residual(&self, z: &[f64], y: &[f64], e: &mut [f64], wz: &mut [f64], lengths: &mut [f64]) -> bool {
        let (n, d) = self.sizes;
        wz.iter_mut().zip(self.white.chunks_exact(d)).for_each(|(to, row)| *to = dot(row, z));
        for (p, to) in lengths.iter_mut().enumerate() {
            let known = self.parts[p].length(z).is_finite();
            *to = if known { WIDER * size(&wz[self.begins[p]..self.begins[p + 1]]) } else { f64::INFINITY };
        }
        for (i, row) in self.centre.chunks_exact(d).enumerate() {
            e[i] = y[self.rows[i]] - dot(row, z);
        }
        (0..n).rev().for_each(|i| e[i] = dot(&self.back[i * n..=i * n + i], &e[..=i]));
        e.iter().chain(lengths.iter()).chain(z).all(|v| v.abs() <= 1e140)
    }

    /// `L^-1 x`.
    pub(super) fn whitened(&self, x: impl Fn(usize) -> f64) -> Result<Vec<f64>> {
        let n = self.sizes.0;
        try_collect(WHAT, (0..n).map(|i| (0..=i).map(|k| self.back[i * n + k] * x(k)).sum::<f64>()))
    }

    /// `|B' l|` of a part: `l' (Theta - C) z` is at most the sum of these times the lengths of z.
    pub(super) fn spread(&self, part: usize, l: &[f64]) -> f64 {
        let own = l.len() * l.len();
        let rows = self.reach[part * own..(part + 1) * own].chunks_exact(l.len());
        WIDER * rows.map(|row| dot(row, l).powi(2)).sum::<f64>().sqrt()
    }
}

/// The rows with noise of their own: more than rounding of readings of these `sizes`, and of the rows before.
fn watched(noise: &[f64], sizes: &[f64]) -> Result<Vec<usize>> {
    let n = sizes.len();
    let (mut rows, mut own) = (Vec::new(), Vec::new()); // own: rows of the root, each n wide
    for i in (0..n).filter(|i| noise.len() == n * n && noise[i * (n + 1)].sqrt() > (ROUNDING * sizes[*i]).max(LEAST)) {
        let mut row = try_zeros::<f64>(WHAT, n)?;
        for (k, j) in rows.iter().enumerate() {
            let before: &[f64] = &own[k * n..(k + 1) * n];
            row[k] = (noise[i * n + j] - dot(&row[..k], &before[..k])) / before[k];
        }
        let left = noise[i * (n + 1)] - dot(&row, &row);
        if left > TIED * noise[i * (n + 1)] {
            row[rows.len()] = left.sqrt();
            try_push(WHAT, &mut rows, i)?;
            try_extend(WHAT, &mut own, row)?;
        }
    }
    Ok(rows)
}
