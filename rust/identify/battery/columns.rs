//! Columns that explain residuals where a model of logged pairs is wrong.

use super::given::{Given, WHAT};
use crate::error::Result;
use crate::memory::{try_push, try_zeros};

/// How many earlier inputs are looked at.
pub(super) const LAGS: usize = 8;
/// Readings at one extreme from which they may be the end of a sensor's range.
const PILED: usize = 3;
/// Signals of which squares, products and cubes are taken.
const SIGNALS: usize = 3;

/// What a group of columns is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    /// 1.
    Constant,
    /// Readings and inputs one step before all regressors.
    Memory,
    /// What the caller gives.
    Extra,
    /// The inputs so many steps earlier.
    Input(usize),
    /// The inputs of the next pair.
    Next,
    /// z in the second half.
    Half,
    /// z times the place in the run.
    Place,
    /// z of some pairs.
    Marked,
    /// Squares and products of the largest signals.
    Squares,
    /// Their cubes.
    Cubes,
    /// The sign of one regressor.
    Sign(usize),
    /// Whether a reading is at an extreme of its own.
    Extremes,
}

/// All groups, and where their columns begin.
pub(super) struct Columns<'a> {
    given: &'a Given<'a>,
    pub(super) groups: Vec<(Kind, usize, usize)>,
    pub(super) width: usize,
    /// Places in z and 1 / size of the largest signals.
    pub(super) signals: Vec<(usize, f64)>,
    /// Readings (state, value, whether the largest) that stand at an extreme.
    pub(super) extremes: Vec<(usize, f64, bool)>,
}

impl<'a> Columns<'a> {
    pub(super) fn new(given: &'a Given<'a>, effect: &[f64], sizes: &[f64]) -> Result<Self> {
        let (n, m, d) = (given.n, given.m, given.d);
        let signals = largest(given, effect, sizes)?;
        let extremes = extremes(given)?;
        let (s, e) = (signals.len(), extremes.len());
        let mut made = Self { given, groups: Vec::new(), width: 0, signals, extremes };
        let mut add = |kind, count: usize| -> Result<()> {
            if count > 0 {
                try_push(WHAT, &mut made.groups, (kind, made.width, count))?;
                made.width += count;
            }
            Ok(())
        };
        if given.marked.is_some() {
            add(Kind::Marked, d)?;
            return Ok(made);
        }
        add(Kind::Constant, usize::from(!given.intercept))?;
        match given.extra {
            Some(extra) => add(Kind::Extra, extra.len() / given.size().max(1))?,
            None => add(Kind::Memory, n + m)?,
        }
        let (_, first, later) = given.beyond;
        for lag in (0..later).chain(first..first.saturating_add(LAGS)) {
            add(Kind::Input(lag), m)?;
        }
        add(Kind::Next, m)?;
        add(Kind::Half, d)?;
        add(Kind::Place, d)?;
        add(Kind::Squares, s * (s + 1) / 2)?;
        add(Kind::Cubes, s)?;
        for j in (0..n).chain(given.inputs_at..given.inputs_at + m) {
            add(Kind::Sign(j), usize::from(both_signs(given, j)))?;
        }
        add(Kind::Extremes, e)?;
        Ok(made)
    }

    /// How many earlier pairs of its piece a row must have for columns of this kind.
    pub(super) fn earlier(&self, kind: Kind) -> usize {
        match kind {
            Kind::Memory => self.given.beyond.0.max(self.given.beyond.1),
            Kind::Input(lag) => lag,
            _ => 0,
        }
    }

    /// The number of earlier pairs in the piece of row t.
    pub(super) fn place(&self, t: usize) -> usize {
        self.given.places[self.given.at[t]]
    }

    /// Whether the pair behind that of row t is of the same piece.
    pub(super) fn has_next(&self, t: usize) -> bool {
        self.given.places.get(self.given.at[t] + 1).is_some_and(|&place| place > 0)
    }

