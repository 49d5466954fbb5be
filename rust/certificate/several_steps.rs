//! The error of the model's trajectory over several steps, for all inputs at once, also for those chosen after the
//! data.
//!
//! In the event `||Gamma||_2 <= spectral`, `||Gamma||_F <= frobenius`, `Theta - H = -D`, `D = S^(1/2) Gamma V^(-1/2)`,
//!
//! ```text
//! e(k+1) = A e(k) + D z(k) + D_x e(k) (+ w(k))
//! ```
//!
//! with the model's `A`, or `A + B K` with feedback `u(k) + K (x(k) - xh(k))`, and `S^(1/2)` (n, q), 0 in rows that are
//! known. Of `e(k)` the first p rows are looked at, `P e(k)`; z is `(x, u)` or, with feedback, `[I; K] e(k)` for an
//! error. With `c_k = V^(-1/2) z(k)`, `M_p = A^p S^(1/2)`, `W = [I; K]' V^-1 [I; K]` and `wcs` the weighted inequality
//! of `Powers::cauchy_schwarz`:
//!
//! ```text
//! lin_k(M) >= ||sum_{j<k} M_{k-1-j} Gamma c_j||                                  see `Powers::linear`
//! b_k = lin_k(W^(1/2) M) + ||W^(1/2) A^k|| rho0 + spectral wcs(W^(1/2) M_{k-1-j}, b_j) (+ nu_k)
//! r_k = lin_k(P M)       + ||P A^k|| rho0       + spectral wcs(P M_{k-1-j}, b_j)       (+ omega_k).
//! ```
//!
//! What else bounds the first order, such as a reference, takes part in the minima; `b_k` of a step may then be
//! smaller.
//!
//! Inputs that may be off the plan by d(k), `|d(k)|_i <= phi_i(k)`, whatever they react to, add
//! `f_k >= |sum_{j<k} P A^(k-1-j) B d(j)|_i` to a bound of the components, `||f_k||` to `r_k`, and to `b_k` the same
//! with the norms of the columns of `W^(1/2) A^(k-1-j) B`, and `sum_i ||V^(-1/2) I_i|| phi_i(k)`, I_i the unit vector
//! of input i: then `b_k` bounds `||V^(-1/2) (e_k, d_k)||`.
//!
//! First order plus rest: `rest(k+1) = A rest(k) + D_x e(k)` and `||V^(-1/2) (e_j, 0)|| = ||W^(1/2) e_j|| <= b_j` by
//! induction.
//!
//! From an exact start the last term of `r_k` is also bounded by a weighted small gain, see [`super::weighted`].
//!
//! Gaussian noise to come, with what the error of the model makes of it, is apart: see [`super::carried`]. `nu_k` is 0
//! then, and `omega_k` the quantile of its bound. Near a reference it is within `b_k`: it has a covariance `<= N` and
//! is independent of the data, so that, given them, `n_k = sum_{i<k} A^(k-1-i) w(i)` is Gaussian of covariance
//! `<= N_k = sum_{p<k} A^p N A^p'`, and `||P n_k|| <= omega_k`, `||W^(1/2) n_k|| <= nu_k` with quantiles of
//! [`normal_quantile`], each with its own probability; `e_k` holds `n_k`, hence `nu_k` in `b_k`.

use crate::control::singular_values;
use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{normal_quantile, spectral_norm};
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, Region, times};

use super::carried::Carried;
use super::noise::Gaussian;
use super::nuclear::{EFFORT, Effort, WHAT};
use super::powers::{Powers, Span, product};
use super::weighted::{Followed, Weighted, growth, rates};

/// For the rounding of singular values, relative to their sum.
const ROUNDING: f64 = 1e-12;

/// How long to look for a better bound of a state before the last.
const OTHERS: Effort = Effort { rounds: 3, tolerance: 1e-2 };

/// What is assumed of the error.
#[derive(Debug, Clone, Copy)]
pub(super) struct Radii<'a> {
    /// Bound of `||Gamma||_2`.
    pub spectral: f64,
    /// Bound of `||Gamma||_F`, or infinity.
    pub frobenius: f64,
    /// How far `x(0)` may be from what is given.
    pub rho0: f64,
    /// Whether the noise of the run counts: the radii must be those of `d + K` columns.
    pub noise: bool,
    /// Noise of the run besides.
    pub to_come: Option<Gaussian<'a>>,
    /// Whether it is within `b_k`, as near a reference; else it is bounded by itself, see [`super::carried`].
    pub within: bool,
    /// Other bounds of `||sum_{j<k} P M_{k-1-j} Gamma c_j||` and of `||sum_{j<k} W^(1/2) M_{k-1-j} Gamma c_j||` (K + 1)
    /// that hold in the event; infinite where there is none.
    pub besides: [Option<&'a [f64]>; 2],
    /// How far inputs may be from those of the plan (K, m).
    pub apart: Option<&'a [f64]>,
}

