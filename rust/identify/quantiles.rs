//! Quantiles of the roots that measure the error of least squares with Gaussian noise.
//!
//! `G` (n, d) is standard normal and `E_nu` an independent Wishart matrix `W_n(I, nu)`. Laws of one extreme root are
//! exact where [`super::largest_root`] says that they are; traces, joint sets and diagonal noise are drawn.

use statrs::function::gamma::ln_gamma;

use crate::error::{Error, Result};
use crate::memory::try_collect;
use crate::parallel::Stop;

use super::beta_model::{DRAWS, largest_of_gaussian, roots, smallest_wishart_root};
use super::distributions::{chi2_density, chi2_quantile, chi2_upper, f_upper, level, root};
use super::largest_root::{Roy, Wishart};

const WHAT: &str = "the draws behind a quantile";
/// A law is used if what it should be 1 is wrong by at most this part of delta.
const TRUSTED: f64 = 1e-2;

/// The `ceil((1 - delta) (M + 1))`-th smallest of `M` draws, infinite if there are too few: a further draw is larger
/// with probability at most `delta`, over all `M + 1` draws (Dwass 1957).
pub(super) fn order_quantile(draws: impl IntoIterator<Item = f64>, delta: f64) -> Result<f64> {
    let mut draws = try_collect(WHAT, draws)?;
    let k = ((1.0 - delta) * (draws.len() + 1) as f64 - 1e-9).ceil() as usize;
    Ok(if (1..=draws.len()).contains(&k) {
        *draws.select_nth_unstable_by(k - 1, f64::total_cmp).1
    } else {
        f64::INFINITY
    })
}

fn checked(n: usize, d: usize, delta: f64) -> Result<()> {
    level("delta", delta)?;
    if n == 0 || d == 0 {
        return Err(Error::Value { name: "n, d", expected: "at least 1", found: format!("{n}, {d}") });
    }
    Ok(())
}

/// Samples from which on the exact law is slow, and the inequality for rare events within a percent of it.
const MANY: usize = 1 << 20;

/// Part by which a quantile may be on the safe side.
const PRECISE: f64 = 1e-11;

fn trusted(end: f64, delta: f64) -> bool {
    (end - 1.0).abs() <= TRUSTED * delta
}

/// The root of a function that may be stopped or fail.
fn stoppable(low: f64, high: f64, stop: &Stop, f: impl Fn(f64) -> Result<f64>) -> Result<f64> {
    let failed = std::cell::Cell::new(None);
    let value = |x: f64| match stop.check().and_then(|()| f(x)) {
        Ok(value) => value,
        Err(error) => {
            failed.set(Some(error));
            f64::NAN
        }
    };
    let found = root((low, value(low)), (high, value(high)), value);
    failed.take().map_or(found, Err)
}

/// The largest `x` from `low` to `high` with `share(x) <= 1`, at most `PRECISE` too small; `share` grows.
///
/// By secants of its logarithm, which is nearly linear, with half the value at an end that stays (Illinois). A few
/// values of a distribution function: to the last digit it would take many more, that only follow its rounding.
fn reached(low: f64, high: f64, stop: &Stop, share: impl Fn(f64) -> Result<f64>) -> Result<f64> {
    let value = |x: f64| share(x).map(|v| v.max(1e-9).ln());
    let (mut low, mut high) = ((low, value(low)?), (high, value(high)?));
    if low.1 > 0.0 {
        low = (0.0, value(0.0)?);
    }
    let mut side = 0;
    for step in 0..200 {
        if high.0 - low.0 <= PRECISE * high.0 {
            break;
        }
        stop.check()?;
        let secant = (low.0 * high.1 - high.0 * low.1) / (high.1 - low.1);
        let inside = secant > low.0 && secant < high.0 && step % 4 != 3;
        let x = if inside { secant } else { f64::midpoint(low.0, high.0) };
        let found = value(x)?;
        if found > 0.0 {
            high = (x, found);
            low.1 *= if side > 0 { 0.5 } else { 1.0 };
            side = 1;
        } else {
            low = (x, found);
            high.1 *= if side < 0 { 0.5 } else { 1.0 };
            side = -1;
        }
    }
    Ok(low.0)
}

