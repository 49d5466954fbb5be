//! Where a model of readings can rest, what holds it there, and where all systems of a region do.
//!
//! `y(t+1) = Theta z_t + e`; filters have the gain 1, so that at rest `z = N (y, u) + N_1`, and (y, u) rests iff
//!
//! ```text
//! M (y, u) = c + e,    M = [I, 0] - Theta N,    c = Theta N_1
//! ```
//!
//! Where a gain makes the loop of the model stable, M has full row rank: its points of rest are of dimension m, whether
//! it integrates or not. m rows `[Hy Hu] (y, u) = r` choose one: `(y, u) = T_e (c + e) + T_r r`,
//! `[T_e T_r] = [M; Hy Hu]^-1`.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result, sized};
use crate::identify::whiten;
use crate::matrix::MatrixView;
use crate::memory::{covered, room_for_products, try_collect, try_extend, try_push, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, Region};
use crate::window::Window;

use super::{Bounds, Penalty, Until, box_control};

pub(super) const WHAT: &str = "a set point";
/// Relative singular values below it are rounding.
const RANK: f64 = 1e-10;
/// Held outputs or inputs that move by less than this, in units of their ranges, while free outputs move by their own:
/// these integrate.
const FLAT: f64 = 0.03;
/// The weight of an output with a target and none in the cost, beside the largest.
const SMALL: f64 = 1e-6;
/// So many inputs have all sets of their limits tried.
const ENUMERATED: usize = 6;

pub(super) type Matrix = Mat<f64>;

/// The points of rest of a model.
#[derive(Debug)]
pub struct SetPoints {
    pub(super) window: Window,
    /// `[N_y N_u]` (d, p + m).
    pub(super) along: Matrix,
    /// `M` (p, p + m), and c.
    pub(super) m: Matrix,
    c: Matrix,
    /// The state of the window per (y, u) at rest (n, p + m); what a slope of 1 per step takes off it, and off the next
    /// reading.
    states: Matrix,
    ramp: Matrix,
    ahead: Matrix,
    /// The sizes of outputs and inputs.
    unit: Vec<f64>,
}

/// What is asked of a set point.
#[derive(Debug, Clone, Copy)]
pub struct SetPointTask<'a> {
    /// The outputs (p); nan where one is free.
    pub target: &'a [f64],
    /// The weights Q (p, p) of `(y - target)'Q (y - target)`.
    pub weights: MatrixView<'a>,
    /// Where outputs stay that are free and integrate (p).
    pub now: &'a [f64],
    /// The limits of the inputs (m).
    pub low: &'a [f64],
    /// See `low`.
    pub high: &'a [f64],
    /// Inputs that are measured and not chosen (m); nan where one is chosen.
    pub given: &'a [f64],
}

/// A point of rest, and the rows that hold it.
#[derive(Debug)]
#[non_exhaustive]
pub struct SetPoint {
    /// Outputs and inputs (p + m).
    pub place: Vec<f64>,
    /// `T_e` (p + m, p), of a constant e.
    pub of_bias: Vec<f64>,
    /// What one unit of each target adds (p + m, p), `T_r dr/dy`; 0 for free ones.
    pub of_target: Vec<f64>,
    /// What one unit of each given input adds (p + m, m); 0 for chosen ones.
    pub of_given: Vec<f64>,
    /// Inputs that are held by a limit.
    pub at_limit: Vec<usize>,
    /// Outputs that are held exactly, whatever constant acts (p).
    pub exact: Vec<bool>,
}

/// The points of rest of all systems of a region that keep the held rows.
#[derive(Debug)]
pub struct Spread {
    /// Their middle less the set point (p + m).
    pub shift: Vec<f64>,
    /// How far they are from it at most.
    pub half: Vec<f64>,
    /// `||W N T_e D||`, below 1.
    pub norm: f64,
}

/// `a = u diag(s) v'` with all of v.
pub(super) struct Parts {
    u: Matrix,
    pub s: Vec<f64>,
    v: Matrix,
}

fn lost<T>(_: T) -> Error {
    Error::Numerical("a decomposition of a set point did not converge".into())
}

pub(super) fn parts(a: &Matrix) -> Result<Parts> {
    if a.nrows() == 0 || a.ncols() == 0 {
        let (u, v) = (Matrix::identity(a.nrows(), a.nrows()), Matrix::identity(a.ncols(), a.ncols()));
        return Ok(Parts { u, s: Vec::new(), v });
    }
    let svd = a.svd().map_err(lost)?;
    let s = try_collect(WHAT, svd.S().column_vector().iter().copied())?;
    Ok(Parts { u: svd.U().to_owned(), s, v: svd.V().to_owned() })
}

impl Parts {
    pub fn rank(&self, cut: f64) -> usize {
        self.s.iter().filter(|s| **s > cut).count()
    }

    /// The shortest x with the least `||a x - b||`, of the first `rank` singular values.
    pub fn solve(&self, b: &Matrix, rank: usize) -> Matrix {
        let along = self.u.subcols(0, rank).transpose() * b;
        self.v.subcols(0, rank) * Mat::from_fn(rank, b.ncols(), |i, j| along[(i, j)] / self.s[i])
    }

    /// The directions that the first `rank` leave free.
    pub fn free(&self, rank: usize) -> Matrix {
        self.v.subcols(rank, self.v.ncols() - rank).to_owned()
    }
}

