//! A face of the homogenised problem with the Cholesky factor of an earlier one.
//!
//! The factor belongs to the face `F0`. Each change since borders the system, `H_0 x + B y = b`, `B^T x + C y = c`:
//!
//! * a sample that entered brings its column of `H` (and `C` the block among those that entered);
//! * a sample that left brings a unit vector: its weight must not change.
//!
//! With `U = H_0^{-1} B` and `C - B^T U` kept, a change costs one solve with the factor and one new row. The right side
//! costs nothing: a step of length `t` along the Newton direction scales the gradient on the face by `1 - t`.

use super::budget::Budget;
use super::factor::{Factor, LARGEST_FACTOR};
use super::hessian::Hessian;
use super::operator::Operator;
use super::problem::SEARCH;
use crate::error::Result;
use crate::memory::{checked_len, try_collect, try_copy, try_push, try_room, try_zeros};
use crate::vector::{axpy, dot};

/// Steps after which the gradient is solved for again instead of scaled, to limit rounding errors.
const REUSE: usize = 10;

/// One change since the factor was computed.
struct Border {
    kind: Kind,
    /// `U`'s column: `H_0^{-1} b`
    solved: Vec<f64>,
    /// Row of `C - B^T U`, up to this border.
    schur: Vec<f64>,
}

enum Kind {
    /// The member at this position of `F0` has left.
    Left(usize),
    /// This sample has entered: its column of `H` on `F0`, and `E - q`.
    Entered { sample: usize, column: Vec<f64>, image: Vec<f64> },
}

/// A face with its bordered factor.
pub(crate) struct Face<'a> {
    op: &'a dyn Operator,
    q: &'a [f64],
    kappa: f64,
    factor: Factor,
    members: Vec<usize>,
    borders: Vec<Border>,
    /// `H_0^{-1} (-g)`, scaled from step to step, and the number of steps since it was computed.
    plain: Option<(Vec<f64>, usize)>,
}

impl<'a> Face<'a> {
    /// The face of the samples `free`; `None` if it is too large or cannot be factored, or a limit is reached.
    pub fn new(
        op: &'a dyn Operator,
        q: &'a [f64],
        kappa: f64,
        images: &[f64],
        free: &[bool],
        budget: &mut Budget,
    ) -> Result<Option<Self>> {
        let members: Vec<usize> = try_collect(SEARCH, (0..free.len()).filter(|&i| free[i]))?;
        if members.len() > LARGEST_FACTOR {
            return Ok(None);
        }
        let sub = op.subset(&members)?;
        let images: Vec<f64> = try_collect(SEARCH, members.iter().map(|&i| images[i]))?;
        let factor = Hessian { sub: &*sub, q, kappa }.factor(&images, dot(q, q), budget)?;
        Ok(factor.map(|factor| Self { op, q, kappa, factor, members, borders: Vec::new(), plain: None }))
    }

    /// Number of changes since the factor was computed.
    pub fn changes(&self) -> usize {
        self.borders.len()
    }

    /// Takes a sample out of the face.
    pub fn leave(&mut self, sample: usize) -> Result<()> {
        if let Some(k) =
            self.borders.iter().position(|b| matches!(&b.kind, Kind::Entered { sample: s, .. } if *s == sample))
        {
            self.remove(k);
        } else if let Ok(place) = self.members.binary_search(&sample) {
            let mut solved = try_zeros(SEARCH, self.members.len())?;
            solved[place] = 1.0;
            self.factor.solve(&mut solved);
            self.border(Kind::Left(place), solved)?;
        }
        Ok(())
    }

    /// Adds a sample to the face.
    pub fn enter(&mut self, sample: usize, budget: &mut Budget) -> Result<()> {
        if let Ok(place) = self.members.binary_search(&sample) {
            if let Some(k) = self.borders.iter().position(|b| matches!(b.kind, Kind::Left(p) if p == place)) {
                self.remove(k);
            }
            // Its gradient was not updated while it was out.
            self.plain = None;
            return Ok(());
        }
        // H_ia = <E_i - q, E_a - q> + kappa
        let n = self.op.size();
        let mut unit = try_zeros(SEARCH, n)?;
        unit[sample] = 1.0;
        let mut image = try_zeros(SEARCH, self.q.len())?;
        self.op.apply(&unit, &mut image)?;
        axpy(-1.0, self.q, &mut image);
        let mut values = try_zeros(SEARCH, n)?;
        self.op.apply_transpose(&image, &mut values)?;
        budget.charge(1, n, self.op.entries());
        let constant = self.kappa - dot(self.q, &image);
        let column: Vec<f64> = try_collect(SEARCH, self.members.iter().map(|&i| values[i] + constant))?;
        let mut solved = try_copy(SEARCH, &column)?;
        self.factor.solve(&mut solved);
        self.border(Kind::Entered { sample, column, image }, solved)
    }

