//! What all units say of a command.

use super::units::Units;
use super::within::Within;
use crate::error::Result;
use crate::limits::Until;

/// The largest miss and the largest excess of a limit of states, and those of every unit.
pub(super) struct Look {
    pub(super) value: f64,
    pub(super) excess: f64,
    pub(super) misses: Vec<f64>,
    pub(super) beyond: Vec<f64>,
}

/// The misses of all units, and the largest of those that are not in `skip`.
pub(super) fn look(
    units: &Units<'_>,
    within: &Within<'_>,
    u: &[f64],
    skip: &[bool],
    (threads, until): (usize, Until<'_>),
) -> Result<Look> {
    let (misses, beyond) = units.misses(u, within.beside(u), within.given.states, threads, until.stop)?;
    let most = |of: &[f64]| of.iter().zip(skip).filter(|(_, skip)| !**skip).fold(0.0f64, |most, (v, _)| most.max(*v));
    Ok(Look { value: most(&misses), excess: most(&beyond), misses, beyond })
}
