//! Error-free transformations and the sums built on them (Ogita, Rump, Oishi, SIAM J. Sci. Comput. 26, 2005).

/// `(s, e)` with `s = fl(a + b)` and `s + e = a + b` exactly (Knuth).
#[inline(always)]
pub(crate) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let t = s - a;
    (s, (a - (s - t)) + (b - t))
}

/// `(p, e)` with `p = fl(a b)` and `p + e = a b` exactly (Veltkamp, Dekker), barring over- and underflow.
#[inline(always)]
pub(crate) fn two_product(a: f64, b: f64) -> (f64, f64) {
    let (p, (ah, al), (bh, bl)) = (a * b, split(a), split(b));
    (p, al * bl - (((p - ah * bh) - al * bh) - ah * bl))
}

#[inline(always)]
fn split(a: f64) -> (f64, f64) {
    let c = 134_217_729.0 * a; // 2^27 + 1
    let high = c - (c - a);
    (high, a - high)
}

/// A sum kept as `high + low`: as if computed in twice the precision.
#[derive(Clone, Copy, Default)]
pub(crate) struct Sum {
    high: f64,
    low: f64,
}

impl Sum {
    pub fn add(&mut self, a: f64) {
        let (s, e) = two_sum(self.high, a);
        self.high = s;
        self.low += e;
    }

    pub fn add_product(&mut self, a: f64, b: f64) {
        let (p, e) = two_product(a, b);
        self.add(p);
        self.low += e;
    }

    /// The value as an unevaluated pair with `|low| <= ulp(high) / 2`.
    pub fn pair(self) -> (f64, f64) {
        two_sum(self.high, self.low)
    }

    pub fn value(self) -> f64 {
        self.high + self.low
    }
}

/// `<x, y>` as an unevaluated pair.
pub(crate) fn dot(x: &[f64], y: &[f64]) -> (f64, f64) {
    let mut sum = Sum::default();
    for (&a, &b) in x.iter().zip(y) {
        sum.add_product(a, b);
    }
    sum.pair()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancelling_sum_keeps_what_plain_arithmetic_loses() {
        let (high, low) = dot(&[1e17, 1.0, -1e17], &[1.0, 1.0, 1.0]);
        assert_eq!(high + low, 1.0);
    }

    #[test]
    fn the_product_error_is_exact() {
        let (p, e) = two_product(1.0 + f64::EPSILON, 1.0 - f64::EPSILON);
        assert_eq!((p, e), (1.0, -f64::EPSILON * f64::EPSILON));
    }
}
