//! The laws of the extreme roots of `E_nu^-1 G G'` (Roy 1953) and of `G G'`, `G` (p, d) standard normal, exactly.
//!
//! The largest root of a density with weight `w` is at most `theta` with a probability that is a Pfaffian of (de Bruijn
//! 1955)
//!
//! ```text
//! A_ij = int int_{0 < x, y < theta} x^(i-1) y^(j-1) sign(y - x) w(x) w(y) dx dy,
//! ```
//!
//! for odd p bordered by `int x^(i-1) w`. In powers of `x` the rows are nearly dependent; another basis of polynomials
//! only changes the Pfaffian by its leading coefficients, and in those orthonormal for `w^2 dx/dt` nothing cancels.
//! With `x = sin(t)^2` (Roy) or `t^2` (Wishart) everything is analytic, so that the rule of Gauss and Legendre is exact
//! to rounding. With `c_l` the coefficients of the functions in Legendre's polynomials (times `2 / (2 l + 1)`), and
//! since the integral of `P_l` is `(P_{l+1} - P_{l-1}) / (2 l + 1)`,
//!
//! ```text
//! A_ij = sum_l c_li c_{l+1,j} - c_lj c_{l+1,i}.
//! ```

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

use statrs::function::gamma::ln_gamma;

use crate::error::Result;
use crate::memory::{checked_len, try_zeros};

use super::legendre::Rule;

const WHAT: &str = "the law of a largest root";

/// `P(lam / (1 + lam) <= theta)` for the largest root `lam` of `E_nu^-1 G G'`, `nu >= p`.
pub(super) struct Roy(Law);

/// `P(above <= all roots of G G' <= x)`.
pub(super) struct Wishart(Law);

struct Law {
    p: usize,
    /// Powers of the weight: `sin^b cos^a` or `t^b exp(-t^2)`.
    a: f64,
    b: f64,
    /// Three-term recurrence of the orthonormal polynomials in `s`:
    /// `next_{i+1} q_{i+1} = (s - middle_i) q_i - next_i q_{i-1}`.
    middle: Vec<f64>,
    next: Vec<f64>,
    /// Logarithm of the norm of the weight itself, and of what the Pfaffian is to be multiplied by.
    log_norm: f64,
    log_scale: f64,
    /// All roots are in this range of `t`, but for 1e-17.
    range: (f64, f64),
    rule: Rule,
}

/// `log (pi^(p/2) / prod_r Gamma(r/2) Gamma((d - p + r)/2))`, the part of the constants that both laws share.
fn shared(p: usize, d: usize) -> f64 {
    let part = |r: usize| ln_gamma(r as f64 / 2.0) + ln_gamma((d - p + r) as f64 / 2.0);
    p as f64 / 2.0 * PI.ln() - (1..=p).map(part).sum::<f64>()
}

/// `log (Gamma(z + halves / 2) / Gamma(z))` without the cancellation of two large logarithms.
fn ln_gamma_ratio(z: f64, halves: usize) -> f64 {
    let whole = (0..halves / 2).map(|k| (z + k as f64).ln()).sum::<f64>();
    let z = z + (halves / 2) as f64;
    whole
        + match halves % 2 {
            0 => 0.0,
            _ if z < 50.0 => ln_gamma(z + 0.5) - ln_gamma(z),
            // Stirling's series; the next term is 17 / (14336 z^7)
            _ => 0.5 * z.ln() - 1.0 / (8.0 * z) + 1.0 / (192.0 * z.powi(3)) - 1.0 / (640.0 * z.powi(5)),
        }
}

/// Bounds of the singular values of a Gaussian matrix with `p` rows: `9` below `sqrt(cols) - sqrt(p)` and `9` beyond
/// `sqrt(cols) + sqrt(p)`, wrong with probability 3e-18 each (Davidson and Szarek 2001).
fn singular_values(p: usize, cols: usize) -> (f64, f64) {
    let (p, cols) = ((p as f64).sqrt(), (cols as f64).sqrt());
    ((cols - p - 9.0).max(0.0), cols + p + 9.0)
}

