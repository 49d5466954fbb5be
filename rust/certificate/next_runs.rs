//! The inputs of the next runs after which the error of a plan is smallest: of first order, for a model in place of the
//! system.
//!
//! With `M_p = A^p Sigma^(1/2)` and the planned `z_j = (x, u, 1)` that error has the size
//! `phi(V) = tr Psi V^-1`, `Psi = sum_jk tr(M_{K-1-j} M_{K-1-k}') z_j z_k'`, convex and decreasing in `V = sum z z'`.

use rand::RngExt;

use crate::error::{Error, Result, require_finite, sized};
use crate::identify::covariance_root;
use crate::memory::{checked_len, try_zeros};
use crate::parallel::Stop;
use crate::stream::{Key, Purpose};

const WHAT: &str = "the next runs";
/// Inputs from which a run is improved.
const STARTS: usize = 3;
/// A bound on what ends by itself.
const SWEEPS: usize = 200;

/// The model, what was measured, and the plan that the runs are for.
#[derive(Debug, Clone, Copy)]
pub struct Goal<'a> {
    /// The model (n, d): d is n + m, or one more with an offset.
    pub model: &'a [f64],
    /// States.
    pub n: usize,
    /// Inputs.
    pub m: usize,
    /// `white' white = V^-1` of all pairs so far (r, d); 0 in columns that are known.
    pub white: &'a [f64],
    /// The covariance of the noise (n, n), up to a factor.
    pub covariance: &'a [f64],
    /// The start of the plan (n).
    pub x0: &'a [f64],
    /// Its inputs (K, m).
    pub inputs: &'a [f64],
}

/// The runs to come, of `steps` steps each.
#[derive(Debug, Clone, Copy)]
pub struct NextRuns<'a> {
    /// Their starts (runs, n).
    pub starts: &'a [f64],
    /// Their steps.
    pub steps: usize,
    /// The least inputs (steps, m).
    pub low: &'a [f64],
    /// The largest (steps, m).
    pub high: &'a [f64],
}

/// Inputs and what follows from them.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DesignedRuns {
    /// (runs, steps, m)
    pub inputs: Vec<f64>,
    /// `phi` before the first run and after each (runs + 1).
    pub phi: Vec<f64>,
}

/// Coordinates `white z`, in which the V of the measured pairs is the identity.
struct Search<'a> {
    goal: Goal<'a>,
    d: usize,
    /// `sum_j vec(M_{K-1-j}) (white z_j)'` (n n, r): `F' F = white Psi white'`.
    f: Vec<f64>,
    /// `V^-1` (r, r).
    inverse: Vec<f64>,
    /// `white' V^-1 F' F V^-1 white` (d, d).
    weights: Vec<f64>,
}

/// Inputs at their limits, run after run: each maximises `sum_k z_k' V^-1 Psi V^-1 z_k` over its own inputs, V with all
/// runs before it (Frank and Wolfe's method for `phi`), which is convex in them; to a point that neither its linear
/// part nor a single input improves.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Value`] for limits in the wrong order, [`Error::Overflow`] if
/// states of the model overflow, [`Error::Memory`], [`Error::Interrupted`].
pub fn next_runs(goal: Goal<'_>, runs: NextRuns<'_>, key: &Key, stop: &Stop) -> Result<DesignedRuns> {
    let (count, mut search) = checked(goal, runs)?;
    let (n, one) = (goal.n, checked_len(WHAT, runs.steps, goal.m)?);
    let mut design =
        DesignedRuns { inputs: try_zeros(WHAT, checked_len(WHAT, count, one)?)?, phi: try_zeros(WHAT, count + 1)? };
    design.phi[0] = search.refresh()?;
    let [mut u, mut kept, mut next] = [try_zeros(WHAT, one)?, try_zeros(WHAT, one)?, try_zeros(WHAT, one)?];
    let mut path = search.path(runs.steps)?;
    for (r, best) in design.inputs.chunks_exact_mut(one.max(1)).enumerate() {
        let (start, mut largest) = (&runs.starts[r * n..(r + 1) * n], f64::NEG_INFINITY);
        for from in 0..STARTS {
            let mut rng = key.stream(Purpose::Replicates, r * STARTS + from);
            let at = |i: usize, up: bool| if up { runs.high[i] } else { runs.low[i] };
            u.iter_mut().enumerate().for_each(|(i, u)| *u = at(i, rng.random()));
            let mut value = f64::NEG_INFINITY;
            for sweep in 0..SWEEPS {
                stop.check()?;
                let found = search.value_and_gradient(start, &u, &mut path, &mut next)?;
                if found <= value {
                    // no linear part improves it: does one input alone?
                    u.copy_from_slice(&kept);
                    value = search.flipped(start, &mut u, runs, value, &mut path, &mut next, stop)?;
                    let same = u == kept;
                    kept.copy_from_slice(&u);
                    if same || sweep + 1 == SWEEPS {
                        break;
                    }
                    search.value_and_gradient(start, &u, &mut path, &mut next)?;
                }
                value = value.max(found);
                kept.copy_from_slice(&u);
                // the vertex that maximises the linear part
                for (i, (u, slope)) in u.iter_mut().zip(&next).enumerate() {
                    if *slope != 0.0 {
                        *u = at(i, *slope > 0.0);
                    }
                }
            }
            if value > largest {
                largest = value;
                best.copy_from_slice(&kept);
            }
        }
        search.add(start, best, &mut path, &mut next)?;
        design.phi[r + 1] = search.refresh()?;
    }
    Ok(design)
}

