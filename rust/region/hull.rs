//! What data say of a mixture of given models, from where least squares lie relative to the hull of these models.

use crate::control::{singular, singular_values};
use crate::error::{Error, Result};
use crate::identify::{chi2_quantile, chi2_upper, f_upper, noncentrality_limit};
use crate::memory::{try_collect, try_push, try_zeros};
use crate::vector::{axpy, dot, norm};

const WHAT: &str = "cells of a variance";

/// Singular values of the differences of models below this share of the largest size count as 0.
const SPAN: f64 = 1e-10;
/// Probability to doubt models of which a mixture is true.
const DOUBT: f64 = 0.01;
/// Of Stein's constant; below 2 least squares is never better.
const MOST: f64 = 1.5;
/// How far above its largest value a squared radius may be.
const LOOSE: f64 = 1.002;
/// Noncentral laws are replaced by a normal bound beyond.
const LARGE: f64 = 1e4;

/// The noise of the data in each coordinate.
#[derive(Debug, Clone, Copy)]
pub enum CoordinateNoise {
    /// Its variance.
    Known(f64),
    /// The residual sum of squares, and its degrees of freedom.
    Estimated {
        /// `tr S`
        rss: f64,
        /// Degrees of freedom.
        degrees: usize,
    },
    /// One for each row of the outcomes, in any dependence; the rows are in units of their estimated deviations.
    Rows {
        /// How many.
        count: usize,
        /// Degrees of freedom of each estimate.
        degrees: usize,
    },
}

impl CoordinateNoise {
    /// Whether there are no residuals to estimate it from.
    fn is_unknown(self) -> bool {
        matches!(self, Self::Estimated { degrees: 0, .. } | Self::Rows { degrees: 0, .. })
    }
}

/// Where t, least squares in `p` coordinates, lies: at distances `off^(1/2)` of the affine hull and `distance^(1/2)` of
/// the nearest mixture, with `along` between the two nearest points; `k` and `face` are the dimensions of the affine
/// hull and of the face of the mixture.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// `||t - mixture||^2`
    pub distance: f64,
    /// `||t - P t||^2`
    pub off: f64,
    /// `||P t - mixture||`
    pub along: f64,
    /// Dimension of the affine hull.
    pub k: usize,
    /// Dimension of the face.
    pub face: usize,
    /// Dimension of the space.
    pub p: usize,
}

/// The mixture of models that is nearest to the data.
#[derive(Debug)]
pub struct Mixture {
    /// `sum_i w_i S_i`
    pub point: Vec<f64>,
    /// Where the data are.
    pub place: Place,
    /// The largest norm of the data and the models.
    pub largest: f64,
}

impl Mixture {
    /// Of models (count, p) with the best weights (count) for the data (p).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Overflow`], [`Error::Numerical`], [`Error::Memory`].
    pub fn new(models: &[f64], data: &[f64], weights: &[f64]) -> Result<Self> {
        let (p, count) = (data.len(), weights.len());
        if p == 0 || count == 0 || models.len() != p * count {
            let (expected, found) = (format!("{count} rows of {p} entries"), models.len().to_string());
            return Err(Error::Shape { name: "models", expected, found });
        }
        let mut point = try_zeros(WHAT, p)?;
        models.chunks_exact(p).zip(weights).for_each(|(model, w)| axpy(*w, model, &mut point));
        let largest = models.chunks_exact(p).map(norm).fold(0.0, f64::max);
        let less = |a: &[f64], b: &[f64]| try_collect(WHAT, a.iter().zip(b).map(|(a, b)| a - b));
        let (first, size) = (&models[..p], SPAN * largest);
        let basis = span(models.chunks_exact(p), size, p)?;
        let to = less(data, first)?;
        let mut nearest = try_zeros(WHAT, p)?;
        basis.chunks_exact(p).for_each(|vector| axpy(dot(vector, &to), vector, &mut nearest));
        let (away, off) = (less(data, &point)?, less(&to, &nearest)?);
        let (k, along) = (basis.len() / p, less(&nearest, &less(&point, first)?)?);
        let chosen = models.chunks_exact(p).zip(weights).filter(|(_, w)| **w > 0.0);
        let place = Place {
            distance: dot(&away, &away),
            off: if k < p { dot(&off, &off) } else { 0.0 },
            along: norm(&along),
            k,
            face: span(chosen.map(|(model, _)| model), size, p)?.len() / p,
            p,
        };
        Ok(Self { point, place, largest: largest.max(norm(data)) })
    }
}

