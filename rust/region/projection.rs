//! The projection of a region on the plane of two coefficients.
//!
//! A part is `Theta - C = sqrt(factor) S^(1/2) W V^(-1/2)` with `||W|| <= 1`. In the direction
//! `G = cos(t) e_i e_j' + sin(t) e_k e_l'` it reaches as far as `sqrt(factor) ||S^(1/2) G V^(-1/2)||_*`, the dual of
//! the spectral norm. `G` has rank two, hence `||.||_*^2 = trace + 2 sqrt(det)` of a 2 by 2 matrix.

use std::f64::consts::PI;

use crate::error::Result;
use crate::memory::{try_room, try_zeros};

use super::models::Region;
use super::part::{Part, WHAT, times};

/// Directions of tangents; a multiple of 4, so that a box keeps its corners.
pub const DIRECTIONS: usize = 720;

impl Region {
    /// Corners ([`DIRECTIONS`], 2) around the projection of `Theta - C` on two entries (row, column); `None` if an
    /// entry is known or the projection is not bounded. The polygon is made of tangents, so it contains the projection.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn projection(&self, one: (usize, usize), other: (usize, usize)) -> Result<Option<Vec<f64>>> {
        let has =
            |entry: (usize, usize)| move |part: &&Part| part.rows.contains(&entry.0) && part.columns.contains(&entry.1);
        let [Some(first), Some(second)] =
            [one, other].map(|entry| self.parts.iter().map(AsRef::as_ref).find(has(entry)))
        else {
            return Ok(None);
        };
        let at = |part: &Part, (row, column): (usize, usize)| {
            let place = |all: &[usize], one| all.iter().position(|v| *v == one).unwrap_or_default();
            (place(&part.rows, row), place(&part.columns, column))
        };
        let ((i, j), (k, l)) = (at(first, one), at(second, other));
        // sqrt(factor S_ii) ||e_j||
        let sizes =
            [times(first.deviations()[i], first.unit_length(j)), times(second.deviations()[k], second.unit_length(l))];
        if !sizes.iter().all(|size| size.is_finite()) {
            return Ok(None);
        }
        let mut reach = try_zeros(WHAT, DIRECTIONS)?;
        let angle = |t: usize| (2.0 * PI * (t % DIRECTIONS) as f64 / DIRECTIONS as f64).sin_cos();
        if std::ptr::eq(first, second) {
            let (n, width) = (first.rows.len(), first.columns.len());
            let gram = |a: usize, b: usize| first.white.chunks_exact(width).map(|row| row[a] * row[b]).sum::<f64>();
            let s = |a: usize, b: usize| first.shape[a * n + b];
            let both = first.factor * s(i, k) * gram(j, l);
            let in_rows = s(i, i) * s(k, k) - s(i, k).powi(2);
            let in_columns = gram(j, j) * gram(l, l) - gram(j, l).powi(2);
            let root = first.factor * (in_rows.max(0.0) * in_columns.max(0.0)).sqrt();
            for (t, to) in reach.iter_mut().enumerate() {
                let (sin, cos) = angle(t);
                let trace = (cos * sizes[0]).powi(2) + 2.0 * cos * sin * both + (sin * sizes[1]).powi(2);
                *to = (trace + 2.0 * (cos * sin).abs() * root).max(0.0).sqrt();
            }
        } else {
            // rows of their own: each entry whatever the other one is
            for (t, to) in reach.iter_mut().enumerate() {
                let (sin, cos) = angle(t);
                *to = cos.abs() * sizes[0] + sin.abs() * sizes[1];
            }
        }
        // where the tangents of neighbouring directions meet
        let mut corners = try_room(WHAT, 2 * DIRECTIONS)?;
        let between = (2.0 * PI / DIRECTIONS as f64).sin();
        for (t, now) in reach.iter().enumerate() {
            let ((sin, cos), (sin1, cos1)) = (angle(t), angle(t + 1));
            let after = reach[(t + 1) % DIRECTIONS];
            corners.push((now * sin1 - after * sin) / between);
            corners.push((after * cos - now * cos1) / between);
        }
        Ok(Some(corners))
    }
}