impl Search<'_> {
    fn rank(&self) -> usize {
        self.goal.white.len() / self.d
    }

    /// Room for the `z_0 .. z_{steps-1}` of a run, and a state.
    fn path(&self, steps: usize) -> Result<Vec<f64>> {
        try_zeros(WHAT, checked_len(WHAT, steps + 1, self.d)?)
    }

    /// The rows `z_k` of a run under `u`.
    fn simulate(&self, start: &[f64], u: &[f64], path: &mut [f64]) -> Result<()> {
        let (n, m, d) = (self.goal.n, self.goal.m, self.d);
        path[..n].copy_from_slice(start);
        for (k, u) in u.chunks_exact(m).enumerate() {
            let (row, next) = path[k * d..].split_at_mut(d);
            row[n..n + m].copy_from_slice(u);
            row[n + m..].fill(1.0);
            for (to, model) in next.iter_mut().zip(self.goal.model.chunks_exact(d)) {
                *to = model.iter().zip(&*row).map(|(a, z)| a * z).sum();
            }
        }
        if path.iter().any(|v| !v.is_finite()) {
            return Err(Error::Overflow { what: "a state of the next runs" });
        }
        Ok(())
    }

    /// `sum_k z_k' W z_k`, and half its derivative by the inputs, by the adjoint of the run.
    fn value_and_gradient(&self, start: &[f64], u: &[f64], path: &mut [f64], slope: &mut [f64]) -> Result<f64> {
        let (n, m, d) = (self.goal.n, self.goal.m, self.d);
        self.simulate(start, u, path)?;
        let (mut adjoint, mut own) = (try_zeros(WHAT, n)?, try_zeros(WHAT, d)?);
        let mut value = 0.0;
        for (k, slope) in slope.chunks_exact_mut(m).enumerate().rev() {
            let z = &path[k * d..(k + 1) * d];
            for (to, row) in own.iter_mut().zip(self.weights.chunks_exact(d)) {
                *to = row.iter().zip(z).map(|(w, z)| w * z).sum();
            }
            value += own.iter().zip(z).map(|(w, z)| w * z).sum::<f64>();
            // W z_k + Theta' lambda_{k+1}
            for (lambda, row) in adjoint.iter().zip(self.goal.model.chunks_exact(d)) {
                own.iter_mut().zip(row).for_each(|(to, a)| *to += lambda * a);
            }
            slope.copy_from_slice(&own[n..n + m]);
            adjoint.copy_from_slice(&own[..n]);
        }
        Ok(value)
    }

    /// Moves each input in turn to its other limit where that is better; the value that is reached.
    #[expect(clippy::too_many_arguments, reason = "memory of the search")]
    fn flipped(
        &self,
        start: &[f64],
        u: &mut [f64],
        runs: NextRuns<'_>,
        mut value: f64,
        path: &mut [f64],
        spare: &mut [f64],
        stop: &Stop,
    ) -> Result<f64> {
        for i in 0..u.len() {
            stop.check()?;
            let before = u[i];
            u[i] = if before == runs.low[i] { runs.high[i] } else { runs.low[i] };
            let found = self.value_and_gradient(start, u, path, spare)?;
            if found > value * (1.0 + 1e-12) {
                value = found;
            } else {
                u[i] = before;
            }
        }
        Ok(value)
    }

    /// Takes a run into V, row by row: `V^-1 - v v' / (1 + q' v)`, `v = V^-1 q`.
    fn add(&mut self, start: &[f64], u: &[f64], path: &mut [f64], spare: &mut [f64]) -> Result<()> {
        self.value_and_gradient(start, u, path, spare)?;
        let (d, r) = (self.d, self.rank());
        let (mut q, mut v) = (try_zeros(WHAT, r)?, try_zeros(WHAT, r)?);
        for z in path.chunks_exact(d).take(u.len() / self.goal.m) {
            times(self.goal.white, z, &mut q);
            times(&self.inverse, &q, &mut v);
            let size = 1.0 + q.iter().zip(&v).map(|(q, v)| q * v).sum::<f64>();
            for (row, vi) in self.inverse.chunks_exact_mut(r).zip(&v) {
                row.iter_mut().zip(&v).for_each(|(to, vj)| *to -= vi * vj / size);
            }
        }
        Ok(())
    }

    /// `phi`, and the weights of the run to come.
    fn refresh(&mut self) -> Result<f64> {
        let (d, r) = (self.d, self.rank());
        self.weights.fill(0.0);
        let (mut moved, mut back) = (try_zeros(WHAT, r)?, try_zeros(WHAT, d)?);
        let mut phi = 0.0;
        for row in self.f.chunks_exact(r) {
            times(&self.inverse, row, &mut moved);
            phi += row.iter().zip(&moved).map(|(f, v)| f * v).sum::<f64>();
            back.fill(0.0);
            for (factor, white) in moved.iter().zip(self.goal.white.chunks_exact(d)) {
                back.iter_mut().zip(white).for_each(|(to, w)| *to += factor * w);
            }
            for (to, b) in self.weights.chunks_exact_mut(d).zip(&back) {
                to.iter_mut().zip(&back).for_each(|(to, c)| *to += b * c);
            }
        }
        if !phi.is_finite() || self.weights.iter().any(|w| !w.is_finite()) {
            return Err(Error::Overflow { what: "the error that the next runs make smaller" });
        }
        Ok(phi)
    }
}

