//! One pass over the pairs, and what groups of columns explain.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::columns::{Columns, Kind};
use super::explained::{Explained, Outcomes, explained, halved};
use super::given::{Given, Test, WHAT, dot, zeros};
use crate::error::Result;
use crate::memory::{checked_len, try_push};
use crate::parallel::Stop;

/// Pairs that are taken at a time.
const BLOCK: usize = 512;
/// Pieces of equal length in place of runs, where there are few or short ones.
const PIECES: usize = 8;
/// Rows of a run for each regressor, below which a model of its own fits what made the regressors too.
const ROWS: usize = 4;
/// The same of filters, which remember for many steps.
const ROWS_OF_FILTERS: usize = 40;

/// What one pass over the pairs adds up.
pub(super) struct Sums<'a> {
    pub(super) columns: Columns<'a>,
    /// Products of the columns with the regressors (rank, width), the residuals (width, n), and each other, by groups.
    along_z: Vec<f64>,
    along_e: Vec<f64>,
    own: Vec<Vec<f64>>,
    /// What rounding left of the products of regressors and residuals (rank, n).
    rest: Vec<f64>,
    /// For each row the leverage, and `nu` times its part in the sum of squares over `1 - leverage`.
    pub(super) leverages: Vec<f64>,
    pub(super) parts: Vec<f64>,
    /// Of readings that are at an extreme one step later: their number, and the sum of their residuals.
    ends: Vec<(usize, f64)>,
    /// Rows with fewer than so many earlier pairs, rising; at last those without a next one.
    short: Vec<(usize, Rows)>,
    /// The strongest model of its own of a run or piece, and how many were looked at.
    own_model: Option<(usize, Explained)>,
    looked: usize,
    in_runs: bool,
    /// Rows of a run or piece from which it is looked at.
    least: usize,
}

/// Products of the regressors q and residuals e of some rows: q q', q e' and e e'.
struct Rows {
    count: usize,
    qq: Vec<f64>,
    qe: Vec<f64>,
    ee: Vec<f64>,
}

impl Rows {
    fn none(rank: usize, n: usize) -> Result<Self> {
        let square = |a, b| zeros(checked_len(WHAT, a, b)?);
        Ok(Self { count: 0, qq: square(rank, rank)?, qe: square(rank, n)?, ee: square(n, n)? })
    }

    fn add(&mut self, q: &[f64], e: &[f64]) {
        self.count += 1;
        add(&mut self.qq, (q, q.len()), (q, q.len()), 1);
        add(&mut self.qe, (q, q.len()), (e, e.len()), 1);
        add(&mut self.ee, (e, e.len()), (e, e.len()), 1);
    }
}

