//! What a call of a loop from readings allocates: the window and its gate, the set point, and the plan or the gain.

use super::*;
use crate::limits::horizon::{Horizon, RecedingHorizon, Task};
use crate::limits::{Policy, SetPointTask, SetPoints};
use crate::matrix::MatrixView;
use crate::memory::tests::counted;
use crate::region::tests::round;
use crate::region::{Aim, Bias, Gate, Readings, Region};
use crate::window::{Filter, Kind, Window};

/// Two outputs and two inputs, two lags of each.
const THETA: [f64; 16] = [1.1, 0.1, -0.3, 0.0, 0.5, 0.1, 0.2, 0.0, 0.0, 0.9, 0.1, -0.2, 0.1, 0.4, 0.0, 0.1];
const NOISE: [f64; 4] = [0.01, 0.002, 0.002, 0.02];
const P: usize = 2;
const M: usize = 2;
const N: usize = 6;

fn eye(n: usize, size: f64) -> Vec<f64> {
    (0..n * n).map(|at| if at % (n + 1) == 0 { size } else { 0.0 }).collect()
}

/// How a loop finds its input.
enum Law {
    Plans(Box<RecedingHorizon>),
    Gain(Vec<f64>),
}

struct Loop {
    readings: Readings,
    points: SetPoints,
    low: Vec<f64>,
    law: Law,
}

impl Loop {
    fn new(steps: usize, rate: Option<f64>, soft: Option<f64>) -> Self {
        let window = Window::new(P, M, Kind::Lags(2), 0, false, 0).unwrap();
        let theta = MatrixView::of(&THETA, 8);
        let points = SetPoints::new(window, theta, &[1.0; P + M]).unwrap();
        let region = Region::new(theta, 6, vec![round(&[0, 1], &[0, 1, 2, 3, 4, 5, 6, 7], 1e-4)], None, false).unwrap();
        let gate = Gate::new(&region.with_noise(Some(NOISE.to_vec())).unwrap(), 0.01).unwrap();
        let (noise, of_inputs) = (MatrixView::of(&NOISE, P), points.of_inputs().unwrap());
        let filter = Filter::new(window, theta, noise, &[0.0; P], &[1.0; P + M]).unwrap();
        let bias = Bias::learned(MatrixView::of(&of_inputs, M), &[0.1; M], noise).unwrap();
        let none = Aim { of_bias: vec![0.0; M * P], limits: [vec![0.0; M], vec![-0.3; M], vec![0.3; M]] };
        let readings = Readings::new(filter, theta, Some(gate.unwrap()), bias, none, 3).unwrap();
        let linear = window.linear(theta).unwrap();
        let (a, b): (Vec<f64>, Vec<f64>) = linear
            .matrix
            .chunks_exact(N + M)
            .fold((vec![], vec![]), |(a, b), row| ([&a[..], &row[..N]].concat(), [&b[..], &row[N..]].concat()));
        let side = |side: f64| (0..N * steps).map(|i| side * if i % N < P { 0.4 } else { INF }).collect::<Vec<_>>();
        let (sides, weights) = ([side(-1.0), side(1.0)], [eye(N, 1.0), eye(M, 0.1)]);
        let (low, high, zero) = (vec![-0.3; M * steps], vec![0.3; M * steps], vec![0.0; N * steps]);
        let rate = rate.map(|rate| [rate; M]);
        let task = Task {
            low: MatrixView::of(&low, M),
            high: MatrixView::of(&high, M),
            stage: MatrixView::of(&weights[0], N),
            terminal: MatrixView::of(&weights[0], N),
            reference: MatrixView::of(&zero, N),
            r: Some(MatrixView::of(&weights[1], M)),
            rate: rate.as_ref().map(|rate| (&rate[..], &[0.0; M][..])),
            states: soft.map(|_| (MatrixView::of(&sides[0], N), MatrixView::of(&sides[1], N))),
            soft,
        };
        let law = if steps == 0 {
            Law::Gain((0..M * N).map(|i| -0.2 * (i as f64).cos()).collect())
        } else {
            let horizon = Horizon::new(MatrixView::of(&a, N), MatrixView::of(&b, M), None, task).unwrap();
            Law::Plans(Box::new(RecedingHorizon::new(horizon, &Stop::new()).unwrap()))
        };
        Self { readings, points, low: vec![-0.3; M], law }
    }
}