fn times(matrix: &[f64], vector: &[f64], to: &mut [f64]) {
    for (to, row) in to.iter_mut().zip(matrix.chunks_exact(vector.len())) {
        *to = row.iter().zip(vector).map(|(a, v)| a * v).sum();
    }
}

fn checked<'a>(goal: Goal<'a>, runs: NextRuns<'_>) -> Result<(usize, Search<'a>)> {
    let Goal { model, n, m, white, covariance, x0, inputs } = goal;
    let d = model.len().checked_div(n).unwrap_or(0);
    let fits = |name, values: &[f64], len: usize| {
        sized(name, values.len(), len)?;
        require_finite(name, values)
    };
    if n == 0 || m == 0 || d.wrapping_sub(n + m) > 1 || inputs.is_empty() || runs.steps == 0 {
        let expected = "n rows of n + m entries, or one more, and a step at least".into();
        return Err(Error::Shape { name: "H", expected, found: format!("{} entries", model.len()) });
    }
    let (count, steps) = (runs.starts.len() / n, inputs.len() / m);
    fits("H", model, checked_len(WHAT, n, d)?)?;
    let r = white.len() / d;
    fits("white", white, checked_len(WHAT, r.max(1), d)?)?;
    fits("covariance", covariance, checked_len(WHAT, n, n)?)?;
    fits("x0", x0, n)?;
    fits("inputs", inputs, steps * m)?;
    fits("starts", runs.starts, count * n)?;
    fits("low", runs.low, checked_len(WHAT, runs.steps, m)?)?;
    fits("high", runs.high, runs.low.len())?;
    if let Some((low, high)) = runs.low.iter().zip(runs.high).find(|(low, high)| low > high) {
        return Err(Error::Value { name: "limits", expected: "low <= high", found: format!("{low} and {high}") });
    }
    let (square, mut inverse) = (checked_len(WHAT, d, d)?, try_zeros(WHAT, checked_len(WHAT, r, r)?)?);
    inverse.iter_mut().step_by(r + 1).for_each(|v| *v = 1.0);
    let f = try_zeros(WHAT, checked_len(WHAT, n * n, r)?)?;
    let mut search = Search { goal, d, f, inverse, weights: try_zeros(WHAT, square)? };
    let (mut path, mut q) = (search.path(steps)?, try_zeros(WHAT, r)?);
    search.simulate(x0, inputs, &mut path)?;
    let (mut power, mut next) = (covariance_root(covariance, n)?, try_zeros(WHAT, n * n)?);
    for z in path.chunks_exact(d).take(steps).rev() {
        times(white, z, &mut q);
        for (row, entry) in search.f.chunks_exact_mut(r).zip(&power) {
            row.iter_mut().zip(&q).for_each(|(to, q)| *to += entry * q);
        }
        // A M
        next.fill(0.0);
        for (to, a) in next.chunks_exact_mut(n).zip(model.chunks_exact(d)) {
            for (factor, from) in a.iter().zip(power.chunks_exact(n)) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
            }
        }
        std::mem::swap(&mut power, &mut next);
    }
    Ok((count, search))
}

