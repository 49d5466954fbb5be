//! Dense vector kernels: four independent partial sums, so that they vectorise.

/// `<x, y>`
pub(crate) fn dot(x: &[f64], y: &[f64]) -> f64 {
    let (x4, x_tail) = x.as_chunks::<4>();
    let (y4, y_tail) = y.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in x4.iter().zip(y4) {
        for k in 0..4 {
            sums[k] += a[k] * b[k];
        }
    }
    let tail: f64 = x_tail.iter().zip(y_tail).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}

/// `sum_i x_i`
pub(crate) fn sum(x: &[f64]) -> f64 {
    let (x4, tail) = x.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for a in x4 {
        for k in 0..4 {
            sums[k] += a[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail.iter().sum::<f64>()
}

/// `||x||_2`
pub(crate) fn norm(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}

/// `y += a x`
pub(crate) fn axpy(a: f64, x: &[f64], y: &mut [f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}

/// `min_i x_i` (`+inf` for an empty slice)
pub(crate) fn min(x: &[f64]) -> f64 {
    let (x4, tail) = x.as_chunks::<4>();
    let mut low = [f64::INFINITY; 4];
    for a in x4 {
        for k in 0..4 {
            low[k] = if a[k] < low[k] { a[k] } else { low[k] };
        }
    }
    low.iter().chain(tail).fold(f64::INFINITY, |m, &v| if v < m { v } else { m })
}
