//! The certificate of a plan: how far the true system ends from its target, from what one or several regions say.

use crate::control::singular_values;
use crate::error::{Error, Result};
use crate::fuse::{distance, norm};
use crate::identify::spectral_norm;
use crate::memory::{try_collect, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Region, times};

use super::noise::ToCome;
use super::nuclear::WHAT;
use super::trajectory::{Errors, trajectory};

/// Where a plan begins and ends.
#[derive(Debug, Clone, Copy)]
pub struct Endpoints<'a> {
    /// The initial state (n).
    pub x0: &'a [f64],
    /// How far the true one may be from it.
    pub rho0: f64,
    /// The target (n).
    pub xf: &'a [f64],
    /// The predicted states (K + 1, n), around which there is the tube.
    pub predicted: &'a [f64],
}

/// A region that holds in the event of the certificate, and the inputs in the form that it takes.
#[derive(Debug, Clone, Copy)]
pub struct Way<'a> {
    /// Of single steps, or of all steps at once.
    pub region: &'a Region,
    /// (K, m), or all in one row.
    pub inputs: &'a [f64],
    /// Noise to come that is not in the region.
    pub to_come: Option<ToCome<'a>>,
    /// Whether it is asked how far the control is from the best one: a region of all steps at once.
    pub compares: bool,
}

/// How far a control is from the best one of the true system.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum ControlError {
    /// At most so far; may be infinite.
    Within(f64),
    /// There are more inputs than states, so that many controls are as good.
    Many,
    /// Within the error of the data some inputs may have no effect.
    NoEffect,
}

/// What holds in one event.
#[derive(Debug, Clone)]
#[non_exhaustive]
#[must_use]
pub struct Plan {
    /// The way of the smallest `target`.
    pub best: usize,
    /// `||x(K) - xf|| <= target <= reach + model_error + start`.
    pub target: f64,
    /// `||xh(K) - xf||`.
    pub reach: f64,
    /// What the error of the model adds, with that of noise to come.
    pub model_error: f64,
    /// What an uncertain x0 adds.
    pub start: f64,
    /// `|x(K) - xf|_i <= components[i]` (n).
    pub components: Vec<f64>,
    /// `||x(k) - predicted[k]|| <= tube[k]` (K + 1).
    pub tube: Vec<f64>,
    /// `|x(k) - predicted[k]|_i <= bands[k, i]` (K + 1, n); empty where they were not asked for.
    pub bands: Vec<f64>,
    /// Of the ways that compare, the smallest; `None` if there are none.
    pub control: Option<ControlError>,
}

