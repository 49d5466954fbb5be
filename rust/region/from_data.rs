//! Regions from data: the factor of each part, in one event.

use std::sync::Arc;

use crate::control::singular;
use crate::error::{Error, Result};
use crate::identify::{
    Assumed, By, Covariance, Estimate, Fitted, Magnitudes, Measured, Noise, Radius, Wish, adaptive, independent,
    lengths, level, null_space,
};
use crate::memory::{try_collect, try_copy, try_extend, try_push, try_room, try_zeros};
use crate::parallel::Stop;

use super::models::Region;
use super::part::{Part, WHAT};

impl Region {
    /// The models that contain the true one with probability `1 - wish.delta`, around the `estimate`; the `units` of
    /// states, inputs (and 1) count where no exact law holds.
    ///
    /// # Errors
    /// [`Error::Value`] for a `delta` outside (0, 1), or directions or noise to come where no exact law holds;
    /// [`Error::Shape`], [`Error::Overflow`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn from_data(
        estimate: &Estimate,
        assumed: Assumed<'_>,
        wish: Wish<'_>,
        units: Magnitudes<'_>,
        threads: usize,
        stop: &Stop,
    ) -> Result<Self> {
        let (n, d, by) = (estimate.n, estimate.d, By { threads, stop });
        level("delta", wish.delta)?;
        let by_rows = wish.components && estimate.blocks.len() == 1;
        let (rows, first_rows);
        let blocks = if by_rows {
            rows = estimate.least_squares(true, stop)?;
            &rows
        } else {
            &estimate.blocks
        };
        let firsts = match units {
            Magnitudes::First(first) if by_rows && !assumed.exact() => {
                first_rows = first.least_squares(true, stop)?;
                &first_rows
            }
            Magnitudes::First(first) => &first.blocks,
            Magnitudes::Expected(_) => blocks,
        };
        if assumed.noise != Noise::Gaussian && !matches!(assumed.covariance, Covariance::Known(_)) {
            let found = "an unknown one".into();
            return Err(Error::Value { name: "covariance", expected: "known for noise that is not Gaussian", found });
        }
        let exact_law = assumed.exact() && estimate.blocks.len() == 1 && !wish.components;
        if !exact_law && (wish.directions.is_some() || wish.future > 0) {
            let (name, found) = (if wish.future > 0 { "future" } else { "directions" }, "another one".into());
            let expected = "for one region of all rows, Gaussian noise and an independent design";
            return Err(Error::Value { name, expected, found });
        }
        let sized = match units {
            Magnitudes::Expected(scale) => scale.len(),
            Magnitudes::First(first) if first.n == n && firsts.len() == blocks.len() => first.d,
            Magnitudes::First(_) => 0,
        };
        if sized != d || wish.directions.is_some_and(|q| q.is_empty() || !q.len().is_multiple_of(d)) {
            let found = sized.to_string();
            return Err(Error::Shape { name: "units", expected: format!("{d} entries, as rows of directions"), found });
        }
        if let Covariance::Known(known) = assumed.covariance
            && known.len() != n * n
        {
            let found = known.len().to_string();
            return Err(Error::Shape { name: "covariance", expected: format!("{n} x {n} entries"), found });
        }
        let mut parts = try_room(WHAT, blocks.len())?;
        let (mut frobenius, mut noise) = (None, None);
        for (f, first) in blocks.iter().zip(firsts) {
            let (delta, count) = (shared(f, assumed, wish, n), f.rows.len());
            let known = known_of(f, assumed.covariance, n)?;
            let covariance = known.as_deref().map_or(assumed.covariance, Covariance::Known);
            let (missing, radius) = if assumed.exact() {
                let (rank, missing) = directed(f, wish.directions, d)?;
                let columns = rank + wish.future;
                if wish.frobenius && covariance == Covariance::Full && count == n {
                    let (spectral, joint) = by.joint(n, columns, f.degrees(), delta)?;
                    frobenius = Some(joint);
                    parts.push(Arc::new(Part::within(f, &missing, &f.residual, spectral.powi(2))?));
                    continue;
                }
                (missing, independent(f, covariance, columns, delta, by)?)
            } else {
                let measured = || {
                    let Magnitudes::Expected(scale) = units else { return Measured::first(f, first) };
                    let of = |places: &[usize]| try_collect(WHAT, places.iter().map(|&j| scale[j]));
                    Measured::expected(f, &of(&f.columns)?, of(&f.rows)?).map(Some)
                };
                let assumed = Assumed { covariance, ..assumed };
                (try_copy(WHAT, &f.missing)?, adaptive(f, assumed, wish, measured, delta, by)?)
            };
            let Radius { factor, shape, noise: own } = radius;
            parts.push(Arc::new(Part::within(f, &missing, &shape, factor)?));
            if blocks.len() == 1 {
                noise = own;
                if wish.frobenius {
                    frobenius = Some((factor * count.min(f.rank() + wish.future) as f64).sqrt());
                }
            }
        }
        if let Covariance::Known(known) = assumed.covariance {
            noise = Some(try_copy(WHAT, known)?);
        }
        let region = Self::new(estimate.theta(), estimate.m, parts, frobenius, wish.future > 0)?;
        region.with_noise(noise)
    }
}

