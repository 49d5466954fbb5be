//! A loop from readings, step by step: which of them are taken for true, what is known of the window, and of a
//! disturbance.

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};

use crate::error::{Error, Result, require_finite, sized};
use crate::identify::{chi2_upper, whiten};
use crate::matrix::MatrixView;
use crate::memory::{
    covered, room_for_products, try_collect, try_collect_all, try_copy, try_filled, try_room, try_zeros,
};
use crate::vector::dot;
use crate::window::{Contents, Filter, Workspace};

use super::{Part, Region};

mod tables;

const WHAT: &str = "a loop from readings";
/// Rejected readings in a row, or alike with few others between them, behind which the next rejected one is taken for
/// true.
const BELIEVED: f64 = 3.0;
/// So many accepted readings take one off the number of those that were alike.
const FORGOTTEN: f64 = 3.0;
/// A window without the first of the rejected readings is the true one where it predicts so much better.
const BETTER: f64 = 0.5;
/// Relative: inputs that hold a capped bias are at their limits to rounding.
const CAPPED: f64 = 1e-9;
/// Of the excess of a window: what it holds says nothing.
const USELESS: f64 = 1e12;
/// Of the deviation of the noise: a walk of every output beside those that inputs can make.
const EVERY: f64 = 0.01;

/// A reading y is rejected if it is too far from what was predicted, p, for every system.
///
/// ```text
/// ||T (y - p)|| > q + ||T D|| ||W z||,    T = (Sb + P)^(-1/2),    q^2 an upper quantile of chi2
/// ```
///
/// `y - C z = D G W z + w` with `||G|| <= 1` for all systems of the region, and `||T w|| <= ||Sigma^(-1/2) w||` as
/// `Sb >= Sigma`. So a true reading behind a window of true ones is rejected with at most the probability of the
/// quantile in the event of the region, whatever was planned; P is what an uncertain window adds.
#[derive(Debug, Clone)]
pub struct Gate {
    centre: Vec<f64>,
    parts: Vec<Arc<Part>>,
    /// `D D'` of each part.
    shapes: Vec<Mat<f64>>,
    noise: Mat<f64>,
    /// q for so many readings.
    quantiles: Vec<f64>,
    /// Of all readings behind a known window.
    usual: White,
}

/// `T` and `||T D||` of each part, of some readings, with memory to compute them.
#[derive(Debug, Clone)]
struct White {
    back: Mat<f64>,
    sizes: Vec<f64>,
    seen: Vec<usize>,
    root: Mat<f64>,
    half: Mat<f64>,
    small: Workspace,
}

impl White {
    fn new(p: usize, parts: usize) -> Result<Self> {
        covered(WHAT, 256 * (p as u128 + 16).pow(2), || {
            let [back, root, half] = [(); 3].map(|()| Mat::zeros(p, p));
            let (small, seen) = (Workspace::new(p, p)?, try_collect(WHAT, 0..p)?);
            Ok(Self { back, sizes: try_zeros(WHAT, parts)?, seen, root, half, small })
        })?
    }

    /// Those of the readings `seen`; false where the covariance is not positive definite.
    fn set(&mut self, noise: &Mat<f64>, more: Option<&Mat<f64>>, shapes: &[Mat<f64>]) -> bool {
        let Self { back, sizes, seen, root, half, small } = self;
        let p = seen.len();
        let [mut root, mut half] = [root, half].map(|of| of.submatrix_mut(0, 0, p, p));
        let all = || (0..p).flat_map(|i| (0..p).map(move |j| (i, j)));
        for (i, j) in all() {
            let at = (seen[i], seen[j]);
            root[(i, j)] = noise[at] + more.map_or(0.0, |more| more[at]);
        }
        if !small.factored(root.as_mut()) {
            return false;
        }
        let mut back = back.submatrix_mut(0, 0, p, p);
        back.fill(0.0);
        back.as_mut().diagonal_mut().fill(1.0);
        whiten(root.as_ref(), back.as_mut());
        for (size, shape) in sizes.iter_mut().zip(shapes) {
            all().for_each(|(i, j)| root[(i, j)] = shape[(seen[i], seen[j])]);
            matmul(half.as_mut(), Accum::Replace, back.as_ref(), root.as_ref(), 1.0, Par::Seq);
            matmul(root.as_mut(), Accum::Replace, half.as_ref(), back.as_ref().transpose(), 1.0, Par::Seq);
            let Some(largest) = small.largest(root.as_ref()) else { return false };
            *size = largest.max(0.0).sqrt();
        }
        true
    }
}

