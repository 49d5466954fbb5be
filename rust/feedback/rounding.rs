//! The numbers that a controller gets and computes with: rounded ones, and readings that are off.

use faer::Mat;
use faer::linalg::solvers::Solve;

use crate::error::{Error, Result};
use crate::memory::covered;
use crate::parallel::Stop;

use super::data::{Matrix, WHAT, absolute, entries, filled, gathered, matrix};
use super::late::Recorder;
use super::loops::{Loop, bytes};
use super::spectrum::radius;
use super::tube::ROUNDING;

/// Unit roundoff of 32 bits.
const U: f64 = 1.0 / 16_777_216.0;

/// The filters of a window, the first states: `count` of each of `outputs`, then of each input.
#[derive(Debug, Clone, Copy)]
pub struct Filters {
    /// Their pole, in (0, 1).
    pub pole: f64,
    /// How many outputs there are.
    pub outputs: usize,
    /// How many filters of each signal.
    pub count: usize,
}

/// What each operation of a computer is off: times what it is about, and at least.
struct Numbers {
    /// Of the sum of products, relative.
    sum: f64,
    /// Of a reading, relative.
    reading: f64,
    /// Of one step of a filter, relative to what it adds up.
    filter: f64,
    /// Of one step or reading, at least.
    least: f64,
}

impl Loop {
    /// How far states and inputs in the numbers of a computer are from those of exact numbers (n + m), for ever: 32
    /// bits of floating point, or fixed point with so many `bits` behind the point. The gain of this loop is the one
    /// that is stored; the exact loop may have another one: its states and inputs are at most `reach` (n + m), and the
    /// inputs that the two gains ask for at its states are at most `apart` (m) from each other.
    ///
    /// With the gains `K` and `S` (stored) and the exact states x, the difference e of the states is that of this loop
    /// with wrong inputs: `e+ = (A + B S) e + B ((S - K) x + what is off at x + e)`.
    ///
    /// Of a filter `a c + (1 - a) b` each step is off by at most `e (|c| + |b|) + least`, and the filter by
    /// `1 / (1 - a)` of that, beside what b is off.
    ///
    /// # Errors
    /// As [`Loop::errors`].
    pub fn rounded(
        &self,
        (reach, apart): (&[f64], &[f64]),
        bits: Option<i32>,
        filters: Option<Filters>,
        stop: &Stop,
    ) -> Result<Vec<f64>> {
        let (n, m, k) = (self.data.n, self.data.m, absolute(&self.own_gain()));
        let a = filters.map_or(0.0, |of| of.pole);
        let sum = (n as f64 + 2.0) * U;
        let (numbers, fixed) = match bits {
            None => {
                let least = n as f64 * (1.0 + k.norm_max()) * 2f64.powi(-125);
                let filter = (5.0 + a / (1.0 - a)) * U;
                (Numbers { sum: sum / (1.0 - sum), reading: U, filter, least: 2f64.powi(-124) }, filled(m, least))
            }
            Some(bits) => {
                let half = 2f64.powi(-bits - 1);
                let each = gathered((0..m).map(|i| half * ((0..n).map(|j| k[(i, j)]).sum::<f64>() + 1.0)));
                (Numbers { sum: 0.0, reading: 0.0, filter: half, least: half }, each)
            }
        };
        if !(reach.iter().all(|v| v.is_finite()) && numbers.filter < 1.0 - a) {
            return Ok(filled(n + m, f64::INFINITY));
        }
        let (by, least) = filters.map_or((Mat::zeros(n, n + m), Mat::zeros(n, 1)), |of| self.filtered(of, &numbers));
        let (by, least) = (&k * by * faer::Scale(1.0 + numbers.sum), &k * least * faer::Scale(1.0 + numbers.sum));
        let own = |i: usize, j: usize| if j < n { numbers.sum * k[(i, j)] } else { 0.0 };
        let weights = entries(&Mat::from_fn(m, n + m, |i, j| by[(i, j)] + own(i, j)));
        let fixed = gathered(fixed.iter().zip(apart).enumerate().map(|(i, (v, more))| v + more + least[(i, 0)]));
        self.computed(reach, &weights, &fixed, stop)
    }