/// Which rows of the error are looked at, and what acts on it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen<'a> {
    /// The first p.
    pub rows: usize,
    /// K (m, n), row by row.
    pub gain: Option<&'a [f64]>,
}

/// What several steps of a region of one part add up to, and what its components are made of.
#[derive(Debug)]
pub(super) struct Steps {
    /// `r_k` (K + 1), without `omega_k`: see [`Steps::add`].
    pub radii: Vec<f64>,
    /// The first-order part, or what bounds it besides (K + 1).
    pub linear: Vec<f64>,
    /// `spectral wcs(P M_{k-1-j}, b_j)` (K + 1).
    pub back: Vec<f64>,
    /// `b_k >= ||W^(1/2) e(k)||` (K + 1).
    pub rest: Vec<f64>,
    /// `P M_p`, p < K.
    pub outside: Powers,
    /// Coordinates of the `c_k`.
    pub span: Span,
    /// `P A^k` (p, n), k <= K.
    pub powers: Vec<Vec<f64>>,
    /// A bound of the covariance of noise to come (p, p), k <= K; 0 without noise.
    pub covariances: Vec<Vec<f64>>,
    /// Bounds of its variances (p), k <= K.
    pub variances: Vec<Vec<f64>>,
    /// Other bounds of what is not of first order in each row (K + 1, p), or infinite.
    pub later: Vec<f64>,
    /// `f_k` (K + 1, p), of inputs that may be off the plan; empty without them.
    pub pushed: Vec<f64>,
}

impl Steps {
    /// Adds the quantiles `omega_k` of noise to come.
    pub fn add(&mut self, noise: Gaussian<'_>) -> Result<()> {
        let steps = self.radii.len() - 1;
        for (k, (to, covariance)) in self.radii.iter_mut().zip(&self.covariances).enumerate().skip(1) {
            if !to.is_finite() {
                continue;
            }
            let level = if k < steps { noise.before } else { noise.end };
            *to += normal_quantile(covariance, covariance.len().isqrt(), level)?;
        }
        Ok(())
    }

    /// Bounds of `|P e(k)|_i` (K + 1, p) with Gaussian noise to come; infinite before the `first` step.
    pub fn bands(&self, radii: &Radii<'_>, first: usize, stop: &Stop) -> Result<Vec<f64>> {
        let (steps, p) = (self.radii.len() - 1, self.covariances[0].len().isqrt());
        let mut bands = try_room(WHAT, checked_len(WHAT, steps + 1, p)?)?;
        bands.resize(first * p, f64::INFINITY);
        for k in first..=steps {
            stop.check()?;
            let mut own = self.components(k, radii)?;
            if let (Some(noise), true) = (radii.to_come, k > 0) {
                noise.of_components(k == steps, &self.variances[k], &mut own)?;
            }
            bands.extend(own);
        }
        Ok(bands)
    }

    /// Bounds of `|P e(k)|_i` (p) without noise to come: the expansion of `r_k` with a row `m_j` of `M_{k-1-j}`,
    ///
    /// ```text
    /// min(frobenius ||N||_F, spectral ||N||_*) + ||(A^k)_i|| rho0 + spectral sum ||m_j|| b_j,    N = sum_j m_j' c_j'.
    /// ```
    fn components(&self, k: usize, radii: &Radii<'_>) -> Result<Vec<f64>> {
        let power = &self.powers[k];
        let p = self.covariances[k].len().isqrt();
        let (n, mut components) = (power.len() / p, try_zeros(WHAT, p)?);
        if !self.radii[k].is_finite() {
            components.fill(f64::INFINITY);
            return Ok(components);
        }
        let (c, width) = self.span.first(k)?;
        let q = self.outside.all().next().map_or(0, <[f64]>::len) / p;
        let mut all = try_zeros(WHAT, checked_len(WHAT, width, q)?)?;
        for (i, component) in components.iter_mut().enumerate() {
            // N = sum_j c_j m_j, and sum_j ||m_j|| b_j
            let mut back = 0.0;
            all.fill(0.0);
            for (p, (matrix, b)) in self.outside.all().zip(self.rest[..k].iter().rev()).enumerate() {
                let (m, c) = (&matrix[i * q..(i + 1) * q], &c[p * width..(p + 1) * width]);
                back += times(norm(m.iter().copied()), *b);
                for (to, c) in all.chunks_exact_mut(q).zip(c) {
                    to.iter_mut().zip(m).for_each(|(to, m)| *to += c * m);
                }
            }
            let (frobenius, nuclear) = norms(&all, q)?;
            let first = times(radii.frobenius, frobenius).min(times(radii.spectral, nuclear));
            let start = times(radii.rho0, norm(power[i * n..(i + 1) * n].iter().copied()));
            let pushed = self.pushed.get(k * p + i).unwrap_or(&0.0);
            let later = times(radii.spectral, back).min(self.later[k * p + i]);
            *component = first + later + start + pushed;
        }
        Ok(components)
    }
}

