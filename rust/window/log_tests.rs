//! The tests of a log: those of the residuals of its model, and what the order of its pairs and runs says.

use super::order::Past;
use super::{Kind, Window};
use crate::error::Result;
use crate::identify::{Declared, Fitted, Given, Test, battery, fit, noise_tests};
use crate::memory::{checked_len, try_collect, try_copy, try_extend, try_filled, try_push, try_zeros};
use crate::parallel::Stop;

const WHAT: &str = "the tests of a log";
/// Of each test: together below 0.01.
pub(super) const LEVEL: f64 = 5e-4;
/// Times what rounding may change: residuals that are noise.
const CLEAR: f64 = 100.0;
/// Share that late inputs explain at least, and that a good window leaves at most.
const LARGE: f64 = 0.2;
/// The probability from which an input has no effect that is seen.
const NO_EFFECT: f64 = 1e-3;
/// Runs that end beyond one limit, from which it ended them.
const FEW: usize = 5;
/// The largest spectral radius of a plant whose noise is followed over its runs.
const UNSTABLE: f64 = 1.5;
/// Steps back: no pair has so many before it.
const FAR: usize = 1_000_000_000;

/// Logged pairs, and how they follow on each other.
#[derive(Debug, Clone, Copy)]
pub struct Log<'a> {
    /// (x, u, x one step later) (N, 2 n + m).
    pub pairs: &'a [f64],
    /// The place of each pair in its piece (N).
    pub places: &'a [usize],
    /// The run of each pair (N), rising.
    pub runs: &'a [usize],
    /// The number of states or outputs.
    pub n: usize,
    /// The number of inputs.
    pub m: usize,
}

impl Log<'_> {
    pub(super) fn size(&self) -> usize {
        self.places.len()
    }

    fn pair(&self, t: usize) -> &[f64] {
        &self.pairs[t * (2 * self.n + self.m)..][..2 * self.n + self.m]
    }

    fn x(&self, t: usize) -> &[f64] {
        &self.pair(t)[..self.n]
    }

    fn u(&self, t: usize) -> &[f64] {
        &self.pair(t)[self.n..self.n + self.m]
    }

    fn y(&self, t: usize) -> &[f64] {
        &self.pair(t)[self.n + self.m..]
    }

    /// The last pair of each run.
    fn ends(&self) -> Result<Vec<usize>> {
        try_collect(WHAT, (0..self.size()).filter(|&t| self.runs.get(t + 1) != Some(&self.runs[t])))
    }

    /// The rows (z, y) of complete windows, and their pairs.
    pub(super) fn rows(&self, window: &Window) -> Result<(Vec<f64>, Vec<usize>)> {
        window.rows(self.pairs, &try_collect(WHAT, self.places.iter().map(|&place| place == 0))?)
    }
}

/// What is declared of a log and its model.
#[derive(Debug, Clone, Copy)]
pub struct Declarations<'a> {
    /// The pairs of the model.
    pub log: Log<'a>,
    /// The runs of which these are the last pairs.
    pub whole: Option<Log<'a>>,
    /// From which part of the past it predicts.
    pub past: Past,
    /// The least and the largest delay, of a past that is not known.
    pub delays: [usize; 2],
    /// Whether z has a 1.
    pub intercept: bool,
    /// Whether outputs are read: of states only the delay is chosen.
    pub read: bool,
    /// Whether z is of outputs, or of states with a dead time.
    pub windowed: bool,
    /// Whether the size of z was expected before the data.
    pub scaled: bool,
    /// Whether the error has an exact law, for which no size counts.
    pub exact: bool,
    /// Whether starts are declared to be independent of the noise of all runs.
    pub piloted: bool,
    /// The rows that are not declared as exact.
    pub tested: &'a [usize],
    /// What was declared of the noise.
    pub noise: Option<Declared<'a>>,
}

