//! Quantiles of chi-square and F laws, and upper limits of a noncentrality. Distribution functions are those of
//! `statrs`.

use statrs::function::{
    beta::checked_beta_reg, erf::erfc, gamma::checked_gamma_lr, gamma::checked_gamma_ur, gamma::ln_gamma,
};

use crate::error::{Error, Result};

/// `P(chi2_k <= x)`.
pub(super) fn chi2_below(x: f64, degrees: f64) -> f64 {
    if x <= 0.0 {
        0.0
    } else if x == f64::INFINITY {
        1.0
    } else {
        checked_gamma_lr(degrees / 2.0, x / 2.0).unwrap_or(f64::NAN)
    }
}

/// `P(chi2_k > x)`.
pub(super) fn chi2_above(x: f64, degrees: f64) -> f64 {
    if x <= 0.0 {
        1.0
    } else if x == f64::INFINITY {
        0.0
    } else {
        checked_gamma_ur(degrees / 2.0, x / 2.0).unwrap_or(f64::NAN)
    }
}

/// The density of chi2_k.
pub(super) fn chi2_density(x: f64, degrees: f64) -> f64 {
    let half = degrees / 2.0;
    ((half - 1.0) * (x / 2.0).ln() - x / 2.0 - ln_gamma(half)).exp() / 2.0
}

/// `x` with `P(chi2_k <= x) = probability`; 0 without degrees of freedom.
///
/// # Errors
/// [`Error::Value`] for a probability outside (0, 1).
pub fn chi2_quantile(probability: f64, degrees: f64) -> Result<f64> {
    level("probability", probability)?;
    if degrees == 0.0 {
        return Ok(0.0);
    }
    // logarithms: the lower tail of few degrees of freedom is a power of x
    positive_root(degrees, |x| chi2_below(x, degrees).ln() - probability.ln())
}

/// `x` with `P(chi2_k > x) = delta`, accurate for small `delta`; 0 without degrees of freedom.
///
/// # Errors
/// [`Error::Value`] for a `delta` outside (0, 1).
pub fn chi2_upper(delta: f64, degrees: f64) -> Result<f64> {
    level("delta", delta)?;
    if degrees == 0.0 {
        return Ok(0.0);
    }
    positive_root(degrees, |x| delta.ln() - chi2_above(x, degrees).ln())
}

/// `x` with `P(F_{a,b} > x) = delta`: `P(F > x) = I_y(b/2, a/2)`, `y = b / (b + a x)`.
///
/// # Errors
/// [`Error::Value`] for a `delta` outside (0, 1).
pub fn f_upper(delta: f64, a: f64, b: f64) -> Result<f64> {
    level("delta", delta)?;
    positive_root(1.0, |x| delta.ln() - f_above(x, a, b).ln())
}

/// `P(F_{a,b} > x)`.
pub(super) fn f_above(x: f64, a: f64, b: f64) -> f64 {
    if x == f64::INFINITY { 0.0 } else { checked_beta_reg(b / 2.0, a / 2.0, b / (b + a * x)).unwrap_or(f64::NAN) }
}

/// `P(B > x)` of the law Beta(a, b), accurate where it is small.
pub(super) fn beta_above(x: f64, a: f64, b: f64) -> f64 {
    checked_beta_reg(b, a, (1.0 - x).clamp(0.0, 1.0)).unwrap_or(f64::NAN)
}

/// `P(w > x)` of a standard normal w.
pub(super) fn normal_above(x: f64) -> f64 {
    erfc(x / std::f64::consts::SQRT_2) / 2.0
}

pub(crate) fn level(name: &'static str, value: f64) -> Result<()> {
    if value > 0.0 && value < 1.0 {
        return Ok(());
    }
    Err(Error::Value { name, expected: "in (0, 1)", found: value.to_string() })
}

/// `sup {L : P(chi2_k(L) <= x) >= delta}`, 0 if that set is empty: an upper limit for the noncentrality `L` with
/// confidence `1 - delta` from one value `x`; 0 without degrees of freedom.
///
/// # Errors
/// [`Error::Value`] for a `delta` outside (0, 1).
pub fn noncentrality_limit(x: f64, degrees: f64, delta: f64) -> Result<f64> {
    level("delta", delta)?;
    if degrees == 0.0 || x <= 0.0 || chi2_below(x, degrees) <= delta {
        return Ok(0.0);
    }
    positive_root(x, |limit| delta - noncentral_below(x, degrees, limit))
}

/// `P(chi2_k(L) <= x) = sum_j e^(-L/2) (L/2)^j / j! P(chi2_{k+2j} <= x)`.
///
/// Terms within ten standard deviations of the Poisson law; `P(chi2_{k+2j} <= x)` from the last one downwards, where
/// `P(chi2_{k+2j} <= x) = P(chi2_{k+2j+2} <= x) + (x/2)^(k/2+j) e^(-x/2) / Gamma(k/2 + j + 1)` adds.
fn noncentral_below(x: f64, degrees: f64, limit: f64) -> f64 {
    let (mean, y, half) = (limit / 2.0, x / 2.0, degrees / 2.0);
    let width = 10.0 * mean.sqrt() + 40.0;
    let (first, last) = ((mean - width).max(0.0).floor(), (mean + width).ceil());
    let mut below = chi2_below(x, degrees + 2.0 * last);
    let (mut sum, mut j) = (0.0, last);
    while j >= first {
        sum += (j * mean.ln() - mean - ln_gamma(j + 1.0)).exp() * below;
        let a = half + j - 1.0;
        below += (a * y.ln() - y - ln_gamma(a + 1.0)).exp();
        j -= 1.0;
    }
    sum
}