impl Gate {
    /// None where no bound of the noise of all readings is known, or the region is unbounded.
    ///
    /// # Errors
    /// [`Error::Value`], [`Error::Memory`].
    pub fn new(region: &Region, false_alarm: f64) -> Result<Option<Self>> {
        let p = region.n;
        let known = region.noise().filter(|noise| noise.iter().all(|v| v.is_finite()));
        let Some(noise) = known.filter(|_| region.radius().is_finite()) else { return Ok(None) };
        let quantile = |count| if count == 0 { Ok(0.0) } else { Ok(chi2_upper(false_alarm, count as f64)?.sqrt()) };
        let quantiles = try_collect_all(WHAT, (0..=p).map(quantile))?;
        let (centre, parts) = (try_copy(WHAT, region.centre())?, try_collect(WHAT, region.parts().iter().cloned())?);
        room_for_products()?;
        let mut usual = White::new(p, parts.len())?;
        covered(WHAT, 256 * (p as u128 + 16).pow(2) * (region.parts().len() as u128 + 4), || {
            let shape = |part: &Arc<Part>| {
                let (of, mut shape) = (part.of(), Mat::zeros(p, p));
                for (i, row) in of.rows.iter().zip(part.shape.chunks_exact(of.rows.len())) {
                    of.rows.iter().zip(row).for_each(|(j, v)| shape[(*i, *j)] = v * of.factor);
                }
                shape
            };
            let shapes = try_collect(WHAT, parts.iter().map(shape))?;
            let noise = MatRef::from_row_major_slice(noise, p, p).to_owned();
            let sound = usual.set(&noise, None, &shapes);
            Ok(sound.then_some(Self { centre, parts, shapes, noise, quantiles, usual }))
        })?
    }

    /// `(||T off|| - ||T D|| ||W z||) / q` of the components `seen`; above 1 it rejects. Of the system of the model
    /// alone: `||T off|| / q`.
    fn excess(
        &self,
        off: &[f64],
        z: &[f64],
        seen: &[bool],
        (more, alone): (Option<&Mat<f64>>, bool),
        white: &mut White,
    ) -> f64 {
        white.seen.clear();
        white.seen.extend((0..off.len()).filter(|i| seen[*i]));
        let usual = more.is_none() && white.seen.len() == off.len();
        if !usual && !white.set(&self.noise, more, &self.shapes) {
            return 0.0; // the covariance of what is not known overflows
        }
        let White { back, sizes, seen, .. } = if usual { &self.usual } else { white };
        let along = |i: usize| (0..=i).map(|j| back[(i, j)] * off[seen[j]]).sum::<f64>();
        let far = (0..seen.len()).map(|i| along(i).powi(2)).sum::<f64>().sqrt();
        let room = self.parts.iter().zip(sizes).map(|(part, size)| size * part.length(z));
        let room = if alone { 0.0 } else { room.sum::<f64>() };
        (far - room) / self.quantiles[seen.len()]
    }

    /// The excess of readings off by `off` behind a known window.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn excess_of(&self, off: &[f64], z: &[f64], seen: &[bool]) -> Result<f64> {
        let (p, d) = (self.noise.nrows(), self.centre.len() / self.noise.nrows());
        if off.len() != p || seen.len() != p || z.len() != d || !seen.contains(&true) {
            let (expected, found) = (format!("{p} entries, and {d} of z"), off.len().to_string());
            return Err(Error::Shape { name: "off", expected, found });
        }
        room_for_products()?;
        Ok(self.excess(off, z, seen, (None, false), &mut White::new(p, self.parts.len())?))
    }
}

/// A constant e in `y+ = Theta z + e`, and what is learned of it from what was not predicted:
/// `e+ = e + L (y - Theta z - e)`.
#[derive(Debug)]
pub struct Bias {
    /// L (p, p); 0 where none is learned.
    pub gain: Vec<f64>,
    /// The covariance of what is not known of it (p, p).
    pub spread: Vec<f64>,
    /// The covariance of the noise (p, p).
    pub noise: Vec<f64>,
}