/// All tests that the pairs allow, of each name the one with the smallest probability, for least squares of those
/// behind the `first` ones.
pub(super) fn log_tests(
    of: &Declarations<'_>,
    window: &Window,
    first: usize,
    fitted: &Fitted,
    stop: &Stop,
) -> Result<Vec<Test>> {
    let log = of.log;
    let width = window.length() + log.n;
    let plain = !of.windowed && window.fill() == 0;
    let (all, mut at) = log.rows(window)?;
    let before = at.partition_point(|&t| t < first);
    let rows = &all[before * width..];
    at.drain(..before);
    let raw = of.whole.filter(|_| plain).unwrap_or(log);
    if plain && of.whole.is_some() {
        at = raw.ends()?;
    }
    let rest = one_filter_more(log, window, at.len())?;
    let noise = noisy(fitted, of.tested)?;
    let mut found = Vec::new();
    let given = Rows { log: raw, rows, at: &at, window, extra: rest.as_deref(), marked: None };
    add(&mut found, given.tests(fitted, &noise, stop)?)?;
    add(&mut found, declared_tests(fitted, of.tested, of.noise)?)?;
    wraps(raw, &mut found)?;
    if let Some(late) = take(&mut found, "late rows").filter(|late| late.p_value <= LEVEL) {
        if plain && no_effect(&found) {
            let p_value = late_actions(log, stop)?.map_or(1.0, |test| test.p_value.max(late.p_value));
            put(&mut found, Test { p_value, ..late })?;
        } else if !plain && late.share > LARGE && follow(raw, &at, rows, width, stop)? {
            put(&mut found, late)?;
        }
    }
    found.retain(|test| test.name != "effect");
    if of.whole.is_some() {
        before_last(of.tested, window.intercept(), raw, &mut found, stop)?;
    }
    if (of.piloted || of.whole.is_some())
        && let Some(test) = starts(raw, window.intercept(), stop)?
    {
        put(&mut found, Test { name: "starts", ..test })?;
    }
    Ok(found)
}

/// The tests of what was declared of the noise, in rows that are far above rounding.
///
/// # Errors
/// [`crate::error::Error::Value`] for rows that there are not; no memory.
pub fn declared_tests(f: &Fitted, tested: &[usize], declared: Option<Declared<'_>>) -> Result<Vec<Test>> {
    let (rows, n) = (noisy(f, tested)?, f.rows.len());
    let Some(declared) = declared.filter(|_| !rows.is_empty()) else { return Ok(Vec::new()) };
    let part =
        |m: &[f64]| try_collect(WHAT, rows.iter().flat_map(|&i| rows.iter().map(move |&j| i * n + j)).map(|k| m[k]));
    let known = match declared {
        Declared::Gaussian(known) | Declared::SubGaussian(known) => part(known)?,
        _ => Vec::new(),
    };
    let declared = match declared {
        Declared::Gaussian(_) => Declared::Gaussian(&known),
        Declared::SubGaussian(_) => Declared::SubGaussian(&known),
        other => other,
    };
    let mut tests = noise_tests(&part(&f.residual)?, rows.len(), (f.size, f.degrees()), declared)?;
    tests.iter_mut().for_each(|test| test.at.iter_mut().for_each(|i| *i = rows[*i]));
    Ok(tests)
}

/// Rows of which residuals are far above rounding, which is no noise of one law.
fn noisy(f: &Fitted, tested: &[usize]) -> Result<Vec<usize>> {
    let n = f.rows.len();
    let clear = |i: &usize| f.residual[i * (n + 1)].sqrt() > CLEAR * f.rounding[*i];
    try_collect(WHAT, tested.iter().copied().filter(|&i| i < n).filter(clear))
}

/// The rows of a model, and the log that they are of.
struct Rows<'a> {
    log: Log<'a>,
    rows: &'a [f64],
    at: &'a [usize],
    window: &'a Window,
    extra: Option<&'a [f64]>,
    marked: Option<&'a [bool]>,
}

impl Rows<'_> {
    fn tests(&self, fitted: &Fitted, tested: &[usize], stop: &Stop) -> Result<Vec<Test>> {
        let (log, window) = (self.log, self.window);
        let basis = fitted.span(tested)?.basis;
        let runs = try_collect(WHAT, self.at.iter().map(|&t| log.runs[t]))?;
        let given = Given {
            rows: self.rows,
            fitted,
            basis: &basis,
            pairs: log.pairs,
            at: self.at,
            places: log.places,
            runs: &runs,
            d: window.length(),
            n: log.n,
            m: log.m,
            inputs_at: window.count() * log.n,
            intercept: window.intercept(),
            beyond: window.beyond(FAR),
            extra: self.extra,
            marked: self.marked,
        };
        battery(&given, stop)
    }
}

