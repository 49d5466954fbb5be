//! The input with the smallest certificate of one step: `||H z - xf|| + beta ||z||_{V^-1}`, `z = (x0, u)`.
//!
//! With `H z - xf = G u + a` and `white z = L u + b` this is a sum of two norms. A minimiser with both norms positive has
//!
//! ```text
//! G'(G u + a) + lambda L'(L u + b) = 0,  lambda = beta ||G u + a|| / ||L u + b||,
//! ```
//!
//! so it minimises `||G u + a||^2 + lambda ||L u + b||^2`; if a norm is 0, it is the limit for `lambda` to 0 or to
//! infinity. Along these minimisers the second norm falls and `lambda ||L u + b|| / ||G u + a||` rises, since the smallest
//! first norm is a convex function of the second. What is left is a bisection for `lambda`.
//!
//! `[G; L] = Q R` with `Q = [Q1; Q2]` orthonormal: the right singular vectors of `Q1` make `Q1' Q1` and
//! `Q2' Q2 = I - Q1' Q1` diagonal at once, so that every `lambda` costs a sum of vectors.

use crate::control::pseudoinverse;
use crate::error::{Error, Result, require_finite};
use crate::fuse::{norm, power_of_two_scale};
use crate::memory::{checked_len, try_collect, try_copy, try_zeros};
use crate::vector::{axpy, dot};

const WHAT: &str = "a robust control";

/// `||sum_i y_i image_i + from||`.
struct Norm {
    /// Images of the directions, one after the other.
    images: Vec<f64>,
    /// The residual where all directions are 0.
    from: Vec<f64>,
    /// `||image_i||^2` and `<image_i, from>`.
    products: Vec<(f64, f64)>,
    residual: Vec<f64>,
}

impl Norm {
    fn new(images: Vec<f64>, from: Vec<f64>) -> Result<Self> {
        let rows = images.chunks_exact(from.len().max(1));
        let products = try_collect(WHAT, rows.map(|image| (dot(image, image), dot(image, &from))))?;
        Ok(Self { images, residual: try_zeros(WHAT, from.len())?, from, products })
    }

    fn at(&mut self, y: &[f64]) -> f64 {
        self.residual.copy_from_slice(&self.from);
        let rows = self.images.chunks_exact(self.from.len().max(1));
        rows.zip(y).for_each(|(image, y)| axpy(*y, image, &mut self.residual));
        norm(self.residual.iter().copied())
    }
}

