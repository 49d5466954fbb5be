//! Atoms and diameters of a control problem under a linear map.
//!
//! The error of a fused control is `u - v* = M (y_hat - y)` with `y = xf - A x0`; that of the state it leads to has the
//! same form. In an orthonormal basis of the rows of `B^+`, for `B = U diag(s) V'`:
//!
//! - state: `M = U'`, as `||B (u - v*)|| = ||U U' (y_hat - y)||`;
//! - control: `M = diag(1/s) U'`.

use super::sizes::{WHAT, largest, nonzero, one_norm, sign, unit_of};
use crate::control::{pseudoinverse, times, transposed};
use crate::error::{Error, Result, require_finite};
use crate::memory::{checked_len, try_collect, try_filled, try_zeros};
use crate::vector::{dot, norm};

/// A control problem.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// (n, n) and (n, m), row by row.
    pub a: &'a [f64],
    /// (n, m)
    pub b: &'a [f64],
    /// The initial state (n).
    pub x0: &'a [f64],
    /// The target (n).
    pub xf: &'a [f64],
    /// Whether rows of `A` are sampled, not columns.
    pub rows: bool,
    /// Whether the error is that of the control, not of the state.
    pub control: bool,
    /// Whether N controls are averaged (diagonal fusion), not every entity for itself (product fusion).
    pub paired: bool,
}

/// `A`, `x0`, `xf` and `M` in units in which nothing overflows, and how far realizations can be apart.
#[derive(Debug)]
pub struct Image {
    /// States.
    pub n: usize,
    /// Whether rows of `A` are sampled, not columns.
    pub rows: bool,
    /// The unit of the error.
    pub unit: f64,
    /// The unit of `x0`.
    pub unit_x0: f64,
    /// (n, n)
    pub a: Vec<f64>,
    /// (n)
    pub x0: Vec<f64>,
    /// (n)
    pub xf: Vec<f64>,
    /// `M e_i` of every i, (n, rank); rank 1 for `B = 0`.
    pub images: Vec<f64>,
    /// `M A e_j` of every j, (n, rank).
    pub moved: Vec<f64>,
    /// `||M||_2`
    norm: f64,
    /// `||x0||_1`
    pub g0: f64,
    /// At least `E||M (A^s - A) e_j||^2`; by columns equal.
    pub tau: Vec<f64>,
    /// By columns the diameter of column j of `M A^s`, by rows `||M e_i|| ||row i||_1`; 0 for exact lines.
    widths: Vec<f64>,
    /// The diameter of `M xf^s`.
    pub d_f: f64,
    /// How far `M xf^s` is from its mean.
    pub(super) reach_f: f64,
    /// How far `M A x0^s` is from its mean.
    pub(super) reach_0: f64,
    /// How far `M A^s x0` is from its mean.
    pub reach_a: f64,
    /// How far `M A^s x0^s` is from its mean.
    pub reach_z: f64,
    /// The largest [`Image::range`] of an average of `x0`.
    pub cap_a: f64,
    /// How fast [`Image::range`] grows with the distance from `x0`.
    pub slope_a: f64,
    /// `||M A d||^2` for the differences d of two atoms of `x0`, and an upper bound of `E||M (A^s - A) d||^2`.
    pairs: Vec<(f64, f64)>,
}

impl Image {
    /// The ranges of a problem.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NonFinite`], [`Error::Overflow`], [`Error::Numerical`], [`Error::Memory`].
    pub fn new(of: Problem<'_>) -> Result<Self> {
        let mut found = Self::scaled(of)?;
        found.moved = times(&transposed(&found.a, found.n)?, &found.images, found.n)?;
        let (of_xf, of_x0) = (found.atoms(&found.xf, &found.images)?, found.atoms(&found.x0, &found.moved)?);
        let r = found.rank();
        found.reach_f = farthest(&of_xf, &sums(&found.images, &found.xf, r)?);
        found.d_f = apart(&of_xf, r, 1.0)?.iter().fold(0.0f64, |m, v| m.max(*v)).sqrt();
        let centre = sums(&found.moved, &found.x0, r)?;
        found.reach_0 = farthest(&of_x0, &centre);
        if found.rows {
            found.rows_of_a()?
        } else {
            found.columns_of_a(&centre)?
        }
        let hit = try_collect(WHAT, (0..found.n).filter(|j| found.x0[*j] != 0.0))?;
        let between = apart(&of_x0, r, 1.0)?;
        let places = (0..hit.len()).flat_map(|i| (0..i).map(move |k| (i, k)));
        let extra = |i: usize, k: usize| found.g0 * found.g0 * (found.tau[hit[i]] + found.tau[hit[k]]);
        found.pairs = try_collect(WHAT, places.map(|(i, k)| (between[i * hit.len() + k], extra(i, k))))?;
        Ok(found)
    }

