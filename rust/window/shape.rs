//! What a window is made of, and how it is kept from step to step.

use crate::error::{Error, Result};
use crate::memory::{checked_len, try_push, try_room, try_zeros};

pub(super) const WHAT: &str = "a window";
/// Of lags, filters, delays, and rows that fill filters.
pub(super) const LARGEST: usize = 1 << 16;

/// Which functions of past readings and inputs the window holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// The last so many readings and inputs.
    Lags(usize),
    /// So many filters in a row, with one pole.
    Filters {
        /// The pole a, in (0, 1).
        pole: f64,
        /// Their number r.
        count: usize,
    },
}

impl Kind {
    /// So many lags, or filters where there is a pole.
    pub(crate) fn of(pole: Option<f64>, count: usize) -> Self {
        pole.map_or(Self::Lags(count), |pole| Self::Filters { pole, count })
    }
}

/// A window, and its state x: of lags `(y_t .. y_{t-p+1}, u_{t-1} .. u_{t-D-p+1})`, of filters
/// `(xi_y at t, xi_u at t-1, u_{t-1} .. u_{t-D})`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    outputs: usize,
    inputs: usize,
    kind: Kind,
    delay: usize,
    intercept: bool,
    fill: usize,
}

impl Window {
    /// A window of `outputs` readings and `inputs` inputs that act `delay` steps later; `burn` are the rows that fill
    /// the filters at the start of a piece. Lags fill by themselves.
    ///
    /// # Errors
    /// [`Error::Value`] for sizes of 0 or out of range, or a pole outside (0, 1).
    pub fn new(outputs: usize, inputs: usize, kind: Kind, delay: usize, intercept: bool, burn: usize) -> Result<Self> {
        let (count, own) = match kind {
            Kind::Lags(p) => (p, p.saturating_sub(1)),
            Kind::Filters { count, .. } => (count, burn),
        };
        let sizes = [
            ("outputs", outputs, 1),
            ("inputs", inputs, 1),
            ("count", count, 1),
            ("delay", delay, 0),
            ("burn", own, 0),
        ];
        for (name, size, least) in sizes {
            if size < least || size > LARGEST {
                return Err(Error::Value {
                    name,
                    expected: "a number from 1 (0 for delay and burn) to 65536",
                    found: size.to_string(),
                });
            }
        }
        if let Kind::Filters { pole, .. } = kind
            && !(pole > 0.0 && pole < 1.0)
        {
            return Err(Error::Value { name: "pole", expected: "in (0, 1)", found: pole.to_string() });
        }
        let window = Self { outputs, inputs, kind, delay, intercept, fill: delay + own };
        checked_len(WHAT, window.states() + window.length(), window.states() + window.length())?;
        Ok(window)
    }

    /// The number of outputs n_y.
    #[must_use]
    pub const fn outputs(&self) -> usize {
        self.outputs
    }

    /// The number of inputs m.
    #[must_use]
    pub const fn inputs(&self) -> usize {
        self.inputs
    }

    /// Whether z has a 1 behind it.
    #[must_use]
    pub const fn intercept(&self) -> bool {
        self.intercept
    }

    /// That of the filters; None for lags.
    #[must_use]
    pub const fn pole(&self) -> Option<f64> {
        match self.kind {
            Kind::Lags(_) => None,
            Kind::Filters { pole, .. } => Some(pole),
        }
    }

    /// After how many steps an input acts.
    #[must_use]
    pub const fn delay(&self) -> usize {
        self.delay
    }

    /// p or r.
    #[must_use]
    pub const fn count(&self) -> usize {
        match self.kind {
            Kind::Lags(count) | Kind::Filters { count, .. } => count,
        }
    }

    /// Whether the first entries of x are the last readings themselves.
    pub(super) const fn lags(&self) -> bool {
        matches!(self.kind, Kind::Lags(_))
    }

    /// The number d of entries of z.
    #[must_use]
    pub const fn length(&self) -> usize {
        self.count() * (self.outputs + self.inputs) + self.intercept as usize
    }

