//! Logarithms of binomial probabilities and tails, accurate far out, without differences `1 - cdf`.
//!
//! The probability of success is given by its odds `y = e / (1 - e)`, so that neither `e` near 0 nor `e` near 1 is
//! rounded.

use std::f64::consts::PI;

use statrs::function::gamma::ln_gamma;

/// Odds of success, and the logarithms of both probabilities.
#[derive(Clone, Copy)]
pub(super) struct Odds {
    pub(super) e: f64,
    pub(super) log_e: f64,
    /// `ln (1 - e)`
    pub(super) log_t: f64,
}

impl Odds {
    pub(super) fn new(y: f64) -> Self {
        let log_t = -y.ln_1p();
        let log_e = if y > 1.0 { -(1.0 / y).ln_1p() } else { y.ln() + log_t };
        Self { e: y / (1.0 + y), log_e, log_t }
    }
}

/// `ln n! - ln (sqrt(2 pi n) (n/e)^n)`: Stirling's series, exact to rounding for n > 15; a difference below.
fn stirling_error(n: f64) -> f64 {
    if n <= 15.0 {
        return ln_gamma(n + 1.0) - (n + 0.5) * n.ln() + n - 0.5 * (2.0 * PI).ln();
    }
    let n2 = n * n;
    (1.0 / 12.0 - (1.0 / 360.0 - (1.0 / 1260.0 - (1.0 / 1680.0 - 1.0 / 1188.0 / n2) / n2) / n2) / n2) / n
}

/// `x ln(x / m) + m - x`, accurate for x near m.
fn deviance(x: f64, m: f64) -> f64 {
    let v = (x - m) / (x + m);
    if v.abs() >= 0.1 {
        return x * (x / m).ln() + m - x;
    }
    // (x - m) v + 2 x sum_j v^(2j+1) / (2j + 1)
    let (mut power, mut sum) = (2.0 * x * v, (x - m) * v);
    for j in 1..1000 {
        power *= v * v;
        let next = sum + power / f64::from(2 * j + 1);
        if next == sum {
            break;
        }
        sum = next;
    }
    sum
}

/// `ln C(n, k)`
pub(super) fn log_choose(n: f64, k: f64) -> f64 {
    if k == 0.0 || k == n {
        return 0.0;
    }
    // C(n, k) is the probability of k at e = k / n, over e^k (1 - e)^(n - k)
    let rest = n - k;
    stirling_error(n) - stirling_error(k) - stirling_error(rest) + 0.5 * (n / (2.0 * PI * k * rest)).ln()
        - k * (k / n).ln()
        - rest * (-k / n).ln_1p()
}

/// `ln P(Bin(n, e) = k)`: the saddle point of Loader (2000).
pub(super) fn log_pmf(n: f64, k: f64, odds: Odds) -> f64 {
    if k == 0.0 {
        return n * odds.log_t;
    }
    if k == n {
        return n * odds.log_e;
    }
    let rest = n - k;
    stirling_error(n)
        - stirling_error(k)
        - stirling_error(rest)
        - deviance(k, n * odds.e)
        - deviance(rest, n * odds.log_t.exp())
        + 0.5 * (n / (2.0 * PI * k * rest)).ln()
}

/// `ln P(Bin(n, e) <= k)` and `ln P(Bin(n, e) >= k + 1)`.
pub(super) fn log_tails(n: f64, k: f64, odds: Odds) -> (f64, f64) {
    if k >= n {
        return (0.0, f64::NEG_INFINITY);
    }
    // P(<= k) = I_{1-e}(n - k, k + 1), P(>= k + 1) = I_e(k + 1, n - k): the smaller one by its continued fraction
    // where the fraction converges fast (DLMF 8.17.22)
    if odds.log_t.exp() < (n - k + 1.0) / (n + 3.0) {
        let below = log_pmf(n, k, odds) + odds.log_e + fraction(n - k, k + 1.0, odds.log_t.exp()).ln();
        (below, log_rest(below))
    } else {
        let above = log_pmf(n, k + 1.0, odds) + odds.log_t + fraction(k + 1.0, n - k, odds.e).ln();
        (log_rest(above), above)
    }
}

/// `ln (1 - exp x)`
fn log_rest(x: f64) -> f64 {
    if x > -0.7 { (-x.exp_m1()).ln() } else { (-x.exp()).ln_1p() }
}

/// `a B(a, b) I_x(a, b) / (x^a (1 - x)^b)`: the continued fraction of the incomplete beta function (DLMF 8.17.22) by
/// Lentz, for `x` at most about `a / (a + b)`.
fn fraction(a: f64, b: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut d = 1.0 / away(1.0 - (a + b) * x / (a + 1.0));
    let (mut c, mut value) = (1.0, d);
    for j in 1..1_000_000 {
        let j = f64::from(j);
        let even = j * (b - j) * x / ((a + 2.0 * j - 1.0) * (a + 2.0 * j));
        d = 1.0 / away(1.0 + even * d);
        c = away(1.0 + even / c);
        value *= c * d;
        let odd = -(a + j) * (a + b + j) * x / ((a + 2.0 * j) * (a + 2.0 * j + 1.0));
        d = 1.0 / away(1.0 + odd * d);
        c = away(1.0 + odd / c);
        let step = c * d;
        value *= step;
        if (step - 1.0).abs() <= f64::EPSILON {
            break;
        }
    }
    value
}
