//! A loop from readings, step by step: which of them are taken for true, what is known of the window, and of a disturbance.

use std::sync::Arc;

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, MatRef, Side};

use crate::error::{Error, Result, require_finite, sized};
use crate::identify::chi2_upper;
use crate::memory::{covered, room_for_products, try_collect, try_collect_all, try_copy, try_extend};
use crate::vector::dot;
use crate::window::{Contents, Filter};

use super::{Part, Region};

mod tables;

const WHAT: &str = "a loop from readings";
/// Rejected readings in a row, or alike with few others between them, behind which the next rejected one is taken for true.
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
/// `y - C z = D G W z + w` with `||G|| <= 1` for all systems of the region, and `||T w|| <= ||Sigma^(-1/2) w||` as `Sb >= Sigma`.
/// So a true reading behind a window of true ones is rejected with at most the probability of the quantile in the event of the
/// region, whatever was planned; P is what an uncertain window adds.
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

/// `T` and `||T D||` of each part.
#[derive(Debug, Clone)]
struct White(Mat<f64>, Vec<f64>);

impl White {
    /// None where the covariance is not positive definite.
    fn new<'a>(noise: &Mat<f64>, shapes: impl Iterator<Item = &'a Mat<f64>>, seen: &[usize]) -> Option<Self> {
        let p = seen.len();
        let some = |of: &Mat<f64>| Mat::from_fn(p, p, |i, j| of[(seen[i], seen[j])]);
        let root = some(noise).llt(Side::Lower).ok()?;
        let mut back = Mat::<f64>::identity(p, p);
        for j in 0..p {
            for i in j..p {
                let done = (j..i).map(|q| root.L()[(i, q)] * back[(q, j)]).sum::<f64>();
                back[(i, j)] = (back[(i, j)] - done) / root.L()[(i, i)];
            }
        }
        let mut sizes = Vec::new();
        for shape in shapes {
            let values = (&back * some(shape) * back.transpose()).self_adjoint_eigenvalues(Side::Lower).ok()?;
            sizes.push(values.last().copied().unwrap_or(0.0).max(0.0).sqrt());
        }
        Some(Self(back, sizes))
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
        let all = try_collect(WHAT, 0..p)?;
        let (centre, parts) = (try_copy(WHAT, region.centre())?, try_collect(WHAT, region.parts().iter().cloned())?);
        room_for_products()?;
        covered(WHAT, 256 * (p as u128 + 16).pow(2) * (region.parts().len() as u128 + 4), || {
            let shape = |part: &Arc<Part>| {
                let (of, mut shape) = (part.of(), Mat::zeros(p, p));
                for (i, row) in of.rows.iter().zip(of.shape.chunks_exact(of.rows.len())) {
                    of.rows.iter().zip(row).for_each(|(j, v)| shape[(*i, *j)] = v * of.factor);
                }
                shape
            };
            let shapes = try_collect(WHAT, parts.iter().map(shape))?;
            let noise = MatRef::from_row_major_slice(noise, p, p).to_owned();
            let usual = White::new(&noise, shapes.iter(), &all);
            Ok(usual.map(|usual| Self { centre, parts, shapes, noise, quantiles, usual }))
        })?
    }

    /// `(||T off|| - ||T D|| ||W z||) / q` of the components `seen`; above 1 it rejects. Of the system of the model alone: `||T
    /// off|| / q`.
    fn excess(&self, off: &[f64], z: &[f64], seen: &[bool], more: Option<&Mat<f64>>, alone: bool) -> Result<f64> {
        let places = try_collect(WHAT, (0..off.len()).filter(|i| seen[*i]))?;
        let mut other = None;
        if more.is_some() || places.len() < off.len() {
            room_for_products()?;
            other = covered(WHAT, 256 * (off.len() as u128 + 16).pow(2) * (self.parts.len() as u128 + 4), || {
                let noise = more.map_or_else(|| self.noise.clone(), |more| &self.noise + more);
                White::new(&noise, self.shapes.iter(), &places)
            })?;
            if other.is_none() {
                return Ok(0.0); // the covariance of what is not known overflows
            }
        }
        let White(t, sizes) = other.as_ref().unwrap_or(&self.usual);
        let along = |i: usize| (0..=i).map(|j| t[(i, j)] * off[places[j]]).sum::<f64>();
        let far = (0..places.len()).map(|i| along(i).powi(2)).sum::<f64>().sqrt();
        let room = self.parts.iter().zip(sizes).map(|(part, size)| size * part.length(z));
        let room = if alone { 0.0 } else { room.sum::<f64>() };
        Ok((far - room) / self.quantiles[places.len()])
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
        self.excess(off, z, seen, None, false)
    }
}

