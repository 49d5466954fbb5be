//! What explains a bias that was learned at rest: the error of the model, constants at the inputs, or sensors that are
//! wrong.
//!
//! `e = (Theta - H) z + b d + M_y s + n` for constants d at the inputs and s of the sensors, `b = -M_u`, z at rest.
//! Causes are refuted where what they leave of e is outside of the sum of the ellipsoids of n and of `(Theta - H) z`.

use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result};
use crate::identify::{chi2_upper, whiten};
use crate::matrix::MatrixView;
use crate::memory::{covered, room_for_products, try_collect, try_collect_all, try_extend};
use crate::region::Region;

use super::set_points::{Matrix, SetPoints, WHAT, listed, parts};

/// Of the steps after which what was learned is as good as settled.
const DOUBLINGS: usize = 40;
/// Ellipsoids around a sum of two: their shares are from `1e-3` to `1e3`.
const SPLITS: usize = 25;
/// Relative singular values of causes below it are 0.
const ALIKE: f64 = 1e-9;

/// A bias that was learned at rest.
#[derive(Debug, Clone, Copy)]
pub struct Learned<'a> {
    /// Its mean over so many calls (p).
    pub bias: &'a [f64],
    /// See `bias`.
    pub calls: usize,
    /// L of `e+ = e + L (w - e)` (p, p).
    pub gain: MatrixView<'a>,
    /// A bound of the covariance of the noise (p, p).
    pub noise: MatrixView<'a>,
    /// Outputs and inputs at rest (p + m).
    pub rest: &'a [f64],
}

/// What is not refuted.
#[derive(Debug, PartialEq)]
pub struct Causes {
    /// Constants at the inputs (m), if these alone explain it.
    pub constants: Option<Vec<f64>>,
    /// How much more each output reads than the others say (p), where that explains it; beside constants, unless these
    /// do.
    pub sensors: Vec<Option<f64>>,
    /// Whether two sensors do, where nothing else does.
    pub two: bool,
}

/// The ellipsoids of a bias, and what a constant of each signal adds to it (p, p + m).
struct Ellipsoids<'a> {
    region: &'a Region,
    bias: Matrix,
    effects: Matrix,
    /// `T' T = Sigma^-1` of n, and `q^2 Sigma`.
    white: Matrix,
    near: Matrix,
    z: Matrix,
    /// What one unit of each cause adds to the true z (d, p + m).
    moves: Matrix,
}

/// `L^-1` of `a = L L'`; None where it is not positive definite.
fn whitening(a: &Matrix) -> Option<Matrix> {
    let mut white = Matrix::identity(a.nrows(), a.nrows());
    whiten(a.llt(Side::Lower).ok()?.L(), white.as_mut());
    Some(white)
}

/// The covariance of the mean over so many calls of `e+ = e + L (w - e)`, long after.
fn settled(gain: &Matrix, noise: &Matrix, calls: usize) -> Matrix {
    let p = gain.nrows();
    let keeps = Matrix::identity(p, p) - gain;
    let (mut one, mut power) = (gain * noise * gain.transpose(), keeps.clone());
    for _ in 0..DOUBLINGS {
        one = &one + &power * &one * power.transpose();
        power = &power * &power;
    }
    let (mut mean, mut later) = (&one * faer::Scale(1.0 / calls as f64), one);
    for k in 1..calls {
        later = &keeps * later;
        let share = (calls - k) as f64 / (calls as f64).powi(2);
        mean += (&later + later.transpose()) * faer::Scale(share);
    }
    (&mean + mean.transpose()) * faer::Scale(0.5)
}

