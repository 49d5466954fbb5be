//! Primal active set method with a factor: the last rung, and the way through the hard spot `N = 2 d`.
//!
//! On a face of the homogenised problem (see `newton_cg`) the minimiser is one linear system with the free block `H_FF`. Walk
//! towards it; a weight that reaches zero on the way leaves the face, at the minimiser the sample with the most negative
//! gradient enters (Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23). Exact where conjugate gradients crawl, but
//! one sample per step: for starts with nearly the right support.
//!
//! The factor belongs to an earlier face `F0`. Each change since borders the system, `H_0 x + B y = b`, `B^T x + C y = c`:
//!
//! * a sample that entered brings its column of `H` (and `C` the block among those that entered);
//! * a sample that left brings a unit vector: its weight must not change.
//!
//! With `U = H_0^{-1} B` kept, a step costs one solve with the factor and a small dense system with `C - B^T U`.

use super::budget::Budget;
use super::factor::{Factor, LARGEST_FACTOR, solve_cost};
use super::hessian::Hessian;
use super::newton_cg::{Iterate, Work};
use super::operator::Operator;
use super::vector::{axpy, dot, min, norm, sum};

/// Steps after which the gradient is no longer scaled but solved for.
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
    /// The member at this place of `F0` has left.
    Left(usize),
    /// This sample has entered: its column of `H` on `F0`, and `E - q`.
    Entered { sample: usize, column: Vec<f64>, image: Vec<f64> },
}

/// A face with its bordered factor.
struct Face<'a, O: Operator> {
    op: &'a O,
    q: &'a [f64],
    kappa: f64,
    factor: Factor,
    members: Vec<usize>,
    borders: Vec<Border>,
    /// `H_0^{-1} (-g)`, kept while it can be scaled from step to step, and for how many steps it has been.
    plain: Option<(Vec<f64>, usize)>,
}

impl<'a, O: Operator> Face<'a, O> {
    fn new(op: &'a O, q: &'a [f64], kappa: f64, images: &[f64], free: &[bool], budget: &mut Budget) -> Option<Self> {
        let members: Vec<usize> = (0..free.len()).filter(|&i| free[i]).collect();
        if members.len() > LARGEST_FACTOR {
            return None;
        }
        let sub = op.subset(&members);
        let images: Vec<f64> = members.iter().map(|&i| images[i]).collect();
        let factor = Hessian { sub: &sub, q, kappa }.factor(&images, dot(q, q), budget)?;
        Some(Self { op, q, kappa, factor, members, borders: Vec::new(), plain: None })
    }

    fn leave(&mut self, sample: usize) {
        if let Some(k) =
            self.borders.iter().position(|b| matches!(&b.kind, Kind::Entered { sample: s, .. } if *s == sample))
        {
            self.remove(k);
        } else if let Ok(place) = self.members.binary_search(&sample) {
            let mut solved = vec![0.0; self.members.len()];
            solved[place] = 1.0;
            self.factor.solve(&mut solved);
            self.border(Kind::Left(place), solved);
        }
    }

    fn enter(&mut self, sample: usize, budget: &mut Budget) {
        if let Ok(place) = self.members.binary_search(&sample) {
            if let Some(k) = self.borders.iter().position(|b| matches!(b.kind, Kind::Left(p) if p == place)) {
                self.remove(k);
            }
            // Its gradient was not followed while it was out.
            self.plain = None;
            return;
        }
        // H_ia = <E_i - q, E_a - q> + kappa
        let n = self.op.size();
        let mut unit = vec![0.0; n];
        unit[sample] = 1.0;
        let mut image = vec![0.0; self.q.len()];
        self.op.apply(&unit, &mut image);
        axpy(-1.0, self.q, &mut image);
        let mut values = vec![0.0; n];
        self.op.apply_transpose(&image, &mut values);
        budget.charge(1, n, self.op.entries());
        let constant = self.kappa - dot(self.q, &image);
        let column: Vec<f64> = self.members.iter().map(|&i| values[i] + constant).collect();
        let mut solved = column.clone();
        self.factor.solve(&mut solved);
        self.border(Kind::Entered { sample, column, image }, solved);
    }

    fn border(&mut self, kind: Kind, solved: Vec<f64>) {
        // Row of C - B^T U against the borders before, and itself
        let mut schur: Vec<f64> =
            self.borders.iter().map(|b| coupling(&kind, &b.kind, &b.solved, self.kappa)).collect();
        schur.push(coupling(&kind, &kind, &solved, self.kappa));
        self.borders.push(Border { kind, solved, schur });
    }

    fn remove(&mut self, k: usize) {
        self.borders.remove(k);
        for border in &mut self.borders[k..] {
            border.schur.remove(k);
        }
    }