    fn border(&mut self, kind: Kind, solved: Vec<f64>) -> Result<()> {
        // Row of C - B^T U against the borders before, and itself
        let mut schur = try_room(SEARCH, self.borders.len() + 1)?;
        schur.extend(self.borders.iter().map(|b| coupling(&kind, &b.kind, &b.solved, self.kappa)));
        schur.push(coupling(&kind, &kind, &solved, self.kappa));
        try_push(SEARCH, &mut self.borders, Border { kind, solved, schur })
    }

    fn remove(&mut self, k: usize) {
        self.borders.remove(k);
        for border in &mut self.borders[k..] {
            border.schur.remove(k);
        }
    }

    /// A step of this length along `p` leaves `(1 - length) g` in exact arithmetic; recomputed after a full step or
    /// `REUSE` steps.
    pub fn stepped(&mut self, length: f64) {
        self.plain = self.plain.take().filter(|(_, age)| length < 1.0 && *age < REUSE).map(|(mut x, age)| {
            for v in &mut x {
                *v *= 1.0 - length;
            }
            (x, age + 1)
        });
    }

    /// `H_FF p = -g` on the current face; `p` is zero elsewhere.
    pub fn newton(&mut self, gradient: &[f64], p: &mut [f64]) -> Result<bool> {
        let c = self.borders.len();
        let (x, age) = match self.plain.take() {
            Some(kept) => kept,
            None => {
                let mut x: Vec<f64> = try_collect(SEARCH, self.members.iter().map(|&i| -gradient[i]))?;
                for border in &self.borders {
                    if let Kind::Left(place) = border.kind {
                        x[place] = 0.0;
                    }
                }
                self.factor.solve(&mut x);
                (x, 0)
            }
        };
        // (C - B^T U) y = c - B^T x
        let mut matrix = try_zeros(SEARCH, checked_len(SEARCH, c, c)?)?;
        let mut y = try_zeros(SEARCH, c)?;
        for (k, row) in self.borders.iter().enumerate() {
            for (l, v) in row.schur.iter().enumerate() {
                matrix[k * c + l] = *v;
                matrix[l * c + k] = *v;
            }
            y[k] = -against(&row.kind, &x);
            if let Kind::Entered { sample, .. } = row.kind {
                y[k] -= gradient[sample];
            }
        }
        if !eliminate(&mut matrix, &mut y) {
            return Ok(false);
        }
        p.fill(0.0);
        for (&i, x) in self.members.iter().zip(&x) {
            p[i] = *x;
        }
        for (border, y) in self.borders.iter().zip(&y) {
            for (&i, u) in self.members.iter().zip(&border.solved) {
                p[i] -= y * u;
            }
        }
        for (border, y) in self.borders.iter().zip(&y) {
            match border.kind {
                Kind::Left(place) => p[self.members[place]] = 0.0,
                Kind::Entered { sample, .. } => p[sample] = *y,
            }
        }
        self.plain = Some((x, age));
        Ok(p.iter().all(|v| v.is_finite()))
    }
}

/// `b^T x`
fn against(kind: &Kind, x: &[f64]) -> f64 {
    match kind {
        Kind::Left(place) => x[*place],
        Kind::Entered { column, .. } => dot(column, x),
    }
}

/// Entry of `C - B^T U` for two borders, `solved` belonging to the second.
fn coupling(row: &Kind, column: &Kind, solved: &[f64], kappa: f64) -> f64 {
    let mut value = -against(row, solved);
    if let (Kind::Entered { image: a, sample: s, .. }, Kind::Entered { image: b, sample: t, .. }) = (row, column) {
        let lift = if s == t { 1e-13 * dot(a, a) } else { 0.0 };
        value += dot(a, b) + kappa + lift;
    }
    value
}

/// Gaussian elimination with partial pivoting, `y <- M^{-1} y`; `false` if singular.
fn eliminate(matrix: &mut [f64], y: &mut [f64]) -> bool {
    let n = y.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&a, &b| matrix[a * n + k].abs().total_cmp(&matrix[b * n + k].abs())).unwrap_or(k);
        if matrix[pivot * n + k] == 0.0 {
            return false;
        }
        if pivot != k {
            for c in 0..n {
                matrix.swap(k * n + c, pivot * n + c);
            }
            y.swap(k, pivot);
        }
        let (above, below) = matrix.split_at_mut((k + 1) * n);
        let top = &above[k * n..];
        for (i, row) in below.chunks_exact_mut(n).enumerate() {
            let factor = row[k] / top[k];
            if factor != 0.0 {
                axpy(-factor, &top[k + 1..], &mut row[k + 1..]);
                y[k + 1 + i] -= factor * y[k];
            }
        }
    }
    for k in (0..n).rev() {
        let row = &matrix[k * n..(k + 1) * n];
        y[k] = (y[k] - dot(&row[k + 1..], &y[k + 1..])) / row[k];
    }
    true
}
