//! The Hessian of the homogenised problem on the free samples: products, and a Cholesky factor if they are few.

use super::budget::Budget;
use super::factor::{self, Factor};
use super::operator::Operator;
use super::problem::SEARCH;
use super::triangle::Triangle;
use crate::error::Result;
use crate::memory::try_zeros;
use crate::vector::{axpy, dot, sum};

/// Cost of the factor of `H` on `k` samples, with its Gram matrix, in indices touched by a pass.
pub(crate) fn factor_cost(k: usize, entries: usize) -> f64 {
    factor::factor_cost(k) + 0.5 * (k * k) as f64 * entries as f64
}

/// `H = (S - q 1^T)^T (S - q 1^T) + kappa 11^T` on the free samples.
pub(crate) struct Hessian<'a> {
    pub sub: &'a dyn Operator,
    pub q: &'a [f64],
    pub kappa: f64,
}

impl Hessian<'_> {
    /// `out = H v`; `image` is scratch space.
    pub fn apply(&self, v: &[f64], image: &mut [f64], out: &mut [f64]) -> Result<()> {
        // H v = S^T x - <q, x> 1 + kappa (1^T v) 1,   x = S v - (1^T v) q
        let total = sum(v);
        self.sub.apply(v, image)?;
        axpy(-total, self.q, image);
        self.sub.apply_transpose(image, out)?;
        let constant = self.kappa * total - dot(self.q, image);
        for h in out {
            *h += constant;
        }
        Ok(())
    }

    /// Cholesky factor of `H`, shifted slightly if `H` is singular; `images = S^T q`. `None` also if a limit is
    /// reached.
    pub fn factor(&self, images: &[f64], qq: f64, budget: &mut Budget) -> Result<Option<Factor>> {
        for ridge in [1e-13, 1e-11, 1e-8] {
            let Some(mut matrix) = self.matrix(images, qq, budget)? else { return Ok(None) };
            let largest = (0..matrix.size()).fold(0.0_f64, |m, i| m.max(matrix.row_mut(i)[i]));
            for i in 0..matrix.size() {
                matrix.row_mut(i)[i] += ridge * largest;
            }
            let factor = Factor::new(matrix, budget)?;
            if factor.is_some() || budget.exhausted() {
                return Ok(factor);
            }
        }
        Ok(None)
    }

    fn matrix(&self, images: &[f64], qq: f64, budget: &mut Budget) -> Result<Option<Triangle>> {
        let mut table = try_zeros(SEARCH, self.sub.dim())?;
        let Some(mut matrix) = Triangle::zeros(images.len()) else { return Ok(None) };
        for (i, a) in images.iter().enumerate() {
            // H_ik = <E_i, E_k> - <E_i, q> - <E_k, q> + ||q||^2 + kappa
            let line = matrix.row_mut(i);
            self.sub.gram_row(i, &mut table, line);
            for (h, b) in line.iter_mut().zip(images) {
                *h += (qq - b) - a + self.kappa;
            }
            if budget.charge(1, i, self.sub.entries()) {
                return Ok(None);
            }
        }
        Ok(Some(matrix))
    }
}
