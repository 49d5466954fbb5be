//! Gains: least squares of the centre, the widest margin, and the least guaranteed cost, by one doubling.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

use crate::error::{Error, Result};
use crate::matrix::MatrixView;
use crate::memory::{covered, room_for_products};
use crate::parallel::Stop;
use crate::region::Region;

use super::data::{Closed, Matrix, Uncertain, WHAT, entries, finite, in_units, largest, matrix, symmetric};
use super::doubling::limit;
use super::loops::{best_of, bytes};
use super::norm::proof;
use super::riccati::regulator;
use super::spectrum::{self, radius};

/// The sizes for which a gain of the widest margin is proved, as factors, one after the other.
const SLACKS: [f64; 4] = [1.0005, 1.005, 1.05, 1.5];

/// A gain `u = K x`, with the matrix of its cost `x'Px` or bound.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Gain {
    /// K (m, n).
    pub gain: Vec<f64>,
    /// P (n, n); of [`widest`] nothing.
    pub cost: Option<Vec<f64>>,
    /// What was chosen: the multiplier tau of [`guaranteed`], the widest margin of [`widest`].
    pub parameter: f64,
    n: usize,
}

/// K (m, n).
impl<'a> From<&'a Gain> for MatrixView<'a> {
    fn from(of: &'a Gain) -> Self {
        Self::of(&of.gain, of.n)
    }
}

/// The eigenvalues of `A + B K` as pairs; A (n, n), B (n, m), K (m, n).
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Numerical`], [`Error::Memory`].
pub fn eigenvalues<'a>(
    a: impl Into<MatrixView<'a>>,
    b: impl Into<MatrixView<'a>>,
    k: impl Into<MatrixView<'a>>,
) -> Result<Vec<(f64, f64)>> {
    let (a, b) = (a.into(), b.into());
    let (n, m) = b.shape();
    let (a, b, k) = (a.finite("A", n, n)?, b.finite("B", n, m)?, k.into().finite("K", m, n)?);
    room_for_products()?;
    covered(WHAT, bytes(n, n + m), || {
        let own = matrix(&a, n, n) + matrix(&b, n, m) * matrix(&k, m, n);
        let mut found = Vec::new();
        found.extend(spectrum::eigenvalues(&own)?.iter().map(|value| (value.re, value.im)));
        Ok(found)
    })?
}

fn weights<'a>(name: &'static str, values: impl Into<MatrixView<'a>>, size: usize) -> Result<Matrix> {
    Ok(symmetric(&matrix(&values.into().finite(name, size, size)?, size, size)))
}

fn refused(what: &str) -> Error {
    Error::Numerical(format!("no gain was found: {what}"))
}

/// The gain that minimises `sum_k x'Qx + u'Ru`, Q >= 0, R > 0, for `A` (n, n), `B` (n, m), with `P` and
/// `K = -(R + B'PB)^-1 B'PA`.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Value`] for an R that is not positive definite, [`Error::NoGain`]
/// with the cause, [`Error::Memory`], [`Error::Interrupted`].
pub fn least_squares<'a>(
    a: impl Into<MatrixView<'a>>,
    b: impl Into<MatrixView<'a>>,
    q: impl Into<MatrixView<'a>>,
    r: impl Into<MatrixView<'a>>,
    stop: &Stop,
) -> Result<Gain> {
    let (a, b) = (a.into(), b.into());
    let (n, m) = b.shape();
    let (a, b) = (a.finite("A", n, n)?, b.finite("B", n, m)?);
    room_for_products()?;
    covered(WHAT, bytes(n, n + m), || {
        let (a, b) = (matrix(&a, n, n), matrix(&b, n, m));
        let (q, r) = (weights("Q", q, n)?, weights("R", r, m)?);
        let (p, k) = regulator(&a, &b, &q, &r, stop)?;
        Ok(Gain { gain: entries(&k), cost: Some(entries(&p)), parameter: 0.0, n })
    })?
}