/// The inputs that hold the set point, `us + T_e e`, and their limits.
#[derive(Debug)]
pub struct Aim {
    /// `T_e` (m, p).
    pub of_bias: Vec<f64>,
    /// `us`, and the limits low and high (m).
    pub limits: [Vec<f64>; 3],
}

impl Bias {
    /// The steady Kalman gain for random walks of steps `Q = B diag(drift^2) B' + EVERY^2 Sigma`, `B` (p, m) what
    /// inputs add to the next reading.
    ///
    /// In units in which `Sigma = I` and `Q = U diag(q) U'`: `p = (q + sqrt(q^2 + 4 q)) / 2`,
    /// `L = U diag(p / (p + 1)) U'`, `P = U diag(p) U'`. As L is invertible, a loop at rest holds its set point
    /// whatever constants act.
    ///
    /// # Errors
    /// [`Error::Numerical`] for a Sigma that is not positive definite, [`Error::Memory`].
    pub fn learned<'a>(
        of_inputs: impl Into<MatrixView<'a>>,
        drift: &[f64],
        noise: impl Into<MatrixView<'a>>,
    ) -> Result<Self> {
        let (m, of_inputs, noise) = (drift.len(), of_inputs.into(), noise.into());
        let p = noise.shape().0;
        let (of_inputs, noise) = (of_inputs.sized("of_inputs", p, m)?, noise.sized("noise", p, p)?);
        room_for_products()?;
        covered(WHAT, 1024 * (p as u128 + m as u128 + 16).pow(2), || {
            let lost =
                |_| Error::Numerical("the covariance of the noise of the readings is not positive definite".into());
            let sigma = MatRef::from_row_major_slice(&noise, p, p);
            let root = sigma.llt(Side::Lower).map_err(lost)?.L().to_owned();
            let mut back = Mat::identity(p, p);
            whiten(root.as_ref(), back.as_mut());
            let walk = &back * Mat::from_fn(p, m, |i, j| of_inputs[i * m + j] * drift[j]);
            let walk = &walk * walk.transpose() + Mat::from_fn(p, p, |i, j| if i == j { EVERY * EVERY } else { 0.0 });
            let eigen = walk.self_adjoint_eigen(Side::Lower);
            let eigen = eigen.map_err(|_| Error::Numerical("a random walk has no eigenvalues".into()))?;
            let known = |j: usize| {
                let q = eigen.S().column_vector()[j].max(0.0);
                0.5 * (q + (q * q + 4.0 * q).sqrt())
            };
            let along =
                |of: &dyn Fn(f64) -> f64| eigen.U() * Mat::from_fn(p, p, |i, j| of(known(i)) * eigen.U()[(j, i)]);
            let gain = &root * along(&|p| p / (p + 1.0)) * &back;
            let spread = &root * along(&|p| p) * root.transpose();
            let listed = |a: Mat<f64>| try_collect(WHAT, (0..p * p).map(|at| a[(at / p, at % p)]));
            Ok(Self { gain: listed(gain)?, spread: listed(spread)?, noise: try_copy(WHAT, &noise)? })
        })?
    }
}

/// What a step found.
#[derive(Debug, Clone, Default)]
pub struct Step {
    /// What was predicted a step before; empty at the first one.
    pub predicted: Vec<f64>,
    /// The bias of the equation.
    pub bias: Vec<f64>,
    /// How far off the readings are, in widths of the gate: above 1 they were rejected.
    pub off: f64,
    /// Or, after as many in a row, taken for true.
    pub believed: bool,
    /// Whether the window holds no numbers that say anything.
    pub lost: bool,
    /// Whether the loop may run.
    pub runs: bool,
}

/// A window of readings with a gate, and what it would be with those that were rejected.
#[derive(Debug)]
pub struct Readings {
    filter: Filter,
    theta: Vec<f64>,
    gate: Option<Gate>,
    of: Bias,
    aim: Aim,
    max_missing: usize,
    /// The window, that with all that was rejected, and that with all but the first of it, which was then false.
    windows: [Contents; 3],
    doubt: Doubt,
    step: Step,
    room: Room,
}

const NOW: usize = 0;
const RAW: usize = 1;
const LATE: usize = 2;