/// Of each name, and of each input whose effect is tested, the smallest.
fn add(found: &mut Vec<Test>, tests: Vec<Test>) -> Result<()> {
    for test in tests {
        let alike = |other: &&mut Test| other.name == test.name && (test.name != "effect" || other.at == test.at);
        match found.iter_mut().find(alike) {
            Some(other) if test.p_value < other.p_value => *other = test,
            Some(_) => {}
            None => try_push(WHAT, found, test)?,
        }
    }
    Ok(())
}

fn take(found: &mut Vec<Test>, name: &str) -> Option<Test> {
    found.iter().position(|test| test.name == name).map(|at| found.remove(at))
}

/// In place of what has its name.
pub(super) fn put(found: &mut Vec<Test>, test: Test) -> Result<()> {
    take(found, test.name);
    try_push(WHAT, found, test)
}

fn no_effect(found: &[Test]) -> bool {
    let mut effects = found.iter().filter(|test| test.name == "effect").peekable();
    effects.peek().is_some() && effects.all(|test| test.p_value > NO_EFFECT)
}

/// Outputs and inputs through one filter more than a window of filters has, in the last `count` complete windows.
fn one_filter_more(log: Log<'_>, window: &Window, count: usize) -> Result<Option<Vec<f64>>> {
    let Some(wide) = window.wider()? else { return Ok(None) };
    let (n, m, width) = (log.n, log.m, wide.length() + log.n);
    let (rows, at) = log.rows(&wide)?;
    let inputs = width - n - m - usize::from(wide.intercept());
    let mut more = Vec::new();
    for row in rows[(at.len() - count) * width..].chunks_exact(width) {
        try_extend(WHAT, &mut more, row[window.count() * n..][..n].iter().chain(&row[inputs..][..m]).copied())?;
    }
    Ok(Some(more))
}

/// What more columns (N, any) explain of p outcomes beside z in `rows` (N, d + p), as the test "memory".
fn beside(rows: &[f64], (d, p): (usize, usize), extra: &[f64], stop: &Stop) -> Result<Option<Test>> {
    let size = rows.len() / (d + p);
    if size <= d + p + extra.len().checked_div(size).unwrap_or(0) {
        return Ok(None);
    }
    let f = fit(rows, d + p, d, size, 1, stop)?;
    if (0..p).any(|i| f.residual[i * (p + 1)] <= (10.0 * f.rounding[i]).powi(2)) {
        return Ok(None);
    }
    let (mut basis, pairs) = (try_zeros(WHAT, p * p)?, try_zeros(WHAT, checked_len(WHAT, size, 2 * p)?)?);
    basis.iter_mut().step_by(p + 1).for_each(|v| *v = 1.0);
    let (order, places) = (try_collect(WHAT, 0..size)?, try_filled(WHAT, 0, size)?);
    let given = Given {
        rows,
        fitted: &f,
        basis: &basis,
        pairs: &pairs,
        at: &order,
        places: &places,
        runs: &order,
        d,
        n: p,
        m: 0,
        inputs_at: d,
        intercept: false,
        beyond: (FAR, FAR, 0),
        extra: Some(extra),
        marked: None,
    };
    Ok(take(&mut battery(&given, stop)?, "memory"))
}

/// Jumps of one size, of which few are undone in the next step, are no spikes.
fn wraps(raw: Log<'_>, found: &mut Vec<Test>) -> Result<()> {
    let Some(spikes) = found.iter().find(|test| test.name == "spikes").cloned() else { return Ok(()) };
    for i in 0..raw.n {
        let steps = || (0..raw.size()).map(|t| (raw.y(t)[i] - raw.x(t)[i]).abs());
        let ends = (0..raw.size()).map(|t| raw.y(t)[i]);
        let (low, high) = ends.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        let jump = steps().fold(0.0, f64::max);
        let alike = jump > 0.5 * (high - low) && steps().all(|step| step <= 0.5 * jump || step > 0.8 * jump);
        let count = steps().filter(|step| *step > 0.5 * jump).count();
        if alike && count as f64 > 2.5 * spikes.at.len() as f64 {
            let at = try_collect(WHAT, [i])?;
            put(found, Test { name: "spikes", p_value: 1.0, share: 0.0, at: Vec::new(), each: Vec::new() })?;
            return put(found, Test { name: "wrap", at, share: jump, ..spikes });
        }
    }
    Ok(())
}