/// The game with `Pi` (n + m): cost `z'Pi z` against disturbances with `G0 = B Piuu^-1 B' - s S`, in the units of
/// `data`: `K = N - (Piuu + B'P~B)^-1 B'P~ (A + B N)`, `N = -Piuu^-1 Piux`, `P~ = P (I - s S P)^-1`, where
/// `I - s D'PD > 0`.
fn game(data: &Uncertain, pi: &Matrix, s: f64) -> Option<(Matrix, Matrix)> {
    let (n, m) = (data.n, data.m);
    let block = |i: usize, j: usize, rows: usize, cols: usize| Mat::from_fn(rows, cols, |p, q| pi[(i + p, j + q)]);
    let (xx, ux, uu) = (block(0, 0, n, n), block(n, 0, m, n), block(n, n, m, m));
    let inputs = uu.llt(Side::Lower).ok()?;
    let own = -inputs.solve(&ux);
    let (h, a) = (symmetric(&(xx + ux.transpose() * &own)), &data.a + &data.b * &own);
    let mut d = Mat::<f64>::zeros(n, n);
    let piece = data.pieces.first()?;
    for (i, row) in piece.rows.iter().enumerate() {
        (0..piece.rows.len()).for_each(|j| d[(*row, j)] = piece.root[(i, j)]);
    }
    let spread = &d * d.transpose() * faer::Scale(s);
    let g = symmetric(&(&data.b * inputs.solve(data.b.transpose()) - &spread));
    let sound = |p: &Matrix| {
        let room = Mat::<f64>::identity(n, n) - d.transpose() * p * &d * faer::Scale(s);
        symmetric(&room).llt(Side::Lower).is_ok()
    };
    let p = limit(&a, &g, &h, sound)?;
    let worst = (Mat::<f64>::identity(n, n) - &p * &spread).partial_piv_lu().solve(&p);
    let k = own - (&uu + data.b.transpose() * &worst * &data.b).partial_piv_lu().solve(data.b.transpose() * &worst * a);
    (finite(&k) && radius(&(&data.a + &data.b * &k)).is_ok_and(|size| size < 1.0)).then_some((p, k))
}

/// `W'W` of the only part at (x, u), if all directions are determined.
fn information(data: &Uncertain) -> Result<(Matrix, f64)> {
    let complete =
        data.region.parts.iter().all(|part| (0..part.columns.len()).all(|at| part.unit_length(at).is_finite()));
    let [piece] = data.pieces.as_slice() else {
        return Err(refused("this needs a region of one part for all rows"));
    };
    if !(complete && piece.rho.is_finite()) {
        return Err(refused("the data do not determine the system"));
    }
    if data.region.parts.iter().any(|part| (data.n..data.n + data.m).any(|j| !part.columns.contains(&j))) {
        return Err(refused("this needs a system none of whose input columns is known"));
    }
    let all = piece.w.transpose() * &piece.w;
    Ok((Mat::from_fn(data.n + data.m, data.n + data.m, |i, j| all[(i, j)]), piece.rho))
}

fn in_own_units(data: &Uncertain, p: Option<&Matrix>, k: &Matrix, parameter: f64) -> Gain {
    let back = data.back();
    let cost = p.map(|p| entries(&in_units(p, &back, &back)));
    let mut gain = entries(k);
    gain.iter_mut().enumerate().for_each(|(at, v)| *v *= back[at % data.n]);
    Gain { gain, cost, parameter, n: data.n }
}

/// The gain for nearly the largest region, at 9/10 of it, and how many times larger than `region` that may be: 0 where
/// nothing is proved, and the gain is that of the centre alone.
///
/// # Errors
/// [`Error::Numerical`] where no gain is found, [`Error::Memory`], [`Error::Interrupted`].
pub fn widest(region: &Region, stop: &Stop) -> Result<Gain> {
    room_for_products()?;
    covered(WHAT, bytes(region.n, region.d), || {
        let data = Uncertain::new(region)?;
        let (pi, rho) = information(&data)?;
        // accepted where the analysis agrees: of states that nearly depend on each other, as in a long window, rounding
        // asks for more room, a thousandth of the slack
        let at = |by: f64| {
            let (_, k) = game(&data, &pi, (by * rho).powi(2))?;
            let closed = Closed::new(&data, k.clone());
            SLACKS.iter().any(|s| proof(&data, &closed, 1.0, by / (s * s), *s).0.is_some()).then_some(k)
        };
        let (mut low, mut high) = (1.0, f64::INFINITY);
        while low > 1e-12 && at(low).is_none() {
            stop.check()?;
            (low, high) = (low / 4.0, low);
        }
        while high.is_infinite() && low < 1e12 {
            stop.check()?;
            if at(4.0 * low).is_some() { low *= 4.0 } else { high = 4.0 * low }
        }
        while high.is_finite() && high > low * 1.0005 {
            stop.check()?;
            let middle = (low * high).sqrt();
            if at(middle).is_some() { low = middle } else { high = middle }
        }
        if let Some(k) = at(0.9 * low).or_else(|| at(0.5 * low)) {
            return Ok(in_own_units(&data, None, &k, low));
        }
        // nothing is proved: least squares of the centre in the units of the data
        let (_, k) = game(&data, &pi, 0.0).ok_or_else(|| refused("the iteration found no stabilising gain"))?;
        Ok(in_own_units(&data, None, &k, 0.0))
    })?
}

