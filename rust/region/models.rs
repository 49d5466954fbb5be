//! [`Region`]: parts around a centre.

use std::sync::Arc;

use crate::error::{Error, Result, sized};
use crate::fuse::norm;
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_copy, try_room, try_zeros};

use super::part::{Part, WHAT, times};

/// Relative difference of entries that were declared as known, by rounding.
const SAME: f64 = 1e-12;
/// Largest entry of a model that is looked at.
const LARGEST: f64 = 1e100;

/// One part for all rows of Theta, or one for each.
///
/// ```
/// use std::sync::Arc;
/// use stochens::region::{Part, PartOf, Region};
/// // x(k+1) = a x(k) + b u(k) around a = 1/2, b = 1, from V = diag(4, 16) and S = 1
/// let (white, root) = ((&[[0.5, 0.0], [0.0, 0.25]]).into(), (&[[2.0, 0.0], [0.0, 4.0]]).into());
/// let (missing, shape) = (None, (&[[1.0]]).into());
/// let part = PartOf { rows: &[0], columns: &[0, 1], white, root, missing, ratio: 1.0, shape, factor: 0.04 };
/// let region = Region::new(&[[0.5, 1.0]], 1, vec![Arc::new(Part::new(part)?)], None, false)?;
/// assert!((region.bound(&[3.0, 0.0], false)? - 0.3).abs() < 1e-15); // sqrt(.04 * 1) * 3 / 2
/// assert!(region.contains(&[[0.59, 1.0]])? && !region.contains(&[[0.61, 1.0]])?);
/// # Ok::<(), stochens::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Region {
    pub(crate) n: usize,
    pub(crate) m: usize,
    pub(crate) d: usize,
    pub(crate) centre: Vec<f64>,
    pub(crate) parts: Vec<Arc<Part>>,
    /// Bound of `||S^(-1/2) (Theta - C) V^(1/2)||_F` in the same event, where one was asked for.
    pub(crate) frobenius: Option<f64>,
    /// Whether noise to come is covered.
    pub(crate) future: bool,
    noise: Option<Vec<f64>>,
}

