//! Models that may be the true one, drawn around least squares by the law of its error under Gaussian noise.

use rand_distr::{ChiSquared, Distribution, StandardNormal};

use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_collect_all, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::{Key, Purpose};

use super::symmetric::covariance_root;

const WHAT: &str = "the models of the law of the estimate";
/// The most models that one thread makes at a time.
const BLOCK: usize = 64;

/// What becomes a model.
#[derive(Debug, Clone, Copy)]
pub struct Centre<'a> {
    /// The model `H` (n, d).
    pub model: &'a [f64],
    /// `white` (rank, d) with `q = white z`.
    pub white: &'a [f64],
}

/// `H + deviation white`, `deviation` the first `rank` columns of `lines`, which are `width` long.
fn write_model(lines: &[f64], width: usize, centre: Centre<'_>, d: usize, model: &mut [f64]) {
    model.copy_from_slice(centre.model);
    for (row, deviation) in model.chunks_exact_mut(d).zip(lines.chunks_exact(width.max(1))) {
        for (factor, white) in deviation.iter().zip(centre.white.chunks_exact(d)) {
            row.iter_mut().zip(white).for_each(|(to, white)| *to += factor * white);
        }
    }
}

/// What is known of the covariance `Sigma` of the noise; the number is that of the degrees of freedom of the residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoiseLaw {
    /// `Sigma` itself.
    Known,
    /// `Sigma = sigma^2 I`: the residual sums of squares are `sigma^2 chi^2` together.
    Scalar(usize),
    /// `Sigma` is diagonal.
    Diagonal(usize),
    /// Nothing.
    Full(usize),
}

/// The law of `H + R G V^(-1/2)`, `G` standard normal (n, rank), and of noise `R g` of the same draw.
///
/// `R R' = Sigma` where it is known; else `R = S^(1/2) E^(-1/2)` with `E ~ W_n(I, nu)` by Bartlett's triangle, and its
/// counterparts for a diagonal and for a scalar covariance.
#[derive(Debug)]
pub struct EstimateLaw<'a> {
    centre: Centre<'a>,
    noise: NoiseLaw,
    /// `root root'` is `Sigma` or S (n, n), or what stands for it.
    root: Vec<f64>,
    chi2: Vec<ChiSquared<f64>>,
}

/// Memory for a draw.
#[derive(Debug)]
pub(crate) struct Drawing {
    /// (n, n)
    triangle: Vec<f64>,
    /// (n, rank + the columns of noise)
    normal: Vec<f64>,
    /// Of the same shape.
    moved: Vec<f64>,
}

impl<'a> EstimateLaw<'a> {
    /// `s` (n, n) is `Sigma` where that is known, else the residual sums of squares and products.
    ///
    /// # Errors
    /// [`Error::Shape`]; [`Error::NonFinite`]; [`Error::Value`] for too few degrees of freedom; [`Error::Memory`].
    pub fn new(centre: Centre<'a>, s: &[f64], noise: NoiseLaw) -> Result<Self> {
        let n = s.len().isqrt();
        let d = centre.model.len().checked_div(n).unwrap_or(0);
        if n == 0 || n * n != s.len() || n * d != centre.model.len() || d == 0 || !centre.white.len().is_multiple_of(d)
        {
            let (expected, found) = ("n x n entries, where H is n x d and white rank x d", s.len());
            return Err(Error::Shape { name: "S", expected: expected.into(), found: format!("{found} entries") });
        }
        require_finite("S", s)?;
        let (count, nu, least, step) = match noise {
            NoiseLaw::Known => (0, 0, 0, 0),
            NoiseLaw::Scalar(nu) => (1, n.saturating_mul(nu), 1, 0),
            NoiseLaw::Diagonal(nu) => (1, nu, 1, 0),
            NoiseLaw::Full(nu) => (n, nu, n, 1),
        };
        if nu < least {
            return Err(Error::Value { name: "nu", expected: "enough degrees of freedom", found: nu.to_string() });
        }
        let refused = |_| Error::Numerical("a chi-square law was refused".into());
        let laws = (0..count).map(|i| ChiSquared::new((nu - step * i) as f64).map_err(refused));
        Ok(Self { centre, noise, root: root(s, n, noise)?, chi2: try_collect_all(WHAT, laws)? })
    }

