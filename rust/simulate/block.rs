//! Thirty-two runs that are simulated together, and the order of their random words.
//!
//! The order of the words is part of the stream's definition. A block starts with one word per run if `x0` is drawn.
//! At step `k` it takes, if `A` is drawn, one word for every run `s` and state `j` with `x_j^s(k) != 0` and a column
//! that is not zero; then, if `B` is drawn, one for every input `j` with `u_j(k) != 0` and a column that is not zero,
//! and every run. Columns are the outer loop, runs the inner one, except that singletons - an `x0` that is drawn or has
//! one nonzero, up to the first `u(k) != 0` - are taken run by run: they cost one draw, and finding them by columns
//! would cost `n`.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::model::{Drawn, Model, add_product};
use super::words::{MOST, Words};
use crate::error::Result;
use crate::memory::{checked_len, try_collect_all, try_zeros};
use crate::parallel::Stop;
use crate::sample::{AliasTable, Law};

/// Runs in a block. Part of the stream's definition.
pub(super) const RUNS: usize = MOST;

/// All runs, as bits.
const EVERY: u64 = u64::MAX >> (64 - RUNS);

/// One state of every run.
pub(super) type Row = [f64; RUNS];

/// Columns of an exact matrix multiplied between two checks of the stop flag.
const SLAB: usize = 256;

/// How one line is drawn.
struct Line {
    table: AliasTable,
    gamma: f64,
    /// bit `i % 64` of word `i / 64`: whether entry `i` is negative
    negative: Vec<u64>,
}

impl Line {
    /// The index for a word, and the sign bit of its entry.
    #[inline(always)]
    fn draw(&self, word: u64) -> (usize, u64) {
        let r = self.table.draw(word) as usize;
        (r, self.negative[r / 64] >> (r % 64) << 63)
    }

    /// Adds `x^s E^s` to the state of run `s`, for the runs in `present` (bit `s`), with one word each.
    #[inline(always)]
    fn scatter(&self, mut present: u64, words: &[u64], x: &Row, next: &mut [Row]) {
        let mut scaled = [0.0; RUNS];
        scaled.iter_mut().zip(x).for_each(|(to, x)| *to = x * self.gamma);
        let mut add = |s: usize, word: u64| {
            let (r, sign) = self.draw(word);
            next[r][s % RUNS] += f64::from_bits(scaled[s % RUNS].to_bits() ^ sign);
        };
        if present == EVERY {
            words.iter().enumerate().for_each(|(s, &word)| add(s, word));
            return;
        }
        for &word in words {
            add(present.trailing_zeros() as usize, word);
            present &= present.wrapping_sub(1);
        }
    }
}

/// The runs whose value is not zero, as bits.
#[inline(always)]
fn present(row: &Row) -> u64 {
    let mut bytes = [0u8; RUNS];
    bytes.iter_mut().zip(row).for_each(|(to, v)| *to = u8::from(*v != 0.0));
    let eights = bytes.as_chunks::<8>().0.iter().enumerate();
    // eight bytes 0 or 1 become eight bits: byte i is shifted to bit 56 + i, and no two products overlap
    eights.fold(0, |bits, (at, eight)| {
        bits | (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * at)
    })
}

const WHAT: &str = "the tables of a simulation";

/// A table for every line that is not zero.
fn lines(law: &Law, stop: &Stop) -> Result<Vec<Option<Line>>> {
    let line = |j: usize| {
        stop.check()?;
        let mut negative = try_zeros(WHAT, law.length().div_ceil(64))?;
        for (i, _) in law.line(j).iter().enumerate().filter(|(_, v)| **v < 0.0) {
            negative[i / 64] |= 1 << (i % 64);
        }
        Ok(AliasTable::new(law.line(j))?.map(|table| Line { table, gamma: law.gamma()[j], negative }))
    };
    try_collect_all(WHAT, (0..law.lines()).map(line))
}

/// Data that all blocks share.
pub(super) struct Stepper<'a> {
    model: &'a Model,
    a: Option<Vec<Option<Line>>>,
    b: Option<Vec<Option<Line>>>,
    x0: Option<Line>,
    drawn: Drawn,
    /// `B u(k)` for every step, if `B` is exact
    pushes: Vec<f64>,
    /// the first step whose state need not be a singleton
    dense_from: usize,
}