impl Region {
    /// The region of these parts around a `centre` (n, d), `d = n + m`, or one more with an offset; m are the inputs.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn new<'a>(
        centre: impl Into<MatrixView<'a>>,
        m: usize,
        parts: Vec<Arc<Part>>,
        frobenius: Option<f64>,
        future: bool,
    ) -> Result<Self> {
        let centre = centre.into();
        let (n, d) = centre.shape();
        if n == 0 || m == 0 || d.checked_sub(n).is_none_or(|beside| beside != m && beside - 1 != m) {
            let expected = format!("{n} rows, as many columns and {m}, or one more, with a state and an input");
            return Err(Error::Shape { name: "centre", expected, found: format!("{n} x {d}") });
        }
        let centre = centre.sized("centre", n, d)?;
        let mut times = try_zeros::<usize>(WHAT, n)?;
        for part in &parts {
            let outside = part.columns.iter().any(|j| *j >= d) || part.rows.iter().any(|i| *i >= n);
            if !outside {
                part.rows.iter().for_each(|i| times[*i] += 1);
            }
            if outside || part.rows.iter().any(|i| times[*i] > 1) {
                let found = "others".into();
                return Err(Error::Shape {
                    name: "parts",
                    expected: format!("rows below {n}, each once, and columns below {d}"),
                    found,
                });
            }
        }
        Ok(Self { n, m, d, centre: try_copy(WHAT, &centre)?, parts, frobenius, future, noise: None })
    }

    /// The same with a bound (n, n) of the covariance of the noise that holds in the same event.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn with_noise(self, noise: Option<Vec<f64>>) -> Result<Self> {
        sized("noise", noise.as_ref().map_or(self.n * self.n, Vec::len), self.n * self.n)?;
        Ok(Self { noise, ..self })
    }

    /// C (n, d), the middle of the region.
    #[must_use]
    pub fn centre(&self) -> &[f64] {
        &self.centre
    }

    /// One part for all rows, or one for each.
    #[must_use]
    pub fn parts(&self) -> &[Arc<Part>] {
        &self.parts
    }

    /// `||S^(-1/2) (Theta - C) V^(1/2)||_F` is at most this, infinite where only the spectral norm is bounded.
    #[must_use]
    pub fn frobenius(&self) -> f64 {
        self.frobenius.unwrap_or(f64::INFINITY)
    }

    /// The covariance (n, n) of the noise is at most this, in the same event; None where no bound is known.
    #[must_use]
    pub fn noise(&self) -> Option<&[f64]> {
        self.noise.as_deref()
    }

    /// Entries of z.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.d
    }

    /// Whether there is an offset.
    #[must_use]
    pub const fn offset(&self) -> bool {
        self.d > self.n + self.m
    }

    /// `sqrt(factor ||S||)`, and of several parts the root of the sum of squares.
    #[must_use]
    pub fn radius(&self) -> f64 {
        norm(self.parts.iter().map(|part| part.radius()))
    }

    /// `z = (x, u)`, with 1 behind it for an offset.
    pub(crate) fn regressor(&self, x: &[f64], u: &[f64]) -> Result<Vec<f64>> {
        let mut z = try_room(WHAT, self.d)?;
        z.extend_from_slice(x);
        z.extend_from_slice(u);
        z.resize(self.d, 1.0);
        Ok(z)
    }

    fn checked(&self, z: &[f64]) -> Result<()> {
        if z.len() == self.d {
            return Ok(());
        }
        let found = z.len().to_string();
        Err(Error::Shape { name: "z", expected: format!("{} entries", self.d), found })
    }

    /// `||(Theta - C) z||` is at most this, for all z at once; with `noise` that of one step to come as well, which is
    /// one more coordinate of length 1.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn bound(&self, z: &[f64], noise: bool) -> Result<f64> {
        self.checked(z)?;
        Ok(norm(self.parts.iter().map(|part| {
            let length = part.length(z);
            times_length(part.radius(), if noise { length.hypot(1.0) } else { length })
        })))
    }

    /// `|(Theta - C) z|_i` is at most this (n), for all z and i at once.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn component_bounds(&self, z: &[f64]) -> Result<Vec<f64>> {
        self.checked(z)?;
        let mut found = try_zeros(WHAT, self.n)?;
        for part in &self.parts {
            let length = part.length(z);
            for (i, deviation) in part.rows.iter().zip(part.deviations()) {
                found[*i] = times_length(*deviation, length);
            }
        }
        Ok(found)
    }

    /// `|Theta - C|` is at most this (n, d), entry by entry: `sqrt(factor S_ii) ||e_j||_(V^-1)`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn entry_bounds(&self) -> Result<Vec<f64>> {
        let mut found = try_zeros(WHAT, checked_len(WHAT, self.n, self.d)?)?;
        for part in &self.parts {
            for (at, j) in part.columns.iter().enumerate() {
                let length = part.unit_length(at);
                for (i, deviation) in part.rows.iter().zip(part.deviations()) {
                    found[i * self.d + j] = times_length(*deviation, length);
                }
            }
        }
        Ok(found)
    }

    /// `|D v|_i` is at most this (n) for all `||v||_2 = 1` in the columns `from .. to`, D of the region.
    pub(crate) fn row_spreads(&self, from: usize, to: usize) -> Result<Vec<f64>> {
        let mut found = try_zeros(WHAT, self.n)?;
        for part in &self.parts {
            let reach = part.reach(from, to)?;
            for (i, deviation) in part.rows.iter().zip(part.deviations()) {
                found[*i] = times(*deviation, reach);
            }
        }
        Ok(found)
    }

    /// `||D v||` is at most this for all `||v||_2 = 1` in the columns `from .. to`, D of the region.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn spread(&self, from: usize, to: usize) -> Result<f64> {
        let mut found = try_room(WHAT, self.parts.len())?;
        for part in &self.parts {
            found.push(times(part.radius(), part.reach(from, to)?));
        }
        Ok(norm(found.iter().copied()))
    }

    /// Whether a model (n, d) has the known entries of the centre, up to rounding.
    fn has_known(&self, theta: &[f64]) -> bool {
        let free =
            |i: usize, j: usize| self.parts.iter().any(|part| part.rows.contains(&i) && part.columns.contains(&j));
        let same = |(at, (one, own)): (usize, (&f64, &f64))| {
            one.abs() <= LARGEST && (free(at / self.d, at % self.d) || (one - own).abs() <= SAME * own.abs())
        };
        theta.iter().zip(&self.centre).enumerate().all(same)
    }

    /// Whether a model (n, d) is in the region.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn contains<'a>(&self, theta: impl Into<MatrixView<'a>>) -> Result<bool> {
        self.holds(&theta.into().sized("Theta", self.n, self.d)?)
    }

    /// The same of its entries.
    pub(crate) fn holds(&self, theta: &[f64]) -> Result<bool> {
        if !self.has_known(theta) {
            return Ok(false);
        }
        let mut difference = try_copy(WHAT, theta)?;
        difference.iter_mut().zip(&self.centre).for_each(|(one, own)| *one -= own);
        for part in &self.parts {
            if !part.contains(&difference, self.d)? {
                return Ok(false);
            }
        }
        Ok(true)
    }
}

/// `radius length`: 0 for z = 0, infinite where the data do not determine `Theta z`, also if the radius is 0.
fn times_length(radius: f64, length: f64) -> f64 {
    if length == 0.0 || length.is_infinite() { length } else { radius * length }
}