/// The `u` with the smallest `||H z - xf|| + beta ||white z||`, `z = (x0, u)`, or `(x0, u, 1)` with an `offset`; `H` (n, d),
/// `white` (rank, d). Directions of `u` that change neither norm are not taken.
///
/// # Errors
/// [`Error::Shape`]; [`Error::Value`] unless `0 <= beta < inf`; [`Error::NonFinite`]; [`Error::Overflow`];
/// [`Error::Memory`]; [`Error::Numerical`] where a singular value decomposition fails.
pub fn robust_control(
    model: &[f64],
    white: &[f64],
    x0: &[f64],
    xf: &[f64],
    offset: bool,
    beta: f64,
) -> Result<Vec<f64>> {
    let n = xf.len();
    let d = model.len().checked_div(n).unwrap_or(0);
    let m = d.saturating_sub(x0.len() + usize::from(offset));
    if m == 0 || model.len() != n * d || !white.len().is_multiple_of(d) {
        let found = format!("{} and {} entries", model.len(), white.len());
        let expected = format!("{n} rows and rows of one length, above that of x0");
        return Err(Error::Shape { name: "H, white", expected, found });
    }
    if !(0.0..f64::INFINITY).contains(&beta) {
        return Err(Error::Value { name: "beta", expected: "at least 0 and finite", found: beta.to_string() });
    }
    for (name, values) in [("H", model), ("white", white), ("x0", x0), ("xf", xf)] {
        require_finite(name, values)?;
    }
    // both blocks over their largest entries, then columns of length 1: the basis does not depend on units
    let inputs = x0.len()..x0.len() + m;
    let scale = |rows: &[f64]| power_of_two_scale(rows.chunks_exact(d).flat_map(|row| &row[inputs.clone()]));
    let scales = (scale(model), scale(white));
    let rows = n + white.len() / d;
    let mut stacked = try_zeros(WHAT, checked_len(WHAT, rows, m)?)?;
    let mut fixed = try_zeros(WHAT, rows)?;
    for (k, row) in model.chunks_exact(d).chain(white.chunks_exact(d)).enumerate() {
        let (scale, target) = if k < n { (scales.0, xf[k]) } else { (scales.1, 0.0) };
        stacked[k * m..(k + 1) * m].iter_mut().zip(&row[inputs.clone()]).for_each(|(to, from)| *to = from / scale);
        let constant = if offset { row[d - 1] } else { 0.0 };
        fixed[k] = (dot(&row[..x0.len()], x0) + constant - target) / scale;
    }
    let size = power_of_two_scale(&fixed);
    let ratio = beta * (scales.1 / scales.0);
    if !fixed.iter().all(|v| v.is_finite()) || !ratio.is_finite() {
        return Err(Error::Overflow { what: WHAT });
    }
    fixed.iter_mut().for_each(|v| *v /= size);
    let lengths = try_collect(WHAT, (0..m).map(|j| norm(stacked.iter().skip(j).step_by(m).copied())))?;
    for row in stacked.chunks_exact_mut(m) {
        row.iter_mut().zip(&lengths).for_each(|(v, length)| *v /= if *length > 0.0 { *length } else { 1.0 });
    }
    let basis = pseudoinverse(&stacked, rows, m)?;
    let v = along_the_basis(&basis.basis, basis.rank, &fixed, n, ratio)?;
    // D u = sum_j right_j v_j / sigma_j
    let mut u = try_zeros(WHAT, m)?;
    for (right, (v, sigma)) in basis.right.chunks_exact(m).zip(v.iter().zip(&basis.singular_values)) {
        axpy(v / sigma, right, &mut u);
    }
    u.iter_mut().zip(&lengths).for_each(|(u, length)| *u *= if *length > 0.0 { size / length } else { 0.0 });
    if !u.iter().all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: WHAT });
    }
    Ok(u)
}