/// A constant e in `y+ = Theta z + e`, and what is learned of it from what was not predicted: `e+ = e + L (y - Theta z - e)`.
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
    /// The steady Kalman gain for random walks of steps `Q = B diag(drift^2) B' + EVERY^2 Sigma`, `B` (p, m) what inputs add to the
    /// next reading.
    ///
    /// In units in which `Sigma = I` and `Q = U diag(q) U'`: `p = (q + sqrt(q^2 + 4 q)) / 2`, `L = U diag(p / (p + 1)) U'`,
    /// `P = U diag(p) U'`. As L is invertible, a loop at rest holds its set point whatever constants act.
    ///
    /// # Errors
    /// [`Error::Numerical`] for a Sigma that is not positive definite, [`Error::Memory`].
    pub fn learned(of_inputs: &[f64], drift: &[f64], noise: &[f64]) -> Result<Self> {
        let (m, p) = (drift.len(), of_inputs.len().checked_div(drift.len()).unwrap_or(0));
        if of_inputs.len() != p * m || noise.len() != p * p {
            let (expected, found) = (format!("{p} x {p} entries"), noise.len().to_string());
            return Err(Error::Shape { name: "noise", expected, found });
        }
        room_for_products()?;
        covered(WHAT, 1024 * (p as u128 + m as u128 + 16).pow(2), || {
            let lost =
                |_| Error::Numerical("the covariance of the noise of the readings is not positive definite".into());
            let sigma = MatRef::from_row_major_slice(noise, p, p);
            let root = sigma.llt(Side::Lower).map_err(lost)?.L().to_owned();
            let back = root.as_ref().partial_piv_lu().inverse();
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
            Ok(Self { gain: listed(gain)?, spread: listed(spread)?, noise: try_copy(WHAT, noise)? })
        })?
    }
}

/// What a step found.
#[derive(Debug)]
pub struct Step {
    /// What was predicted a step before; None at the first one.
    pub predicted: Option<Vec<f64>>,
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
    now: Option<Contents>,
    /// With all that was rejected, and with all but the first of it, which was then false.
    others: [Option<Contents>; 2],
    doubt: Doubt,
}

/// Whether what is rejected is a change of the plant: a constant force can bring every second or third reading back to what is
/// predicted, so that none of the others come in a row, but they are off by the same.
#[derive(Debug, Clone, Default)]
struct Doubt {
    /// Rejected in a row.
    row: f64,
    /// `FORGOTTEN` times those that were rejected and off by the same, less the others between them.
    alike: f64,
    /// What the last rejected one was off by, in deviations of the noise (p).
    off: Vec<f64>,
}

impl Doubt {
    const fn of_change(&self) -> bool {
        self.row >= BELIEVED || self.alike >= FORGOTTEN * BELIEVED
    }

    fn accept(&mut self) {
        (self.row, self.alike) = (0.0, (self.alike - 1.0).max(0.0));
    }

