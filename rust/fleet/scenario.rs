//! The risk of a design over `size` sampled units, at confidence `1 - beta`: each in a few binomial tails, O(1) in the
//! size.

use super::binomial::{Odds, log_choose, log_pmf, log_tails};
use crate::error::{Error, Result};
use crate::identify::{level, positive_root, root};

/// `e` where the falling `f` changes its sign; the search begins at `start`.
fn falling(start: f64, f: impl Fn(Odds) -> f64) -> Result<f64> {
    positive_root(start, |y| -f(Odds::new(y))).map(|y| y / (1.0 + y))
}

/// Where to begin: the odds of `k + 1` in `size`.
fn near(size: f64, k: f64) -> f64 {
    (k + 1.0) / (size - k)
}

/// `e` with `ln P(Bin(size, e) <= most) = log_level < 0`; 1 if `most >= size`.
fn limit(size: f64, most: f64, log_level: f64) -> Result<f64> {
    if most >= size {
        return Ok(1.0);
    }
    falling(near(size, most), |odds| log_tails(size, most, odds).0 - log_level)
}

/// `P(Bin(size, e) <= most) = beta`: with `most = d - 1` before the data (Campi, Garatti 2008), with the violations of
/// fresh units after them (Clopper, Pearson 1934).
///
/// # Errors
/// [`Error::Value`] for a `beta` outside (0, 1).
pub fn at_most(size: usize, most: usize, beta: f64) -> Result<f64> {
    level("beta", beta)?;
    limit(size as f64, most as f64, beta.ln())
}

/// `C(r + d - 1, r) P(Bin(size, e) <= r + d - 1) = beta`, after `r` units were left out (Campi, Garatti 2011).
///
/// # Errors
/// [`Error::Value`] for a `beta` outside (0, 1).
pub fn discarding(size: usize, discarded: usize, dimension: usize, beta: f64) -> Result<f64> {
    level("beta", beta)?;
    let (r, most) = (discarded as f64, discarded as f64 + dimension as f64 - 1.0);
    limit(size as f64, most, beta.ln() - log_choose(most, r))
}

/// `beta / (N + 1) sum_{m=k}^N C(m, k) t^(m-k) = C(N, k) t^(N-k)`, `e = 1 - t` (Campi, Garatti 2018).
///
/// The sum is `e^-(k+1) P(Bin(N + 1, e) >= k + 1)`: the number of trials up to success `k + 1`.
///
/// # Errors
/// [`Error::Value`] for a `beta` outside (0, 1).
pub fn judged(size: usize, support: usize, beta: f64) -> Result<f64> {
    level("beta", beta)?;
    let (n, k, log_beta) = (size as f64, support as f64, beta.ln());
    if support >= size {
        return Ok(1.0);
    }
    // (k + 1) P(Bin(N + 1, e) = k + 1) = beta P(Bin(N + 1, e) >= k + 1)
    falling(near(n, k), |odds| {
        (k + 1.0).ln() + log_pmf(n + 1.0, k + 1.0, odds) - log_beta - log_tails(n + 1.0, k, odds).1
    })
}

/// `C(N, k) P(Bin(N - k, e) <= r) = beta / N` for a command that k of N units give, and a threshold that at most r of
/// the others miss more than (Floyd, Warmuth 1995).
///
/// # Errors
/// [`Error::Value`] for a `beta` outside (0, 1).
pub fn compression(size: usize, support: usize, violations: usize, beta: f64) -> Result<f64> {
    level("beta", beta)?;
    let (n, k, r) = (size as f64, support as f64, violations as f64);
    if support >= size {
        return Ok(1.0);
    }
    limit(n - k, r, beta.ln() - n.ln() - log_choose(n, k))
}

