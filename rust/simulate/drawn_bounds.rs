//! Order statistics of errors drawn from their law, which are bounds of the next one (Clopper and Pearson, 1934).

use crate::error::{Error, Result};
use crate::memory::{try_collect, try_zeros};

const WHAT: &str = "the order statistics of drawn errors";
/// The share of delta for the quantile, and for a bound that is below it.
const QUANTILE: f64 = 0.9;
const MISTAKE: f64 = 0.01;

/// The largest j with `P(Bin(runs, 0.9 delta) <= j) <= 0.01 delta`; none if there is none.
#[must_use]
pub fn exceedances(runs: usize, delta: f64) -> Option<usize> {
    let p = QUANTILE * delta;
    let mut log = runs as f64 * (-p).ln_1p();
    let (odds, mut below) = (p.ln() - (-p).ln_1p(), log.exp());
    let mut found = None;
    // up to the mean, log P(k) = log P(k-1) + log((R - k + 1) / k) + log(p / (1 - p))
    for k in 0..=(runs as f64 * p) as usize {
        if k > 0 {
            log += ((runs - k + 1) as f64 / k as f64).ln() + odds;
            below += log.exp();
        }
        if below > MISTAKE * delta {
            break;
        }
        found = Some(k);
    }
    found
}

/// Of each column of errors (runs, columns) the one that is exceeded with probability `delta` at most, over the runs
/// and the next error together: that of [`exceedances`], or the largest.
///
/// # Errors
/// [`Error::Shape`] for no errors, [`Error::Memory`].
pub fn drawn_bounds(errors: &[f64], columns: usize, delta: f64) -> Result<Vec<f64>> {
    let runs = errors.len().checked_div(columns).unwrap_or(0);
    if runs == 0 || errors.len() != runs * columns {
        let (expected, found) = (format!("rows of {columns} entries"), errors.len().to_string());
        return Err(Error::Shape { name: "errors", expected, found });
    }
    let rank = runs - 1 - exceedances(runs, delta).unwrap_or(0);
    let mut found = try_zeros(WHAT, columns)?;
    for (c, to) in found.iter_mut().enumerate() {
        let mut column = try_collect(WHAT, errors.iter().skip(c).step_by(columns).copied())?;
        *to = *column.select_nth_unstable_by(rank, f64::total_cmp).1;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_by_hand() {
        // P(Bin(100, .9) <= 80) = .0020 is at most .01, P(.. <= 82) = .0100 is more
        assert!((79..=82).contains(&exceedances(100, 1.0 - 1e-12).unwrap()));
        assert_eq!(exceedances(40, 0.1), None);
        let errors: Vec<f64> = (0..200).map(|k| f64::from((k * 77) % 200)).collect();
        assert_eq!(drawn_bounds(&errors, 1, 0.01).unwrap(), [199.0]);
        let allowed = exceedances(200, 0.2).unwrap();
        assert_eq!(drawn_bounds(&errors, 1, 0.2).unwrap(), [199.0 - allowed as f64]);
        // of two columns
        let both: Vec<f64> = errors.iter().flat_map(|e| [*e, -e]).collect();
        assert_eq!(drawn_bounds(&both, 2, 0.2).unwrap(), [199.0 - allowed as f64, -(allowed as f64)]);
        assert!(drawn_bounds(&errors, 3, 0.2).is_err());
        assert!(drawn_bounds(&[], 1, 0.2).is_err());
    }
}
