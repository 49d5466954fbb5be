//! Rows that are no pairs of the plant: readings that are off, jumps of one size, pairs that count twice.

use std::hash::{DefaultHasher, Hash, Hasher};

use super::explained::Outcomes;
use super::given::{Given, Test, WHAT, dot, zeros};
use super::sums::Sums;
use crate::error::Result;
use crate::identify::distributions::{beta_above, chi2_quantile, chi2_upper, normal_above};
use crate::identify::least_squares::{Fitted, fit};
use crate::memory::{checked_len, try_collect, try_copy, try_push, try_room, try_zeros};
use crate::parallel::Stop;

/// Probability of a row of noise being taken for one that is off, over all rows.
const OFF: f64 = 1e-3;
/// Share of the rows with the largest residuals that no fit of the others sees.
const TAIL: f64 = 0.01;
/// Of jumps, in parts of the range of a signal.
const JUMP: f64 = 0.5;

/// Rows with residuals that Gaussian noise does not have: what they are, and whether they move the model.
///
/// The largest part: `e' S^-1 e / (1 - h) ~ Beta(p / 2, (nu - p) / 2)`, with the union over all rows; and Mardia's
/// kurtosis, which many large ones raise that hide each other in S.
pub(super) fn outliers(
    given: &Given<'_>,
    of: &Outcomes<'_>,
    sums: &Sums<'_>,
    tests: &mut Vec<Test>,
    stop: &Stop,
) -> Result<()> {
    let (size, p, nu) = (given.size() as f64, of.p as f64, of.nu as f64);
    let largest = sums.parts.iter().fold(0.0f64, |m, v| m.max(*v));
    let alone = size * beta_above((largest / nu).min(1.0), p / 2.0, (nu - p) / 2.0);
    let fourth = sums.parts.iter().map(|v| v * v).sum::<f64>() / size;
    let heavy = normal_above((fourth - p * (p + 2.0)) / (8.0 * p * (p + 2.0) / size).sqrt());
    // the kurtosis of few pairs is far from Gaussian: only where it leaves no doubt
    let p_value = (2.0 * alone.min(heavy.powf(0.25))).min(1.0);
    let share = (largest / p).sqrt();
    try_push(WHAT, tests, Test { name: "tails", p_value, share, at: Vec::new(), each: Vec::new() })?;
    if p_value > OFF {
        return Ok(());
    }
    let Some(robust) = Robust::of(given, of, sums, stop)? else { return Ok(()) };
    let least = chi2_upper(OFF / size, p)? * robust.scale;
    let off = try_collect(WHAT, (0..given.size()).filter(|&t| robust.parts[t] > least))?;
    if off.is_empty() {
        return Ok(());
    }
    let spikes = robust.spikes(given, &off)?;
    if !spikes.is_empty() {
        let share = spikes.len() as f64 / size;
        let test = Test { name: "spikes", p_value: p_value.min(1e-5), share, at: spikes, each: Vec::new() };
        return try_push(WHAT, tests, test);
    }
    if let Some((state, jump)) = jumps(given, &off)? {
        let at = Vec::from([state]);
        return try_push(WHAT, tests, Test { name: "wrap", p_value, share: jump, at, each: Vec::new() });
    }
    if robust.moved(given)? >= p * given.fitted.rank() as f64 {
        let share = off.len() as f64 / size;
        let at = try_collect(WHAT, off.iter().map(|&t| given.at[t]))?;
        try_push(WHAT, tests, Test { name: "outliers", p_value, share, at, each: Vec::new() })?;
    }
    Ok(())
}

/// Least squares without the rows of the largest residuals.
struct Robust {
    fitted: Fitted,
    /// Residuals (N, n), whitened (N, p), and their squares in deviations (N).
    residuals: Vec<f64>,
    parts: Vec<f64>,
    /// The median of the parts over that of their law.
    scale: f64,
    root: Vec<f64>,
    p: usize,
    nu: f64,
}