impl<'a> Sums<'a> {
    pub(super) fn of(given: &'a Given<'a>, of: &Outcomes<'_>, stop: &Stop) -> Result<Self> {
        let (f, d, n, size) = (given.fitted, given.d, given.n, given.size());
        let rank = f.rank();
        let (effect, sizes) = effects(given, of)?;
        let columns = Columns::new(given, &effect, &sizes)?;
        let width = columns.width;
        let square = |a, b| zeros(checked_len(WHAT, a, b)?);
        let mut own = Vec::new();
        for &(_, _, count) in &columns.groups {
            try_push(WHAT, &mut own, square(count, count)?)?;
        }
        let ends = columns.extremes.len();
        let mut short: Vec<(usize, Rows)> = Vec::new();
        for &(kind, _, _) in &columns.groups {
            let earlier = columns.earlier(kind);
            if earlier > 0 && short.iter().all(|(first, _)| *first != earlier) {
                try_push(WHAT, &mut short, (earlier, Rows::none(rank, n)?))?;
            }
        }
        short.sort_unstable_by_key(|(first, _)| *first);
        try_push(WHAT, &mut short, (usize::MAX, Rows::none(rank, n)?))?;
        let mut sums = Self {
            along_z: square(rank, width)?,
            along_e: square(width, n)?,
            own,
            rest: square(rank, n)?,
            leverages: square(size, 1)?,
            parts: square(size, 1)?,
            ends: crate::memory::try_filled(WHAT, (0, 0.0), ends)?,
            short,
            own_model: None,
            looked: 0,
            in_runs: false,
            least: least_rows(given, rank),
            columns,
        };
        let pieces = Pieces::of(given, rank);
        sums.in_runs = !pieces.runs.is_empty();
        let mut piece = (square(rank, rank)?, square(rank, n)?, 0);
        let (mut q, mut e, mut g) = (square(BLOCK, rank)?, square(BLOCK, n)?, square(BLOCK, width)?);
        let (mut white, mut group) = (square(of.p, 1)?, square(BLOCK, width.max(1))?);
        let mut t = 0;
        while t < size {
            stop.check()?;
            let end = pieces.end(t).min(t + BLOCK).min(size);
            let count = end - t;
            for k in 0..count {
                let (z, y) = (given.z(t + k), given.y(t + k));
                for (i, to) in e[k * n..(k + 1) * n].iter_mut().enumerate() {
                    *to = y[i] - dot(&f.model[i * d..(i + 1) * d], z);
                }
                for (r, to) in q[k * rank..(k + 1) * rank].iter_mut().enumerate() {
                    *to = dot(&f.white[r * d..(r + 1) * d], z);
                }
                sums.columns.fill(t + k, &mut g[k * width..(k + 1) * width]);
                let (q, e) = (&q[k * rank..(k + 1) * rank], &e[k * n..(k + 1) * n]);
                let h = dot(q, q).min(1.0);
                of.whiten(e, &mut white);
                sums.leverages[t + k] = h;
                sums.parts[t + k] = of.nu as f64 * dot(&white, &white) / (1.0 - h).max(1e-12);
                sums.leave(t + k, q, e);
                let after = &given.pair(given.at[t + k])[n + given.m..];
                for (end, &(i, value, _)) in sums.ends.iter_mut().zip(&sums.columns.extremes) {
                    if after[i] == value {
                        *end = (end.0 + 1, end.1 + e[i]);
                    }
                }
            }
            let (q, e, g) = (&q[..count * rank], &e[..count * n], &g[..count * width]);
            add(&mut sums.along_z, (q, rank), (g, width), count);
            add(&mut sums.along_e, (g, width), (e, n), count);
            add(&mut sums.rest, (q, rank), (e, n), count);
            for (&(_, from, wide), own) in sums.columns.groups.iter().zip(&mut sums.own) {
                let part = &mut group[..count * wide];
                for (to, row) in part.chunks_exact_mut(wide).zip(g.chunks_exact(width)) {
                    to.copy_from_slice(&row[from..from + wide]);
                }
                let part = &*part;
                add(own, (part, wide), (part, wide), count);
            }
            if pieces.count > 1 {
                add(&mut piece.0, (q, rank), (q, rank), count);
                add(&mut piece.1, (q, rank), (e, n), count);
                piece.2 += count;
                if end == size || end == pieces.end(t) {
                    sums.finish(&piece, pieces.number(t), of)?;
                    piece.0.fill(0.0);
                    piece.1.fill(0.0);
                    piece.2 = 0;
                }
            }
            t = end;
        }
        Ok(sums)
    }

    /// Adds row t to those without some neighbour.
    fn leave(&mut self, t: usize, q: &[f64], e: &[f64]) {
        let place = self.columns.place(t);
        let at = self.short.partition_point(|(first, _)| *first <= place);
        let next = self.short.len() - 1;
        if at < next {
            self.short[at].1.add(q, e);
        }
        if !self.columns.has_next(t) {
            self.short[next].1.add(q, e);
        }
    }

    /// The rows that have no columns of this kind.
    fn without(&self, kind: Kind, rank: usize, n: usize) -> Result<Rows> {
        let earlier = self.columns.earlier(kind);
        let mut all = Rows::none(rank, n)?;
        let wanted = |first: usize| if kind == Kind::Next { first == usize::MAX } else { first <= earlier };
        for (_, rows) in self.short.iter().filter(|(first, _)| wanted(*first)) {
            all.count += rows.count;
            for (to, from) in [(&mut all.qq, &rows.qq), (&mut all.qe, &rows.qe), (&mut all.ee, &rows.ee)] {
                to.iter_mut().zip(from).for_each(|(to, v)| *to += v);
            }
        }
        Ok(all)
    }

