//! The error of the model's trajectory over several steps, for all inputs at once, also for those chosen after the data.
//!
//! In the event `||Gamma||_2 <= spectral`, `||Gamma||_F <= frobenius`, `Theta - H = -D`, `D = S^(1/2) Gamma V^(-1/2)`,
//!
//! ```text
//! e(k+1) = A e(k) + D z(k) + D_x e(k) (+ w(k))
//! ```
//!
//! with the model's `A`. With `c_k = V^(-1/2) z(k)`, `M_p = A^p S^(1/2)`, `W = (V^-1)_xx` and `wcs` the weighted inequality of
//! `Powers::cauchy_schwarz`:
//!
//! ```text
//! lin_k(M) >= ||sum_{j<k} M_{k-1-j} Gamma c_j||                                  see `Powers::linear`
//! b_k = lin_k(W^(1/2) M) + ||W^(1/2) A^k|| rho0 + spectral wcs(W^(1/2) M_{k-1-j}, b_j) (+ nu_k)
//! r_k = lin_k(M)         + ||A^k|| rho0         + spectral wcs(M_{k-1-j}, b_j)         (+ omega_k).
//! ```
//!
//! First order plus rest: `rest(k+1) = A rest(k) + D_x e(k)` and `||V^(-1/2) (e_j, 0)|| = ||W^(1/2) e_j|| <= b_j` by induction.
//!
//! Gaussian noise to come of covariance `<= N` is independent of the data: given them, `n_k = sum_{i<k} A^(k-1-i) w(i)` is
//! Gaussian of covariance `<= N_k = sum_{p<k} A^p N A^p'`, so that `||n_k|| <= omega_k` and `||W^(1/2) n_k|| <= nu_k` with
//! quantiles of [`normal_quantile`], each with its own probability; `e_k` holds `n_k`, hence nu_k in b_k.

use crate::error::{Error, Result};
use crate::identify::{normal_quantile, spectral_norm};
use crate::memory::{checked_len, room_for_products, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Part, Region, times};

use super::noise::Gaussian;
use super::nuclear::Effort;
use super::nuclear::WHAT;
use super::powers::{Powers, Span, product};

/// How long to look for a better bound of the last state, and of all others.
const LAST: Effort = Effort { rounds: 10, tolerance: 1e-3 };
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
}

/// What several steps of a region of one part add up to, and what its components are made of.
#[derive(Debug)]
pub(super) struct Steps {
    /// `r_k` (K + 1).
    pub radii: Vec<f64>,
    /// The first-order part (K + 1).
    pub linear: Vec<f64>,
    /// `b_k >= ||W^(1/2) e(k)||` (K + 1).
    pub rest: Vec<f64>,
    /// `nu_k` of noise to come besides, 0 for the last (K + 1).
    pub noise: Vec<f64>,
    /// `M_p`, p < K.
    pub outside: Powers,
    /// `W^(1/2) M_p`, p < K.
    pub inside: Powers,
    /// Coordinates of the `c_k`.
    pub span: Span,
    /// `A^K` (n, n).
    pub power: Vec<f64>,
    /// `N_K` (n, n).
    pub covariance: Vec<f64>,
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
/// `root` (n, n) is one of its shape.
///
/// # Errors
/// [`Error::Overflow`] where a square leaves the range of doubles, [`Error::Memory`], [`Error::Interrupted`].
pub(super) fn several_steps(
    region: &Region,
    root: &[f64],
    states: &[f64],
    inputs: &[f64],
    radii: Radii<'_>,
    stop: &Stop,
) -> Result<Steps> {
    room_for_products()?;
    let (part, n, d, steps) = (&region.parts[0], region.n, region.d, inputs.len() / region.m);
    let (rank, white) = (part.rank(), padded(part, d)?);
    let mut a = try_room(WHAT, n * n)?;
    region.centre.chunks_exact(d).for_each(|row| a.extend_from_slice(&row[..n]));
    let mut half = try_room(WHAT, rank * n)?; // half' half = W: as good as W^(1/2) in front of a vector
    white.chunks_exact(d).for_each(|row| half.extend_from_slice(&row[..n]));

    let (mut c, mut lengths) = (try_room(WHAT, checked_len(WHAT, steps, rank)?)?, try_room(WHAT, steps)?);
    for (x, u) in states.chunks_exact(n).zip(inputs.chunks_exact(region.m)) {
        let z = region.regressor(x, u)?;
        let length = part.length(&z);
        lengths.push(if radii.noise { length.hypot(1.0) } else { length });
        c.extend(product(&white, &z, rank, d, 1)?);
    }
    let span = Span::new(&c, steps, radii.noise, stop)?;
    let bounds = (radii.spectral, radii.frobenius);

    let known = (0..part.columns.len()).all(|at| part.columns[at] >= n || part.unit_length(at).is_finite());
    let mut outside = Powers::new(n, n, steps)?; // M_p
    let mut inside = Powers::new(rank, n, steps)?; // W^(1/2) M_p
    let mut power = try_zeros(WHAT, n * n)?;
    (0..n).for_each(|i| power[i * (n + 1)] = 1.0);
    let mut covariance = try_zeros(WHAT, n * n)?;
    let [mut linear, mut rest, mut r, mut noise] = [
        try_room(WHAT, steps + 1)?,
        try_room(WHAT, steps + 1)?,
        try_room(WHAT, steps + 1)?,
        try_room(WHAT, steps + 1)?,
    ];
    noise.push(0.0);
    let start = |matrix: &[f64], rows: usize| -> Result<f64> {
        Ok(if radii.rho0 == 0.0 { 0.0 } else { times(radii.rho0, spectral_norm(matrix, rows, n)?) })
    };
    let seen = |value: f64| if known { value } else { f64::INFINITY };
    linear.push(0.0);
    rest.push(if radii.rho0 == 0.0 { 0.0 } else { seen(start(&half, rank)?) });
    r.push(radii.rho0);
    for k in 1..=steps {
        stop.check()?;
        outside.push(product(&power, root, n, n, n)?)?;
        inside.push(product(&half, &outside.matrices[k - 1], rank, n, n)?)?;
        let (mut omega, mut nu) = (0.0, 0.0);
        if let Some(noise) = radii.to_come {
            noise.add(&power, n, &mut covariance)?; // N_k
            omega = normal_quantile(&covariance, n, if k < steps { noise.before } else { noise.end })?;
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
        power = product(&a, &power, n, n, n)?;
        if !power.iter().all(|v| v.is_finite()) {
            return Err(Error::Overflow { what: "a power of the model's A" });
        }
        let efforts = if k < steps { OTHERS } else { LAST };
        linear.push(outside.linear(&span, &lengths[..k], bounds, efforts)?);
        let back = times(radii.spectral, outside.cauchy_schwarz(&rest[..k])?);
        r.push(linear[k] + start(&power, n)? + back + omega);
        let back = times(radii.spectral, inside.cauchy_schwarz(&rest[..k])?);
        let first = inside.linear(&span, &lengths[..k], bounds, OTHERS)?;
        rest.push(seen(first + start(&product(&half, &power, rank, n, n)?, rank)? + back + nu));
        noise.push(nu);
    }
    Ok(Steps { radii: r, linear, rest, noise, outside, inside, span, power, covariance })
}