impl Roy {
    pub(super) fn new(n: usize, d: usize, nu: usize) -> Result<Self> {
        // the roots of (p, d, nu) are those of (d, p, nu + d - p)
        let (p, d, nu) = if n > d { (d, n, nu + d - n) } else { (n, d, nu) };
        let (a, b) = ((nu - p) as f64, (d - p) as f64);
        let (mut middle, mut next) = (try_zeros(WHAT, p)?, try_zeros(WHAT, p)?);
        // Jacobi's for (2 - s)^a s^b on [0, 2] (Gautschi 2004, table 1.1, moved by 1)
        for i in 0..p {
            let (k, sum) = (i as f64, a + b + 2.0 * i as f64);
            let moved = (2.0 * k + b) * (sum + a) + 2.0 * sum + b * b;
            middle[i] = if i == 0 { 2.0 * (b + 1.0) / (a + b + 2.0) } else { moved / (sum * (sum + 2.0)) };
            next[i] = match i {
                0 => 0.0,
                1 => 4.0 * (1.0 + a) * (1.0 + b) / ((2.0 + a + b).powi(2) * (3.0 + a + b)),
                _ => 4.0 * k * (k + a) * (k + b) * (k + a + b) / (sum * sum * (sum + 1.0) * (sum - 1.0)),
            }
            .sqrt();
        }
        // prod_r Gamma((nu + d - p + r)/2) / Gamma((nu - p + r)/2)
        let own: f64 = (1..=p).map(|r| ln_gamma_ratio((nu - p + r) as f64 / 2.0, d)).sum();
        let log_norm = ln_gamma(b + 1.0) - ln_gamma_ratio(a + 1.0, 2 * (d - p + 1));
        // lam <= ||G||^2 / lam_min(E) = tan(end)^2
        let (least, _) = singular_values(p, nu);
        let end = (singular_values(p, d).1 / least).atan();
        let nodes = 40 + 2 * p + (6.0 * ((nu + d) as f64).sqrt() * end / FRAC_PI_2) as usize;
        Ok(Self(Law::new(p, (a, b), (middle, next), log_norm, shared(p, d) + own, (0.0, end), nodes)?))
    }

    pub(super) fn below(&self, theta: f64) -> Result<f64> {
        let (a, b) = (self.0.a, self.0.b);
        self.0.pfaffian(0.0, theta.sqrt().asin(), |t| {
            // w dx = 2 sin^b cos^a dt
            let squared = t.sin().powi(2);
            let power = if b == 0.0 { 0.0 } else { b / 2.0 * squared.ln() };
            (2.0 * squared, power + a / 2.0 * (-squared).ln_1p())
        })
    }
}

impl Wishart {
    pub(super) fn new(n: usize, d: usize) -> Result<Self> {
        let (p, d) = (n.min(d), n.max(d));
        let b = (d - p) as f64;
        let (mut middle, mut next) = (try_zeros(WHAT, p)?, try_zeros(WHAT, p)?);
        // Laguerre's for s^b exp(-s), s = 2 y
        for i in 0..p {
            let k = i as f64;
            (middle[i], next[i]) = (2.0 * k + b + 1.0, (k * (k + b)).sqrt());
        }
        let log_norm = ln_gamma(b + 1.0) - (b + 1.0) * 2f64.ln();
        let (least, most) = singular_values(p, d);
        let nodes = 40 + 2 * p + (6.0 * (d as f64).sqrt().min(most - least)) as usize;
        let range = (least * FRAC_1_SQRT_2, most * FRAC_1_SQRT_2);
        Ok(Self(Law::new(p, (0.0, b), (middle, next), log_norm, shared(p, d), range, nodes)?))
    }

    pub(super) fn between(&self, above: f64, x: f64) -> Result<f64> {
        let b = self.0.b;
        self.0.pfaffian((above / 2.0).sqrt(), (x / 2.0).sqrt(), |t| {
            // y = x / 2 = t^2,  w dy = 2 t^b exp(-t^2) dt
            (2.0 * t * t, if b == 0.0 { 0.0 } else { b * t.ln() } - t * t)
        })
    }
}

impl Law {
    fn new(
        p: usize,
        (a, b): (f64, f64),
        (middle, next): (Vec<f64>, Vec<f64>),
        log_norm: f64,
        constant: f64,
        range: (f64, f64),
        nodes: usize,
    ) -> Result<Self> {
        // leading coefficients in x, of which s is twice: k_i = k_{i-1} 2 / next_i from k_0 = exp(-log_norm / 2)
        let mut log_lead = -log_norm / 2.0;
        let mut log_scale = constant - log_lead;
        for next in next.iter().skip(1) {
            log_lead += (2.0 / next).ln();
            log_scale -= log_lead;
        }
        Ok(Self { p, a, b, middle, next, log_norm, log_scale, range, rule: Rule::new(nodes)? })
    }

