//! Known answers, and the conditions of a minimum on random problems, computed without the solver.

#![allow(clippy::needless_range_loop, reason = "formulas with indices")]

use super::*;
use crate::Stop;
use crate::limits::tests::Normal;
use crate::limits::{box_control, horizon_control};

const INF: f64 = f64::INFINITY;

/// `n` states, `m` inputs, `steps`, and their matrices.
struct Case {
    n: usize,
    m: usize,
    steps: usize,
    a: Vec<f64>,
    b: Vec<f64>,
    x0: Vec<f64>,
    reference: Vec<f64>,
    stage: Vec<f64>,
    terminal: Vec<f64>,
    r: Vec<f64>,
    low: Vec<f64>,
    high: Vec<f64>,
}

impl Case {
    fn horizon(&self) -> Steps<'_> {
        let Self { a, b, x0, reference, stage, terminal, r, .. } = self;
        Steps { a, b, x0, reference, stage, terminal, r }
    }

    fn solve(&self, rows: Rows<'_>) -> RowsSolution {
        let stop = Stop::new();
        let bounds = Bounds::new(&self.low, &self.high, self.steps * self.m).unwrap();
        rows_control(&self.horizon(), bounds, rows, Until::new(&stop, None)).unwrap()
    }

    fn states(&self, u: &[f64]) -> Vec<f64> {
        let (mut x, mut all) = (self.x0.clone(), Vec::new());
        for t in 0..self.steps {
            x = (0..self.n)
                .map(|i| {
                    (0..self.n).map(|j| self.a[i * self.n + j] * x[j]).sum::<f64>()
                        + (0..self.m).map(|j| self.b[i * self.m + j] * u[t * self.m + j]).sum::<f64>()
                })
                .collect();
            all.extend_from_slice(&x);
        }
        all
    }

    /// `J` without soft limits.
    fn objective(&self, u: &[f64]) -> f64 {
        let (n, x) = (self.n, self.states(u));
        let form = |w: &[f64], v: &[f64]| -> f64 {
            let k = v.len();
            (0..k).map(|i| (0..k).map(|j| v[i] * w[i * k + j] * v[j]).sum::<f64>()).sum()
        };
        let of_states: f64 = (0..self.steps)
            .map(|t| {
                let e: Vec<f64> = (0..n).map(|i| x[t * n + i] - self.reference[t * n + i]).collect();
                form(if t + 1 == self.steps { &self.terminal } else { &self.stage }, &e)
            })
            .sum();
        of_states + u.chunks(self.m).map(|u| form(&self.r, u)).sum::<f64>()
    }

    /// `J'` by differences, which are exact for a quadratic function up to rounding.
    fn slope(&self, u: &[f64]) -> Vec<f64> {
        (0..u.len())
            .map(|i| {
                let at = |by: f64| {
                    let mut v = u.to_vec();
                    v[i] += by;
                    self.objective(&v)
                };
                (at(1.0) - at(-1.0)) / 2.0
            })
            .collect()
    }
}

/// The double integrator from (1, 0) to 0 in two steps.
fn double_integrator(limit: f64) -> Case {
    Case {
        n: 2,
        m: 1,
        steps: 2,
        a: vec![1.0, 1.0, 0.0, 1.0],
        b: vec![0.0, 1.0],
        x0: vec![1.0, 0.0],
        reference: vec![0.0; 4],
        stage: vec![0.0; 4],
        terminal: vec![1.0, 0.0, 0.0, 1.0],
        r: vec![0.0],
        low: vec![-limit; 2],
        high: vec![limit; 2],
    }
}

#[test]
fn two_steps_with_a_limit_on_changes() {
    let case = double_integrator(0.5);
    let free = case.solve(Rows::default());
    assert!((free.found.control[0] + 0.5).abs() < 1e-14 && (free.found.control[1] - 0.5).abs() < 1e-14);
    assert!((free.found.objective - 0.25).abs() < 1e-14 && free.rows[1].is_empty() && free.rows[2].is_empty());
    let found = case.solve(Rows { rate: Some((&[0.5], &[0.0])), ..Rows::default() });
    assert!((found.found.control[0] + 0.4).abs() < 1e-14 && (found.found.control[1] - 0.1).abs() < 1e-14);
    assert!((found.found.objective - 0.45).abs() < 1e-14);
    assert_eq!(found.found.status, Status::Optimal);
    assert!(found.found.gap < 1e-14 && found.found.distance < 1e-7, "{:?}", found.found);
    // J = (1 + u0)^2 + (u0 + u1)^2: J' = (2 (1 + u0) + 2 (u0 + u1), 2 (u0 + u1)) = (3/5, -3/5) = -D' (0, 3/5)
    assert!(found.rows[1][0].abs() < 1e-12 && (found.rows[1][1] - 0.6).abs() < 1e-12, "{:?}", found.rows[1]);
    assert_eq!(found.found.active, [0, 0]);
}

