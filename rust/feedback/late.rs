//! The region of a plant with more states whose equations are known: past inputs, and the record of a controller.

use std::sync::Arc;

use faer::Mat;

use crate::error::{Error, Result};
use crate::matrix::MatrixView;
use crate::memory::{try_copy, try_zeros};
use crate::region::{Part, PartOf, Region};

use super::blocks::Channel;
use super::data::{Closed, Matrix, REPEATED, Uncertain, WHAT, filled, gathered, in_units, matrix};
use super::loops::Loop;

/// The record `c+ = N (c, v) + G y+` of a controller: of the inputs v that it asks for and the readings y that it gets.
/// Its inputs are `v = K c`. The first entries of c are the readings, or their first filters. A controller without one
/// has `c = y`.
#[derive(Debug, Clone, Copy)]
pub struct Recorder<'a> {
    /// N (n, n + m), row by row.
    pub next: &'a [f64],
    /// G (n, p).
    pub reads: &'a [f64],
}

/// Where a fault is: between the inputs that are asked for and those that act, or in the readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Fault {
    Inputs,
    Readings,
}

/// The region with more states below, of which `below` (more, n + more + m) are the rows of A and B.
fn with_below(region: &Region, below: &Matrix) -> Result<Region> {
    let (n, m, width, more) = (region.n, region.m, region.d, below.nrows());
    let all = n + more;
    let mut centre = try_zeros::<f64>(WHAT, all * (width + more))?;
    for (i, row) in centre.chunks_exact_mut(width + more).enumerate() {
        if i < n {
            let own = &region.centre[i * width..(i + 1) * width];
            row[..n].copy_from_slice(&own[..n]);
            row[all..].copy_from_slice(&own[n..]);
        } else {
            (0..all + m).for_each(|j| row[j] = below[(i - n, j)]);
        }
    }
    let mut parts = Vec::new();
    for part in &region.parts {
        let mut columns = try_copy(WHAT, &part.columns)?;
        columns.iter_mut().filter(|j| **j >= n).for_each(|j| *j += more);
        parts.push(Arc::new(Part::new(PartOf { columns: &columns, ..part.of() })?));
    }
    Region::new(MatrixView::of(&centre, width + more), m, parts, region.frobenius, region.future)
}

/// The states that those of `from` move, after any number of steps, and those themselves.
fn followers(next: &Matrix, mut from: Vec<bool>) -> Vec<usize> {
    for _ in 0..from.len() {
        let more =
            gathered((0..from.len()).map(|i| from[i] || (0..from.len()).any(|j| from[j] && next[(i, j)] != 0.0)));
        from = more;
    }
    gathered((0..from.len()).filter(|i| from[*i]))
}

impl Loop {
    /// The gain of this loop in the units of the data.
    pub(super) fn own_gain(&self) -> Matrix {
        in_units(&self.closed.k, &filled(self.data.m, 1.0), &self.data.back())
    }

    /// The first rows below, so many, are of `u - K x` in place of u.
    fn grown(&self, below: &Matrix, following: usize, k: impl Fn(usize, usize) -> f64) -> Result<(Uncertain, Closed)> {
        let (region, n) = (with_below(&self.data.region, below)?, self.data.n);
        let mut data = Uncertain::beside(&region, self.data.later_misfits(below.nrows()))?;
        data.lift = self.data.lift;
        data.followed = match &self.data.followed {
            Some((rows, asked)) => {
                Some((rows.clone(), Mat::from_fn(data.m, data.n, |i, j| if j < n { asked[(i, j)] } else { 0.0 })))
            }
            None => (following > 0).then(|| (n..n + following, Mat::from_fn(data.m, data.n, &k))),
        };
        let inside = Mat::from_fn(data.m, data.n, |i, j| k(i, j) * data.unit[j]);
        let closed = Closed::new(&data, inside);
        Ok((data, closed))
    }

