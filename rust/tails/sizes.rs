//! Sizes of vectors.

pub(super) const WHAT: &str = "a tail bound";

/// `max |v|`, 1 if all are 0: in this unit squares do not overflow or vanish.
pub(super) fn unit_of(values: &[f64]) -> f64 {
    let largest = largest(values);
    if largest > 0.0 { largest } else { 1.0 }
}

pub(super) fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

pub(super) fn one_norm(values: &[f64]) -> f64 {
    values.iter().map(|v| v.abs()).sum()
}

/// `sign(v)`, 0 for 0.
pub(super) fn sign(v: f64) -> f64 {
    if v == 0.0 { 0.0 } else { v.signum() }
}

pub(super) fn nonzero(values: &[f64]) -> usize {
    values.iter().filter(|v| **v != 0.0).count()
}

/// `sum_{k != i} v_k` for every i, without a subtraction.
pub(super) fn others(values: &[f64], to: &mut [f64]) {
    let mut before = 0.0;
    for (to, v) in to.iter_mut().zip(values) {
        *to = before;
        before += v;
    }
    let mut after = 0.0;
    for (to, v) in to.iter_mut().zip(values).rev() {
        *to += after;
        after += v;
    }
}