#[test]
fn a_limit_that_cannot_be_met() {
    let case = Case {
        n: 1,
        m: 1,
        steps: 1,
        a: vec![1.0],
        b: vec![1.0],
        x0: vec![3.0],
        reference: vec![5.0],
        stage: vec![0.0],
        terminal: vec![1.0],
        r: vec![0.1],
        low: vec![-1.0],
        high: vec![1.0],
    };
    let states = Some((&[-INF][..], &[1.0][..]));
    let found = case.solve(Rows { states, ..Rows::default() });
    assert_eq!(found.found.status, Status::Infeasible);
    assert!((found.missing - 1.0).abs() < 1e-9 && (found.excess - 1.0).abs() < 1e-6, "{found:?}");
    assert!((found.found.control[0] + 1.0).abs() < 1e-6);
    // with a weight: J = (u - 2)^2 + u^2 / 10 + rho (2 + u)^2
    for rho in [1e-2, 1.0, 1e6] {
        let found = case.solve(Rows { states, soft: Some(rho), ..Rows::default() });
        let best = ((2.0 - 2.0 * rho) / (1.1 + rho)).clamp(-1.0, 1.0);
        assert_eq!((found.found.status, found.missing), (Status::Optimal, 0.0));
        assert!((found.found.control[0] - best).abs() < 1e-12, "{rho} {found:?}");
        assert!((found.rows[2][0] - 2.0 * rho * (2.0 + best)).abs() < 1e-9 * (1.0 + rho));
    }
}

fn random(seed: u8, n: usize, m: usize, steps: usize) -> Case {
    let mut normal = Normal::new(seed);
    let mut square = |k: usize, scale: f64| -> Vec<f64> {
        let f = normal.take(k * k);
        let entry = |i: usize, j: usize| (0..k).map(|l| f[l * k + i] * f[l * k + j]).sum::<f64>() * scale;
        (0..k * k).map(|e| entry(e / k, e % k)).collect()
    };
    let (stage, terminal, r) = (square(n, 1.0), square(n, 1.0), square(m, 0.3));
    let d = m * steps;
    let mut case = Case {
        n,
        m,
        steps,
        a: normal.take(n * n),
        b: normal.take(n * m),
        x0: normal.take(n),
        reference: normal.take(n * steps),
        stage,
        terminal,
        r,
        low: normal.take(d).iter().map(|v| -v.abs()).collect(),
        high: normal.take(d).iter().map(|v| v.abs()).collect(),
    };
    (0..d).step_by(5).for_each(|i| case.low[i] = -INF);
    (0..d).step_by(4).for_each(|i| case.high[i] = INF);
    case
}

/// Feasible, complementary, and nothing left of the gradient.
#[test]
fn random_problems_satisfy_the_conditions_of_a_minimum() {
    let (mut of_rates, mut of_states) = (0, 0);
    for seed in 0..60 {
        let (n, m, steps) = (1 + seed as usize % 3, 1 + seed as usize % 2, 2 + seed as usize % 4);
        let case = random(seed, n, m, steps);
        let (rate, previous) = (vec![0.4; m], vec![0.1; m]);
        // limits that some control keeps: states of a clipped one, and some room
        let bounds = Bounds::new(&case.low, &case.high, steps * m).unwrap();
        let rates = Rows { rate: Some((&rate, &previous)), ..Rows::default() };
        let mut inside = vec![0.0; steps * m];
        Task::new(case.horizon(), bounds, rates).unwrap().clip(&mut inside);
        let x = case.states(&inside);
        let (low, high): (Vec<f64>, Vec<f64>) =
            (x.iter().map(|v| v - 0.05).collect(), x.iter().map(|v| v + 0.2).collect());
        let soft = [None, Some(1e-2), Some(1.0), Some(1e6)][seed as usize % 4];
        let rows = Rows { rate: rates.rate, states: Some((&low, &high)), soft, grows: false };
        let all = case.solve(rows);
        let found = &all.found;
        assert_eq!(found.status, Status::Optimal, "{seed} {all:?}");
        assert!(found.gap <= 1e-12 * (found.objective + found.at_zero), "{seed} {all:?}");
        let (u, x) = (&found.control, case.states(&found.control));
        let mut g = case.slope(u);
        let size = 1.0 + g.iter().chain(&all.rows[2]).fold(0.0f64, |s, v| s.max(v.abs()));
        let mut pulled = vec![0.0; u.len()];
        Task::new(case.horizon(), bounds, rows).unwrap().pull(&all.rows[2], &mut pulled).unwrap();
        for i in 0..u.len() {
            assert!(case.low[i] <= u[i] && u[i] <= case.high[i]);
            let step = u[i] - if i < m { previous[i] } else { u[i - m] };
            assert!(step.abs() <= 0.4 + 1e-12);
            let v = all.rows[1][i];
            assert!(v.abs() * (0.4 - v.signum() * step) <= 1e-9 * size);
            of_rates += usize::from(v.abs() > 1e-6);
            g[i] += v - if i + m < u.len() { all.rows[1][i + m] } else { 0.0 };
            g[i] += f64::from(found.active[i]) * found.multipliers[i] + pulled[i];
            assert!(found.multipliers[i] >= 0.0 && (found.active[i] != 0 || found.multipliers[i] == 0.0));
        }
        for i in 0..x.len() {
            let (v, over) = (all.rows[2][i], (x[i] - high[i]).max(0.0) - (low[i] - x[i]).max(0.0));
            match soft {
                Some(rho) => assert!((v - 2.0 * rho * over).abs() <= 1e-9 * size),
                None => {
                    assert!(over.abs() < 1e-11);
                    assert!(v.abs() * (if v > 0.0 { high[i] - x[i] } else { x[i] - low[i] }) <= 1e-9 * size);
                }
            }
            of_states += usize::from(v.abs() > 1e-6);
        }
        assert!(g.iter().all(|g| g.abs() <= 1e-7 * size), "{seed} {g:?} {size}");
    }
    assert!(of_rates > 40 && of_states > 40, "{of_rates} {of_states}");
}

