//! From a region for `Theta = [A B c]` to the error of a trajectory of its centre.
//!
//! With `D = Theta - C` and `e(k) = x(k) - xh(k)`, xh the trajectory of the centre C,
//!
//! ```text
//! e(k+1) = A e(k) + D z(k) + D_x e(k) (+ w(k)),    z = (xh, u, 1),
//! ```
//!
//! A the state matrix of C and `D_x` the first columns of D. What follows holds for all inputs at once, also for those
//! chosen after the data, in the event that Theta is in the region.

use crate::error::{Error, Result};
use crate::fuse::norm;
use crate::identify::{covariance_root, normal_quantile, spectral_norm};
use crate::memory::{checked_len, room_for_products, try_collect, try_copy, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Region, times};

use super::noise::{Gaussian, ToCome};
use super::nuclear::WHAT;
use super::powers::product;
use super::several_steps::{Radii, Seen, Steps, several_steps};

/// `||x(k) - states[k]|| <= radii[k]`, `|x(k) - states[k]|_i <= bands[k, i]`.
///
/// With Gaussian noise to come the bands are a statement of their own.
#[derive(Debug, Clone)]
pub struct Errors {
    /// Of the centre, (K + 1, n).
    pub states: Vec<f64>,
    /// (K + 1).
    pub radii: Vec<f64>,
    /// (K + 1, n); infinite but for the last where no others were asked for.
    pub bands: Vec<f64>,
    /// For a region of one part: the part of `radii` that is of first order, and `b_k >= ||e(k)||` in the norm of
    /// `V^-1` (K + 1); empty for others, or where a square overflows.
    pub linear: Vec<f64>,
    /// See `linear`.
    pub rest: Vec<f64>,
}

impl Errors {
    fn unbounded(states: Vec<f64>, n: usize, rho0: f64) -> Result<Self> {
        let mut radii = try_filled(WHAT, f64::INFINITY, states.len() / n)?;
        radii[0] = rho0;
        let mut bands = try_filled(WHAT, f64::INFINITY, states.len())?;
        bands[..n].fill(rho0);
        Ok(Self { states, radii, bands, linear: Vec::new(), rest: Vec::new() })
    }

    /// The band of the last state (n).
    pub fn components(&self) -> &[f64] {
        &self.bands[self.bands.len() - self.bands.len() / self.radii.len()..]
    }
}

/// The states (K + 1, n) of the centre from `x0` under `inputs` (K, m).
///
/// # Errors
/// [`Error::Shape`], [`Error::Overflow`], [`Error::Memory`].
pub fn states(region: &Region, x0: &[f64], inputs: &[f64]) -> Result<Vec<f64>> {
    let (n, m, d) = (region.n, region.m, region.d);
    if x0.len() != n || inputs.is_empty() || !inputs.len().is_multiple_of(m) {
        let found = format!("{} and {} entries", x0.len(), inputs.len());
        return Err(Error::Shape { name: "x0, inputs", expected: format!("{n} entries and rows of {m}"), found });
    }
    room_for_products()?;
    let mut states = try_room(WHAT, checked_len(WHAT, inputs.len() / m + 1, n)?)?;
    states.extend_from_slice(x0);
    for (k, u) in inputs.chunks_exact(m).enumerate() {
        let z = region.regressor(&states[k * n..(k + 1) * n], u)?;
        states.extend(product(&region.centre, &z, n, d, 1)?);
    }
    if !states.iter().all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: "the model's trajectory" });
    }
    Ok(states)
}

/// The inputs (K, m) of the centre under `u(k) + K (x(k) - planned(k))` from x0, for a plan with other states (K + 1,
/// n): about these inputs and the states they lead to, the feedback is the same.
///
/// # Errors
/// [`Error::Shape`], [`Error::Overflow`], [`Error::Memory`].
pub fn followed(region: &Region, x0: &[f64], inputs: &[f64], planned: &[f64], gain: &[f64]) -> Result<Vec<f64>> {
    let (n, m, d) = (region.n, region.m, region.d);
    let steps = inputs.len() / m;
    if x0.len() != n || inputs.len() != steps * m || planned.len() != (steps + 1) * n || gain.len() != m * n {
        let found = format!("{} and {} entries", x0.len(), planned.len());
        return Err(Error::Shape {
            name: "x0, planned",
            expected: format!("{n} and {} entries", (steps + 1) * n),
            found,
        });
    }
    room_for_products()?;
    let (mut at, mut made) = (try_copy(WHAT, x0)?, try_copy(WHAT, inputs)?);
    for (u, xh) in made.chunks_exact_mut(m).zip(planned.chunks_exact(n)) {
        for (to, row) in u.iter_mut().zip(gain.chunks_exact(n)) {
            *to += row.iter().zip(at.iter().zip(xh)).map(|(k, (x, xh))| k * (x - xh)).sum::<f64>();
        }
        at = product(&region.centre, &region.regressor(&at, u)?, n, d, 1)?;
    }
    if !made.iter().chain(&at).all(|v| v.is_finite()) {
        return Err(Error::Overflow { what: "the model's trajectory" });
    }
    Ok(made)
}

