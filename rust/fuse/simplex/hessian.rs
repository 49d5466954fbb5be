//! The Hessian of the homogenised problem on some of the samples: products, and a Cholesky factor when there are few of them.

use super::factor::Factor;
use super::operator::Operator;
use super::vector::{axpy, dot, sum};

/// Free samples above which no factor is computed (64 MB of packed triangle).
pub(crate) const LARGEST_FACTOR: usize = 4000;

/// What a factor of size `k` costs, in entries touched by a pass: `k^3 / 3` fused operations and the Gram matrix.
pub(crate) fn factor_cost(k: usize, entries: usize) -> f64 {
    let k = k as f64;
    k * k * (k / 12.0 + 0.5 * entries as f64)
}

/// `H = (S - q 1^T)^T (S - q 1^T) + kappa 11^T` on the free samples.
pub(crate) struct Hessian<'a, O: Operator> {
    pub sub: &'a O,
    pub q: &'a [f64],
    pub kappa: f64,
}

impl<O: Operator> Hessian<'_, O> {
    /// `out = H v`; `image` is scratch space.
    pub fn apply(&self, v: &[f64], image: &mut [f64], out: &mut [f64]) {
        // H v = S^T x - <q, x> 1 + kappa (1^T v) 1,   x = S v - (1^T v) q
        let total = sum(v);
        self.sub.apply(v, image);
        axpy(-total, self.q, image);
        self.sub.apply_transpose(image, out);
        let constant = self.kappa * total - dot(self.q, image);
        for h in out {
            *h += constant;
        }
    }

    /// Cholesky factor of `H`, lifted a little where it is singular; `images = S^T q`.
    pub fn factor(&self, images: &[f64], qq: f64) -> Option<Factor> {
        let k = images.len();
        let mut table = vec![0.0; self.sub.dim()];
        let mut matrix = Vec::with_capacity(k * (k + 1) / 2);
        let mut largest = 0.0_f64;
        for (i, a) in images.iter().enumerate() {
            // H_ik = <E_i, E_k> - <E_i, q> - <E_k, q> + ||q||^2 + kappa
            let start = matrix.len();
            matrix.resize(start + i + 1, 0.0);
            let line = &mut matrix[start..];
            self.sub.gram_row(i, &mut table, line);
            for (h, b) in line.iter_mut().zip(images) {
                *h += (qq - b) - a + self.kappa;
            }
            largest = largest.max(line[i]);
        }
        for ridge in [1e-13, 1e-11, 1e-8] {
            let mut lifted = matrix.clone();
            for i in 0..k {
                lifted[i * (i + 1) / 2 + i] += ridge * largest;
            }
            if let Some(factor) = Factor::new(lifted, k) {
                return Some(factor);
            }
        }
        None
    }
}
