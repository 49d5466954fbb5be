//! Held-out runs and fresh systems against the states that a plan predicts: scores, and the order statistic that the
//! next score exceeds with at most a given probability, whatever the law.

use super::systems::{Systems, WHAT};
use crate::control::{times, transposed};
use crate::error::{Error, Result, require_finite, sized};
use crate::identify::{Symmetric, f_upper};
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_copy, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::scaled::distance;

/// Runs that are scored as one piece of work.
const CHUNK: usize = 64;

/// The states `p(0) .. p(K)` of a plan with n states, and how a run is compared with them.
///
/// A run that begins at `x(0)` is predicted at `p(k) + A^k (x(0) - p(0))`.
#[derive(Debug, Clone, Copy)]
pub struct Predicted<'a> {
    /// States.
    pub n: usize,
    /// `(K + 1) n` entries; or so many for each run, which is then predicted by its own, from its own start.
    pub path: &'a [f64],
    /// `n n` entries, one row after another.
    pub a: &'a [f64],
    /// The unit of the deviation of each state in each step: `K n` entries > 0, for `x(1) .. x(K)`.
    pub scale: &'a [f64],
    /// n entries.
    pub target: &'a [f64],
}

/// Of each run: the largest deviation of a state, in its units, and `||x(K) - target||`; infinite for a run that
/// diverged.
#[derive(Debug, PartialEq)]
#[non_exhaustive]
pub struct Scores {
    /// The largest deviations.
    pub deviations: Vec<f64>,
    /// The misses.
    pub misses: Vec<f64>,
}