/// An orthonormal basis of the differences of models, vector by vector.
fn span<'a>(mut models: impl Iterator<Item = &'a [f64]>, size: f64, p: usize) -> Result<Vec<f64>> {
    let Some(first) = models.next() else {
        return Ok(Vec::new());
    };
    let mut apart = Vec::new();
    for model in models {
        model.iter().zip(first).try_for_each(|(v, first)| try_push(WHAT, &mut apart, v - first))?;
    }
    let found = singular(&apart, apart.len() / p, p)?;
    let kept = found.s.iter().take_while(|s| **s > size).count();
    let mut basis = found.v;
    basis.truncate(kept * p);
    Ok(basis)
}

/// The radius around `point + share away`, `away` (rows, columns) from there to t, of a Theta within `b` of t and `a`
/// of `point`, in the spectral or the Frobenius norm.
///
/// With X, Y the differences of Theta from `point` and t, that from the point between is, squared,
/// `(1 - s) X X' + s Y Y' - s (1 - s) away away'`; or, in the spectral norm, the triangle inequality.
///
/// # Errors
/// [`Error::Numerical`], [`Error::Memory`].
pub fn between(b: f64, a: f64, away: &[f64], columns: usize, share: f64, frobenius: bool) -> Result<f64> {
    let rows = away.len().checked_div(columns).unwrap_or(0);
    let (distance, least) = if frobenius {
        (norm(away), norm(away))
    } else {
        let sizes = singular_values(away, columns)?;
        let least = if rows <= columns { sizes.last() } else { None };
        (sizes.first().copied().unwrap_or(0.0), least.copied().unwrap_or(0.0))
    };
    let (a, b) = (a.min(b + distance), b.min(a + distance));
    if !a.is_finite() {
        return Ok(f64::INFINITY);
    }
    let (rest, middle) = (1.0 - share, (1.0 - share) * a * a + share * b * b);
    let middle = (middle - share * rest * least * least).max(0.0).sqrt();
    Ok(if frobenius { middle } else { middle.min(b + rest * distance).min(a + share * distance) })
}

impl Place {
    /// The share of least squares in the mixture with it.
    ///
    /// With `q = p - face`, `c = sigma^2 min(1.5 (q - 2), chi^2_{q; DOUBT})`. While the mixture stays in its face, t is
    /// shrunk along the normal cone of that face, of dimension q, and Stein's identity has no boundary terms there: the
    /// unbiased estimate of the risk minus that of least squares is `sigma^2 (distance / sigma^2 - 2 q)` below c and
    /// `c (c - 2 sigma^2 (q - 2)) / distance` beyond, both <= 0 (James and Stein 1961; Bock 1982). So no Theta has a
    /// larger mean-square error than with least squares. The quantile lets the data in only where they contradict the
    /// models; 1.5 keeps three quarters of what the best constant, 1, gains far from the hull. sigma unknown:
    /// `1.5 (q - 2) / (degrees + 2)` and the quantile of F, times tr S (Baranchik 1970); without degrees nothing is
    /// known of the noise, and 0. For a variance of each row the same in units of the estimates, as a rule without that
    /// property.
    ///
    /// # Errors
    /// As [`chi2_upper`].
    pub fn share(&self, noise: CoordinateNoise) -> Result<f64> {
        let q = (self.p - self.face) as f64;
        if self.distance == 0.0 || noise.is_unknown() {
            return Ok(0.0);
        }
        if q <= 2.0 {
            return Ok(1.0);
        }
        let (rss, free) = match noise {
            CoordinateNoise::Known(_) => (0.0, 0.0),
            CoordinateNoise::Estimated { rss, degrees } => (rss, degrees as f64),
            CoordinateNoise::Rows { count, degrees } => ((count * degrees) as f64, (count * degrees) as f64),
        };
        let c = match noise {
            CoordinateNoise::Known(variance) => variance * (MOST * (q - 2.0)).min(chi2_upper(DOUBT, q)?),
            _ => rss * (MOST * (q - 2.0) / (free + 2.0)).min(q / free * f_upper(DOUBT, q, free)?),
        };
        Ok((1.0 - c / self.distance).max(0.0))
    }

