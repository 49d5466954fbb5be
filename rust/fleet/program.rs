//! Dense convex programs of moderate size: `min x'P x / 2 + q'x` subject to rows `C x <= c` and to `||M u - t|| <= z`,
//! where z is the last entry of x and u are the others.
//!
//! A primal-dual interior point with the corrections of Mehrotra and the scaling of Nesterov and Todd. Its linear
//! systems are the normal equations, `P + G' W^-2 G`, in which a cone is the square of its map, which is computed once,
//! and a row. What it finds is a proposal: whoever asks computes from the data how good it is.

use super::scaling::{Scaling, Shape};
use super::units::WHAT;
use crate::error::Result;
use crate::limits::{Factor, Until, padded, squared};
use crate::memory::{checked_len, try_copy, try_filled, try_zeros};
use crate::vector::{axpy, dot, norm};

const ITERATIONS: usize = 80;
/// Iterations without a better point after which no more follow.
const PATIENCE: usize = 8;
/// Of the way to the boundary.
const SHARE: f64 = 0.99;
/// Rounds of a correction of a linear system.
const CORRECTIONS: usize = 3;

/// `by[0] x[at[0]] + by[1] x[at[1]] <= right`
pub(super) struct Pair {
    pub(super) at: [usize; 2],
    pub(super) by: [f64; 2],
    pub(super) right: f64,
}

/// `||M u - t|| <= z`
#[derive(Default)]
pub(super) struct Cone {
    /// `(rows, d)`
    pub(super) map: Vec<f64>,
    pub(super) target: Vec<f64>,
    /// `M'M` in lines of the padded length.
    gram: Vec<f64>,
}

impl Cone {
    pub(super) fn new(map: Vec<f64>, target: Vec<f64>, d: usize, until: Until<'_>) -> Result<Self> {
        let ld = padded(d);
        let mut lines = try_zeros(WHAT, checked_len(WHAT, target.len(), ld)?)?;
        for (line, row) in lines.chunks_exact_mut(ld).zip(map.chunks_exact(d)) {
            line[..d].copy_from_slice(row);
        }
        let mut gram = try_zeros(WHAT, checked_len(WHAT, d, ld)?)?;
        squared(&lines, d, ld, &mut gram, until)?;
        Ok(Self { map, target, gram })
    }
}

/// A program; `squares` (columns, columns) is P, or empty for 0.
pub(super) struct Program<'a> {
    pub(super) columns: usize,
    pub(super) squares: &'a [f64],
    pub(super) linear: Vec<f64>,
    pub(super) pairs: Vec<Pair>,
    /// `(len of right, columns)`
    pub(super) rows: Vec<f64>,
    pub(super) right: Vec<f64>,
    pub(super) cones: Vec<&'a Cone>,
}

/// What was found: `multipliers` of the pairs, the rows and, one after another, the cones; the largest of the gap and
/// the residuals, relative.
pub(super) struct Point {
    pub(super) x: Vec<f64>,
    pub(super) multipliers: Vec<f64>,
    pub(super) merit: f64,
}