#[test]
fn a_box_alone_has_the_control_of_the_box() {
    for seed in 0..20 {
        let case = random(seed, 3, 2, 6);
        let stop = Stop::new();
        let bounds = Bounds::new(&case.low, &case.high, 12).unwrap();
        let theirs = horizon_control(&case.horizon(), bounds, None, Until::new(&stop, None)).unwrap();
        let ours = case.solve(Rows::default());
        assert_eq!(ours.found.status, Status::Optimal);
        assert!((ours.found.objective - theirs.objective).abs() <= 1e-12 * (1.0 + theirs.objective));
        assert!(ours.found.control.iter().zip(&theirs.control).all(|(a, b)| (a - b).abs() < 1e-9), "{seed}");
        assert_eq!(ours.found.active, theirs.active);
    }
    let one = box_control; // one step is a problem of the box
    let (stop, bounds) = (Stop::new(), Bounds::new(&[-1.0], &[1.0], 1).unwrap());
    let penalty = crate::limits::Penalty::Diagonal(&[1.0]);
    assert_eq!(one(&[1.0], &[3.0], penalty, bounds, None, Until::new(&stop, None)).unwrap().objective, 5.0);
}

#[test]
fn time_stops_and_arguments() {
    let case = random(3, 2, 1, 4);
    let (stop, bounds) = (Stop::new(), Bounds::new(&case.low, &case.high, 4).unwrap());
    let now = Until::new(&stop, Some(std::time::Duration::ZERO));
    let states = Some((&[-INF; 8][..], &[9.0; 8][..]));
    let found = rows_control(&case.horizon(), bounds, Rows { states, ..Rows::default() }, now).unwrap();
    assert!(matches!(found.found.status, Status::Limit | Status::Optimal));
    let refused = |rows: Rows<'_>, name: &str| {
        let error = rows_control(&case.horizon(), bounds, rows, Until::new(&stop, None)).unwrap_err();
        assert!(error.to_string().contains(&format!("`{name}`")), "{error}");
    };
    refused(Rows { rate: Some((&[0.0], &[0.0])), ..Rows::default() }, "rate");
    refused(Rows { rate: Some((&[1.0], &[f64::NAN])), ..Rows::default() }, "previous");
    refused(Rows { rate: Some((&[1.0], &[1e6])), ..Rows::default() }, "previous");
    refused(Rows { states: Some((&[0.0; 8], &[-1.0; 8])), ..Rows::default() }, "state_low");
    refused(Rows { states: Some((&[0.0; 7], &[1.0; 8])), ..Rows::default() }, "state_low");
    refused(Rows { states, soft: Some(0.0), ..Rows::default() }, "soft");
    stop.request();
    let early = rows_control(&case.horizon(), bounds, Rows::default(), Until::new(&stop, None));
    assert!(matches!(early, Err(Error::Interrupted)) || early.unwrap().found.status == Status::Interrupted);
}

/// Also: the memory that was foreseen for Clarabel suffices, which a failing cover would turn into another status.
#[test]
fn larger_problems_of_unlike_shapes() {
    for (seed, n, m, steps) in [(0, 12, 5, 30), (1, 2, 20, 10), (2, 20, 1, 12), (3, 1, 1, 300), (4, 30, 10, 3)] {
        let mut case = random(seed, n, m, steps);
        case.a.iter_mut().for_each(|a| *a *= 0.5 / (n as f64).sqrt());
        let (rate, previous) = (vec![0.4; m], vec![0.0; m]);
        let (low, high) = (vec![-0.5; n * steps], vec![0.5; n * steps]);
        let rows = Rows { rate: Some((&rate, &previous)), states: Some((&low, &high)), soft: Some(3.0), grows: false };
        let found = case.solve(rows);
        assert_eq!((found.found.status, found.found.method), (Status::Optimal, Method::Refinement), "{seed}");
        let hard = case.solve(Rows { soft: None, ..rows });
        assert!(matches!(hard.found.status, Status::Optimal | Status::Infeasible), "{seed} {:?}", hard.found.status);
    }
}
