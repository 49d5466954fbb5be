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
use crate::fuse::norm;
use crate::memory::{checked_len, room_for_products, try_room, try_zeros};
use crate::parallel::Stop;

use super::normal_norm::normal_quantile;
use super::nuclear::Effort;
use super::powers::{Powers, Span, product, times};
use super::symmetric::spectral_norm;

const WHAT: &str = "a certificate of several steps";

/// The ratio below which the missing directions are known to fewer than half of the digits; see `Fitted::sees`.
const TRUSTED: f64 = 1e-8;

/// Least squares and what its error is measured with; `d = n + m`, or one more with an offset.
#[derive(Debug, Clone, Copy)]
pub struct Fitted<'a> {
    /// The model `H` (n, d).
    pub model: &'a [f64],
    /// `white' white = V^+` (rank, d).
    pub white: &'a [f64],
    /// A root of `S` (n, n).
    pub root: &'a [f64],
    /// A basis of the `z` that the data do not show (columns; d, d - rank). Rows that are rounding have been set to 0.
    pub missing: &'a [f64],
    /// Smallest over largest singular value of the data with columns of unit length.
    pub ratio: f64,
    /// Number of states.
    pub n: usize,
    /// Entries of `z`.
    pub d: usize,
}

/// Gaussian noise of the run to come, independent of the data.
#[derive(Debug, Clone, Copy)]
pub struct ToCome<'a> {
    /// A root of the covariance, or of a bound of it (n, n).
    pub root: &'a [f64],
    /// The probability that the last state is off by more than what is added for it.
    pub end: f64,
    /// The same of each earlier state, and again of its effect through the model's error.
    pub before: f64,
}

/// How long to look for a better bound of the last state, and of all others.
const LAST: Effort = Effort { rounds: 10, tolerance: 1e-3 };
const OTHERS: Effort = Effort { rounds: 3, tolerance: 1e-2 };

/// What is assumed of the error.
#[derive(Debug, Clone, Copy)]
pub struct Radii<'a> {
    /// Bound of `||Gamma||_2`.
    pub spectral: f64,
    /// Bound of `||Gamma||_F`, or infinity.
    pub frobenius: f64,
    /// How far `x(0)` may be from what is given.
    pub rho0: f64,
    /// Whether the noise of the run counts: the radii must be those of `d + K` columns.
    pub noise: bool,
    /// Noise of the run besides.
    pub to_come: Option<ToCome<'a>>,
}

/// `||x(k) - states[k]|| <= radii[k]`.
#[derive(Debug, Clone)]
pub struct Steps {
    /// Of the model, (K + 1, n).
    pub states: Vec<f64>,
    /// (K + 1).
    pub radii: Vec<f64>,
    /// The first-order part (K + 1).
    pub linear: Vec<f64>,
    /// `b_k >= ||W^(1/2) e(k)||` (K + 1).
    pub rest: Vec<f64>,
    /// `||z(k)||` in the norm of `V^+` (K), infinite where the data do not determine `Theta z`.
    pub sizes: Vec<f64>,
}

impl Fitted<'_> {
    fn checked(&self) -> Result<usize> {
        let (n, d) = (self.n, self.d);
        let sized = |name, values: &[f64], len: usize| {
            if values.len() == len {
                return Ok(());
            }
            Err(Error::Shape { name, expected: format!("{len} entries"), found: values.len().to_string() })
        };
        if n == 0 || d < n {
            return Err(Error::Shape {
                name: "H",
                expected: "n x d entries, 1 <= n <= d".into(),
                found: format!("{n} x {d}"),
            });
        }
        sized("H", self.model, checked_len(WHAT, n, d)?)?;
        sized("root", self.root, checked_len(WHAT, n, n)?)?;
        let rank = self.white.len() / d;
        sized("white", self.white, rank * d)?;
        sized("missing", self.missing, d * d.saturating_sub(rank))?;
        Ok(rank)
    }

    /// Whether the data determine `Theta z`: each missing direction against the size of what is added up in it. Rounding
    /// turns these directions by `eps / ratio` (Wedin 1972). Where that is more than half of the digits, only a z that fits
    /// them as well as at [`TRUSTED`] counts as determined: in doubt the certificate is infinite.
    fn sees(&self, z: &[f64]) -> bool {
        let tolerance = 100.0 * self.d as f64 * f64::EPSILON / self.ratio.max(TRUSTED);
        let directions = self.missing.len() / self.d;
        (0..directions).all(|q| {
            let terms = || self.missing.iter().skip(q).step_by(directions).zip(z).map(|(m, z)| m * z);
            terms().sum::<f64>().abs() <= tolerance * terms().map(f64::abs).sum::<f64>()
        })
    }

    /// Whether the data determine `A`.
    fn sees_states(&self) -> bool {
        self.missing.is_empty() || {
            let directions = self.missing.len() / self.d;
            self.missing[..self.n * directions].iter().all(|m| *m == 0.0)
        }
    }
}