impl Predicted<'_> {
    /// Scores of runs of `(K + 1) n` entries each, nan after the end of a run that was aborted.
    ///
    /// # Errors
    /// [`Error::Shape`] if the arrays do not fit together, [`Error::NonFinite`] for what is not of the runs,
    /// [`Error::Value`] for a unit that is not positive, [`Error::Memory`], [`Error::Interrupted`] after a stop.
    pub fn runs(&self, runs: &[f64], threads: usize, stop: &Stop) -> Result<Scores> {
        self.checked()?;
        let one = self.one();
        if runs.is_empty() || !runs.len().is_multiple_of(one) {
            let expected = format!("a multiple of {one} entries");
            return Err(Error::Shape { name: "runs", expected, found: runs.len().to_string() });
        }
        if self.path.len() != one && self.path.len() != runs.len() {
            let expected = format!("{one} entries, or those of {} runs", runs.len() / one);
            return Err(Error::Shape { name: "predicted", expected, found: self.path.len().to_string() });
        }
        self.scored(runs.len() / one, threads, stop, |r, run| {
            run.copy_from_slice(&runs[r * one..(r + 1) * one]);
            Ok(())
        })
    }

    /// Scores of systems that are run once each.
    ///
    /// # Errors
    /// As [`Predicted::runs`], and as [`Systems::run`] but for an overflow, which is a run that diverged.
    pub fn systems(&self, systems: &Systems<'_>, threads: usize, stop: &Stop) -> Result<Scores> {
        self.checked()?;
        let (size, steps) = (systems.checked()?, self.scale.len() / self.n);
        if self.path.len() != self.one() || systems.n != self.n || systems.steps() != steps {
            let found = format!("{} states and {} steps", systems.n, systems.steps());
            return Err(Error::Shape {
                name: "systems",
                expected: format!("{} states and {steps} steps", self.n),
                found,
            });
        }
        self.scored(size, threads, stop, |s, run| systems.path(s, run, stop))
    }

    /// `fill` writes the states of a run.
    fn scored(
        &self,
        size: usize,
        threads: usize,
        stop: &Stop,
        fill: impl Fn(usize, &mut [f64]) -> Result<()> + Sync,
    ) -> Result<Scores> {
        let (mut deviations, mut misses) = (try_zeros(WHAT, size)?, try_zeros(WHAT, size)?);
        let chunks = deviations.chunks_mut(CHUNK).zip(misses.chunks_mut(CHUNK)).enumerate();
        for_each_chunk(chunks, threads, stop, |(index, (deviations, misses))| {
            let mut run = try_zeros(WHAT, self.one())?;
            let (mut off, mut next) = (try_zeros(WHAT, self.n)?, try_zeros(WHAT, self.n)?);
            for (at, (deviation, miss)) in deviations.iter_mut().zip(misses).enumerate() {
                stop.check()?;
                let r = index * CHUNK + at;
                fill(r, &mut run)?;
                let path =
                    if self.path.len() == run.len() { self.path } else { &self.path[r * run.len()..][..run.len()] };
                let finite = run.iter().all(|v| v.is_finite());
                *deviation = if finite { self.deviation(path, &run, &mut off, &mut next) } else { f64::INFINITY };
                *miss = if finite { self.miss(&run) } else { f64::INFINITY };
            }
            Ok(())
        })?;
        Ok(Scores { deviations, misses })
    }

    /// Entries of a run.
    fn one(&self) -> usize {
        self.scale.len().saturating_add(self.n)
    }

    /// `max_{k, i} |x(k) - p(k) - A^k (x(0) - p(0))|_i / s(k)_i`
    fn deviation(&self, path: &[f64], run: &[f64], off: &mut [f64], next: &mut [f64]) -> f64 {
        let n = self.n;
        off.iter_mut().zip(run).zip(path).for_each(|((to, x), p)| *to = x - p);
        let steps = run.chunks_exact(n).zip(path.chunks_exact(n)).skip(1).zip(self.scale.chunks_exact(n));
        let mut largest: f64 = 0.0;
        for ((x, p), scale) in steps {
            for (to, row) in next.iter_mut().zip(self.a.chunks_exact(n)) {
                *to = row.iter().zip(&*off).map(|(a, v)| a * v).sum();
            }
            off.copy_from_slice(next);
            for (((x, p), shift), unit) in x.iter().zip(p).zip(&*off).zip(scale) {
                let found = (x - p - shift).abs() / unit;
                // 0 inf is nan in a prediction that overflows: no deviation is known
                largest = if found.is_nan() { f64::INFINITY } else { largest.max(found) };
            }
        }
        largest
    }

    fn miss(&self, run: &[f64]) -> f64 {
        let last = &run[run.len() - self.n..];
        // the largest entry is taken out, so that no square overflows or vanishes
        let top = last.iter().zip(self.target).map(|(x, t)| (x - t).abs()).fold(0.0, f64::max);
        if top == 0.0 || top == f64::INFINITY {
            return top;
        }
        top * last.iter().zip(self.target).map(|(x, t)| ((x - t) / top).powi(2)).sum::<f64>().sqrt()
    }

    fn checked(&self) -> Result<()> {
        let n = self.n;
        let fits = |name, values: &[f64], len: usize| {
            sized(name, values.len(), len)?;
            require_finite(name, values)
        };
        let one = self.one();
        if n == 0
            || one < 2 * n
            || !one.is_multiple_of(n)
            || !self.path.len().is_multiple_of(one)
            || self.path.is_empty()
        {
            let expected = "one step of one state at least".into();
            return Err(Error::Shape { name: "predicted", expected, found: self.path.len().to_string() });
        }
        require_finite("predicted", self.path)?;
        fits("A", self.a, checked_len(WHAT, n, n)?)?;
        fits("scale", self.scale, one - n)?;
        fits("target", self.target, n)?;
        match self.scale.iter().find(|&&v| v <= 0.0) {
            Some(v) => Err(Error::Value { name: "scale", expected: "> 0", found: v.to_string() }),
            None => Ok(()),
        }
    }
}