#[test]
fn calls_allocate_nothing() {
    let (mut rejected, mut lost, mut capped) = (0, 0, 0);
    for (seed, steps, rate, soft, measured) in [
        (41, 20, None, None, false),
        (42, 12, Some(0.1), None, false),
        (43, 12, Some(0.1), Some(20.0), false),
        (44, 20, None, None, true),
        (45, 12, Some(INF), Some(20.0), true),
        (46, 900, None, None, true),
        (47, 0, None, None, false),
    ] {
        let mut all = Loop::new(steps, rate, soft);
        let (high, given) = (vec![0.3; M], [f64::NAN; M]);
        let weights = eye(P, 1.0);
        let wish = SetPointTask {
            target: &[0.3, 0.1],
            weights: MatrixView::of(&weights, P),
            now: &[0.0; P],
            low: &[-INF; M],
            high: &[INF; M],
            given: &given,
        };
        let point = all.points.at(&wish).unwrap();
        let limits = [point.place[P..].to_vec(), all.low.clone(), high.clone()];
        all.readings.aim(Aim { of_bias: point.of_bias[P * P..].to_vec(), limits }).unwrap();
        let (mut normal, stop) = (Normal::new(seed), Stop::new());
        let (mut z, mut u, mut bias, mut started) = ([0.0; 8], vec![0.0; M], vec![0.0; P], false);
        let (mut moved, mut fixed, mut x) = (all.points.moved().unwrap(), vec![f64::NAN; M * steps], vec![0.0; N]);
        for call in 0..if steps > 100 { 60 } else { 200 } {
            let w = normal.take(P);
            let load = if call > 80 { 0.3 } else { 0.0 };
            let y: Vec<f64> = (0..P)
                .map(|i| THETA[i * 8..][..8].iter().zip(&z).map(|(a, z)| a * z).sum::<f64>() + 0.1 * w[i] + load)
                .collect();
            z = [y[0], y[1], z[0], z[1], 0.0, 0.0, z[4], z[5]];
            let mut seen = y.clone();
            match call % 23 {
                7 | 8 => seen[call % P] = f64::NAN,
                12 => seen.fill(f64::NAN),
                15 => seen[0] += 50.0,
                _ => {}
            }
            if call % 61 == 50 {
                seen[0] = 1e300; // nothing is known of such a window
            }
            let acted = u.clone();
            let (step, bytes) = counted(|| {
                let step = all.readings.step(&seen, &[true; P], &acted, &bias, started).unwrap();
                bias.copy_from_slice(&step.bias);
                let runs = (step.runs, step.off > 1.0, step.lost);
                started |= runs.0;
                let Some(window) = all.readings.window().filter(|_| runs.0) else { return runs };
                all.points.moving(&point, &bias, [&[0.0; P]; 2], &[0.0; M], &mut moved).unwrap();
                let us = &moved.place[P..];
                match &mut all.law {
                    Law::Plans(plans) => {
                        if measured {
                            fixed.iter_mut().skip(1).step_by(M).for_each(|v| *v = 0.01 * call as f64 % 0.1);
                            plans.fix(&fixed).unwrap();
                        }
                        x.iter_mut().zip(window.x.iter().zip(&moved.x)).for_each(|(to, (x, xs))| *to = x - xs);
                        plans.about(us, &moved.x).unwrap();
                        u.iter_mut().zip(us).for_each(|(u, us)| *u -= us);
                        plans.follow(&u).unwrap();
                        let found = plans.solve(&x, Until::new(&stop, None)).unwrap();
                        assert_eq!(found.status, Status::Optimal, "{seed} {call}");
                        u.iter_mut().zip(&found.control).zip(us).for_each(|((to, u), us)| *to = u + us);
                    }
                    Law::Gain(gain) => {
                        let (low, high) = (&all.low, &high);
                        let policy = Policy { gain, more: &[0.0; M], rate: &[0.2; M], low, high };
                        assert!(policy.input(&window.x, (&moved.x, us), &acted, &mut u).unwrap());
                    }
                }
                runs
            });
            assert!(bytes == 0 || call == 0, "{seed} {call} {bytes}");
            (z[4], z[5]) = (u[0], u[1]);
            rejected += usize::from(step.1);
            lost += usize::from(step.2);
            capped += usize::from(u.iter().any(|u| u.abs() >= 0.3 - 1e-9));
        }
        assert!(started, "{seed}");
    }
    assert!(rejected > 20 && capped > 20, "{rejected} {lost} {capped}");
}