/// The errors under `inputs` (K, m) from an x0 known up to `rho0`. They include the noise that the region covers, or
/// that of `to_come`; where a square overflows they are infinite. With `every`, bands of every step.
///
/// # Errors
/// [`Error::Shape`], [`Error::Overflow`] for states of the centre that leave the range of doubles, [`Error::Value`] for
/// levels outside (0, 1), [`Error::Memory`], [`Error::Interrupted`].
pub fn trajectory(
    region: &Region,
    x0: &[f64],
    inputs: &[f64],
    rho0: f64,
    to_come: Option<ToCome<'_>>,
    (every, stop): (bool, &Stop),
) -> Result<Errors> {
    let n = region.n;
    let to_come = to_come.map(|noise| noise.checked(n)).transpose()?;
    let at = states(region, x0, inputs)?;
    let found = if region.parts.len() == 1 && region.parts[0].rows.len() == n {
        one_part(region, &at, inputs, rho0, to_come, (every, stop))
    } else {
        by_rows(region, &at, inputs, rho0, to_come, stop)
    };
    match found {
        Ok(found) if !found.radii.iter().chain(&found.bands).any(|r| r.is_nan()) => Ok(Errors { states: at, ..found }),
        Ok(_) | Err(Error::Overflow { .. }) => Errors::unbounded(at, n, rho0),
        Err(error) => Err(error),
    }
}

/// `D = S^(1/2) Gamma V^(-1/2)` with bounds of both norms of Gamma: see [`super::several_steps`].
fn one_part(
    region: &Region,
    at: &[f64],
    inputs: &[f64],
    rho0: f64,
    to_come: Option<ToCome<'_>>,
    (every, stop): (bool, &Stop),
) -> Result<Errors> {
    let (part, n, steps) = (&region.parts[0], region.n, inputs.len() / region.m);
    let order = part.rows.iter().enumerate().all(|(at, row)| at == *row);
    if !order {
        return Err(Error::Shape {
            name: "rows",
            expected: "0, 1, .. of a part of all rows".into(),
            found: "others".into(),
        });
    }
    let mut radii = Radii {
        spectral: part.factor.sqrt(),
        frobenius: region.frobenius(),
        rho0,
        noise: region.future,
        to_come: None,
        within: false,
        besides: [None; 2],
        apart: None,
    };
    let own;
    let mut added = None;
    let root = match to_come {
        // ||[X, W]||^2 <= ||X||^2 + ||W||^2, in both norms
        Some(ToCome::Sized { radius, root }) if steps > 1 => {
            radii.frobenius = radii.frobenius.hypot((n.min(steps) as f64).sqrt() * radius);
            radii.spectral = radii.spectral.hypot(radius);
            radii.noise = true;
            root
        }
        other => {
            match other {
                Some(ToCome::Sized { radius, root }) => added = Some((radius, root)),
                Some(ToCome::Gaussian(noise)) => radii.to_come = Some(noise),
                None => {}
            }
            own = covariance_root(&part.shape, n)?;
            &own
        }
    };
    let mut found = several_steps(region, root, at, inputs, radii, Seen { rows: n, gain: None }, stop)?;
    if let Some(noise) = radii.to_come {
        found.add(noise)?;
    }
    let mut bands = found.bands(&radii, if every { 0 } else { steps }, stop)?;
    let Steps { radii: mut r, linear, rest, .. } = found;
    if let (Some((radius, root)), true) = (added, r[steps].is_finite()) {
        r[steps] += times(radius, spectral_norm(root, n, n)?);
        let rows = root.chunks_exact(n).map(|row| times(radius, norm(row.iter().copied())));
        bands[steps * n..].iter_mut().zip(rows).for_each(|(to, row)| *to += row);
    }
    Ok(Errors { states: Vec::new(), radii: r, bands, linear, rest })
}

