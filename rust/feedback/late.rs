//! The region of a plant with the inputs of the steps before as states.

use std::sync::Arc;

use crate::error::Result;
use crate::memory::{try_copy, try_zeros};
use crate::region::{Part, PartOf, Region};

use super::data::WHAT;

/// States `(x, v_1, .., v_d)` with `v_1(k+1) = K x(k)`, `v_j(k+1) = v_(j-1)(k)`: the inputs that were asked for.
pub(super) fn with_past(region: &Region, gain: &[f64], d: usize) -> Result<Region> {
    let (n, m, width) = (region.n, region.m, region.d);
    let (all, more) = (n + m * d, m * d);
    let mut centre = try_zeros::<f64>(WHAT, all * (width + more))?;
    for (i, row) in centre.chunks_exact_mut(width + more).enumerate() {
        if i < n {
            let own = &region.centre[i * width..(i + 1) * width];
            row[..n].copy_from_slice(&own[..n]);
            row[all..].copy_from_slice(&own[n..]);
        } else if i < n + m {
            row[..n].copy_from_slice(&gain[(i - n) * n..(i - n + 1) * n]);
        } else {
            row[i - m] = 1.0;
        }
    }
    let mut parts = Vec::new();
    for part in &region.parts {
        let mut columns = try_copy(WHAT, &part.columns)?;
        columns.iter_mut().filter(|j| **j >= n).for_each(|j| *j += more);
        parts.push(Arc::new(Part::new(PartOf { columns: &columns, ..part.of() })?));
    }
    Region::new(&centre, all, m, parts, region.frobenius, region.future)
}