    /// Off by the same: within half of the larger one.
    fn reject(&mut self, off: Vec<f64>) {
        let size = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>();
        let apart = self.off.iter().zip(&off).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let same = self.off.len() == off.len() && 4.0 * apart <= size(&self.off).max(size(&off));
        let before = if same { self.alike } else { 0.0 };
        (self.row, self.alike) = (self.row + 1.0, (before + FORGOTTEN).min(2.0 * FORGOTTEN * BELIEVED));
        self.off = off;
    }
}

/// `M v`, row by row.
fn product(rows: &[f64], v: &[f64]) -> Result<Vec<f64>> {
    try_collect(WHAT, rows.chunks_exact(v.len()).map(|row| dot(row, v)))
}

impl Readings {
    /// An empty window of the model `theta` (p, d).
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn new(
        filter: Filter,
        theta: &[f64],
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
        let theta = try_copy(WHAT, theta)?;
        let none = Aim { of_bias: Vec::new(), limits: [const { Vec::new() }; 3] };
        let (others, doubt) = ([None, None], Doubt::default());
        let mut made = Self { filter, theta, gate, of, aim: none, max_missing, now: None, others, doubt };
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
    /// `e + Sigma T'(T Sigma T')^-1 (limit - us - T e)` over the rows T of `T_e` of the inputs that are beyond. Where that is more
    /// than can be met, as of two inputs for one output, the largest share of it that all limits allow.
    fn capped(&self, bias: &mut [f64]) -> Result<()> {
        let ([us, low, high], p) = (&self.aim.limits, bias.len());
        let (mut asked, mut held) = (Vec::new(), Vec::<(usize, f64)>::new());
        for _ in 0..us.len() {
            let wanted = product(&self.aim.of_bias, bias)?;
            let over = |i: usize| us[i] + wanted[i] - (us[i] + wanted[i]).clamp(low[i], high[i]);
            let beyond = |i: usize| over(i).abs() > CAPPED * wanted[i].abs().max(us[i].abs());
            let new = (0..us.len()).filter(|i| beyond(*i) && held.iter().all(|(at, _)| at != i));
            let new = try_collect(WHAT, new.map(|i| (i, (us[i] + wanted[i]).clamp(low[i], high[i]) - us[i])))?;
            if new.is_empty() {
                break;
            }
            if held.is_empty() {
                asked = try_copy(WHAT, bias)?;
            }
            try_extend(WHAT, &mut held, new)?;
            if held.len() > p {
                break;
            }
            room_for_products()?;
            covered(WHAT, 512 * (p as u128 + held.len() as u128 + 16).pow(2), || {
                let rows = Mat::from_fn(held.len(), p, |i, j| self.aim.of_bias[held[i].0 * p + j]);
                let across = MatRef::from_row_major_slice(&self.of.noise, p, p) * rows.transpose();
                let e = Mat::from_fn(p, 1, |i, _| bias[i]);
                let lacking = Mat::from_fn(held.len(), 1, |i, _| held[i].1) - &rows * e;
                let by = &across * (&rows * &across).partial_piv_lu().solve(lacking);
                if (0..p).all(|i| by[(i, 0)].is_finite()) {
                    bias.iter_mut().enumerate().for_each(|(i, e)| *e += by[(i, 0)]);
                }
            })?;
        }
        if held.is_empty() {
            return Ok(());
        }
        let share = |bias: &[f64]| -> Result<f64> {
            let wanted = product(&self.aim.of_bias, bias)?;
            let allowed = (0..us.len()).map(|i| {
                let there = (us[i] + wanted[i]).clamp(low[i], high[i]) - us[i];
                if (wanted[i] - there).abs() > CAPPED * wanted[i].abs().max(us[i].abs()) {
                    there / wanted[i]
                } else {
                    1.0
                }
            });
            Ok(allowed.fold(1.0, f64::min).max(0.0))
        };
        if share(bias)? < 1.0 {
            let part = share(&asked)?;
            bias.iter_mut().zip(&asked).for_each(|(e, asked)| *e = part * asked);
        }
        Ok(())
    }

    /// The window, if it has begun.
    #[must_use]
    pub const fn window(&self) -> Option<&Contents> {
        self.now.as_ref()
    }

    /// The window, those with all that was rejected and with all but the first, and the doubt of the window: how many were
    /// rejected in a row, how many were alike, and what the last was off by.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn state(&self) -> Result<([Option<&Contents>; 3], Vec<f64>)> {
        let Doubt { row, alike, off } = &self.doubt;
        let doubt = try_collect(WHAT, [*row, *alike].into_iter().chain(off.iter().copied()))?;
        Ok(([self.now.as_ref(), self.others[0].as_ref(), self.others[1].as_ref()], doubt))
    }

