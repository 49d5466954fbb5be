//! How much a certified loop stands: gain, phase, delay, errors of readings, rounding and saturation, for all members.

use faer::Mat;

use crate::error::{Error, Result};
use crate::memory::covered;
use crate::parallel::Stop;

use super::blocks::{Blocks, Channel};
use super::certificate::{Verdict, judged};
use super::data::{Matrix, WHAT, entries, filled, gathered, in_units, matrix, scaled};
use super::late::{Fault, Recorder};
use super::loops::{Loop, bytes};
use super::scalings::{hint, largest};
use super::spectrum::radius;

/// Largest gain that is looked at, and the largest size of a channel.
const MOST: f64 = 1e3;
/// Most steps of delay.
const LATE: usize = 20;
/// Most bits of a rounded gain.
const BITS: i32 = 16;
/// Least piece of a chain of discs.
const PIECE: f64 = 2e-3;

/// One number for all members of the region, and that of the centre.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Margin {
    /// A proved bound for every member.
    pub certified: f64,
    /// The same of the centre alone, not proved.
    pub nominal: f64,
}

/// What the loop stands. Each by itself, the others as they are.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Margins {
    /// The least and the largest constant factor of each input.
    pub gains: Vec<[Margin; 2]>,
    /// The largest turn of each input, in rad.
    pub phases: Vec<Margin>,
    /// The largest alpha of `(1 + delta / 2) / (1 - delta / 2)`, `|delta| <= alpha`, at each input.
    pub disks: Vec<Margin>,
    /// The same at all inputs at once.
    pub disk: Margin,
    /// Constant delays of up to this many steps.
    pub delay: Margin,
    /// The share of the input before in what is applied, at any step, at most 1; above that steps of delay in any pattern.
    pub varying: Margin,
    /// The relative error of each reading, in any way.
    pub readings: Margin,
    /// Bits of the entries of a rounded gain; infinite where no number up to 16 is enough.
    pub bits: Margin,
    /// All inputs may be reduced to any share from this one to 1, in any way.
    pub share: Margin,
}

/// A matrix whose row `i` is that of `k` times `by`.
fn with_row(k: &Matrix, i: usize, by: f64) -> Matrix {
    Mat::from_fn(k.nrows(), k.ncols(), |row, j| if row == i { by * k[(row, j)] } else { k[(row, j)] })
}

fn row_of(k: &Matrix, i: usize) -> Matrix {
    k.subrows(i, 1).to_owned()
}

fn unit(count: usize, i: usize) -> Matrix {
    Mat::from_fn(count, 1, |row, _| f64::from(u8::from(row == i)))
}

/// Each entry to so many bits.
fn rounded(k: &Matrix, bits: i32) -> Matrix {
    let of = |v: f64| {
        if v == 0.0 {
            return v;
        }
        let step = 2f64.powi(v.abs().log2().floor() as i32 + 1 - bits);
        (v / step).round() * step
    };
    Mat::from_fn(k.nrows(), k.ncols(), |i, j| of(k[(i, j)]))
}

/// How far from `from` towards `to` all is stable; the first change is found to 1e-6 if it is wider than a step.
fn edge(from: f64, to: f64, mut stable: impl FnMut(f64) -> Result<bool>) -> Result<f64> {
    if !stable(from)? {
        return Ok(from);
    }
    let (mut inside, mut step) = (from, 0.01 * (to - from).signum());
    while (to - inside) * step > 0.0 {
        let next = if (to - inside).abs() < step.abs() { to } else { inside + step };
        if stable(next)? {
            inside = next;
            step *= 1.1;
            continue;
        }
        let mut outside = next;
        for _ in 0..40 {
            let middle = 0.5 * (inside + outside);
            *(if stable(middle)? { &mut inside } else { &mut outside }) = middle;
        }
        return Ok(inside);
    }
    Ok(to)
}

/// The largest x in [0, 1], to 1e-3 or so, with `allowed(x) >= x / 2`, that was tried: secants, as `allowed` falls slowly.
fn crossing(mut allowed: impl FnMut(f64) -> Result<f64>) -> Result<f64> {
    let mut room = |x: f64| -> Result<f64> { Ok(allowed(x)? - 0.5 * x) };
    let (mut low, mut high) = ((0.0, room(0.0)?), (1.0, room(1.0)?));
    if high.1 >= 0.0 || low.1 <= 0.0 {
        return Ok(if high.1 >= 0.0 { 1.0 } else { 0.0 });
    }
    for round in 0..9 {
        // just below the secant, and halves where one end does not move
        let secant = low.0 + (high.0 - low.0) * low.1 / (low.1 - high.1);
        let x = if round % 3 == 2 { 0.5 * (low.0 + high.0) } else { secant - 1e-4 * (secant - low.0) };
        let found = room(x)?;
        *(if found >= 0.0 { &mut low } else { &mut high }) = (x, found);
        if high.0 - low.0 < 1e-3 || low.1 < 5e-4 {
            break;
        }
    }
    Ok(low.0)
}

