//! How much a certified loop stands: gain, phase, delay, errors of readings, rounding and saturation, for all members.

use faer::{Mat, c64};

use crate::error::{Error, Result};
use crate::memory::covered;
use crate::parallel::Stop;

use super::blocks::{Blocks, Channel};
use super::certificate::{Verdict, judged};
use super::data::{Matrix, WHAT, entries, filled, gathered, in_units, matrix, scaled};
use super::late::{Fault, Recorder};
use super::loops::{Loop, bytes};
use super::scalings::{
    Asked, Field, Found, ROUNDS_OF_ANGLES, Reduced, SHARES, View, certified, hint, largest, proof_at,
};
use super::spectrum::{radius, radius_of_complex};

/// Largest gain that is looked at, and the largest size of a channel.
const MOST: f64 = 1e3;
/// Most steps of delay.
const LATE: usize = 20;
/// Most bits of a rounded gain.
const BITS: i32 = 16;
/// Factors of a multiplier that are tried near the end of a chain.
const FACTORS: [f64; 9] = [1.0, 3.0, 0.33, 10.0, 0.1, 30.0, 100.0, 300.0, 1000.0];
/// Least piece of a chain of discs.
const PIECE: f64 = 5e-4;

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
    /// The share of the input before in what is applied, at any step, at most 1; above that steps of delay in any
    /// pattern.
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

/// The largest x in [0, 1], to 3e-4 or so, with `allowed(x) >= x / 2`, that was tried: secants, as `allowed` falls
/// slowly.
fn crossing(mut allowed: impl FnMut(f64) -> Result<f64>) -> Result<f64> {
    let mut room = |x: f64| -> Result<f64> { Ok(allowed(x)? - 0.5 * x) };
    let (mut low, mut high) = ((0.0, room(0.0)?), (1.0, room(1.0)?));
    if high.1 >= 0.0 || low.1 <= 0.0 {
        return Ok(if high.1 >= 0.0 { 1.0 } else { 0.0 });
    }
    for round in 0..12 {
        // just below the secant, and halves where one end does not move
        let secant = low.0 + (high.0 - low.0) * low.1 / (low.1 - high.1);
        let x = if round % 3 == 2 { 0.5 * (low.0 + high.0) } else { secant - 1e-4 * (secant - low.0) };
        let found = room(x)?;
        *(if found >= 0.0 { &mut low } else { &mut high }) = (x, found);
        if high.0 - low.0 < 3e-4 || low.1 < 1e-4 {
            break;
        }
    }
    Ok(low.0)
}

