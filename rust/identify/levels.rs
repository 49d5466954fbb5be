//! Levels of the anytime regions: the mixture over the sphere, `1F1(1/2; n/2; c)`, and one sub-Gaussian vector.
//!
//! With `ld = log det(I + V / lam)`, `||M (V + lam I)^(-1/2)||^2 <= 2 sigma^2 c`,
//! `1F1(1/2; n/2; c) = exp(ld / 2) / delta`, for all N at once (Ville's inequality; `tests/python/twin/anytime.py`).

use crate::error::{Error, Result};

use super::distributions::{level, positive_root};

/// `log sum_k t_k`, `t_0 = 1`, `t_{k+1} = t_k ratio(k)`, all positive: until `ratio <= 1/2` and what is left is below
/// rounding.
fn log_series(ratio: impl Fn(f64) -> f64) -> f64 {
    const LARGE: f64 = 1e200;
    let (mut term, mut sum, mut log, mut k) = (1.0, 1.0, 0.0, 0.0);
    loop {
        let r = ratio(k);
        if (r <= 0.5 && term <= sum * 1e-17) || r.is_nan() {
            return log + f64::ln(sum);
        }
        term *= r;
        sum += term;
        if sum > LARGE {
            (term, sum, log) = (term / LARGE, sum / LARGE, log + LARGE.ln());
        }
        k += 1.0;
    }
}

/// `log 1F1(a; b; c)` for `0 < a <= b`, `c >= 0`.
fn log_hyp1f1(a: f64, b: f64, c: f64) -> f64 {
    if a == b { c } else { log_series(|k| (a + k) / (b + k) * (c / (k + 1.0))) }
}

/// `c` with `1F1(1/2; n/2; c) = exp(ld / 2) / delta`.
///
/// # Errors
/// [`Error::Value`] for a `delta` outside (0, 1), an `ld` that is negative or not finite, or `n = 0`.
pub fn sphere_level(n: usize, ld: f64, delta: f64) -> Result<f64> {
    Ok(0.5 * least_squares_level(n, &[ld], &[1.0], delta, false)?)
}

/// `rho^2` with `||D V^(1/2)||^2 <= rho^2 sigma^2` for least squares, from `ld` and
/// `wider = 1 + lam / (smallest eigenvalue of V)` of `J` values of `lam` fixed beforehand: `2 c` with
///
/// ```text
/// sum_j exp(-ld_j / 2) 1F1(1/2; n/2; c / wider_j) = J / delta,
/// ```
///
/// or, for the Frobenius norm, the smallest of `(n ld_j + 2 log(J / delta)) wider_j`. Infinite for infinite `wider`.
///
/// # Errors
/// As [`sphere_level`]; [`Error::Shape`] for lists that are empty or of different length.
pub fn least_squares_level(n: usize, ld: &[f64], wider: &[f64], delta: f64, frobenius: bool) -> Result<f64> {
    level("delta", delta)?;
    if ld.is_empty() || ld.len() != wider.len() {
        return Err(Error::Shape {
            name: "wider",
            expected: format!("as many entries as `ld`, at least one, not {}", ld.len()),
            found: wider.len().to_string(),
        });
    }
    if let Some(bad) = ld.iter().find(|ld| !(ld.is_finite() && **ld >= 0.0)) {
        return Err(Error::Value { name: "ld", expected: "finite and not negative", found: bad.to_string() });
    }
    if n == 0 {
        return Err(Error::Value { name: "n", expected: "at least 1", found: "0".into() });
    }
    if wider.contains(&f64::INFINITY) {
        return Ok(f64::INFINITY);
    }
    let log_share = delta.ln() - (ld.len() as f64).ln(); // of delta / J, which may underflow
    let each = ld.iter().zip(wider);
    if frobenius {
        let best = each.map(|(ld, wide)| (n as f64 * ld - 2.0 * log_share) * wide).fold(f64::INFINITY, f64::min);
        return Ok(best);
    }
    let left = |c: f64| {
        let term = |(ld, wide): (&f64, &f64)| log_hyp1f1(0.5, n as f64 / 2.0, c / wide) - ld / 2.0;
        let top = each.clone().map(term).fold(f64::NEG_INFINITY, f64::max);
        top + each.clone().map(|pair| (term(pair) - top).exp()).sum::<f64>().ln() + log_share
    };
    // 1F1(1/2; n/2; c) <= exp(c): the root is at least the smallest wider_j times log(1 / delta), for one j exactly so
    // at n = 1
    let start = each.clone().map(|(ld, wide)| (ld / 2.0 - log_share) * wide).fold(f64::INFINITY, f64::min);
    Ok(2.0 * positive_root(start, left)?)
}