/// The positive root of a rising function, searched from `start` on by factors of 2.
///
/// # Errors
/// [`Error::Numerical`] if there is none, or a value is NaN.
pub(crate) fn positive_root(start: f64, f: impl Fn(f64) -> f64) -> Result<f64> {
    let (mut low, mut high) = (start, start);
    let (mut at_low, mut at_high) = (f(start), f(start));
    while at_low > 0.0 && low > f64::MIN_POSITIVE {
        (high, at_high) = (low, at_low);
        low /= 2.0;
        at_low = f(low);
    }
    while at_high < 0.0 && high < f64::MAX {
        (low, at_low) = (high, at_high);
        high *= 2.0;
        at_high = f(high);
    }
    root((low, at_low), (high, at_high), f)
}

/// The root of `f` between two points where its values have different signs, to rounding: Brent (1973), ch. 4.
///
/// # Errors
/// [`Error::Numerical`] if the signs are equal, or a value is NaN.
pub(crate) fn root((a, fa): (f64, f64), (b, fb): (f64, f64), f: impl Fn(f64) -> f64) -> Result<f64> {
    let (mut a, mut fa, mut b, mut fb) = (a, fa, b, fb);
    if fa == 0.0 || fb == 0.0 {
        return Ok(if fa == 0.0 { a } else { b });
    }
    if fa.is_nan() || fb.is_nan() || (fa > 0.0) == (fb > 0.0) {
        return Err(Error::Numerical(format!("no change of sign between {a:e} and {b:e}")));
    }
    let (mut c, mut fc, mut step, mut before) = (a, fa, b - a, b - a);
    for _ in 0..500 {
        if (fb > 0.0) == (fc > 0.0) {
            (c, fc, step, before) = (a, fa, b - a, b - a);
        }
        if fc.abs() < fb.abs() {
            (a, fa, b, fb, c, fc) = (b, fb, c, fc, b, fb);
        }
        let (tolerance, half) = (2.0 * f64::EPSILON * b.abs(), (c - b) / 2.0);
        if half.abs() <= tolerance || fb == 0.0 {
            return Ok(b);
        }
        let mut bisect = before.abs() < tolerance || fa.abs() <= fb.abs();
        if !bisect {
            let s = fb / fa;
            let (p, q) = if a == c {
                (2.0 * half * s, 1.0 - s)
            } else {
                let (q, r) = (fa / fc, fb / fc);
                (s * (2.0 * half * q * (q - r) - (b - a) * (r - 1.0)), (q - 1.0) * (r - 1.0) * (s - 1.0))
            };
            let (p, q) = (p.abs(), if p > 0.0 { -q } else { q });
            bisect = 2.0 * p >= (3.0 * half * q - (tolerance * q).abs()).min((before * q).abs());
            if !bisect {
                (before, step) = (step, p / q);
            }
        }
        if bisect {
            (step, before) = (half, half);
        }
        (a, fa) = (b, fb);
        b += if step.abs() > tolerance { step } else { tolerance.copysign(half) };
        fb = f(b);
        if fb.is_nan() {
            return Err(Error::Numerical(format!("a distribution function is not a number at {b:e}")));
        }
    }
    Ok(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(found: Result<f64>, expected: f64) {
        let found = found.unwrap();
        assert!((found - expected).abs() <= 2e-12 * expected.abs(), "{found:.15} is not {expected:.15}");
    }

    #[test]
    fn quantiles_of_the_plain_laws() {
        check(chi2_quantile(0.01, 50.0), 29.706682698841);
        check(chi2_upper(0.05, 5.0).map(f64::sqrt), 3.327235743604);
        check(f_upper(0.05, 2.0, 2.0), 19.0);
        // d = 1: n F / (nu - n + 1)
        check(f_upper(0.05, 4.0, 31.0).map(|f| 4.0 / 31.0 * f), 0.345634465762168);
        check(chi2_quantile(1e-100, 1.0), std::f64::consts::FRAC_PI_2 * 1e-200); // a power of x in the lower tail
        assert!(chi2_upper(0.0, 3.0).is_err() && chi2_quantile(f64::NAN, 3.0).is_err());
    }

    #[test]
    fn limits_of_a_noncentrality() {
        check(noncentrality_limit(32.0, 32.0, 0.025), 21.445789230634);
        check(noncentrality_limit(150.0, 147.0, 0.025), 43.023665602840);
        check(noncentrality_limit(10.0, 5.0, 0.05), 18.117739807813);
        assert_eq!(noncentrality_limit(0.1, 32.0, 0.025), Ok(0.0));
    }
}