impl<'a> Stepper<'a> {
    pub(super) fn new(model: &'a Model, drawn: Drawn, stop: &Stop) -> Result<Self> {
        let (n, steps) = (model.n(), model.steps());
        let mut pushes: Vec<f64> = Vec::new();
        if !drawn.b {
            pushes = try_zeros("the inputs", checked_len("the inputs", steps, n)?)?;
            for (k, push) in pushes.chunks_exact_mut(n).enumerate() {
                add_product(model.b(), model.input(k), push, stop)?;
            }
        }
        let lone = drawn.x0 || model.x0().values().iter().filter(|&&x| x != 0.0).count() <= 1;
        let quiet = (0..steps).take_while(|&k| model.input(k).iter().all(|&u| u == 0.0)).count();
        Ok(Self {
            a: drawn.a.then(|| lines(model.a(), stop)).transpose()?,
            b: drawn.b.then(|| lines(model.b(), stop)).transpose()?,
            x0: lines(model.x0(), stop)?.pop().flatten().filter(|_| drawn.x0),
            dense_from: if lone && drawn.a { quiet + 1 } else { 0 },
            model,
            drawn,
            pushes,
        })
    }
}

/// The states of the runs of one block at one time.
pub(super) enum States<'a> {
    /// Run `s` has the single value `values[s]` at `indices[s]`.
    Singles { indices: &'a [u32; RUNS], values: &'a Row },
    /// Row `i` has state `i` of all runs.
    Rows(&'a [Row]),
}

/// A block during the simulation.
pub(super) struct Block<'a> {
    stepper: &'a Stepper<'a>,
    words: Words<'a>,
    k: usize,
    indices: [u32; RUNS],
    values: Row,
    x: &'a mut Vec<f64>,
    next: &'a mut Vec<f64>,
}

impl<'a> Block<'a> {
    /// The runs at time 0; `x` and `next` are memory for `n * RUNS` numbers each.
    pub(super) fn new(stepper: &'a Stepper<'a>, words: Words<'a>, x: &'a mut Vec<f64>, next: &'a mut Vec<f64>) -> Self {
        let mut block = Self { stepper, words, k: 0, indices: [0; RUNS], values: [0.0; RUNS], x, next };
        let x0 = stepper.model.x0().values();
        if let Some(line) = &stepper.x0 {
            for ((index, value), &word) in block.indices.iter_mut().zip(&mut block.values).zip(block.words.take(RUNS)) {
                let (r, sign) = line.draw(word);
                (*index, *value) = (r as u32, f64::from_bits(line.gamma.to_bits() ^ sign));
            }
        } else if let (false, Some(i)) = (stepper.drawn.x0, x0.iter().position(|&v| v != 0.0)) {
            block.indices = [i as u32; RUNS];
            block.values = [x0[i]; RUNS];
        }
        if stepper.dense_from == 0 {
            if stepper.drawn.x0 {
                block.spread();
            } else {
                for (row, &v) in block.x.as_chunks_mut::<RUNS>().0.iter_mut().zip(x0) {
                    *row = [v; RUNS];
                }
            }
        }
        block
    }

