//! The few units that are solved for together: `min z^2 + ||u||_R^2` (without R: `min z`) with `||M_w u - t_w|| <= z`.

use super::held::{Forces, Held, scaled};
use super::program::{Cone, Program};
use super::units::{Room, Units, WHAT};
use super::within::Within;
use crate::error::{Error, Result};
use crate::limits::Until;
use crate::memory::{checked_len, try_collect, try_copy, try_extend, try_room, try_zeros};
use crate::scaled::nearest_power_of_two;
use crate::vector::{dot, norm};

/// Tolerance of a program, and of one whose units are not yet those of the command.
pub(super) const EXACT: f64 = 1e-10;
pub(super) const ROUGH: f64 = 1e-4;
/// A program that was left this far from its constraints has none that can be kept, unless it is shown otherwise.
const UNMET: f64 = 1e-4;

/// The inputs, inside their limits, and the vectors of the dual: `v_w`, and `cost u` behind them.
pub(super) struct Proposal {
    pub(super) control: Vec<f64>,
    pub(super) vectors: Vec<f64>,
    pub(super) forces: Forces,
}

/// A unit: `M_w` and `t_w`, and the cone of its free inputs, `M = gain M'`.
struct One {
    unit: usize,
    map: Vec<f64>,
    target: Vec<f64>,
    cone: Cone,
}

/// The units in their order.
pub(super) struct Chosen {
    room: Room,
    free: Vec<usize>,
    ones: Vec<One>,
    gain: f64,
}

impl Chosen {
    pub(super) fn new(units: &Units<'_>, free: Vec<usize>) -> Result<Self> {
        Ok(Self { room: Room::new(units)?, free, ones: Vec::new(), gain: 0.0 })
    }

    pub(super) fn take(&mut self, units: &Units<'_>, working: &[usize], until: Until<'_>) -> Result<()> {
        let (d, rows) = (units.inputs(), units.rows());
        let mut ones = try_room(WHAT, working.len())?;
        for &unit in working {
            if let Some(at) = self.ones.iter().position(|one| one.unit == unit) {
                ones.push(self.ones.swap_remove(at));
                continue;
            }
            let (mut map, mut target) = (try_zeros(WHAT, checked_len(WHAT, rows, d)?)?, try_zeros(WHAT, rows)?);
            units.map(unit, &mut self.room, &mut map, &mut target);
            if !map.iter().chain(&target).all(|v| v.is_finite()) {
                return Err(Error::Overflow { what: "the map of a unit" });
            }
            ones.push(One { unit, map, target, cone: Cone::default() });
        }
        if self.gain == 0.0 {
            let sizes = ones.iter().flat_map(|one| one.map.chunks_exact(d)).map(norm);
            self.gain = nearest_power_of_two(sizes.fold(0.0, f64::max));
        }
        for one in ones.iter_mut().filter(|one| one.cone.map.is_empty()) {
            let mut map = try_room(WHAT, rows * self.free.len())?;
            for row in one.map.chunks_exact(d) {
                map.extend(self.free.iter().map(|&j| row[j] / self.gain));
            }
            one.cone = Cone::new(map, try_zeros(WHAT, rows)?, self.free.len(), until)?;
        }
        self.ones = ones;
        Ok(())
    }

    /// All maps and all targets, one below the other.
    pub(super) fn stacked(&self) -> Result<(Vec<f64>, Vec<f64>)> {
        let (mut maps, mut targets) = (Vec::new(), Vec::new());
        for one in &self.ones {
            try_extend(WHAT, &mut maps, one.map.iter().copied())?;
            try_extend(WHAT, &mut targets, one.target.iter().copied())?;
        }
        Ok((maps, targets))
    }

    /// Solves for `u = unit v`, where the value is about `size`; None where the limits of states are not met.
    pub(super) fn propose(
        &mut self,
        within: &Within<'_>,
        held: &[Held],
        size: f64,
        tolerance: f64,
        until: Until<'_>,
    ) -> Result<Option<Proposal>> {
        let (d, free, gain) = (within.low.len(), &self.free, self.gain);
        let (columns, unit) = (free.len() + 1, nearest_power_of_two(size / gain));
        let fixed = try_collect(WHAT, (0..d).filter(|j| !free.contains(j)))?;
        for one in &mut self.ones {
            for ((to, t), row) in one.cone.target.iter_mut().zip(&one.target).zip(one.map.chunks_exact(d)) {
                let taken: f64 = fixed.iter().map(|&j| row[j] * within.low[j]).sum();
                *to = (t - taken) / gain / unit;
            }
        }
        let weighed = !within.cost.is_empty() || within.diagonal.iter().any(|weight| *weight > 0.0);
        let (mut squares, mut linear) = (Vec::new(), try_zeros(WHAT, columns)?);
        if weighed {
            let (r, of_fixed) = within.weight(free)?;
            squares = try_zeros(WHAT, checked_len(WHAT, columns, columns)?)?;
            for (line, row) in squares.chunks_exact_mut(columns).zip(r.chunks_exact(free.len())) {
                line.iter_mut().zip(row).for_each(|(to, r)| *to = r / gain / gain);
            }
            squares[columns * columns - 1] = 1.0;
            linear.iter_mut().zip(&of_fixed).for_each(|(to, q)| *to = q / gain / gain / unit);
        } else {
            linear[columns - 1] = 1.0;
        }
        let limits = scaled(held, within, free, unit, 1)?;
        let mut cones = try_room(WHAT, self.ones.len())?;
        cones.extend(self.ones.iter().map(|one| &one.cone));
        let (rows, right) = (try_copy(WHAT, &limits.rows)?, try_copy(WHAT, &limits.right)?);
        let program =
            Program { columns, squares: &squares, linear, pairs: within.pairs(free, unit)?, rows, right, cones };
        let point = program.solve(tolerance, until)?;
        if (point.merit > UNMET || point.merit.is_nan()) && !held.is_empty() {
            return Ok(None);
        }
        let mut control = try_copy(WHAT, &within.low)?;
        self.free.iter().zip(&point.x).for_each(|(&j, v)| control[j] = v * unit);
        within.clip(&mut control);
        let (share, pairs) = (gain * unit * gain * unit, program.pairs.len());
        let (flat, cones) = point.multipliers.split_at(pairs + held.len());
        let forces = Forces::of(flat, pairs, within, &limits, unit, share)?;
        let mut vectors = Vec::new();
        for block in cones.chunks_exact(self.ones[0].target.len() + 1) {
            try_extend(WHAT, &mut vectors, block[1..].iter().map(|v| -v * gain * unit))?;
        }
        try_extend(WHAT, &mut vectors, within.cost.chunks_exact(d).map(|row| dot(row, &control)))?;
        if !control.iter().chain(&vectors).all(|v| v.is_finite()) {
            return Ok(None);
        }
        Ok(Some(Proposal { control, vectors, forces }))
    }
}