/// The certificate from all `ways`, of which each holds: the smallest target, and the smallest radius and component of
/// any. Components of a region by rows, `apart`, are a statement of their own and replace the others. With `every`,
/// bands too.
///
/// # Errors
/// As [`trajectory`].
pub fn certify(
    task: Endpoints<'_>,
    ways: &[Way<'_>],
    apart: Option<Way<'_>>,
    (every, stop): (bool, &Stop),
) -> Result<Plan> {
    let n = task.xf.len();
    if n == 0 || task.x0.len() != n || !task.predicted.len().is_multiple_of(n) || task.predicted.len() < 2 * n {
        let found = format!("{}, {} and {} entries", task.x0.len(), n, task.predicted.len());
        return Err(Error::Shape { name: "x0, xf, predicted", expected: "n, n and (K + 1) n entries".into(), found });
    }
    let mut all: Option<Plan> = None;
    for (index, way) in ways.iter().enumerate() {
        let found = one_way(task, way, index, (every, stop))?;
        all = Some(match all {
            None => found,
            Some(before) => smaller(before, found),
        });
    }
    let Some(mut all) = all else {
        return Err(Error::Shape { name: "ways", expected: "at least one region".into(), found: "none".into() });
    };
    if let Some(way) = apart {
        let errors = trajectory(way.region, task.x0, way.inputs, task.rho0, way.to_come, (false, stop))?;
        all.components = components(&errors, task.xf)?;
        if every {
            all.bands = around(&errors, task)?;
        }
    }
    Ok(all)
}

/// `|xh(K) - xf|_i` and the error of the component.
fn components(errors: &Errors, xf: &[f64]) -> Result<Vec<f64>> {
    let end = &errors.states[errors.states.len() - xf.len()..];
    try_collect(WHAT, end.iter().zip(xf).zip(errors.components()).map(|((x, xf), error)| (x - xf).abs() + error))
}

/// The bands around the predicted states; a region of all steps at once says nothing between.
fn around(errors: &Errors, task: Endpoints<'_>) -> Result<Vec<f64>> {
    let n = task.xf.len();
    let each = (task.predicted.len() / n - 1) / (errors.radii.len() - 1);
    let mut bands = try_filled(WHAT, f64::INFINITY, task.predicted.len())?;
    for (k, (state, own)) in errors.states.chunks_exact(n).zip(errors.bands.chunks_exact(n)).enumerate() {
        let at = k * each * n..(k * each + 1) * n;
        for ((to, x), (centre, error)) in
            bands[at.clone()].iter_mut().zip(&task.predicted[at]).zip(state.iter().zip(own))
        {
            *to = error + (centre - x).abs();
        }
    }
    Ok(bands)
}

/// What both say, which hold at once.
fn smaller(before: Plan, mut found: Plan) -> Plan {
    let least = |to: &mut [f64], other: &[f64]| to.iter_mut().zip(other).for_each(|(to, other)| *to = to.min(*other));
    least(&mut found.components, &before.components);
    least(&mut found.tube, &before.tube);
    least(&mut found.bands, &before.bands);
    found.control = match (before.control, found.control) {
        (Some(ControlError::Within(a)), Some(ControlError::Within(b))) => Some(ControlError::Within(a.min(b))),
        (Some(ControlError::Within(a)), Some(_)) if a.is_finite() => Some(ControlError::Within(a)),
        (None | Some(_), Some(ControlError::Within(b))) if b.is_finite() => Some(ControlError::Within(b)),
        (before, found) => before.or(found),
    };
    if found.target < before.target {
        return found;
    }
    Plan { components: found.components, tube: found.tube, bands: found.bands, control: found.control, ..before }
}

fn one_way(task: Endpoints<'_>, way: &Way<'_>, index: usize, (every, stop): (bool, &Stop)) -> Result<Plan> {
    let (n, region) = (task.xf.len(), way.region);
    let errors = trajectory(region, task.x0, way.inputs, task.rho0, way.to_come, (every, stop))?;
    let (steps, all) = (errors.radii.len() - 1, task.predicted.len() / n - 1);
    if !all.is_multiple_of(steps) {
        let (expected, found) = (format!("a number of steps that divides {all}"), steps.to_string());
        return Err(Error::Shape { name: "inputs", expected, found });
    }
    let whole = errors.radii[steps];
    let mut alone = whole;
    if task.rho0 > 0.0 && whole.is_finite() {
        alone = trajectory(region, task.x0, way.inputs, 0.0, way.to_come, (false, stop))?.radii[steps];
    }
    // a region of all steps at once says nothing between
    let mut tube = try_filled(WHAT, f64::INFINITY, all + 1)?;
    let each = errors.states.chunks_exact(n).zip(&errors.radii).enumerate();
    for (k, (state, radius)) in each {
        let at = k * (all / steps);
        tube[at] = radius + distance(state, &task.predicted[at * n..(at + 1) * n]);
    }
    let (end, predicted) = (&errors.states[steps * n..], &task.predicted[all * n..]);
    // the centre may lead elsewhere than what was predicted: the parts add up to the target all the same
    let (target, start) = (distance(end, task.xf) + whole, if whole.is_finite() { whole - alone } else { 0.0 });
    let reach = distance(predicted, task.xf).min(target - start);
    Ok(Plan {
        best: index,
        target,
        reach,
        model_error: if target.is_finite() { target - start - reach } else { f64::INFINITY },
        start,
        components: components(&errors, task.xf)?,
        tube,
        bands: if every { around(&errors, task)? } else { Vec::new() },
        control: if way.compares { Some(control(task, way, &errors.states[n..])?) } else { None },
    })
}

/// `||u - v||` for `v = B^+ (xf - A x0 - c)`, or why there is no bound; `end` is where the centre leads in one step.
///
/// `v - u = B^+ (r + D z)`, `r = xf - C z` and `B^+ r = (B'B)^-1 (B_C' r + (B - B_C)' r)`. With `s = sigma_min(B_C)`
/// and `||B - B_C|| <= eB < s`:
///
/// ```text
/// (||D z|| + (||B_C' r|| + eB ||r||) / (s - eB)) / (s - eB).
/// ```
fn control(task: Endpoints<'_>, way: &Way<'_>, end: &[f64]) -> Result<ControlError> {
    let region = way.region;
    let (n, m, d) = (region.n, region.m, region.d);
    if m > n {
        return Ok(ControlError::Many);
    }
    let mut b = try_room(WHAT, n * m)?;
    region.centre.chunks_exact(d).for_each(|row| b.extend_from_slice(&row[n..n + m]));
    let least = singular_values(&b, m)?.last().copied().unwrap_or(f64::INFINITY);
    let spread = region.spread(n, n + m)?;
    if spread.is_nan() || spread >= least {
        return Ok(ControlError::NoEffect);
    }
    let mut wrong = region.bound(&region.regressor(task.x0, way.inputs)?, false)?;
    if task.rho0 > 0.0 {
        // D (e, 0) + A_C e
        let mut a = try_room(WHAT, n * n)?;
        region.centre.chunks_exact(d).for_each(|row| a.extend_from_slice(&row[..n]));
        wrong += times(spectral_norm(&a, n, n)? + region.spread(0, n)?, task.rho0);
    }
    let r = || task.xf.iter().zip(end).map(|(xf, x)| xf - x);
    let mut across = try_zeros(WHAT, m)?;
    for (row, r) in b.chunks_exact(m).zip(r()) {
        across.iter_mut().zip(row).for_each(|(to, b)| *to += b * r);
    }
    let (across, room) = (norm(across.iter().copied()) + spread * norm(r()), least - spread);
    Ok(ControlError::Within((wrong + across / room) / room))
}