    /// The problem in its units.
    fn scaled(of: Problem<'_>) -> Result<Self> {
        let (n, Problem { a, b, x0, xf, rows, control, .. }) = (of.x0.len(), of);
        let square = checked_len(WHAT, n, n)?;
        if n == 0 || a.len() != square || xf.len() != n || b.is_empty() || !b.len().is_multiple_of(n) {
            let found = format!("{}, {}, {} and {n} entries", a.len(), b.len(), xf.len());
            return Err(Error::Shape { name: "A, B, xf, x0", expected: "sizes of one system".into(), found });
        }
        for (name, values) in [("A", a), ("B", b), ("x0", x0), ("xf", xf)] {
            require_finite(name, values)?;
        }
        let (unit_a, unit_b, still) = (unit_of(a), unit_of(b), largest(a) == 0.0);
        let product = if still || largest(x0) == 0.0 { 0.0 } else { unit_a * unit_of(x0) };
        let unit_y = Some(product.max(largest(xf))).filter(|unit| *unit > 0.0).unwrap_or(1.0);
        let (unit_x0, unit) = (unit_y / unit_a, if control { unit_y / unit_b } else { unit_y });
        if ![unit_y, unit_x0, unit].iter().all(|unit| *unit > 0.0 && unit.is_finite()) {
            return Err(Error::Overflow { what: "`A x0`, or the control, under- or" });
        }
        let over = |values: &[f64], unit: f64| try_collect(WHAT, values.iter().map(|v| v / unit));
        let factors = pseudoinverse(&over(b, unit_b)?, n, b.len() / n)?;
        let (rank, of_state) = (factors.rank, !control);
        let entry =
            |i: usize, k: usize| factors.basis[k * n + i] / if of_state { 1.0 } else { factors.singular_values[k] };
        let images = (0..n).flat_map(|i| (0..rank).map(move |k| (i, k))).map(|(i, k)| entry(i, k));
        Ok(Self {
            n,
            rows,
            unit,
            unit_x0,
            a: over(a, unit_a)?,
            // without A, x0 has no effect whatever its size
            x0: if still { try_zeros(WHAT, n)? } else { over(x0, unit_x0)? },
            xf: over(xf, unit_y)?,
            images: if rank == 0 { try_zeros(WHAT, n)? } else { try_collect(WHAT, images)? },
            norm: match rank {
                0 => 0.0,
                _ if of_state => 1.0,
                _ => 1.0 / factors.singular_values[rank - 1],
            },
            moved: Vec::new(),
            g0: if still { 0.0 } else { one_norm(x0) / unit_x0 },
            tau: try_zeros(WHAT, n)?,
            widths: try_zeros(WHAT, n)?,
            d_f: 0.0,
            reach_f: 0.0,
            reach_0: 0.0,
            reach_a: 0.0,
            reach_z: 0.0,
            cap_a: 0.0,
            slope_a: 0.0,
            pairs: Vec::new(),
        })
    }

    /// The rank of `M`, 1 for `M = 0`.
    pub(super) fn rank(&self) -> usize {
        self.images.len() / self.n
    }

    /// `||M e_i||` of every i.
    pub(super) fn norms(&self) -> Result<Vec<f64>> {
        try_collect(WHAT, self.images.chunks_exact(self.rank()).map(norm))
    }

    /// `||w||_1 sign(w_i) p_i` of every `w_i != 0`.
    fn atoms(&self, w: &[f64], points: &[f64]) -> Result<Vec<f64>> {
        let (g, r) = (one_norm(w), self.rank());
        let hit = w.iter().zip(points.chunks_exact(r)).filter(|(w, _)| **w != 0.0);
        try_collect(WHAT, hit.flat_map(|(w, point)| point.iter().map(move |p| g * sign(*w) * p)))
    }