impl Ellipsoids<'_> {
    /// That of `(Theta - H) z`.
    fn far(&self, z: &Matrix) -> Result<Matrix> {
        let (p, count) = (self.bias.nrows(), self.region.parts().len() as f64);
        let (mut far, z) = (Mat::zeros(p, p), listed(z)?);
        for part in self.region.parts() {
            let (rows, length) = (part.rows.len(), part.length(&z));
            for (at, v) in part.shape.iter().enumerate() {
                far[(part.rows[at / rows], part.rows[at % rows])] += count * part.factor * v * length * length;
            }
        }
        Ok(far)
    }

    /// The causes, and what they leave, that fit best in these units.
    fn fit(&self, white: &Matrix, which: &[usize]) -> Result<(Matrix, Matrix)> {
        let effects = Mat::from_fn(self.bias.nrows(), which.len(), |i, j| self.effects[(i, which[j])]);
        let found = parts(&(white * &effects))?;
        let size = found.solve(&(white * &self.bias), found.rank(ALIKE * found.s.first().copied().unwrap_or(0.0)));
        let left = white * (&self.bias - effects * &size);
        Ok((size, left))
    }

    /// The sizes of these causes; None if they are refuted.
    fn explained(&self, which: &[usize]) -> Result<Option<Vec<f64>>> {
        let size = self.fit(&self.white, which)?.0;
        let moved = Mat::from_fn(self.z.nrows(), 1, |i, _| {
            self.z[(i, 0)] + which.iter().enumerate().map(|(j, at)| self.moves[(i, *at)] * size[(j, 0)]).sum::<f64>()
        });
        for z in [&self.z, &moved] {
            if !self.refuted(&self.far(z)?, which)? {
                return Ok(Some(listed(&size)?));
            }
        }
        Ok(None)
    }

    fn refuted(&self, far: &Matrix, which: &[usize]) -> Result<bool> {
        if !listed(far)?.iter().all(|v| v.is_finite()) {
            return Ok(false);
        }
        for k in 0..SPLITS {
            let t = 10_f64.powf(6.0 * k as f64 / (SPLITS - 1) as f64 - 3.0);
            let around = &self.near * faer::Scale(1.0 + 1.0 / t) + far * faer::Scale(1.0 + t);
            let Some(white) = whitening(&around) else { return Ok(false) };
            if self.fit(&white, which)?.1.norm_l2() > 1.0 {
                return Ok(true); // any ellipsoid around the sum refutes
            }
        }
        Ok(false)
    }
}

impl SetPoints {
    /// What explains a bias at rest. None where noise and the error of the model do, and where no bound of these is
    /// known; a false explanation is given with at most this probability, in the event of the region.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`], [`Error::Numerical`], [`Error::Memory`].
    pub fn causes(&self, region: &Region, learned: &Learned<'_>, level: f64) -> Result<Option<Causes>> {
        let ((p, m), d, own) = (self.sizes(), self.along.nrows(), *learned);
        let (gain, noise) = (own.gain.sized("gain", p, p)?, own.noise.sized("noise", p, p)?);
        let sizes = [own.bias.len() == p, own.rest.len() == p + m];
        if sizes.contains(&false) || own.calls == 0 || (region.n, region.width()) != (p, d) {
            let (expected, found) = (format!("{p} outputs and {m} inputs"), own.bias.len().to_string());
            return Err(Error::Shape { name: "bias", expected, found });
        }
        if !region.radius().is_finite() || own.bias.iter().all(|v| *v == 0.0) {
            return Ok(None);
        }
        let square = chi2_upper(level, p as f64)?;
        room_for_products()?;
        covered(WHAT, 4 * self.bytes(), || {
            let [gain, noise] = [&gain, &noise].map(|of| MatRef::from_row_major_slice(of, p, p).to_owned());
            let settled = settled(&gain, &noise, own.calls);
            let Some(white) = whitening(&settled) else { return Ok(None) };
            let mut z = &self.along * MatRef::from_row_major_slice(own.rest, p + m, 1);
            if self.window.intercept() {
                z[(d - 1, 0)] = 1.0;
            }
            let sign = |j: usize| if j < p { 1.0 } else { -1.0 };
            let of = Ellipsoids {
                region,
                bias: MatRef::from_row_major_slice(own.bias, p, 1).to_owned(),
                effects: Mat::from_fn(p, p + m, |i, j| sign(j) * self.m[(i, j)]),
                white,
                near: settled * faer::Scale(square),
                z,
                moves: Mat::from_fn(d, p + m, |i, j| -sign(j) * self.along[(i, j)]),
            };
            if of.explained(&[])?.is_some() {
                return Ok(None);
            }
            let inputs = try_collect(WHAT, p..p + m)?;
            let constants = of.explained(&inputs)?;
            let beside = if constants.is_some() { &[][..] } else { &inputs };
            let also = |sensors: &[usize]| {
                let mut which = try_collect(WHAT, sensors.iter().copied())?;
                try_extend(WHAT, &mut which, beside.iter().copied())?;
                of.explained(&which)
            };
            let sensors = try_collect_all(WHAT, (0..p).map(|i| Ok(also(&[i])?.map(|size| size[0]))))?;
            let mut two = false;
            if constants.is_none() && sensors.iter().all(Option::is_none) {
                for (i, j) in (0..p).flat_map(|i| (i + 1..p).map(move |j| (i, j))) {
                    two = two || also(&[i, j])?.is_some();
                }
            }
            Ok(Some(Causes { constants, sensors, two }))
        })?
    }

