//! Independent answers: exact rational arithmetic, Clarabel, closed forms, and the corner cases one by one.

use super::common::{Instance, Rng, recompute};
use super::peer;
use crate::fuse::simplex::*;
use std::time::Duration;

/// `min f` over the simplex as a reduced pair `(numerator, denominator)`, by enumeration of the supports in integers.
///
/// On an affinely independent support, `G w - c = lambda 1`, `1^T w = 1`, and `f = ||t||^2 - c^T w + lambda`.
fn exact_minimum(x: &Instance, subsimplex: bool) -> f64 {
    let int = |v: f64| v as i128;
    let n = x.size;
    let row = |i: usize, j: usize| x.indices[i * x.lines + j] as usize;
    let total = n + usize::from(subsimplex); // the last one is zero
    let gram = |a: usize, b: usize| -> i128 {
        if a >= n || b >= n {
            return 0;
        }
        (0..x.lines).filter(|&j| row(a, j) == row(b, j)).map(|j| int(x.g[j]) * int(x.g[j])).sum()
    };
    let image = |a: usize| -> i128 {
        if a >= n { 0 } else { (0..x.lines).map(|j| int(x.g[j]) * int(x.target[j * x.length + row(a, j)])).sum() }
    };
    let square: i128 = x.target.iter().map(|&t| int(t) * int(t)).sum();
    let mut best = f64::INFINITY;
    for mask in 1_u32..1 << total {
        let support: Vec<usize> = (0..total).filter(|i| mask >> i & 1 == 1).collect();
        let k = support.len();
        // [G 1; 1^T 0] [w; -lambda] = [c; 1]
        let mut m: Vec<Vec<i128>> =
            support.iter().map(|&a| support.iter().map(|&b| gram(a, b)).chain([1, image(a)]).collect()).collect();
        m.push((0..k).map(|_| 1).chain([0, 1]).collect());
        let Some((numerators, denominator)) = bareiss(m) else { continue };
        if numerators[..k].iter().any(|&v| v * denominator.signum() < 0) {
            continue;
        }
        let cw: i128 = support.iter().zip(&numerators).map(|(&a, v)| image(a) * v).sum();
        let f = (denominator * square - cw - numerators[k]) as f64 / denominator as f64;
        best = best.min(f);
    }
    best
}

/// Fraction-free elimination of `[A | b]`: `x_i = numerators[i] / denominator`; `None` if singular.
fn bareiss(mut m: Vec<Vec<i128>>) -> Option<(Vec<i128>, i128)> {
    let n = m.len();
    let mut last = 1;
    for k in 0..n {
        let pivot = (k..n).find(|&i| m[i][k] != 0)?;
        m.swap(k, pivot);
        for i in 0..n {
            if i != k {
                for j in (0..=n).filter(|&j| j != k) {
                    m[i][j] = (m[i][j] * m[k][k] - m[i][k] * m[k][j]) / last;
                }
                m[i][k] = 0;
            }
        }
        last = m[k][k];
        for (i, row) in m.iter_mut().enumerate().take(k) {
            row[i] = last;
        }
    }
    Some(((0..n).map(|i| m[i][n]).collect(), last))
}

pub fn small(seed: u64) -> Instance {
    let mut rng = Rng::new(seed);
    let (lines, length, size) = (1 + rng.below(4), 1 + rng.below(4), 1 + rng.below(6));
    let e: Vec<f64> = (0..lines * length).map(|_| rng.below(4) as f64).collect();
    let mut x = Instance::sample(e, lines, length, size, &mut rng);
    if rng.below(3) == 0 {
        x.target.iter_mut().for_each(|t| *t = rng.below(17) as f64 - 8.0);
    }
    x
}

#[test]
fn the_gap_bounds_the_exact_suboptimality_of_small_instances() {
    let mut loose = 0;
    for seed in 0..3000 {
        let x = small(seed);
        for subsimplex in [false, true] {
            let exact = exact_minimum(&x, subsimplex);
            let norm: f64 = x.target.iter().map(|t| t * t).sum::<f64>() + x.g.iter().map(|g| g * g).sum::<f64>();
            let rounding = 1e-15 * norm;
            for tol in [1e-9, 1e-2, 0.5] {
                let s = x.solve(&Options { tol, subsimplex, ..Options::default() });
                assert_eq!(s.status, WeightStatus::Optimal, "seed {seed}");
                let error = s.objective - exact;
                assert!(error >= -rounding, "seed {seed}: below the minimum by {error}");
                assert!(error <= s.gap + rounding, "seed {seed}: error {error}, gap {}", s.gap);
                assert!(s.lower_bound <= exact + rounding, "seed {seed}: bound {} above {exact}", s.lower_bound);
                if tol == 1e-9 {
                    assert!(s.gap <= 1e-9 * norm);
                    assert_eq!(s.exact, exact == 0.0, "seed {seed}: f {} exact {exact}", s.objective);
                } else if error > 1e-3 * norm {
                    loose += 1;
                    assert!(s.gap <= 100.0 * norm, "vacuous");
                }
            }
        }
    }
    assert!(loose > 20, "the loose tolerances must exercise a positive gap: {loose}");
}

