//! The centre along a run, and what its states and inputs make of the error of the model.

use faer::Mat;

use super::data::Matrix;
use super::loops::Loop;

/// The centre along the run.
pub(super) struct Way<'a> {
    pub of: &'a Loop,
    pub x: Matrix,
    pub plan: &'a [f64],
    pub k: usize,
    /// The loop about its rest point: without the intercept.
    pub about_rest: bool,
}

impl Way<'_> {
    pub fn input(&self) -> Matrix {
        let m = self.of.data.m;
        match self.plan.chunks_exact(m).nth(self.k) {
            Some(row) => Mat::from_fn(m, 1, |j, _| row[j]),
            None => &self.of.closed.k * &self.x,
        }
    }

    /// `T^(-1/2) W z` of all parts, and whether the data determine `Theta z`.
    pub fn forcing(&self) -> (Vec<f64>, bool) {
        let (data, u) = (&self.of.data, self.input());
        let z = Mat::from_fn(data.region.d, 1, |i, _| match i {
            i if i < data.n => self.x[(i, 0)],
            i if i < data.n + data.m => u[(i - data.n, 0)],
            _ => f64::from(u8::from(!self.about_rest)),
        });
        let (mut c, mut own) = (Vec::new(), Vec::new());
        for (piece, t) in data.pieces.iter().zip(&self.of.closed.t) {
            let part = &piece.w * &z;
            c.extend((0..part.nrows()).map(|i| part[(i, 0)] / t.sqrt()));
        }
        own.extend((0..data.region.d).map(|i| z[(i, 0)] * data.unit.get(i).copied().unwrap_or(1.0)));
        (c, data.determined(&own))
    }

    pub fn step(&mut self) {
        let data = &self.of.data;
        let mut next = &data.a * &self.x + &data.b * self.input();
        if let Some(c) = data.c.as_ref().filter(|_| !self.about_rest) {
            next += c;
        }
        self.x = next;
        self.k += 1;
    }
}