impl Loop {
    /// Whether the loop is certified, and the data determine all directions: those of another gain, too.
    pub(super) fn free(&self) -> bool {
        self.certificate.status == Verdict::Certified
            && self.data.region.parts.iter().all(|part| part.missing.is_empty())
    }

    fn blocks(&self, k: &Matrix, channels: &[Channel]) -> Blocks {
        Blocks::new(&self.data, k, None, &self.closed.t, channels)
    }

    /// The largest common size of the channels, for the region and for the centre.
    fn sized(&self, k: &Matrix, channels: &[Channel], most: f64, stop: &Stop) -> Result<Margin> {
        let shares = filled(channels.len(), 1.0);
        let certified = largest(&self.blocks(k, channels), &shares, most, stop)?.0.gamma;
        let alone = Blocks::new(&self.data, k, None, &[], channels);
        let nominal =
            if radius(&alone.a())? < 1.0 { hint(&alone, &shares, stop)?.map_or(0.0, |f| f.gamma) } else { 0.0 };
        Ok(Margin { certified, nominal: nominal.min(most) })
    }

    /// How large a term `f(z)`, `||f(z)|| <= gamma ||z||`, may be in the states `e` (n, k) of `z = H (x, u)`, H (l, n + m): gamma,
    /// in the units of the data; 0 where nothing is proved.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn allows(&self, e: &[f64], h: &[f64], stop: &Stop) -> Result<Margin> {
        let (n, m) = (self.data.n, self.data.m);
        if e.is_empty() || !e.len().is_multiple_of(n) || h.is_empty() || !h.len().is_multiple_of(n + m) {
            let (expected, found) = (format!("{n} rows, and {} columns", n + m), format!("{}, {}", e.len(), h.len()));
            return Err(Error::Shape { name: "E and H", expected, found });
        }
        covered(WHAT, bytes(n, self.data.region.d), || {
            let e = in_units(&matrix(e, n, e.len() / n), &self.data.back(), &filled(e.len() / n, 1.0));
            let h = matrix(h, h.len() / (n + m), n + m);
            let own = in_units(&h.subcols(0, n).to_owned(), &filled(h.nrows(), 1.0), &self.data.unit);
            let h = own + h.subcols(n, m) * &self.closed.k;
            let mut found = self.sized(&self.closed.k, &[Channel::at_states(e, h, m)], f64::MAX.sqrt(), stop)?;
            if self.certificate.status != Verdict::Certified {
                found.certified = 0.0;
            }
            Ok(found)
        })?
    }

    /// What the loop withstands, for every member and for the centre; nothing without a certificate. `recorder`: of a controller
    /// that uses more than the readings now. The share is that of inputs whose size after the cut the controller knows.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn margins(&self, recorder: Option<Recorder<'_>>, stop: &Stop) -> Result<Margins> {
        let (n, m) = (self.data.n, self.data.m);
        covered(WHAT, 8 * bytes(3 * n, self.data.region.d), || {
            let (next, reads) = (filled(n * (n + m), 0.0), entries(&Mat::identity(n, n)));
            let recorder = recorder.unwrap_or(Recorder { next: &next, reads: &reads });
            let asked = self.apart(recorder, Fault::Inputs)?.0;
            let (certified, k) = (self.free(), &asked.closed.k);
            let (mut gains, mut phases, mut disks, mut all) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
            for i in 0..m {
                let mut one = Channel::at_inputs(unit(m, i), row_of(k, i));
                one.own[(0, 0)] = 0.5;
                disks.push(asked.sized(k, std::slice::from_ref(&one), MOST, stop)?);
                all.push(one);
                gains.push(asked.gain(i, certified, stop)?);
                phases.push(asked.phase(i, certified, stop)?);
            }
            let disk = asked.sized(k, &all, MOST, stop)?;
            let (read, mut reads) = self.apart(recorder, Fault::Readings)?;
            reads.retain(|one| one.u.norm_max() > 0.0 || one.e.norm_max() > 0.0);
            let mut readings = Margin { certified: MOST, nominal: MOST };
            if !reads.is_empty() {
                readings = read.sized(&read.closed.k, &reads, MOST, stop)?;
            }
            let mut found = Margins {
                gains,
                phases,
                disks,
                disk,
                delay: asked.delay(stop)?,
                varying: asked.varying(stop)?,
                readings,
                bits: self.bits(stop)?,
                share: self.share(stop)?,
            };
            if !certified {
                let none = |margin: &mut Margin, value: f64| margin.certified = value;
                found.gains.iter_mut().flatten().for_each(|one| none(one, 1.0));
                found.phases.iter_mut().chain(&mut found.disks).for_each(|one| none(one, 0.0));
                [&mut found.disk, &mut found.delay, &mut found.varying, &mut found.readings]
                    .into_iter()
                    .for_each(|one| none(one, 0.0));
                none(&mut found.bits, f64::INFINITY);
                none(&mut found.share, 1.0);
            }
            Ok(found)
        })?
    }

    /// A chain of discs from 0 to `to` on a curve: `disc(a, h)` is the gain in the middle of `[a, a + h]`, its imaginary part, and
    /// the radius that covers the piece.
    fn chain(
        &self,
        i: usize,
        to: f64,
        disc: impl Fn(f64, f64) -> (Matrix, Option<Matrix>, f64),
        stop: &Stop,
    ) -> Result<f64> {
        let channel = [Channel::at_inputs(unit(self.data.m, i), row_of(&self.closed.k, i))];
        let (mut a, mut h) = (0.0f64, 0.3f64.min(to));
        let mut t = None;
        while a < to && h >= PIECE.min(to) {
            stop.check()?;
            h = h.min(to - a);
            let (k, turn, r) = disc(a, h);
            let of = Blocks::new(&self.data, &k, turn.as_ref(), &self.closed.t, &channel);
            if t.is_none() {
                let start = largest(&self.blocks(&self.closed.k, &channel), &[1.0], MOST, stop)?.0;
                t = Some(start.t[0]);
            }
            let near = t.unwrap_or(1.0);
            let found = [1.0, 3.0, 1.0 / 3.0, 10.0, 0.1].iter().find_map(|by| {
                let one = near * by;
                [1.02, 1.0005].iter().find_map(|slack| of.proof(&[r], &[one], (None, 1.0), *slack)).map(|_| one)
            });
            match found {
                Some(one) => {
                    (t, a, h) = (Some(one), a + h, h * 1.5);
                }
                None => h /= 1.7,
            }
        }
        Ok(a)
    }

    fn gain(&self, i: usize, certified: bool, stop: &Stop) -> Result<[Margin; 2]> {
        let k = &self.closed.k;
        let stable = |by: f64| Ok(radius(&(&self.data.a + &self.data.b * with_row(k, i, by)))? < 1.0);
        let mut found =
            [(-1.0, 0.0), (1.0, MOST)].map(|(sign, end)| (sign, end, Margin { certified: 1.0, nominal: 1.0 }));
        for (sign, end, margin) in &mut found {
            margin.nominal = edge(1.0, *end, stable)?;
            if certified {
                let disc =
                    |a: f64, h: f64| (with_row(k, i, 1.0 + *sign * (a + 0.5 * h)), None, 0.5 * h * (1.0 + 1e-12));
                margin.certified = 1.0 + *sign * self.chain(i, (*end - 1.0).abs(), disc, stop)?;
            }
        }
        Ok(found.map(|one| one.2))
    }

    fn phase(&self, i: usize, certified: bool, stop: &Stop) -> Result<Margin> {
        let k = &self.closed.k;
        let turned = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            let im = Mat::from_fn(k.nrows(), k.ncols(), |row, j| if row == i { sin * k[(row, j)] } else { 0.0 });
            (with_row(k, i, cos), im)
        };
        let stable = |angle: f64| {
            let (re, im) = turned(angle);
            Ok(radius(&Blocks::new(&self.data, &re, Some(&im), &[], &[]).a())? < 1.0)
        };
        let nominal = edge(0.0, std::f64::consts::PI, stable)?;
        let disc = |a: f64, h: f64| {
            let (re, im) = turned(a + 0.5 * h);
            (re, Some(im), 2.0 * (0.25 * h).sin() * (1.0 + 1e-12) + 1e-15)
        };
        Ok(Margin {
            certified: if certified { self.chain(i, std::f64::consts::PI, disc, stop)? } else { 0.0 },
            nominal,
        })
    }

    fn delay(&self, stop: &Stop) -> Result<Margin> {
        let mut found = Margin { certified: 0.0, nominal: 0.0 };
        let (mut proved, mut stable) = (self.certificate.status == Verdict::Certified, self.certificate.radius < 1.0);
        for d in 1..=LATE {
            if !stable {
                break;
            }
            let (data, closed) = self.past(d, (0.0, 1.0))?;
            stable = radius(&closed.a0)? < 1.0;
            if proved {
                proved = judged(&data, closed, stop)?.0.status == Verdict::Certified;
            }
            let d = d as f64;
            found = Margin {
                certified: if proved { d } else { found.certified },
                nominal: if stable { d } else { found.nominal },
            };
        }
        Ok(found)
    }

    /// `u = (1 - d) K x + d v`, v the input asked for a step before: `K x + d / 2 (v - K x) + q`, `|q| <= d / 2 |K x - v|`.
    fn varying(&self, stop: &Stop) -> Result<Margin> {
        let (n, m) = (self.data.n, self.data.m);
        let size = |share: f64| -> Result<Margin> {
            let (data, closed) = self.past(1, (1.0 - share, share))?;
            let asked = self.own_gain();
            let of = Mat::from_fn(m, n + m, |i, j| {
                data.unit[j] * if j < n { asked[(i, j)] } else { -f64::from(u8::from(i == j - n)) }
            });
            let eye = Mat::<f64>::identity(m, m);
            let channel = [Channel::at_inputs(eye, of)];
            let whole = Blocks::new(&data, &closed.k, None, &self.closed.t, &channel);
            let certified = largest(&whole, &[1.0], 2.0 * LATE as f64, stop)?.0.gamma;
            let alone = Blocks::new(&data, &closed.k, None, &[], &channel);
            let stable = radius(&alone.a())? < 1.0;
            let nominal = if stable { hint(&alone, &[1.0], stop)?.map_or(0.0, |f| f.gamma) } else { 0.0 };
            Ok(Margin { certified, nominal })
        };
        let most = |of: &dyn Fn(&Margin) -> f64| -> Result<f64> {
            let share = crossing(|share| Ok(of(&size(0.5 * share)?)))?;
            Ok(if share < 1.0 { share } else { of(&size(0.0)?).floor().clamp(1.0, LATE as f64) })
        };
        let certified = if self.free() { most(&|one| one.certified)? } else { 0.0 };
        let nominal = if self.certificate.radius < 1.0 { most(&|one| one.nominal)? } else { 0.0 };
        Ok(Margin { certified, nominal })
    }

    /// The least number of bits from which on up to the most every rounding of the gain is certified.
    fn bits(&self, stop: &Stop) -> Result<Margin> {
        let mut found = Margin { certified: f64::INFINITY, nominal: f64::INFINITY };
        let (mut proved, mut stable) = (self.free(), true);
        for bits in (1..=BITS).rev() {
            let k = in_units(&rounded(&self.own_gain(), bits), &filled(self.data.m, 1.0), &self.data.unit);
            stable = stable && radius(&(&self.data.a + &self.data.b * &k))? < 1.0;
            if proved {
                stop.check()?;
                let of = Blocks::new(&self.data, &k, None, &self.closed.t, &[]);
                proved =
                    [1.2, 1.02, 1.002, 1.0002].iter().any(|slack| of.proof(&[], &[], (None, 1.0), *slack).is_some());
            }
            if proved {
                found.certified = f64::from(bits);
            }
            if stable {
                found.nominal = f64::from(bits);
            }
            if !stable && !proved {
                break;
            }
        }
        Ok(found)
    }

    pub(super) fn cut_channels(&self, beta: f64) -> (Matrix, Vec<Channel>) {
        let (m, k) = (self.data.m, &self.closed.k);
        let channels = gathered((0..m).map(|i| Channel::at_inputs(unit(m, i), row_of(k, i))));
        (scaled(k, 1.0 - 0.5 * beta), channels)
    }

    fn share(&self, stop: &Stop) -> Result<Margin> {
        let shares = filled(self.data.m, 1.0);
        let certified = |beta: f64| {
            let (k, channels) = self.cut_channels(beta);
            Ok(largest(&self.blocks(&k, &channels), &shares, MOST, stop)?.0.gamma)
        };
        let nominal = |beta: f64| {
            let (k, channels) = self.cut_channels(beta);
            let alone = Blocks::new(&self.data, &k, None, &[], &channels);
            let stable = radius(&alone.a())? < 1.0;
            Ok(if stable { hint(&alone, &shares, stop)?.map_or(0.0, |f| f.gamma) } else { 0.0 })
        };
        Ok(Margin {
            certified: 1.0 - if self.free() { crossing(certified)? } else { 0.0 },
            nominal: 1.0 - crossing(nominal)?,
        })
    }
}