impl Program<'_> {
    fn shape(&self) -> Shape {
        let side = self.cones.first().map_or(1, |cone| cone.target.len() + 1);
        Shape { flat: self.pairs.len() + self.right.len(), side }
    }

    fn ends(&self) -> Result<Vec<f64>> {
        let shape = self.shape();
        let mut h = try_zeros(WHAT, shape.flat + self.cones.len() * shape.side)?;
        let flat = self.pairs.iter().map(|pair| pair.right).chain(self.right.iter().copied());
        h.iter_mut().zip(flat).for_each(|(h, right)| *h = right);
        for (h, cone) in h[shape.flat..].chunks_exact_mut(shape.side).zip(&self.cones) {
            h[1..].iter_mut().zip(&cone.target).for_each(|(h, t)| *h = -t);
        }
        Ok(h)
    }

    /// `y += scale G x`
    fn forth(&self, x: &[f64], scale: f64, y: &mut [f64]) {
        let (pairs, rest) = y.split_at_mut(self.pairs.len());
        for (y, pair) in pairs.iter_mut().zip(&self.pairs) {
            *y += scale * (pair.by[0] * x[pair.at[0]] + pair.by[1] * x[pair.at[1]]);
        }
        let (rows, cones) = rest.split_at_mut(self.right.len());
        for (y, row) in rows.iter_mut().zip(self.rows.chunks_exact(self.columns)) {
            *y += scale * dot(row, x);
        }
        let d = self.columns - 1;
        for (y, cone) in cones.chunks_exact_mut(self.shape().side).zip(&self.cones) {
            y[0] -= scale * x[d];
            for (y, row) in y[1..].iter_mut().zip(cone.map.chunks_exact(d)) {
                *y -= scale * dot(row, &x[..d]);
            }
        }
    }

    /// `x += scale G' y`
    fn back(&self, y: &[f64], scale: f64, x: &mut [f64]) {
        let (pairs, rest) = y.split_at(self.pairs.len());
        for (y, pair) in pairs.iter().zip(&self.pairs) {
            x[pair.at[0]] += scale * pair.by[0] * y;
            x[pair.at[1]] += scale * pair.by[1] * y;
        }
        let (rows, cones) = rest.split_at(self.right.len());
        for (y, row) in rows.iter().zip(self.rows.chunks_exact(self.columns)) {
            axpy(scale * y, row, x);
        }
        let d = self.columns - 1;
        for (y, cone) in cones.chunks_exact(self.shape().side).zip(&self.cones) {
            x[d] -= scale * y[0];
            for (y, row) in y[1..].iter().zip(cone.map.chunks_exact(d)) {
                axpy(-scale * y, row, &mut x[..d]);
            }
        }
    }

    /// `to += P x`
    fn curve(&self, x: &[f64], to: &mut [f64]) {
        for (to, row) in to.iter_mut().zip(self.squares.chunks_exact(self.columns)) {
            *to += dot(row, x);
        }
    }

    /// Factors `P + G' W^-2 G`. Without a scaling W is 1.
    fn factor(&self, scaling: Option<&Scaling>, work: &mut Work, until: Until<'_>) -> Result<bool> {
        let (v, ld, shape) = (self.columns, padded(self.columns), self.shape());
        let mut weights = try_filled(WHAT, 1.0, shape.flat)?;
        if let Some(scaling) = scaling {
            weights.iter_mut().zip(scaling.weights()).for_each(|(to, w)| *to = w);
        }
        let (of_pairs, of_rows) = weights.split_at(self.pairs.len());
        let mut lines = try_zeros(WHAT, checked_len(WHAT, of_rows.len() + self.cones.len(), ld)?)?;
        for ((line, row), w) in lines.chunks_exact_mut(ld).zip(self.rows.chunks_exact(v)).zip(of_rows) {
            axpy(w.sqrt(), row, &mut line[..v]);
        }
        let rest = lines.chunks_exact_mut(ld).skip(of_rows.len());
        if let Some(scaling) = scaling {
            let points = scaling.points.chunks_exact(shape.side);
            for ((line, cone), (w, beta)) in rest.zip(&self.cones).zip(points.zip(&scaling.beta)) {
                // the row G' J w
                for (row, w) in cone.map.chunks_exact(v - 1).zip(&w[1..]) {
                    axpy(*w, row, &mut line[..v - 1]);
                }
                line[v - 1] = -w[0];
                line.iter_mut().for_each(|x| *x *= 2.0f64.sqrt() / beta);
            }
        }
        squared(&lines, v, ld, &mut work.h, until)?;
        let h = &mut work.h;
        // only from the diagonal on
        for (i, (line, row)) in h.chunks_exact_mut(ld).zip(self.squares.chunks_exact(v)).enumerate() {
            axpy(1.0, &row[i..], &mut line[i..v]);
        }
        for (pair, w) in self.pairs.iter().zip(of_pairs) {
            for (i, by) in pair.at.iter().zip(&pair.by) {
                for (j, other) in pair.at.iter().zip(&pair.by) {
                    h[i * ld + j] += w * by * other;
                }
            }
        }
        let side = padded(v - 1);
        for (k, cone) in self.cones.iter().enumerate() {
            let share = scaling.map_or(1.0, |scaling| scaling.beta[k].powi(-2));
            for (i, (line, row)) in h.chunks_exact_mut(ld).zip(cone.gram.chunks_exact(side)).enumerate() {
                axpy(share, &row[i..v - 1], &mut line[i..v - 1]);
            }
            let head = if scaling.is_some() { -share } else { share };
            h[(v - 1) * ld + v - 1] += head;
        }
        let most = (0..v).fold(f64::MIN_POSITIVE, |most, j| most.max(h[j * ld + j]));
        for more in [f64::EPSILON, 1e-13, 1e-11, 1e-9] {
            let column = |j: usize, to: &mut [f64]| {
                to.copy_from_slice(&h[j * ld + j..j * ld + v]);
                to[0] += more * most.min(1e6 * to[0] + more * most);
            };
            if work.factor.set(v, column, until)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// `x` with `(P + G' W^-2 G) x = b`, corrected by the residual.
    fn inverse(&self, scaling: Option<&Scaling>, work: &mut Work, b: &[f64]) -> Result<Vec<f64>> {
        let (v, mut least) = (self.columns, f64::INFINITY);
        let (mut x, mut rest) = (try_zeros(WHAT, v)?, try_copy(WHAT, b)?);
        let mut kept = try_zeros(WHAT, v)?;
        for _ in 0..=CORRECTIONS {
            work.line[..v].copy_from_slice(&rest);
            work.line[v..].fill(0.0);
            work.factor.solve(&mut work.line);
            axpy(1.0, &work.line[..v], &mut x);
            // b - H x
            rest.copy_from_slice(b);
            let mut y = try_zeros(WHAT, work.len)?;
            self.forth(&x, 1.0, &mut y);
            if let Some(scaling) = scaling {
                scaling.undo(&mut y);
                scaling.undo(&mut y);
            }
            let mut product = try_zeros(WHAT, v)?;
            self.curve(&x, &mut product);
            self.back(&y, 1.0, &mut product);
            axpy(-1.0, &product, &mut rest);
            let size = norm(&rest);
            if size >= least || size.is_nan() {
                return Ok(kept);
            }
            kept.copy_from_slice(&x);
            if size <= 1e-14 * norm(b) || size > 0.3 * least {
                return Ok(kept);
            }
            least = size;
        }
        Ok(kept)
    }

    /// Solves it until the largest of the gap and the residuals is at most `tolerance`, or as far as rounding lets it.
    pub(super) fn solve(&self, tolerance: f64, until: Until<'_>) -> Result<Point> {
        let (shape, h) = (self.shape(), self.ends()?);
        let mut work = Work::new(self.columns, h.len())?;
        let mut best =
            Point { x: try_zeros(WHAT, self.columns)?, multipliers: try_zeros(WHAT, h.len())?, merit: f64::INFINITY };
        if !self.factor(None, &mut work, until)? {
            return Ok(best);
        }
        // x and z of `min x'P x / 2 + q'x + ||h - G x||^2 / 2`, and both moved inside
        let mut b = try_zeros(WHAT, self.columns)?;
        self.back(&h, 1.0, &mut b);
        axpy(-1.0, &self.linear, &mut b);
        let mut x = self.inverse(None, &mut work, &b)?;
        let mut s = try_copy(WHAT, &h)?;
        self.forth(&x, -1.0, &mut s);
        let mut z = try_zeros(WHAT, h.len())?;
        axpy(-1.0, &s, &mut z);
        for part in [&mut s, &mut z] {
            let lacking = shape.lacking(part);
            if lacking >= -1e-8 * norm(part).max(1.0) {
                shape.shift(part, 1.0 + lacking);
            }
        }
        let (size_x, size_z) = (norm(&self.linear).max(1.0), norm(&h).max(1.0));
        let mut waits = 0;
        for _ in 0..ITERATIONS {
            let mut curved = try_zeros(WHAT, self.columns)?;
            self.curve(&x, &mut curved);
            let cost = dot(&x, &curved) / 2.0 + dot(&x, &self.linear);
            // rx = P x + q + G'z, rz = s + G x - h
            let (mut rx, mut rz) = (curved, try_copy(WHAT, &s)?);
            axpy(1.0, &self.linear, &mut rx);
            self.back(&z, 1.0, &mut rx);
            axpy(-1.0, &h, &mut rz);
            self.forth(&x, 1.0, &mut rz);
            let gap = dot(&s, &z);
            let merit = (gap / cost.abs().max(1.0)).max(norm(&rx) / size_x).max(norm(&rz) / size_z);
            if merit < best.merit {
                (best.merit, waits) = (merit, 0);
                best.x.copy_from_slice(&x);
                best.multipliers.copy_from_slice(&z);
            } else {
                waits += 1;
            }
            if best.merit <= tolerance || waits >= PATIENCE || !merit.is_finite() {
                break;
            }
            let Some(scaling) = Scaling::new(shape, &s, &z)? else { break };
            if !self.factor(Some(&scaling), &mut work, until)? {
                break;
            }
            let (mut centre, mut correction) = (0.0, try_zeros(WHAT, h.len())?);
            let mut way = 0.0;
            for last in [false, true] {
                // right = middle \ (centre e - middle o middle - correction)
                let mut right = try_copy(WHAT, &scaling.middle)?;
                shape.times(&mut right, &scaling.middle);
                axpy(1.0, &correction, &mut right);
                right.iter_mut().for_each(|v| *v = -*v);
                shape.shift(&mut right, centre);
                shape.divide(&mut right, &scaling.middle);
                // scaled = W^-1 rz + right
                let mut scaled = try_copy(WHAT, &rz)?;
                scaling.undo(&mut scaled);
                axpy(1.0, &right, &mut scaled);
                let mut pulled = try_copy(WHAT, &scaled)?;
                scaling.undo(&mut pulled);
                let mut b = try_zeros(WHAT, self.columns)?;
                axpy(-1.0, &rx, &mut b);
                self.back(&pulled, -1.0, &mut b);
                let dx = self.inverse(Some(&scaling), &mut work, &b)?;
                // W dz = W^-1 G dx + scaled, W^-1 ds = right - W dz
                let mut dz = try_zeros(WHAT, h.len())?;
                self.forth(&dx, 1.0, &mut dz);
                scaling.undo(&mut dz);
                axpy(1.0, &scaled, &mut dz);
                let mut ds = right;
                axpy(-1.0, &dz, &mut ds);
                let most = shape.way(&scaling.middle, &ds).min(shape.way(&scaling.middle, &dz));
                if !last {
                    way = most.min(1.0);
                    let rest = (1.0 - way + dot(&ds, &dz) / gap * way * way).clamp(0.0, 1.0);
                    centre = rest.powi(3) * gap / shape.degree(h.len());
                    correction = try_copy(WHAT, &ds)?;
                    shape.times(&mut correction, &dz);
                    continue;
                }
                way = (SHARE * most).min(1.0);
                scaling.times(&mut ds);
                scaling.undo(&mut dz);
                axpy(way, &dx, &mut x);
                axpy(way, &ds, &mut s);
                axpy(way, &dz, &mut z);
            }
            if way <= 1e-10 || way.is_nan() {
                break;
            }
        }
        Ok(best)
    }
}

/// Memory of the linear systems.
struct Work {
    h: Vec<f64>,
    factor: Factor,
    line: Vec<f64>,
    len: usize,
}

impl Work {
    fn new(columns: usize, len: usize) -> Result<Self> {
        let ld = padded(columns);
        Ok(Self {
            h: try_zeros(WHAT, checked_len(WHAT, columns, ld)?)?,
            factor: Factor::new(columns)?,
            line: try_zeros(WHAT, ld)?,
            len,
        })
    }
}