/// The deviations that noise of a covariance (n, n) gives to `x(1) .. x(K)`, the roots of the diagonal of
/// `sum_{p < k} A^p Sigma A^p'`: (K, n), not finite where it overflows.
///
/// # Errors
/// [`Error::Shape`], [`Error::Memory`].
pub fn noise_deviations<'a>(
    a: impl Into<MatrixView<'a>>,
    covariance: impl Into<MatrixView<'a>>,
    steps: usize,
) -> Result<Vec<f64>> {
    let a = a.into();
    let n = a.shape().0.max(1);
    let (a, covariance) = (a.sized("A", n, n)?, covariance.into().sized("covariance", n, n)?);
    let (back, mut total) = (transposed(&a, n)?, try_zeros(WHAT, a.len())?);
    let mut found = try_zeros(WHAT, checked_len(WHAT, steps, n)?)?;
    for row in found.chunks_exact_mut(n) {
        total = times(&times(&a, &total, n)?, &back, n)?;
        total.iter_mut().zip(&*covariance).for_each(|(to, v)| *to += v);
        row.iter_mut().zip(total.iter().step_by(n + 1)).for_each(|(to, v)| *to = if *v < 0.0 { 0.0 } else { v.sqrt() });
    }
    Ok(found)
}

/// A bound of `||E x - target||` of which Gaussian x the rows of `ends` are independent draws, with probability
/// `1 - delta` (Hotelling): `||mean - target|| + sqrt(lam_max(S) n (M - 1) / (M (M - n)) F_{n, M - n}(delta))`,
/// infinite for `M <= n`.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Memory`].
pub fn mean_miss(ends: &[f64], target: &[f64], delta: f64) -> Result<f64> {
    let (n, size) = (target.len(), ends.len().checked_div(target.len()).unwrap_or(0));
    if size == 0 || ends.len() != size * n {
        let expected = format!("rows of {n} entries");
        return Err(Error::Shape { name: "ends", expected, found: ends.len().to_string() });
    }
    require_finite("ends", ends)?;
    require_finite("target", target)?;
    if size <= n {
        return Ok(f64::INFINITY);
    }
    let (mut mean, mut spread) = (try_zeros(WHAT, n)?, Symmetric::new(n)?);
    for row in ends.chunks_exact(n) {
        mean.iter_mut().zip(row).for_each(|(to, x)| *to += x / size as f64);
    }
    for row in ends.chunks_exact(n) {
        for (i, line) in spread.matrix.chunks_exact_mut(n).enumerate() {
            for (j, to) in line.iter_mut().enumerate() {
                *to += (row[i] - mean[i]) * (row[j] - mean[j]);
            }
        }
    }
    // the divisor M - 1 of S goes with the factor M - 1
    let factor = n as f64 / (size as f64 * (size - n) as f64) * f_upper(delta, n as f64, (size - n) as f64)?;
    Ok(distance(&mean, target) + (spread.largest()?.max(0.0) * factor).sqrt())
}

/// The score of this rank, from 1; infinite beyond the last one.
///
/// # Errors
/// [`Error::Value`] for a score that is nan, [`Error::Memory`].
pub fn order_statistic(scores: &[f64], rank: usize) -> Result<f64> {
    let mut sorted = try_copy(WHAT, scores)?;
    not_nan(&sorted)?;
    sorted.sort_unstable_by(f64::total_cmp);
    Ok(rank.checked_sub(1).map_or(f64::NEG_INFINITY, |at| sorted.get(at).copied().unwrap_or(f64::INFINITY)))
}

