//! A region in the units of its noise: what all bets and the fresh set are measured in.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{covariance_root, spectral_norm};
use crate::memory::{checked_len, try_collect, try_copy, try_push, try_room, try_zeros};
use crate::region::{Part, Region};

pub(super) const WHAT: &str = "a watch";
/// Of the variance of a row: what the other rows must leave of it, or it is a combination of them.
const LEFT: f64 = 1e-10;
/// Of the size of a row: a smaller deviation is rounding.
const ROUNDING: f64 = 1e-13;
/// What is taken for a bound is larger by this: the rounding of what it is compared with.
pub(super) const WIDER: f64 = 1.0 + 1e-9;

/// `e = L^-1 (y - C z)` of the rows that have noise of their own, `Sbar = L L'`.
#[derive(Debug, Clone)]
pub struct Frame {
    /// The rows that are watched, in the order of y.
    pub rows: Vec<usize>,
    /// C of these rows (n, d).
    pub centre: Vec<f64>,
    /// L (n, n), lower.
    pub root: Vec<f64>,
    /// `L^-1` (n, n), lower.
    pub back: Vec<f64>,
    /// W of all parts, one below the other (any, d): `||W z||` of a part is its length.
    pub white: Vec<f64>,
    /// Where the rows of each part begin, and the end.
    pub begins: Vec<usize>,
    /// `B = L^-1 S_r^(1/2)` of each part (parts, n, n).
    pub reach: Vec<f64>,
    /// `||B||` of each part, enlarged by its rounding.
    pub norms: Vec<f64>,
    /// `P^(-1/2)` (own, d), P the mean of z z' in the data.
    pub scaled: Vec<f64>,
    /// `P^(1/2)'` (own, d): `scaled unscaled' = I`.
    pub unscaled: Vec<f64>,
    /// The root mean squares (d) of z in the data.
    pub sizes: Vec<f64>,
    parts: Vec<Arc<Part>>,
}

impl Frame {
    /// Of a region of `pairs` pairs with this bound (n, n) of the covariance of the noise.
    ///
    /// # Errors
    /// [`Error::Value`] for a region that is unbounded, or without noise; [`Error::Shape`], [`Error::Memory`].
    pub fn new(region: &Region, noise: &[f64], pairs: usize) -> Result<Self> {
        let (all, d) = (region.centre().len() / region.width(), region.width());
        if noise.len() != all * all || noise.iter().any(|v| !v.is_finite()) {
            let found = noise.len().to_string();
            return Err(Error::Shape { name: "noise", expected: format!("{all} x {all} finite entries"), found });
        }
        if !region.radius().is_finite() {
            return Err(Error::Value { name: "region", expected: "bounded", found: "one of infinite radius".into() });
        }
        let (mut begins, mut white) = (try_zeros::<usize>(WHAT, 1)?, Vec::new());
        let (mut sizes, pairs) = (try_zeros::<f64>(WHAT, d)?, pairs.max(1) as f64);
        for part in region.parts() {
            let (of, width) = (part.of(), part.columns.len().max(1));
            for row in of.white.chunks_exact(width) {
                let mut wide = try_zeros(WHAT, d)?;
                of.columns.iter().zip(row).for_each(|(j, v)| wide[*j] = *v);
                white.extend_from_slice(&wide);
            }
            for (at, j) in of.columns.iter().enumerate() {
                let own = norm(of.root.iter().copied().skip(at).step_by(width)) / pairs.sqrt();
                sizes[*j] = own.max(sizes[*j]);
            }
            try_push(WHAT, &mut begins, white.len() / d)?;
        }
        sizes.iter_mut().filter(|size| **size == 0.0).for_each(|size| *size = 1.0);
        let (rows, root, back) = factored(region, noise, &sizes)?;
        let n = rows.len();
        let (mut centre, mut reach) = (try_room(WHAT, n * d)?, try_room(WHAT, region.parts().len() * n * n)?);
        rows.iter().for_each(|i| centre.extend_from_slice(&region.centre()[i * d..(i + 1) * d]));
        let mut norms = try_room(WHAT, region.parts().len())?;
        for part in region.parts() {
            let (of, mut shape) = (part.of(), try_zeros(WHAT, checked_len(WHAT, n, n)?)?);
            let place = |i: usize| of.rows.iter().position(|row| *row == rows[i]);
            for (at, to) in shape.iter_mut().enumerate() {
                if let (Some(i), Some(j)) = (place(at / n), place(at % n)) {
                    *to = of.factor * of.shape[i * of.rows.len() + j];
                }
            }
            let own = covariance_root(&shape, n)?;
            let mut product = try_zeros::<f64>(WHAT, n * n)?;
            for (at, to) in product.iter_mut().enumerate() {
                *to = (0..=at / n).map(|k| back[at / n * n + k] * own[k * n + at % n]).sum();
            }
            norms.push(WIDER * spectral_norm(&product, n, n)?);
            reach.extend_from_slice(&product);
        }
        let parts = try_collect(WHAT, region.parts().iter().cloned())?;
        let whole = parts.len() == 1 && begins[1] == d && parts[0].of().root.len() == d * d;
        let square = checked_len(WHAT, d, d)?;
        let [mut scaled, mut unscaled] = [try_zeros(WHAT, square)?, try_zeros(WHAT, square)?];
        for (j, size) in sizes.iter().enumerate() {
            (scaled[j * (d + 1)], unscaled[j * (d + 1)]) = (1.0 / size, *size);
        }
        if whole {
            let of = parts[0].of();
            scaled.iter_mut().zip(&white).for_each(|(to, v)| *to = pairs.sqrt() * v);
            unscaled.iter_mut().zip(of.root).for_each(|(to, v)| *to = v / pairs.sqrt());
        }
        Ok(Self { rows, centre, root, back, white, begins, reach, norms, scaled, unscaled, sizes, parts })
    }

