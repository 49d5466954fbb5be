//! Known answers, and random problems against projected gradients and against enumeration.

#![allow(clippy::needless_range_loop, reason = "formulas with indices")]

mod batches;
mod horizons;
mod loops;
mod readings;
mod stops;

use proptest::prelude::*;

use super::*;
use crate::Key;
use crate::parallel::Stop;

const INF: f64 = f64::INFINITY;

/// Normal numbers of a seed.
pub(super) struct Normal(Vec<f64>, usize);

impl Normal {
    pub(super) fn new(seed: u8) -> Self {
        let mut lanes = Key([seed; 32]).lanes(0, 0);
        let uniform: Vec<f64> =
            (0..8192).flat_map(|_| lanes.step()).map(|w| ((w >> 11) as f64 + 0.5) / 2f64.powi(53)).collect();
        let pairs = uniform.chunks_exact(2);
        Self(pairs.map(|p| (-2.0 * p[0].ln()).sqrt() * (std::f64::consts::TAU * p[1]).cos()).collect(), 0)
    }

    pub(super) fn take(&mut self, len: usize) -> Vec<f64> {
        (0..len)
            .map(|_| {
                self.1 += 1;
                self.0[(self.1 * 7) % self.0.len()]
            })
            .collect()
    }
}

fn solved(m: &[f64], y: &[f64], r: &[f64], low: &[f64], high: &[f64]) -> Solution {
    let stop = Stop::new();
    let bounds = Bounds::new(low, high, r.len()).unwrap();
    let found = box_control(m, y, Penalty::Diagonal(r), bounds, None, Until::new(&stop, None)).unwrap();
    for (i, u) in found.control.iter().enumerate() {
        assert!(low[i] <= *u && *u <= high[i]);
    }
    found
}

/// `J` and its gradient, summed without tricks.
pub(super) fn value(m: &[f64], y: &[f64], r: &[f64], u: &[f64]) -> (f64, Vec<f64>) {
    let d = u.len();
    let residual: Vec<f64> =
        m.chunks_exact(d).zip(y).map(|(row, y)| row.iter().zip(u).map(|(a, b)| a * b).sum::<f64>() - y).collect();
    let mut g: Vec<f64> = u.iter().zip(r).map(|(u, r)| 2.0 * r * u).collect();
    for (row, v) in m.chunks_exact(d).zip(&residual) {
        row.iter().zip(&mut g).for_each(|(a, g)| *g += 2.0 * a * v);
    }
    (residual.iter().map(|v| v * v).sum::<f64>() + u.iter().zip(r).map(|(u, r)| r * u * u).sum::<f64>(), g)
}

/// The minimum by enumeration of all sets of limits, with Gauss elimination.
fn enumerated(m: &[f64], y: &[f64], r: &[f64], low: &[f64], high: &[f64]) -> f64 {
    let d = r.len();
    let mut best = INF;
    for code in 0..3usize.pow(d as u32) {
        let held: Vec<usize> = (0..d).map(|i| code / 3usize.pow(i as u32) % 3).collect();
        let mut u: Vec<f64> = (0..d).map(|i| [0.0, low[i], high[i]][held[i]]).collect();
        if u.iter().any(|v| !v.is_finite()) {
            continue;
        }
        let free: Vec<usize> = (0..d).filter(|&i| held[i] == 0).collect();
        let right = value(m, y, r, &u).1;
        let k = free.len();
        let mut a: Vec<Vec<f64>> = free
            .iter()
            .map(|&i| {
                let entry = |j: usize| {
                    m.chunks_exact(d).map(|row| row[i] * row[j]).sum::<f64>() + if i == j { r[i] } else { 0.0 }
                };
                free.iter().map(|&j| entry(j)).chain([-right[i] / 2.0]).collect()
            })
            .collect();
        for c in 0..k {
            let p = (c..k).max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs())).unwrap();
            a.swap(c, p);
            for i in 0..k {
                if i != c {
                    let f = a[i][c] / a[c][c];
                    for j in c..=k {
                        a[i][j] -= f * a[c][j];
                    }
                }
            }
        }
        free.iter().enumerate().for_each(|(c, &i)| u[i] = a[c][k] / a[c][c]);
        if (0..d).all(|i| low[i] - 1e-12 <= u[i] && u[i] <= high[i] + 1e-12) {
            best = best.min(value(m, y, r, &u).0);
        }
    }
    best
}