impl Robust {
    fn of(given: &Given<'_>, of: &Outcomes<'_>, sums: &Sums<'_>, stop: &Stop) -> Result<Option<Self>> {
        let (d, n, size, p) = (given.d, given.n, given.size(), of.p);
        let median = chi2_quantile(0.5, p as f64)?;
        let cut = chi2_upper(TAIL, p as f64)?;
        let mut parts = try_copy(WHAT, &sums.parts)?;
        let mut found = None;
        for _ in 0..5 {
            let scale = middle(&parts)? / median;
            let kept = |t: &usize| parts[*t] <= cut * scale;
            let count = (0..size).filter(kept).count();
            let mut rows = try_room(WHAT, checked_len(WHAT, count, d + n)?)?;
            for t in (0..size).filter(kept) {
                rows.extend_from_slice(&given.rows[t * (d + n)..(t + 1) * (d + n)]);
            }
            if count <= d + n {
                return Ok(None);
            }
            let fitted = fit(&rows, d + n, d, count, 1, stop)?;
            let Some(inner) = Outcomes::new(&fitted.residual, of.basis, n, fitted.degrees())? else { return Ok(None) };
            let mut residuals = zeros(checked_len(WHAT, size, n)?)?;
            let mut white = zeros(p)?;
            let mut next = zeros(size)?;
            for (t, e) in residuals.chunks_exact_mut(n).enumerate() {
                let (z, y) = (given.z(t), given.y(t));
                e.iter_mut().enumerate().for_each(|(i, to)| *to = y[i] - dot(&fitted.model[i * d..(i + 1) * d], z));
                inner.whiten(e, &mut white);
                let h: f64 = fitted.white.chunks_exact(d.max(1)).map(|row| dot(row, z).powi(2)).sum();
                let wide = if kept(&t) { (1.0 - h).max(1e-12) } else { 1.0 + h };
                next[t] = inner.nu as f64 * dot(&white, &white) / wide;
            }
            let (nu, root) = (inner.nu as f64, inner.root);
            parts = next;
            found = Some((fitted, residuals, root, nu));
        }
        let scale = middle(&parts)? / median;
        Ok(found.map(|(fitted, residuals, root, nu)| Self { fitted, residuals, parts, scale, root, p, nu }))
    }

    /// Squares of a residual in deviations of the noise.
    fn square(&self, given: &Given<'_>, e: &[f64]) -> Result<f64> {
        let of = Outcomes {
            squares: &[],
            basis: given.basis,
            root: try_copy(WHAT, &self.root)?,
            n: given.n,
            p: self.p,
            nu: 1,
        };
        let mut white = zeros(self.p)?;
        of.whiten(e, &mut white);
        Ok(self.nu * dot(&white, &white) / self.scale)
    }

    /// Readings that jump there and back: the residual behind a row that is off is `-A e` of it, as of an error of the
    /// reading between them, and not noise of its own, as after a shock. With `s = ||A e||` in deviations the squares
    /// differ by `s (s + 2 w)`, by `-s (s + 2 w)` after a shock: above c with a probability of at most
    /// `P(w > sqrt(c))`.
    fn spikes(&self, given: &Given<'_>, off: &[usize]) -> Result<Vec<usize>> {
        let (d, n) = (given.d, given.n);
        let mut found = Vec::new();
        if given.extra.is_some() {
            return Ok(found);
        }
        let least = 2.0 * (off.len() as f64 / 1e-4).ln();
        let mut back = zeros(n)?;
        for &t in off {
            let follows =
                t + 1 < given.size() && given.at[t + 1] == given.at[t] + 1 && given.places[given.at[t + 1]] > 0;
            if !follows || found.last() == Some(&given.at[t]) {
                continue;
            }
            let (e, after) = (&self.residuals[t * n..(t + 1) * n], &self.residuals[(t + 1) * n..(t + 2) * n]);
            for (i, to) in back.iter_mut().enumerate() {
                *to = after[i] + dot(&self.fitted.model[i * d..i * d + n], e);
            }
            if self.square(given, after)? - self.square(given, &back)? > least {
                try_push(WHAT, &mut found, given.at[t + 1])?;
            }
        }
        Ok(found)
    }