#[cfg(test)]
mod tests {
    use super::*;

    // x+ = x / 2 + u, V = diag(4, 1), the plan goes from 1 by 0 and 1
    const GOAL: Goal<'_> = Goal {
        model: &[0.5, 1.0],
        n: 1,
        m: 1,
        white: &[0.5, 0.0, 0.0, 1.0],
        covariance: &[1.0],
        x0: &[1.0],
        inputs: &[0.0, 1.0],
    };
    const RUNS: NextRuns<'_> = NextRuns { starts: &[0.0, 2.0], steps: 1, low: &[-1.0], high: &[3.0] };

    #[test]
    fn two_runs_by_hand() {
        let found = next_runs(GOAL, RUNS, &Key([1; 32]), &Stop::new()).unwrap();
        // z = (1, 0), (1/2, 1): the sum of M z is (1, 1), so Psi has ones only and phi = 1/4 + 1
        assert_eq!(found.phi[0], 1.25);
        assert_eq!(found.inputs[0], 3.0); // from 0 the sign does nothing
        assert!((found.phi[1] - (0.25 + 0.1)).abs() < 1e-15);
        // V = [[4, 0], [0, 10]]: from 2 the input must have the sign of the start
        assert_eq!(found.inputs[1], 3.0);
        let (a, b, c) = (8.0, 6.0, 19.0);
        assert!((found.phi[2] - (a + c - 2.0 * b) / (a * c - b * b)).abs() < 1e-15);
    }

    #[test]
    fn wrong_arguments_and_a_stop_are_errors() {
        let (key, stop) = (Key([1; 32]), Stop::new());
        for (goal, runs) in [
            (Goal { model: &[0.5], ..GOAL }, RUNS),
            (Goal { white: &[], ..GOAL }, RUNS),
            (Goal { covariance: &[f64::NAN], ..GOAL }, RUNS),
            (Goal { inputs: &[], ..GOAL }, RUNS),
            (Goal { model: &[1e300, 1.0], inputs: &[0.0; 4], ..GOAL }, RUNS),
            (GOAL, NextRuns { low: &[4.0], ..RUNS }),
            (GOAL, NextRuns { steps: 0, ..RUNS }),
            (GOAL, NextRuns { high: &[], ..RUNS }),
        ] {
            assert!(next_runs(goal, runs, &key, &stop).is_err(), "{goal:?} {runs:?}");
        }
        stop.request();
        assert_eq!(next_runs(GOAL, RUNS, &key, &stop), Err(Error::Interrupted));
    }
}