    /// Whether an affine mixture is compatible with the data: test of `off` at level 0.01. None where there is no
    /// direction off the hull, or nothing is known of the noise.
    ///
    /// Of a mixture the error of row i, squared, over its estimated variance is `rank F_{rank, degrees}` whatever the
    /// covariance of the rows is, and `off` is at most the sum: none of the rows is beyond the quantile of
    /// `DOUBT / count`.
    ///
    /// # Errors
    /// As [`chi2_upper`].
    pub fn explained(&self, noise: CoordinateNoise) -> Result<Option<bool>> {
        let off = (self.p - self.k) as f64;
        if off == 0.0 || noise.is_unknown() {
            return Ok(None);
        }
        Ok(match noise {
            CoordinateNoise::Known(variance) => Some(self.off <= variance * chi2_upper(DOUBT, off)?),
            CoordinateNoise::Estimated { rss, degrees } => {
                let free = degrees as f64;
                Some(self.off <= rss * (off / free * f_upper(DOUBT, off, free)?))
            }
            CoordinateNoise::Rows { count, degrees } => {
                let rank = (self.p / count) as f64;
                Some(self.off <= self.p as f64 * f_upper(DOUBT / count as f64, rank, degrees as f64)?)
            }
        })
    }

    /// A bound on `||(F - Theta) V^(1/2)||_F^2` for the mixture F, from the data alone.
    ///
    /// `off / sigma^2` is noncentral chi^2_{p-k} with the squared distance of Theta to the affine hull, independent of
    /// the part along it: `sigma^2 L + (along + sigma chi_k)^2`, L the upper limit of the noncentrality (after Baraud
    /// 2004). sigma unknown: the largest value over its interval from tr S, by cells that are bounded by both their
    /// ends and halved where it matters. `extra`: independent variates of the same noise that are to be covered too;
    /// `(a + x)^2 + y^2 <= (a + (x^2 + y^2)^(1/2))^2`. Infinite where the rows have variances of their own.
    ///
    /// # Errors
    /// As [`chi2_upper`] and [`noncentrality_limit`].
    pub fn radius(&self, noise: CoordinateNoise, delta: f64, extra: usize) -> Result<f64> {
        let (inside, off) = ((self.k + extra) as f64, (self.p - self.k) as f64);
        let squared = |v: f64, limit: f64, chi: f64| v * limit + (self.along + v.sqrt() * chi).powi(2);
        let (rss, degrees) = match noise {
            CoordinateNoise::Known(variance) => {
                let share = if inside > 0.0 && off > 0.0 { delta / 2.0 } else { delta };
                let chi = chi2_upper(share, inside)?.sqrt();
                return Ok(squared(variance, limit(self.off / variance, off, share)?, chi));
            }
            CoordinateNoise::Estimated { degrees: 0, .. } | CoordinateNoise::Rows { .. } => return Ok(f64::INFINITY),
            CoordinateNoise::Estimated { rss, degrees } => (rss, degrees as f64),
        };
        let (low, high) = (rss / chi2_upper(delta / 6.0, degrees)?, rss / chi2_quantile(delta / 6.0, degrees)?);
        if low <= 0.0 {
            return Ok(self.off + self.along * self.along); // no noise at all
        }
        let chi = chi2_upper(delta / 3.0, inside)?.sqrt();
        let upper = |v: f64| limit(self.off / v, off, delta / 3.0);
        // the limit falls with sigma^2: a cell [v, w] is below the value for w with the limit at v
        let first = upper(low)?;
        let mut largest = squared(low, first, chi);
        let mut cells = Vec::new();
        try_push(WHAT, &mut cells, (squared(high, first, chi), low, high, first))?;
        loop {
            let worst = (0..cells.len()).max_by(|&a, &b| cells[a].0.total_cmp(&cells[b].0)).unwrap_or(0);
            let (bound, v, w, above) = cells[worst];
            if bound <= LOOSE * largest || !bound.is_finite() {
                return Ok(bound);
            }
            let middle = (v * w).sqrt();
            let lower = upper(middle)?;
            largest = largest.max(squared(middle, lower, chi));
            cells[worst] = (squared(middle, above, chi), v, middle, above);
            try_push(WHAT, &mut cells, (squared(w, lower, chi), middle, w, lower))?;
        }
    }
}