/// Memory of a step, so that none asks for any.
#[derive(Debug)]
struct Room {
    white: White,
    seen: Vec<bool>,
    none: Vec<bool>,
    z: Vec<f64>,
    predicted: Vec<f64>,
    off: Vec<f64>,
    /// Of a bias that is capped: as it was asked for, the inputs at their limits, what is lacking there, and what moves
    /// it.
    asked: Vec<f64>,
    held: Vec<(usize, f64)>,
    lacking: Mat<f64>,
    square: Mat<f64>,
}

impl Room {
    fn new(filter: &Filter, parts: usize) -> Result<Self> {
        let (p, m) = (filter.window.outputs(), filter.window.inputs());
        let (signs, zeros) = (|| try_filled(WHAT, false, p), |len: usize| try_zeros(WHAT, len));
        let (white, seen, none, z) = (White::new(p, parts)?, signs()?, signs()?, zeros(filter.window.length())?);
        let (predicted, off, asked, held) = (zeros(p)?, zeros(p)?, zeros(p)?, try_room(WHAT, m)?);
        let of = || (Mat::zeros(p, 1), Mat::zeros(p, p));
        let (lacking, square) = covered(WHAT, 256 * (p as u128 + 16).pow(2), of)?;
        Ok(Self { white, seen, none, z, predicted, off, asked, held, lacking, square })
    }
}

/// Whether what is rejected is a change of the plant: a constant force can bring every second or third reading back to
/// what is predicted, so that none of the others come in a row, but they are off by the same.
#[derive(Debug)]
struct Doubt {
    /// Rejected in a row.
    row: f64,
    /// `FORGOTTEN` times those that were rejected and off by the same, less the others between them.
    alike: f64,
    /// What the last rejected one was off by, in deviations of the noise (p).
    off: Vec<f64>,
}

impl Doubt {
    fn new(row: f64, alike: f64, off: &[f64], p: usize) -> Result<Self> {
        let mut room = try_room(WHAT, p)?;
        room.extend_from_slice(off);
        Ok(Self { row, alike, off: room })
    }

    fn clear(&mut self) {
        (self.row, self.alike) = (0.0, 0.0);
        self.off.clear();
    }

    const fn of_change(&self) -> bool {
        self.row >= BELIEVED || self.alike >= FORGOTTEN * BELIEVED
    }

    fn accept(&mut self) {
        (self.row, self.alike) = (0.0, (self.alike - 1.0).max(0.0));
    }

    /// Off by the same: within half of the larger one.
    fn reject(&mut self, off: &[f64]) {
        let size = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>();
        let apart = self.off.iter().zip(off).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let same = self.off.len() == off.len() && 4.0 * apart <= size(&self.off).max(size(off));
        let before = if same { self.alike } else { 0.0 };
        (self.row, self.alike) = (self.row + 1.0, (before + FORGOTTEN).min(2.0 * FORGOTTEN * BELIEVED));
        self.off.clear();
        self.off.extend_from_slice(off);
    }
}

