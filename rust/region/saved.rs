//! Regions in files. That the true system is in one is a statement of who saved it; that it is a set is checked.

use std::sync::Arc;

use super::models::Region;
use super::part::{Part, PartOf, WHAT};
use crate::error::Result;
use crate::memory::{checked_len, try_collect_all, try_push};
use crate::parallel::Stop;
use crate::storage::{Saved, Sections, damaged};

const FORMAT: u64 = 1;
/// Of `white root' = I` and of the symmetry of S, relative to what is added up.
const TOLERANCE: f64 = 1e-6;

impl Saved for Region {
    const KIND: &'static str = "core.region";

    fn put(&self, to: &mut Sections) -> Result<()> {
        let (n, m, d) = (self.n as u64, self.m as u64, self.d as u64);
        to.put_u64("region", &[FORMAT, n, m, d, self.parts.len() as u64, u64::from(self.future)])?;
        to.put_f64("centre", &self.centre)?;
        to.put_f64("frobenius", self.frobenius.as_slice())?;
        to.put_f64("noise", self.noise().unwrap_or_default())?;
        self.parts.iter().enumerate().try_for_each(|(k, part)| put_part(part.of(), k, to))
    }

    fn take(from: &mut Sections, _: &Stop) -> Result<Self> {
        let [n, m, d, count, future] = from.take_sizes("region", FORMAT)?;
        let centre = from.take_f64("centre", Some(checked_len(WHAT, n, d)?))?;
        let (frobenius, noise) = (from.take_reals("frobenius", None)?, from.take_reals("noise", None)?);
        let sized = frobenius.len() <= 1 && [0, n.saturating_mul(n)].contains(&noise.len());
        if !sized || frobenius.iter().any(|size| size.is_nan() || *size < 0.0) || noise.iter().any(|v| v.is_nan()) {
            return Err(damaged("a state with bounds of its region and noise", "others".into()));
        }
        let mut parts = Vec::new();
        for k in 0..count {
            try_push(WHAT, &mut parts, Arc::new(take_part(k, from)?))?;
        }
        let region = Self::new(&centre, n, m, parts, frobenius.first().copied(), future == 1)?;
        Ok(region.with_noise((!noise.is_empty()).then_some(noise)))
    }
}

fn put_part(of: PartOf<'_>, k: usize, to: &mut Sections) -> Result<()> {
    for (name, places) in [("rows", of.rows), ("columns", of.columns)] {
        let places = try_collect_all(WHAT, places.iter().map(|at| Ok(*at as u64)))?;
        to.put_u64(format!("part{k}.{name}"), &places)?;
    }
    for (name, values) in [("white", of.white), ("root", of.root), ("missing", of.missing), ("shape", of.shape)] {
        to.put_f64(format!("part{k}.{name}"), values)?;
    }
    to.put_f64(format!("part{k}.sizes"), &[of.ratio, of.factor])
}

/// A part whose matrices describe a set, and the same one.
fn take_part(k: usize, from: &mut Sections) -> Result<Part> {
    let wrong = |expected| damaged(expected, format!("others in part {k}"));
    let mut places = |name: &str| {
        let found = from.take_u64(&format!("part{k}.{name}"), None)?;
        if !found.is_sorted_by(|a, b| a < b) {
            return Err(wrong("a state with rising rows and columns"));
        }
        let place = |at: u64| usize::try_from(at).map_err(|_| wrong("a state with rows and columns of its model"));
        try_collect_all(WHAT, found.into_iter().map(place))
    };
    let (rows, columns) = (places("rows")?, places("columns")?);
    let mut values = |name: &str| from.take_f64(&format!("part{k}.{name}"), None);
    let (white, root, missing) = (values("white")?, values("root")?, values("missing")?);
    let shape = from.take_reals(&format!("part{k}.shape"), Some(checked_len(WHAT, rows.len(), rows.len())?))?;
    let sizes = from.take_reals(&format!("part{k}.sizes"), Some(2))?;
    let of = PartOf {
        rows: &rows,
        columns: &columns,
        white: &white,
        root: &root,
        missing: &missing,
        ratio: sizes[0],
        shape: &shape,
        factor: sizes[1],
    };
    let part = Part::new(of)?;
    let (n, width) = (rows.len(), columns.len().max(1));
    let diagonal = |i: usize| shape[i * n + i];
    let fits = |(i, j): (usize, usize)| {
        let size = (diagonal(i) * diagonal(j)).sqrt();
        let (a, b) = (shape[i * n + j], shape[j * n + i]);
        a.abs() <= size * (1.0 + TOLERANCE) && (a - b).abs() <= size * TOLERANCE
    };
    let is_weight = (0..n).all(|i| diagonal(i) >= 0.0 && (0..i).all(|j| fits((i, j))));
    let inverse = white.chunks_exact(width).enumerate().all(|(i, w)| {
        root.chunks_exact(width).enumerate().all(|(j, r)| {
            let terms = || w.iter().zip(r).map(|(a, b)| a * b);
            let off = terms().sum::<f64>() - f64::from(u8::from(i == j));
            off.abs() <= TOLERANCE * terms().map(f64::abs).sum::<f64>().max(1.0)
        })
    });
    if (of.factor.is_finite() && !is_weight) || !inverse || white.len() != root.len() {
        return Err(wrong("a state with parts that are sets"));
    }
    if (0.0..=1.0).contains(&of.ratio) { Ok(part) } else { Err(wrong("a state with ratios from 0 to 1")) }
}
