//! The bounds of a tube step by step: causal sums, and the exact first order of one constant member.

use faer::Mat;

use crate::error::Result;
use crate::parallel::Stop;

use super::data::{Matrix, in_units, largest, lost, size_of, symmetric};
use super::loops::{Loop, squares};
use super::member::clipped;
use super::tube::{Level, ROUNDING, Run, Tube};
use super::way::Way;

impl Loop {
    /// The bounds step by step, to `end`; without a level they are infinite from the first step on.
    pub(super) fn along(
        &self,
        run: Run<'_>,
        end: usize,
        levels: &[Level],
        sharp: bool,
        rows: &Matrix,
        stop: &Stop,
    ) -> Result<Tube> {
        let data = &self.data;
        let (n, q) = (data.n, data.n + data.m);
        let mut tube = Tube {
            nominal: Vec::new(),
            model: Vec::new(),
            start: Vec::new(),
            radii: Vec::new(),
            noise: Vec::new(),
            noise_radius: 0.0,
            later: Vec::new(),
            reach: Vec::new(),
        };
        tube.noise.resize(q, 0.0);
        tube.reach.resize(q, 0.0);
        let mut way = Way { of: self, x: Mat::from_fn(n, 1, |i, _| run.x0[i] / data.unit[i]), plan: run.plan, k: 0 };
        // sum_j (c_j)_i A0^(k-1-j) D, side by side for all i, of each part
        let (mut sums, mut roots) = (Vec::new(), Vec::new());
        for (piece, e) in data.pieces.iter().zip(&self.closed.e) {
            let mut root = Mat::<f64>::zeros(n, piece.rows.len());
            for (i, row) in piece.rows.iter().enumerate() {
                (0..piece.rows.len()).for_each(|j| root[(*row, j)] = piece.root[(i, j)]);
            }
            sums.push(Mat::<f64>::zeros(n, if sharp { piece.rows.len() * e.nrows() } else { 0 }));
            roots.push(root);
        }
        let d = self.closed.inputs(data);
        let (forcing, mut l) = (&d * d.transpose(), Mat::<f64>::zeros(n, n));
        for k in 0..=end {
            stop.check()?;
            let u = way.input();
            let power = |level: &Level| level.t.powi(k as i32);
            let least = |f: &dyn Fn(&Level) -> f64| levels.iter().map(f).fold(f64::INFINITY, f64::min);
            // causal sums at t = 1, where `L_k` is that of k steps
            let partial = levels.iter().find(|level| level.t == 1.0);
            let (mut own, mut whole) = (squares(&l, rows), 0.0);
            own.iter_mut().for_each(|v| *v = v.sqrt() * (1.0 + ROUNDING));
            if partial.is_some() {
                whole = largest(&symmetric(&in_units(&l, &data.unit, &data.unit)))?.sqrt() * (1.0 + ROUNDING);
            }
            let (mut model, mut start) = ([0.0f64, 0.0], Vec::new());
            let mut squared = 0.0;
            for h in 0..q {
                let plain = partial.map_or(f64::INFINITY, |level| own[h] * level.size);
                let second = partial.map_or(f64::INFINITY, |level| own[h] * level.second);
                let mut bound = plain.min(least(&|level| power(level) * level.rows[h] * level.size));
                if sharp && !levels.is_empty() {
                    let mut linear = 0.0;
                    for ((piece, e), sum) in data.pieces.iter().zip(&self.closed.e).zip(&sums) {
                        linear += first_order(
                            &rows.subrows(h, 1).to_owned(),
                            sum,
                            (e.nrows(), piece.rows.len()),
                            piece.rho,
                            data.phi,
                        )?;
                    }
                    let second = second.min(least(&|level| power(level) * level.rows[h] * level.second));
                    bound = bound.min(linear * (1.0 + ROUNDING) + second);
                }
                let bound = if k == 0 { 0.0 } else { bound };
                let first = least(&|level| level.start.as_ref().map_or(0.0, |start| power(level) * start.0[h]));
                let length = || crate::fuse::norm((0..n).map(|j| rows[(h, j)] / data.unit[j]));
                start.push(match k {
                    _ if run.start <= 0.0 => 0.0,
                    0 => first.min(run.start * length()),
                    _ => first,
                });
                if h < n {
                    squared += bound * bound;
                }
                if k <= run.steps {
                    tube.model.push(bound);
                }
                let nominal = if h < n { way.x[(h, 0)] * data.unit[h] } else { u[(h - n, 0)] };
                if k <= run.steps {
                    tube.nominal.push(nominal);
                }
                tube.reach[h] = tube.reach[h].max(nominal.abs() + bound + start[h]);
            }
            model[0] = squared.sqrt();
            model[1] = partial.map_or(f64::INFINITY, |level| whole * level.size);
            model[1] = model[1].min(least(&|level| power(level) * level.norm * level.size));
            if let ([piece], [sum], [e], true) =
                (data.pieces.as_slice(), sums.as_slice(), self.closed.e.as_slice(), sharp && k > 0)
            {
                // ||vec(G)|| <= phi
                let phi = data.phi.min(piece.rho * (piece.rows.len().min(e.nrows()) as f64).sqrt());
                let square = symmetric(&in_units(&(sum * sum.transpose()), &data.unit, &data.unit));
                let second = partial.map_or(f64::INFINITY, |level| whole * level.second);
                let second = second.min(least(&|level| power(level) * level.norm * level.second));
                model[1] = model[1].min(phi * largest(&square)?.sqrt() * (1.0 + ROUNDING) + second);
            }
            let first = least(&|level| level.start.as_ref().map_or(0.0, |start| power(level) * start.1));
            let first = if run.start > 0.0 { first } else { 0.0 };
            let radius = if k == 0 { first.min(run.start) } else { model[0].min(model[1]) + first };
            if k <= run.steps {
                tube.radii.push(radius);
                tube.start.extend_from_slice(&start);
            }
            tube.later.push(crate::fuse::norm((0..n).map(|i| way.x[(i, 0)] * data.unit[i])) + radius);
            if sharp {
                let mut at = 0;
                let (c, _) = way.forcing();
                for ((sum, root), (e, t)) in sums.iter_mut().zip(&roots).zip(self.closed.e.iter().zip(&self.closed.t)) {
                    let rank = e.nrows();
                    let mut next = &self.closed.a0 * &*sum;
                    for i in 0..rank {
                        for j in 0..root.ncols() {
                            (0..n).for_each(|a| next[(a, i * root.ncols() + j)] += c[at + i] * t.sqrt() * root[(a, j)]);
                        }
                    }
                    *sum = next;
                    at += rank;
                }
            }
            l = &self.closed.a0 * &l * self.closed.a0.transpose() + &forcing;
            way.step();
        }
        Ok(tube)
    }
}

/// `max <G, X>` of one part, `X = sum_j D' A0'^(k-1-j) h c_j'`, whose entries are those of `h sum`.
fn first_order(h: &Matrix, sum: &Matrix, (rank, rows): (usize, usize), rho: f64, phi: f64) -> Result<f64> {
    let line = h * sum;
    if rank == 0 || rows == 0 {
        return Ok(0.0);
    }
    let unit = size_of(&line);
    let x = Mat::from_fn(rank, rows, |i, j| line[(0, i * rows + j)] / unit);
    Ok(unit * clipped(&x.singular_values().map_err(lost)?, rho, phi).0)
}
