//! How far outputs may be from where a model of a window of them leads, in the event that it is in a region.
//!
//! The state x is such a window. In front of it we put the output of the step, on which nothing acts:
//! `D = [I; G] S^(1/2)` and `P = [I 0]` in the recursion of [`several_steps`].
//!
//! Readings have the noise of the run, Gaussian and independent of the data, of covariance `<= Sbar`, with what the
//! error of the model makes of it: see [`super::carried`]. These are K events, of equal shares.

use crate::error::{Error, Result};
use crate::identify::covariance_root;
use crate::memory::{checked_len, try_collect, try_filled, try_room, try_zeros};
use crate::parallel::Stop;
use crate::region::{Entering, Region};

use super::noise::Gaussian;
use super::nuclear::WHAT;
use super::powers::product;
use super::several_steps::{Radii, Seen, several_steps};
use super::trajectory::states;

/// What is planned from a record that happened.
#[derive(Debug, Clone, Copy)]
pub struct Along<'a> {
    /// The window at the end of the record (n).
    pub x0: &'a [f64],
    /// The inputs (K, m).
    pub inputs: &'a [f64],
    /// K (m, n) of the feedback `u(k) + K (x(k) - xh(k))`.
    pub gain: Option<&'a [f64]>,
    /// How far each input may be from its plan (K, m), as where it is a forecast of what is measured.
    pub apart: Option<&'a [f64]>,
}

/// Bounds of the outputs along a run.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct OutputTube {
    /// `||y(k) - yh(k)||` (K + 1), 0 for the reading that is known.
    pub radii: Vec<f64>,
    /// `|y(k) - yh(k)|_i` (K + 1, p); with noise a statement of its own.
    pub components: Vec<f64>,
}

/// The window along the plan, and how far the outputs may be.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Outputs {
    /// The window along the centre, (K + 1, n).
    pub states: Vec<f64>,
    /// The outputs along the centre, of the steps from 1 on, (K, p).
    pub predicted: Vec<f64>,
    /// Of the mean of the outputs, given the record.
    pub mean: OutputTube,
    /// Of the readings.
    pub readings: Option<OutputTube>,
}