    /// The number of entries of x.
    #[must_use]
    pub const fn states(&self) -> usize {
        let (past, count) = (self.count() * self.outputs, self.count());
        match self.kind {
            Kind::Lags(_) => past + (count - 1 + self.delay) * self.inputs,
            Kind::Filters { .. } => past + (count + self.delay) * self.inputs,
        }
    }

    /// How many pairs at the start of a piece only fill the window.
    #[must_use]
    pub const fn fill(&self) -> usize {
        self.fill
    }

    /// How many steps back the first reading and the first input are that are not in z, `far` where all of the past is,
    /// and how many inputs are later than all that are.
    #[must_use]
    pub const fn beyond(&self, far: usize) -> (usize, usize, usize) {
        match self.kind {
            Kind::Lags(count) => (count, self.delay + count, self.delay),
            Kind::Filters { .. } => (far, far, self.delay),
        }
    }

    /// The window with one filter more, filled by as many pairs; None for lags.
    ///
    /// # Errors
    /// [`Error::Value`] for more filters than a window may have.
    pub fn wider(&self) -> Result<Option<Self>> {
        let Kind::Filters { pole, count } = self.kind else { return Ok(None) };
        let kind = Kind::Filters { pole, count: count + 1 };
        let burn = self.fill - self.delay;
        Self::new(self.outputs, self.inputs, kind, self.delay, self.intercept, burn).map(Some)
    }

    /// The same, but with so many pairs to fill it.
    #[must_use]
    pub(super) const fn filled_after(mut self, fill: usize) -> Self {
        self.fill = fill;
        self
    }

    /// x at the start of a piece: all readings and inputs before it are taken to be the first ones.
    pub(crate) fn start(&self, y: &[f64], u: &[f64], x: &mut [f64]) {
        let (past, acting) = x.split_at_mut(self.count() * self.outputs);
        past.chunks_exact_mut(self.outputs).for_each(|to| to.copy_from_slice(y));
        acting.chunks_exact_mut(self.inputs).for_each(|to| to.copy_from_slice(u));
    }

    /// What x differs by from that at rest where outputs and inputs rise by `y` and `u` in a step: `-lag` times these,
    /// of filter j `a / (1 - a) + (j - 1) / (1 - a)`.
    pub(crate) fn ramp(&self, y: &[f64], u: &[f64], x: &mut [f64]) {
        let (past, acting) = x.split_at_mut(self.count() * self.outputs);
        let (lag, filters) = match self.kind {
            Kind::Lags(_) => ((0.0, 1.0), 0),
            Kind::Filters { pole, count } => ((pole / (1.0 - pole), 1.0 / (1.0 - pole)), count),
        };
        let own = |j: usize| lag.0 + j as f64 * lag.1;
        for (j, to) in past.chunks_exact_mut(self.outputs).enumerate() {
            to.iter_mut().zip(y).for_each(|(to, y)| *to = -own(j) * y);
        }
        // inputs before this one: filtered ones of what was put in one step and the delay before, then the queue
        for (j, to) in acting.chunks_exact_mut(self.inputs).enumerate() {
            let back = if j < filters { own(j) + 1.0 + self.delay as f64 } else { (j - filters + 1) as f64 };
            to.iter_mut().zip(u).for_each(|(to, u)| *to = -back * u);
        }
    }

    /// `z = J (x; u; one)`.
    pub(crate) fn regressors(&self, x: &[f64], u: &[f64], one: f64, z: &mut [f64]) {
        let (past, acting) = x.split_at(self.count() * self.outputs);
        let (of_outputs, rest) = z.split_at_mut(past.len());
        let (of_inputs, last) = rest.split_at_mut(self.count() * self.inputs);
        of_outputs.copy_from_slice(past);
        last.fill(one);
        let m = self.inputs;
        match self.kind {
            Kind::Lags(_) => {
                let mut every = u.iter().chain(acting).skip(self.delay * m);
                of_inputs.iter_mut().zip(&mut every).for_each(|(to, v)| *to = *v);
            }
            Kind::Filters { pole, count } => {
                let (filtered, queue) = acting.split_at(count * m);
                let arriving = if self.delay == 0 { u } else { &queue[(self.delay - 1) * m..] };
                of_inputs.copy_from_slice(filtered);
                shift(of_inputs, arriving, pole);
            }
        }
    }