    /// `exp(log_scale) Pf(A)` with the weight `t -> (s, log w)`, but for the factor 2 of `dx/dt`, between two points.
    fn pfaffian(&self, from: f64, to: f64, weight: impl Fn(f64) -> (f64, f64)) -> Result<f64> {
        let (from, to) = (from.max(self.range.0), to.min(self.range.1));
        if from >= to {
            return Ok(0.0);
        }
        let (p, nodes, half) = (self.p, self.rule.nodes.len(), (to - from) / 2.0);
        let mut coefficients: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, nodes, p)?)?;
        let mut values = try_zeros(WHAT, p)?;
        for (q, (x, w)) in self.rule.nodes.iter().zip(&self.rule.weights).enumerate() {
            let (s, log_w) = weight(from + half * (x + 1.0));
            values[0] = 2.0 * half * w * (log_w - self.log_norm / 2.0).exp();
            for i in 1..p {
                let back = if i > 1 { self.next[i - 1] * values[i - 2] } else { 0.0 };
                values[i] = ((s - self.middle[i - 1]) * values[i - 1] - back) / self.next[i];
            }
            let legendre = &self.rule.legendre[q * nodes..(q + 1) * nodes];
            for (value, line) in values.iter().zip(coefficients.chunks_exact_mut(nodes)) {
                line.iter_mut().zip(legendre).for_each(|(c, l)| *c += value * l);
            }
        }
        let size = p + p % 2;
        let mut skew = try_zeros(WHAT, size * size)?;
        for i in 0..p {
            let first = &coefficients[i * nodes..(i + 1) * nodes];
            for j in i + 1..p {
                let second = &coefficients[j * nodes..(j + 1) * nodes];
                let pairs = first.windows(2).zip(second.windows(2));
                let entry = pairs.map(|(f, s)| f[0] * s[1] - s[0] * f[1]).sum::<f64>();
                (skew[i * size + j], skew[j * size + i]) = (entry, -entry);
            }
            if p % 2 == 1 {
                (skew[i * size + p], skew[p * size + i]) = (first[0], -first[0]);
            }
        }
        let (positive, log) = log_determinant(&mut skew, size);
        Ok(if positive { (self.log_scale + log / 2.0).exp() } else { 0.0 })
    }
}

/// Whether the determinant of the `n x n` matrix is positive, and the logarithm of its size: elimination with pivots.
fn log_determinant(a: &mut [f64], n: usize) -> (bool, f64) {
    let (mut positive, mut log) = (true, 0.0);
    for j in 0..n {
        let larger = |&x: &usize, &y: &usize| a[x * n + j].abs().total_cmp(&a[y * n + j].abs());
        let pivot = (j..n).max_by(larger).unwrap_or(j);
        if pivot != j {
            (0..n).for_each(|k| a.swap(j * n + k, pivot * n + k));
            positive = !positive;
        }
        let (done, below) = a.split_at_mut((j + 1) * n);
        let row = &done[j * n..];
        positive ^= row[j] < 0.0;
        log += row[j].abs().ln();
        for line in below.chunks_exact_mut(n) {
            let factor = line[j] / row[j];
            (j + 1..n).for_each(|k| line[k] -= factor * row[k]);
        }
    }
    (positive && log > f64::NEG_INFINITY, log)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() <= tolerance * expected.abs(), "{found:.16} is not {expected:.16}");
    }

    #[test]
    fn roy_in_closed_form_and_at_the_end() {
        let law = Roy::new(2, 3, 9).unwrap();
        close(law.below(0.5).unwrap(), 367.0 / 512.0, 1e-13);
        close(law.below(0.3).unwrap(), 0.311376393, 1e-12);
        let cases = [
            (1, 4, 9),
            (2, 3, 9),
            (2, 3, 3),
            (4, 2, 20),
            (5, 5, 5),
            (10, 15, 100),
            (20, 22, 200),
            (40, 45, 500),
            (10, 15, 2000),
        ];
        for (p, d, nu) in cases {
            close(Roy::new(p, d, nu).unwrap().below(1.0).unwrap(), 1.0, 1e-10);
            close(Wishart::new(p, d).unwrap().between(0.0, f64::INFINITY).unwrap(), 1.0, 1e-11);
        }
        // 50 digits of the form in powers
        let q = 0.684817207726018;
        close(Roy::new(10, 15, 100).unwrap().below(q / (1.0 + q)).unwrap(), 0.95, 2e-12);
        close(Wishart::new(10, 15).unwrap().between(0.0, 7.2760921524526f64.powi(2)).unwrap(), 0.95, 2e-12);
    }

    #[test]
    fn many_degrees_of_freedom() {
        // nu lam tends to the root of G G', with an error of order 1 / nu
        let q = 7.2760921524526f64.powi(2);
        let rest = |nu: usize| Roy::new(10, 15, nu).unwrap().below(q / (q + nu as f64)).unwrap() - 0.95;
        assert!((rest(1_000_000) * 10.0 / rest(100_000) - 1.0).abs() < 1e-3);
        let law = Wishart::new(10, 1_000_000).unwrap();
        close(law.between(0.0, f64::INFINITY).unwrap(), 1.0, 1e-6);
        for (z, halves) in [(0.5, 3), (49.0, 5), (51.0, 5), (51.5, 1), (60.0, 4)] {
            close(ln_gamma_ratio(z, halves), ln_gamma(z + halves as f64 / 2.0) - ln_gamma(z), 1e-12);
        }
    }

    #[test]
    fn one_row_is_beta_and_chi_square() {
        // p = 1: P(chi2_4 <= x) = 1 - (1 + x/2) exp(-x/2)
        let x = 3.7f64;
        let expected = 1.0 - (1.0 + x / 2.0) * (-x / 2.0).exp();
        close(Wishart::new(1, 4).unwrap().between(0.0, x).unwrap(), expected, 1e-13);
        close(Wishart::new(4, 1).unwrap().between(x, f64::INFINITY).unwrap(), 1.0 - expected, 1e-13);
    }
}