    /// The states at the present time.
    pub(super) fn states(&self) -> States<'_> {
        if self.k < self.stepper.dense_from {
            States::Singles { indices: &self.indices, values: &self.values }
        } else {
            States::Rows(self.x.as_chunks::<RUNS>().0)
        }
    }

    /// Converts singletons to rows.
    fn spread(&mut self) {
        self.x.fill(0.0);
        let rows = self.x.as_chunks_mut::<RUNS>().0;
        for (s, (&i, &v)) in self.indices.iter().zip(&self.values).enumerate() {
            rows[i as usize][s] = v;
        }
    }

    /// `x(k+1) = A_k x(k) + B_k u(k)` for every run.
    pub(super) fn step(&mut self, stop: &Stop) -> Result<()> {
        stop.check()?;
        let (stepper, k) = (self.stepper, self.k);
        if k < stepper.dense_from {
            self.step_singles();
            if k + 1 == stepper.dense_from {
                self.spread();
                self.push();
            }
        } else {
            self.step_rows(stop)?;
            std::mem::swap(self.x, self.next);
            self.push();
        }
        self.k += 1;
        Ok(())
    }

    fn step_singles(&mut self) {
        let Some(lines) = &self.stepper.a else { return };
        for (index, value) in self.indices.iter_mut().zip(&mut self.values) {
            match &lines[*index as usize] {
                Some(line) if *value != 0.0 => {
                    let (r, sign) = line.draw(self.words.take(1)[0]);
                    *index = r as u32;
                    *value = f64::from_bits((*value * line.gamma).to_bits() ^ sign);
                }
                _ => *value = 0.0,
            }
        }
    }

    /// `next = A_k x`.
    fn step_rows(&mut self, stop: &Stop) -> Result<()> {
        let n = self.stepper.model.n();
        self.next.fill(0.0);
        let Some(lines) = &self.stepper.a else {
            let a = MatRef::from_column_major_slice(self.stepper.model.a().values(), n, n);
            let x = MatRef::from_row_major_slice(self.x, n, RUNS);
            let mut next = MatMut::from_row_major_slice_mut(self.next, n, RUNS);
            for from in (0..n).step_by(SLAB) {
                stop.check()?;
                let width = SLAB.min(n - from);
                let (a, x) = (a.subcols(from, width), x.subrows(from, width));
                matmul(next.as_mut(), Accum::Add, a, x, 1.0, Par::Seq);
            }
            return Ok(());
        };
        let (x, next) = (self.x.as_chunks::<RUNS>().0, self.next.as_chunks_mut::<RUNS>().0);
        for (j, (row, line)) in x.iter().zip(lines).enumerate() {
            if j % SLAB == 0 {
                stop.check()?;
            }
            let Some(line) = line else { continue };
            let present = present(row);
            if present != 0 {
                line.scatter(present, self.words.take(present.count_ones() as usize), row, next);
            }
        }
        Ok(())
    }

    /// `x += B_k u(k)`.
    fn push(&mut self) {
        let (model, rows) = (self.stepper.model, self.x.as_chunks_mut::<RUNS>().0);
        if let Some(lines) = &self.stepper.b {
            for (&u, line) in model.input(self.k).iter().zip(lines) {
                if let (true, Some(line)) = (u != 0.0, line) {
                    line.scatter(EVERY, self.words.take(RUNS), &[u; RUNS], rows);
                }
            }
        } else {
            let n = model.n();
            for (row, push) in rows.iter_mut().zip(&self.stepper.pushes[self.k * n..]) {
                row.iter_mut().for_each(|x| *x += push);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::model::tests::model;
    use crate::stream::Key;

    #[test]
    fn present_is_a_bit_for_every_nonzero() {
        let mut row = [0.0; RUNS];
        assert_eq!(present(&row), 0);
        for (s, v) in [(0, 1.0), (3, -1e-320), (9, f64::INFINITY), (RUNS - 1, f64::NAN)] {
            row[s] = v;
        }
        assert_eq!(present(&row), 1 | 1 << 3 | 1 << 9 | 1 << (RUNS - 1));
        row[3] = -0.0;
        assert_eq!(present(&row), 1 | 1 << 9 | 1 << (RUNS - 1));
        assert_eq!(present(&[2.0; RUNS]), EVERY);
    }

    #[test]
    fn singletons_stay_alone_until_an_input_acts_and_take_one_word_per_run() {
        let a: Vec<f64> = (0..36).map(|i| f64::from(i) - 17.5).collect();
        let model = model(&a, &[1.0; 6], &[1.0, -2.0, 0.0, 3.0, 0.5, 0.0], &[0.0, 0.0, 1.0]);
        let (key, stop) = (Key([1; 32]), Stop::new());
        let stepper = Stepper::new(&model, Drawn { a: true, b: true, x0: true }, &stop).unwrap();
        let (mut x, mut next) = (vec![0.0; 6 * RUNS], vec![0.0; 6 * RUNS]);
        let mut block = Block::new(&stepper, Words::new(&key, 0), &mut x, &mut next);
        for _ in 0..3 {
            assert!(matches!(block.states(), States::Singles { .. }));
            block.step(&stop).unwrap();
        }
        let States::Rows(rows) = block.states() else { panic!("the third input is not zero") };
        assert!((0..RUNS).all(|s| (1..=2).contains(&rows.iter().filter(|row| row[s] != 0.0).count())));
        // x0, three times A, once B
        let mut fresh = Words::new(&key, 0);
        (0..5).for_each(|_| drop(fresh.take(RUNS).to_vec()));
        assert_eq!(block.words.take(RUNS), fresh.take(RUNS));
    }
}
