//! The map of K steps: the effect of the inputs on the weighted states.

use std::sync::OnceLock;

use crate::error::{Error, Result, require_finite, sized};
use crate::limits::bounds::Bounds;
use crate::limits::linear::{least_eigenvalue, only_diagonal, root, times};
use crate::limits::rows::Rows;
use crate::limits::solve::Penalty;
use crate::matrix::MatrixView;
use crate::memory::{checked_len, try_copy, try_extend, try_room, try_zeros};
use crate::vector;

pub(super) const WHAT: &str = "the control within limits";

/// `R` of a task without one: this share of the mean eigenvalue of `G'QG`.
pub(super) const REGULAR: f64 = 1e-8;

/// From this many inputs on the recursion of Riccati is faster than the condensed map, unless its work,
/// `n^2 (3 n + 4 m)` for each step and factorization, is larger.
const LONG: usize = 250;
/// From this growth of the powers of `A` on states and inputs are kept together: `J` has lost 8 of its 16 digits in the
/// condensed map.
const GROWTH: f64 = 1e4;
/// From this growth on loops use a table of Riccati's recursion: inputs of the map have lost 3 of 16 digits.
const STEEP: f64 = 10.0;
/// What rounding makes of a symmetric weight without eigenvalues below 0, relative to its largest entry.
const UNEQUAL: f64 = 1e-9;
/// Factorizations that are usual.
const FACTORS: usize = 8;

/// What the inputs of K steps minimise, and their limits. K is the number of rows of `reference`; weights are Q, not
/// their roots, which [`crate::fleet::Units`] takes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Task<'a> {
    /// Limits of the inputs (K, m), infinite where there is none.
    pub low: MatrixView<'a>,
    /// As `low`.
    pub high: MatrixView<'a>,
    /// `Q_k` (n, n) before the last step.
    pub stage: MatrixView<'a>,
    /// `Q_K` (n, n).
    pub terminal: MatrixView<'a>,
    /// `r(1) .. r(K)` (K, n).
    pub reference: MatrixView<'a>,
    /// `R` (m, m); none: `1e-8 tr(G'QG) / (m K)` times the identity.
    pub r: Option<MatrixView<'a>>,
    /// `|u(k) - u(k-1)| <= rate` (m), and `u(-1)` (m).
    pub rate: Option<(&'a [f64], &'a [f64])>,
    /// Lower and upper limits of `x(1) .. x(K)` (K, n).
    pub states: Option<(MatrixView<'a>, MatrixView<'a>)>,
    /// The weight of squares beyond limits on states; none: they are hard.
    pub soft: Option<f64>,
}

/// The same in memory of its own, row by row.
#[derive(Debug)]
pub(super) struct Kept {
    pub(super) low: Vec<f64>,
    pub(super) high: Vec<f64>,
    pub(super) stage: Vec<f64>,
    pub(super) terminal: Vec<f64>,
    pub(super) reference: Vec<f64>,
    pub(super) rate: Option<(Vec<f64>, Vec<f64>)>,
    pub(super) states: Option<(Vec<f64>, Vec<f64>)>,
    pub(super) soft: Option<f64>,
}

/// A system and a task over K steps; what is needed of the map is computed once.
#[derive(Debug)]
pub struct Horizon {
    pub(super) n: usize,
    pub(super) m: usize,
    pub(super) steps: usize,
    pub(super) a: Vec<f64>,
    pub(super) b: Vec<f64>,
    pub(super) task: Kept,
    /// `R`, given or chosen.
    pub(super) r: Vec<f64>,
    /// The offset, if there is one.
    pub(super) c: Option<Vec<f64>>,
    /// Whether the system grows so much that inputs alone do not tell where its states are.
    pub(super) grows: bool,
    /// Whether it grows so much that inputs of the map have few digits.
    pub(super) steep: bool,
    /// `f(1) .. f(K)`: the states from 0 without inputs.
    pub(super) drift: Vec<f64>,
    /// `A^p B`, `p = 0 .. K-1`.
    pub(super) pushes: Vec<f64>,
    /// `F` with `F'F = Q`, of the stages and of the last step.
    pub(super) roots: [Vec<f64>; 2],
    /// `F A^p B` for both roots.
    seen: [Vec<f64>; 2],
    map: OnceLock<Vec<f64>>,
    powers: OnceLock<Vec<f64>>,
}

