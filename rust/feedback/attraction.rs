//! From where every member comes to rest although its inputs saturate.

use faer::Mat;
use faer::linalg::solvers::Solve;

use crate::error::{Error, Result};
use crate::memory::covered;
use crate::parallel::Stop;

use super::blocks::Blocks;
use super::data::{Matrix, WHAT, filled, gathered, in_units, largest, symmetric, trace};
use super::loops::{Loop, bytes, squares};
use super::scalings::hint;

/// Shares of the inputs that may be cut off.
const CUTS: usize = 10;
/// Steps after which a motion counts as lost.
const STEPS: usize = 300;
/// For the rounding of the motion, each step.
const ROUNDING: f64 = 1e-9;

/// `{x'Q^-1 x <= level}`, `Q = R R'`, from where all members rest.
struct Set {
    root: Matrix,
    level: f64,
}

impl Loop {
    /// The largest c such that every member comes to rest from `c x0` (n) under `u_i = sat(K_i x)` with
    /// `|u_i| <= limits` (m), without noise; 0 where nothing is proved.
    ///
    /// On `|K_i x| <= limit / (1 - beta)` the input is K x times a number of `[1 - beta, 1]`: a channel. Beyond, a
    /// motion with an ellipsoid around it that every member stays in, until it is in such a set. The rounding of that
    /// motion is not proved, but allowed for by 1e-9 a step.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Numerical`], [`Error::Memory`], [`Error::Interrupted`].
    pub fn attracted(&self, limits: &[f64], x0: &[f64], stop: &Stop) -> Result<f64> {
        let (n, m) = (self.data.n, self.data.m);
        if limits.len() != m || x0.len() != n || limits.iter().any(|v| v.is_nan() || *v <= 0.0) {
            let found = format!("{}, {}", limits.len(), x0.len());
            return Err(Error::Shape { name: "limits", expected: format!("{m} numbers > 0 and {n} entries"), found });
        }
        let size = x0.iter().fold(0.0f64, |most, v| most.max(v.abs()));
        if !self.free() || self.data.c.is_some() || size == 0.0 {
            return Ok(0.0);
        }
        covered(WHAT, bytes(n, self.data.region.d), || {
            let x = Mat::from_fn(n, 1, |i, _| x0[i] / size / self.data.unit[i]);
            let sets = self.sets(limits, &x, stop)?;
            let from = |set: &Set| (set.level / set.root.partial_piv_lu().solve(&x).squared_norm_l2()).sqrt();
            let inside = sets.iter().map(from).fold(0.0, f64::max) * (1.0 - 1e-6);
            if !(inside > 0.0 && inside.is_finite()) {
                return Ok(0.0);
            }
            let (mut low, mut high) = (inside, inside * 1.5);
            while high < inside * 1e3 && self.rests(&(&x * faer::Scale(high)), limits, &sets)? {
                stop.check()?;
                (low, high) = (high, high * 1.5);
            }
            for _ in 0..12 {
                stop.check()?;
                let middle = 0.5 * (low + high);
                *(if self.rests(&(&x * faer::Scale(middle)), limits, &sets)? { &mut low } else { &mut high }) = middle;
            }
            Ok(low / size)
        })?
    }

    /// For each share the set that reaches furthest along `x`.
    fn sets(&self, limits: &[f64], x: &Matrix, stop: &Stop) -> Result<Vec<Set>> {
        let (mut sets, m) = (Vec::new(), self.data.m);
        let add = |root: Matrix, beta: f64, best: &mut Option<(f64, Set)>| {
            let each = squares(&root, &self.closed.k);
            let level = each
                .iter()
                .zip(limits)
                .map(|(own, limit)| if *own > 0.0 { (limit / (1.0 - beta)).powi(2) / own } else { f64::INFINITY })
                .fold(f64::INFINITY, f64::min)
                * (1.0 - 1e-6);
            let far = level / root.partial_piv_lu().solve(x).squared_norm_l2();
            if best.as_ref().is_none_or(|(most, _)| far > *most) && level.is_finite() {
                *best = Some((far, Set { root, level }));
            }
        };
        for step in 0..CUTS {
            stop.check()?;
            let (beta, mut best) = (step as f64 / CUTS as f64, None);
            if step == 0 {
                if let Some(root) = &self.proof {
                    add(root.clone(), 0.0, &mut best);
                }
            } else {
                let (k, channels) = self.cut_channels(beta);
                let of = Blocks::new(&self.data, &k, None, &self.closed.t, &channels);
                let found = hint(&of, &filled(m, 1.0), stop)?.filter(|found| found.gamma > 0.5 * beta);
                let Some(found) = found else { break };
                for shift in -4..=4 {
                    let t = gathered(found.t.iter().map(|t| t * 10f64.powf(0.5 * f64::from(shift))));
                    let gammas = filled(m, 0.5 * beta * (1.0 + 1e-12));
                    for slack in [1.02, 1.002] {
                        if let Some(root) = of.proof(&gammas, &t, (None, 1.0), slack) {
                            add(root, beta, &mut best);
                        }
                    }
                }
            }
            sets.extend(best.map(|one| one.1));
        }
        Ok(sets)
    }