    /// Column j of `A^s` is one of the atoms `g_j sign(a_ij) e_i`.
    fn columns_of_a(&mut self, centre: &[f64]) -> Result<()> {
        let (n, r, lines, m) = (self.n, self.rank(), transposed(&self.a, self.n)?, self.norms()?);
        // sum_k |a_kj| ||M (s_i e_i - s_k e_k)||^2 for the atom i of column j, s the signs of a_j
        let (alike, unlike) = (apart(&self.images, r, 1.0)?, apart(&self.images, r, -1.0)?);
        let up = try_collect(WHAT, lines.iter().map(|v| v.max(0.0)))?;
        let down = try_collect(WHAT, lines.iter().map(|v| (-v).max(0.0)))?;
        let sum = |a: &[f64], b: &[f64]| -> Result<Vec<f64>> {
            let mut found = times(&up, a, n)?;
            found.iter_mut().zip(times(&down, b, n)?).for_each(|(to, v)| *to += v);
            Ok(found)
        };
        let (of_plus, of_minus) = (sum(&alike, &unlike)?, sum(&unlike, &alike)?);
        let mut g = try_zeros(WHAT, n)?;
        for (j, line) in lines.chunks_exact(n).enumerate() {
            let distance = |i: usize| if line[i] > 0.0 { of_plus[j * n + i] } else { of_minus[j * n + i] };
            g[j] = one_norm(line);
            // tr(M Cv(a_j) M')
            self.tau[j] = line.iter().enumerate().map(|(i, v)| v.abs() * distance(i)).sum::<f64>() / 2.0;
            if nonzero(line) < 2 {
                continue;
            }
            let present = || (0..n).filter(|i| line[*i] != 0.0);
            // two atoms are at most sqrt(2) g ||M|| and g (m_1 + m_2) apart
            let (second, first) =
                present().fold(
                    (0.0, 0.0),
                    |(second, first): (f64, f64), i| {
                        if m[i] > first { (first, m[i]) } else { (second.max(m[i]), first) }
                    },
                );
            self.widths[j] = g[j] * (first + second).min(2f64.sqrt() * self.norm);
            // ||M (atom - a_j)||^2 = g_j distance - tau_j; the largest is at least tau_j
            let far = present().fold(0.0f64, |far, i| far.max(g[j] * distance(i) - self.tau[j])).sqrt();
            self.reach_a += self.x0[j].abs() * far;
        }
        let hit = self.widths.iter().zip(&self.x0).filter(|(_, x)| **x != 0.0);
        self.slope_a = hit.fold(0.0f64, |m, (width, _)| m.max(*width));
        self.cap_a = self.g0 * self.slope_a;
        // atoms of A^s x0^s: at each i the ends, and 0 where x0 meets a zero column
        let off = |image: &[f64], factor: f64| norm_of(image.iter().zip(centre).map(|(p, c)| p * factor - c));
        for (image, row) in self.images.chunks_exact(r).zip(self.a.chunks_exact(n)) {
            let met = (0..n).filter(|j| row[*j] != 0.0 && self.x0[*j] != 0.0);
            let values = met.map(|j| sign(row[j]) * sign(self.x0[j]) * self.g0 * g[j]);
            let far = values.fold(0.0f64, |far, value| far.max(off(image, value)));
            self.reach_z = self.reach_z.max(far);
        }
        if g.iter().zip(&self.x0).any(|(g, x)| *g == 0.0 && *x != 0.0) {
            self.reach_z = self.reach_z.max(norm(centre));
        }
        Ok(())
    }

