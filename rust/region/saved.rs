//! Regions in files. That the true system is in one is a statement of who saved it; that it is a set is checked.

use std::sync::Arc;

use super::models::Region;
use super::part::{Part, PartOf, WHAT};
use crate::error::Result;
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_collect, try_push};
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
        self.parts.iter().enumerate().try_for_each(|(k, part)| put_part(part, k, to))
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
        let region = Self::new(MatrixView::of(&centre, d), m, parts, frobenius.first().copied(), future == 1)?;
        region.with_noise((!noise.is_empty()).then_some(noise))
    }
}

fn put_part(of: &Part, k: usize, to: &mut Sections) -> Result<()> {
    require_set(of, k)?;
    for (name, places) in [("rows", &of.rows), ("columns", &of.columns)] {
        let places = try_collect(WHAT, places.iter().map(|at| *at as u64))?;
        to.put_u64(format!("part{k}.{name}"), &places)?;
    }
    for (name, values) in [("white", &of.white), ("root", &of.root), ("missing", &of.missing), ("shape", &of.shape)] {
        to.put_f64(format!("part{k}.{name}"), values)?;
    }
    to.put_f64(format!("part{k}.sizes"), &[of.ratio, of.factor])
}

fn take_part(k: usize, from: &mut Sections) -> Result<Part> {
    let mut places = |name: &str| {
        let found = from.take_u64(&format!("part{k}.{name}"), None)?;
        try_collect(WHAT, found.into_iter().map(|at| usize::try_from(at).unwrap_or(usize::MAX)))
    };
    let (rows, columns) = (places("rows")?, places("columns")?);
    let mut values = |name: &str| from.take_reals(&format!("part{k}.{name}"), None);
    let (white, root, missing, shape) = (values("white")?, values("root")?, values("missing")?, values("shape")?);
    let sizes = from.take_reals(&format!("part{k}.sizes"), Some(2))?;
    let (n, d, rows, columns) = (rows.len(), columns.len(), &rows[..], &columns[..]);
    let of = |values, rows: usize| MatrixView::new(values, rows, d);
    let lines = |values: &[f64]| values.len().checked_div(d).unwrap_or(0);
    let (white, root, shape) = (of(&white, lines(&white))?, of(&root, lines(&root))?, MatrixView::new(&shape, n, n)?);
    let across = MatrixView::new(&missing, d, lines(&missing))?;
    let (ratio, factor, missing) = (sizes[0], sizes[1], Some(across));
    let part = Part::new(PartOf { rows, columns, white, root, missing, ratio, shape, factor })?;
    require_set(&part, k)?;
    Ok(part)
}

/// Refuses matrices that describe no set, or not the same one.
fn require_set(of: &Part, k: usize) -> Result<()> {
    let wrong = |expected| Err(damaged(expected, format!("others in part {k}")));
    if ![&of.rows, &of.columns].iter().all(|places| places.is_sorted_by(|a, b| a < b)) {
        return wrong("a region with rising rows and columns");
    }
    if ![&of.white, &of.root, &of.missing].iter().all(|values| values.iter().all(|v| v.is_finite())) {
        return wrong("a region of finite numbers");
    }
    if !(0.0..=1.0).contains(&of.ratio) {
        return wrong("a region with ratios from 0 to 1");
    }
    let (n, width) = (of.rows.len(), of.columns.len().max(1));
    let diagonal = |i: usize| of.shape[i * n + i];
    let fits = |i: usize, j: usize| {
        let size = (diagonal(i) * diagonal(j)).sqrt();
        let (a, b) = (of.shape[i * n + j], of.shape[j * n + i]);
        a.abs() <= size * (1.0 + TOLERANCE) && (a - b).abs() <= size * TOLERANCE
    };
    let is_weight = (0..n).all(|i| diagonal(i) >= 0.0 && (0..i).all(|j| fits(i, j)));
    let inverse = of.white.chunks_exact(width).enumerate().all(|(i, w)| {
        of.root.chunks_exact(width).enumerate().all(|(j, r)| {
            let terms = || w.iter().zip(r).map(|(a, b)| a * b);
            let off = terms().sum::<f64>() - f64::from(u8::from(i == j));
            off.abs() <= TOLERANCE * terms().map(f64::abs).sum::<f64>().max(1.0)
        })
    });
    if (of.factor.is_finite() && !is_weight) || !inverse || of.white.len() != of.root.len() {
        return wrong("a region with parts that are sets");
    }
    Ok(())
}