impl Kept {
    /// Its limits besides those of single inputs.
    pub(super) fn rows(&self) -> Rows<'_> {
        let rate = self.rate.as_ref().map(|(rate, previous)| (&rate[..], &previous[..]));
        let states = self.states.as_ref().map(|(low, high)| (&low[..], &high[..]));
        Rows { rate, states, soft: self.soft, grows: false }
    }
}

/// A weight (n, n); refuses one that is not symmetric, or with an eigenvalue below 0, but for rounding.
fn weight(name: &'static str, of: MatrixView<'_>, n: usize) -> Result<Vec<f64>> {
    let weight = try_copy(WHAT, &of.finite(name, n, n)?)?;
    let size = weight.iter().fold(0.0f64, |most, v| most.max(v.abs()));
    let refused = |expected, found| Err(Error::Value { name, expected, found });
    for (i, j) in (0..n).flat_map(|i| (0..i).map(move |j| (i, j))) {
        let (below, above) = (weight[i * n + j], weight[j * n + i]);
        if (below - above).abs() > UNEQUAL * size {
            return refused("symmetric", format!("{below} at ({i}, {j}) and {above} at ({j}, {i})"));
        }
    }
    let least = least_eigenvalue(&weight, n)?;
    if least < -UNEQUAL * size {
        return refused("without eigenvalues below 0", format!("{least:.3e}"));
    }
    Ok(weight)
}

/// What a problem computes at the first use.
fn once(cell: &OnceLock<Vec<f64>>, make: impl FnOnce() -> Result<Vec<f64>>) -> Result<&[f64]> {
    if let Some(there) = cell.get() {
        return Ok(there);
    }
    let new = make()?;
    Ok(cell.get_or_init(|| new))
}

/// `A^p B` (n, m) for `p = 0 .. K-1`.
pub(super) fn pushes(a: &[f64], b: &[f64], n: usize, steps: usize) -> Result<Vec<f64>> {
    let mut all = try_room(WHAT, checked_len(WHAT, steps, b.len())?)?;
    let mut last = try_copy(WHAT, b)?;
    for p in 0..steps {
        if p > 0 {
            last = times(a, &last, n)?;
        }
        all.extend_from_slice(&last);
    }
    Ok(all)
}

/// The largest of `||A^p||_F / max(1, ||A||_F)`, `p = 2, 4, 8, ..` up to the number of steps.
fn growth(a: &[f64], n: usize, steps: usize) -> Result<f64> {
    let first = vector::norm(a).max(1.0);
    let (mut power, mut most, mut p) = (try_copy(WHAT, a)?, 1.0f64, 2);
    while p <= steps {
        power = times(&power, &power, n)?;
        most = most.max(vector::norm(&power) / first);
        if !most.is_finite() || most > GROWTH {
            return Ok(f64::INFINITY);
        }
        p *= 2;
    }
    Ok(most)
}

/// `F A^p B` for all p.
pub(super) fn seen(root: &[f64], pushes: &[f64], n: usize, m: usize) -> Result<Vec<f64>> {
    let mut all = Vec::new();
    for push in pushes.chunks_exact((n * m).max(1)) {
        try_extend(WHAT, &mut all, times(root, push, n)?)?;
    }
    Ok(all)
}

/// `M` (rows, m K): the block of step k = 1 .. K and input j < k is `F_k A^(k-1-j) B`.
pub(super) fn condense(seen: [&[f64]; 2], m: usize, steps: usize, map: &mut [f64]) {
    let (d, mut first) = (m * steps, 0);
    for k in 1..=steps {
        let seen = seen[usize::from(k == steps)];
        let block = seen.len() / steps;
        let height = block / m;
        for i in 0..height {
            let row = &mut map[(first + i) * d..(first + i + 1) * d];
            for (j, to) in row.chunks_exact_mut(m).take(k).enumerate() {
                to.copy_from_slice(&seen[(k - 1 - j) * block + i * m..][..m]);
            }
        }
        first += height;
    }
}