/// The states of the model from `x0` under `inputs` (K, d - n, or one less with an `offset`), and how far the truth may be.
///
/// # Errors
/// [`Error::Shape`], [`Error::Overflow`] for states that leave the range of doubles, [`Error::Memory`],
/// [`Error::Interrupted`].
pub fn several_steps(
    fitted: &Fitted<'_>,
    x0: &[f64],
    inputs: &[f64],
    offset: bool,
    radii: Radii<'_>,
    stop: &Stop,
) -> Result<Steps> {
    let rank = fitted.checked()?;
    let (n, d) = (fitted.n, fitted.d);
    let m = (d - n).saturating_sub(usize::from(offset));
    if x0.len() != n || m == 0 || !inputs.len().is_multiple_of(m) {
        let found = format!("{} and {} entries", x0.len(), inputs.len());
        return Err(Error::Shape { name: "x0, inputs", expected: format!("{n} entries and rows of {m}"), found });
    }
    if let Some(noise) = radii.to_come
        && noise.root.len() != n * n
    {
        let found = noise.root.len().to_string();
        return Err(Error::Shape { name: "noise to come", expected: format!("a root of {} entries", n * n), found });
    }
    room_for_products()?;
    let steps = inputs.len() / m;
    let mut a = try_room(WHAT, n * n)?;
    fitted.model.chunks_exact(d).for_each(|row| a.extend_from_slice(&row[..n]));
    let mut half = try_room(WHAT, rank * n)?; // half' half = W: as good as W^(1/2) in front of a vector
    fitted.white.chunks_exact(d).for_each(|row| half.extend_from_slice(&row[..n]));

    let mut states = try_zeros(WHAT, checked_len(WHAT, steps + 1, n)?)?;
    states[..n].copy_from_slice(x0);
    let (mut c, mut sizes) = (try_room(WHAT, checked_len(WHAT, steps, rank)?)?, try_room(WHAT, steps)?);
    let mut z = try_zeros(WHAT, d)?;
    for (k, u) in inputs.chunks_exact(m).enumerate() {
        let (done, rest) = states.split_at_mut((k + 1) * n);
        z[..n].copy_from_slice(&done[k * n..]);
        z[n..n + m].copy_from_slice(u);
        if offset {
            z[d - 1] = 1.0;
        }
        rest[..n].copy_from_slice(&product(fitted.model, &z, n, d, 1)?);
        let white = product(fitted.white, &z, rank, d, 1)?;
        sizes.push(if fitted.sees(&z) { norm(white.iter().copied()) } else { f64::INFINITY });
        c.extend(white);
    }
    if !states.iter().all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: "the model's trajectory" });
    }
    let mut lengths = try_room(WHAT, steps)?;
    lengths.extend(sizes.iter().map(|size: &f64| if radii.noise { size.hypot(1.0) } else { *size }));

    let c = Span::new(&c, steps, radii.noise, stop)?;
    let bounds = (radii.spectral, radii.frobenius);

    let known = fitted.sees_states();
    let mut outside = Powers::new(n, n, steps)?; // M_p
    let mut inside = Powers::new(rank, n, steps)?; // W^(1/2) M_p
    let mut power = try_zeros(WHAT, n * n)?;
    (0..n).for_each(|i| power[i * (n + 1)] = 1.0);
    let mut covariance = try_zeros(WHAT, n * n)?;
    let [mut linear, mut rest, mut r] =
        [try_room(WHAT, steps + 1)?, try_room(WHAT, steps + 1)?, try_room(WHAT, steps + 1)?];
    let start = |matrix: &[f64], rows: usize| -> Result<f64> {
        Ok(if radii.rho0 == 0.0 { 0.0 } else { times(radii.rho0, spectral_norm(matrix, rows, n)?) })
    };
    let seen = |value: f64| if known { value } else { f64::INFINITY };
    linear.push(0.0);
    rest.push(if radii.rho0 == 0.0 { 0.0 } else { seen(start(&half, rank)?) });
    r.push(radii.rho0);
    for k in 1..=steps {
        stop.check()?;
        outside.push(product(&power, fitted.root, n, n, n)?)?;
        inside.push(product(&half, &outside.matrices[k - 1], rank, n, n)?)?;
        let (mut omega, mut nu) = (0.0, 0.0);
        if let Some(noise) = radii.to_come {
            // N_k = sum_p (A^p root) (A^p root)'
            let moved = product(&power, noise.root, n, n, n)?;
            for (i, to) in covariance.chunks_exact_mut(n).enumerate() {
                let row = &moved[i * n..(i + 1) * n];
                let along = moved.chunks_exact(n).map(|other| row.iter().zip(other).map(|(a, b)| a * b).sum::<f64>());
                to.iter_mut().zip(along).for_each(|(to, value)| *to += value);
            }
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
        linear.push(outside.linear(&c, &lengths[..k], bounds, efforts)?);
        let back = times(radii.spectral, outside.cauchy_schwarz(&rest[..k])?);
        r.push(linear[k] + start(&power, n)? + back + omega);
        let back = times(radii.spectral, inside.cauchy_schwarz(&rest[..k])?);
        let first = inside.linear(&c, &lengths[..k], bounds, OTHERS)?;
        rest.push(seen(first + start(&product(&half, &power, rank, n, n)?, rank)? + back + nu));
    }
    Ok(Steps { states, radii: r, linear, rest, sizes })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One state, one input: everything in closed form.
    #[test]
    fn a_scalar_system() {
        let (a, b, white, s) = (0.8, 1.0, [0.1, 0.0, 0.0, 0.2], 0.5);
        let fitted = Fitted { model: &[a, b], white: &white, root: &[s], missing: &[], ratio: 1.0, n: 1, d: 2 };
        let radii = Radii { spectral: 1.5, frobenius: f64::INFINITY, rho0: 0.0, noise: false, to_come: None };
        let found = several_steps(&fitted, &[2.0], &[1.0, -1.0], false, radii, &Stop::new()).unwrap();
        let states = [2.0, 2.6, 0.8 * 2.6 - 1.0];
        let sizes = [(0.04f64 + 0.04).sqrt(), (0.26f64 * 0.26 + 0.04).sqrt()];
        // ||a c_0 + c_1|| with c_0 = (0.2, 0.2) and c_1 = (0.26, -0.2)
        let first = [0.0, 1.5 * s * sizes[0], 1.5 * s * (a * 0.2 + 0.26f64).hypot(a * 0.2 - 0.2)];
        let b1 = 0.1 * first[1];
        let r2 = first[2] + 1.5 * s * b1;
        let near = |x: f64, y: f64| assert!((x - y).abs() < 1e-14, "{x} is not {y}");
        (0..3).for_each(|k| near(found.states[k], states[k]));
        (0..2).for_each(|k| near(found.sizes[k], sizes[k]));
        (0..3).for_each(|k| near(found.linear[k], first[k]));
        near(found.rest[1], b1);
        near(found.radii[2], r2);
        // an uncertain start is multiplied by |a| each step, and seen through the model's error
        let moved = several_steps(&fitted, &[2.0], &[1.0], false, Radii { rho0: 0.3, ..radii }, &Stop::new()).unwrap();
        near(moved.radii[1], first[1] + a * 0.3 + 1.5 * s * 0.1 * 0.3);
    }

    #[test]
    fn what_the_data_do_not_show_is_infinite() {
        let (white, missing) = ([0.1, 0.0], [0.0, 1.0]); // nothing is known of B
        let fitted =
            Fitted { model: &[0.8, 1.0], white: &white, root: &[1.0], missing: &missing, ratio: 1.0, n: 1, d: 2 };
        let radii = Radii { spectral: 1.0, frobenius: 1.0, rho0: 0.0, noise: false, to_come: None };
        let found = several_steps(&fitted, &[1.0], &[0.0, 1.0], false, radii, &Stop::new()).unwrap();
        assert!(found.radii[1].is_finite() && found.radii[2] == f64::INFINITY);
        assert_eq!(found.sizes[1], f64::INFINITY);
    }
}