/// `||N||_F` and `||N||_*`, with room for its rounding.
pub(super) fn norms(matrix: &[f64], cols: usize) -> Result<(f64, f64)> {
    if matrix.is_empty() {
        return Ok((0.0, 0.0));
    }
    if !matrix.iter().all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: "a component of the error" });
    }
    let values = singular_values(matrix, cols)?;
    Ok((norm(values.iter().copied()), values.iter().sum::<f64>() * (1.0 + ROUNDING)))
}

/// `white` of a part for all entries of z (rank, d).
fn padded(part: &Part, d: usize) -> Result<Vec<f64>> {
    let mut white = try_zeros(WHAT, checked_len(WHAT, part.rank(), d)?)?;
    for (to, from) in white.chunks_exact_mut(d).zip(part.white.chunks_exact(part.columns.len().max(1))) {
        part.columns.iter().zip(from).for_each(|(j, value)| to[*j] = *value);
    }
    Ok(white)
}

/// How far the truth may be from the `states` (K + 1, n) of the centre under `inputs` (K, m), for a region of one part;
/// `root` (n, q) is one of its shape.
///
/// # Errors
/// [`Error::Overflow`] where a square leaves the range of doubles, [`Error::Memory`], [`Error::Interrupted`].
pub(super) fn several_steps(
    region: &Region,
    root: &[f64],
    states: &[f64],
    inputs: &[f64],
    radii: Radii<'_>,
    seen: Seen<'_>,
    stop: &Stop,
) -> Result<Steps> {
    room_for_products()?;
    let (part, n, d, steps) = (&region.parts[0], region.n, region.d, inputs.len() / region.m);
    let (rank, white, p, q) = (part.rank(), padded(part, d)?, seen.rows, root.len() / n);
    let joined = joined(region, seen.gain)?;
    let a = product(&region.centre, &joined, n, d, n)?;
    let half = product(&white, &joined, rank, d, n)?; // half' half = W: as good as W^(1/2) in front of a vector

    let (mut c, mut lengths) = (try_room(WHAT, checked_len(WHAT, steps, rank)?)?, try_room(WHAT, steps)?);
    for (x, u) in states.chunks_exact(n).zip(inputs.chunks_exact(region.m)) {
        let z = region.regressor(x, u)?;
        let length = part.length(&z);
        lengths.push(if radii.noise { length.hypot(1.0) } else { length });
        c.extend(product(&white, &z, rank, d, 1)?);
    }
    let span = Span::new(&c, steps, radii.noise, stop)?;
    let bounds = (radii.spectral, radii.frobenius);

    let known = match seen.gain {
        None => (0..part.columns.len()).all(|at| part.columns[at] >= n || part.unit_length(at).is_finite()),
        Some(_) => (0..n).all(|j| {
            let column = try_collect(WHAT, joined.iter().skip(j).step_by(n).copied());
            column.is_ok_and(|column| part.length(&column).is_finite())
        }),
    };
    let mut outside = Powers::new(p, q, steps)?; // P M_p
    let mut inside = Powers::new(rank, q, steps)?; // W^(1/2) M_p
    let mut power = try_zeros(WHAT, n * n)?;
    (0..n).for_each(|i| power[i * (n + 1)] = 1.0);
    let mut covariance = try_zeros(WHAT, n * n)?;
    let by = (radii.spectral, root);
    let apart = radii.to_come.filter(|_| !radii.within).map(|noise| Carried::new((&a, &half), noise.root, by, n));
    let mut carried = apart.transpose()?;
    let [mut linear, mut rest, mut r] =
        [try_room(WHAT, steps + 1)?, try_room(WHAT, steps + 1)?, try_room(WHAT, steps + 1)?];
    let mut backs = try_zeros(WHAT, steps + 1)?;
    let [mut powers, mut covariances] = [try_room(WHAT, steps + 1)?, try_room(WHAT, steps + 1)?];
    powers.push(try_copy(WHAT, &power[..p * n])?);
    covariances.push(try_zeros(WHAT, p * p)?);
    let mut variances = try_room(WHAT, steps + 1)?;
    variances.push(try_zeros(WHAT, p)?);
    let start = |matrix: &[f64], rows: usize| -> Result<f64> {
        Ok(if radii.rho0 == 0.0 { 0.0 } else { times(radii.rho0, spectral_norm(matrix, rows, n)?) })
    };
    let seen = |value: f64| if known { value } else { f64::INFINITY };
    let [outer, inner] = radii.besides;
    let besides = |of: Option<&[f64]>, k: usize| of.map_or(f64::INFINITY, |of| of[k]);
    let mut away = radii.apart.map(|apart| Away::new(region, apart, p)).transpose()?;
    linear.push(0.0);
    rest.push(
        if radii.rho0 == 0.0 { 0.0 } else { seen(start(&half, rank)?) } + away.as_ref().map_or(0.0, |of| of.at(0)),
    );
    r.push(radii.rho0);
    for k in 1..=steps {
        stop.check()?;
        let moved = product(&power, root, n, n, q)?; // M_{k-1}
        outside.push(&moved[..p * q])?;
        inside.push(&product(&half, &moved, rank, n, q)?)?;
        let mut nu = 0.0;
        if let Some(noise) = radii.to_come.filter(|_| radii.within) {
            noise.add(&power, n, &mut covariance)?; // N_k
            if k < steps && known {
                let moved = product(&half, &covariance, rank, n, n)?;
                let mut seen = try_zeros(WHAT, checked_len(WHAT, rank, rank)?)?;
                for (to, row) in seen.chunks_exact_mut(rank.max(1)).zip(moved.chunks_exact(n)) {
                    let along =
                        half.chunks_exact(n).map(|other| row.iter().zip(other).map(|(a, b)| a * b).sum::<f64>());
                    to.iter_mut().zip(along).for_each(|(to, value)| *to = value);
                }
                nu = normal_quantile(&seen, rank, noise.before)?;
            }
        }
        let (pushed, inner_push) = match &mut away {
            Some(of) => of.step(&power, &half)?,
            None => (0.0, 0.0),
        };
        power = product(&a, &power, n, n, n)?;
        if !power.iter().all(|v| v.is_finite()) {
            return Err(Error::Overflow { what: "a power of the model's A" });
        }
        let efforts = if k < steps { OTHERS } else { EFFORT };
        linear.push(outside.linear(&span, &lengths[..k], bounds, efforts, besides(outer, k))?);
        backs[k] = times(radii.spectral, outside.cauchy_schwarz(&rest[..k])?);
        r.push(linear[k] + start(&power[..p * n], p)? + backs[k] + pushed);
        let back = times(radii.spectral, inside.cauchy_schwarz(&rest[..k])?);
        let first = inside.linear(&span, &lengths[..k], bounds, OTHERS, besides(inner, k))?;
        let own = first + start(&product(&half, &power, rank, n, n)?, rank)? + back + nu + inner_push;
        rest.push(seen(own) + away.as_ref().map_or(0.0, |of| of.at(k)));
        powers.push(try_copy(WHAT, &power[..p * n])?);
        let (covariance, variance) = match &mut carried {
            Some(carried) => {
                carried.step(k == 1 || known)?;
                carried.leading(p)?
            }
            None => {
                let own = leading(&covariance, n, p)?;
                let variance = try_collect(WHAT, own.iter().step_by(p + 1).copied())?;
                (own, variance)
            }
        };
        covariances.push(covariance);
        variances.push(variance);
    }
    // from 0, and about no other first order, by a weighted small gain too
    let mut later = try_filled(WHAT, f64::INFINITY, checked_len(WHAT, steps + 1, p)?)?;
    if known && radii.rho0 == 0.0 && radii.apart.is_none() && radii.besides == [None; 2] && !radii.noise {
        let followed = Followed { a: &a, error: root, seen: &half, kernel: &inside, c: &c, radii: bounds };
        let (rates, maps) = (rates(growth(&a, n, steps)?), followed.maps(n, stop));
        if let Some(mut weighted) = Weighted::new(&followed, (n, p), &rates, None, maps, stop)? {
            for (k, rows) in later.chunks_exact_mut(p).enumerate().skip(1) {
                let whole = weighted.step(k, outside.square(k - 1), None, rows)?;
                if whole < backs[k] {
                    r[k] += whole - backs[k];
                    backs[k] = whole;
                }
            }
        }
    }
    let pushed = away.map_or_else(Vec::new, |of| of.pushed);
    Ok(Steps { radii: r, linear, back: backs, rest, outside, span, powers, covariances, variances, later, pushed })
}