#[test]
fn one_input() {
    let found = solved(&[1.0], &[3.0], &[1.0], &[-INF], &[INF]);
    assert!((found.control[0] - 1.5).abs() < 1e-15 && found.active == [0] && found.gap < 1e-30);
    let found = solved(&[1.0], &[3.0], &[1.0], &[-1.0], &[1.0]);
    assert_eq!((found.control[0], found.objective, found.active[0], found.multipliers[0]), (1.0, 5.0, 1, 2.0));
    assert_eq!((found.status, found.at_zero, found.distance), (Status::Optimal, 9.0, 0.0));
    let found = solved(&[1.0], &[-3.0], &[1.0], &[-1.0], &[1.0]);
    assert_eq!((found.control[0], found.active[0], found.multipliers[0]), (-1.0, -1, 2.0));
}

#[test]
fn two_inputs_without_penalty() {
    let found = solved(&[1.0, 1.0, 0.0, 1.0], &[2.0, 0.0], &[0.0; 2], &[-1.0; 2], &[1.0; 2]);
    assert!((found.control[1] - 0.5).abs() < 1e-15 && found.control[0] == 1.0 && (found.objective - 0.5).abs() < 1e-15);
    assert_eq!(found.active, [1, 0]);
    assert!((found.multipliers[0] - 1.0).abs() < 1e-15);
}

#[test]
fn a_double_integrator_over_two_steps() {
    // x2 = x0 + C u, C = [A B, B] = [[1, 0], [1, 1]], x0 = (1, 0), goal 0
    let m = [1.0, 0.0, 1.0, 1.0];
    let free = solved(&m, &[-1.0, 0.0], &[0.0; 2], &[-INF; 2], &[INF; 2]);
    assert!((free.control[0] + 1.0).abs() < 1e-15 && (free.control[1] - 1.0).abs() < 1e-15);
    let found = solved(&m, &[-1.0, 0.0], &[0.0; 2], &[-0.5; 2], &[0.5; 2]);
    assert_eq!(found.control, [-0.5, 0.5]);
    assert!((found.objective - 0.25).abs() < 1e-15);
}

#[test]
fn fixed_and_idle_inputs() {
    // the second is fixed, the third changes nothing
    let m = [1.0, 1.0, 0.0, 0.0, 1.0, 0.0];
    let found = solved(&m, &[1.0, 0.0], &[0.0; 3], &[-9.0, 0.25, 2.0], &[9.0, 0.25, 3.0]);
    assert!((found.control[0] - 0.75).abs() < 1e-15);
    assert_eq!(found.control[1..], [0.25, 2.0]);
    assert_eq!((found.active[1], found.multipliers[1]), (-1, 0.5));
    assert_eq!(found.status, Status::Optimal);
    let all = solved(&m, &[1.0, 0.0], &[0.0; 3], &[1.0; 3], &[1.0; 3]);
    assert_eq!((all.control.as_slice(), all.gap), (&[1.0; 3][..], 0.0));
}

#[test]
fn full_penalties() {
    let stop = Stop::new();
    let (low, high) = ([-1.0; 2], [0.1, 1.0]);
    let bounds = Bounds::new(&low, &high, 2).unwrap();
    let solve = |r: &[f64]| box_control(&[1.0, 0.0], &[1.0], Penalty::Full(r), bounds, None, Until::new(&stop, None));
    // J = (a - 1)^2 + (a + b)^2 with a <= 0.1: b = -0.1
    let found = solve(&[1.0, 1.0, 1.0, 1.0]).unwrap();
    assert!((found.control[0] - 0.1).abs() < 1e-15 && (found.control[1] + 0.1).abs() < 1e-14);
    assert!(matches!(solve(&[1.0, 2.0, 2.0, 1.0]), Err(crate::Error::Value { name: "R", .. })));
    assert!(matches!(solve(&[1.0, f64::NAN, 2.0, 1.0]), Err(crate::Error::NonFinite { name: "R", .. })));
    assert!(matches!(solve(&[1.0]), Err(crate::Error::Shape { name: "R", .. })));
    assert!(Bounds::new(&[1.0], &[0.0], 1).is_err() && Bounds::new(&[f64::NAN], &[0.0], 1).is_err());
    assert!(Bounds::new(&[INF], &[INF], 1).is_err());
}

