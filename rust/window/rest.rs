//! Where a window model comes to rest.

use faer::{Mat, MatRef};

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, covered, try_collect, try_zeros};

use super::shape::{WHAT, Window};

/// Effects of inputs below this share of the largest one are rounding.
const SEEN: f64 = 1e-13;

/// A point of rest, or what comes nearest to one.
#[derive(Debug, Clone)]
pub struct Rest {
    /// The state where outputs and inputs were always these.
    pub x: Vec<f64>,
    /// z there.
    pub z: Vec<f64>,
    /// The inputs (m).
    pub u: Vec<f64>,
    /// What one unit of a constant input adds to the state (states, m).
    pub states: Vec<f64>,
    /// The same of the next output, (n_y, m).
    pub outputs: Vec<f64>,
    /// How far the outputs move in the next step.
    pub off: f64,
    /// What of that may be rounding.
    pub rounding: f64,
}

impl Window {
    /// x and z where outputs and inputs were always these.
    fn always(&self, y: &[f64], u: &[f64], x: &mut [f64], z: &mut [f64]) {
        self.start(y, u, x); // filters have the gain 1
        self.regressors(x, u, 1.0, z);
    }

    /// Where the model `theta` (n_y, d) stays at `y = target`, by least squares in the constant inputs; or, where the `inputs`
    /// are given, how far it moves under these.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Numerical`], [`Error::Memory`].
    pub fn rest(&self, theta: &[f64], target: &[f64], inputs: Option<&[f64]>) -> Result<Rest> {
        let (p, m, n, d) = (self.outputs(), self.inputs(), self.states(), self.length());
        if theta.len() != checked_len(WHAT, p, d)? || target.len() != p || inputs.is_some_and(|u| u.len() != m) {
            let (expected, found) = (format!("{p} rows of {d}, and {p} outputs"), format!("{} outputs", target.len()));
            return Err(Error::Shape { name: "theta, target, inputs", expected, found });
        }
        require_finite("theta", theta)?;
        require_finite("target", target)?;
        let h = MatRef::from_row_major_slice(theta, p, d);
        let [mut x, mut z] = [try_zeros::<f64>(WHAT, n)?, try_zeros::<f64>(WHAT, d)?];
        let [mut moved, mut by] = [try_zeros::<f64>(WHAT, n)?, try_zeros::<f64>(WHAT, d)?];
        let mut unit = try_zeros::<f64>(WHAT, m)?;
        self.always(target, &unit, &mut x, &mut z);
        let mut states = try_zeros(WHAT, checked_len(WHAT, n, m)?)?;
        covered(WHAT, 64 * (d as u128 + 1) * (m as u128 + p as u128 + 1), || {
            let mut per = Mat::<f64>::zeros(d, m);
            for j in 0..m {
                unit.fill(0.0);
                unit[j] = 1.0;
                self.always(target, &unit, &mut moved, &mut by);
                states.iter_mut().skip(j).step_by(m).zip(moved.iter().zip(&x)).for_each(|(to, (a, b))| *to = a - b);
                (0..d).for_each(|i| per[(i, j)] = by[i] - z[i]);
            }
            let outputs = h * &per;
            let start = Mat::from_fn(d, 1, |i, _| z[i]);
            let lacking = Mat::from_fn(p, 1, |i, _| target[i]) - h * &start;
            let u = match inputs {
                Some(u) => Mat::from_fn(m, 1, |i, _| u[i]),
                None => least_squares(&outputs, &lacking)?,
            };
            let there = start + &per * &u;
            let off = (h * &there - Mat::from_fn(p, 1, |i, _| target[i])).norm_l2();
            let size: f64 = (0..p).map(|i| (0..d).map(|j| (h[(i, j)] * there[(j, 0)]).abs()).sum::<f64>()).sum();
            let mut found = try_collect(WHAT, x.iter().copied())?;
            found.iter_mut().zip(states.chunks_exact(m)).for_each(|(to, row)| {
                *to += row.iter().enumerate().map(|(j, v)| v * u[(j, 0)]).sum::<f64>();
            });
            Ok(Rest {
                x: found,
                z: try_collect(WHAT, (0..d).map(|i| there[(i, 0)]))?,
                u: try_collect(WHAT, (0..m).map(|j| u[(j, 0)]))?,
                states,
                outputs: try_collect(WHAT, (0..p * m).map(|at| outputs[(at / m, at % m)]))?,
                off,
                rounding: 1e-12 * size,
            })
        })?
    }
}

/// The shortest u of all with the least `||a u - b||`.
fn least_squares(a: &Mat<f64>, b: &Mat<f64>) -> Result<Mat<f64>> {
    let lost = |_| Error::Numerical("what constant inputs do to the outputs has no singular values".into());
    let svd = a.thin_svd().map_err(lost)?;
    let (s, mut along) = (svd.S().column_vector(), svd.U().transpose() * b);
    for i in 0..along.nrows() {
        along[(i, 0)] = if s[i] > SEEN * s[0] { along[(i, 0)] / s[i] } else { 0.0 };
    }
    Ok(svd.V() * along)
}