    /// The columns of row t in `to`; 0 where a pair has no such neighbour.
    pub(super) fn fill(&self, t: usize, to: &mut [f64]) {
        let g = self.given;
        let (n, m, z) = (g.n, g.m, g.z(t));
        let (pair, place) = (g.at[t], g.places[g.at[t]]);
        for &(kind, from, count) in &self.groups {
            let to = &mut to[from..from + count];
            to.fill(0.0);
            match kind {
                Kind::Constant => to.fill(1.0),
                Kind::Memory | Kind::Input(_) if place < self.earlier(kind) => {}
                Kind::Memory => {
                    let (y, u, _) = g.beyond;
                    to[..n].copy_from_slice(&g.pair(pair - y)[..n]);
                    to[n..].copy_from_slice(&g.pair(pair - u)[n..n + m]);
                }
                Kind::Extra => to.copy_from_slice(&g.extra.unwrap_or_default()[t * count..(t + 1) * count]),
                Kind::Input(lag) => to.copy_from_slice(&g.pair(pair - lag)[n..n + m]),
                Kind::Next if self.has_next(t) => to.copy_from_slice(&g.pair(pair + 1)[n..n + m]),
                Kind::Next => {}
                Kind::Half if t >= g.size() / 2 => to.copy_from_slice(z),
                Kind::Half => {}
                Kind::Place => to.iter_mut().zip(z).for_each(|(to, v)| *to = place as f64 * v),
                Kind::Marked => {
                    if g.marked.is_some_and(|marked| marked[t]) {
                        to.copy_from_slice(z);
                    }
                }
                Kind::Squares => {
                    let mut next = to.iter_mut();
                    for (a, &(i, one)) in self.signals.iter().enumerate() {
                        for &(j, other) in &self.signals[a..] {
                            if let Some(to) = next.next() {
                                *to = z[i] * one * z[j] * other;
                            }
                        }
                    }
                }
                Kind::Cubes => {
                    to.iter_mut().zip(&self.signals).for_each(|(to, &(i, one))| *to = (z[i] * one).powi(3));
                }
                Kind::Sign(j) => to.fill(if z[j] == 0.0 { 0.0 } else { z[j].signum() }),
                Kind::Extremes => {
                    let read = &g.pair(pair)[..n];
                    to.iter_mut().zip(&self.extremes).for_each(|(to, &(i, v, _))| *to = f64::from(read[i] == v));
                }
            }
        }
    }
}

/// Whether a regressor is on both sides of 0: else its sign is a constant.
fn both_signs(g: &Given<'_>, j: usize) -> bool {
    let any = |sign: f64| (0..g.size()).any(|t| sign * g.z(t)[j] > 0.0);
    j < g.d && any(1.0) && any(-1.0)
}

/// The regressors with the largest effect in deviations of the noise, one of them an input where there is one in z.
fn largest(g: &Given<'_>, effect: &[f64], sizes: &[f64]) -> Result<Vec<(usize, f64)>> {
    let mut left = try_zeros::<u8>(WHAT, g.d - usize::from(g.intercept))?;
    left.iter_mut().zip(sizes).for_each(|(to, size)| *to = u8::from(*size > 0.0));
    let mut chosen = Vec::new();
    let input = |j: usize| j >= g.inputs_at;
    while chosen.len() < SIGNALS {
        let last = chosen.len() + 1 == SIGNALS && !chosen.iter().any(|&(j, _)| input(j));
        let free = |only: bool| (0..left.len()).filter(move |&j| !only || input(j));
        let best = |only| free(only).filter(|&j| left[j] == 1).max_by(|&i, &j| effect[i].total_cmp(&effect[j]));
        let Some(at) = (if last { best(true).or_else(|| best(false)) } else { best(false) }) else { break };
        left[at] = 0;
        try_push(WHAT, &mut chosen, (at, sizes[at].recip()))?;
    }
    Ok(chosen)
}

/// Extremes at which at least [`PILED`] readings stand, and not half of all.
fn extremes(g: &Given<'_>) -> Result<Vec<(usize, f64, bool)>> {
    let mut found = Vec::new();
    for i in 0..g.n {
        let read = || g.at.iter().map(|&pair| g.pair(pair)[i]);
        for top in [true, false] {
            let end = if top { read().fold(f64::MIN, f64::max) } else { read().fold(f64::MAX, f64::min) };
            let count = read().filter(|v| *v == end).count();
            if count >= PILED && 2 * count <= g.size() {
                try_push(WHAT, &mut found, (i, end, top))?;
            }
        }
    }
    Ok(found)
}