fn stacked(above: &Matrix, below: &Matrix) -> Matrix {
    let first = above.nrows();
    Mat::from_fn(first + below.nrows(), above.ncols().max(below.ncols()), |i, j| {
        if i < first { above[(i, j)] } else { below[(i - first, j)] }
    })
}

/// Row by row.
pub(super) fn listed(a: &Matrix) -> Result<Vec<f64>> {
    try_collect(WHAT, (0..a.nrows() * a.ncols()).map(|at| a[(at / a.ncols(), at % a.ncols())]))
}

/// The nearest point in the units of the signals, with the rows that hold it and what these are per target and apart
/// from it.
struct Nearest {
    v: Matrix,
    rows: Matrix,
    per_target: Matrix,
    values: Matrix,
}

/// A target in units of the signals.
struct Goal {
    /// Ones of the outputs that have a target (p, p).
    set: Matrix,
    /// Directions that move these by less are none in which they are held.
    cut: f64,
    goal: Matrix,
    now: Matrix,
}

/// The limits of the inputs in their units, behind so many that are given.
struct Within {
    fixed: usize,
    sides: [Matrix; 2],
}

impl Within {
    /// The input farthest beyond a limit that does not hold it, and this limit.
    fn worst(&self, v: &Matrix, p: usize, active: &[(usize, f64)]) -> Option<(usize, f64)> {
        let [low, high] = &self.sides;
        let u = |i: usize| v[(p + i, 0)];
        let over = |i: usize| (low[(i, 0)] - u(i)).max(u(i) - high[(i, 0)]);
        let size = (0..low.nrows()).map(|i| u(i).abs()).fold(1.0, f64::max);
        let out = (0..low.nrows()).filter(|i| active.iter().all(|(held, _)| held != i));
        let worst = out.max_by(|i, j| over(*i).total_cmp(&over(*j))).filter(|i| over(*i) > RANK * size)?;
        Some((worst, if u(worst) < low[(worst, 0)] { low[(worst, 0)] } else { high[(worst, 0)] }))
    }
}