/// What inputs do that may be off the plan.
struct Away<'a> {
    region: &'a Region,
    /// How far (K, m).
    apart: &'a [f64],
    /// `|P A^p B|` (p, m), and the norms of the columns of `W^(1/2) A^p B` (m), for each power so far.
    outside: Vec<Vec<f64>>,
    inside: Vec<Vec<f64>>,
    /// `f_k` so far.
    pushed: Vec<f64>,
}

impl<'a> Away<'a> {
    fn new(region: &'a Region, apart: &'a [f64], p: usize) -> Result<Self> {
        let steps = apart.len() / region.m;
        let (outside, inside) = (try_room(WHAT, steps)?, try_room(WHAT, steps)?);
        let mut pushed = try_room(WHAT, checked_len(WHAT, steps + 1, p)?)?;
        pushed.resize(p, 0.0);
        Ok(Self { region, apart, outside, inside, pushed })
    }

    /// `sum_i ||V^(-1/2) I_i|| phi_i(k)`, 0 behind the last input.
    fn at(&self, k: usize) -> f64 {
        let (part, n, m) = (&self.region.parts[0], self.region.n, self.region.m);
        let apart = self.apart.get(k * m..(k + 1) * m).unwrap_or(&[]).iter().zip(n..);
        let length = |(phi, column): (&f64, usize)| match part.columns.iter().position(|at| *at == column) {
            Some(at) => times(*phi, part.unit_length(at)),
            None => 0.0, // an entry that is known has no error
        };
        apart.map(length).sum()
    }