    /// Go on from there, with the numbers of the windows, and the doubt.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Memory`].
    pub fn restore(&mut self, [now, raw, late]: [Option<&[f64]>; 3], doubt: &[f64]) -> Result<()> {
        let contents = |of: Option<&[f64]>| of.map(|numbers| self.filter.restored(numbers)).transpose();
        let p = self.filter.window.outputs();
        let doubt = match doubt {
            [] => Doubt::default(),
            [row, alike, off @ ..] if [0, p].contains(&off.len()) && doubt.iter().all(|v| v.is_finite()) => {
                Doubt { row: *row, alike: *alike, off: try_copy(WHAT, off)? }
            }
            _ => {
                let (expected, found) = (format!("2 or {} numbers", p + 2), doubt.len().to_string());
                return Err(Error::Shape { name: "doubt", expected, found });
            }
        };
        (self.now, self.others, self.doubt) = (contents(now)?, [contents(raw)?, contents(late)?], doubt);
        Ok(())
    }

    /// Go on from a window that is known.
    ///
    /// # Errors
    /// [`Error::Memory`].
    pub fn start(&mut self, x: &[f64]) -> Result<()> {
        (self.now, self.others, self.doubt) = (Some(self.filter.full(x)?), [None, None], Doubt::default());
        Ok(())
    }

    /// How far off a reading is, in widths of the gate, with the bias or without it; of the system of the model `alone`, or of all.
    fn off(&self, y: &[f64], now: &Contents, z: &[f64], shift: &[f64], seen: &[bool], alone: bool) -> Result<f64> {
        let Some(gate) = self.gate.as_ref().filter(|_| seen.contains(&true)) else { return Ok(0.0) };
        let mut off = product(&gate.centre, z)?;
        off.iter_mut().zip(y).for_each(|(off, y)| *off = y - *off);
        let more = self.filter.unknown(now);
        let found = gate.excess(&off, z, seen, more.as_ref(), alone)?;
        // one that was capped to 0 is rounding
        let shifted = |(v, variance): (&f64, &f64)| v.abs() > CAPPED * variance.sqrt();
        if found > 1.0 && shift.iter().zip(self.of.noise.iter().step_by(y.len() + 1)).any(shifted) {
            let spread = MatRef::from_row_major_slice(&self.of.spread, y.len(), y.len()).to_owned();
            let more = more.map_or_else(|| spread.clone(), |more| &more + &spread);
            off.iter_mut().zip(shift).for_each(|(off, shift)| *off -= shift);
            return Ok(found.min(gate.excess(&off, z, seen, Some(&more), alone)?));
        }
        Ok(found)
    }