impl SetPoints {
    /// Of a model `theta` (p, d); `unit` has the sizes of its outputs and inputs (p + m).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Value`] for a size that is not above 0, [`Error::Memory`].
    pub fn new<'a>(window: Window, theta: impl Into<MatrixView<'a>>, unit: &[f64]) -> Result<Self> {
        let (p, m, n, d) = (window.outputs(), window.inputs(), window.states(), window.length());
        let theta = theta.into().sized("theta", p, d)?;
        sized("unit", unit.len(), p + m)?;
        if let Some(wrong) = unit.iter().find(|v| !(**v > 0.0 && v.is_finite())) {
            return Err(Error::Value { name: "unit", expected: "above 0, and finite", found: wrong.to_string() });
        }
        room_for_products()?;
        let ([mut x, mut z], mut both) =
            ([try_zeros::<f64>(WHAT, n)?, try_zeros::<f64>(WHAT, d)?], try_zeros::<f64>(WHAT, p + m)?);
        let none = try_zeros::<f64>(WHAT, m)?;
        covered(WHAT, 256 * ((d + n + p + m) as u128 + 16).pow(2), || {
            let h = MatRef::from_row_major_slice(&theta, p, d).to_owned();
            let k = p + m;
            let (mut along, mut states) = (Mat::zeros(d, k), Mat::zeros(n, k));
            let (mut ramp, mut of_ramp, mut offset) = (Mat::zeros(n, k), Mat::zeros(d, k), Mat::zeros(d, 1));
            for j in 0..=k {
                both.fill(0.0);
                if j < k {
                    both[j] = 1.0;
                }
                let (y, u) = both.split_at(p);
                window.start(y, u, &mut x);
                window.regressors(&x, u, f64::from(u8::from(j == k)), &mut z);
                for i in 0..d {
                    if j < k { along[(i, j)] = z[i] } else { offset[(i, 0)] = z[i] }
                }
                if j < k {
                    (0..n).for_each(|i| states[(i, j)] = x[i]);
                    window.ramp(y, u, &mut x);
                    window.regressors(&x, &none, 0.0, &mut z);
                    (0..n).for_each(|i| ramp[(i, j)] = x[i]);
                    (0..d).for_each(|i| of_ramp[(i, j)] = z[i]);
                }
            }
            let at = &h * &along;
            let m = Mat::from_fn(p, k, |i, j| f64::from(u8::from(i == j)) - at[(i, j)]);
            let (c, ahead) = (&h * offset, &h * of_ramp);
            Ok(Self { window, along, m, c, states, ramp, ahead, unit: try_collect(WHAT, unit.iter().copied())? })
        })?
    }

    /// p and m.
    #[must_use]
    pub const fn sizes(&self) -> (usize, usize) {
        (self.window.outputs(), self.window.inputs())
    }

    pub(super) fn bytes(&self) -> u128 {
        1024 * (self.unit.len() as u128 + self.along.nrows() as u128 + 16).pow(2)
    }

    /// `M` for (y, u) in their units.
    fn in_units(&self) -> Matrix {
        Mat::from_fn(self.m.nrows(), self.m.ncols(), |i, j| self.m[(i, j)] * self.unit[j])
    }

    /// The largest entry of each row of `M` in its units.
    fn row_sizes(&self) -> Result<Vec<f64>> {
        let (scaled, k) = (self.in_units(), self.unit.len());
        let largest = |i: usize| (0..k).map(|j| scaled[(i, j)].abs()).fold(0.0, f64::max);
        try_collect(WHAT, (0..scaled.nrows()).map(|i| if largest(i) > 0.0 { largest(i) } else { 1.0 }))
    }

    /// `M` in its units, with rows of size 1.
    fn in_rows(&self, sizes: &[f64]) -> Matrix {
        let scaled = self.in_units();
        Mat::from_fn(scaled.nrows(), scaled.ncols(), |i, j| scaled[(i, j)] / sizes[i])
    }

    /// Whether some feedback can hold the outputs: whether M has full row rank.
    ///
    /// # Errors
    /// [`Error::Numerical`], [`Error::Memory`].
    pub fn can_be_held(&self) -> Result<bool> {
        covered(WHAT, self.bytes(), || {
            let found = parts(&self.in_rows(&self.row_sizes()?))?;
            Ok(found.s.last().is_some_and(|s| *s > RANK * found.s[0]))
        })?
    }

    /// What a constant input adds to the next reading (p, m).
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn of_inputs(&self) -> Result<Vec<f64>> {
        let (p, m) = self.sizes();
        try_collect(WHAT, (0..p * m).map(|at| -self.m[(at / m, p + at % m)]))
    }

    /// What a constant e adds to the state of the window at a set point (n, p), `T_x = X T_e`.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn states_of_bias(&self, point: &SetPoint) -> Result<Vec<f64>> {
        let (p, k) = (self.sizes().0, self.unit.len());
        covered(WHAT, self.bytes(), || listed(&(&self.states * MatRef::from_row_major_slice(&point.of_bias, k, p))))?
    }

    /// The nearest point of rest, with some inputs at given values; see [`Self::at`].
    fn nearest(&self, root: &Matrix, Goal { set, cut, goal, now }: &Goal, active: &[(usize, f64)]) -> Result<Nearest> {
        let (p, k) = (self.sizes().0, self.unit.len());
        let units = Mat::from_fn(active.len(), k, |i, j| f64::from(u8::from(j == p + active[i].0)));
        let sizes = self.row_sizes()?;
        let all = stacked(&self.in_rows(&sizes), &units);
        let values =
            Mat::from_fn(all.nrows(), 1, |i, _| if i < p { self.c[(i, 0)] / sizes[i] } else { active[i - p].1 });
        let rest = parts(&all)?;
        let rank = rest.rank(RANK * rest.s[0]);
        let (start, free) = (rest.solve(&values, rank), rest.free(rank));
        let outputs = |a: &Matrix| a.subrows(0, p).to_owned();
        let inputs = |a: &Matrix| a.subrows(p, k - p).to_owned();
        let count = free.ncols();
        let mut rows = Mat::zeros(count + active.len(), k);
        let (mut per_target, mut held) = (Mat::zeros(rows.nrows(), p), Mat::zeros(rows.nrows(), 1));
        // least (y - r)'Q (y - r), where the outputs of the target move
        let split = parts(&(set * outputs(&free)))?;
        let count_moving = split.rank(cut * set.norm_l2());
        let moving = &free * split.v.subcols(0, count_moving);
        let first = parts(&(root * outputs(&moving)))?;
        let one = first.rank(RANK * root.norm_l2());
        let mut v = &start + &moving * first.solve(&(root * (goal - outputs(&start))), one);
        let of_target = first.u.subcols(0, one).transpose() * root;
        for i in 0..one {
            for j in 0..p {
                (rows[(i, j)], per_target[(i, j)]) = (of_target[(i, j)], of_target[(i, j)] / self.unit[j]);
            }
        }
        // then the least inputs, in their units
        let (here, still) = (moving * first.free(one), &free * split.free(count_moving));
        let left = Mat::from_fn(k, here.ncols() + still.ncols(), |i, j| {
            if j < here.ncols() { here[(i, j)] } else { still[(i, j - here.ncols())] }
        });
        let second = parts(&inputs(&left))?;
        let two = second.rank(FLAT);
        v -= &left * second.solve(&inputs(&v), two);
        for i in 0..two {
            (p..k).for_each(|j| rows[(one + i, j)] = second.u[(j - p, i)]);
        }
        // what integrates stays where it is
        let last = &left * second.free(two);
        let third = parts(&outputs(&last))?;
        let three = third.rank(RANK);
        v += &last * third.solve(&(now - outputs(&v)), three);
        for i in 0..three {
            (0..p).for_each(|j| rows[(one + two + i, j)] = third.u[(j, i)]);
            held[(one + two + i, 0)] = (0..p).map(|j| third.u[(j, i)] * now[(j, 0)]).sum::<f64>();
        }
        if one + two + three < count {
            return Err(Error::Numerical("a set point is not determined".into()));
        }
        for (i, (input, value)) in active.iter().enumerate() {
            (rows[(count + i, p + input)], held[(count + i, 0)]) = (1.0, *value);
        }
        Ok(Nearest { v, rows, per_target, values: held })
    }

    /// The point of rest with the least `(y - r)'Q (y - r)` within the limits of the inputs; among those that are as
    /// near the one with the least inputs in their units, and an output that is free and integrates stays where it is.
    ///
    /// As many outputs as inputs, or fewer, are held exactly. An active set of limits.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`].
    pub fn at(&self, wish: &SetPointTask<'_>) -> Result<SetPoint> {
        let (p, m) = self.sizes();
        let outputs = [("target", wish.target, p), ("now", wish.now, p)];
        let inputs = [("low", wish.low, m), ("high", wish.high, m), ("given", wish.given, m)];
        outputs.into_iter().chain(inputs).try_for_each(|(name, of, len)| sized(name, of.len(), len))?;
        let weights = wish.weights.sized("weights", p, p)?;
        room_for_products()?;
        covered(WHAT, self.bytes(), || self.found(wish, &weights))?
    }

    fn found(&self, wish: &SetPointTask<'_>, weights: &[f64]) -> Result<SetPoint> {
        let ((p, m), k) = (self.sizes(), self.unit.len());
        let set = |i: usize| !wish.target[i].is_nan();
        let chosen = (0..m).filter(|i| wish.given[*i].is_nan()).count();
        let held = (0..p).filter(|i| set(*i)).count() <= chosen;
        // an output with a target has a weight, where limits decide between them
        let least = (0..p).map(|i| weights[i * p + i] * self.unit[i].powi(2)).fold(0.0, f64::max) * SMALL;
        let weight = |i: usize, j: usize| match (set(i) && set(j), i == j) {
            (false, _) => 0.0,
            (true, true) => (weights[i * p + j] * self.unit[i].powi(2)).max(if least > 0.0 { least } else { 1.0 }),
            (true, false) => weights[i * p + j] * self.unit[i] * self.unit[j],
        };
        let root = |of: Matrix| -> Result<Matrix> {
            let eigen = of.self_adjoint_eigen(Side::Lower).map_err(lost)?;
            let values = eigen.S().column_vector();
            Ok(Mat::from_fn(p, p, |i, j| values[i].max(0.0).sqrt() * eigen.U()[(j, i)]))
        };
        let side = |of: &[f64], i: usize| of[i] / self.unit[p + i];
        let given = (0..m).filter(|i| !wish.given[*i].is_nan());
        let mut active = try_collect(WHAT, given.map(|i| (i, side(wish.given, i))))?;
        let fixed = active.len();
        let limits =
            Within { fixed, sides: [0, 1].map(|at| Mat::from_fn(m, 1, |i, _| side([wish.low, wish.high][at], i))) };
        // all are held: no weight decides, unless a limit is in the way
        let goal = Goal {
            set: Mat::from_fn(p, p, |i, j| f64::from(u8::from(i == j && set(i)))),
            cut: if held && !(0..p).all(set) { FLAT } else { RANK },
            goal: Mat::from_fn(p, 1, |i, _| if set(i) { wish.target[i] / self.unit[i] } else { 0.0 }),
            now: Mat::from_fn(p, 1, |i, _| wish.now[i] / self.unit[i]),
        };
        let mut near = self.nearest(&goal.set, &goal, &active)?;
        if !held || limits.worst(&near.v, p, &active).is_some() {
            near = self.settled(&root(Mat::from_fn(p, p, weight))?, &goal, &limits, &mut active)?;
        }
        let sizes = self.row_sizes()?;
        let whole = stacked(&self.in_rows(&sizes), &near.rows);
        if whole.nrows() != k {
            return Err(Error::Numerical("no point of rest is within the limits of the inputs".into()));
        }
        let whole = whole.partial_piv_lu().inverse();
        if !(0..k).all(|i| (0..k).all(|j| whole[(i, j)].is_finite())) {
            return Err(Error::Numerical("a set point is not determined".into()));
        }
        let of_bias = Mat::from_fn(k, p, |i, j| whole[(i, j)] / sizes[j] * self.unit[i]);
        let of_rows = Mat::from_fn(k, m, |i, j| whole[(i, p + j)] * self.unit[i]);
        let reference = Mat::from_fn(p, 1, |i, _| if set(i) { wish.target[i] } else { 0.0 });
        let of_target = &of_rows * &near.per_target;
        let free = m - active.len();
        let of_given = Mat::from_fn(k, m, |i, j| {
            let at = active[..fixed].iter().position(|(input, _)| *input == j);
            at.map_or(0.0, |at| of_rows[(i, free + at)] / self.unit[p + j])
        });
        let mut place = &of_bias * &self.c + &of_target * reference + &of_rows * &near.values;
        for (i, end) in &active {
            place[(p + i, 0)] = end * self.unit[p + i];
        }
        let largest = (0..p).map(|j| (0..k).map(|i| (whole[(i, j)]).abs()).fold(0.0, f64::max)).fold(0.0, f64::max);
        let moves = |i: usize| (0..p).any(|j| whole[(i, j)].abs() > RANK * largest);
        Ok(SetPoint {
            place: listed(&place)?,
            of_bias: listed(&of_bias)?,
            of_target: listed(&of_target)?,
            of_given: listed(&of_given)?,
            at_limit: try_collect(WHAT, active[fixed..].iter().map(|(i, _)| *i))?,
            exact: try_collect(WHAT, (0..p).map(|i| !moves(i)))?,
        })
    }

    /// The nearest point within the limits, and those that hold it: one limit more where one is broken, one less where
    /// the distance falls away from it; where that goes round in a circle the best of all their sets.
    fn settled(&self, root: &Matrix, goal: &Goal, limits: &Within, active: &mut Vec<(usize, f64)>) -> Result<Nearest> {
        let (p, m) = self.sizes();
        let mut near = self.nearest(root, goal, active)?;
        for _ in 0..4 * m + 4 {
            if let Some(new) = limits.worst(&near.v, p, active) {
                try_push(WHAT, active, new)?;
            } else if let Some(at) = self.to_release(root, goal, &near, active, limits)? {
                active.remove(at);
            } else {
                return Ok(near);
            }
            near = self.nearest(root, goal, active)?;
        }
        let chosen = try_collect(WHAT, (0..m).filter(|i| active[..limits.fixed].iter().all(|(held, _)| held != i)))?;
        let distance = |near: &Nearest| (root * (near.v.subrows(0, p) - &goal.goal)).norm_l2();
        let mut best: Option<(Nearest, Vec<(usize, f64)>)> = None;
        for code in 0..3_usize.pow(chosen.len().min(ENUMERATED) as u32) {
            let ends = |at: usize| [f64::NAN, limits.sides[0][(chosen[at], 0)], limits.sides[1][(chosen[at], 0)]];
            let held =
                (0..chosen.len().min(ENUMERATED)).map(|at| (chosen[at], ends(at)[code / 3_usize.pow(at as u32) % 3]));
            let mut tried = try_collect(WHAT, active[..limits.fixed].iter().copied())?;
            try_extend(WHAT, &mut tried, held.filter(|(_, end)| !end.is_nan()))?;
            if tried.iter().any(|(_, end)| end.is_infinite()) {
                continue;
            }
            let found = self.nearest(root, goal, &tried)?;
            let nearer = best.as_ref().is_none_or(|(best, _)| distance(&found) < distance(best));
            if nearer && limits.worst(&found.v, p, &tried).is_none() {
                best = Some((found, tried));
            }
        }
        let lost = || Error::Numerical("no nearest point of rest was found within the limits of the inputs".into());
        let (near, held) = best.ok_or_else(lost)?;
        *active = held;
        Ok(near)
    }

    /// The place of an active limit along which the distance falls away from it.
    fn to_release(
        &self,
        root: &Matrix,
        goal: &Goal,
        near: &Nearest,
        active: &[(usize, f64)],
        limits: &Within,
    ) -> Result<Option<usize>> {
        let (p, k) = (self.sizes().0, self.unit.len());
        if active.len() == limits.fixed {
            return Ok(None);
        }
        let off = root.transpose() * (root * (near.v.subrows(0, p) - &goal.goal));
        let slope = Mat::from_fn(k, 1, |j, _| if j < p { off[(j, 0)] } else { 0.0 });
        let units = Mat::from_fn(active.len(), k, |i, j| f64::from(u8::from(j == p + active[i].0)));
        let across = stacked(&self.in_rows(&self.row_sizes()?), &units).transpose().to_owned();
        let found = parts(&across)?;
        let along = found.solve(&slope, found.rank(RANK * found.s[0]));
        Ok((limits.fixed..active.len()).find(|at| {
            let ((i, end), s) = (active[*at], along[(p + at, 0)]);
            let [low, high] = [0, 1].map(|side| limits.sides[side][(i, 0)]);
            low < high && if end <= low { s < -RANK } else { s > RANK }
        }))
    }

    /// Where the windows of all systems of a region rest that keep the held rows of a set point, `e = 0`.
    ///
    /// `Theta = H + D G W` with `||G|| <= 1`: with `a = W z_s`, `B = W N T_e D` and `||B|| < 1` they are
    /// `(y, u)_s + T_e D q` for
    ///
    /// ```text
    /// (q - q_c)'(I - B'B)(q - q_c) <= ||a||^2 + a'B q_c,    q_c = (I - B'B)^-1 B'a
    /// ```
    ///
    /// None where the region is of several parts, or does not determine the point, or `||B|| >= 1`: one of them may
    /// have no such point of rest.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`].
    pub fn spread(&self, point: &SetPoint, region: &Region) -> Result<Option<Spread>> {
        let ((p, m), d) = (self.sizes(), self.along.nrows());
        let whole = |part: &Part| part.rows.len() == p && part.columns.len() == d && part.missing.is_empty();
        let [part] = region.parts() else { return Ok(None) };
        if region.width() != d || !whole(part) || !part.radius().is_finite() || point.place.len() != p + m {
            return Ok(None);
        }
        covered(WHAT, self.bytes() + 64 * (d as u128).pow(2), || {
            let white = MatRef::from_row_major_slice(&part.white, part.rank(), d);
            // D in units in which the diagonal of S is 1, so that no output is lost beside others
            let deviation = |i: usize| part.deviations()[i];
            let unit = |i: usize| if deviation(i) > 0.0 { deviation(i) } else { 1.0 };
            let eigen = Mat::from_fn(p, p, |i, j| part.factor * part.shape[i * p + j] / unit(i) / unit(j));
            let eigen = eigen.self_adjoint_eigen(Side::Lower).map_err(lost)?;
            let size = |j: usize| (eigen.S().column_vector()[j].max(0.0) + p as f64 * 1e-14).sqrt();
            let root = Mat::from_fn(p, p, |i, j| unit(i) * eigen.U()[(i, j)] * size(j));
            let reach = MatRef::from_row_major_slice(&point.of_bias, p + m, p) * root;
            let place = MatRef::from_row_major_slice(&point.place, p + m, 1);
            // z_s, the 1 of the intercept included
            let mut z = &self.along * place;
            if self.window.intercept() {
                z[(d - 1, 0)] = 1.0;
            }
            let (a, b) = (white * z, white * &self.along * &reach);
            let room = Matrix::identity(p, p) - b.transpose() * &b;
            let norm = parts(&b)?.s.first().copied().unwrap_or(0.0);
            if norm >= 1.0 || norm.is_nan() {
                return Ok(None);
            }
            let lu = room.partial_piv_lu();
            let middle = lu.solve(b.transpose() * &a);
            let square = (a.transpose() * &a)[(0, 0)] + (a.transpose() * &b * &middle)[(0, 0)];
            let (shift, each) = (&reach * &middle, lu.solve(reach.transpose()));
            let half = |i: usize| {
                let row = (0..p).map(|j| reach[(i, j)] * each[(j, i)]).sum::<f64>();
                (1.0 + 1e-9) * (square.max(0.0) * row.max(0.0)).sqrt()
            };
            Ok(Some(Spread { shift: listed(&shift)?, half: try_collect(WHAT, (0..p + m).map(half))?, norm }))
        })?
    }

    /// The least f(u) within the limits, and the size of its terms: some system of one part of the region rests at
    /// `y = target` under u iff `f(u) <= 0`; the largest of all parts; -inf where it is not known, or not convex.
    ///
    /// With `z = z_0 + z_1 u` and `H z - y = l_0 + l_1 u` the equation `(Theta - H) z = y - H z` has a solution
    /// `Theta = H + D G W`, `||G|| <= 1`, exactly where
    ///
    /// ```text
    /// f(u) = ||D^-1 (l_0 + l_1 u)||^2 - ||W (z_0 + z_1 u)||^2 <= 0
    /// ```
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn lacking(
        &self,
        region: &Region,
        target: &[f64],
        low: &[f64],
        high: &[f64],
        stop: &Stop,
    ) -> Result<(f64, f64)> {
        let ((p, m), d) = (self.sizes(), self.along.nrows());
        if target.len() != p || low.len() != m || high.len() != m || region.width() != d {
            let (expected, found) = (format!("{p} outputs and {m} inputs"), target.len().to_string());
            return Err(Error::Shape { name: "target", expected, found });
        }
        let mut largest = (f64::NEG_INFINITY, 1.0);
        for part in region.parts() {
            let found = covered(WHAT, self.bytes() + 64 * (d as u128).pow(2), || {
                self.lacking_in(part, target, (low, high), stop)
            })??;
            if let Some((least, size)) = found.filter(|(least, size)| *least > largest.0 * size / largest.1) {
                largest = (least, size);
            }
        }
        Ok(largest)
    }

    fn lacking_in(
        &self,
        part: &Part,
        target: &[f64],
        (low, high): (&[f64], &[f64]),
        stop: &Stop,
    ) -> Result<Option<(f64, f64)>> {
        let ((p, m), d, rows, cols) = (self.sizes(), self.along.nrows(), part.rows.len(), part.columns.len());
        let shape = Mat::from_fn(rows, rows, |i, j| part.factor * part.shape[i * rows + j]);
        let finite = (0..rows).all(|i| (0..rows).all(|j| shape[(i, j)].is_finite()));
        if !finite || !part.missing.is_empty() {
            return Ok(None);
        }
        let Ok(root) = shape.llt(Side::Lower) else { return Ok(None) };
        let last = |i: usize| if self.window.intercept() && i == d - 1 { 1.0 } else { 0.0 };
        let start = Mat::from_fn(d, 1, |i, _| (0..p).map(|j| self.along[(i, j)] * target[j]).sum::<f64>() + last(i));
        // l_0 = c - M (r, 0) with the sign of H z - r; l_1 = -M_u, in the units of the inputs
        let place = Mat::from_fn(p + m, 1, |i, _| if i < p { target[i] } else { 0.0 });
        let off = &self.c - &self.m * place;
        let mut a = Mat::from_fn(rows, 1, |i, _| off[(part.rows[i], 0)]);
        let mut b = Mat::from_fn(rows, m, |i, j| -self.m[(part.rows[i], p + j)] * self.unit[p + j]);
        [&mut a, &mut b].into_iter().for_each(|of| whiten(root.L(), of.as_mut()));
        let white = MatRef::from_row_major_slice(&part.white, part.rank(), cols);
        let e = white * Mat::from_fn(cols, 1, |i, _| start[(part.columns[i], 0)]);
        let f = white * Mat::from_fn(cols, m, |i, j| self.along[(part.columns[i], p + j)] * self.unit[p + j]);
        let curve = b.transpose() * &b - f.transpose() * &f;
        let slope = b.transpose() * &a - f.transpose() * &e;
        let total: f64 = (0..m).map(|j| b.col(j).squared_norm_l2()).sum();
        let values = curve.self_adjoint_eigenvalues(Side::Lower).map_err(lost)?;
        if !values.first().is_some_and(|least| *least > RANK * total) {
            return Ok(None); // the data do not determine what constant inputs do
        }
        let half = curve.llt(Side::Lower).map_err(lost)?;
        let mut goal = -&slope;
        whiten(half.L(), goal.as_mut());
        let goal = listed(&goal)?;
        let half = listed(&half.L().transpose().to_owned())?;
        let within = |side: &[f64]| try_collect(WHAT, (0..m).map(|j| side[j] / self.unit[p + j]));
        let (low, high) = (within(low)?, within(high)?);
        let (none, bounds) = (try_zeros(WHAT, m)?, Bounds::new(&low, &high, m)?);
        let u = box_control(&half, &goal, Penalty::Diagonal(&none), bounds, None, Until::new(stop, None))?.control;
        let u = Mat::from_fn(m, 1, |j, _| u[j]);
        let scalar = |x: Matrix| x[(0, 0)];
        let own = scalar(a.transpose() * &a);
        let other = scalar(e.transpose() * &e);
        let moved = scalar(u.transpose() * &curve * &u) + 2.0 * scalar(slope.transpose() * &u);
        Ok(Some((moved + own - other, own + other)))
    }

    /// Memory for [`Self::moving`].
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn moved(&self) -> Result<Moved> {
        let ((p, m), zeros) = (self.sizes(), |len| try_zeros(WHAT, len));
        Ok(Moved { x: zeros(self.window.states())?, place: zeros(p + m)?, slopes: zeros(p + m)?, bias: zeros(p)? })
    }

    /// The state of the window and the input while the target is `step` away and moves by `slope` a step (p, 0 where
    /// free), given inputs are `given` away (m), and a constant e acts: exact for the model on constants and ramps.
    /// Nothing is allocated.
    ///
    /// `(y, u) = T_e (c + e + H Z s - y') + T_r r`, `x = X (y, u) + Z_x s` with `s = (y', u') = T_r r'`.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn moving(
        &self,
        point: &SetPoint,
        bias: &[f64],
        [step, slope]: [&[f64]; 2],
        given: &[f64],
        to: &mut Moved,
    ) -> Result<()> {
        let ((p, m), k) = (self.sizes(), self.unit.len());
        let sizes = [point.place.len() == k, bias.len() == p, step.len() == p, slope.len() == p, given.len() == m];
        if sizes.contains(&false) || to.place.len() != k || to.x.len() != self.window.states() {
            let (expected, found) = (format!("{p} outputs"), bias.len().to_string());
            return Err(Error::Shape { name: "target", expected, found });
        }
        let Moved { x, place, slopes, bias: all } = to;
        let of = |rows: &[f64], i: usize, by: &[f64]| (0..p).map(|j| rows[i * p + j] * by[j]).sum::<f64>();
        slopes.iter_mut().enumerate().for_each(|(i, to)| *to = of(&point.of_target, i, slope));
        for (i, to) in all.iter_mut().enumerate() {
            *to = bias[i] + ((0..k).map(|j| self.ahead[(i, j)] * slopes[j]).sum::<f64>() - slopes[i]);
        }
        for (i, to) in place.iter_mut().enumerate() {
            let apart = (0..m).map(|j| point.of_given[i * m + j] * given[j]).sum::<f64>();
            *to = point.place[i] + of(&point.of_bias, i, all) + of(&point.of_target, i, step) + apart;
        }
        for (i, to) in x.iter_mut().enumerate() {
            *to = (0..k).map(|j| self.states[(i, j)] * place[j] + self.ramp[(i, j)] * slopes[j]).sum();
        }
        Ok(())
    }
}