    /// The number of rows that are watched.
    #[must_use]
    pub fn n(&self) -> usize {
        self.rows.len()
    }

    /// The number of entries of z.
    #[must_use]
    pub fn width(&self) -> usize {
        self.sizes.len()
    }

    /// The number of parts of the region.
    #[must_use]
    pub fn count(&self) -> usize {
        self.norms.len()
    }

    /// `e` (n) and `W z` (any), and the lengths (parts) of z; false where a number is not finite, or z has a part in a direction
    /// that the data do not determine.
    pub fn residual(&self, z: &[f64], y: &[f64], e: &mut [f64], wz: &mut [f64], lengths: &mut [f64]) -> bool {
        let (n, d) = (self.n(), self.width());
        for (to, row) in wz.iter_mut().zip(self.white.chunks_exact(d)) {
            *to = row.iter().zip(z).map(|(a, b)| a * b).sum();
        }
        for (p, to) in lengths.iter_mut().enumerate() {
            *to = if self.parts[p].length(z).is_finite() {
                wz[self.begins[p]..self.begins[p + 1]].iter().map(|v| v * v).sum::<f64>().sqrt() * WIDER
            } else {
                f64::INFINITY
            };
        }
        for (to, i) in e.iter_mut().zip(&self.rows) {
            *to = y[*i];
        }
        for (to, row) in e.iter_mut().zip(self.centre.chunks_exact(d)) {
            *to -= row.iter().zip(z).map(|(a, b)| a * b).sum::<f64>();
        }
        for i in (0..n).rev() {
            e[i] = self.back[i * n..=i * n + i].iter().zip(&e[..=i]).map(|(a, b)| a * b).sum();
        }
        e.iter().chain(lengths.iter()).all(|v| v.abs() <= 1e140)
    }

    /// `|B' l|` of each part (parts) for a direction `l` (n) of e: `l' (Theta - C) z` is at most the sum of these times the
    /// lengths of z.
    pub fn spreads(&self, l: &[f64], to: &mut [f64]) {
        let n = self.n();
        for (to, reach) in to.iter_mut().zip(self.reach.chunks_exact(n * n)) {
            let square = (0..n).map(|j| l.iter().enumerate().map(|(i, v)| v * reach[i * n + j]).sum::<f64>().powi(2));
            *to = WIDER * square.sum::<f64>().sqrt();
        }
    }
}

/// The rows with noise of their own, `L` and `L^-1` of them.
fn factored(region: &Region, noise: &[f64], sizes: &[f64]) -> Result<(Vec<usize>, Vec<f64>, Vec<f64>)> {
    let (all, d) = (region.centre().len() / sizes.len(), sizes.len());
    let mut rows: Vec<usize> = try_room(WHAT, all)?;
    let mut known = try_zeros(WHAT, all * all)?; // rows of L, of width `all`
    for i in 0..all {
        let at = rows.len();
        for j in 0..at {
            let done: f64 = (0..j).map(|k| known[at * all + k] * known[j * all + k]).sum();
            known[at * all + j] = (noise[i * all + rows[j]] - done) / known[j * all + j];
        }
        let own = noise[i * (all + 1)];
        let left = own - known[at * all..at * all + at].iter().map(|v| v * v).sum::<f64>();
        let size = region.centre()[i * d..(i + 1) * d].iter().zip(sizes).map(|(c, size)| (c * size).abs()).sum::<f64>();
        if left > LEFT * own && left.sqrt() > ROUNDING * size {
            known[at * (all + 1)] = left.sqrt();
            rows.push(i);
        }
    }
    if rows.is_empty() {
        return Err(Error::Value { name: "noise", expected: "of some row above rounding", found: "none".into() });
    }
    let n = rows.len();
    let (mut root, mut back) = (try_copy(WHAT, &known[..0])?, try_zeros::<f64>(WHAT, n * n)?);
    for row in known.chunks_exact(all).take(n) {
        root.extend_from_slice(&row[..n]);
    }
    for j in 0..n {
        for i in j..n {
            let done: f64 = (j..i).map(|k| root[i * n + k] * back[k * n + j]).sum();
            back[i * n + j] = (f64::from(u8::from(i == j)) - done) / root[i * (n + 1)];
        }
    }
    Ok((rows, root, back))
}
