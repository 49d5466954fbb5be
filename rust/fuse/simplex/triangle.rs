//! The lower triangle of a symmetric matrix, in panels of rows.
//!
//! Row `i` is contiguous, from column 0 to the end of its diagonal block. It is filled by rows and factored by
//! row-major blocks, and half the memory of a full matrix is never touched.

use std::ops::Range;

use faer::{MatMut, MatRef};

use super::problem::SEARCH;
use crate::memory::{checked_len, try_collect_all, try_zeros};

/// Rows of one panel.
pub(crate) const PANEL: usize = 128;

/// Lower triangle of a matrix with `size` rows. Entries above the diagonal in a diagonal block are not used.
pub(crate) struct Triangle {
    panels: Vec<Vec<f64>>,
    size: usize,
}

impl Triangle {
    /// `None` if there is no memory for it.
    pub fn zeros(size: usize) -> Option<Self> {
        let panel = |p| {
            let rows = rows(size, p);
            try_zeros(SEARCH, checked_len(SEARCH, rows.len(), rows.end)?)
        };
        Some(Self { panels: try_collect_all(SEARCH, (0..size.div_ceil(PANEL)).map(panel)).ok()?, size })
    }

    pub fn size(&self) -> usize {
        self.size
    }

    /// The rows of each panel.
    pub fn panels(&self) -> impl DoubleEndedIterator<Item = Range<usize>> + ExactSizeIterator + use<> {
        let size = self.size;
        (0..size.div_ceil(PANEL)).map(move |p| rows(size, p))
    }

    /// Entries `0..=i` of row `i`.
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        let rows = rows(self.size, i / PANEL);
        let start = (i - rows.start) * rows.end;
        &mut self.panels[i / PANEL][start..=start + i]
    }

    /// Panel `p`, its rows by the columns up to its diagonal block.
    pub fn panel(&self, p: usize) -> MatRef<'_, f64> {
        let rows = rows(self.size, p);
        MatRef::from_row_major_slice(&self.panels[p], rows.len(), rows.end)
    }

    /// Mutable panel `p`, and the panels before it.
    pub fn split<'a>(&'a mut self, p: usize) -> (impl Fn(usize) -> MatRef<'a, f64> + use<'a>, MatMut<'a, f64>) {
        let size = self.size;
        let (before, rest) = self.panels.split_at_mut(p);
        let before = &*before;
        let here = rows(size, p);
        let panel = MatMut::from_row_major_slice_mut(&mut rest[0], here.len(), here.end);
        let earlier = move |q: usize| {
            let rows = rows(size, q);
            MatRef::from_row_major_slice(&before[q], rows.len(), rows.end)
        };
        (earlier, panel)
    }
}

fn rows(size: usize, p: usize) -> Range<usize> {
    p * PANEL..((p + 1) * PANEL).min(size)
}