/// `q` with `P(largest root of E_nu^-1 G G' <= q) = 1 - delta`; infinite for `nu < n`.
///
/// # Errors
/// [`Error::Value`] for a `delta` outside (0, 1) or no rows or columns, [`Error::Memory`], [`Error::Interrupted`].
pub fn roy_quantile(n: usize, d: usize, nu: usize, delta: f64, threads: usize, stop: &Stop) -> Result<f64> {
    checked(n, d, delta)?;
    if nu < n {
        return Ok(f64::INFINITY);
    }
    let (long, free) = (n.max(d) as f64, (nu - n + 1) as f64);
    if n.min(d) == 1 {
        return Ok(long / free * f_upper(delta, long, free)?); // n = 1: an F ratio; d = 1: Hotelling's
    }
    let law = Roy::new(n, d, nu)?;
    if trusted(law.below(1.0)?, delta) {
        let single = n as f64 / free * f_upper(delta, n as f64, free)?; // one column is not larger
        let (low, high) = (single / (1.0 + single), 1.0 - 1e-15);
        let theta = stoppable(low, high, stop, |theta| Ok(law.below(theta)? - (1.0 - delta)))?;
        return Ok(theta / (1.0 - theta));
    }
    order_quantile(roots(n, d, nu, DRAWS, threads, stop)?.into_iter().map(|[largest, _]| largest), delta)
}

/// `q` with `P(largest root of G G' <= q) = 1 - delta`.
///
/// # Errors
/// As [`roy_quantile`].
pub fn wishart_quantile(n: usize, d: usize, delta: f64, threads: usize, stop: &Stop) -> Result<f64> {
    checked(n, d, delta)?;
    let single = chi2_upper(delta, n.max(d) as f64)?;
    if n.min(d) == 1 {
        return Ok(single);
    }
    let law = Wishart::new(n, d)?;
    if trusted(law.between(0.0, f64::INFINITY)?, delta) {
        // Davidson and Szarek (2001)
        let high = ((n as f64).sqrt() + (d as f64).sqrt() + (2.0 * (2.0 / delta).ln()).sqrt()).powi(2);
        return stoppable(single, high, stop, |x| Ok(law.between(0.0, x)? - (1.0 - delta)));
    }
    let draws = largest_of_gaussian(n, d, None, DRAWS / 10, threads, stop)?;
    order_quantile(draws.into_iter().map(|[largest, _]| largest), delta)
}

/// `a` with `P(smallest eigenvalue of W_n(I, N) < a) = delta`, or less for a `delta` too small to draw; 0 for `N < n`.
///
/// # Errors
/// As [`roy_quantile`].
pub fn smallest_quantile(n: usize, samples: usize, delta: f64, threads: usize, stop: &Stop) -> Result<f64> {
    checked(n, 1, delta)?;
    if samples < n {
        return Ok(0.0);
    }
    let rare = delta * (DRAWS as f64 + 1.0) < 1.0; // too rare to be drawn
    // P(smallest singular value < sqrt N - sqrt n - t) <= exp(-t^2 / 2), Davidson and Szarek (2001)
    let below = (samples as f64).sqrt() - (n as f64).sqrt() - (-2.0 * delta.ln()).sqrt();
    let below = below.max(0.0).powi(2);
    if rare && samples > MANY {
        return Ok(below);
    }
    let single = chi2_quantile(delta, samples as f64)?;
    if n == 1 {
        return Ok(single);
    }
    let law = Wishart::new(n, samples)?;
    if trusted(law.between(0.0, f64::INFINITY)?, delta) {
        return reached(below, single, stop, |a| Ok((1.0 - law.between(a, f64::INFINITY)?) / delta));
    }
    if rare {
        return Ok(below);
    }
    // the floor(delta (M + 1))-th smallest: a further draw is smaller with probability at most delta
    let negative = smallest_wishart_root(n, samples, DRAWS, threads, stop)?.into_iter().map(|[smallest, _]| -smallest);
    Ok((-order_quantile(negative, delta)?).max(0.0))
}

/// `q` with `P(largest root of G G' <= q c) = 1 - delta`, `c ~ chi2_{n nu}` independent; infinite for `nu = 0`.
///
/// The mean over `c` by 200 points of Gauss and Legendre between its 1e-16 quantiles.
///
/// # Errors
/// As [`roy_quantile`].
pub fn scalar_quantile(n: usize, d: usize, nu: usize, delta: f64, threads: usize, stop: &Stop) -> Result<f64> {
    checked(n, d, delta)?;
    let free = (n * nu) as f64;
    if nu == 0 {
        return Ok(f64::INFINITY);
    }
    if n.min(d) == 1 {
        let long = n.max(d) as f64;
        return Ok(long * f_upper(delta, long, free)? / free);
    }
    let (low, high) = (chi2_quantile(1e-16, free)?, chi2_upper(1e-16, free)?);
    let (nodes, weights) = super::legendre::gauss_legendre(200)?;
    let law = Wishart::new(n, d)?;
    let left = |q: f64| {
        let mut sum = delta - 1.0;
        for (x, w) in nodes.iter().zip(&weights) {
            let c = low + (x + 1.0) * (high - low) / 2.0;
            let mass = w * (high - low) / 2.0 * chi2_density(c, free);
            if mass > 1e-18 {
                stop.check()?;
                sum += mass * law.between(0.0, q * c)?;
            }
        }
        Ok(sum)
    };
    let middle = wishart_quantile(n, d, delta, threads, stop)? / free;
    let most = 10.0 * middle + wishart_quantile(n, d, delta / 4.0, threads, stop)? / low;
    stoppable(0.1 * middle, most, stop, left)
}