/// Whether readings follow the inputs of the next row: these do not depend on the window.
///
/// Those of a feedback do, as far as the window predicts the readings.
fn follow(raw: Log<'_>, at: &[usize], rows: &[f64], width: usize, stop: &Stop) -> Result<bool> {
    let (d, n) = (width - raw.n, raw.n);
    let (mut of_y, mut of_u, mut extra) = (Vec::new(), Vec::new(), Vec::new());
    for (row, &t) in rows.chunks_exact(width).zip(at) {
        if raw.places.get(t + 1).is_some_and(|&place| place > 0) {
            try_extend(WHAT, &mut of_y, [1.0].iter().chain(&row[d..]).copied())?;
            try_extend(WHAT, &mut of_u, [1.0].iter().chain(raw.u(t + 1)).copied())?;
            try_extend(WHAT, &mut extra, row[..d].iter().copied())?;
        }
    }
    let window = beside(&of_y, (1, n), &extra, stop)?;
    let inputs = beside(&of_u, (1, raw.m), &extra, stop)?;
    let good = window.is_some_and(|test| test.each.iter().all(|share| *share > 1.0 - LARGE));
    Ok(good && inputs.is_some_and(|test| test.p_value > NO_EFFECT))
}

/// What the row before explains of an input beside the state.
///
/// With `u = K x + d` of a feedback the next input explains, too, through the next state; but then u(k) depends on x(k)
/// alone, in rows that hold the state after their action on the one before.
fn late_actions(log: Log<'_>, stop: &Stop) -> Result<Option<Test>> {
    let (mut rows, mut extra) = (Vec::new(), Vec::new());
    for t in (0..log.size()).filter(|&t| log.places[t] > 0) {
        try_extend(WHAT, &mut rows, log.x(t).iter().chain(&[1.0]).chain(log.u(t)).copied())?;
        try_extend(WHAT, &mut extra, log.x(t - 1).iter().chain(log.u(t - 1)).copied())?;
    }
    beside(&rows, (log.n + 1, log.m), &extra, stop)
}

/// What the rows before the last pairs say: of dead time and hidden states, and of the ends.
fn before_last(tested: &[usize], intercept: bool, raw: Log<'_>, found: &mut Vec<Test>, stop: &Stop) -> Result<()> {
    let window = Window::new(raw.n, raw.m, Kind::Lags(1), 0, intercept, 0)?;
    let (rows, at) = raw.rows(&window)?;
    let width = window.length() + raw.n;
    let f = fit(&rows, width, window.length(), at.len(), 1, stop)?;
    let noise = noisy(&f, tested)?;
    let tests = |marked: Option<&[bool]>| {
        let given = Rows { log: raw, rows: &rows, at: &at, window: &window, extra: None, marked };
        let mut own = Vec::new();
        add(&mut own, given.tests(&f, &noise, stop)?)?;
        Ok::<_, crate::error::Error>(own)
    };
    let mut whole = tests(None)?;
    for name in ["memory", "dead time"] {
        let least = [take(&mut whole, name), take(found, name)].into_iter().flatten();
        if let Some(test) = least.reduce(|a, b| if b.p_value < a.p_value { b } else { a }) {
            put(found, Test { p_value: (2.0 * test.p_value).min(1.0), ..test })?;
        }
    }
    let ends = raw.ends()?;
    let length = |k: usize| if k == 0 { ends[0] + 1 } else { ends[k] - ends[k - 1] };
    let longest = (0..ends.len()).map(length).max().unwrap_or(0);
    if (0..ends.len()).all(|k| length(k) == longest) {
        return Ok(());
    }
    let mut last = try_filled(WHAT, false, raw.size())?;
    ends.iter().for_each(|&t| last[t] = true);
    for test in tests(Some(&last))? {
        put(found, test)?;
    }
    let short = try_collect(WHAT, (0..ends.len()).filter(|&k| length(k) < longest).map(|k| ends[k]))?;
    if short.len() >= FEW && one_limit(raw, &short, &last) {
        put(found, Test { name: "ends", p_value: 0.0, share: 1.0, at: Vec::new(), each: Vec::new() })?;
    }
    Ok(())
}