/// The two roots around `t = 1 - k/N` of `C(N, k) t^(N-k) = beta / 2N sum_{i=k}^{N-1} C(i, k) t^(i-k) + beta / 6N
/// sum_{i=N+1}^{4N} C(i, k) t^(i-k)`, `e = 1 - t` (Garatti, Campi 2022): bounds of the risk from below and from above.
///
/// # Errors
/// [`Error::Value`] for a `beta` outside (0, 1).
pub fn relaxed(size: usize, support: usize, beta: f64) -> Result<(f64, f64)> {
    level("beta", beta)?;
    let (n, k) = (size as f64, support.min(size) as f64);
    let (half, sixth) = ((beta / (2.0 * n)).ln(), (beta / (6.0 * n)).ln());
    let last = 4.0 * n + 1.0;
    // times e^(k+1): ln of the right side less ln of the left side, negative between the roots
    let f = |odds: Odds| {
        // P(Bin(4N + 1, e) >= k + 1) - P(Bin(N + 1, e) >= k + 1), from the tails that are small
        let (later, sooner) = (log_tails(last, k, odds), log_tails(n + 1.0, k, odds));
        let (more, less) = if last * odds.e < k { (later.1, sooner.1) } else { (sooner.0, later.0) };
        let second = sixth + more + (-(less - more).exp()).ln_1p();
        let first = half + log_tails(n, k, odds).1;
        let (high, low) = if first > second { (first, second) } else { (second, first) };
        high + (low - high).exp().ln_1p() - odds.log_e - log_pmf(n, k, odds)
    };
    let odds = |y: f64| f(Odds::new(y));
    let (middle, upper) = if k >= n {
        (1e15, 1.0)
    } else {
        let (middle, mut high) = (k.max(1e-3) / (n - k), near(n, k));
        while odds(high) < 0.0 && high < f64::MAX {
            high *= 2.0;
        }
        let y = root((middle, odds(middle)), (high, odds(high)), odds)?;
        (middle, y / (1.0 + y))
    };
    // at e = 0 the sums are C(N, k+1) and C(4N+1, k+1) - C(N+1, k+1)
    let smallest = 1e-12 * middle.min(1.0);
    let lower = if k == 0.0 || odds(smallest) <= 0.0 {
        0.0
    } else {
        let (mut low, mut high) = (middle, middle);
        while odds(low) < 0.0 {
            (low, high) = ((low / 2.0).max(smallest), low);
        }
        let y = root((low, odds(low)), (high, odds(high)), odds)?;
        y / (1.0 + y)
    };
    Ok((lower, upper))
}

/// The smallest rank j with `P(Bin(size, delta) <= size - j) <= beta`, `size + 1` if there is none: so many runs,
/// counted from the best, make a share of at most delta of all runs worse but with probability beta.
///
/// # Errors
/// [`Error::Value`] for a `beta` outside (0, 1).
pub fn rank(size: usize, delta: f64, beta: f64) -> Result<usize> {
    let (mut low, mut high) = (0, size); // the rank is size + 1 - low
    while low < high {
        let above = usize::midpoint(low, high);
        if at_most(size, above, beta)? <= delta {
            low = above + 1;
        } else {
            high = above;
        }
    }
    Ok(size + 1 - low)
}

/// The smallest size for which `at_most(size, dimension - 1, beta) <= epsilon`.
///
/// # Errors
/// [`Error::Value`] for an `epsilon` or a `beta` outside (0, 1), and where the size exceeds 2^53.
pub fn required(epsilon: f64, dimension: usize, beta: f64) -> Result<usize> {
    level("epsilon", epsilon)?;
    level("beta", beta)?;
    const MOST: usize = if usize::BITS > 53 { (1_u64 << 53) as usize } else { usize::MAX / 2 };
    let (odds, log_beta) = (Odds::new(epsilon / (1.0 - epsilon)), beta.ln());
    let enough = |size: usize| log_tails(size as f64, dimension as f64 - 1.0, odds).0 <= log_beta;
    let (mut low, mut high) = (dimension.saturating_sub(1), dimension);
    while !enough(high) {
        if high >= MOST {
            let found = format!("{epsilon:e}");
            return Err(Error::Value { name: "epsilon", expected: "reached by at most 2^53 units", found });
        }
        (low, high) = (high, 2 * high);
    }
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if enough(middle) { high = middle } else { low = middle }
    }
    Ok(high)
}
