//! Known answers, and random problems against projected gradients and against enumeration.

#![allow(clippy::needless_range_loop, reason = "formulas with indices")]

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

#[test]
fn a_solver_agrees_with_single_calls() {
    let (mut normal, stop) = (Normal::new(6), Stop::new());
    for (d, rows, n) in [(6, 9, 3), (30, 40, 5), (12, 5, 4)] {
        let (m, state, target) = (normal.take(rows * d), normal.take(rows * n), normal.take(rows));
        let (r, low, high) = (vec![0.1; d], vec![-0.2; d], vec![0.3; d]);
        let bounds = Bounds::new(&low, &high, d).unwrap();
        let mut of_states = Solver::new(&m, Penalty::Diagonal(&r), bounds, 2, Some((&state, &target)), &stop).unwrap();
        let mut of_goals = Solver::new(&m, Penalty::Diagonal(&r), bounds, 0, None, &stop).unwrap();
        for _ in 0..20 {
            let x = normal.take(n);
            let of = |i: usize| target[i] - (0..n).map(|j| state[i * n + j] * x[j]).sum::<f64>();
            let y: Vec<f64> = (0..rows).map(of).collect();
            let single = solved(&m, &y, &r, &low, &high);
            for found in [of_states.solve(&x, Until::new(&stop, None)), of_goals.solve(&y, Until::new(&stop, None))] {
                let found = found.unwrap();
                assert_eq!(
                    (found.status, &found.active),
                    (Status::Optimal, &single.active),
                    "{d}\n{found:?}\n{single:?}"
                );
                assert!((found.objective - single.objective).abs() <= 1e-12 * single.objective);
                assert!((found.at_zero - single.at_zero).abs() <= 1e-12 * single.at_zero);
                assert!(found.control.iter().zip(&single.control).all(|(a, b)| (a - b).abs() < 1e-12));
            }
        }
        let before = of_states.warm().unwrap().to_vec();
        assert!(of_states.solve(&[f64::NAN].repeat(n), Until::new(&stop, None)).is_err());
        assert!(of_states.solve(&[1.0], Until::new(&stop, None)).is_err() || n == 1);
        assert_eq!(of_states.warm().unwrap(), before);
        assert!(of_states.resume(Some(vec![0; d + 1])).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// All answers of small problems are those of enumeration; certificates bound what is left.
    #[test]
    fn enumeration_agrees(
        d in 1usize..5,
        rows in 1usize..6,
        entries in prop::collection::vec(-2i32..3, 30),
        ends in prop::collection::vec((-4i32..3, 0i32..4, 0u8..8), 4),
        heavy in any::<bool>(),
    ) {
        let m: Vec<f64> = entries[..rows * d].iter().map(|&v| f64::from(v)).collect();
        let y: Vec<f64> = entries[24..24 + rows].iter().map(|&v| 1.5 * f64::from(v)).collect();
        let r = vec![if heavy { 1.0 } else { 0.01 }; d];
        let low: Vec<f64> = ends[..d].iter().map(|e| if e.2 & 1 > 0 { -INF } else { 0.5 * f64::from(e.0) }).collect();
        let high: Vec<f64> = ends[..d].iter().map(|e| if e.2 & 2 > 0 { INF } else { 0.5 * f64::from(e.0 + e.1) }).collect();
        let found = solved(&m, &y, &r, &low, &high);
        let least = enumerated(&m, &y, &r, &low, &high);
        let scale = found.at_zero + found.objective;
        prop_assert!((found.objective - least).abs() <= 1e-12 * scale, "{} {}", found.objective, least);
        prop_assert!(found.gap <= 1e-12 * scale && found.status == Status::Optimal);
        let (objective, g) = value(&m, &y, &r, &found.control);
        prop_assert!((objective - found.objective).abs() <= 1e-13 * scale);
        for i in 0..d {
            let left = g[i] + f64::from(found.active[i]) * found.multipliers[i];
            prop_assert!(left.abs() <= 1e-6 * (1.0 + scale), "{left}");
        }
    }
}

#[test]
fn batches_agree_with_single_calls_for_any_number_of_threads() {
    let (mut normal, stop) = (Normal::new(7), Stop::new());
    for d in [1, 2, 3, 5, 8, 9, 20] {
        let (rows, size) = (d + 2, if d < 9 { 2500 } else { 60 });
        let (m, mut y) = (normal.take(rows * d), normal.take(rows * size));
        y[..rows].fill(0.0);
        let mut low = vec![-0.3; d];
        let mut high = vec![0.2; d];
        if d == 5 {
            (low[1], high[2]) = (-INF, INF);
            (low[3], high[3]) = (0.1, 0.1);
        }
        let (r, bounds) = (vec![0.01; d], Bounds::new(&low, &high, d).unwrap());
        let batch =
            |gaps, threads| box_batch(&m, &y, size, Penalty::Diagonal(&r), bounds, gaps, threads, &stop).unwrap();
        let ((u, gaps), three, two) = (batch(true, 1), batch(true, 3), batch(false, 2));
        assert_eq!((&u, &gaps), {
            let (u, gaps) = &three;
            (u, gaps)
        });
        assert_eq!((&u, None), (&two.0, two.1));
        let gaps = gaps.unwrap();
        let all: Vec<f64> = (0..size).flat_map(|_| m.iter().copied()).collect();
        let each = box_batch_each(&all, &y, size, Penalty::Diagonal(&r), bounds, true, 2, &stop).unwrap();
        for (s, y) in y.chunks_exact(rows).enumerate().take(300) {
            let single = solved(&m, y, &r, &low, &high);
            let scale = single.at_zero + single.objective;
            assert!(gaps[s] <= 1e-12 * scale && each.1.as_ref().unwrap()[s] <= 1e-12 * scale, "{d} {s} {}", gaps[s]);
            for i in 0..d {
                assert!((u[s * d + i] - single.control[i]).abs() < 1e-12);
                assert!((each.0[s * d + i] - single.control[i]).abs() < 1e-12);
            }
        }
    }
    assert!(
        box_batch(
            &[1.0],
            &[f64::NAN],
            1,
            Penalty::Diagonal(&[0.0]),
            Bounds::new(&[0.0], &[1.0], 1).unwrap(),
            false,
            1,
            &stop
        )
        .is_err()
    );
    stop.request();
    let bounds = Bounds::new(&[0.0; 9], &[1.0; 9], 9).unwrap();
    let (m, y) = (normal.take(81), normal.take(81));
    assert!(matches!(
        box_batch(&m, &y, 9, Penalty::Diagonal(&[0.0; 9]), bounds, false, 1, &stop),
        Err(crate::Error::Interrupted)
    ));
}

/// `M`, `y` of a horizon, by powers of `A`; weights are diagonal here.
fn condensed(
    a: &[f64],
    b: &[f64],
    x0: &[f64],
    reference: &[f64],
    q: &[f64],
    last: &[f64],
    k: usize,
) -> (Vec<f64>, Vec<f64>) {
    let n = x0.len();
    let m = b.len() / n;
    let d = k * m;
    let (mut map, mut state) = (vec![0.0; n * d], x0.to_vec());
    let (mut rows, mut y) = (Vec::new(), Vec::new());
    let times =
        |v: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..n).map(|i| (0..n).map(|j| a[i * n + j] * v(j)).sum()).collect() };
    for t in 0..k {
        state = times(&|j| state[j]);
        let mut next = vec![0.0; n * d];
        for c in 0..d {
            let column = times(&|j| map[j * d + c]);
            (0..n).for_each(|i| next[i * d + c] = column[i]);
        }
        for i in 0..n {
            next[i * d + t * m..i * d + (t + 1) * m].copy_from_slice(&b[i * m..(i + 1) * m]);
        }
        map = next;
        for i in 0..n {
            let root = if t + 1 == k { last[i] } else { q[i] }.sqrt();
            rows.extend(map[i * d..(i + 1) * d].iter().map(|v| root * v));
            y.push(root * (reference[t * n + i] - state[i]));
        }
    }
    (rows, y)
}

