//! How a control may miss, by resampled means: of which nothing is certified.

use rand_distr::{ChiSquared, Distribution, StandardNormal};

use super::data::{DataStream, Feed, GROUPS};
use super::geometry::NAMES;
use crate::error::{Error, Result, require_finite};
use crate::memory::try_zeros;
use crate::parallel::Stop;
use crate::scaled::distance;
use crate::stream::{Key, Purpose};
use crate::vector::dot;

const WHAT: &str = "resampled means";

impl Feed {
    /// `F + r sum_g sqrt(n_g) xi_g (M_g - F) / sqrt((G - 1) N)` of the means `M_g` of `G` groups of `n_g` realizations,
    /// xi standard normal and `r = sqrt((G - 1) / chi^2_(G-1))`: Student's law, whose covariance about F is that of the
    /// groups.
    fn resampled(&self, chi2: ChiSquared<f64>, rng: &mut impl rand::Rng, to: &mut [f64]) {
        to.copy_from_slice(&self.mean);
        let size = 1.0 / (chi2.sample(rng) * self.count as f64).sqrt();
        for (g, group) in self.groups.chunks_exact(to.len()).enumerate() {
            let own = (self.count / GROUPS as u64 + u64::from((g as u64) < self.count % GROUPS as u64)) as f64;
            let xi: f64 = StandardNormal.sample(rng);
            let weight = xi * own.sqrt() * size;
            to.iter_mut().zip(group).zip(&self.mean).for_each(|((to, group), mean)| *to += weight * (group - mean));
        }
    }
}

impl DataStream {
    /// `||x(K) - xf||` under `inputs` (K, m) for `size` resampled means of x0, xf and A; infinite where a run
    /// overflows. Those of an `exact` entity stay.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Value`] for an entity that is neither exact nor has a
    /// realization in each group, or has a target, [`Error::Memory`], [`Error::Interrupted`].
    pub fn misses(&self, inputs: &[f64], exact: [bool; 3], key: &Key, size: usize, stop: &Stop) -> Result<Vec<f64>> {
        let (n, m) = (self.geometry.n, self.geometry.m);
        if inputs.is_empty() || !inputs.len().is_multiple_of(m) {
            let expected = format!("rows of {m}");
            return Err(Error::Shape { name: "inputs", expected, found: format!("{} entries", inputs.len()) });
        }
        require_finite("inputs", inputs)?;
        for ((feed, name), exact) in self.feeds.iter().zip(NAMES).zip(exact) {
            let enough = if exact { feed.count > 0 } else { feed.count >= GROUPS as u64 };
            if feed.target.is_some() || !enough {
                let expected = "the mean of 16 realizations or more, or known by a range of 0";
                return Err(Error::Value { name, expected, found: feed.count.to_string() });
            }
        }
        let chi2 = ChiSquared::new((GROUPS - 1) as f64).map_err(|_| Error::Numerical(WHAT.into()))?;
        let [mut x, mut xf, mut next] = [try_zeros(WHAT, n)?, try_zeros(WHAT, n)?, try_zeros(WHAT, n)?];
        let (mut a, mut misses) = (try_zeros(WHAT, self.feeds[2].mean.len())?, try_zeros(WHAT, size)?);
        for (draw, miss) in misses.iter_mut().enumerate() {
            stop.check()?;
            let mut rng = key.stream(Purpose::Replicates, draw);
            for ((feed, to), exact) in self.feeds.iter().zip([&mut x, &mut xf, &mut a]).zip(exact) {
                if exact {
                    to.copy_from_slice(&feed.mean);
                } else {
                    feed.resampled(chi2, &mut rng, to);
                }
            }
            for u in inputs.chunks_exact(m) {
                let rows = a.chunks_exact(n).zip(self.geometry.b.chunks_exact(m));
                next.iter_mut().zip(rows).for_each(|(to, (a, b))| *to = dot(a, &x) + dot(b, u));
                x.copy_from_slice(&next);
            }
            *miss = distance(&x, &xf);
            if miss.is_nan() {
                *miss = f64::INFINITY;
            }
        }
        Ok(misses)
    }
}