    /// x one step later, from the reading then and the input now.
    pub(crate) fn advance(&self, x: &mut [f64], y: &[f64], u: &[f64]) {
        let (past, acting) = x.split_at_mut(self.count() * self.outputs);
        match self.kind {
            Kind::Lags(_) => {
                shift(past, y, 0.0);
                shift(acting, u, 0.0);
            }
            Kind::Filters { pole, count } => {
                let m = self.inputs;
                shift(past, y, pole);
                let (filtered, queue) = acting.split_at_mut(count * m);
                let arriving = if self.delay == 0 { u } else { &queue[(self.delay - 1) * m..] };
                shift(filtered, arriving, pole);
                shift(queue, u, 0.0);
            }
        }
    }

    /// The rows (z, y one step later) of `pairs` (y, u, y one step later), and the places of the pairs that they belong
    /// to.
    ///
    /// `first[t]` says whether pair t does not follow on the one before it: the window then starts anew.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn rows(&self, pairs: &[f64], first: &[bool]) -> Result<(Vec<f64>, Vec<usize>)> {
        let (n, m) = (self.outputs, self.inputs);
        let width = 2 * n + m;
        if pairs.len() != checked_len(WHAT, first.len(), width)? || first.first() == Some(&false) {
            let expected = format!("{} rows of {width} entries, of which the first begins a piece", first.len());
            return Err(Error::Shape { name: "pairs", expected, found: format!("{} entries", pairs.len()) });
        }
        let mut since = 0;
        let mut filled = try_room(WHAT, first.len())?;
        for (t, first) in first.iter().enumerate() {
            since = if *first { 0 } else { since + 1 };
            if since >= self.fill {
                try_push(WHAT, &mut filled, t)?;
            }
        }
        let d = self.length();
        let mut rows = try_zeros(WHAT, checked_len(WHAT, filled.len(), d + n)?)?;
        let mut x = try_zeros(WHAT, self.states())?;
        let mut out = rows.chunks_exact_mut(d + n).zip(&filled).peekable();
        for (t, (pair, first)) in pairs.chunks_exact(width).zip(first).enumerate() {
            let (y, u, next) = (&pair[..n], &pair[n..n + m], &pair[n + m..]);
            if *first {
                self.start(y, u, &mut x);
            }
            if let Some((row, _)) = out.next_if(|(_, place)| **place == t) {
                self.regressors(&x, u, 1.0, &mut row[..d]);
                row[d..].copy_from_slice(next);
            }
            self.advance(&mut x, next, u);
        }
        Ok((rows, filled))
    }

    /// x at the last of the readings `y` (T, n_y), with the inputs `u` (T - 1, m) between them.
    ///
    /// # Errors
    /// [`Error::Shape`] where they are too few to fill the window, or do not fit together.
    pub fn state_of(&self, y: &[f64], u: &[f64]) -> Result<Vec<f64>> {
        let (n, m) = (self.outputs, self.inputs);
        let steps = u.len() / m;
        if u.len() != steps * m || y.len() != (steps + 1) * n || steps < self.fill {
            let found = format!("{} entries and {}", y.len(), u.len());
            let expected = format!("{} rows of outputs or more, and a row of inputs between each two", self.fill + 1);
            return Err(Error::Shape { name: "record", expected, found });
        }
        let mut x = try_zeros(WHAT, self.states())?;
        let none = try_zeros(WHAT, m)?;
        self.start(&y[..n], u.get(..m).unwrap_or(&none), &mut x);
        for (y, u) in y[n..].chunks_exact(n).zip(u.chunks_exact(m)) {
            self.advance(&mut x, y, u);
        }
        Ok(x)
    }
}

/// One step of filters in a row: each is `pole` of itself and `1 - pole` of the one before it, the first of what
/// arrives.
fn shift(xi: &mut [f64], arriving: &[f64], pole: f64) {
    let width = arriving.len();
    for at in (0..xi.len()).rev() {
        let before = if at < width { arriving[at] } else { xi[at - width] };
        xi[at] = if pole == 0.0 { before } else { pole * xi[at] + (1.0 - pole) * before };
    }
}
