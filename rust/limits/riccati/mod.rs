//! Many steps of `x(k+1) = A x(k) + B u(k)`: Riccati's recursion solves a face in time proportional to the number of
//! steps, and does not form powers of `A`.
//!
//! `J(u) = sum_{k=1..K} ||x(k) - ref(k)||^2_{Q_k} + sum_{k<K} ||u(k)||^2_R`, `Q_k = Q` before the last step. On a face
//! with free inputs `F`, backwards from `P_K = Q_K`: `G = R_FF + B_F' P B_F`, `L = G^{-1} B_F' P A`,
//! `P <- Q + A' P A - A' P B_F L` (Bertsekas 2017, 3.1); the affine terms follow in a second recursion.

pub(super) mod closed;
mod faces;
mod recursion;

use crate::error::{Error, Result, require_finite, sized};
use crate::limits::bounds::Bounds;
use crate::limits::factor::product;
use crate::limits::kernel::{add_lines, add_times, dot, padded};
use crate::limits::quadratic::{Quadratic, Until};
use crate::limits::search::Search;
use crate::limits::solve::{Penalty, Solution, Warm, checked_rows, checked_warm, or_ended, tell};
use crate::memory::{checked_len, try_filled, try_zeros};

const WHAT: &str = "a control of many steps";
const OVERFLOW: Error = Error::Overflow { what: "the state without inputs over all steps" };

/// A problem of many steps; matrices row by row.
#[derive(Debug, Clone, Copy)]
pub struct Steps<'a> {
    /// `A` (n, n).
    pub a: &'a [f64],
    /// `B` (n, m).
    pub b: &'a [f64],
    /// The state before the first step (n).
    pub x0: &'a [f64],
    /// Wanted states after each step (K, n).
    pub reference: &'a [f64],
    /// `Q` (n, n), positive semidefinite.
    pub stage: &'a [f64],
    /// `Q_K` (n, n), positive semidefinite.
    pub terminal: &'a [f64],
    /// `R` (m, m), positive semidefinite.
    pub r: &'a [f64],
}

/// A matrix in padded lines.
#[derive(Debug, Default, Clone)]
struct Lines {
    values: Vec<f64>,
    ld: usize,
}

impl Lines {
    fn zeros(rows: usize, columns: usize) -> Result<Self> {
        let ld = padded(columns).max(1);
        Ok(Self { values: try_zeros(WHAT, checked_len(WHAT, rows, ld)?)?, ld })
    }

    fn new(values: &[f64], rows: usize, columns: usize) -> Result<Self> {
        let mut lines = Self::zeros(rows, columns)?;
        for (line, row) in lines.values.chunks_exact_mut(lines.ld).zip(values.chunks_exact(columns)) {
            line[..columns].copy_from_slice(row);
        }
        Ok(lines)
    }

    fn line(&self, i: usize) -> &[f64] {
        &self.values[i * self.ld..(i + 1) * self.ld]
    }

    fn line_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.values[i * self.ld..(i + 1) * self.ld]
    }
}

/// `out += A' v`, `A` in lines.
fn add_transposed(a: &Lines, v: &[f64], sign: f64, out: &mut [f64]) {
    add_lines(&a.values, a.ld, v.iter().enumerate().map(|(i, v)| (i, sign * v)), out);
}

/// The recursion for one face.
#[derive(Debug, Default)]
struct Gains {
    /// `P_1 .. P_K`, each `n` lines.
    p: Vec<f64>,
    /// `L_0 .. L_{K-1}`, each `m` lines of the length of a state.
    gain: Vec<f64>,
    /// The factor of each `G`, `m` columns, and the inverse of its diagonal.
    lower: Vec<f64>,
    inverse: Vec<f64>,
    held: Vec<i8>,
}

#[derive(Debug)]
pub(super) struct Riccati {
    n: usize,
    m: usize,
    steps: usize,
    /// Lengths of lines of states and inputs.
    ln: usize,
    lm: usize,
    a: Lines,
    b: Lines,
    q: [Lines; 2],
    r: Lines,
    x0: Vec<f64>,
    reference: Lines,
    /// From [`Quadratic::prepare`] on.
    curvature: Vec<f64>,
    /// `-J'(0) / 2`, and `J(0)`.
    f: Vec<f64>,
    pub(super) zero: f64,
    /// `sum ||ref||_Q^2`, and with `sum ||A x||_Q^2 + ||u||_R^2` at the last `u`: what `J` is before anything cancels.
    /// `J(0)` of an unstable system grows without end.
    references: f64,
    size: f64,
    face: Gains,
    other: Gains,
    whole: bool,
    /// The system grows: `P` by `Q + (A - B L)' P (A - B L) + L'R L`, which loses nothing where `P` is large.
    grows: bool,
    /// The gains of `face` are not those of a face that was solved.
    stale: bool,
    /// States of the last face.
    path: Vec<f64>,
    /// States less references.
    errors: Lines,
    work: [Vec<f64>; 5],
    squares: [Lines; 4],
    /// Zeros, and inputs.
    none: Vec<f64>,
    moves: Vec<f64>,
}

