//! A stream of realizations from outside: running means, or line searches towards targets.

use super::geometry::{Geometry, NAMES};
use crate::control::Best;
use crate::error::{Error, Result, sized};
use crate::fuse::{Dense, distance, norm, step_towards};
use crate::memory::{checked_len, try_collect, try_zeros};
use crate::parallel::Stop;

const WHAT: &str = "a stream";
/// Largest relative error of one rounding.
const U: f64 = 0.5 * f64::EPSILON;
/// Realization i counts in group i mod this one as well, whose means say how the mean of all scatters.
pub(super) const GROUPS: usize = 16;

/// One entity: its estimate, and the spread of its realizations.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Feed {
    /// the mean of the realizations, or their fusion towards the target
    pub(super) estimate: Vec<f64>,
    pub(super) mean: Vec<f64>,
    pub(super) target: Option<Vec<f64>>,
    pub(super) first: Vec<f64>,
    pub(super) count: u64,
    /// `sqrt(sum_i ||E_i - mean||^2)`
    pub(super) deviation: f64,
    /// `max_i ||E_i - E_1||`
    pub(super) spread: f64,
    /// The smallest and the largest value of every entry; empty with a target.
    pub(super) low: Vec<f64>,
    pub(super) high: Vec<f64>,
    /// The means of the groups (GROUPS, dim); empty with a target.
    pub(super) groups: Vec<f64>,
}

impl Feed {
    fn new(dim: usize, target: Option<Vec<f64>>) -> Result<Self> {
        let kept = if target.is_some() { dim } else { 0 };
        Ok(Self {
            estimate: try_zeros(WHAT, kept)?,
            mean: try_zeros(WHAT, dim)?,
            target,
            first: try_zeros(WHAT, dim)?,
            count: 0,
            deviation: 0.0,
            spread: 0.0,
            low: try_zeros(WHAT, dim - kept)?,
            high: try_zeros(WHAT, dim - kept)?,
            groups: try_zeros(WHAT, checked_len(WHAT, GROUPS, dim - kept)?)?,
        })
    }

    fn current(&self) -> &[f64] {
        if self.target.is_some() { &self.estimate } else { &self.mean }
    }

    /// Takes in one realization; after an error, nothing has changed.
    fn push(&mut self, e: &[f64]) -> Result<()> {
        const TOO_LARGE: Error = Error::Overflow { what: "the difference of two realizations" };
        if self.count == 0 {
            self.mean.copy_from_slice(e);
            self.first.copy_from_slice(e);
            if self.target.is_some() {
                self.estimate.copy_from_slice(e);
            } else {
                self.low.copy_from_slice(e);
                self.high.copy_from_slice(e);
                self.groups[..e.len()].copy_from_slice(e);
            }
            self.count = 1;
            return Ok(());
        }
        let n = (self.count + 1) as f64;
        let apart = distance(e, &self.mean);
        let spread = self.spread.max(distance(e, &self.first));
        // sum_i ||E_i - mean||^2 grows by ||E - mean||^2 (n - 1) / n
        let deviation = self.deviation.hypot(apart * ((n - 1.0) / n).sqrt());
        if !spread.is_finite() || !deviation.is_finite() {
            return Err(TOO_LARGE);
        }
        if let Some(target) = &self.target {
            let off = |m: f64, ((f, e), t): ((&f64, &f64), &f64)| m.max((e - f).abs()).max((t - f).abs());
            let far = self.estimate.iter().zip(e).zip(target).fold(0.0, off);
            if !(far * (e.len() as f64).sqrt()).is_finite() {
                return Err(TOO_LARGE); // nor is its norm finite
            }
            step_towards(&mut self.estimate, |k| e[k], target, 1.0 / far.max(f64::MIN_POSITIVE));
        }
        self.mean.iter_mut().zip(e).for_each(|(mean, e)| *mean += (e - *mean) / n);
        self.low.iter_mut().zip(e).for_each(|(low, e)| *low = low.min(*e));
        self.high.iter_mut().zip(e).for_each(|(high, e)| *high = high.max(*e));
        let group = (self.count % GROUPS as u64) as usize;
        let own = (self.count / GROUPS as u64 + 1) as f64;
        let group = self.groups.iter_mut().skip(group * e.len());
        group.zip(e).for_each(|(mean, e)| *mean += (e - *mean) / own);
        (self.spread, self.deviation, self.count) = (spread, deviation, self.count + 1);
        Ok(())
    }

    /// A bound on the rounding error of the running mean, `u (N S + 4 spread)` with `u = 2^-53` and
    /// `S = sqrt(sum_k max |E_k|^2)`: update i adds at most `u |mean| + 2 u |E - mean| / i` to the error before it,
    /// which shrinks by `1 - 1 / i`, and `|E - mean| <= 2 spread`. 0 if all realizations are equal: then the mean is
    /// exact.
    fn rounding(&self) -> f64 {
        if self.spread == 0.0 {
            return 0.0;
        }
        let size = norm(self.low.iter().zip(&self.high).map(|(l, h)| l.abs().max(h.abs())));
        U * (self.count as f64 * size + 4.0 * self.spread) + f64::MIN_POSITIVE
    }

