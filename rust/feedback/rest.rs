//! Where the loops come to rest with an intercept or at a set point.

use faer::Mat;
use faer::linalg::solvers::Solve;

use crate::error::{Error, Result};
use crate::memory::{covered, try_copy};

use super::certificate::Verdict;
use super::data::{Matrix, WHAT, lost, scaled, size_of};
use super::loops::{Loop, bytes};
use super::tube::ROUNDING;

/// The spectral norm.
fn norm(a: &Matrix) -> Result<f64> {
    let unit = size_of(a);
    let values = scaled(a, 1.0 / unit).singular_values().map_err(lost)?;
    Ok(unit * values.first().copied().unwrap_or(0.0))
}

/// Where the loops of all members rest, as differences from a set point: `off + forced q`, `||q|| <= size`, in the
/// units of the loop.
struct AtRest {
    off: Matrix,
    forced: Matrix,
    size: f64,
}

impl Loop {
    /// Where the centre rests under `u = us + K (x - xs)`, states and inputs; the set point itself unless the gain is
    /// certified, as it may rest nowhere.
    pub(super) fn centre_at_rest(&self, xs: &[f64], us: &[f64]) -> Result<(Vec<f64>, Vec<f64>)> {
        let data = &self.data;
        if xs.len() != data.n || us.len() != data.m {
            let found = format!("{} and {}", xs.len(), us.len());
            let expected = format!("{} entries, and {} of inputs", data.n, data.m);
            return Err(Error::Shape { name: "xs", expected, found });
        }
        let (mut x, mut u) = (try_copy(WHAT, xs)?, try_copy(WHAT, us)?);
        if self.certificate.status != Verdict::Certified {
            return Ok((x, u));
        }
        covered(WHAT, bytes(data.n, data.region.d), || {
            let point = Mat::from_fn(data.n, 1, |i, _| xs[i] / data.unit[i]);
            let mut moved = &data.a * &point + &data.b * Mat::from_fn(data.m, 1, |j, _| us[j]) - &point;
            if let Some(c) = &data.c {
                moved += c;
            }
            let off = (Mat::<f64>::identity(data.n, data.n) - &self.closed.a0).partial_piv_lu().solve(&moved);
            let inputs = &self.closed.k * &off;
            x.iter_mut().enumerate().for_each(|(i, x)| *x += data.unit[i] * off[(i, 0)]);
            u.iter_mut().enumerate().for_each(|(j, u)| *u += inputs[(j, 0)]);
            (x, u)
        })
    }

    /// None unless the gain is certified and the data determine the point.
    fn at_rest(&self, xs: &[f64], us: &[f64]) -> Result<Option<AtRest>> {
        let data = &self.data;
        let (n, m, d) = (data.n, data.m, data.region.d);
        if xs.len() != n || us.len() != m {
            let found = format!("{} and {}", xs.len(), us.len());
            return Err(Error::Shape { name: "xs", expected: format!("{n} entries, and {m} of inputs"), found });
        }
        let mut own = Vec::new();
        own.extend(xs.iter().chain(us).copied().chain(data.c.iter().map(|_| 1.0)));
        if self.certificate.status != Verdict::Certified || !data.determined(&own) {
            return Ok(None);
        }
        covered(WHAT, bytes(n, d), || {
            let z = Mat::from_fn(d, 1, |i, _| own[i] / data.unit.get(i).copied().unwrap_or(1.0));
            let x = z.subrows(0, n);
            let mut r = &data.a * x + &data.b * z.subrows(n, m) - x;
            if let Some(c) = &data.c {
                r += c;
            }
            let lu = (Mat::<f64>::identity(n, n) - &self.closed.a0).partial_piv_lu();
            let (off, forced, e) = (lu.solve(&r), lu.solve(self.closed.inputs(data)), self.closed.outputs());
            let known = data.pieces.iter().zip(&self.closed.t).map(|(piece, t)| (&piece.w * &z).norm_l2() / t.sqrt());
            let size = crate::fuse::norm(known) + (&e * &off).norm_l2();
            let gain = (norm(&(&e * &forced))? * (1.0 + ROUNDING)).min(self.certificate.norm);
            Ok(Some(AtRest { off, forced, size: size / (1.0 - gain) * (1.0 + ROUNDING) }))
        })?
    }

    /// How far states and inputs (n + m) of any member are at rest from `xs` and `us`, under `u = us + K (x - xs)`, and
    /// the 2-norm of the states; infinite unless the gain is certified and the data determine the point. With
    /// `r = C z_s - xs`, `M = (I - A0)^-1` and `g1 = rho ||E M D||`:
    ///
    /// ```text
    /// |h'e| <= |h'M r| + rho ||h'M D|| (||W z_s|| + ||E M r||) / (1 - g1)
    /// ```
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`].
    pub fn rest(&self, xs: &[f64], us: &[f64]) -> Result<(Vec<f64>, f64)> {
        let data = &self.data;
        let (n, mut found) = (data.n, Vec::new());
        found.resize(n + data.m, f64::INFINITY);
        let Some(AtRest { off, forced, size }) = self.at_rest(xs, us)? else { return Ok((found, f64::INFINITY)) };
        covered(WHAT, bytes(n, data.region.d), || {
            let (rows, mut squared) = (self.rows(), 0.0);
            let (at, each) = (&rows * &off, &rows * &forced);
            for (h, to) in found.iter_mut().enumerate() {
                *to = at[(h, 0)].abs() * (1.0 + ROUNDING) + each.row(h).norm_l2() * size;
                squared += if h < n { to.powi(2) } else { 0.0 };
            }
            let whole = |a: &Matrix| norm(&Mat::from_fn(n, a.ncols(), |i, j| data.unit[i] * a[(i, j)]));
            let radius = whole(&off)? * (1.0 + ROUNDING) + whole(&forced)? * size;
            Ok((found, radius.min(squared.sqrt())))
        })?
    }

    /// X with `e e' <= X` for all differences e at rest, by `(a + b)(a + b)' <= (1 + s) a a' + (1 + 1/s) b b'`; None
    /// where there is no bound.
    pub(super) fn spread_at_rest(&self, xs: &[f64], us: &[f64]) -> Result<Option<Matrix>> {
        let Some(AtRest { off, forced, size }) = self.at_rest(xs, us)? else { return Ok(None) };
        covered(WHAT, bytes(self.data.n, self.data.region.d), || {
            let around = scaled(&(&forced * forced.transpose()), size * size);
            let (one, other) = (off.norm_l2(), size * forced.norm_l2());
            if one <= 0.0 {
                return Some(around);
            }
            let share = (one / other).clamp(1e-6, 1e6);
            Some(scaled(&around, 1.0 + share) + scaled(&(&off * off.transpose()), 1.0 + 1.0 / share))
        })
    }
}