/// The `v` with the smallest `||Q1 v + a|| + ratio ||Q2 v + b||`; `vectors` are the `rank` columns of `[Q1; Q2]`, orthonormal,
/// `fixed = (a, b)`, and `a` has `n` entries.
fn along_the_basis(vectors: &[f64], rank: usize, fixed: &[f64], n: usize, ratio: f64) -> Result<Vec<f64>> {
    let rows = fixed.len();
    // Q1 v = 0 and lambda > 0: what is left of Q2' b, for Q2' Q2 = I there
    let mut v = try_zeros(WHAT, rank)?;
    v.iter_mut().zip(vectors.chunks_exact(rows)).for_each(|(v, q)| *v = -dot(&q[n..], &fixed[n..]));
    let mut first = try_zeros(WHAT, checked_len(WHAT, n, rank)?)?;
    for (j, q) in vectors.chunks_exact(rows).enumerate() {
        first.iter_mut().skip(j).step_by(rank).zip(&q[..n]).for_each(|(to, from)| *to = *from);
    }
    if rank == 0 {
        return Ok(v);
    }
    let directions = pseudoinverse(&first, n, rank)?;
    for right in directions.right.chunks_exact(rank) {
        let along = dot(right, &v);
        axpy(-along, right, &mut v);
    }
    let image = |by: &[f64], to: &mut [f64], part: std::ops::Range<usize>| {
        vectors.chunks_exact(rows).zip(by).for_each(|(q, by)| axpy(*by, &q[part.clone()], to));
    };
    let parts = [0..n, n..rows].map(|part| {
        let mut from = try_copy(WHAT, &fixed[part.clone()])?;
        image(&v, &mut from, part.clone());
        let mut images = try_zeros(WHAT, checked_len(WHAT, directions.rank, part.len())?)?;
        for (to, right) in images.chunks_exact_mut(part.len().max(1)).zip(directions.right.chunks_exact(rank)) {
            image(right, to, part.clone());
        }
        Norm::new(images, from)
    });
    let [reach, size] = parts;
    let (mut reach, mut size) = (reach?, size?);
    let mut y = try_zeros(WHAT, directions.rank)?;
    // lambda = 2^low: below 2^-160 and above 2^160 nothing changes, as squared singular values are at least 1e-32
    let (mut low, mut high) = (-160.0, 160.0);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        let lambda = middle.exp2();
        for (i, y) in y.iter_mut().enumerate() {
            let (first, second) = (reach.products[i], size.products.get(i).copied().unwrap_or((0.0, 0.0)));
            *y = -(first.1 + lambda * second.1) / (first.0 + lambda * second.0);
        }
        if lambda * size.at(&y) < ratio * reach.at(&y) {
            low = middle;
        } else {
            high = middle;
        }
    }
    directions.right.chunks_exact(rank).zip(&y).for_each(|(right, y)| axpy(*y, right, &mut v));
    Ok(v)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(found: &[f64], expected: &[f64], tolerance: f64) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= tolerance), "{found:?} is not {expected:?}");
    }

    /// One state, one input, in closed form.
    #[test]
    fn a_scalar_system() {
        // |x0 + u - xf| + beta |(w x0, s u)|: beta^2 s^2 >= 1 keeps u far from the target
        let at =
            |beta, xf: f64| robust_control(&[1.0, 1.0], &[0.5, 0.0, 0.0, 0.1], &[2.0], &[xf], false, beta).unwrap();
        // the reachable target is taken as long as the slope beta s u s / ||..|| is below 1
        close(&at(1.0, 5.0), &[3.0], 1e-13);
        close(&at(0.0, 5.0), &[3.0], 1e-13);
        // slope 1 at s u / sqrt((w x0)^2 + (s u)^2) = 1 / (beta s) = 0.5: s u = w x0 / sqrt(3)
        close(&at(20.0, 50.0), &[10.0 / 3f64.sqrt()], 1e-12);
        close(&at(1e9, 50.0), &[0.0], 1e-6);
    }

    #[test]
    fn degenerate_problems() {
        let none = robust_control(&[0.5, 0.0], &[0.1, 0.0], &[1.0], &[2.0], false, 1.0).unwrap();
        assert_eq!(none, [0.0]); // an input that does nothing
        assert_eq!(robust_control(&[0.5, 2.0], &[], &[1.0], &[2.5], false, 1.0).unwrap(), [1.0]); // white of no rows
        let offset = robust_control(&[0.5, 2.0, 1.0], &[0.0, 1e-3, 0.0], &[1.0], &[3.5], true, 1.0).unwrap();
        close(&offset, &[1.0], 1e-14);
        let small = robust_control(&[0.0, 0.0], &[0.0, 1.0], &[1.0], &[2.0], false, 1.0).unwrap();
        assert_eq!(small, [0.0]); // B = 0
        let far = robust_control(&[1e200, 1e-200], &[0.0, 1.0], &[1e200], &[0.0], false, 1.0);
        assert!(matches!(far, Err(Error::Overflow { .. })), "{far:?}");
        for beta in [-1.0, f64::INFINITY, f64::NAN] {
            assert!(robust_control(&[1.0, 1.0], &[], &[1.0], &[1.0], false, beta).is_err());
        }
        assert!(robust_control(&[1.0, f64::INFINITY], &[], &[1.0], &[1.0], false, 1.0).is_err());
        assert!(robust_control(&[1.0], &[], &[1.0], &[1.0], false, 1.0).is_err());
        assert!(robust_control(&[], &[], &[], &[], false, 1.0).is_err());
    }
}