impl Readings {
    /// An empty window of the model `theta` (p, d).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn new<'a>(
        filter: Filter,
        theta: impl Into<MatrixView<'a>>,
        gate: Option<Gate>,
        of: Bias,
        aim: Aim,
        max_missing: usize,
    ) -> Result<Self> {
        let p = filter.window.outputs();
        if [of.gain.len(), of.spread.len(), of.noise.len()] != [p * p; 3] {
            let (expected, found) = (format!("{p} x {p} entries, as the others"), of.gain.len().to_string());
            return Err(Error::Shape { name: "bias", expected, found });
        }
        let theta = try_copy(WHAT, &theta.into().sized("theta", p, filter.window.length())?)?;
        let none = Aim { of_bias: Vec::new(), limits: [const { Vec::new() }; 3] };
        let windows = [filter.empty()?, filter.empty()?, filter.empty()?];
        let room = Room::new(&filter, gate.as_ref().map_or(0, |gate| gate.parts.len()))?;
        let (bias, predicted) = (try_zeros(WHAT, p)?, try_room(WHAT, p)?);
        let (step, doubt) = (Step { bias, predicted, ..Step::default() }, Doubt::new(0.0, 0.0, &[], p)?);
        let mut made = Self { filter, theta, gate, of, aim: none, max_missing, windows, doubt, step, room };
        made.aim(aim)?;
        Ok(made)
    }

    /// Another set point.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn aim(&mut self, aim: Aim) -> Result<()> {
        let (p, m) = (self.filter.window.outputs(), self.filter.window.inputs());
        if aim.of_bias.len() != m * p || aim.limits.iter().any(|side| side.len() != m) {
            let (expected, found) = (format!("{m} x {p} entries"), aim.of_bias.len().to_string());
            return Err(Error::Shape { name: "limits", expected, found });
        }
        self.aim = aim;
        Ok(())
    }

    /// The bias nearest to this one, in the metric of the noise, that inputs within the limits hold the set point with:
    /// `e + Sigma T'(T Sigma T')^-1 (limit - us - T e)` over the rows T of `T_e` of the inputs that are beyond. Where
    /// that is more than can be met, as of two inputs for one output, the largest share of it that all limits allow.
    fn capped(&mut self) {
        let Room { white: White { small, .. }, asked, held, lacking, square, .. } = &mut self.room;
        let (aim, bias) = (&self.aim, &mut self.step.bias);
        let ([us, low, high], p) = (&aim.limits, bias.len());
        let of_input = |i: usize| &aim.of_bias[i * p..(i + 1) * p];
        let across = |j: usize, i: usize| dot(&self.of.noise[j * p..(j + 1) * p], of_input(i));
        // what is wanted of an input, and as far as its limits allow
        let allowed = |bias: &[f64], i: usize| {
            let wanted = dot(of_input(i), bias);
            let there = (us[i] + wanted).clamp(low[i], high[i]) - us[i];
            let beyond = (wanted - there).abs() > CAPPED * wanted.abs().max(us[i].abs());
            (wanted, there, beyond)
        };
        held.clear();
        for _ in 0..us.len() {
            let before = held.len();
            for i in 0..us.len() {
                let (_, there, beyond) = allowed(bias, i);
                if beyond && held[..before].iter().all(|(at, _)| *at != i) {
                    held.push((i, there));
                }
            }
            if before == 0 {
                asked.copy_from_slice(bias);
            }
            let count = held.len();
            if count == before || count > p {
                break;
            }
            let (mut square, mut lacking) = (square.submatrix_mut(0, 0, count, count), lacking.subrows_mut(0, count));
            for (i, (at, there)) in held.iter().enumerate() {
                for (j, (other, _)) in held.iter().enumerate() {
                    square[(i, j)] = of_input(*at).iter().enumerate().map(|(q, t)| t * across(q, *other)).sum();
                }
                lacking[(i, 0)] = there - dot(of_input(*at), bias);
            }
            small.solve(square, lacking.as_mut());
            let by =
                |j: usize| held.iter().enumerate().map(|(i, (at, _))| across(j, *at) * lacking[(i, 0)]).sum::<f64>();
            if (0..p).all(|i| by(i).is_finite()) {
                bias.iter_mut().enumerate().for_each(|(i, e)| *e += by(i));
            }
        }
        if held.is_empty() {
            return;
        }
        let share = |bias: &[f64]| {
            let each = (0..us.len()).map(|i| allowed(bias, i));
            each.map(|(wanted, there, beyond)| if beyond { there / wanted } else { 1.0 }).fold(1.0, f64::min).max(0.0)
        };
        if share(bias) < 1.0 {
            let part = share(asked);
            bias.iter_mut().zip(&*asked).for_each(|(e, asked)| *e = part * asked);
        }
    }

    /// The window, if it has begun.
    #[must_use]
    pub fn window(&self) -> Option<&Contents> {
        self.state_of(NOW)
    }

    fn state_of(&self, k: usize) -> Option<&Contents> {
        Some(&self.windows[k]).filter(|window| window.began())
    }

    /// The window, those with all that was rejected and with all but the first, and the doubt of the window: how many
    /// were rejected in a row, how many were alike, and what the last was off by.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn state(&self) -> Result<([Option<&Contents>; 3], Vec<f64>)> {
        let Doubt { row, alike, off } = &self.doubt;
        let doubt = try_collect(WHAT, [*row, *alike].into_iter().chain(off.iter().copied()))?;
        Ok(([NOW, RAW, LATE].map(|k| self.state_of(k)), doubt))
    }

    /// Go on from there, with the numbers of the windows, and the doubt.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn restore(&mut self, [now, raw, late]: [Option<&[f64]>; 3], doubt: &[f64]) -> Result<()> {
        let contents = |of: Option<&[f64]>| of.map_or_else(|| self.filter.empty(), |of| self.filter.restored(of));
        let p = self.filter.window.outputs();
        let doubt = match doubt {
            [] => Doubt::new(0.0, 0.0, &[], p)?,
            [row, alike, off @ ..] if [0, p].contains(&off.len()) && doubt.iter().all(|v| v.is_finite()) => {
                Doubt::new(*row, *alike, off, p)?
            }
            _ => {
                let (expected, found) = (format!("2 or {} numbers", p + 2), doubt.len().to_string());
                return Err(Error::Shape { name: "doubt", expected, found });
            }
        };
        (self.windows, self.doubt) = ([contents(now)?, contents(raw)?, contents(late)?], doubt);
        Ok(())
    }

    /// Go on from a window that is known.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn start(&mut self, x: &[f64]) -> Result<()> {
        self.windows[NOW] = self.filter.full(x)?;
        self.certain();
        Ok(())
    }

    /// Without doubt of the window.
    fn certain(&mut self) {
        (self.windows[RAW].calls, self.windows[LATE].calls) = (0, 0);
        self.doubt.clear();
    }

    /// How far off a reading is, in widths of the gate, with the bias or without it; of the system of the model
    /// `alone`, or of all.
    fn off(&mut self, k: usize, y: &[f64], shift: &[f64], alone: bool) -> f64 {
        let Self { filter, gate, of, windows, room: Room { white, seen, z, off, .. }, .. } = self;
        let Some(gate) = gate.as_ref().filter(|_| seen.contains(&true)) else { return 0.0 };
        for ((off, y), row) in off.iter_mut().zip(y).zip(gate.centre.chunks_exact(z.len())) {
            *off = y - dot(row, z);
        }
        let more = filter.unknown(&windows[k]);
        let found = gate.excess(off, z, seen, (Some(&*more).filter(|_| !windows[k].known), alone), white);
        // one that was capped to 0 is rounding
        let shifted = |(v, variance): (&f64, &f64)| v.abs() > CAPPED * variance.sqrt();
        if found > 1.0 && shift.iter().zip(of.noise.iter().step_by(y.len() + 1)).any(shifted) {
            *more += MatRef::from_row_major_slice(&of.spread, y.len(), y.len());
            off.iter_mut().zip(shift).for_each(|(off, shift)| *off -= shift);
            return found.min(gate.excess(off, z, seen, (Some(more), alone), white));
        }
        found
    }

    /// z of a window, and what is predicted behind it.
    fn predict(&mut self, k: usize, acted: &[f64], bias: &[f64]) {
        let Self { filter, theta, windows, room: Room { z, predicted, .. }, .. } = self;
        filter.window.regressors(&windows[k].x, acted, 1.0, z);
        for ((to, row), shift) in predicted.iter_mut().zip(theta.chunks_exact(z.len())).zip(bias) {
            *to = dot(row, z) + shift;
        }
    }

    /// Takes what was seen into a window, or nothing of it, behind [`Self::predict`].
    fn take(&mut self, k: usize, y: &[f64], acted: &[f64], rejected: bool) {
        let Room { seen, none, predicted, .. } = &self.room;
        self.filter.advance(&mut self.windows[k], y, acted, if rejected { none } else { seen }, predicted);
    }

    /// A window becomes another.
    fn copy(&mut self, to: usize, from: usize) {
        if let Ok([to, from]) = self.windows.get_disjoint_mut([to, from]) {
            to.copy(from);
        }
    }

    /// Take readings in, those with `seen` that are numbers, or what is predicted in their place, with the input that
    /// acted, the bias that was found last, and whether the loop has run. No call allocates, but for the first one on a
    /// thread, where `faer` asks for its buffers; after an error, all is as before.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`] for the input or the bias, [`Error::Memory`].
    pub fn step(&mut self, y: &[f64], seen: &[bool], acted: &[f64], bias: &[f64], started: bool) -> Result<&Step> {
        let (p, m) = (self.filter.window.outputs(), self.filter.window.inputs());
        for (name, len, expected) in
            [("y", y.len(), p), ("seen", seen.len(), p), ("acted", acted.len(), m), ("bias", bias.len(), p)]
        {
            sized(name, len, expected)?;
        }
        require_finite("acted", acted)?;
        require_finite("bias", bias)?;
        room_for_products()?;
        for (to, (seen, y)) in self.room.seen.iter_mut().zip(seen.iter().zip(y)) {
            *to = *seen && y.is_finite();
        }
        self.step.predicted.clear();
        self.step.bias.copy_from_slice(bias);
        (self.step.off, self.step.believed) = (0.0, false);
        let mut begins = !self.windows[NOW].began();
        if !begins {
            self.predict(NOW, acted, bias);
            let off = self.off(NOW, y, bias, false);
            begins = off > 1.0 && self.windows[NOW].calls == 1 && !self.windows[NOW].known;
            let believed = off > 1.0 && self.doubt.of_change();
            let rejected = off > 1.0 && !believed;
            (self.step.off, self.step.believed) = (off, believed);
            self.judge(y, acted, bias);
            self.predict(NOW, acted, bias);
            self.learn(y, started && !rejected);
            self.step.predicted.extend_from_slice(&self.room.predicted);
            self.take(NOW, y, acted, rejected);
            if believed {
                self.copy(RAW, NOW);
                self.windows[LATE].calls = 0;
            }
        }
        if begins {
            // of two readings that do not agree the second is kept: no others say which is false
            self.filter.begun(&mut self.windows[NOW], y, acted, &self.room.seen);
            self.certain();
        }
        let (now, step) = (&self.windows[NOW], &mut self.step);
        let sum = now.x.iter().chain(&step.bias).sum::<f64>();
        step.lost = !sum.is_finite() || now.excess.is_nan() || now.excess >= USELESS;
        step.runs = !step.lost && now.tells(started) && now.missed <= self.max_missing;
        if step.lost {
            self.windows[NOW].calls = 0;
            self.certain();
        }
        Ok(&self.step)
    }

    /// What readings that are rejected, or not, say of the window: another takes its place if it explains them better,
    /// where they are believed; else they are taken into the others alone.
    fn judge(&mut self, y: &[f64], acted: &[f64], bias: &[f64]) {
        let Step { off, believed, .. } = self.step;
        if off > 1.0 {
            let Room { seen, predicted, off, .. } = &mut self.room;
            for (i, off) in off.iter_mut().enumerate() {
                *off = (y[i] - predicted[i]) / self.of.noise[i * y.len() + i].sqrt();
                *off = if seen[i] && off.is_finite() { *off } else { 0.0 };
            }
            self.doubt.reject(off);
        } else {
            self.doubt.accept();
        }
        if believed {
            let (mut best, mut least) = (NOW, f64::INFINITY);
            for k in [RAW, LATE, NOW] {
                if !self.windows[k].began() {
                    continue;
                }
                self.predict(k, acted, bias);
                // behind a false reading some system of the region explains nearly everything
                let off = self.off(k, y, bias, true);
                if off < BETTER * least {
                    (best, least) = (k, off);
                }
            }
            self.copy(NOW, best);
            return;
        }
        let there = [RAW, LATE].map(|k| self.windows[k].began());
        let kept = off > 1.0 || self.doubt.alike > 0.0;
        for (k, began) in [RAW, LATE].into_iter().zip(there) {
            if off > 1.0 && !began && (k == RAW || there[0]) {
                self.copy(k, NOW);
            }
            if kept && self.windows[k].began() {
                self.predict(k, acted, bias);
                self.take(k, y, acted, false);
            } else {
                self.windows[k].calls = 0;
            }
        }
    }

    /// The bias by what was not predicted, within what inputs can hold.
    fn learn(&mut self, y: &[f64], taken: bool) {
        let (Room { seen, predicted, off, .. }, step) = (&mut self.room, &mut self.step);
        for (i, news) in off.iter_mut().enumerate() {
            *news = if taken && seen[i] { y[i] - predicted[i] } else { 0.0 };
        }
        step.bias.iter_mut().zip(self.of.gain.chunks_exact(off.len())).for_each(|(e, row)| *e += dot(row, off));
        if self.gate.is_some() {
            // alone, a cut would leave a part of a false reading behind
            self.capped();
        }
    }
}