    /// Whether every member comes from `x` into one of the sets.
    fn rests(&self, x: &Matrix, limits: &[f64], sets: &[Set]) -> Result<bool> {
        let (n, m, k) = (self.data.n, self.data.m, &self.closed.k);
        let (mut x, mut y) = (x.clone(), Mat::<f64>::zeros(n, n));
        let mut inverses = Vec::new();
        for set in sets {
            inverses.push(set.root.partial_piv_lu());
        }
        let weigh = inverses.last();
        for _ in 0..STEPS {
            for (set, lu) in sets.iter().zip(&inverses) {
                let off = lu.solve(lu.solve(&y).transpose().to_owned());
                let far = lu.solve(&x).norm_l2() + largest(&symmetric(&off))?.sqrt();
                if far <= set.level.sqrt() * (1.0 - 1e-6) {
                    return Ok(true);
                }
            }
            let asked = k * &x;
            let (mut mid, mut rad, mut off) = (filled(m, 0.0), filled(m, 0.0), filled(m, 0.0));
            let mut input = asked.clone();
            for i in 0..m {
                let row = k.subrows(i, 1);
                let r = (row * &y * row.transpose())[(0, 0)].max(0.0).sqrt() * (1.0 + ROUNDING);
                let (v, limit) = (asked[(i, 0)], limits[i]);
                // slopes of the saturation between v and v + e, |e| <= r
                let (low, high) = if v.abs() + r <= limit {
                    (1.0, 1.0)
                } else if v.abs() - r >= limit {
                    (0.0, 0.0)
                } else if v.abs() < limit {
                    (((limit - v.abs()) / r).clamp(0.0, 1.0), 1.0)
                } else {
                    (0.0, (1.0 - (v.abs() - limit) / r).clamp(0.0, 1.0))
                };
                (mid[i], rad[i], off[i]) = (0.5 * (low + high), 0.5 * (high - low), r);
                input[(i, 0)] = v.clamp(-limit, limit);
            }
            let moved = in_units(k, &mid, &filled(n, 1.0));
            let a = &self.data.a + &self.data.b * &moved;
            let mut terms = Vec::new();
            terms.push(symmetric(&(&a * &y * a.transpose())));
            for piece in &self.data.pieces {
                let (states, inputs) = (piece.w.subcols(0, n).to_owned(), piece.w.subcols(n, m).to_owned());
                let e = &states + &inputs * &moved;
                let mut b = (&states * &x + &inputs * &input).norm_l2();
                b += largest(&symmetric(&(&e * &y * e.transpose())))?.sqrt();
                b += (0..m).map(|i| rad[i] * off[i] * inputs.col(i).norm_l2()).sum::<f64>();
                let mut own = Mat::<f64>::zeros(n, n);
                for (i, to) in piece.rows.iter().enumerate() {
                    for (j, col) in piece.rows.iter().enumerate() {
                        own[(*to, *col)] = (piece.rho * b).powi(2) * piece.s[(i, j)];
                    }
                }
                terms.push(own);
            }
            for i in 0..m {
                let through = self.data.b.subcols(i, 1) * faer::Scale(rad[i] * off[i]);
                terms.push(&through * through.transpose());
            }
            // an ellipsoid around the sum of ellipsoids: any weights will do
            let mut all = Mat::<f64>::zeros(n, n);
            let mut weights = Vec::new();
            for term in &terms {
                let own = weigh.map_or_else(|| term.clone(), |lu| lu.solve(lu.solve(term).transpose().to_owned()));
                weights.push(trace(&own).max(0.0).sqrt());
            }
            let sum: f64 = weights.iter().sum();
            for (term, weight) in terms.iter().zip(&weights) {
                if *weight > 0.0 {
                    all += term * faer::Scale(sum / weight * (1.0 + ROUNDING));
                }
            }
            (x, y) = (&self.data.a * &x + &self.data.b * &input, symmetric(&all));
            if !(x.norm_l2() < 1e100 && y.norm_l2() < 1e200) {
                return Ok(false);
            }
        }
        Ok(false)
    }
}