/// The share of delta for a block. One row each: together by the union, or independent of each other.
fn shared(f: &Fitted, assumed: Assumed<'_>, wish: Wish<'_>, n: usize) -> f64 {
    if f.rows.len() == n {
        return wish.delta;
    }
    let apart = matches!(assumed.covariance, Covariance::Diagonal | Covariance::Scalar);
    if apart && assumed.exact() && wish.components && !f.columns.is_empty() {
        -((-wish.delta).ln_1p() / n as f64).exp_m1() // 1 - (1 - delta)^(1/n)
    } else {
        wish.delta / n as f64
    }
}

/// The known covariance of the rows of a block.
fn known_of(f: &Fitted, covariance: Covariance<'_>, n: usize) -> Result<Option<Vec<f64>>> {
    let Covariance::Known(known) = covariance else { return Ok(None) };
    let entries = f.rows.iter().flat_map(|i| f.rows.iter().map(move |j| known[i * n + j]));
    let mut found = try_room(WHAT, f.rows.len() * f.rows.len())?;
    try_extend(WHAT, &mut found, entries)?;
    Ok(Some(found))
}

/// Rank and missing directions for z in the span of `q` (rows, r) alone: there only as many columns of G count.
///
/// In units in which the columns of the data have length 1, as for their own rank.
fn directed(f: &Fitted, q: Option<&[f64]>, rows: usize) -> Result<(usize, Vec<f64>)> {
    let (d, rank) = (f.columns.len(), f.rank());
    let Some(q) = q.filter(|_| d > 0) else { return Ok((rank, try_copy(WHAT, &f.missing)?)) };
    let (sizes, r) = (f.lengths()?, q.len() / rows);
    let width = r.max(d); // with columns of 0 there are d left vectors
    let mut scaled = try_zeros(WHAT, d * width)?;
    for (i, row) in scaled.chunks_exact_mut(width).enumerate() {
        let at = f.columns[i] * r;
        row.iter_mut().zip(&q[at..at + r]).for_each(|(to, v)| *to = v / sizes[i]);
    }
    let units = lengths(&scaled, width, width)?;
    scaled.iter_mut().enumerate().for_each(|(at, v)| *v /= units[at % width]);
    let span = singular(&scaled, d, width)?;
    let (inside, off) = null_space(&span.u, &span.s, d, d.max(r) as f64 * f64::EPSILON)?;
    // white D with rows of length 1 is orthonormal: cosines decide, not sizes
    let mut cosines = try_room(WHAT, rank * inside)?;
    for row in f.white.chunks_exact(d) {
        let row = || row.iter().zip(&sizes).map(|(v, size)| v * size);
        let length = crate::fuse::norm(row());
        for u in span.u.chunks_exact(d).take(inside) {
            try_push(WHAT, &mut cosines, row().zip(u).map(|(a, b)| a / length * b).sum::<f64>())?;
        }
    }
    let s = singular(&cosines, rank, inside)?.s;
    let least = s.first().map_or(0.0, |s| s * rank.max(inside) as f64 * f64::EPSILON);
    let seen = s.iter().filter(|s| **s > least).count();
    let (hidden, missing) = (d - inside, d - rank);
    let mut all = try_room(WHAT, d * (hidden + missing))?;
    for i in 0..d {
        all.extend(off[i * hidden..(i + 1) * hidden].iter().map(|v| v / sizes[i]));
        all.extend_from_slice(&f.missing[i * missing..(i + 1) * missing]);
    }
    Ok((seen, all))
}