/// `|D z|_i <= c_i(z)` and `|D_x e|_i <= s_i ||e||` for regions of several parts.
///
/// Unrolled, `e(k) = A^k e(0) + sum_{j<k} A^(k-1-j) (D z(j) + D_x e(j) + w(j))`, so that by induction `r_k`, the
/// smaller of the norm of
///
/// ```text
/// E_k = |(A^k)_i| rho0 + sum_{j<k} |A^(k-1-j)| (c(z(j)) + s r_j + omega)
/// ```
///
/// (componentwise) and the same with norms throughout, is a bound of `||e(k)||`; omega bounds noise of known size, the
/// quantile of Gaussian noise is added to `r_k`.
fn by_rows(
    region: &Region,
    at: &[f64],
    inputs: &[f64],
    rho0: f64,
    to_come: Option<ToCome<'_>>,
    stop: &Stop,
) -> Result<Errors> {
    let (n, d, steps) = (region.n, region.d, inputs.len() / region.m);
    let mut pushes = try_room(WHAT, checked_len(WHAT, steps, n)?)?; // c(z(j)), later with s r_j + omega
    for (x, u) in at.chunks_exact(n).zip(inputs.chunks_exact(region.m)) {
        pushes.extend(region.component_bounds(&region.regressor(x, u)?)?);
    }
    let sizes = try_collect(WHAT, pushes.chunks_exact(n).map(|c| norm(c.iter().copied())))?;
    let spreads = region.row_spreads(0, n)?;
    let spread = norm(spreads.iter().copied());
    let (mut omega, mut size, mut noise) = (try_zeros(WHAT, n)?, 0.0, None::<Gaussian<'_>>);
    match to_come {
        Some(ToCome::Sized { radius, root }) => {
            omega.iter_mut().zip(root.chunks_exact(n)).for_each(|(to, row)| *to = radius * norm(row.iter().copied()));
            size = radius * spectral_norm(root, n, n)?;
        }
        Some(ToCome::Gaussian(gaussian)) => noise = Some(gaussian),
        None => {}
    }
    let mut a = try_room(WHAT, n * n)?;
    region.centre.chunks_exact(d).for_each(|row| a.extend_from_slice(&row[..n]));
    let mut powers: Vec<Vec<f64>> = try_room(WHAT, steps + 1)?;
    let mut power = try_zeros(WHAT, checked_len(WHAT, n, n)?)?;
    (0..n).for_each(|i| power[i * (n + 1)] = 1.0);
    let mut covariance = try_zeros(WHAT, n * n)?;
    let mut norms = try_room(WHAT, steps + 1)?;
    norms.push(1.0);
    powers.push(power);
    let (mut r, mut components) = (try_room(WHAT, steps + 1)?, try_zeros::<f64>(WHAT, n)?);
    r.push(rho0);
    let mut bands = try_room(WHAT, checked_len(WHAT, steps + 1, n)?)?;
    bands.extend((0..n).map(|_| rho0));
    for k in 1..=steps {
        stop.check()?;
        let before = r[k - 1];
        let push = pushes[(k - 1) * n..k * n].iter_mut();
        push.zip(&spreads).zip(&omega).for_each(|((to, s), omega)| *to += times(before, *s) + omega);
        if let Some(noise) = noise {
            noise.add(&powers[k - 1], n, &mut covariance)?;
        }
        let next = product(&a, &powers[k - 1], n, n, n)?;
        if !next.iter().all(|v| v.is_finite()) {
            return Err(Error::Overflow { what: "a power of the model's A" });
        }
        norms.push(spectral_norm(&next, n, n)?);
        for (i, component) in components.iter_mut().enumerate() {
            let through = |(power, push): (&Vec<f64>, &[f64])| -> f64 {
                power[i * n..(i + 1) * n].iter().zip(push).map(|(a, push)| times(a.abs(), *push)).sum()
            };
            let sum: f64 = powers.iter().rev().zip(pushes.chunks_exact(n)).map(through).sum();
            *component = sum + times(rho0, norm(next[i * n..(i + 1) * n].iter().copied()));
        }
        let along = |(j, c): (usize, &f64)| times(norms[k - 1 - j], c + times(r[j], spread) + size);
        let whole = times(norms[k], rho0) + sizes[..k].iter().enumerate().map(along).sum::<f64>();
        let bound = norm(components.iter().copied()).min(whole);
        components.iter_mut().for_each(|component| *component = component.min(bound));
        bands.extend_from_slice(&components);
        let quantile = match noise {
            Some(noise) => {
                let variances = try_collect(WHAT, covariance.iter().step_by(n + 1).copied())?;
                noise.of_components(k == steps, &variances, &mut bands[k * n..])?;
                normal_quantile(&covariance, n, if k == steps { noise.end } else { noise.before })?
            }
            None => 0.0,
        };
        r.push(bound + quantile);
        powers.push(next);
    }
    Ok(Errors { states: Vec::new(), radii: r, bands, linear: Vec::new(), rest: Vec::new() })
}
