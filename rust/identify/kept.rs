//! Quantiles that were asked for before: they depend on sizes alone, and take milliseconds.

use std::collections::BTreeMap;
use std::sync::Mutex;

use crate::error::Result;

/// Of [`super::quantiles`], what is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Law {
    Roy,
    Joint,
    Wishart,
    Scalar,
    Diagonal,
    Smallest,
}

type Key = (Law, [usize; 3], u64);

/// Most that are kept; then they are forgotten, all at once.
const MOST: usize = 4096;

static KEPT: Mutex<BTreeMap<Key, (f64, f64)>> = Mutex::new(BTreeMap::new());

/// The quantile of a law for these sizes and this level, from before or by `compute`.
///
/// Nothing waits for the lock: another thread may hold it while the process is forked, and the child would wait for
/// ever.
pub(super) fn kept(
    law: Law,
    sizes: [usize; 3],
    delta: f64,
    compute: impl FnOnce() -> Result<(f64, f64)>,
) -> Result<(f64, f64)> {
    let key = (law, sizes, delta.to_bits());
    if let Some(found) = KEPT.try_lock().ok().and_then(|kept| kept.get(&key).copied()) {
        return Ok(found);
    }
    let found = compute()?;
    if let Ok(mut kept) = KEPT.try_lock() {
        if kept.len() >= MOST {
            kept.clear();
        }
        kept.insert(key, found);
    }
    Ok(found)
}