/// The smallest score s with `sum_{s_i > s} w_i + w_new <= delta (sum w + w_new)`, infinite if there is none
/// (Tibshirani, Barber, Candes, Ramdas 2019). The last weight is `w_new`, of the run to come.
///
/// # Errors
/// [`Error::Shape`] if there is not one weight more than scores, [`Error::Value`] for a score that is nan or a weight
/// that is not in `[0, inf)`, [`Error::Memory`].
pub fn weighted_order_statistic(scores: &[f64], weights: &[f64], delta: f64) -> Result<f64> {
    not_nan(scores)?;
    sized("weights", weights.len(), scores.len() + 1)?;
    if let Some(w) = weights.iter().find(|w| !(0.0..f64::INFINITY).contains(*w)) {
        return Err(Error::Value { name: "weights", expected: ">= 0 and finite", found: w.to_string() });
    }
    let top = weights.iter().copied().fold(0.0, f64::max);
    if top == 0.0 {
        return Ok(f64::INFINITY);
    }
    let mut order: Vec<(f64, f64)> =
        crate::memory::try_collect(WHAT, scores.iter().copied().zip(weights.iter().map(|w| w / top)))?;
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let new = weights[scores.len()] / top;
    let allowed = delta * (order.iter().map(|(_, w)| w).sum::<f64>() + new);
    let (mut above, mut found) = (new, f64::INFINITY);
    for one in order.chunk_by(|a, b| a.0 == b.0) {
        if above > allowed {
            break;
        }
        found = one[0].0;
        above += one.iter().map(|(_, w)| w).sum::<f64>();
    }
    Ok(found)
}