/// `q` of `max_i ||g_i||^2 / c_i`, rows `g_i` of `G`, `c_i ~ chi2_nu`: `(d / nu) F^-1_{d,nu}((1 - delta)^(1/n))`.
///
/// # Errors
/// As [`roy_quantile`].
pub fn row_quantile(n: usize, d: usize, nu: usize, delta: f64) -> Result<f64> {
    checked(n, d, delta)?;
    if nu == 0 {
        return Ok(f64::INFINITY);
    }
    let each = -((-delta).ln_1p() / n as f64).exp_m1(); // 1 - (1 - delta)^(1/n)
    Ok(d as f64 / nu as f64 * f_upper(each, d as f64, nu as f64)?)
}

/// `q` of the largest root of `C^-1/2 G G' C^-1/2`, `C` diagonal of `n` independent chi2_nu; drawn.
///
/// # Errors
/// As [`roy_quantile`].
pub fn diagonal_quantile(n: usize, d: usize, nu: usize, delta: f64, threads: usize, stop: &Stop) -> Result<f64> {
    checked(n, d, delta)?;
    if nu == 0 {
        return Ok(f64::INFINITY);
    }
    let draws = largest_of_gaussian(n, d, Some(nu), DRAWS / 5, threads, stop)?;
    order_quantile(draws.into_iter().map(|[largest, _]| largest), delta)
}

/// `q` of `tr(E_nu^-1 G G')`, the trace of Lawley and Hotelling; drawn; infinite for `nu < n`.
///
/// # Errors
/// As [`roy_quantile`].
pub fn trace_quantile(n: usize, d: usize, nu: usize, delta: f64, threads: usize, stop: &Stop) -> Result<f64> {
    checked(n, d, delta)?;
    if nu < n {
        return Ok(f64::INFINITY);
    }
    order_quantile(roots(n, d, nu, DRAWS, threads, stop)?.into_iter().map(|[_, sum]| sum), delta)
}

/// Radii of `||Gamma||_2` and `||Gamma||_F` in one event of `1 - delta`, `Gamma Gamma' = E_nu^-1 G G'` but for a
/// rotation: roots of `t q_R` and `t q_T`, `t` the quantile of `max(lam_max / q_R, tr / q_T)`; infinite for `nu < n`.
///
/// # Errors
/// As [`roy_quantile`].
pub fn joint_radii(n: usize, d: usize, nu: usize, delta: f64, threads: usize, stop: &Stop) -> Result<(f64, f64)> {
    checked(n, d, delta)?;
    if nu < n {
        return Ok((f64::INFINITY, f64::INFINITY));
    }
    let draws = roots(n, d, nu, DRAWS, threads, stop)?;
    let root = roy_quantile(n, d, nu, delta, threads, stop)?;
    let trace = order_quantile(draws.iter().map(|[_, sum]| *sum), delta)?;
    let t = order_quantile(draws.iter().map(|[largest, sum]| (largest / root).max(sum / trace)), delta)?;
    Ok(((t * root).sqrt(), (t * trace).sqrt()))
}