#[test]
fn horizons_agree_with_condensed_problems() {
    let (mut normal, stop) = (Normal::new(8), Stop::new());
    for (n, m, k) in [(1, 1, 1), (2, 1, 6), (3, 2, 9), (10, 5, 12), (4, 9, 5)] {
        for limit in [0.02, 0.3, 5.0, INF] {
            let a: Vec<f64> = normal.take(n * n).iter().map(|v| v / (n as f64).sqrt()).collect();
            let (b, x0, reference) = (normal.take(n * m), normal.take(n), normal.take(k * n));
            let (q, last): (Vec<f64>, Vec<f64>) = ((0..n).map(|i| 0.2 + i as f64).collect(), vec![3.0; n]);
            let square = |v: &[f64]| {
                let mut all = vec![0.0; v.len() * v.len()];
                (0..v.len()).for_each(|i| all[i * v.len() + i] = v[i]);
                all
            };
            let (r, d) = (vec![0.3; m], k * m);
            let (low, mut high) = (vec![-limit; d], vec![0.7 * limit; d]);
            if limit < 1.0 {
                high[0] = -limit; // fixed
            }
            let horizon = Horizon {
                a: &a,
                b: &b,
                x0: &x0,
                reference: &reference,
                stage: &square(&q),
                terminal: &square(&last),
                r: &square(&r),
            };
            let bounds = Bounds::new(&low, &high, d).unwrap();
            let found = horizon_control(&horizon, bounds, None, Until::new(&stop, None)).unwrap();
            let (rows, y) = condensed(&a, &b, &x0, &reference, &q, &last, k);
            let dense = solved(&rows, &y, &vec![0.3; d], &low, &high);
            let scale = dense.at_zero + dense.objective;
            assert!(found.gap <= 1e-12 * scale && found.gap >= 0.0, "{n} {m} {k} {limit}: {found:?}");
            assert!(
                (found.objective - dense.objective).abs() <= 1e-11 * scale,
                "{} {}",
                found.objective,
                dense.objective
            );
            assert!((found.at_zero - dense.at_zero).abs() <= 1e-12 * scale);
            assert!(found.control.iter().zip(&dense.control).all(|(a, b)| (a - b).abs() < 1e-9));
            assert_eq!(found.active, dense.active);
            let again = horizon_control(&horizon, bounds, Some(&found.active), Until::new(&stop, None)).unwrap();
            assert!((again.objective - found.objective).abs() <= 1e-13 * scale && again.iterations == 1);
        }
    }
}