fn not_nan(scores: &[f64]) -> Result<()> {
    if scores.iter().any(|s| s.is_nan()) {
        return Err(Error::Value { name: "scores", expected: "numbers", found: "nan".into() });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAN: Predicted<'_> =
        Predicted { n: 1, path: &[1.0, 2.0, 3.0], a: &[2.0], scale: &[1.0, 4.0], target: &[0.5] };

    #[test]
    fn runs_by_hand() {
        let runs = [1.0, 2.5, 3.0, 2.0, 4.0, 3.0, 1.0, f64::NAN, f64::NAN, 1.0, f64::INFINITY, 0.0];
        for threads in [1, 3] {
            let found = PLAN.runs(&runs, threads, &Stop::new()).unwrap();
            // the second begins 1 off and is predicted at 4 and 7
            assert_eq!(found.deviations, [0.5, 1.0, f64::INFINITY, f64::INFINITY]);
            assert_eq!(found.misses, [2.5, 2.5, f64::INFINITY, f64::INFINITY]);
        }
    }

    #[test]
    fn runs_of_a_loop_have_paths_of_their_own() {
        let (path, runs) = ([1.0, 2.0, 3.0, 2.0, 4.0, 6.0], [1.0, 2.5, 3.0, 2.0, 4.0, 8.0]);
        let found = Predicted { path: &path, ..PLAN }.runs(&runs, 1, &Stop::new()).unwrap();
        assert_eq!(found, Scores { deviations: vec![0.5, 0.5], misses: vec![2.5, 7.5] });
    }

    #[test]
    fn the_mean_of_one_state_is_that_of_student() {
        // mean 2, S = 1, t_2(.025)^2 = F_{1,2}(.05) = 18.51282
        let found = mean_miss(&[1.0, 2.0, 3.0], &[0.0], 0.05).unwrap();
        assert!((found - (2.0 + (18.512_820_512_820_51_f64 / 3.0).sqrt())).abs() < 1e-9, "{found}");
        assert_eq!(mean_miss(&[1.0, 2.0, 3.0, 4.0], &[0.0, 0.0], 0.05).unwrap(), f64::INFINITY);
        assert!(mean_miss(&[1.0, 2.0, 3.0], &[0.0, 0.0], 0.05).is_err());
    }

    #[test]
    fn noise_grows_with_the_steps() {
        let found = noise_deviations(&[[2.0, 0.0], [1.0, 0.0]], &[[1.0, 0.0], [0.0, 4.0]], 3).unwrap();
        let squares = found.iter().map(|v| v * v);
        // the second state is the first one step before
        assert!(squares.zip([1.0, 4.0, 5.0, 5.0, 21.0, 9.0]).all(|(v, expected)| (v - expected).abs() < 1e-12));
        assert!(!noise_deviations(&[[1e200]], &[[1.0]], 4).unwrap()[3].is_finite());
        assert!(noise_deviations(&[[1.0]], &[[1.0, 1.0]], 4).is_err());
    }

    #[test]
    fn systems_are_scored_as_their_runs() {
        let (a, b, x0, u) = ([1.0, 1e300], [1.0, 1e300], [1.0], [1.0, 1e10]);
        let systems = Systems { n: 1, m: 1, a: &a, b: &b, c: None, x0: &x0, u: &u };
        let found = PLAN.systems(&systems, 2, &Stop::new()).unwrap();
        let runs = [1.0, 2.0, 2.0 + 1e10, 1.0, f64::INFINITY, f64::INFINITY];
        assert_eq!(found, PLAN.runs(&runs, 1, &Stop::new()).unwrap());
        let short = Systems { u: &u[..1], ..systems };
        assert!(matches!(PLAN.systems(&short, 1, &Stop::new()), Err(Error::Shape { .. })));
    }

    #[test]
    fn misses_have_no_scale() {
        for scale in [1e-200, 1.0, 1e200] {
            let (path, run) = ([0.0; 4], [0.0, 0.0, 3.0 * scale, 4.0 * scale]);
            let plan = Predicted { n: 2, path: &path, a: &[0.0; 4], scale: &[1.0; 2], target: &[0.0; 2] };
            let found = plan.runs(&run, 1, &Stop::new()).unwrap().misses[0];
            assert!((found / (5.0 * scale) - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn order_statistics_by_hand() {
        let scores = [4.0, 1.0, 3.0, 2.0];
        let weights = [1.0, 1.0, 2.0, 0.5, 1.0];
        assert_eq!(order_statistic(&scores, 3).unwrap(), 3.0);
        assert_eq!(order_statistic(&scores, 5).unwrap(), f64::INFINITY);
        assert_eq!(weighted_order_statistic(&scores, &weights, 0.2).unwrap(), 4.0);
        assert_eq!(weighted_order_statistic(&scores, &weights, 0.1).unwrap(), f64::INFINITY);
        assert_eq!(weighted_order_statistic(&scores, &weights, 0.4).unwrap(), 3.0);
        // ties are one score
        assert_eq!(weighted_order_statistic(&[1.0, 2.0, 2.0], &[1.0; 4], 0.5).unwrap(), 2.0);
        assert_eq!(weighted_order_statistic(&[1.0, 1.0, 2.0], &[1.0; 4], 0.5).unwrap(), 1.0);
        assert!(order_statistic(&[f64::NAN], 1).is_err());
        for wrong in [&weights[..4], &[1.0, 1.0, 1.0, 1.0, -1.0], &[1.0, 1.0, 1.0, 1.0, f64::NAN]] {
            assert!(weighted_order_statistic(&scores, wrong, 0.2).is_err());
        }
        assert_eq!(weighted_order_statistic(&scores, &[0.0; 5], 0.2).unwrap(), f64::INFINITY);
    }

    #[test]
    fn wrong_arguments_and_a_stop_are_errors() {
        let stop = Stop::new();
        for (wrong, runs) in [
            (Predicted { path: &[1.0], ..PLAN }, 3),
            (Predicted { path: &[1.0; 6], ..PLAN }, 3),
            (Predicted { path: &[1.0, 2.0, f64::NAN], ..PLAN }, 3),
            (Predicted { a: &[], ..PLAN }, 3),
            (Predicted { scale: &[1.0], ..PLAN }, 3),
            (Predicted { scale: &[1.0, 0.0], ..PLAN }, 3),
            (Predicted { target: &[1.0, 1.0], ..PLAN }, 3),
            (PLAN, 0),
            (PLAN, 4),
        ] {
            assert!(wrong.runs(&vec![0.0; runs], 1, &stop).is_err(), "{wrong:?} {runs}");
        }
        stop.request();
        assert_eq!(PLAN.runs(&[0.0; 3], 1, &stop), Err(Error::Interrupted));
    }
}