/// The tubes for a `region` of the coefficients (p, d) of `y+ = Theta z` in this system, whose states are the window;
/// those of readings for the probability given to their noise, of which the region must know the covariance.
///
/// # Errors
/// [`Error::Shape`], [`Error::Overflow`] for states of the centre that leave the range of doubles, [`Error::Value`] for
/// a probability outside (0, 1), [`Error::Memory`], [`Error::Interrupted`].
pub fn outputs(
    region: &Region,
    system: Entering<'_>,
    along: Along<'_>,
    noise: Option<f64>,
    stop: &Stop,
) -> Result<Outputs> {
    let (p, m) = (region.n, system.m);
    let (n, k) = system.sizes(p, region.width())?;
    if along.x0.len() != n
        || along.gain.is_some_and(|gain| gain.len() != m * n)
        || along.apart.is_some_and(|apart| apart.len() != along.inputs.len())
    {
        let found = format!("{} entries", along.x0.len());
        return Err(Error::Shape { name: "x0, gain, apart", expected: format!("{n} and {m} x {n} entries"), found });
    }
    // (y; x), of which y acts on nothing
    let behind = |of: &[f64]| -> Result<Vec<f64>> {
        let mut wider = try_zeros(WHAT, checked_len(WHAT, of.len() / k.max(1), p + k)?)?;
        wider.chunks_exact_mut(p + k).zip(of.chunks_exact(k)).for_each(|(to, row)| to[p..].copy_from_slice(row));
        Ok(wider)
    };
    let above = |of: &[f64], below: &[f64]| try_collect(WHAT, of.iter().chain(below).copied());
    let matrix = above(&product(region.centre(), system.entering, p, region.width(), k)?, system.matrix)?;
    let mut ones = try_zeros(WHAT, p * p)?;
    (0..p).for_each(|i| ones[i * (p + 1)] = 1.0);
    let (both, whole) = (above(&ones, system.noise)?, p + n);
    let wider = Entering { m, matrix: &behind(&matrix)?, entering: &behind(system.entering)?, noise: &both };
    let rooted = |covariance: &[f64]| product(&both, &covariance_root(covariance, p)?, whole, p, p);
    let wider = region.entered(wider)?; // which looks at the parts
    let of = Of { p, root: rooted(&region.parts[0].shape)?, region: wider };
    let mut x0 = try_zeros(WHAT, whole)?;
    x0[p..].copy_from_slice(along.x0);
    let mut gain = try_zeros(WHAT, checked_len(WHAT, m, whole)?)?;
    if let Some(given) = along.gain {
        gain.chunks_exact_mut(whole).zip(given.chunks_exact(n)).for_each(|(to, row)| to[p..].copy_from_slice(row));
    }
    let at = states(&of.region, &x0, along.inputs)?;
    let way = Way {
        at: &at,
        inputs: along.inputs,
        gain: along.gain.is_some().then_some(gain.as_slice()),
        apart: along.apart,
    };
    let mean = of.tube(way, None, stop)?;
    let steps = along.inputs.len() / m;
    let readings = match (noise, region.noise()) {
        (None, _) => None,
        (Some(level), Some(covariance)) if covariance.iter().all(|v| v.is_finite()) => {
            let root = covariance_root(covariance, p)?;
            let mut square = try_zeros(WHAT, checked_len(WHAT, whole, whole)?)?;
            for (to, row) in square.chunks_exact_mut(whole).zip(product(&both, &root, whole, p, p)?.chunks_exact(p)) {
                to[..p].copy_from_slice(row);
            }
            let share = level / steps as f64;
            Some(of.tube(way, Some(Gaussian { root: &square, end: share, before: share }), stop)?)
        }
        _ => Some(unbounded(steps, p)?),
    };
    let mut states = try_room(WHAT, (steps + 1) * n)?;
    at.chunks_exact(whole).for_each(|row| states.extend_from_slice(&row[p..]));
    let mut predicted = try_room(WHAT, steps * p)?;
    at.chunks_exact(whole).skip(1).for_each(|row| predicted.extend_from_slice(&row[..p]));
    Ok(Outputs { states, predicted, mean, readings })
}

fn unbounded(steps: usize, p: usize) -> Result<OutputTube> {
    let filled = |width: usize| -> Result<Vec<f64>> {
        let mut values = try_filled(WHAT, f64::INFINITY, (steps + 1) * width)?;
        values[..width].fill(0.0);
        Ok(values)
    };
    Ok(OutputTube { radii: filled(1)?, components: filled(p)? })
}

/// The plan in the system (y; x).
#[derive(Clone, Copy)]
struct Way<'a> {
    at: &'a [f64],
    inputs: &'a [f64],
    gain: Option<&'a [f64]>,
    apart: Option<&'a [f64]>,
}

/// A region of the system (y; x), with a root (n, p) of its shape.
struct Of {
    region: Region,
    root: Vec<f64>,
    p: usize,
}

impl Of {
    fn tube(&self, way: Way<'_>, noise: Option<Gaussian<'_>>, stop: &Stop) -> Result<OutputTube> {
        let Way { at, inputs, gain, apart } = way;
        let (region, p, steps) = (&self.region, self.p, inputs.len() / self.region.m);
        let radii = Radii {
            spectral: region.parts[0].factor.sqrt(),
            frobenius: region.frobenius(),
            rho0: 0.0,
            noise: false,
            to_come: noise,
            within: false,
            besides: [None; 2],
            apart,
        };
        let seen = Seen { rows: p, gain };
        let mut found = match several_steps(region, &self.root, at, inputs, radii, seen, stop) {
            Err(Error::Overflow { .. }) => return unbounded(steps, p),
            found => found?,
        };
        if let Some(noise) = noise {
            found.add(noise)?;
        }
        let components = found.bands(&radii, 0, stop)?;
        let nan = |values: &[f64]| values.iter().any(|v| v.is_nan());
        if nan(&found.radii) || nan(&components) {
            return unbounded(steps, p);
        }
        Ok(OutputTube { radii: found.radii, components })
    }
}