#[test]
fn a_double_integrator_by_steps() {
    let horizon = Horizon {
        a: &[1.0, 1.0, 0.0, 1.0],
        b: &[0.0, 1.0],
        x0: &[1.0, 0.0],
        reference: &[0.0; 4],
        stage: &[0.0; 4],
        terminal: &[1.0, 0.0, 0.0, 1.0],
        r: &[0.0],
    };
    let (stop, solve) = (Stop::new(), |low: &[f64], high: &[f64], stop: &Stop| {
        horizon_control(&horizon, Bounds::new(low, high, 2).unwrap(), None, Until::new(stop, None)).unwrap()
    });
    let free = solve(&[-INF; 2], &[INF; 2], &stop);
    assert!((free.control[0] + 1.0).abs() < 1e-14 && (free.control[1] - 1.0).abs() < 1e-14, "{free:?}");
    let found = solve(&[-0.5; 2], &[0.5; 2], &stop);
    assert!(found.control == [-0.5, 0.5] && (found.objective - 0.25).abs() < 1e-15);
    assert!(
        horizon_control(
            &Horizon { r: &[-1.0], ..horizon },
            Bounds::new(&[0.0; 2], &[1.0; 2], 2).unwrap(),
            None,
            Until::new(&stop, None)
        )
        .is_err()
    );
    let steep = Horizon { a: &[1e200, 1.0, 0.0, 1.0], ..horizon };
    assert!(matches!(
        horizon_control(&steep, Bounds::new(&[0.0; 2], &[1.0; 2], 2).unwrap(), None, Until::new(&stop, None)),
        Err(crate::Error::Overflow { .. })
    ));
}

/// Unstable over 40 steps: `J(0)` is 1e13, and the tail past step 30 hardly matters.
#[test]
fn an_unstable_system_over_many_steps() {
    let stop = Stop::new();
    let solve = |k: usize| {
        let horizon = Horizon {
            a: &[1.5, 1.0, 0.0, 0.9],
            b: &[0.0, 1.0],
            x0: &[0.3, 0.0],
            reference: &vec![0.0; 2 * k],
            stage: &[1.0, 0.0, 0.0, 1.0],
            terminal: &[1.0, 0.0, 0.0, 1.0],
            r: &[0.1],
        };
        let (low, high) = (vec![-0.45; k], vec![0.15; k]);
        horizon_control(&horizon, Bounds::new(&low, &high, k).unwrap(), None, Until::new(&stop, None)).unwrap()
    };
    let (long, short) = (solve(40), solve(30));
    assert_eq!((long.status, short.status), (Status::Optimal, Status::Optimal));
    assert!(long.active[..5] == short.active[..5] && long.active.iter().any(|at| *at != 0), "{long:?}");
    assert!((long.objective - short.objective).abs() <= 1e-9 * short.objective && long.at_zero > 1e12);
    assert!(long.gap < 1e-9 * long.objective, "{long:?}");
}