    /// The test of a model of its own of one piece: the columns q of its rows alone, of which `V - V V` is left.
    fn finish(&mut self, (v, b, count): &(Vec<f64>, Vec<f64>, usize), number: usize, of: &Outcomes<'_>) -> Result<()> {
        let rank = v.len().isqrt();
        if *count < 2.max(self.least) || rank == 0 {
            return Ok(());
        }
        let mut left = zeros(rank * rank)?;
        let mut own = zeros(rank)?;
        for i in 0..rank {
            own[i] = v[i * (rank + 1)];
            for j in 0..rank {
                let twice: f64 = (0..rank).map(|k| v[i * rank + k] * v[k * rank + j]).sum();
                left[i * rank + j] = v[i * rank + j] - twice;
            }
        }
        if let Some(found) = explained(&left, &own, b, of)? {
            self.looked += 1;
            if self.own_model.as_ref().is_none_or(|(_, best)| found.p_value < best.p_value) {
                self.own_model = Some((number, found));
            }
        }
        Ok(())
    }

    /// Judges each group of columns.
    pub(super) fn judge(&self, given: &Given<'_>, of: &Outcomes<'_>, tests: &mut Vec<Test>) -> Result<()> {
        let mut dead: Option<(usize, Explained)> = None;
        let (mut lags, mut least) = (0, 1.0f64);
        let (mut nonlinear, mut curves) = (None::<(Option<usize>, Explained)>, 0);
        let mut halves = None;
        for (at, &(kind, _, _)) in self.columns.groups.iter().enumerate() {
            let Some(found) = self.group(at, given, of)? else { continue };
            match kind {
                Kind::Input(lag) => {
                    lags += 1;
                    least = least.min(found.p_value);
                    if dead.as_ref().is_none_or(|(_, best)| found.share > best.share) {
                        dead = Some((lag, found));
                    }
                }
                Kind::Squares | Kind::Cubes | Kind::Sign(_) => {
                    curves += 1;
                    let sign = if let Kind::Sign(place) = kind { Some(place) } else { None };
                    if nonlinear.as_ref().is_none_or(|(_, best)| found.p_value < best.p_value) {
                        nonlinear = Some((sign, found));
                    }
                }
                Kind::Half => halves = Some(found),
                Kind::Place => push(tests, "drift", found, Vec::new())?,
                Kind::Constant => push(tests, "offset", found, Vec::new())?,
                Kind::Memory | Kind::Extra => push(tests, "memory", found, Vec::new())?,
                Kind::Next => push(tests, "late rows", found, Vec::new())?,
                Kind::Extremes => push(tests, "clipped", found, Vec::new())?,
                Kind::Marked => push(tests, "ends", found, Vec::new())?,
            }
        }
        if let Some((lag, found)) = dead {
            let p_value = (least * f64::from(lags)).min(1.0);
            push(tests, "dead time", Explained { p_value, ..found }, Vec::from([lag]))?;
        }
        if let Some((sign, found)) = nonlinear {
            let p_value = (f64::from(curves) * found.p_value).min(1.0);
            let signals = self.columns.signals.iter().map(|s| s.0).filter(|_| sign.is_none());
            let places = crate::memory::try_collect(WHAT, sign.into_iter().chain(signals))?;
            push(tests, "nonlinear", Explained { p_value, ..found }, places)?;
        }
        let run = self.own_model.clone().map(|(run, found)| {
            let p_value = (found.p_value * self.looked as f64).min(1.0);
            let at = if self.in_runs { Vec::from([run]) } else { Vec::from([run, PIECES]) };
            (at, Explained { p_value, ..found })
        });
        let double = |found: Explained| Explained { p_value: (2.0 * found.p_value).min(1.0), ..found };
        match (halves, run) {
            (Some(half), Some((run, found))) if found.p_value < half.p_value => {
                push(tests, "change", double(found), run)?;
            }
            (Some(half), other) => {
                let half = if other.is_some() { double(half) } else { half };
                push(tests, "change", half, Vec::new())?;
            }
            (None, Some((run, found))) => push(tests, "change", found, run)?,
            (None, None) => {}
        }
        self.clipped(of, tests)
    }