/// What [`SetPoints::moving`] has found, and its memory.
#[derive(Debug)]
pub struct Moved {
    /// The state of the window (n).
    pub x: Vec<f64>,
    /// Outputs and inputs (p + m).
    pub place: Vec<f64>,
    slopes: Vec<f64>,
    bias: Vec<f64>,
}

/// A gain K (m, n), what is added to its input, and the limits of that: of the change in one step, low and high (m).
#[derive(Debug)]
pub struct Policy<'a> {
    /// K.
    pub gain: &'a [f64],
    /// What is added.
    pub more: &'a [f64],
    /// Most of the change.
    pub rate: &'a [f64],
    /// The least input.
    pub low: &'a [f64],
    /// The largest one.
    pub high: &'a [f64],
}

impl Policy<'_> {
    /// `u = us + K (x - xs) + more`, at most `rate` from `acted`, within the limits; false where it overflows. Nothing
    /// is allocated.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn input(&self, x: &[f64], (xs, us): (&[f64], &[f64]), acted: &[f64], u: &mut [f64]) -> Result<bool> {
        let (n, m) = (xs.len(), us.len());
        let sizes = [self.more, self.rate, self.low, self.high, acted, u].map(<[f64]>::len);
        if x.len() != n || self.gain.len() != m * n || sizes != [m; 6] {
            return Err(Error::Shape { name: "x", expected: format!("{n} states"), found: x.len().to_string() });
        }
        for (i, u) in u.iter_mut().enumerate() {
            *u = (0..n).map(|j| self.gain[i * n + j] * (x[j] - xs[j])).sum::<f64>() + us[i] + self.more[i];
        }
        if !u.iter().all(|v| v.is_finite()) {
            return Ok(false);
        }
        for (i, u) in u.iter_mut().enumerate() {
            *u = u.max(acted[i] - self.rate[i]).min(acted[i] + self.rate[i]).max(self.low[i]).min(self.high[i]);
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::region::tests::round;
    use crate::window::Kind;

    const INF: f64 = f64::INFINITY;

    fn close(a: &[f64], b: &[f64], tol: f64) {
        assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tol), "{a:?} {b:?}");
    }

    #[test]
    fn the_nearest_and_the_held_point_of_two_outputs() {
        let window = Window::new(2, 1, Kind::Lags(1), 0, false, 0).unwrap();
        let points = SetPoints::new(window, &[[0.9, 0.02, 0.1], [0.3, 0.6, 0.05]], &[1.0; 3]).unwrap();
        assert!(points.can_be_held().unwrap());
        close(&points.of_inputs().unwrap(), &[0.1, 0.05], 1e-15);
        let free = SetPointTask {
            target: &[1.0, 2.0],
            weights: (&[[1.0, 0.0], [0.0, 0.25]]).into(),
            now: &[0.0; 2],
            low: &[-INF],
            high: &[INF],
            given: &[f64::NAN],
        };
        let near = points.at(&free).unwrap();
        close(&near.place, &[1.206944269719, 1.030318279029, 1.000880613914], 1e-11);
        assert_eq!(near.exact, [false, false]);
        let held = points.at(&SetPointTask { target: &[f64::NAN, 2.0], ..free }).unwrap();
        close(&held.place, &[2.342857142857, 2.0, 1.942857142857], 1e-11);
        assert_eq!(held.exact, [false, true]);
        let cut = points.at(&SetPointTask { high: &[0.5], ..free }).unwrap();
        assert_eq!((cut.at_limit.as_slice(), cut.place[2]), ([0].as_slice(), 0.5));
        let mut moved = points.moved().unwrap();
        points.moving(&held, &[0.0; 2], [&[0.0; 2], &[0.0, 0.01]], &[0.0], &mut moved).unwrap();
        close(&[moved.x[0], moved.x[1], moved.place[2]], &[2.354693877551, 2.0, 2.071836734694], 1e-11);
        let wrong = [
            (SetPointTask { target: &[1.0], ..free }, "`target` must have 2 entries, got 1"),
            (SetPointTask { given: &[1.0; 2], ..free }, "`given` must have 1 entries, got 2"),
            (SetPointTask { weights: (&[[1.0; 4]]).into(), ..free }, "`weights` must have 2 x 2 entries, got 1 x 4"),
        ];
        for (wish, why) in wrong {
            assert_eq!(points.at(&wish).unwrap_err().to_string(), why);
        }
        let turned = SetPoints::new(window, &[[0.9, 0.3], [0.02, 0.6], [0.1, 0.05]], &[1.0; 3]);
        assert_eq!(turned.unwrap_err().to_string(), "`theta` must have 2 x 3 entries, got 3 x 2");
        assert!(SetPoints::new(window, &[[0.9, 0.02, 0.1], [0.3, 0.6, 0.05]], &[0.0; 3]).is_err());
    }

    #[test]
    fn an_output_that_integrates_and_is_free_stays() {
        // y1+ = .5 y1 + u, y2+ = y2 + u: held at y1 = 0 the second one is anywhere
        let window = Window::new(2, 1, Kind::Lags(1), 0, false, 0).unwrap();
        let points = SetPoints::new(window, &[[0.5, 0.0, 1.0], [0.0, 1.0, 1.0]], &[1.0; 3]).unwrap();
        let wish = SetPointTask {
            target: &[0.0, f64::NAN],
            weights: (&[[1.0, 0.0], [0.0, 1.0]]).into(),
            now: &[5.0, 7.0],
            low: &[-1.0],
            high: &[1.0],
            given: &[f64::NAN],
        };
        close(&points.at(&wish).unwrap().place, &[0.0, 7.0, 0.0], 1e-12);
    }

    #[test]
    fn all_sizes_are_within_the_memory_that_was_asked_for() {
        for (p, m, count, pole) in [(1, 1, 1, None), (3, 2, 4, None), (2, 3, 6, Some(0.7)), (6, 5, 12, None)] {
            let kind = Kind::of(pole, count);
            let window = Window::new(p, m, kind, 2, true, 3).unwrap();
            let d = window.length();
            let theta: Vec<f64> = (0..p * d).map(|at| 0.3 * ((at * at + 1) as f64).sin() / count as f64).collect();
            let points = SetPoints::new(window, MatrixView::of(&theta, d), &vec![1.0; p + m]).unwrap();
            let mut target = vec![f64::NAN; p];
            target[..p.min(m)].fill(0.1);
            let eye: Vec<_> = (0..p * p).map(|at| f64::from(u8::from(at % (p + 1) == 0))).collect();
            let (low, high, given) = (vec![-0.5; m], vec![0.5; m], vec![f64::NAN; m]);
            let (weights, now) = (MatrixView::of(&eye, p), vec![0.0; p]);
            let wish = SetPointTask { target: &target, weights, now: &now, low: &low, high: &high, given: &given };
            let point = points.at(&wish).unwrap();
            let part = round(&Vec::from_iter(0..p), &Vec::from_iter(0..d), 1e-8);
            let region = Region::new(MatrixView::of(&theta, d), d - p - 1, vec![part], None, false).unwrap();
            let spread = points.spread(&point, &region).unwrap().unwrap();
            assert!(spread.norm < 1.0 && spread.half.iter().all(|half| half.is_finite()));
            let (least, size) = points.lacking(&region, &now, &low, &high, &Stop::new()).unwrap();
            assert!(least <= size);
            assert_eq!(points.states_of_bias(&point).unwrap().len(), window.states() * p);
        }
    }
}