/// Upper limit of the noncentrality of chi^2 from one value x, with confidence `1 - delta`.
///
/// For large x, `(x^(1/2) + z)^2` with the normal quantile z, since chi^2 is at least `(L^(1/2) + g)^2` for a standard
/// normal g: larger by less than the degrees, and quick.
fn limit(x: f64, degrees: f64, delta: f64) -> Result<f64> {
    if x <= LARGE * (1.0 + degrees / 100.0) {
        return noncentrality_limit(x, degrees, delta);
    }
    Ok((x.sqrt() + chi2_upper((2.0 * delta).min(0.999), 1.0)?.sqrt()).powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mixture_by_hand() {
        // the middle of (0, 0, 0) and (2, 0, 0); the third model is in the plane, but has no weight
        let models = [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, -5.0, 0.0];
        let found = Mixture::new(&models, &[1.0, 2.0, 3.0], &[0.5, 0.5, 0.0]).unwrap();
        assert_eq!(found.point, [1.0, 0.0, 0.0]);
        let Place { distance, off, along, k, face, p } = found.place;
        assert_eq!((k, face, p, found.largest), (2, 1, 3, 5.0));
        assert!((distance - 13.0).abs() + (off - 9.0).abs() + (along - 2.0).abs() < 1e-12);
        let one = Mixture::new(&[1.0, 1.0], &[1.0, 2.0], &[1.0]).unwrap();
        assert_eq!((one.place.k, one.place.face, one.place.off), (0, 0, 1.0));
        assert!(Mixture::new(&models, &[1.0, 2.0], &[0.5, 0.5, 0.0]).is_err());
    }

    #[test]
    fn the_radius_around_a_point_between() {
        let away = [3.0, 0.0, 0.0, 4.0];
        // at the ends it is that of the end
        assert_eq!(between(1.0, 4.0, &away, 2, 0.0, false).unwrap(), 4.0);
        assert_eq!(between(1.0, 4.0, &away, 2, 1.0, false).unwrap(), 1.0);
        let half = between(1.0, 4.0, &away, 2, 0.5, true).unwrap();
        assert!((half - (8.5f64 - 6.25).sqrt()).abs() < 1e-12);
        assert_eq!(between(f64::INFINITY, f64::INFINITY, &away, 2, 0.5, false).unwrap(), f64::INFINITY);
        // what is unknown from one end is known by the other
        assert_eq!(between(1.0, f64::INFINITY, &away, 2, 0.0, true).unwrap(), 6.0);
    }

    #[test]
    fn limits_of_the_noncentrality() {
        assert!((limit(32.0, 32.0, 0.025).unwrap() - 21.445789230634).abs() < 1e-9);
        for (x, degrees, delta) in [(32.0, 32.0, 0.025), (3e6, 40.0, 0.01), (1e5, 3.0, 0.4)] {
            let (found, exact) = (limit(x, degrees, delta).unwrap(), noncentrality_limit(x, degrees, delta).unwrap());
            assert!(exact * (1.0 - 1e-9) <= found && found <= exact + 2.0 * degrees, "{x}: {found} {exact}");
        }
    }
}