    /// A lower bound on the largest distance of two realizations of a mean: the largest of
    /// - `max_i ||E_i - E_1||`;
    /// - `max - min` of an entry;
    /// - the root mean square distance of a pair, `sqrt(2 / (N - 1))` times the deviation, since
    ///   `sum_{i<j} ||E_i - E_j||^2 = N sum_i ||E_i - mean||^2`.
    ///
    /// Each is lowered by its rounding error, so that no correct bound is refuted: for d entries by `(d + 8) u` of a
    /// distance; for the deviation by `4 N u` more, and by `sqrt(N)` times the rounding error of the mean. The
    /// difference of two doubles needs no allowance, because rounding is monotonic.
    fn apart(&self) -> f64 {
        if self.spread == 0.0 {
            return 0.0;
        }
        let (n, d) = (self.count as f64, self.first.len() as f64);
        let width = self.low.iter().zip(&self.high).fold(0.0f64, |width, (low, high)| width.max(high - low));
        let deviation = self.deviation * (1.0 - (4.0 * n + d + 8.0) * U) - n.sqrt() * self.rounding();
        let pair = deviation * ((2.0 / (n - 1.0)).sqrt() * (1.0 - 4.0 * U));
        (self.spread * (1.0 - (d + 8.0) * U) - f64::MIN_POSITIVE).max(width).max(pair)
    }
}

/// The sequential algorithm on realizations that are passed in.
#[derive(Debug)]
pub struct DataStream {
    pub(super) geometry: Geometry,
    /// `x0`, `xf`, `A` (row by row)
    pub(super) feeds: [Feed; 3],
}

impl DataStream {
    /// A stream without realizations. An entity without a target is averaged.
    ///
    /// # Errors
    /// [`Error::Shape`] if a target does not fit `B`.
    pub fn new(geometry: Geometry, targets: [Option<Vec<f64>>; 3]) -> Result<Self> {
        let n = geometry.n;
        let dims = [n, n, checked_len("A", n, n)?];
        for ((name, dim), target) in NAMES.into_iter().zip(dims).zip(&targets) {
            sized(name, target.as_ref().map_or(dim, Vec::len), dim)?;
        }
        let [x0, xf, a] = targets;
        let feeds = [Feed::new(dims[0], x0)?, Feed::new(dims[1], xf)?, Feed::new(dims[2], a)?];
        Ok(Self { geometry, feeds })
    }

    /// Takes in realizations of entity 0 (`x0`), 1 (`xf`) or 2 (`A`, row by row), in order.
    ///
    /// # Errors
    /// [`Error::Overflow`] for a realization whose distance to the others is not representable, [`Error::Interrupted`]
    /// after a stop; the realizations before are taken in.
    pub fn update(&mut self, entity: usize, samples: &Dense<'_>, stop: &Stop) -> Result<()> {
        let feed = &mut self.feeds[entity];
        if samples.dim() != feed.mean.len() {
            let (expected, found) = (format!("{} entries per realization", feed.mean.len()), samples.dim().to_string());
            return Err(Error::Shape { name: NAMES[entity], expected, found });
        }
        let check_every = (1 << 17) / samples.dim() + 1;
        for i in 0..samples.size() {
            if i % check_every == 0 {
                stop.check()?;
            }
            feed.push(samples.row(i))?;
        }
        Ok(())
    }

    /// States.
    pub fn n(&self) -> usize {
        self.geometry.n
    }

    /// Number of realizations.
    pub fn counts(&self) -> [u64; 3] {
        [0, 1, 2].map(|k| self.feeds[k].count)
    }

    /// The estimates; zeros before the first realization.
    pub fn estimates(&self) -> [&[f64]; 3] {
        [0, 1, 2].map(|k| self.feeds[k].current())
    }