/// `log Gamma_n(a) = n (n - 1) / 4 log pi + sum_{i < n} log Gamma(a - i / 2)`.
pub fn log_multigamma(a: f64, n: usize) -> f64 {
    let pairs = (n * n.saturating_sub(1)) as f64 / 4.0;
    pairs * std::f64::consts::PI.ln() + (0..n).map(|i| ln_gamma(a - i as f64 / 2.0)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(found: Result<f64>, expected: f64) {
        let found = found.unwrap();
        assert!((found - expected).abs() <= 1e-11 * expected.abs(), "{found:.15} is not {expected:.15}");
    }

    #[test]
    fn a_quantile_is_on_the_safe_side_after_a_few_values() {
        for (power, end) in [(3.0, 50.0), (40.0, 700.0), (400.0, 9e3)] {
            let count = std::cell::Cell::new(0);
            let share = |x: f64| {
                count.set(count.get() + 1);
                Ok((x / 123.456_f64).powf(power))
            };
            let found = reached(20.0, end + 100.0, &Stop::new(), share).unwrap();
            assert!(found <= 123.456 && found > 123.456 * (1.0 - 2.0 * PRECISE), "{found}");
            assert!(count.get() < 60, "{}", count.get());
        }
        // already at the lower end too large: from 0 on
        let found = reached(200.0, 300.0, &Stop::new(), |x| Ok(x / 123.456)).unwrap();
        assert!(found <= 123.456 && found > 123.456 * (1.0 - 2.0 * PRECISE), "{found}");
    }

    #[test]
    fn exact_quantiles() {
        let stop = Stop::new();
        for (n, d, nu, delta, expected) in [
            (2, 3, 9, 0.05, 2.352760180305),
            (2, 2, 9, 0.05, 1.765073871830),
            (2, 1, 9, 0.05, 1.114742526881),
            (4, 6, 34, 0.05, 0.878703628912667),
            (4, 6, 34, 0.001, 1.59384135970193),
            (4, 1, 34, 0.05, 0.345634465762168),
            (2, 5, 12, 0.05, 2.113591033513),
            (10, 15, 100, 0.05, 0.684817207726018),
            (8, 12, 60, 0.01, 1.21828685238585),
            (15, 15, 100, 0.05, 0.909140858288493),
        ] {
            check(roy_quantile(n, d, nu, delta, 1, &stop), expected);
        }
        assert_eq!(roy_quantile(4, 6, 3, 0.05, 1, &stop), Ok(f64::INFINITY));
        assert_eq!(roy_quantile(4, 6, 34, 1e-15, 1, &stop), Ok(f64::INFINITY)); // no form has these digits
        for (n, d, expected) in
            [(2, 3, 3.277246613199), (4, 6, 4.65007831702905), (1, 5, 3.327235743604), (10, 15, 7.2760921524526)]
        {
            check(wishart_quantile(n, d, 0.05, 1, &stop).map(f64::sqrt), expected);
        }
        for (n, d, nu, expected) in
            [(1, 3, 9, 1.287516119208), (2, 3, 9, 0.751702538693), (4, 6, 34, 0.166390274969643)]
        {
            check(scalar_quantile(n, d, nu, 0.05, 1, &stop), expected);
        }
    }

    /// Between the exact laws and the draws of the same roots: frequencies within 4.5 standard deviations.
    #[test]
    fn the_beta_model_and_the_exact_law_agree() {
        let stop = Stop::new();
        let rate = |over: usize, of: usize| {
            let deviation = (over as f64 - 0.05 * of as f64) / (of as f64 * 0.0475).sqrt();
            assert!(deviation.abs() < 4.5, "{over} of {of}");
        };
        for (n, d, nu) in [(1, 3, 9), (2, 3, 9), (4, 6, 34), (6, 2, 20), (3, 3, 3), (20, 22, 200)] {
            let q = roy_quantile(n, d, nu, 0.05, 1, &stop).unwrap();
            let drawn = roots(n, d, nu, 20_000, 1, &stop).unwrap();
            rate(drawn.iter().filter(|r| r[0] > q).count(), 20_000);
        }
        let q = wishart_quantile(3, 5, 0.05, 1, &stop).unwrap();
        let drawn = largest_of_gaussian(3, 5, None, 20_000, 1, &stop).unwrap();
        rate(drawn.iter().filter(|r| r[0] > q).count(), 20_000);
        let a = smallest_quantile(4, 34, 0.05, 1, &stop).unwrap();
        let drawn = smallest_wishart_root(4, 34, 20_000, 1, &stop).unwrap();
        rate(drawn.iter().filter(|r| r[0] < a).count(), 20_000);
        let (spectral, frobenius) = joint_radii(4, 6, 34, 0.05, 1, &stop).unwrap();
        let drawn = roots(4, 6, 34, 20_000, 1, &stop).unwrap();
        rate(drawn.iter().filter(|r| r[0] > spectral.powi(2) || r[1] > frobenius.powi(2)).count(), 20_000);
    }

    #[test]
    fn order_statistics() {
        assert_eq!(order_quantile((1..20).map(f64::from), 0.05), Ok(19.0));
        assert_eq!(order_quantile((1..19).map(f64::from), 0.05), Ok(f64::INFINITY));
        assert!(
            (log_multigamma(5.0, 2) - (ln_gamma(5.0) + ln_gamma(4.5) + std::f64::consts::PI.ln() / 2.0)).abs() < 1e-14
        );
    }
}