    /// Take readings in, those with `seen` that are numbers, or what is predicted in their place, with the input that acted, the
    /// bias that was found last, and whether the loop has run.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`] for the input or the bias, [`Error::Memory`].
    pub fn step(&mut self, y: &[f64], seen: &[bool], acted: &[f64], bias: &[f64], started: bool) -> Result<Step> {
        let (p, m) = (self.filter.window.outputs(), self.filter.window.inputs());
        for (name, len, expected) in
            [("y", y.len(), p), ("seen", seen.len(), p), ("acted", acted.len(), m), ("bias", bias.len(), p)]
        {
            sized(name, len, expected)?;
        }
        require_finite("acted", acted)?;
        require_finite("bias", bias)?;
        let seen = &try_collect(WHAT, seen.iter().zip(y).map(|(seen, y)| *seen && y.is_finite()))?[..];
        let mut step =
            Step { predicted: None, bias: try_copy(WHAT, bias)?, off: 0.0, believed: false, lost: false, runs: false };
        let mut next = (None, [None, None], self.doubt.clone());
        let mut begins = self.now.is_none();
        if let Some(now) = &self.now {
            let ahead = |z: &[f64]| -> Result<Vec<f64>> {
                let mut ahead = product(&self.theta, z)?;
                ahead.iter_mut().zip(bias).for_each(|(ahead, shift)| *ahead += shift);
                Ok(ahead)
            };
            let with_all = |of: &Contents| -> Result<Option<Contents>> {
                let predicted = ahead(&self.filter.regressors(of, acted)?)?;
                Ok(Some(self.filter.advanced(of, y, acted, seen, &predicted)?))
            };
            let (mut now, mut z) = (now, self.filter.regressors(now, acted)?);
            let (mut came, none) = (seen, try_collect(WHAT, seen.iter().map(|_| false))?);
            step.off = self.off(y, now, &z, bias, seen, false)?;
            begins = step.off > 1.0 && now.calls == 1 && now.covariance.is_some();
            if step.off > 1.0 {
                let predicted = ahead(&z)?;
                let off = |i: usize| {
                    let off = (y[i] - predicted[i]) / self.of.noise[i * p + i].sqrt();
                    if seen[i] && off.is_finite() { off } else { 0.0 }
                };
                next.2.reject(try_collect(WHAT, (0..p).map(off))?);
                if self.doubt.of_change() {
                    let mut least = f64::INFINITY;
                    for other in self.others.iter().flatten().chain([now]) {
                        let of = self.filter.regressors(other, acted)?;
                        // behind a false reading some system of the region explains nearly everything
                        let off = self.off(y, other, &of, bias, seen, true)?;
                        if off < BETTER * least {
                            (now, z, least) = (other, of, off);
                        }
                    }
                    step.believed = true;
                } else {
                    came = &none;
                    next.1[0] = with_all(self.others[0].as_ref().unwrap_or(now))?;
                    if self.others[0].is_some() {
                        next.1[1] = with_all(self.others[1].as_ref().unwrap_or(now))?;
                    }
                }
            } else {
                next.2.accept();
                if next.2.alike > 0.0 {
                    for (next, other) in next.1.iter_mut().zip(self.others.iter().flatten()) {
                        *next = with_all(other)?;
                    }
                }
            }
            let predicted = ahead(&z)?;
            let news = |i: usize| if started && came[i] { y[i] - predicted[i] } else { 0.0 };
            let news = try_collect(WHAT, (0..p).map(news))?;
            step.bias.iter_mut().zip(product(&self.of.gain, &news)?).for_each(|(e, more)| *e += more);
            if self.gate.is_some() {
                // alone, a cut would leave a part of a false reading behind
                self.capped(&mut step.bias)?;
            }
            next.0 = Some(self.filter.advanced(now, y, acted, came, &predicted)?);
            if step.believed {
                next.1[0].clone_from(&next.0);
            }
            step.predicted = Some(predicted);
        }
        if begins {
            // of two readings that do not agree the second is kept: no others say which is false
            next = (Some(self.filter.begun(y, acted, seen)?), [None, None], Doubt::default());
        }
        let found = next.0.as_ref();
        let sum = |now: &Contents| now.x.iter().chain(&step.bias).sum::<f64>();
        step.lost = !found.is_some_and(|now| sum(now).is_finite() && now.excess < USELESS);
        step.runs = !step.lost && found.is_some_and(|now| now.tells(started) && now.missed <= self.max_missing);
        if step.lost {
            next = (None, [None, None], Doubt::default());
        }
        (self.now, self.others, self.doubt) = next;
        Ok(step)
    }
}