    /// `sqrt(sum_i ||E_i - mean||^2)`.
    pub fn deviations(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.feeds[k].deviation)
    }

    /// `max_i ||E_i - E_1||`.
    pub fn spreads(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.feeds[k].spread)
    }

    /// A lower bound on the largest distance of two realizations.
    pub fn apart(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.feeds[k].apart())
    }

    /// A bound on the rounding error of the mean.
    pub fn rounding(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.feeds[k].rounding())
    }

    /// `||F - target||`; NaN without a target.
    pub fn residuals(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.feeds[k].target.as_ref().map_or(f64::NAN, |t| distance(self.feeds[k].current(), t)))
    }

    /// The control `v = B^+ (Ff - FA F0)`, with its rounding.
    ///
    /// # Errors
    /// [`Error::Overflow`] if it is not representable, [`Error::Memory`].
    pub fn control(&self) -> Result<Best> {
        let [x0, xf, a] = self.estimates();
        self.geometry.best(a, x0, xf)
    }

    /// The certificate towards the targets, with the rounding of the control, and `||B (v - v*)||` for the control in
    /// doubles; `None` unless all three have one.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn certificate(&self) -> Result<Option<(f64, f64)>> {
        let [x0, xf, a] = &self.feeds;
        let (Some(t0), Some(tf), Some(ta)) = (&x0.target, &xf.target, &a.target) else { return Ok(None) };
        let (d0, df, da) = (minus(x0.current(), t0)?, minus(xf.current(), tf)?, minus(a.current(), ta)?);
        let apart = minus(&df, &rows_times(ta, &d0)?)?;
        let mut off = minus(&apart, &rows_times(&da, x0.current())?)?;
        let matrix = size(&da) * size(x0.current());
        let mut room = try_zeros(WHAT, self.geometry.n)?;
        let bound = self.geometry.projected_norm(&apart, &mut room) + matrix;
        let best = self.control()?;
        // sums of n + 3 terms (Higham, Accuracy and Stability of Numerical Algorithms (2002), 3.1)
        let terms = (self.geometry.n + 8) as f64 * f64::EPSILON;
        let sums = terms * (bound + size(&df) + size(ta) * size(&d0));
        let rounding = self.geometry.rounding(&apart, &best.needed);
        off.iter_mut().zip(&best.shift).for_each(|(off, shift)| *off += shift);
        Ok(Some((bound + sums + rounding, self.geometry.projected_norm(&off, &mut room))))
    }
}

/// `A x` for a square matrix given row by row.
fn rows_times(rows: &[f64], x: &[f64]) -> Result<Vec<f64>> {
    try_collect(WHAT, rows.chunks_exact(x.len()).map(|row| crate::vector::dot(row, x)))
}

fn minus(a: &[f64], b: &[f64]) -> Result<Vec<f64>> {
    try_collect(WHAT, a.iter().zip(b).map(|(a, b)| a - b))
}

pub(super) fn size(v: &[f64]) -> f64 {
    norm(v.iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_spreads_and_line_searches() {
        let geometry = Geometry::new(vec![1.0, 0.0, 0.0, 2.0], 2, 2).unwrap();
        let mut data = DataStream::new(geometry, [None, Some(vec![0.0, 0.0]), None]).unwrap();
        let feed = |data: &mut DataStream, entity, values: &[f64], dim| {
            data.update(entity, &Dense::new(values, values.len() / dim, dim).unwrap(), &Stop::new())
        };
        // (1,0), (0,2), (-1,-2) towards 0: SLSE^2 = 4/25, while the mean is exact
        let three = [1.0, 0.0, 0.0, 2.0, -1.0, -2.0];
        feed(&mut data, 0, &three, 2).unwrap();
        feed(&mut data, 1, &three, 2).unwrap();
        feed(&mut data, 2, &[1.0, 2.0, 3.0, 4.0], 4).unwrap();
        assert_eq!(data.counts(), [3, 3, 1]);
        assert!(data.estimates()[0].iter().all(|f| f.abs() < 1e-15));
        assert!((data.residuals()[1].powi(2) - 4.0 / 25.0).abs() < 1e-14);
        assert!((data.deviations()[0].powi(2) - 10.0).abs() < 1e-13);
        assert!((data.spreads()[0].powi(2) - 8.0).abs() < 1e-13);
        // distance sqrt(8) from the first, ranges 2 and 4 of the entries, and root mean square distance sqrt(10) of the
        // pairs
        assert_eq!([data.apart()[0], data.apart()[2]], [4.0, 0.0]);
        assert_eq!(data.certificate(), Ok(None));
        assert!(matches!(feed(&mut data, 2, &three, 2), Err(Error::Shape { name: "A", .. })));
        let back = DataStream::from_sections(data.to_sections().unwrap()).unwrap();
        assert_eq!(back.to_sections(), data.to_sections());
    }

    #[test]
    fn what_overflows_changes_nothing() {
        let geometry = Geometry::new(vec![1.0], 1, 1).unwrap();
        let mut data = DataStream::new(geometry, [None, None, None]).unwrap();
        let far = [1.2e308, -1.2e308];
        let before = |data: &DataStream| data.feeds[0].clone();
        assert!(data.update(0, &Dense::new(&far[..1], 1, 1).unwrap(), &Stop::new()).is_ok());
        let kept = before(&data);
        assert!(data.update(0, &Dense::new(&far[1..], 1, 1).unwrap(), &Stop::new()).is_err());
        assert_eq!(before(&data), kept);
    }
}