impl Riccati {
    pub(super) fn new(h: &Steps<'_>) -> Result<Self> {
        let mut new = Self::growing(h)?;
        new.grows = false;
        new.finite()?;
        Ok(new)
    }

    /// The same where `J(0)` may be as large as it likes.
    pub(super) fn growing(h: &Steps<'_>) -> Result<Self> {
        let n = h.x0.len();
        let (m, steps) = (h.b.len().checked_div(n).unwrap_or(0), h.reference.len().checked_div(n).unwrap_or(0));
        let named = [
            ("A", h.a, n, n),
            ("B", h.b, n, m),
            ("reference", h.reference, steps, n),
            ("stage", h.stage, n, n),
            ("terminal", h.terminal, n, n),
            ("R", h.r, m, m),
        ];
        require_finite("x0", h.x0)?;
        for (name, values, rows, columns) in named {
            checked_rows(name, values.len(), rows, columns)?;
            require_finite(name, values)?;
        }
        for (name, values, d) in [("stage", h.stage, n), ("terminal", h.terminal, n), ("R", h.r, m)] {
            Penalty::Full(values).split(name, d)?;
        }
        let (ln, lm) = (padded(n).max(1), padded(m).max(1));
        let (state, input) = (|| try_zeros(WHAT, ln), || try_zeros(WHAT, lm));
        let inputs = || try_zeros(WHAT, checked_len(WHAT, steps, m)?);
        let mut new = Self {
            n,
            m,
            steps,
            ln,
            lm,
            a: Lines::new(h.a, n, n)?,
            b: Lines::new(h.b, n, m)?,
            q: [Lines::new(h.stage, n, n)?, Lines::new(h.terminal, n, n)?],
            r: Lines::new(h.r, m, m)?,
            x0: state()?,
            reference: Lines::new(h.reference, steps, n)?,
            curvature: Vec::new(),
            f: inputs()?,
            zero: f64::INFINITY,
            references: 0.0,
            size: 0.0,
            face: Gains::default(),
            other: Gains::default(),
            whole: false,
            grows: true,
            stale: true,
            path: try_zeros(WHAT, checked_len(WHAT, steps, n)?)?,
            errors: Lines::zeros(steps, n)?,
            work: [state()?, state()?, state()?, input()?, input()?],
            squares: [Lines::zeros(n, n)?, Lines::zeros(n, m)?, Lines::zeros(n, n)?, Lines::zeros(m, n)?],
            none: inputs()?,
            moves: inputs()?,
        };
        new.begin(h.x0);
        Ok(new)
    }

    /// From `x0`, and toward the references that are there.
    fn begin(&mut self, x0: &[f64]) {
        self.x0[..self.n].copy_from_slice(x0);
        self.references = 0.0;
        for t in 0..self.steps {
            let (of, q) = (&mut self.work[0], &self.q[usize::from(t + 1 == self.steps)]);
            of.fill(0.0);
            add_times(&q.values, self.reference.line(t), 1.0, &mut of[..self.n]);
            self.references += dot(of, self.reference.line(t));
        }
        let (none, mut g) = (std::mem::take(&mut self.none), std::mem::take(&mut self.moves));
        self.zero = self.slope(&none, &mut g);
        self.f.iter_mut().zip(&g).for_each(|(f, g)| *f = 0.0 - g);
        (self.none, self.moves) = (none, g);
    }

    fn finite(&self) -> Result<()> {
        if self.zero.is_finite() && self.f.iter().all(|v| v.is_finite()) { Ok(()) } else { Err(OVERFLOW) }
    }

    fn gains(&self) -> Result<Gains> {
        let (n, m, steps) = (self.n, self.m, self.steps);
        Ok(Gains {
            p: try_zeros(WHAT, checked_len(WHAT, steps * n, self.ln)?)?,
            gain: try_zeros(WHAT, checked_len(WHAT, steps * m, self.ln)?)?,
            lower: try_zeros(WHAT, checked_len(WHAT, steps * m, self.lm)?)?,
            inverse: try_zeros(WHAT, steps * m)?,
            held: try_filled(WHAT, 0, steps * m)?,
        })
    }