impl Horizon {
    /// `A` (n, n), `B` (n, m), and the offset `c` (n) if there is one.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Value`] for limits without a number between them and for
    /// weights that are not symmetric or have an eigenvalue below 0, [`Error::Overflow`], [`Error::Numerical`] for the
    /// root of a weight, [`Error::Memory`].
    pub fn new<'a>(
        a: impl Into<MatrixView<'a>>,
        b: impl Into<MatrixView<'a>>,
        c: Option<&[f64]>,
        task: Task<'_>,
    ) -> Result<Self> {
        let b = b.into();
        let (n, m) = b.shape();
        let steps = task.reference.shape().0;
        if n == 0 || m == 0 {
            return Err(Error::Shape { name: "B", expected: "a state and an input".into(), found: "none".into() });
        }
        if steps == 0 {
            let expected = format!("a row of {n} for each step: their number is that of the steps");
            return Err(Error::Shape { name: "reference", expected, found: "none".into() });
        }
        let d = checked_len(WHAT, steps, m)?;
        sized("c", c.map_or(n, <[f64]>::len), n)?;
        let kept = |name, of: MatrixView<'_>, columns| try_copy(WHAT, &of.sized(name, steps, columns)?);
        let (a, b) = (a.into().finite("A", n, n)?, b.finite("B", n, m)?);
        let (a, b) = (try_copy(WHAT, &a)?, try_copy(WHAT, &b)?);
        let r = task.r.map(|r| weight("R", r, m)).transpose()?;
        let rate = |(rate, previous)| Ok((try_copy(WHAT, rate)?, try_copy(WHAT, previous)?));
        let task = Kept {
            reference: kept("reference", task.reference, n)?,
            low: kept("low", task.low, m)?,
            high: kept("high", task.high, m)?,
            stage: weight("stage", task.stage, n)?,
            terminal: weight("terminal", task.terminal, n)?,
            rate: task.rate.map(rate).transpose()?,
            states: match task.states {
                Some((low, high)) => Some((kept("state_low", low, n)?, kept("state_high", high, n)?)),
                None => None,
            },
            soft: task.soft,
        };
        require_finite("reference", &task.reference)?;
        Bounds::new(&task.low, &task.high, d)?;
        task.rows().check(n, m, steps)?;
        let pushes = pushes(&a, &b, n, steps)?;
        let roots = [root(&task.stage, n)?, root(&task.terminal, n)?];
        let seen = [seen(&roots[0], &pushes, n, m)?, seen(&roots[1], &pushes, n, m)?];
        // tr(G'QG) = sum_p (K - 1 - p) ||Q^1/2 A^p B||^2 + ||Qf^1/2 A^p B||^2
        let block = (seen[0].len() / steps).max(1);
        let of_stages = seen[0].chunks_exact(block).enumerate();
        let size = of_stages.map(|(p, s)| (steps - 1 - p) as f64 * vector::dot(s, s)).sum::<f64>()
            + vector::dot(&seen[1], &seen[1]);
        if !size.is_finite() || !pushes.iter().all(|v| v.is_finite()) {
            return Err(Error::Overflow { what: "the weighted effect of the inputs" });
        }
        let r = match r {
            Some(r) => r,
            None => {
                let regular = REGULAR * size / d as f64;
                let mut r = try_zeros(WHAT, m * m)?;
                r.iter_mut().step_by(m + 1).for_each(|r| *r = if regular == 0.0 { 1.0 } else { regular });
                r
            }
        };
        let none = OnceLock::new;
        let drift = try_zeros(WHAT, steps * n)?;
        let growth = growth(&a, n, steps)?;
        let (grows, steep) = (growth > GROWTH, growth > STEEP);
        let c_kept = c.map(|c| try_copy(WHAT, c)).transpose()?;
        let (map, powers) = (none(), none());
        let mut new =
            Self { n, m, steps, a, b, task, r, c: c_kept, grows, steep, drift, pushes, roots, seen, map, powers };
        if let Some(c) = c {
            let mut x = try_zeros(WHAT, n)?;
            for k in 0..steps {
                x = times(&new.a, &x, n)?;
                x.iter_mut().zip(c).for_each(|(x, c)| *x += c);
                new.drift[k * n..(k + 1) * n].copy_from_slice(&x);
            }
            require_finite("c", &new.drift)?;
        }
        Ok(new)
    }

    /// `R` (m, m), given or chosen.
    pub fn r(&self) -> &[f64] {
        &self.r
    }

    /// `A^p B` (n, m) for p = 0 .. K-1.
    pub fn pushes(&self) -> &[f64] {
        &self.pushes
    }

    /// `F` (rank, n) with `F'F = Q`, of the stages and of the last step.
    pub fn roots(&self) -> [&[f64]; 2] {
        [&self.roots[0], &self.roots[1]]
    }

    /// The number of states, inputs and steps.
    pub fn size(&self) -> (usize, usize, usize) {
        (self.n, self.m, self.steps)
    }

    /// Rows of the map.
    pub fn rows(&self) -> usize {
        (self.steps - 1) * (self.roots[0].len() / self.n) + self.roots[1].len() / self.n
    }

    /// Whether the recursion of Riccati is used.
    #[must_use]
    pub fn long(&self) -> bool {
        self.grows || self.many()
    }

    /// Whether there are so many steps that it is faster.
    fn many(&self) -> bool {
        let (n, m, steps, d) = (self.n, self.m, self.steps, self.steps * self.m);
        if d < LONG || steps == 1 {
            return false;
        }
        let (condensed, recursion) = (d as f64 * d as f64 * (self.rows() + d) as f64, steps * n * n * (3 * n + 4 * m));
        steps >= LONG || condensed > FACTORS as f64 * recursion as f64
    }

    /// Whether there are limits of single inputs only.
    #[must_use]
    pub fn boxed(&self) -> bool {
        self.task.rate.is_none() && self.task.states.is_none()
    }

    /// `u(-1)` (m) from now on, if the task has rates.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`]; then all is as before.
    pub fn follow(&mut self, previous: &[f64]) -> Result<()> {
        sized("previous", previous.len(), self.m)?;
        require_finite("previous", previous)?;
        if let Some((_, before)) = &mut self.task.rate {
            before.copy_from_slice(previous);
        }
        Ok(())
    }

    /// `M` (rows, m K).
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn map(&self) -> Result<&[f64]> {
        once(&self.map, || {
            let mut map = try_zeros(WHAT, checked_len(WHAT, self.rows(), self.steps * self.m)?)?;
            condense([&self.seen[0], &self.seen[1]], self.m, self.steps, &mut map);
            Ok(map)
        })
    }

    /// `I, A, ..., A^K` (K + 1, n, n).
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Memory`].
    pub fn powers(&self) -> Result<&[f64]> {
        once(&self.powers, || {
            let square = self.n * self.n;
            let mut all = try_zeros(WHAT, checked_len(WHAT, self.steps + 1, square)?)?;
            all[..square].iter_mut().step_by(self.n + 1).for_each(|v| *v = 1.0);
            for k in 1..=self.steps {
                let next = times(&all[(k - 1) * square..k * square], &self.a, self.n)?;
                all[k * square..(k + 1) * square].copy_from_slice(&next);
            }
            if all.iter().all(|v| v.is_finite()) { Ok(all) } else { Err(Error::Overflow { what: "a power of `A`" }) }
        })
    }

    /// `F_k v(k)` below each other, of `v(1) .. v(K)`, each (n, columns).
    pub(super) fn weighted(&self, along: &[f64]) -> Result<Vec<f64>> {
        let (mut all, block) = (Vec::new(), along.len() / self.steps);
        for (k, part) in along.chunks_exact(block.max(1)).enumerate() {
            try_extend(WHAT, &mut all, times(&self.roots[usize::from(k + 1 == self.steps)], part, self.n)?)?;
        }
        Ok(all)
    }

    /// `F_k A^k` (rows, n): what `x0` is multiplied by in `-y`.
    ///
    /// # Errors
    /// As [`Self::powers`].
    pub fn state(&self) -> Result<Vec<f64>> {
        self.weighted(&self.powers()?[self.n * self.n..])
    }

    /// `F_k (r(k) - f(k))` (rows): `y` from `x0 = 0`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn target(&self) -> Result<Vec<f64>> {
        self.weighted(&self.wanted()?)
    }

    /// `r(k) - f(k)` (K, n).
    pub(super) fn wanted(&self) -> Result<Vec<f64>> {
        let mut wanted = try_copy(WHAT, &self.task.reference)?;
        wanted.iter_mut().zip(&self.drift).for_each(|(r, f)| *r -= f);
        Ok(wanted)
    }

    /// `y` from `x0`, by the recursion of the states, which forms no powers of `A`.
    pub(super) fn aim(&self, x0: &[f64]) -> Result<Vec<f64>> {
        let mut left = self.wanted()?;
        let mut x = try_copy(WHAT, x0)?;
        for wanted in left.chunks_exact_mut(self.n) {
            x = times(&self.a, &x, self.n)?;
            wanted.iter_mut().zip(&x).for_each(|(r, x)| *r -= x);
        }
        if left.iter().all(|v| v.is_finite()) {
            return self.weighted(&left);
        }
        Err(Error::Overflow { what: "the state without inputs over all steps" })
    }

    /// `x(1) .. x(K)` (K, n) under `u` (K, m).
    ///
    /// # Errors
    /// [`Error::Overflow`], [`Error::Memory`].
    pub fn states(&self, x0: &[f64], u: &[f64]) -> Result<Vec<f64>> {
        let mut all = try_room(WHAT, checked_len(WHAT, self.steps, self.n)?)?;
        let mut x = try_copy(WHAT, x0)?;
        for u in u.chunks_exact(self.m) {
            let moved = times(&self.b, u, self.m)?;
            x = times(&self.a, &x, self.n)?;
            x.iter_mut().zip(&moved).for_each(|(x, b)| *x += b);
            all.extend_from_slice(&x);
        }
        all.iter_mut().zip(&self.drift).for_each(|(x, f)| *x += f);
        if all.iter().all(|v| v.is_finite()) { Ok(all) } else { Err(Error::Overflow { what: "a state" }) }
    }

    /// `R` of all inputs.
    pub(super) fn cost(&self) -> Result<(Vec<f64>, bool)> {
        let (m, d) = (self.m, self.m * self.steps);
        if let Some(diagonal) = only_diagonal(&self.r, m)? {
            let mut all = try_room(WHAT, d)?;
            (0..self.steps).for_each(|_| all.extend_from_slice(&diagonal));
            return Ok((all, true));
        }
        let mut all = try_zeros(WHAT, checked_len(WHAT, d, d)?)?;
        for (i, row) in all.chunks_exact_mut(d).enumerate() {
            let first = i - i % m;
            row[first..first + m].copy_from_slice(&self.r[i % m * m..][..m]);
        }
        Ok((all, false))
    }

    /// [`Self::cost`] as an argument of a solver.
    pub(super) fn penalty((values, diagonal): &(Vec<f64>, bool)) -> Penalty<'_> {
        if *diagonal { Penalty::Diagonal(values) } else { Penalty::Full(values) }
    }

    /// `[M; I x R^(1/2)]`, whose square is `H = M'M + R`.
    pub(super) fn stacked(&self) -> Result<Vec<f64>> {
        let (m, d) = (self.m, self.m * self.steps);
        let (map, root) = (self.map()?, root(&self.r, m)?);
        let mut all = try_zeros(WHAT, map.len() + checked_len(WHAT, root.len() / m * self.steps, d)?)?;
        all[..map.len()].copy_from_slice(map);
        for (i, row) in all[map.len()..].chunks_exact_mut(d).enumerate() {
            let (step, line) = (i / (root.len() / m), i % (root.len() / m));
            row[step * m..(step + 1) * m].copy_from_slice(&root[line * m..(line + 1) * m]);
        }
        Ok(all)
    }
}