/// Whether one limit of a reading parts the ends of all runs but the longest from the rest.
///
/// The first readings are left out: a start beyond the limit ends nothing.
fn one_limit(raw: Log<'_>, short: &[usize], last: &[bool]) -> bool {
    let ways: [fn(f64) -> f64; 3] = [|v| v, |v| -v, f64::abs];
    (0..raw.n).any(|i| {
        ways.iter().any(|way| {
            let ended = short.iter().map(|&t| way(raw.y(t)[i])).fold(f64::MAX, f64::min);
            let others = (0..raw.size()).filter(|&t| !last[t]).map(|t| way(raw.y(t)[i]));
            ended > others.fold(f64::MIN, f64::max)
        })
    })
}

/// Whether starts depend on the noise of the run before, as those of pieces of one log do.
///
/// `eta = sum A^(T-1-k) e(k)` is the part of noise in the end of a run: beside a constant and the rest of that end,
/// which may be by plan, it must not explain the next start.
fn starts(raw: Log<'_>, intercept: bool, stop: &Stop) -> Result<Option<Test>> {
    let (n, ends) = (raw.n, raw.ends()?);
    let begins = |t: usize| t == 0 || raw.runs[t] != raw.runs[t - 1];
    let gaps = (0..raw.size()).any(|t| raw.places[t] == 0 && !begins(t));
    if ends.len() < 2 * n + 6 || gaps {
        return Ok(None);
    }
    let window = Window::new(n, raw.m, Kind::Lags(1), 0, intercept, 0)?;
    let (rows, _) = raw.rows(&window)?;
    let d = window.length();
    let f = fit(&rows, d + n, d, raw.size(), 1, stop)?;
    let row = |i: usize| &f.model[i * d..(i + 1) * d];
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut square = Vec::new();
    (0..n).try_for_each(|i| try_extend(WHAT, &mut square, row(i)[..n].iter().copied()))?;
    let stable = spectral_radius(square, n)? < UNSTABLE;
    if !stable {
        return Ok(None);
    }
    let (mut eta, mut begun, mut moving) = (Vec::new(), Vec::new(), try_filled(WHAT, false, n)?);
    let mut now = try_zeros(WHAT, n)?;
    for t in 0..raw.size() {
        if begins(t) {
            now.fill(0.0);
            if t > 0 {
                moving.iter_mut().enumerate().for_each(|(i, moves)| *moves |= raw.x(t)[i] != raw.x(ends[0] + 1)[i]);
                try_push(WHAT, &mut begun, t)?;
            }
        }
        let z = &rows[t * (d + n)..][..d];
        let next = try_collect(WHAT, (0..n).map(|i| dot(&row(i)[..n], &now) + raw.y(t)[i] - dot(row(i), z)))?;
        now = next;
        if raw.runs.get(t + 1).is_some_and(|run| *run != raw.runs[t]) {
            try_extend(WHAT, &mut eta, now.iter().copied())?;
        }
    }
    let count = moving.iter().filter(|moves| **moves).count();
    if count == 0 || eta.iter().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    let mut given = Vec::new();
    for (eta, &t) in eta.chunks_exact(n).zip(&begun) {
        let end = raw.y(t - 1).iter().zip(eta).map(|(y, eta)| y - eta);
        let start = raw.x(t).iter().zip(&moving).filter(|(_, moves)| **moves).map(|(x, _)| *x);
        try_extend(WHAT, &mut given, std::iter::once(1.0).chain(end).chain(start))?;
    }
    beside(&given, (n + 1, count), &eta, stop)
}

/// `||A^(2^k)||^(2^-k)` for a large k.
fn spectral_radius(mut a: Vec<f64>, n: usize) -> Result<f64> {
    let (mut log, mut weight) = (0.0, 1.0);
    for _ in 0..30 {
        let size = a.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        if size == 0.0 {
            return Ok(0.0);
        }
        log += weight * size.ln();
        weight /= 2.0;
        a.iter_mut().for_each(|v| *v /= size);
        let b = try_copy(WHAT, &a)?;
        for (at, to) in a.iter_mut().enumerate() {
            *to = (0..n).map(|k| b[at / n * n + k] * b[k * n + at % n]).sum();
        }
    }
    Ok(log.exp())
}