    /// `diag(R + B' S B)` with `S_k = Q_k + A' S_{k+1} A`.
    pub(super) fn set_curvature(&mut self, until: Until<'_>) -> Result<()> {
        let (n, m, ln, lm) = (self.n, self.m, self.ln, self.lm);
        let (mut s, mut curvature) = (self.q[1].clone(), try_zeros(WHAT, self.steps * m)?);
        for t in (0..self.steps).rev() {
            until.check()?;
            let [sa, sb, next, _] = &mut self.squares;
            product(&s.values, ln, false, n, &self.b.values, &mut sb.values, lm)?;
            for j in 0..m {
                let sum: f64 = (0..n).map(|i| self.b.values[i * lm + j] * sb.values[i * lm + j]).sum();
                curvature[t * m + j] = self.r.values[j * lm + j] + sum;
            }
            product(&s.values, ln, false, n, &self.a.values, &mut sa.values, ln)?;
            product(&self.a.values, ln, true, n, &sa.values, &mut next.values, ln)?;
            next.values.iter_mut().zip(&self.q[0].values).for_each(|(s, q)| *s += q);
            std::mem::swap(&mut s.values, &mut next.values);
        }
        if !curvature.iter().all(|v| v.is_finite()) {
            return Err(OVERFLOW);
        }
        self.curvature = curvature;
        Ok(())
    }
}

/// Problems within limits of single inputs from one state after another, and what their searches need.
#[derive(Debug)]
pub(super) struct Recursion {
    problem: Riccati,
    search: Search,
    g: Vec<f64>,
    pub(super) warm: Warm,
}

impl Recursion {
    /// With all memory that calls need.
    pub(super) fn new(horizon: &Steps<'_>, until: Until<'_>) -> Result<Self> {
        let mut problem = Riccati::new(horizon)?;
        problem.prepare(until)?;
        (problem.face, problem.other) = (problem.gains()?, problem.gains()?);
        let d = problem.size();
        let mut search = Search::new(d)?;
        search.reserve()?;
        Ok(Self { search, g: try_zeros(WHAT, d)?, warm: Warm::new(d)?, problem })
    }

    /// The best inputs from `x0` toward `reference` less `drift` (K, n), from the limits that the last call has
    /// reached, a step later. After an error, all is as before. Nothing is allocated.
    pub(super) fn solve(
        &mut self,
        x0: &[f64],
        (reference, drift): (&[f64], &[f64]),
        bounds: Bounds<'_>,
        until: Until<'_>,
        to: &mut Solution,
    ) -> Result<()> {
        let (n, m) = (self.problem.n, self.problem.m);
        sized("x0", x0.len(), n)?;
        require_finite("x0", x0)?;
        for (t, (r, f)) in reference.chunks_exact(n).zip(drift.chunks_exact(n)).enumerate() {
            self.problem.reference.line_mut(t).iter_mut().zip(r.iter().zip(f)).for_each(|(to, (r, f))| *to = r - f);
        }
        self.problem.begin(x0);
        self.problem.finite()?;
        self.problem.whole = false; // other inputs may be fixed
        let Self { problem, search, g, warm } = self;
        searched(problem, (search, g), bounds, warm.later(m), until, to)?;
        warm.reached(&to.active);
        Ok(())
    }
}

fn searched(
    problem: &mut Riccati,
    (search, g): (&mut Search, &mut [f64]),
    bounds: Bounds<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
    to: &mut Solution,
) -> Result<()> {
    let early = or_ended(search.run(problem, bounds, warm, until), until)?;
    if !search.certificate.objective.is_finite() {
        search.give_up(problem, bounds);
    }
    problem.slope(&search.u, g);
    tell(search, bounds, (early, search.certificate), (problem.zero, problem.scale()), to);
    Ok(())
}

/// The best inputs of a horizon within `bounds` (K m), step by step, from the limits that `warm` names.
///
/// # Errors
/// As [`crate::limits::box_control`].
pub fn horizon_control(
    horizon: &Steps<'_>,
    bounds: Bounds<'_>,
    warm: Option<&[i8]>,
    until: Until<'_>,
) -> Result<Solution> {
    let mut problem = Riccati::new(horizon)?;
    let d = problem.size();
    checked_rows("low", bounds.low.len(), 1, d)?;
    checked_warm(warm, d)?;
    let (mut search, mut g, mut found) = (Search::new(d)?, try_zeros(WHAT, d)?, Solution::sized(d)?);
    searched(&mut problem, (&mut search, &mut g), bounds, warm, until, &mut found)?;
    Ok(found)
}