    /// How far computed filters are off: times the sizes of states and inputs (n, n + m), and at least (n, 1).
    fn filtered(&self, of: Filters, numbers: &Numbers) -> (Matrix, Matrix) {
        let (n, m, a) = (self.data.n, self.data.m, of.pole);
        let (mut by, mut least) = (Mat::<f64>::zeros(n, n + m), Mat::<f64>::zeros(n, 1));
        let (more, past) = (numbers.filter / (1.0 - a), of.count * of.outputs);
        for i in 0..past + of.count * m {
            let (width, at) = if i < past { (of.outputs, i) } else { (m, i - past) };
            let first = at < width;
            // what the filter is fed with: a reading, of two values of its first filter; an input; or the filter before
            let (from, size) = match (first, i < past) {
                (true, true) => (i, (1.0 + a) / (1.0 - a)),
                (true, false) => (n + at, 1.0),
                (false, _) => (i - width, 1.0),
            };
            let read = first && i < past;
            for j in 0..n + m {
                let fed = if j == from { size } else { 0.0 };
                let off = if first { if read { numbers.reading * fed } else { 0.0 } } else { by[(i - width, j)] };
                let all = fed + if j == i { 1.0 } else { 0.0 };
                by[(i, j)] = ((1.0 + more) * off + more * all) / (1.0 - more);
            }
            let tiny = if first { if read { numbers.least } else { 0.0 } } else { least[(i - width, 0)] };
            least[(i, 0)] = ((1.0 + more) * tiny + numbers.least / (1.0 - a)) / (1.0 - more);
        }
        (by, least)
    }

    /// How far states and `K x` (n + m), and inputs (m), are moved by readings that are off by at most `sizes` (p) at
    /// each step, in any way, for ever: the record of the controller is off by at most `d = (I - |N|)^-1 |G| sizes`,
    /// its inputs by `|K| d`.
    ///
    /// # Errors
    /// As [`Loop::errors`].
    pub fn misread(&self, recorder: Option<Recorder<'_>>, sizes: &[f64], stop: &Stop) -> Result<(Vec<f64>, Vec<f64>)> {
        let (n, m, p) = (self.data.n, self.data.m, sizes.len());
        let (next, reads) = (filled(n * (n + m), 0.0), entries(&Mat::identity(n, n)));
        let recorder = recorder.unwrap_or(Recorder { next: &next, reads: &reads });
        if recorder.next.len() != n * (n + m) || recorder.reads.len() != n * p {
            let found = format!("{}, {}", recorder.next.len(), recorder.reads.len());
            return Err(Error::Shape { name: "N and G", expected: format!("{n} rows, and {p} columns of G"), found });
        }
        if let Some(size) = sizes.iter().find(|size| size.is_nan() || **size < 0.0) {
            return Err(Error::Value { name: "readings", expected: ">= 0", found: size.to_string() });
        }
        covered(WHAT, bytes(n, self.data.region.d), || {
            let known = absolute(&matrix(recorder.next, n, n + m).subcols(0, n).to_owned());
            let read = absolute(&matrix(recorder.reads, n, p)) * Mat::from_fn(p, 1, |i, _| sizes[i]);
            if radius(&known)? >= 1.0 {
                return Ok((filled(n + m, f64::INFINITY), filled(m, f64::INFINITY)));
            }
            let record = (Mat::<f64>::identity(n, n) - known).partial_piv_lu().solve(&read);
            let off = absolute(&self.own_gain()) * record;
            let off = gathered((0..m).map(|i| off[(i, 0)] * (1.0 + ROUNDING)));
            Ok((self.errors(&off, stop)?, off))
        })?
    }
}