/// Half of a disk, of gains up to 1000.
fn half_of(disk: f64) -> f64 {
    (disk * (0.5 - 1e-12)).min(0.998)
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
    fn sized(&self, channels: &[Channel], most: f64, stop: &Stop) -> Result<Margin> {
        let (shares, k) = (filled(channels.len(), 1.0), &self.closed.k);
        let certified = largest(&self.blocks(k, channels), &shares, most, stop)?.0.gamma;
        let alone = Blocks::new(&self.data, k, None, &[], channels);
        let nominal =
            if radius(&alone.a())? < 1.0 { hint(&alone, &shares, stop)?.map_or(0.0, |f| f.gamma) } else { 0.0 };
        Ok(Margin { certified, nominal: nominal.min(most) })
    }

    /// How large a term `f(z)`, `||f(z)|| <= gamma ||z||`, may be in the states `e` (n, k) of `z = H (x, u)`, H (l, n +
    /// m): gamma, in the units of the data; 0 where nothing is proved.
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
            let mut found = self.sized(&[Channel::at_states(e, h, m)], f64::MAX.sqrt(), stop)?;
            if self.certificate.status != Verdict::Certified {
                found.certified = 0.0;
            }
            Ok(found)
        })?
    }

    /// What the loop withstands, for every member and for the centre; nothing without a certificate. `recorder`: of a
    /// controller that uses more than the readings now. The share is that of inputs whose size after the cut the
    /// controller knows.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn margins(&self, recorder: Option<Recorder<'_>>, stop: &Stop) -> Result<Margins> {
        let (n, m) = (self.data.n, self.data.m);
        covered(WHAT, 8 * bytes(3 * n, self.data.region.d), || {
            let (next, reads) = (filled(n * (n + m), 0.0), entries(&Mat::identity(n, n)));
            let recorder = recorder.unwrap_or(Recorder { next: &next, reads: &reads });
            let asked = self.apart(recorder, Fault::Inputs)?.0;
            let certified = self.free();
            let mut faults = Faults::new(&asked, stop)?;
            let (mut gains, mut phases, mut disks) = (Vec::new(), Vec::new(), Vec::new());
            for i in 0..m {
                let disk = faults.disk(Some(i))?;
                gains.push(faults.gain(i, disk.certified)?);
                phases.push(faults.phase(i, disk.certified)?);
                disks.push(disk);
            }
            let disk = faults.disk(None)?;
            let delay = faults.delay()?;
            let varying = faults.varying()?;
            let (read, mut reads) = self.apart(recorder, Fault::Readings)?;
            reads.retain(|one| one.u.norm_max() > 0.0 || one.e.norm_max() > 0.0);
            let mut readings = Margin { certified: MOST, nominal: MOST };
            if !reads.is_empty() {
                readings = read.sized(&reads, MOST, stop)?;
            }
            // of inputs whose size after the cut the controller knows
            let share = if asked.data.n > n { Faults::new(self, stop)?.share()? } else { faults.share()? };
            let bits = self.bits(stop)?;
            let mut found = Margins { gains, phases, disks, disk, delay, varying, readings, bits, share };
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

    fn inputs(&self) -> Vec<Channel> {
        gathered((0..self.data.m).map(|i| Channel::at_inputs(unit(self.data.m, i), row_of(&self.closed.k, i))))
    }

    /// The least number of bits from which on up to the most every rounding of the gain is certified.
    fn bits(&self, stop: &Stop) -> Result<Margin> {
        let mut found = Margin { certified: f64::INFINITY, nominal: f64::INFINITY };
        let (mut proved, mut stable) = (self.free(), true);
        for bits in (1..=BITS).rev() {
            let k = in_units(&rounded(&self.own_gain(), bits), &filled(self.data.m, 1.0), &self.data.unit);
            stable = stable && radius(&self.data.around(&k).0)? < 1.0;
            if proved {
                stop.check()?;
                proved = self.blocks(&k, &[]).alone();
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
        (scaled(&self.closed.k, 1.0 - 0.5 * beta), self.inputs())
    }
}

/// Which inputs a fault is at: one, each with its own, or all with one of all.
#[derive(Clone, Copy)]
enum Which {
    One(usize),
    Each,
    Together,
}

fn hinted(
    field: &mut Option<Field>,
    which: Which,
    rounds: usize,
    view: View<'_>,
    stop: &Stop,
) -> Result<Option<Found>> {
    let Some(field) = field else { return Ok(None) };
    let count = field.count();
    let (channels, several) = match which {
        Which::One(_) => (gathered([0]), 1),
        Which::Each => (gathered(0..count), count),
        Which::Together => (gathered((0..count).map(|_| 0)), 1),
    };
    let both = matches!(which, Which::One(_));
    let asked = Asked { shares: &filled(several, 1.0), outs: &channels, ins: &channels, rounds, both };
    let own = |angle: f64, one: &Reduced| {
        if let Which::One(i) = which { view(angle, &one.only(i)) } else { view(angle, one) }
    };
    field.hint(asked, &own, stop)
}

/// The gamma of what is found, 0 of nothing.
fn size(found: Option<&Found>) -> f64 {
    found.map_or(0.0, |one| one.gamma)
}

/// The largest x in [0, 1] with `predicted(x) >= x / 2` of which that is proved.
fn withstood(
    mut predicted: impl FnMut(f64, usize) -> Result<Option<Found>>,
    mut proved: impl FnMut(f64, &Found) -> Result<bool>,
) -> Result<f64> {
    let mut most = 0.0;
    for _ in 0..3 {
        most = crossing(|x| Ok(size(predicted(x, 1)?.as_ref())))?;
        // again where a peak between the angles is in the way
        if size(predicted(most, ROUNDS_OF_ANGLES)?.as_ref()) >= 0.5 * most {
            break;
        }
    }
    for share in [1.0].into_iter().chain(SHARES) {
        let x = share * most;
        if let Some(found) = predicted(x, 1)?
            && x > 0.0
            && found.gamma >= 0.5 * x
            && proved(x, &found)?
        {
            return Ok(x);
        }
    }
    Ok(0.0)
}

/// Faults between the inputs that are asked for and those that act, from one response of all inputs.
struct Faults<'a> {
    of: &'a Loop,
    /// None where nothing can be proved, and where the centre is not stable.
    region: Option<Field>,
    centre: Option<Field>,
    stop: &'a Stop,
}

impl<'a> Faults<'a> {
    fn new(of: &'a Loop, stop: &'a Stop) -> Result<Self> {
        let (k, channels) = (&of.closed.k, of.inputs());
        let region = if of.free() { Field::new(&of.blocks(k, &channels), stop)? } else { None };
        let alone = Blocks::new(&of.data, k, None, &[], &channels);
        let centre = if radius(&of.closed.a0)? < 1.0 { Field::new(&alone, stop)? } else { None };
        Ok(Self { of, region, centre, stop })
    }

    /// `(1 + delta / 2) / (1 - delta / 2)` at one input, or at all.
    fn disk(&mut self, i: Option<usize>) -> Result<Margin> {
        let (which, view) = (i.map_or(Which::Each, Which::One), |_: f64, one: &Reduced| Some(one.with_own(0.5)));
        let mut channels = self.of.inputs();
        channels.iter_mut().for_each(|one| one.own[(0, 0)] = 0.5);
        let channels = i.map_or(&channels[..], |i| &channels[i..=i]);
        let found = hinted(&mut self.region, which, ROUNDS_OF_ANGLES, &view, self.stop)?;
        let of = self.of.blocks(&self.of.closed.k, channels);
        let centre = hinted(&mut self.centre, which, ROUNDS_OF_ANGLES, &view, self.stop)?;
        Ok(Margin {
            certified: certified(&of, &filled(channels.len(), 1.0), found, MOST, self.stop)?.0.gamma,
            nominal: size(centre.as_ref()).min(MOST),
        })
    }

    /// A chain of discs on a curve of factors of one input, from what is proved to `to`. A disc around the middle of a
    /// piece of length h has the radius `within(h)`.
    fn chain(
        &mut self,
        i: usize,
        (from, to): (f64, f64),
        curve: &dyn Fn(f64) -> c64,
        within: &dyn Fn(f64) -> f64,
    ) -> Result<f64> {
        let (k, mut a, least) = (&self.of.closed.k, from, PIECE.min(0.01 * to));
        let channel = [Channel::at_inputs(unit(self.of.data.m, i), row_of(k, i))];
        let piece = |a: f64, h: f64| (curve(a + 0.5 * h), within(h) + 4.0 * f64::EPSILON * (1.0 + a + h));
        let around = |kappa: c64| {
            let turned = |part: f64, rest: f64| {
                Mat::from_fn(k.nrows(), k.ncols(), |row, j| k[(row, j)] * if row == i { part } else { rest })
            };
            let im = (kappa.im != 0.0).then(|| turned(kappa.im, 0.0));
            Blocks::new(&self.of.data, &turned(kappa.re, 1.0), im.as_ref(), &self.of.closed.t, &channel)
        };
        let none = |_: f64, one: &Reduced| one.shifted(c64::ONE, c64::ZERO);
        let start = hinted(&mut self.region, Which::One(i), 1, &none, self.stop)?;
        let Some(mut t) = start.and_then(|one| one.t.first().copied()) else { return Ok(a) };
        while to - a >= least {
            self.stop.check()?;
            let mut fits = |h: f64, rounds: usize| -> Result<Option<Found>> {
                let (kappa, radius) = piece(a, h);
                let view = |_: f64, one: &Reduced| one.shifted(c64::ONE, kappa - c64::ONE);
                let found = hinted(&mut self.region, Which::One(i), rounds, &view, self.stop)?;
                Ok(found.filter(|one| SHARES[0] * one.gamma >= radius))
            };
            // again where a peak between the angles is in the way
            let mut low = least;
            for _ in 0..3 {
                let mut high = to - a;
                low = if fits(high, 1)?.is_some() { high } else { least };
                for _ in 0..if low < high { 9 } else { 0 } {
                    let middle = (low * high).sqrt();
                    *(if fits(middle, 1)?.is_some() { &mut low } else { &mut high }) = middle;
                }
                if fits(low, ROUNDS_OF_ANGLES)?.is_some() {
                    break;
                }
            }
            let (mut h, mut next) = (low, None);
            while next.is_none() && h >= least {
                let Some(found) = fits(h, 1)? else {
                    h *= 0.6;
                    continue;
                };
                let (kappa, radius) = piece(a, h);
                let proved = proof_at(&around(kappa), &[1.0], &found, radius);
                t = proved.as_ref().and_then(|(one, _)| one.t.first().copied()).unwrap_or(t);
                next = proved.map(|_| h);
                h *= if h > 0.9 * low { 0.95 } else { 0.6 };
            }
            let Some(h) = next else { break };
            a += h;
        }
        // near its end, where frequencies promise too little: proofs alone, from the multipliers of the last piece
        let mut h = (16.0 * least).min(to - a);
        while h >= least {
            self.stop.check()?;
            let (kappa, radius) = piece(a, h);
            let of = around(kappa);
            let proved = |one: &f64| {
                [1.02, 1.0005].iter().any(|slack| of.proof(&[radius], &[*one], (None, 1.0), *slack).is_some())
            };
            if let Some(one) = FACTORS.map(|by| t * by).into_iter().find(proved) {
                (t, a) = (one, a + h);
                h = (1.5 * h).min(to - a);
            } else {
                h /= 1.7;
            }
        }
        Ok(a)
    }

    /// From the gains in the disk of so much.
    fn gain(&mut self, i: usize, disk: f64) -> Result<[Margin; 2]> {
        let (data, k, half) = (&self.of.data, &self.of.closed.k, half_of(disk));
        let stable = |by: f64| Ok(radius(&data.around(&with_row(k, i, by)).0)? < 1.0);
        let far = (1.0 + half) / (1.0 - half);
        let mut found =
            [(1.0 / far, 0.0), (far, MOST)].map(|(from, end)| (from, end, Margin { certified: 1.0, nominal: 1.0 }));
        for (from, end, margin) in &mut found {
            let sign = (*end - 1.0).signum();
            margin.nominal = edge(*from, *end, stable)?;
            let ends = ((*from - 1.0).abs(), (margin.nominal - 1.0).abs());
            let far = self.chain(i, ends, &|s| c64::new(1.0 + sign * s, 0.0), &|h| 0.5 * h * (1.0 + 1e-12))?;
            margin.certified = 1.0 + sign * far;
        }
        Ok(found.map(|one| one.2))
    }

    fn phase(&mut self, i: usize, disk: f64) -> Result<Margin> {
        let (data, k, from) = (&self.of.data, &self.of.closed.k, 2.0 * half_of(disk).atan());
        let stable = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            let im = Mat::from_fn(k.nrows(), k.ncols(), |row, j| if row == i { sin * k[(row, j)] } else { 0.0 });
            Ok(radius_of_complex(&data.around(&with_row(k, i, cos)).0, &(&data.b * im))? < 1.0)
        };
        let nominal = edge(from, std::f64::consts::PI, stable)?;
        let within = |h: f64| 2.0 * (0.25 * h).sin() * (1.0 + 1e-12) + 1e-15;
        let certified = self.chain(i, (from, nominal), &|s| c64::from_polar(1.0, s), &within)?;
        Ok(Margin { certified, nominal })
    }

    fn delay(&mut self) -> Result<Margin> {
        let (of, mut found) = (self.of, Margin { certified: 0.0, nominal: 0.0 });
        let (mut proved, mut stable) = (of.free(), self.centre.is_some());
        for d in 1..=LATE {
            if !stable {
                break;
            }
            let (data, closed) = of.past(d, (0.0, 1.0))?;
            stable = radius(&closed.a0)? < 1.0;
            let late =
                |angle: f64, one: &Reduced| one.shifted(c64::ONE, c64::from_polar(1.0, -angle * d as f64) - c64::ONE);
            let likely = data.pieces.len() > 1 || self.region.as_ref().is_some_and(|field| field.stands(&late));
            if proved {
                self.stop.check()?;
                let whole = Blocks::new(&data, &closed.k, None, &of.closed.t, &[]);
                proved = stable
                    && likely
                    && (whole.alone() || judged(&data, closed, self.stop)?.0.status == Verdict::Certified);
            }
            let d = d as f64;
            found = Margin {
                certified: if proved { d } else { found.certified },
                nominal: if stable { d } else { found.nominal },
            };
        }
        Ok(found)
    }

    /// `u = (1 - d) K x + d v`, v the input asked for a step before: `K x + d / 2 (v - K x) + q`,
    /// `|q| <= d / 2 |K x - v|`.
    fn varying(&mut self) -> Result<Margin> {
        let (of, stop) = (self.of, self.stop);
        let (n, m, asked) = (of.data.n, of.data.m, of.own_gain());
        let hint = |field: &mut Option<Field>, share: f64, rounds: usize| {
            let centre = c64::new(0.5 * share, 0.0);
            let view = |angle: f64, one: &Reduced| one.shifted(c64::from_polar(1.0, -angle) - c64::ONE, centre);
            hinted(field, Which::Together, rounds, &view, stop)
        };
        let blocks = |share: f64| -> Result<Blocks> {
            let (data, closed) = of.past(1, (1.0 - 0.5 * share, 0.5 * share))?;
            let z = Mat::from_fn(m, n + m, |i, j| {
                data.unit[j] * if j < n { asked[(i, j)] } else { -f64::from(u8::from(i == j - n)) }
            });
            let channel = [Channel::at_inputs(Mat::identity(m, m), z)];
            Ok(Blocks::new(&data, &closed.k, None, &of.closed.t, &channel))
        };
        let steps = |most: f64| most.floor().clamp(1.0, LATE as f64);
        let mut found = Margin {
            certified: withstood(
                |share, rounds| hint(&mut self.region, share, rounds),
                |share, one| Ok(proof_at(&blocks(share)?, &[1.0], one, 0.5 * share).is_some()),
            )?,
            nominal: 0.0,
        };
        found.nominal = crossing(|share| Ok(size(hint(&mut self.centre, share, 1)?.as_ref())))?;
        if found.certified >= 1.0 {
            let one = hint(&mut self.region, 0.0, ROUNDS_OF_ANGLES)?;
            found.certified = steps(certified(&blocks(0.0)?, &[1.0], one, 2.0 * LATE as f64, stop)?.0.gamma);
        }
        if found.nominal >= 1.0 {
            found.nominal = steps(size(hint(&mut self.centre, 0.0, ROUNDS_OF_ANGLES)?.as_ref()));
        }
        Ok(found)
    }

    fn share(&mut self) -> Result<Margin> {
        let (of, stop, ones) = (self.of, self.stop, filled(self.of.data.m, 1.0));
        let cut = |field: &mut Option<Field>, beta: f64, rounds: usize| {
            let view = |_: f64, one: &Reduced| one.shifted(c64::ONE, c64::new(-0.5 * beta, 0.0));
            hinted(field, Which::Each, rounds, &view, stop)
        };
        let certified = withstood(
            |beta, rounds| cut(&mut self.region, beta, rounds),
            |beta, one| {
                let (k, channels) = of.cut_channels(beta);
                Ok(proof_at(&of.blocks(&k, &channels), &ones, one, 0.5 * beta).is_some())
            },
        )?;
        let nominal = crossing(|beta| Ok(size(cut(&mut self.centre, beta, 1)?.as_ref())))?;
        Ok(Margin { certified: 1.0 - certified, nominal: 1.0 - nominal })
    }
}