/// Singular values from 1 to `1 / condition`, times random rotations.
fn ill(d: usize, condition: f64, normal: &mut Normal) -> Vec<f64> {
    let mut m = vec![0.0; d * d];
    (0..d).for_each(|i| m[i * d + i] = condition.powf(-(i as f64) / (d - 1).max(1) as f64));
    for turn in 0..6 {
        let v = normal.take(d);
        let vv: f64 = v.iter().map(|v| v * v).sum();
        for k in 0..d {
            let entry = |i: usize| if turn % 2 == 0 { i * d + k } else { k * d + i };
            let w: f64 = (0..d).map(|i| v[i] * m[entry(i)]).sum::<f64>() * 2.0 / vv;
            (0..d).for_each(|i| m[entry(i)] -= w * v[i]);
        }
    }
    m
}

#[test]
fn gaps_stay_small_for_any_condition_and_size() {
    let mut normal = Normal::new(3);
    for (condition, most) in [(1e2, 1e-12), (1e3, 1e-12), (1e6, 1e-8)] {
        for d in [1, 2, 5, 8, 20, 50, 97, 120] {
            for share in [1e-3, 0.3, 1.0, 1e3] {
                let (m, y) = (ill(d, condition, &mut normal), normal.take(d));
                let free = solved(&m, &y, &vec![0.0; d], &vec![-INF; d], &vec![INF; d]);
                assert!(free.gap <= most * free.at_zero, "free: {condition} {d} {}", free.gap);
                let mut sizes: Vec<f64> = free.control.iter().map(|u| u.abs()).collect();
                sizes.sort_by(f64::total_cmp);
                let limit = share * sizes[d / 2];
                let found = solved(&m, &y, &vec![0.0; d], &vec![-limit; d], &vec![limit; d]);
                assert!(found.gap <= most * found.at_zero, "{condition} {d} {share}: {found:?}");
                assert!(found.objective <= found.at_zero * (1.0 + 1e-12) && found.gap >= 0.0);
            }
        }
    }
}

#[test]
fn without_a_unique_control_the_value_is_still_the_least() {
    let mut normal = Normal::new(4);
    for d in [3, 10, 40] {
        let (m, y) = (normal.take(2 * d), normal.take(2));
        for limit in [1e-3, 0.1, 10.0] {
            let found = solved(&m, &y, &vec![0.0; d], &vec![-limit; d], &vec![limit; d]);
            assert_eq!(found.status, Status::Optimal, "{d} {limit} {found:?}");
        }
    }
}

#[test]
fn a_stop_and_a_time_limit_still_give_a_control() {
    let (mut normal, stop) = (Normal::new(5), Stop::new());
    let (m, y, r) = (normal.take(20 * 20), normal.take(20), vec![0.0; 20]);
    let bounds = Bounds::new(&[-0.1; 20], &[0.1; 20], 20).unwrap();
    let until = Until::new(&stop, Some(std::time::Duration::ZERO));
    let found = box_control(&m, &y, Penalty::Diagonal(&r), bounds, None, until).unwrap();
    assert!(found.status == Status::Limit && found.gap.is_finite() && found.control.iter().all(|u| u.abs() <= 0.1));
    stop.request();
    let found = box_control(&m, &y, Penalty::Diagonal(&r), bounds, None, Until::new(&stop, None)).unwrap();
    assert!(found.status == Status::Interrupted && found.gap.is_finite());
}