    /// Entry (i, j) of `A^s` is `rho_i sign(a_ij)` for one j in each row i.
    fn rows_of_a(&mut self) -> Result<()> {
        let (n, m) = (self.n, self.norms()?);
        // at j how far entry i of A^s x0^s, where x0^s hits j, is from (A x0)_i: summed, and squared
        let (mut sums, mut squares): (Vec<f64>, Vec<f64>) = (try_zeros(WHAT, n)?, try_zeros(WHAT, n)?);
        let (mut sum, mut square, mut slopes) = (0.0, 0.0, 0.0);
        for (i, row) in self.a.chunks_exact(n).enumerate() {
            let (rho, random, mean) = (one_norm(row), nonzero(row) >= 2, dot(row, &self.x0));
            self.tau.iter_mut().zip(row).for_each(|(tau, v)| *tau += m[i] * m[i] * rho * v.abs());
            if random {
                self.widths[i] = rho * m[i];
                slopes += self.widths[i] * self.widths[i];
            }
            let present = row.iter().zip(&self.x0).filter(|(v, _)| **v != 0.0);
            let deviation = present.fold(0.0f64, |far, (v, x)| far.max((rho * sign(*v) * x - mean).abs()));
            sum += m[i] * deviation;
            square += deviation * deviation;
            for (j, (v, x)) in row.iter().zip(&self.x0).enumerate() {
                let hit = (self.g0 * rho * sign(*v) * sign(*x) - mean).abs();
                let away = if random { hit.max(mean.abs()) } else { hit };
                sums[j] += m[i] * away;
                squares[j] += away * away;
            }
        }
        self.slope_a = (2.0 * slopes).sqrt();
        self.cap_a = self.g0 * self.slope_a / 2f64.sqrt();
        self.reach_a = sum.min(self.norm * square.sqrt());
        let hit = (0..n).filter(|j| self.x0[*j] != 0.0);
        self.reach_z = hit.fold(0.0f64, |far, j| far.max(sums[j].min(self.norm * squares[j].sqrt())));
        Ok(())
    }

    /// The root of the summed squared ranges of one `M A^s x`: by columns `sum_j x_j^2 D_j^2`.
    #[must_use]
    pub fn range(&self, x: &[f64]) -> f64 {
        if !self.rows {
            return norm_of(self.widths.iter().zip(x).map(|(width, x)| width * x));
        }
        norm_of(self.widths.iter().zip(self.a.chunks_exact(self.n)).map(|(width, row)| {
            let values = row.iter().zip(x).filter(|(v, _)| **v != 0.0).map(|(v, x)| sign(*v) * x);
            let (low, high) =
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
            if *width > 0.0 { width * (high - low) } else { 0.0 }
        }))
    }

    /// The largest `||M A d||^2 + rate E||M (A^s - A) d||^2` for the difference d of two atoms of `x0`.
    #[must_use]
    pub fn d_0_squared(&self, rate: f64) -> f64 {
        self.pairs.iter().fold(0.0, |m, (between, extra)| m.max(between + rate * extra))
    }
}

/// `||p_i - sign p_k||^2` of points (k, r).
fn apart(points: &[f64], r: usize, sign: f64) -> Result<Vec<f64>> {
    let count = points.len() / r;
    let squares = try_collect(WHAT, points.chunks_exact(r).map(|p| dot(p, p)))?;
    let mut found = times(points, &transposed(points, r)?, r)?;
    for (i, (p, row)) in points.chunks_exact(r).zip(found.chunks_exact_mut(count.max(1))).enumerate() {
        for ((v, q), square) in row.iter_mut().zip(points.chunks_exact(r)).zip(&squares) {
            let total = squares[i] + square;
            *v = total - 2.0 * sign * *v;
            if *v < 0.1 * total {
                // once more where most of it cancels
                *v = p.iter().zip(q).map(|(p, q)| (p - sign * q).powi(2)).sum();
            }
        }
    }
    Ok(found)
}

/// `sum_i w_i p_i`
fn sums(points: &[f64], w: &[f64], r: usize) -> Result<Vec<f64>> {
    let mut found = try_filled(WHAT, 0.0, r)?;
    for (w, point) in w.iter().zip(points.chunks_exact(r)) {
        found.iter_mut().zip(point).for_each(|(to, p)| *to += w * p);
    }
    Ok(found)
}

fn norm_of(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

/// The largest distance of a point from the centre, 0 without points.
fn farthest(points: &[f64], centre: &[f64]) -> f64 {
    let off = |point: &[f64]| norm_of(point.iter().zip(centre).map(|(p, c)| p - c));
    points.chunks_exact(centre.len()).fold(0.0, |m, point| m.max(off(point)))
}
