//! The numbers of an alarm, for a controller without this core.

use crate::error::Result;
use crate::memory::{try_collect, try_copy, try_push, try_zeros};

use super::alarm::{LEARNED, Promise, Watch};
use super::frame::WHAT;
use super::laws::Laws;

/// Names with whole numbers, and with numbers, of matrices row by row.
pub type Tables = (Vec<(&'static str, usize)>, Vec<(&'static str, Vec<f64>)>);

impl Watch {
    /// All that a step needs, but the places of `sights` and what `changes` are found from. A z of which one of the
    /// `lost` (any, d) directions, of a part each, is seen beyond its `tolerance` in roundoffs of its terms makes no
    /// pair.
    ///
    /// # Errors
    /// [`crate::Error::Memory`].
    pub fn tables(&self) -> Result<Tables> {
        let (frame, bank, window) = (&self.frame, &self.bank, &self.window);
        let (n, d) = frame.sizes;
        let (mut lost, mut tolerance) = (Vec::new(), Vec::new());
        for part in &frame.parts {
            let wide = part.missing.len() / part.columns.len().max(1);
            for q in 0..wide {
                let mut row = try_zeros(WHAT, d)?;
                part.columns.iter().enumerate().for_each(|(at, j)| row[*j] = part.missing[at * wide + q]);
                lost.append(&mut row);
                try_push(WHAT, &mut tolerance, part.roundoffs())?;
            }
        }
        let whole = |list: &[usize]| try_collect(WHAT, list.iter().map(|v| *v as f64));
        let laws = self.law.0;
        let law = [Laws::Variance, Laws::Gaussian, Laws::Symmetric, Laws::Bounded].iter().position(|one| *one == laws);
        let sizes = [
            ("P", frame.outputs),
            ("M", window.inputs()),
            ("STATES", window.states()),
            ("D", d),
            ("COUNT", window.count()),
            ("FILTERS", usize::from(window.pole().is_some())),
            ("DELAY", window.delay()),
            ("INTERCEPT", usize::from(window.intercept())),
            ("FILL", window.fill()),
            ("ROWS", n),
            ("ANY", frame.white.len() / d),
            ("PARTS", frame.norms.len()),
            ("LOST", tolerance.len()),
            ("WAYS", bank.directions.len() / n),
            ("BETS", bank.column.len()),
            ("SHIFTS", bank.shifts.len()),
            ("SMALL", bank.small),
            ("SHORT", bank.blocks[0]),
            ("LONG", bank.blocks[1]),
            ("SHARES", laws.shares().len()),
            ("ALL", self.begins[5]),
            ("LAW", law.unwrap_or(0)),
            ("JOINT", usize::from(self.joint())),
            ("EVER", usize::from(matches!(self.promise, Promise::Ever(_)))),
        ];
        let tables = [
            ("pole", try_collect(WHAT, window.pole())?),
            ("rows", whole(&frame.rows)?),
            ("centre", try_copy(WHAT, &frame.centre)?),
            ("back", try_copy(WHAT, &frame.back)?),
            ("white", try_copy(WHAT, &frame.white)?),
            ("begins", whole(&frame.begins)?),
            ("reach", try_copy(WHAT, &frame.reach)?),
            ("norms", try_copy(WHAT, &frame.norms)?),
            ("scaled", try_copy(WHAT, &frame.scaled)?),
            ("lost", lost),
            ("tolerance", tolerance),
            ("directions", try_copy(WHAT, &bank.directions)?),
            ("spreads", try_copy(WHAT, &bank.spreads)?),
            ("direction", whole(&bank.direction)?),
            ("column", whole(&bank.column)?),
            ("unit", try_copy(WHAT, &bank.unit)?),
            ("shifts", try_copy(WHAT, &bank.shifts)?),
            ("shares", try_copy(WHAT, laws.shares())?),
            ("learned", try_copy(WHAT, &LEARNED)?),
            ("weights", try_copy(WHAT, &self.weights)?),
            ("starts", whole(&self.begins)?),
            ("threshold", try_copy(WHAT, &[self.threshold()])?),
        ];
        Ok((try_copy(WHAT, &sizes)?, tables.into()))
    }
}
