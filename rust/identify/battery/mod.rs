//! Tests of a model of logged pairs: what the residuals must not depend on, in one pass over the pairs.
//!
//! Columns that no linear model with white noise needs (earlier inputs, the next one, a constant, one half of the data,
//! squares, cubes and signs, drift over a run, ends of ranges) are added to the regressors, and what they explain is
//! tested by Rao's F, whose level is exact for regressors independent of Gaussian noise. The same in NumPy is
//! `tests/python/twin/battery.py`.

mod columns;
mod explained;
mod given;
mod rows;
mod spread;
mod sums;

use crate::error::Result;
use crate::memory::room_for_products;
use crate::parallel::Stop;
pub use explained::Explained;
use explained::Outcomes;
pub use given::{Given, Test};
pub use spread::{Declared, noise_tests};
use sums::Sums;

/// All tests that the pairs allow.
///
/// # Errors
/// Rows that do not fit together; a fit without a Cholesky factor; no memory; an interruption.
pub fn battery(given: &Given<'_>, stop: &Stop) -> Result<Vec<Test>> {
    given.refuse()?;
    let f = given.fitted;
    let mut tests = Vec::new();
    let Some(of) = Outcomes::new(&f.residual, given.basis, given.n, f.degrees())? else { return Ok(tests) };
    room_for_products()?;
    let sums = Sums::of(given, &of, stop)?;
    sums.judge(given, &of, &mut tests)?;
    if given.marked.is_none() {
        sums.effects(given, &of, &mut tests)?;
        spread::variance(given, &sums, &mut tests)?;
        rows::outliers(given, &of, &sums, &mut tests, stop)?;
        rows::equal(given, &mut tests)?;
    }
    Ok(tests)
}