    /// Readings that are cut off are below what was predicted, at the upper end; a chosen maximum is above it.
    fn clipped(&self, of: &Outcomes<'_>, tests: &mut Vec<Test>) -> Result<()> {
        for (&(count, sum), &(i, _, top)) in self.ends.iter().zip(&self.columns.extremes) {
            let variance = of.squares[i * (of.n + 1)] / of.nu as f64 * count as f64;
            if count >= 3 && variance > 0.0 {
                let off = if top { -sum } else { sum } / variance.sqrt();
                let p_value = crate::identify::distributions::normal_above(off) * self.ends.len() as f64;
                let each = Vec::new();
                let share = off.max(0.0);
                let test = Test { name: "clipped", p_value: p_value.min(1.0), share, at: Vec::from([i]), each };
                try_push(WHAT, tests, test)?;
            }
        }
        Ok(())
    }

    /// Tests one group of columns on the rows that have them.
    ///
    /// Least squares without rows O: with `V = I - sum_O q q'` and `f = sum q e' - sum_O q e'` the regressors leave
    /// `sum c c' - b' V^-1 b` of columns c with `b = sum q c'`, `sum c e' - b' V^-1 f` of their products with
    /// residuals, and `S - sum_O e e' - f' V^-1 f` of these.
    fn group(&self, at: usize, given: &Given<'_>, of: &Outcomes<'_>) -> Result<Option<Explained>> {
        let (kind, from, count) = self.columns.groups[at];
        let (n, width, rank) = (given.n, self.columns.width, given.fitted.rank());
        let out = self.without(kind, rank, n)?;
        let wide = count + n;
        let mut beside = zeros(checked_len(WHAT, rank, wide)?)?;
        for k in 0..rank {
            let row = &mut beside[k * wide..(k + 1) * wide];
            row[..count].copy_from_slice(&self.along_z[k * width + from..][..count]);
            (0..n).for_each(|j| row[count + j] = self.rest[k * n + j] - out.qe[k * n + j]);
        }
        let mut left = crate::memory::try_copy(WHAT, &self.own[at])?;
        let mut along = crate::memory::try_copy(WHAT, &self.along_e[from * n..(from + count) * n])?;
        let mut own = zeros(count)?;
        own.iter_mut().enumerate().for_each(|(i, to)| *to = left[i * (count + 1)]);
        let mut squares = crate::memory::try_copy(WHAT, of.squares)?;
        squares.iter_mut().zip(&out.ee).for_each(|(s, e)| *s -= e);
        if out.count > 0 {
            let (mut within, mut ones) = (out.qq, zeros(rank)?);
            within.iter_mut().for_each(|v| *v = -*v);
            within.iter_mut().step_by(rank + 1).for_each(|v| *v += 1.0);
            ones.fill(1.0);
            beside = halved(&within, &ones, &beside, wide)?.unwrap_or_default();
        }
        for row in beside.chunks_exact(wide) {
            let (z, e) = row.split_at(count);
            for i in 0..count {
                (0..count).for_each(|j| left[i * count + j] -= z[i] * z[j]);
                (0..n).for_each(|j| along[i * n + j] -= z[i] * e[j]);
            }
            if out.count > 0 {
                (0..n * n).for_each(|k| squares[k] -= e[k / n] * e[k % n]);
            }
        }
        if out.count == 0 {
            return explained(&left, &own, &along, of);
        }
        let nu = (given.size() - out.count).saturating_sub(beside.len() / wide);
        let Some(of) = Outcomes::new(&squares, of.basis, n, nu)? else { return Ok(None) };
        explained(&left, &own, &along, &of)
    }

    /// Tests whether each input has an effect: what its column in z adds to the others.
    pub(super) fn effects(&self, given: &Given<'_>, of: &Outcomes<'_>, tests: &mut Vec<Test>) -> Result<()> {
        let (f, d, n) = (given.fitted, given.d, given.n);
        if given.inputs_at != n || f.rank() < d {
            return Ok(());
        }
        // H_j^2 / (V^-1)_jj is what column j adds to the sum of squares
        for input in 0..given.m {
            let j = n + input;
            let inverse: f64 = f.white.iter().skip(j).step_by(d).map(|v| v * v).sum();
            let along = crate::memory::try_collect(WHAT, (0..n).map(|i| f.model[i * d + j] / inverse))?;
            let Some(wide) = Outcomes::new(of.squares, of.basis, n, of.nu + 1)? else { continue };
            if let Some(found) = added(&along, inverse.recip(), &wide)? {
                push(tests, "effect", found, Vec::from([input]))?;
            }
        }
        Ok(())
    }
}