    /// A step of this length along `p` leaves `(1 - length) g`, exactly in theory; in the end, and now and then, from scratch.
    fn stepped(&mut self, length: f64) {
        self.plain = self.plain.take().filter(|(_, age)| length < 1.0 && *age < REUSE).map(|(mut x, age)| {
            for v in &mut x {
                *v *= 1.0 - length;
            }
            (x, age + 1)
        });
    }

    /// `H_FF p = -g` on the present face; `p` is zero elsewhere.
    fn newton(&mut self, gradient: &[f64], p: &mut [f64]) -> bool {
        let c = self.borders.len();
        let (x, age) = match self.plain.take() {
            Some(kept) => kept,
            None => {
                let mut x: Vec<f64> = self.members.iter().map(|&i| -gradient[i]).collect();
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
        let mut matrix = vec![0.0; c * c];
        let mut y = vec![0.0; c];
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
            return false;
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
        p.iter().all(|v| v.is_finite())
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

/// Walks from `start` (on the simplex) until the gap is below `tol`, no step helps, or `steps` have been made.
pub(crate) fn solve<O: Operator>(
    op: &O,
    q: &[f64],
    start: &[f64],
    tol: f64,
    steps: usize,
    budget: &mut Budget,
    work: &mut Work,
) -> Iterate {
    let (n, d) = (op.size(), op.dim());
    let qq = dot(q, q);
    let mut images = vec![0.0; n];
    op.apply_transpose(q, &mut images);
    let spread = (0..n).map(|i| (op.squared_norm(i) - 2.0 * images[i] + qq).max(0.0)).sum::<f64>() / n as f64;
    let kappa = (spread / (d as f64).sqrt()).max(f64::MIN_POSITIVE);

    let mut w = start.to_vec();
    let mut free: Vec<bool> = w.iter().map(|w| *w > 0.0).collect();
    let mut best = Iterate { weights: w.clone(), gap: f64::INFINITY };
    let (mut r, mut a, mut p) = (vec![0.0; d], vec![0.0; n], vec![0.0; n]);
    let mut face: Option<Face<O>> = None;
    let mut barred: Option<usize> = None;
    for _ in 0..steps {
        let s = sum(&w);
        op.apply(&w, &mut r);
        axpy(-s, q, &mut r);
        op.apply_transpose(&r, &mut a);
        let rq = dot(q, &r);
        for v in &mut a {
            *v -= rq;
        }
        let gap = 2.0 * (dot(&r, &r) / (s * s) - min(&a) / s);
        if gap < best.gap {
            best.weights.copy_from_slice(&w);
            best.gap = gap;
        }
        if !(gap > tol && s > 0.0) || budget.charge(2, n, op.entries()) {
            break;
        }
        for v in &mut a {
            *v += kappa * (s - 1.0);
        }
        let (mut residual, mut lowest, mut enter) = (0.0_f64, 0.0, None);
        for i in 0..n {
            if free[i] {
                residual = residual.max(a[i].abs());
            } else if a[i] < lowest && barred != Some(i) {
                (lowest, enter) = (a[i], Some(i));
            }
        }

        let count = free.iter().filter(|f| **f).count();
        if face.as_ref().is_none_or(|f| f.borders.len() > (count / 6).clamp(4, 96.max(count / 25))) {
            work.factors += 1;
            face = Face::new(op, q, kappa, &images, &free, budget);
        }
        let Some(face) = face.as_mut() else { break };
        // At the minimiser of the face: let the best sample in.
        if residual <= 0.1 * lowest.abs()
            && let Some(i) = enter
        {
            free[i] = true;
            face.enter(i, budget);
        } else if enter.is_none() && residual <= 1e-3 * tol {
            break;
        }
        if !face.newton(&a, &mut p) {
            break;
        }
        work.newton += 1;
        budget.charge(1, solve_cost(count) as usize, 1);
        // The longest step that keeps w >= 0
        let (mut length, mut blocking) = (1.0, None);
        for i in 0..n {
            if free[i] && p[i] < 0.0 && w[i] + length * p[i] < 0.0 {
                (length, blocking) = (-w[i] / p[i], Some(i));
            }
        }
        for ((w, p), free) in w.iter_mut().zip(&p).zip(&free) {
            if *free {
                *w = (*w + length * p).max(0.0);
            }
        }
        face.stepped(length);
        barred = None;
        if let Some(i) = blocking {
            w[i] = 0.0;
            free[i] = false;
            face.leave(i);
            if length == 0.0 {
                barred = Some(i);
            }
        } else if norm(&p) <= 1e-16 * norm(&w) {
            break;
        }
    }
    if !super::threshold::normalise(&mut best.weights) {
        best = Iterate { weights: vec![1.0 / n as f64; n], gap: f64::INFINITY };
    }
    best
}
