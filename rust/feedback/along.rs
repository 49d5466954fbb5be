//! The bounds of a tube step by step: causal sums, and the exact first order of one constant member.

use faer::Mat;

use crate::error::Result;
use crate::parallel::Stop;

use super::data::{Matrix, in_units, largest, symmetric};
use super::first_order::FirstOrder;
use super::loops::{Loop, forms};
use super::tube::{Level, ROUNDING, Run, Tube};
use super::way::Way;

impl Loop {
    /// The bounds step by step, to `end`; without a level they are infinite from the first step on. `beside`: how far
    /// rows and states are at rest from the set point.
    #[expect(clippy::too_many_arguments, reason = "what a tube depends on")]
    pub(super) fn along(
        &self,
        run: Run<'_>,
        beside: &(Vec<f64>, f64),
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
        let mut way = Way {
            of: self,
            x: Mat::from_fn(n, 1, |i, _| run.x0[i] / data.unit[i]),
            plan: run.plan,
            k: 0,
            about_rest: run.rest.is_some(),
        };
        let point = |h: usize| run.rest.map_or(0.0, |(xs, us)| if h < n { xs[h] } else { us[h - n] });
        let mut order = sharp.then(|| FirstOrder::new(self));
        let d = self.closed.inputs(data);
        let (forcing, mut l) = (&d * d.transpose(), Mat::<f64>::zeros(n, n));
        for k in 0..=end {
            stop.check()?;
            let u = way.input();
            let power = |level: &Level| level.t.powi(k as i32);
            let least = |f: &dyn Fn(&Level) -> f64| levels.iter().map(f).fold(f64::INFINITY, f64::min);
            // causal sums at t = 1, where `L_k` is that of k steps
            let partial = levels.iter().find(|level| level.t == 1.0);
            let (mut own, mut whole) = (forms(&l, rows), 0.0);
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
                if let (Some(order), false) = (&order, levels.is_empty()) {
                    let second = second.min(least(&|level| power(level) * level.rows[h] * level.second));
                    bound = bound.min(order.along(&rows.subrows(h, 1).to_owned())? + second);
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
                // x - xs = (x - rest) + (rest - xs), and x(0) - rest = (x0 - xs) - (rest - xs)
                let begun = least(&|level| level.rest.as_ref().map_or(0.0, |rest| power(level) * rest.0[h]));
                let bound = if run.rest.is_some() { bound + beside.0[h] + begun } else { bound };
                let nominal = point(h) + if h < n { way.x[(h, 0)] * data.unit[h] } else { u[(h - n, 0)] };
                if k <= run.steps {
                    tube.model.push(bound);
                    tube.nominal.push(nominal);
                }
                tube.reach[h] = tube.reach[h].max(nominal.abs() + bound + start[h]);
            }
            model[0] = squared.sqrt();
            model[1] = partial.map_or(f64::INFINITY, |level| whole * level.size);
            model[1] = model[1].min(least(&|level| power(level) * level.norm * level.size));
            if let Some((piece, rank, sum)) = order.as_ref().and_then(FirstOrder::single).filter(|_| k > 0) {
                // ||vec(G)|| <= phi
                let phi = data.phi.min(piece.rho * (piece.rows.len().min(rank) as f64).sqrt());
                let square = symmetric(&in_units(&(sum * sum.transpose()), &data.unit, &data.unit));
                let second = partial.map_or(f64::INFINITY, |level| whole * level.second);
                let second = second.min(least(&|level| power(level) * level.norm * level.second));
                model[1] = model[1].min(phi * largest(&square)?.sqrt() * (1.0 + ROUNDING) + second);
            }
            let first = least(&|level| level.start.as_ref().map_or(0.0, |start| power(level) * start.1));
            let first = if run.start > 0.0 { first } else { 0.0 };
            let begun = least(&|level| level.rest.as_ref().map_or(0.0, |rest| power(level) * rest.1));
            let begun = if run.rest.is_some() { begun } else { 0.0 };
            let radius = if k == 0 { first.min(run.start) } else { model[0].min(model[1]) + first } + begun;
            if k <= run.steps {
                tube.radii.push(radius + if run.rest.is_some() { beside.1 } else { 0.0 });
                tube.start.extend_from_slice(&start);
            }
            tube.later.push(crate::fuse::norm((0..n).map(|i| way.x[(i, 0)] * data.unit[i])) + radius);
            if let Some(order) = &mut order {
                order.push(&way.forcing().0);
            }
            l = &self.closed.a0 * &l * self.closed.a0.transpose() + &forcing;
            way.step();
        }
        Ok(tube)
    }
}