#[test]
fn clarabel_agrees_within_the_gaps() {
    for seed in 0..300 {
        let mut rng = Rng::new(900 + seed);
        let (lines, length) = (2 + rng.below(10), 2 + rng.below(10));
        let size = 1 + rng.below(4 * lines * length);
        let e = (0..lines * length).map(|_| rng.normal().abs()).collect();
        let mut x = Instance::sample(e, lines, length, size, &mut rng);
        if seed % 3 == 0 {
            x.target.iter_mut().for_each(|t| *t += rng.normal());
        }
        let norm: f64 = x.target.iter().map(|t| t * t).sum();
        let s = x.solve(&Options::default());
        let (f, gap) = recompute(&x, &peer::clarabel(&x, 1e-10), false);
        assert_eq!(s.status, WeightStatus::Optimal);
        assert!(s.objective - f <= s.gap + 1e-13 * norm, "seed {seed}: ours {} theirs {f}", s.objective);
        assert!(f - s.objective <= gap + 1e-13 * norm, "seed {seed}: ours {} theirs {f}", s.objective);
    }
}

fn optimal(x: &Instance, what: &str) -> Solution {
    let s = x.solve(&Options::default());
    assert_eq!(s.status, WeightStatus::Optimal, "{what}: {:?}", s.info);
    assert!((s.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{what}");
    let sub = x.solve(&Options { subsimplex: true, ..Options::default() });
    assert_eq!(sub.status, WeightStatus::Optimal, "{what}, subsimplex: {:?}", sub.info);
    assert!(sub.objective <= s.objective * (1.0 + 1e-12) + sub.gap, "{what}");
    s
}

#[test]
fn corner_cases() {
    let base = Instance::gaussian(6, 40, 3);
    let with = |change: &dyn Fn(&mut Instance)| {
        let mut x = base.clone();
        change(&mut x);
        x
    };
    let one = optimal(&with(&|x| (x.size, x.indices) = (1, x.indices[..6].to_vec())), "one sample");
    assert_eq!(one.weights, [1.0]);
    optimal(&with(&|x| x.target.fill(0.0)), "zero target");
    optimal(
        &with(&|x| {
            x.g[2] = 0.0;
            x.target[12..18].fill(0.0);
        }),
        "zero column",
    );
    let zero = optimal(
        &with(&|x| {
            x.g.fill(0.0);
            x.target.fill(0.0);
        }),
        "everything zero",
    );
    assert!(zero.exact && zero.objective == 0.0);
    optimal(&with(&|x| x.g.fill(0.0)), "no realization but zero");
    optimal(
        &with(&|x| {
            for i in 1..40 {
                for j in 0..6 {
                    x.indices[i * 6 + j] = x.indices[j];
                }
            }
        }),
        "all samples equal",
    );
    optimal(
        &with(&|x| {
            for i in 20..40 {
                for j in 0..6 {
                    x.indices[i * 6 + j] = x.indices[(i - 20) * 6 + j];
                }
            }
        }),
        "duplicates",
    );
    let vertex = optimal(
        &with(&|x| {
            x.target.fill(0.0);
            for j in 0..6 {
                x.target[j * 6 + x.indices[7 * 6 + j] as usize] = x.g[j];
            }
        }),
        "target at a vertex",
    );
    assert!(vertex.exact, "{}", vertex.objective);
    optimal(
        &with(&|x| {
            x.target.iter_mut().enumerate().for_each(|(k, t)| {
                if k % 2 == 0 {
                    *t = -*t
                }
            })
        }),
        "wrong signs",
    );
    optimal(&with(&|x| x.target.iter_mut().for_each(|t| *t = -*t)), "all signs wrong");
    for exponent in [-150, -30, 30, 150] {
        let scale = 10f64.powi(exponent);
        let s = optimal(
            &with(&|x| {
                x.g.iter_mut().for_each(|g| *g *= scale);
                x.target.iter_mut().for_each(|t| *t *= scale);
            }),
            "scaled",
        );
        let plain = base.solve(&Options::default());
        assert!((s.objective / scale / scale / plain.objective - 1.0).abs() < 1e-9);
    }
    for seed in 0..20 {
        // entries over twelve orders of magnitude
        let mut rng = Rng::new(70 + seed);
        let e = (0..48).map(|_| 10f64.powf(12.0 * rng.uniform() - 6.0)).collect();
        optimal(&Instance::sample(e, 6, 8, 1 + rng.below(300), &mut rng), "twelve orders of magnitude");
        optimal(
            &with(&|x| x.target.iter_mut().for_each(|t| *t *= 10f64.powi(seed as i32 - 2))),
            "target of another size",
        );
    }
}

#[test]
fn two_realizations_per_dimension_are_solved() {
    // The support is a nearly square random matrix; feasible and infeasible instances, by conjugate gradients and by
    // factors.
    let mut phases = Vec::new();
    for seed in 0..12 {
        let s = optimal(&Instance::gaussian(20, 700 + 10 * seed as usize, seed), "two per dimension");
        phases.push(s.info.phase);
    }
    assert!(phases.contains(&Phase::ActiveSet) && phases.contains(&Phase::Direct), "{phases:?}");
}

#[test]
fn a_time_limit_holds_where_factors_take_long() {
    // A factor of 2430 rows takes 0.1 s, the whole solve several seconds.
    let x = Instance::gaussian(50, 4900, 1);
    for seconds in [0.05, 0.4] {
        let limit = Duration::from_secs_f64(seconds);
        let start = std::time::Instant::now();
        let s = x.solve(&Options { time_limit: Some(limit), ..Options::default() });
        assert!(start.elapsed() < limit + Duration::from_secs(1), "{:?}", start.elapsed());
        assert_eq!(s.status, WeightStatus::UserLimit);
        let (f, gap) = recompute(&x, &s.weights, false);
        assert!((f - s.objective).abs() <= 1e-12 * f && (gap - s.gap).abs() <= 1e-9 * gap);
    }
}

#[test]
fn a_tolerance_below_rounding_is_reported_as_missed() {
    // tol ||t||^2 = 1e-29 sum g^2: the rounding of the weights' sum alone moves the gap by 1e-16 sum g^2 (for some
    // seeds to zero)
    let mut x = Instance::gaussian(6, 40, 4);
    x.target.iter_mut().for_each(|t| *t *= 1e-10);
    let s = x.solve(&Options::default());
    let gamma: f64 = x.g.iter().map(|g| g * g).sum();
    assert_eq!(s.status, WeightStatus::OptimalInaccurate);
    assert!(s.gap < 1e-14 * gamma && s.gap > 0.0);
}

#[test]
fn one_line_is_the_closed_form() {
    // Lemma 4.4, corrected: Y_k = wbar_k + delta / |hit|, shared among the copies
    let x = Instance {
        indices: vec![0, 2, 0, 2, 2],
        size: 5,
        lines: 1,
        length: 4,
        g: vec![10.0],
        target: vec![4.0, 3.0, 2.0, 1.0],
    };
    let s = optimal(&x, "one line");
    for (i, w) in s.weights.iter().enumerate() {
        let y = if x.indices[i] == 0 { (0.4 + 0.2) / 2.0 } else { (0.2 + 0.2) / 3.0 };
        assert!((w - y).abs() < 1e-15);
    }
    assert_eq!(s.unseen, 2);
    let sub = x.solve(&Options { subsimplex: true, ..Options::default() });
    assert!((sub.objective - 10.0).abs() < 1e-13);
}

#[test]
fn index_types_and_the_dense_form_agree() {
    let x = Instance::gaussian(8, 150, 5);
    let narrow = x.narrow();
    let middle: Vec<u16> = x.indices.iter().map(|&r| r as u16).collect();
    let stop = Stop::new();
    let wide = x.solve(&Options::default());
    for view in [IndexView::U8(&narrow), IndexView::U16(&middle)] {
        let p = SingletonProblem::new(view, x.size, 8, 8, &x.g, &x.target).unwrap();
        assert_eq!(solve(&p, &Options::default(), None, &stop).unwrap().weights, wide.weights);
    }
    for subsimplex in [false, true] {
        let options = Options { subsimplex, ..Options::default() };
        let wide = x.solve(&options);
        let dense = x.dense();
        let s = solve_dense(&DenseProblem::new(&dense, x.size, &x.target).unwrap(), &options, None, &stop).unwrap();
        assert_eq!(s.status, WeightStatus::Optimal);
        assert!((s.objective - wide.objective).abs() <= s.gap + wide.gap + 1e-13);
    }
    let threads = x.solve(&Options { threads: 2, ..Options::default() });
    assert_eq!(threads.status, WeightStatus::Optimal);
}

#[test]
fn dense_samples_of_every_shape_reach_the_tolerance() {
    for seed in 0..150 {
        let mut rng = Rng::new(400 + seed);
        let (dim, size) = (1 + rng.below(20), 1 + rng.below(120));
        let center: Vec<f64> = (0..dim).map(|_| rng.normal() * 10f64.powi(rng.below(3) as i32)).collect();
        let samples: Vec<f64> = (0..size * dim).map(|k| center[k % dim] + rng.normal()).collect();
        let target: Vec<f64> = if seed % 4 == 0 { (0..dim).map(|_| 3.0 * rng.normal()).collect() } else { center };
        for subsimplex in [false, true] {
            let options = Options { subsimplex, ..Options::default() };
            let s = solve_dense(&DenseProblem::new(&samples, size, &target).unwrap(), &options, None, &Stop::new())
                .unwrap();
            assert_eq!(s.status, WeightStatus::Optimal, "seed {seed} dim {dim} size {size}: {:?}", s.info);
        }
    }
}

#[test]
fn limits_return_certified_weights_and_say_so() {
    let x = Instance::gaussian(20, 700, 1);
    for (options, stop, status) in [
        (Options { time_limit: Some(Duration::ZERO), ..Options::default() }, false, WeightStatus::UserLimit),
        (Options { max_passes: 5, ..Options::default() }, false, WeightStatus::UserLimit),
        (Options::default(), true, WeightStatus::Interrupted),
    ] {
        let asked = Stop::new();
        if stop {
            asked.request();
        }
        let s = solve(&x.problem(), &options, None, &asked).unwrap();
        assert_eq!(s.status, status);
        let (f, gap) = recompute(&x, &s.weights, false);
        assert!((f - s.objective).abs() < 1e-12 * f.max(1.0) && (gap - s.gap).abs() < 1e-10 * gap.max(1.0));
    }
}

#[test]
fn a_reachable_target_is_recovered_exactly() {
    let x = Instance::gaussian(8, 4000, 2);
    let s = x.solve(&Options::default());
    assert!(s.exact && s.unseen == 0, "f {} unseen {} {:?}", s.objective, s.unseen, s.info);
    assert!(s.info.sifted);
}

#[test]
fn a_path_is_certified_at_every_point() {
    let x = Instance::gaussian(10, 2000, 4);
    let sizes: Vec<usize> = (1..=20).map(|k| 100 * k).collect();
    let (mut last, mut warm) = (f64::INFINITY, vec![]);
    for &size in &sizes {
        let prefix = Instance { indices: x.indices[..size * x.lines].to_vec(), size, ..x.clone() };
        let s = solve(&prefix.problem(), &Options::default(), Some(&warm), &Stop::new()).unwrap();
        assert_eq!((s.status, s.weights.len()), (WeightStatus::Optimal, size));
        assert!(s.objective <= last + s.gap);
        (last, warm) = (s.objective, s.weights);
    }
}

#[test]
fn bad_input_is_refused_by_name() {
    let (g, t) = ([1.0], [1.0, 0.0]);
    assert_eq!(
        SingletonProblem::new(IndexView::U8(&[2]), 1, 1, 2, &g, &t).unwrap_err(),
        Invalid::Index { found: 2, length: 2 }
    );
    assert_eq!(SingletonProblem::new(IndexView::U8(&[]), 0, 1, 2, &g, &t).unwrap_err(), Invalid::Empty);
    assert!(matches!(
        SingletonProblem::new(IndexView::U8(&[0]), 1, 1, 2, &[-1.0], &t),
        Err(Invalid::Value { name: "g" })
    ));
    assert!(matches!(
        SingletonProblem::new(IndexView::U8(&[0]), 2, 1, 2, &g, &t),
        Err(Invalid::Length { name: "indices", .. })
    ));
}
