//! Norms of any finite numbers: scaled, so that no square overflows or underflows.

/// `||a - b||_2`, without overflow or underflow for any finite input whose result is representable.
pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    norm(a.iter().zip(b).map(|(a, b)| a - b))
}

/// `||v||_2`, in the same way.
pub(crate) fn norm(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let scale = values.clone().fold(0.0f64, |m, v| m.max(v.abs()));
    if scale == 0.0 || !scale.is_finite() {
        return scale;
    }
    let sum: f64 = values.map(|v| (v / scale).powi(2)).sum();
    scale * sum.sqrt()
}

/// The power of two next to `max |v|` (1 for all zeros): dividing by it is exact and keeps squares in range.
pub(crate) fn power_of_two_scale<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    let max = values.into_iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if max == 0.0 { 1.0 } else { max.log2().floor().clamp(-1021.0, 1022.0).exp2() }
}

/// The power of two nearest to a size, of which dividing by it is exact; 1 where there is none.
pub(crate) fn nearest_power_of_two(size: f64) -> f64 {
    if size > 0.0 && size.is_finite() { 2f64.powi((size.log2().round() as i32).clamp(-1000, 1000)) } else { 1.0 }
}