/// `r` with `P(||w|| > r sigma) <= delta` for one sub-Gaussian `w` in `n` dimensions: Markov's inequality for the mean
/// of `exp(s l'w)` over the sphere, `0F1(n/2; s^2 ||w||^2 / 4)`, of expectation at most `exp(s^2 / 2)`, with the best
/// `s`.
///
/// # Errors
/// [`Error::Value`] for a `delta` outside (0, 1) or `n = 0`.
pub fn one_noise(n: usize, delta: f64) -> Result<f64> {
    level("delta", delta)?;
    if n == 0 {
        return Err(Error::Value { name: "n", expected: "at least 1", found: "0".into() });
    }
    let half = n as f64 / 2.0;
    let log_0f1 = |z: f64| log_series(|k| z / ((half + k) * (k + 1.0)));
    let radius = |log_s: f64| -> Result<f64> {
        let s = log_s.exp();
        positive_root(1.0, |r| log_0f1(s * s * r * r / 4.0) - s * s / 2.0 + delta.ln())
    };
    // any s is valid; the radius falls, then rises with log s
    Ok(smallest(0.1f64.ln(), 50f64.ln(), radius)?.1)
}

/// Where a function that falls, then rises, is smallest between two points, and its value there: golden sections.
pub(crate) fn smallest(low: f64, high: f64, mut f: impl FnMut(f64) -> Result<f64>) -> Result<(f64, f64)> {
    const PART: f64 = 0.618_033_988_749_894_9; // (sqrt(5) - 1) / 2
    let (mut low, mut high) = (low, high);
    let (mut a, mut b) = (high - PART * (high - low), low + PART * (high - low));
    let (mut fa, mut fb) = (f(a)?, f(b)?);
    while high - low > 1e-9 {
        if fa <= fb {
            (high, b, fb) = (b, a, fa);
            a = high - PART * (high - low);
            fa = f(a)?;
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + PART * (high - low);
            fb = f(b)?;
        }
    }
    Ok(if fa <= fb { (a, fa) } else { (b, fb) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(found: f64, expected: f64) {
        assert!((found - expected).abs() <= 2e-12 * expected.abs(), "{found:.15} is not {expected:.15}");
    }

    #[test]
    fn the_mixture_over_the_sphere() {
        check(log_hyp1f1(0.5, 1.5, 2.0).exp(), 2.364453892805);
        check(sphere_level(1, 22.0, 0.05).unwrap(), 11.0 + 20f64.ln());
        let cases =
            [(2, 10.0, 0.05, 9.673318542407), (4, 22.0, 0.05, 18.936369258257), (10, 60.0, 0.01, 49.510828368918)];
        for (n, ld, delta, expected) in cases {
            check(sphere_level(n, ld, delta).unwrap(), expected);
        }
        for (n, ld, delta) in [(300, 5000.0, 1e-12), (300, 0.0, 0.5), (1, 1e-3, 0.05), (2, 5000.0, 0.05)] {
            let c = sphere_level(n, ld, delta).unwrap();
            check(log_hyp1f1(0.5, n as f64 / 2.0, c), ld / 2.0 - delta.ln());
        }
    }

    #[test]
    fn a_mean_of_equal_mixtures_is_each() {
        let one = least_squares_level(3, &[7.0], &[1.2], 0.05, false).unwrap();
        check(least_squares_level(3, &[7.0, 7.0], &[1.2, 1.2], 0.05, false).unwrap(), one);
        check(least_squares_level(3, &[7.0], &[1.2], 0.05, true).unwrap(), (21.0 + 2.0 * 20f64.ln()) * 1.2);
        assert_eq!(least_squares_level(3, &[7.0], &[f64::INFINITY], 0.05, false), Ok(f64::INFINITY));
        assert!(least_squares_level(3, &[7.0], &[], 0.05, false).is_err());
        // a share that underflows: log(1 / 5e-324) = 744.4
        assert!((least_squares_level(1, &[0.0; 16], &[1.0; 16], 5e-324, false).unwrap() - 2.0 * 744.44).abs() < 0.01);
    }

    #[test]
    fn one_vector_of_noise() {
        // n = 1: cosh(s r) = exp(s^2 / 2) / delta, nearly sqrt(2 log(2 / delta)) where the other exponential is small
        let expected = (2.0 * (2.0f64 / 1e-9).ln()).sqrt();
        assert!((one_noise(1, 1e-9).unwrap() - expected).abs() < 1e-7);
    }
}