    /// The estimate (n, d).
    #[must_use]
    pub fn centre(&self) -> &[f64] {
        self.centre.model
    }

    /// The number of states.
    #[must_use]
    pub fn n(&self) -> usize {
        self.root.len().isqrt()
    }

    /// The length of a row of a model.
    #[must_use]
    pub fn d(&self) -> usize {
        self.centre.model.len() / self.n()
    }

    fn rank(&self) -> usize {
        self.centre.white.len() / self.d()
    }

    pub(crate) fn drawing(&self, noises: usize) -> Result<Drawing> {
        let (n, columns) = (self.n(), self.rank() + noises);
        let [normal, moved] = [try_zeros(WHAT, checked_len(WHAT, n, columns)?)?, try_zeros(WHAT, n * columns)?];
        Ok(Drawing { triangle: try_zeros(WHAT, n * n)?, normal, moved })
    }

    /// Draw b: the `model` (n, d), and `noises` (columns, n), a function of the key and b alone.
    pub(crate) fn draw(&self, key: &Key, b: usize, memory: &mut Drawing, model: &mut [f64], noises: &mut [f64]) {
        let (n, rank, mut rng) = (self.n(), self.rank(), key.stream(Purpose::Replicates, b));
        let Drawing { triangle, normal, moved } = memory;
        let columns = normal.len() / n;
        if let NoiseLaw::Full(_) = self.noise {
            for (i, chi2) in self.chi2.iter().enumerate() {
                triangle[i * n..i * n + i].fill_with(|| StandardNormal.sample(&mut rng));
                triangle[i * n + i] = chi2.sample(&mut rng).sqrt();
            }
        }
        normal.fill_with(|| StandardNormal.sample(&mut rng));
        match self.noise {
            NoiseLaw::Known => {}
            NoiseLaw::Scalar(_) => {
                let size = self.chi2[0].sample(&mut rng).sqrt();
                normal.iter_mut().for_each(|value| *value /= size);
            }
            NoiseLaw::Diagonal(_) => {
                for row in normal.chunks_exact_mut(columns.max(1)) {
                    let size = self.chi2[0].sample(&mut rng).sqrt();
                    row.iter_mut().for_each(|value| *value /= size);
                }
            }
            NoiseLaw::Full(_) => {
                // E = T T': T' X = G
                for i in (0..n).rev() {
                    let (row, below) = normal[i * columns..].split_at_mut(columns);
                    for (j, known) in below.chunks_exact(columns.max(1)).enumerate() {
                        let factor = triangle[(i + 1 + j) * n + i];
                        row.iter_mut().zip(known).for_each(|(value, known)| *value -= factor * known);
                    }
                    row.iter_mut().for_each(|value| *value /= triangle[i * n + i]);
                }
            }
        }
        moved.fill(0.0);
        for (to, root) in moved.chunks_exact_mut(columns.max(1)).zip(self.root.chunks_exact(n)) {
            for (factor, from) in root.iter().zip(normal.chunks_exact(columns.max(1))) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
            }
        }
        for (k, noise) in noises.chunks_exact_mut(n).enumerate() {
            noise.iter_mut().enumerate().for_each(|(i, to)| *to = moved[i * columns + rank + k]);
        }
        write_model(moved, columns, self.centre, self.d(), model);
    }

    /// `size` models (n, d), one after another.
    ///
    /// # Errors
    /// [`Error::Memory`], [`Error::Interrupted`].
    pub fn models(&self, key: &Key, size: usize, threads: usize, stop: &Stop) -> Result<Vec<f64>> {
        let one = self.centre.model.len();
        let mut models = try_zeros(WHAT, checked_len(WHAT, size, one)?)?;
        for_each_chunk(models.chunks_mut(BLOCK * one).enumerate(), threads, stop, |(block, models)| {
            let mut memory = self.drawing(0)?;
            for (b, model) in models.chunks_exact_mut(one).enumerate() {
                stop.check()?;
                self.draw(key, block * BLOCK + b, &mut memory, model, &mut []);
            }
            Ok(())
        })?;
        Ok(models)
    }
}