    /// Directions of the outputs (any, p), in these sizes, of which at most `least` leaves in a step: all that
    /// integrates.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`].
    pub fn integrating(&self, sizes: &[f64], least: f64) -> Result<Vec<f64>> {
        let p = self.sizes().0;
        if sizes.len() != p {
            let (expected, found) = (format!("{p} sizes"), sizes.len().to_string());
            return Err(Error::Shape { name: "sizes", expected, found });
        }
        room_for_products()?;
        covered(WHAT, self.bytes(), || {
            let found = parts(&Mat::from_fn(p, p, |i, j| self.m[(i, j)] * sizes[j] / sizes[i]))?;
            listed(&found.free(found.rank(least)).transpose().to_owned())
        })?
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::region::tests::round;
    use crate::window::{Kind, Window};

    const NOISE: [f64; 9] = [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01];
    const GAIN: [f64; 9] = [0.05, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.05];

    /// Three outputs and one input, and a region with this factor.
    fn made(factor: f64) -> (SetPoints, Region) {
        let theta = [0.9, 0.2, 0.0, 0.5, 0.0, 0.7, 0.1, 0.2, 0.1, 0.0, 0.5, -0.3];
        let window = Window::new(3, 1, Kind::Lags(1), 0, false, 0).unwrap();
        let region =
            Region::new(MatrixView::of(&theta, 4), 1, vec![round(&[0, 1, 2], &[0, 1, 2, 3], factor)], None, false);
        (SetPoints::new(window, MatrixView::of(&theta, 4), &[1.0; 4]).unwrap(), region.unwrap())
    }

    fn causes(factor: f64, bias: &[f64], rest: &[f64]) -> Option<Causes> {
        let (points, region) = made(factor);
        let [gain, noise] = [&GAIN, &NOISE].map(|of| MatrixView::of(of, 3));
        let learned = Learned { bias, calls: 1, gain, noise, rest };
        points.causes(&region, &learned, 1e-4).unwrap()
    }

    #[test]
    fn one_cause_is_found_with_its_size() {
        // M_y s of a sensor that reads 4 more, b d of 2 at the input
        let sensor = causes(1e-6, &[0.4, 0.0, -0.4], &[4.0, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!((&sensor.constants, sensor.sensors[1], sensor.sensors[2], sensor.two), (&None, None, None, false));
        assert!((sensor.sensors[0].unwrap() - 4.0).abs() < 1e-12);
        let constant = causes(1e-6, &[1.0, 0.4, -0.6], &[0.0; 4]).unwrap();
        assert!((constant.constants.unwrap()[0] - 2.0).abs() < 1e-12);
        // what no sensor beside a constant explains, two of them do: three effects of three outputs
        let all = causes(1e-6, &[1.0, 1.0, 1.0], &[0.0; 4]).unwrap();
        assert_eq!((all.constants, all.two), (None, true));
        assert_eq!(causes(1e-6, &[1e-3, 0.0, 0.0], &[0.0; 4]), None);
        assert_eq!(causes(1e-6, &[0.0; 3], &[0.0; 4]), None);
        assert_eq!(causes(1.0, &[0.4, 0.0, -0.4], &[4.0, 0.0, 0.0, 0.0]), None);
    }

    #[test]
    fn what_integrates_is_a_direction() {
        let window = Window::new(2, 1, Kind::Lags(1), 0, false, 0).unwrap();
        let points = SetPoints::new(window, &[[0.5, 0.0, 1.0], [0.0, 1.0, 1.0]], &[1.0; 3]).unwrap();
        let found = points.integrating(&[1.0, 2.0], 1e-3).unwrap();
        assert!(found.len() == 2 && found[0].abs() < 1e-12 && (found[1].abs() - 1.0).abs() < 1e-12);
        assert!(points.integrating(&[1.0, 2.0], 1e-3).unwrap().len() == 2 && points.integrating(&[1.0], 1e-3).is_err());
    }
}