    /// The loop of a plant with the inputs of `d` steps before as states `(x, v_1, .., v_d)`, `v_1(k+1) = K x(k)`,
    /// `v_j(k+1) = v_(j-1)(k)`: those that were asked for. The gain is `own` times K, and `last` times the last of
    /// them.
    pub(super) fn past(&self, d: usize, (own, last): (f64, f64)) -> Result<(Uncertain, Closed)> {
        let (n, m, k) = (self.data.n, self.data.m, self.own_gain());
        let below = Mat::from_fn(m * d, n + m * d + m, |i, j| match (i < m, j < n) {
            (true, true) => k[(i, j)],
            (true, false) => 0.0,
            (false, _) => f64::from(u8::from(j + m == n + i)),
        });
        let end = n + m * (d - 1);
        self.grown(&below, 0, |i, j| match (j < n, j >= end) {
            (true, _) => own * k[(i, j)],
            (false, true) => last * f64::from(u8::from(i == j - end)),
            (false, false) => 0.0,
        })
    }

    /// The loop of a plant whose controller has its own record of inputs, or of readings, and the channels of false
    /// readings.
    ///
    /// Where x are the states that such a controller would have without a fault, it has `x + D`,
    ///
    /// ```text
    /// D = r + G q,    r+ = N_x D + N_u (v - u),    v = K (x + D),
    /// ```
    ///
    /// with q the errors of the readings now. The states r, and for filters those `h` of the step before, are below x:
    /// `y = (x_1 - a h) / (1 - a)`.
    pub(super) fn apart(&self, recorder: Recorder<'_>, at: Fault) -> Result<(Self, Vec<Channel>)> {
        let (n, m, k) = (self.data.n, self.data.m, &self.closed.k);
        let p = recorder.reads.len() / n;
        if recorder.next.len() != n * (n + m) || recorder.reads.len() != n * p || !(1..=n).contains(&p) {
            let found = format!("{} and {}", recorder.next.len(), recorder.reads.len());
            return Err(Error::Shape { name: "N and G", expected: format!("{n} rows each"), found });
        }
        let (unit, back) = (&self.data.unit, self.data.back());
        let next = matrix(recorder.next, n, n + m);
        let own = in_units(&next.subcols(0, n).to_owned(), &back, unit);
        let asked = in_units(&next.subcols(n, m).to_owned(), &back, &filled(m, 1.0));
        let reads = in_units(&matrix(recorder.reads, n, p), &back, &unit[..p]);
        let held = &own * &reads;
        let acts = at == Fault::Inputs;
        let seeds = if acts { &asked } else { &held };
        let kept = followers(&own, gathered((0..n).map(|i| (0..seeds.ncols()).any(|j| seeds[(i, j)] != 0.0))));
        let filtered = gathered((0..p).filter(|j| !acts && own[(*j, *j)] != 0.0));
        let more = kept.len() + filtered.len();
        let all = n + more;
        let below = Mat::from_fn(more, all + m, |i, j| {
            let Some(i) = kept.get(i).copied() else {
                let of = filtered[i - kept.len()];
                return if j == of { back[j] } else { 0.0 };
            };
            match kept.get(j.wrapping_sub(n)) {
                Some(of) if j >= n => own[(i, *of)],
                None if j >= all && acts => -asked[(i, j - all)],
                _ => 0.0,
            }
        });
        let (mut data, mut closed) = self.grown(&below, if acts { kept.len() } else { 0 }, |i, j| {
            if j < n { k[(i, j)] * back[j] } else { kept.get(j - n).map_or(0.0, |of| k[(i, *of)]) }
        })?;
        closed.t.clone_from(&self.closed.t);
        data.lift = if more > 0 { REPEATED } else { data.lift };
        let through = k * &reads;
        let channels = (0..p).map(|j| {
            let e = |i: usize| kept.get(i.wrapping_sub(n)).map_or(0.0, |of| held[(*of, j)]);
            let at = filtered.iter().position(|of| *of == j).map(|i| n + kept.len() + i);
            let y = |i: usize| match (i == j, at == Some(i)) {
                (true, _) => 1.0 / reads[(j, j)],
                (_, true) => -own[(j, j)] / reads[(j, j)],
                _ => 0.0,
            };
            let mut one = Channel::at_inputs(through.subcols(j, 1).to_owned(), Mat::from_fn(1, all, |_, i| y(i)));
            one.e = Mat::from_fn(all, 1, |i, _| e(i));
            one
        });
        let channels = gathered(channels);
        Ok((Self { data, closed, certificate: self.certificate.clone(), proof: None }, channels))
    }
}