/// The test of a column that is among the regressors: the residuals without it have `S + along along' / left`.
fn added(along: &[f64], left: f64, of: &Outcomes<'_>) -> Result<Option<Explained>> {
    let n = of.n;
    let mut squares = crate::memory::try_copy(WHAT, of.squares)?;
    for i in 0..n {
        (0..n).for_each(|j| squares[i * n + j] += along[i] * along[j] / left);
    }
    let Some(without) = Outcomes::new(&squares, of.basis, n, of.nu)? else { return Ok(None) };
    explained(&[left], &[left], along, &without)
}

fn push(tests: &mut Vec<Test>, name: &'static str, found: Explained, at: Vec<usize>) -> Result<()> {
    let Explained { p_value, share, each } = found;
    try_push(WHAT, tests, Test { name, p_value, share, at, each })
}

/// Effects of the regressors in deviations of the noise, and their root mean squares.
fn effects(given: &Given<'_>, of: &Outcomes<'_>) -> Result<(Vec<f64>, Vec<f64>)> {
    let (f, d, n) = (given.fitted, given.d, given.n);
    let (mut effect, mut sizes) = (zeros(d)?, zeros(d)?);
    let (mut column, mut white) = (zeros(n)?, zeros(of.p)?);
    for j in 0..d {
        let squares: f64 = f.root.iter().skip(j).step_by(d.max(1)).map(|v| v * v).sum();
        sizes[j] = (squares / given.size().max(1) as f64).sqrt();
        column.iter_mut().enumerate().for_each(|(i, to)| *to = f.model[i * d + j]);
        of.whiten(&column, &mut white);
        effect[j] = sizes[j] * dot(&white, &white).sqrt();
    }
    Ok((effect, sizes))
}

fn least_rows(given: &Given<'_>, rank: usize) -> usize {
    rank.max(1) * if given.extra.is_some() { ROWS_OF_FILTERS } else { ROWS }
}

/// Runs, or pieces of equal length where there are few.
pub(super) struct Pieces<'a> {
    runs: &'a [usize],
    equal: usize,
    pub(super) count: usize,
}

impl<'a> Pieces<'a> {
    pub(super) fn of(given: &'a Given<'a>, rank: usize) -> Self {
        let size = given.size();
        let count = 1 + given.runs.windows(2).filter(|pair| pair[0] != pair[1]).count();
        let cost = count as f64 * (rank as f64).powi(3);
        let none = Self { runs: &[], equal: size.max(1), count: 1 };
        if given.marked.is_some() || cost > 1e9 {
            none
        } else if count >= 4 && size >= count * least_rows(given, rank) {
            Self { runs: given.runs, equal: 0, count }
        } else if size >= PIECES * (least_rows(given, rank) + 2) {
            Self { runs: &[], equal: size.div_ceil(PIECES), count: PIECES }
        } else {
            none
        }
    }

    /// Behind the last row of the piece of row t.
    pub(super) fn end(&self, t: usize) -> usize {
        if self.runs.is_empty() {
            return (t / self.equal + 1) * self.equal;
        }
        t + self.runs[t..].partition_point(|&run| run == self.runs[t])
    }

    fn number(&self, t: usize) -> usize {
        if self.runs.is_empty() { t / self.equal } else { self.runs[t] }
    }
}

/// `to += a' b` of so many rows.
fn add(to: &mut [f64], (a, wide): (&[f64], usize), (b, other): (&[f64], usize), count: usize) {
    if wide == 0 || other == 0 {
        return;
    }
    let (a, b) = (MatRef::from_row_major_slice(a, count, wide), MatRef::from_row_major_slice(b, count, other));
    matmul(MatMut::from_row_major_slice_mut(to, wide, other), Accum::Add, a.transpose(), b, 1.0, Par::Seq);
}
