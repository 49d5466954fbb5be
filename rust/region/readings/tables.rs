//! The numbers of a loop from readings, for a controller without this core.

use faer::Mat;

use crate::error::Result;
use crate::memory::{checked_len, covered, try_collect, try_copy, try_zeros};

use super::{Readings, WHAT};

/// Names with whole numbers, and with numbers, of matrices row by row.
pub type Tables = (Vec<(&'static str, usize)>, Vec<(&'static str, Vec<f64>)>);

fn rows(a: &Mat<f64>) -> Result<Vec<f64>> {
    let (count, wide) = (a.nrows(), a.ncols());
    try_collect(WHAT, (0..count * wide).map(|at| a[(at / wide, at % wide)]))
}

impl Readings {
    /// All that the steps of the window, the gate and the bias need. The lengths of z in the parts of the gate: `white`
    /// (d, d) of each part, which is infinite where one of the `lost` (most, d) is seen beyond `tolerance` roundoffs.
    ///
    /// # Errors
    /// [`Error::Memory`](crate::Error::Memory).
    pub fn tables(&self) -> Result<Tables> {
        let (filter, window) = (&self.filter, &self.filter.window);
        let (p, d) = (window.outputs(), window.length());
        let parts = self.gate.as_ref().map_or(&[][..], |gate| &gate.parts);
        let most = parts.iter().map(|part| part.missing.len() / part.columns.len().max(1)).max().unwrap_or(0);
        let mut white: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, parts.len() * d, d)?)?;
        let mut lost: Vec<f64> = try_zeros(WHAT, checked_len(WHAT, parts.len() * most, d)?)?;
        let mut tolerance = try_zeros(WHAT, parts.len())?;
        for (k, part) in parts.iter().enumerate() {
            let wide = part.columns.len();
            for (at, &j) in part.columns.iter().enumerate() {
                for (r, row) in part.white.chunks_exact(wide).enumerate() {
                    white[(k * d + r) * d + j] = row[at];
                }
                let missing = &part.missing[at * (part.missing.len() / wide)..][..part.missing.len() / wide];
                missing.iter().enumerate().for_each(|(q, v)| lost[(k * most + q) * d + j] = *v);
            }
            tolerance[k] = part.roundoffs();
        }
        let sizes = [
            ("P", p),
            ("D", d),
            ("COUNT", window.count()),
            ("FILTERS", usize::from(window.pole().is_some())),
            ("DELAY", window.delay()),
            ("INTERCEPT", usize::from(window.intercept())),
            ("FILL", window.fill()),
            ("MISSING", self.max_missing),
            ("GATE", usize::from(self.gate.is_some())),
            ("PARTS", parts.len()),
            ("LOST", most),
        ];
        let mut tables = Vec::new();
        covered(WHAT, 1024 * (filter.step.ncols() as u128 + d as u128 + 16).pow(2), || {
            let mut shape = Vec::new();
            let mut own = (Vec::new(), Vec::new(), Vec::new());
            if let Some(gate) = &self.gate {
                for one in &gate.shapes {
                    shape.extend(rows(one)?);
                }
                own = (try_copy(WHAT, &gate.centre)?, rows(&gate.noise)?, try_copy(WHAT, &gate.quantiles)?);
            }
            tables.extend([
                ("theta", try_copy(WHAT, &self.theta)?),
                ("C", rows(&filter.c)?),
                ("ahead", rows(&filter.step)?),
                ("seen_by", rows(&filter.seen_by)?),
                ("mean", try_copy(WHAT, &filter.mean)?),
                ("apart", try_copy(WHAT, &filter.apart)?),
                ("pole", try_collect(WHAT, window.pole())?),
                ("noise", try_copy(WHAT, &self.of.noise)?),
                ("learn", try_copy(WHAT, &self.of.gain)?),
                ("spread", try_copy(WHAT, &self.of.spread)?),
                ("white", white),
                ("lost", lost),
                ("tolerance", tolerance),
                ("shape", shape),
                ("gate_theta", own.0),
                ("gate_noise", own.1),
                ("quantile", own.2),
            ]);
            Ok((try_copy(WHAT, &sizes)?, tables))
        })?
    }
}
