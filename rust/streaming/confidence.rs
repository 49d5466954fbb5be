//! A confidence radius of a running mean that holds for all numbers of realizations at once.
//!
//! *Mean.* With `S_n = sum_i (E_i - mu)`, `||E_i - mu|| <= R` and `V = E ||E - mu||^2`,
//! `cosh(lam ||S_n||) exp(-n V psi(lam))` is a supermartingale in any Hilbert space,
//! `psi(lam) = lam^2 / (2 (1 - lam R / 3))` (Pinelis 1994, proof of theorem 3.2 with D = 1, and
//! `e^x - 1 - x <= x^2 / (2 (1 - x / 3))`). As `cosh(x) >= e^x / 2`, Ville's inequality gives
//! `||S_n|| < (l + n V psi(lam)) / lam` for all n, except with probability `2 e^-l`. With
//! `1 / lam = R / 3 + sqrt(m V / (2 l))` that is `||S_n|| < R l / 3 + w sqrt(2 l V n)`,
//! `w = (sqrt(n / m) + sqrt(m / n)) / 2`: at n = m Bernstein's inequality for one size.
//!
//! *Variance.* `Q_n = sum_i ||E_i - mu||^2` has terms Y in [0, R^2] with `E Y^2 <= R^2 V`, so
//! `E exp(-lam Y) <= exp(-lam V + lam^2 R^2 V / 2)`, and by Ville's inequality with `lam = sqrt(2 l / (m V R^2))`:
//! `V - Q_n / n < 2 beta sqrt(V)` for all n, except with probability `e^-l`, with `beta = w R sqrt(l / (2 n))`. And
//! `Q_n / n = D^2 / n + ||S_n / n||^2`, `D^2 = sum_i ||E_i - mean||^2`.
//!
//! *Both.* `sigma = sqrt(V)` and `x = ||S_n / n||` satisfy `x <= alpha + gamma sigma` and
//! `sigma^2 - 2 beta sigma <= D^2 / n + x^2`; the largest such sigma solves a quadratic equation. Also,
//! `2 V = E ||E - E'||^2 <= R^2`.
//!
//! *All sizes.* Epoch k = 1, 2, ... is `4^k <= n < 4^(k+1)`; it has m = 2 4^k, so w < 1.07, and `delta / (k (k + 1))`,
//! in total delta.

/// Share of delta for the bound on the mean; the bound on the variance has the rest. About the best choice for n > 100.
const SHARE: f64 = 0.75;

/// Bounds `||mean - mu||` for all numbers of realizations at once, of which there are `count`.
///
/// `deviation` is D and `diameter` R with `||E - E'|| <= R`. The bound is tightest at `size` realizations, which must
/// not depend on the data; without it, it is nearly as tight at every number.
#[must_use]
pub fn mean_radius(count: u64, deviation: f64, diameter: f64, delta: f64, size: Option<u64>) -> f64 {
    let epoch = count.checked_ilog2().unwrap_or(0) / 2;
    let (m, delta) = match size {
        _ if count == 0 => return f64::INFINITY,
        _ if count == 1 || diameter == 0.0 => return diameter,
        Some(size) => (size as f64, delta),
        None if epoch == 0 => return diameter,
        None => (2.0 * f64::from(2 * epoch).exp2(), delta / f64::from(epoch * (epoch + 1))),
    };
    let n = count as f64;
    let w = ((n / m).sqrt() + (m / n).sqrt()) / 2.0;
    let (log_mean, log_variance) = ((2.0 / (SHARE * delta)).ln(), -((1.0 - SHARE) * delta).ln());
    // x <= alpha + gamma sigma
    let (alpha, gamma) = (diameter * log_mean / (3.0 * n), w * (2.0 * log_mean / n).sqrt());
    let beta = w * diameter * (log_variance / (2.0 * n)).sqrt();
    let mut sigma = diameter / 2f64.sqrt();
    if gamma < 1.0 {
        // (1 - gamma^2) sigma^2 - 2 (beta + alpha gamma) sigma - (D^2 / n + alpha^2) <= 0
        let (half, rest) = (beta + alpha * gamma, 1.0 - gamma * gamma);
        let last = rest.sqrt() * (deviation / n.sqrt()).hypot(alpha);
        sigma = sigma.min((half + half.hypot(last)) / rest);
    }
    (alpha + gamma * sigma).min(diameter)
}