/// A root of `s`; `sqrt(tr s) I` and that of the diagonal for the smaller families.
fn root(s: &[f64], n: usize, noise: NoiseLaw) -> Result<Vec<f64>> {
    let mut root = try_zeros(WHAT, s.len())?;
    let diagonal = |i: usize| s[i * n + i].max(0.0);
    match noise {
        NoiseLaw::Scalar(_) => {
            let size = (0..n).map(diagonal).sum::<f64>().sqrt();
            root.iter_mut().step_by(n + 1).for_each(|to| *to = size);
        }
        NoiseLaw::Diagonal(_) => {
            root.iter_mut().step_by(n + 1).enumerate().for_each(|(i, to)| *to = diagonal(i).sqrt());
        }
        NoiseLaw::Known | NoiseLaw::Full(_) => return covariance_root(s, n),
    }
    Ok(root)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: [f64; 4] = [1.0, 2.0, 3.0, 4.0];
    const WHITE: [f64; 4] = [2.0, 0.0, 0.0, 4.0];
    const S: [f64; 4] = [1.0, 0.5e-3, 0.5e-3, 1e-6];

    fn centre() -> Centre<'static> {
        Centre { model: &MODEL, white: &WHITE }
    }

    #[test]
    fn the_root_is_one_in_all_units() {
        for noise in [NoiseLaw::Known, NoiseLaw::Full(9)] {
            let law = EstimateLaw::new(centre(), &S, noise).unwrap();
            for (i, j) in [(0, 0), (0, 1), (1, 1)] {
                let found: f64 = (0..2).map(|k| law.root[2 * i + k] * law.root[2 * j + k]).sum();
                assert!((found / S[2 * i + j] - 1.0).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn draws_depend_on_their_number_alone_and_noises_follow_the_model() {
        let (stop, key) = (Stop::new(), Key([7; 32]));
        for noise in [NoiseLaw::Known, NoiseLaw::Scalar(9), NoiseLaw::Diagonal(9), NoiseLaw::Full(9)] {
            let law = EstimateLaw::new(centre(), &S, noise).unwrap();
            let many = law.models(&key, 200, 3, &stop).unwrap();
            assert_eq!(many[..280], law.models(&key, 70, 1, &stop).unwrap());
        }
        // S of rank 1: so is every deviation and every noise
        let law = EstimateLaw::new(centre(), &[1.0, 2.0, 2.0, 4.0], NoiseLaw::Full(9)).unwrap();
        let (mut memory, mut model, mut noises) = (law.drawing(3).unwrap(), [0.0; 4], [0.0; 6]);
        law.draw(&key, 5, &mut memory, &mut model, &mut noises);
        for (one, other) in [(model[0] - 1.0, model[2] - 3.0), (noises[0], noises[1]), (noises[4], noises[5])] {
            assert!(one != 0.0 && (other - 2.0 * one).abs() < 1e-7, "{other} is not 2 {one}"); // rounding of a root
        }
    }

    #[test]
    fn wrong_arguments_are_errors() {
        for s in [&S[..3], &[], &[1.0, f64::NAN, 0.0, 1.0]] {
            assert!(EstimateLaw::new(centre(), s, NoiseLaw::Known).is_err());
        }
        assert!(EstimateLaw::new(centre(), &S, NoiseLaw::Full(1)).is_err());
        assert!(EstimateLaw::new(centre(), &S, NoiseLaw::Scalar(0)).is_err());
    }
}