    /// `||f_k||`, and what is added to `b_k`, with `power` = `A^(k-1)`.
    fn step(&mut self, power: &[f64], half: &[f64]) -> Result<(f64, f64)> {
        let (n, m, d) = (self.region.n, self.region.m, self.region.d);
        let p = self.pushed.len() / (self.outside.len() + 1);
        let mut b = try_room(WHAT, checked_len(WHAT, n, m)?)?;
        self.region.centre.chunks_exact(d).for_each(|row| b.extend_from_slice(&row[n..n + m]));
        let moved = product(power, &b, n, n, m)?;
        let seen = product(half, &moved, half.len() / n, n, m)?;
        let columns = (0..m).map(|i| norm(seen.iter().skip(i).step_by(m).copied()));
        self.inside.push(try_collect(WHAT, columns)?);
        self.outside.push(try_collect(WHAT, moved[..p * m].iter().map(|v| v.abs()))?);
        let sum = |row: &[f64], phi: &[f64]| row.iter().zip(phi).map(|(a, phi)| times(*a, *phi)).sum::<f64>();
        let phis = || self.apart.chunks_exact(m);
        let f = (0..p)
            .map(|i| self.outside.iter().rev().zip(phis()).map(|(of, phi)| sum(&of[i * m..(i + 1) * m], phi)).sum());
        let f: Vec<f64> = try_collect(WHAT, f)?;
        let within = self.inside.iter().rev().zip(phis()).map(|(of, phi)| sum(of, phi)).sum();
        self.pushed.extend_from_slice(&f);
        Ok((norm(f.into_iter()), within))
    }
}

/// The first `p` rows and columns of (n, n).
fn leading(square: &[f64], n: usize, p: usize) -> Result<Vec<f64>> {
    let mut found = try_room(WHAT, p * p)?;
    square.chunks_exact(n).take(p).for_each(|row| found.extend_from_slice(&row[..p]));
    Ok(found)
}

/// `[I; K; 0]` (d, n).
fn joined(region: &Region, gain: Option<&[f64]>) -> Result<Vec<f64>> {
    let n = region.n;
    let mut joined = try_zeros(WHAT, checked_len(WHAT, region.d, n)?)?;
    (0..n).for_each(|i| joined[i * (n + 1)] = 1.0);
    if let Some(gain) = gain {
        joined[n * n..n * n + gain.len()].copy_from_slice(gain);
    }
    Ok(joined)
}