/// `1 / Q_ii` of all states with a weight; of none those of `V^-1` of the data. Their units are those of `1 / P_ii`.
fn sizes(q: &Matrix, information: &Matrix) -> Vec<f64> {
    let mut sizes = Vec::new();
    sizes.extend((0..q.nrows()).map(|i| if q[(i, i)] > 0.0 { 1.0 / q[(i, i)] } else { 0.0 }));
    if sizes.iter().all(|size| *size == 0.0) {
        (0..q.nrows()).for_each(|i| sizes[i] = 1.0 / information[(i, i)]);
    }
    sizes
}

/// The gain with the least `sum_i P_ii / Q_ii`, over states with a weight, of all P with `sum_k x'Qx + u'Ru <= x0'P x0`
/// for every member, by a quadratic function; for a given multiplier `tau` that of this one. Petersen and McFarlane
/// (1994) for a region from data.
///
/// # Errors
/// As [`least_squares`] and [`widest`].
pub fn guaranteed<'a>(
    region: &Region,
    q: impl Into<MatrixView<'a>>,
    r: impl Into<MatrixView<'a>>,
    tau: Option<f64>,
    stop: &Stop,
) -> Result<Gain> {
    let (n, m) = (region.n, region.m);
    room_for_products()?;
    covered(WHAT, bytes(n, region.d), || {
        let data = Uncertain::new(region)?;
        let (pi, rho) = information(&data)?;
        let (q, r) = (in_units(&weights("Q", q, n)?, &data.unit, &data.unit), weights("R", r, m)?);
        let (nominal, _) = regulator(&data.a, &data.b, &q, &r, stop)?;
        let at = |tau: f64| {
            let mut whole = &pi * faer::Scale(tau * rho * rho);
            for i in 0..n + m {
                for j in 0..n + m {
                    whole[(i, j)] += match (i < n, j < n) {
                        (true, true) => q[(i, j)],
                        (false, false) => r[(i - n, j - n)],
                        _ => 0.0,
                    };
                }
            }
            let (p, k) = game(&data, &whole, 1.0 / tau)?;
            let (proved, _) = proof(&data, &Closed::new(&data, k.clone()), 1.0, 1.0, 1.0005);
            proved.map(|_| (p, k))
        };
        let sizes = sizes(&q, &pi);
        let size = |p: &Matrix| (0..n).map(|i| p[(i, i)] * sizes[i]).sum::<f64>();
        let none = || refused("no gain has a cost that is guaranteed for this region");
        let tau = match tau {
            Some(tau) => tau,
            None => {
                let spread = &data.pieces[0].root;
                let own = Mat::from_fn(spread.nrows(), n, |i, j| {
                    (0..spread.nrows()).map(|q| spread[(q, i)] * nominal[(data.pieces[0].rows[q], j)]).sum::<f64>()
                });
                let seen = Mat::from_fn(spread.nrows(), spread.nrows(), |i, j| {
                    (0..spread.nrows()).map(|q| own[(i, data.pieces[0].rows[q])] * spread[(q, j)]).sum::<f64>()
                });
                let start = largest(&symmetric(&seen))?.max(f64::MIN_POSITIVE).log10();
                let log = best_of(start, start + 12.0, 48, |log| {
                    if stop.requested() { None } else { at(10f64.powf(log)).map(|(p, _)| size(&p)) }
                });
                stop.check()?;
                10f64.powf(log.ok_or_else(none)?)
            }
        };
        let (p, k) = at(tau).ok_or_else(none)?;
        Ok(in_own_units(&data, Some(&p), &k, tau))
    })?
}