    /// How far all rows move the model from that of the others: `tr(Sigma^-1 D V D')`, on average `p d` for noise.
    fn moved(&self, given: &Given<'_>) -> Result<f64> {
        let (f, d, n) = (given.fitted, given.d, given.n);
        let mut along = zeros(n)?;
        let mut sum = 0.0;
        for row in f.root.chunks_exact(d.max(1)) {
            for (i, to) in along.iter_mut().enumerate() {
                *to = (0..d).map(|j| (f.model[i * d + j] - self.fitted.model[i * d + j]) * row[j]).sum();
            }
            sum += self.square(given, &along)?;
        }
        Ok(sum)
    }
}

fn middle(values: &[f64]) -> Result<f64> {
    let mut sorted = try_copy(WHAT, values)?;
    let at = sorted.len() / 2;
    Ok(*sorted.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// A state that jumps by one size in the rows that are off, most of its range, and nowhere else: a wrapped angle.
fn jumps(given: &Given<'_>, off: &[usize]) -> Result<Option<(usize, f64)>> {
    let (n, m) = (given.n, given.m);
    for i in 0..n {
        let step = |t: usize| {
            let pair = given.pair(given.at[t]);
            (pair[n + m + i] - pair[i]).abs()
        };
        let read = || given.at.iter().map(|&pair| given.pair(pair)[n + m + i]);
        let range = read().fold(f64::MIN, f64::max) - read().fold(f64::MAX, f64::min);
        let sizes = try_collect(WHAT, off.iter().map(|&t| step(t)).filter(|size| *size > JUMP * range))?;
        if sizes.is_empty() || 2 * sizes.len() < off.len() {
            continue;
        }
        let jump = middle(&sizes)?;
        let mut marked = try_zeros::<u8>(WHAT, given.size())?;
        off.iter().for_each(|&t| marked[t] = 1);
        let calm = (0..given.size()).filter(|&t| marked[t] == 0).all(|t| step(t) < JUMP * jump);
        if calm && sizes.iter().all(|size| (size / jump - 1.0).abs() < 0.1) {
            return Ok(Some((i, jump)));
        }
    }
    Ok(None)
}

/// Pairs that are equal to the last bit: noise does not repeat. Where readings are rounded, outcomes are also equal
/// after unlike states and inputs; and pairs at rest are.
pub(super) fn equal(given: &Given<'_>, tests: &mut Vec<Test>) -> Result<()> {
    let (n, m) = (given.n, given.m);
    let moving = |t: &usize| {
        let pair = given.pair(given.at[*t]);
        pair[..n] != pair[n + m..]
    };
    let mut sorted = try_collect(WHAT, (0..given.size()).filter(moving).map(|t| (of_bits(given.z(t), given.y(t)), t)))?;
    sorted.sort_unstable();
    let same = |a: usize, b: usize| given.pair(given.at[a]) == given.pair(given.at[b]);
    let mut copies = Vec::new();
    for pair in sorted.windows(2) {
        if pair[0].0 == pair[1].0 && same(pair[0].1, pair[1].1) {
            try_push(WHAT, &mut copies, pair[1].1.max(pair[0].1))?;
        }
    }
    let mut after = try_collect(WHAT, (0..given.size()).filter(moving).map(|t| of_bits(&[], given.y(t))))?;
    after.sort_unstable();
    let outcomes = after.windows(2).filter(|pair| pair[0] == pair[1]).count();
    let count = copies.len();
    let found = count >= 2 && 100 * count >= given.size() && 3 * count > 2 * outcomes;
    copies.sort_unstable();
    let at = try_collect(WHAT, copies.into_iter().map(|t| given.at[t]))?;
    let (p_value, share) = (if found { 0.0 } else { 1.0 }, count as f64 / given.size().max(1) as f64);
    try_push(WHAT, tests, Test { name: "equal rows", p_value, share, at, each: Vec::new() })
}

fn of_bits(z: &[f64], y: &[f64]) -> u64 {
    let mut state = DefaultHasher::new();
    z.iter().chain(y).for_each(|v| (v + 0.0).to_bits().hash(&mut state));
    state.finish()
}
