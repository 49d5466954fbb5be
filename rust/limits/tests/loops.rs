//! Loops beside single problems, which the interior point solves; what a call allocates; calls that are cut.

use std::time::{Duration, Instant};

use super::*;
use crate::limits::horizon::{Horizon, RecedingHorizon, Task};
use crate::matrix::MatrixView;
use crate::memory::tests::counted;

/// Limits besides those of single inputs.
#[derive(Clone, Copy)]
struct Kind {
    /// Of the last input; the others have .11.
    rate: Option<f64>,
    /// Of the first half of the states, with the weight of soft ones.
    states: Option<Option<f64>>,
}

const RATES: Kind = Kind { rate: Some(0.11), states: None };
const FREE: Kind = Kind { rate: Some(f64::INFINITY), states: None };
const SOFT: Kind = Kind { rate: None, states: Some(Some(20.0)) };
const BOTH: Kind = Kind { rate: Some(0.11), states: Some(Some(20.0)) };
const HARD: Kind = Kind { rate: Some(0.11), states: Some(None) };
const BOX: Kind = Kind { rate: None, states: None };

struct Plant {
    a: Vec<f64>,
    b: Vec<f64>,
    n: usize,
    m: usize,
    normal: Normal,
}

impl Plant {
    fn new(seed: u8, n: usize, m: usize, growth: f64) -> Self {
        let mut normal = Normal::new(seed);
        let scale = growth / (n as f64).sqrt();
        let a = normal.take(n * n).iter().map(|v| scale * v).collect();
        let b = normal.take(n * m);
        Self { a, b, n, m, normal }
    }

    fn horizon(&self, steps: usize, kind: Kind) -> Horizon {
        let (n, m) = (self.n, self.m);
        let unit = |n: usize, w: f64| (0..n * n).map(|i| if i % (n + 1) == 0 { w } else { 0.0 }).collect::<Vec<_>>();
        let sides = |side: f64| {
            let of = |i: usize| if i % n <= n / 2 { side * (1.0 + 0.1 * (i % 3) as f64) } else { side * f64::INFINITY };
            (0..n * steps).map(of).collect::<Vec<_>>()
        };
        let high: Vec<_> = (0..m * steps).map(|i| 0.3 + 0.1 * (i % m) as f64).collect();
        let reference: Vec<_> = (0..n * steps).map(|i| 0.1 * (i as f64).sin()).collect();
        let (low, zero, stage, terminal) = (vec![-0.3; m * steps], vec![0.0; m], unit(n, 1.0), unit(n, 2.0));
        let (r, below, above) = (unit(m, 0.1), sides(-0.6), sides(0.8));
        let rate = kind.rate.map(|last| (0..m).map(|j| if j + 1 < m { 0.11 } else { last }).collect::<Vec<_>>());
        let task = Task {
            low: MatrixView::of(&low, m),
            high: MatrixView::of(&high, m),
            stage: MatrixView::of(&stage, n),
            terminal: MatrixView::of(&terminal, n),
            reference: MatrixView::of(&reference, n),
            r: Some(MatrixView::of(&r, m)),
            rate: rate.as_ref().map(|rate| (&rate[..], &zero[..])),
            states: kind.states.map(|_| (MatrixView::of(&below, n), MatrixView::of(&above, n))),
            soft: kind.states.flatten(),
        };
        Horizon::new(MatrixView::of(&self.a, n), MatrixView::of(&self.b, m), Some(&vec![0.01; n]), task).unwrap()
    }

    /// The state behind `u`, with noise.
    fn step(&mut self, x: &[f64], u: &[f64], noise: f64) -> Vec<f64> {
        let (n, m, w) = (self.n, self.m, self.normal.take(self.n));
        let of_state = |i: usize| self.a[i * n..(i + 1) * n].iter().zip(x).map(|(a, x)| a * x).sum::<f64>();
        let of_input = |i: usize| self.b[i * m..(i + 1) * m].iter().zip(u).map(|(b, u)| b * u).sum::<f64>();
        (0..n).map(|i| of_state(i) + of_input(i) + 0.01 + noise * w[i]).collect()
    }
}

#[test]
fn calls_agree_with_single_problems() {
    let (mut active, mut unmet) = ([0; 2], 0);
    for (seed, n, m, steps, kind) in [
        (1, 3, 1, 8, RATES),
        (2, 2, 2, 5, SOFT),
        (3, 4, 2, 6, BOTH),
        (4, 3, 2, 7, HARD),
        (5, 10, 5, 20, RATES),
        (6, 5, 1, 25, BOTH),
        (7, 1, 1, 1, BOTH),
        (8, 6, 3, 10, HARD),
        (9, 6, 2, 12, FREE),
    ] {
        let mut plant = Plant::new(seed, n, m, 1.0);
        let (mut many, mut one) =
            (RecedingHorizon::new(plant.horizon(steps, kind), &Stop::new()).unwrap(), plant.horizon(steps, kind));
        assert!(!many.condensed());
        let mut x = plant.normal.take(n);
        for call in 0..25 {
            let stop = Stop::new();
            let found = many.solve(&x, Until::new(&stop, None)).unwrap().clone();
            let other = one.best(&x, false, None, Until::new(&stop, None)).unwrap();
            unmet += usize::from(found.status == Status::Infeasible);
            assert_eq!(found.status, other.found.status, "{seed} {call}\n{found:?}\n{other:?}");
            if found.status == Status::Optimal {
                assert!(found.gap <= 1e-9 * found.objective + 1e-12, "{seed} {call} {found:?}");
                let (most, size) = (found.gap + other.found.gap, 1.0 + found.objective);
                assert!((found.objective - other.found.objective).abs() <= most + 1e-12 * size, "{seed} {call}");
                assert!((found.at_zero - other.found.at_zero).abs() <= 1e-10 * (1.0 + found.at_zero), "{seed} {call}");
            }
            for (i, (u, v)) in found.control.iter().zip(&other.found.control).enumerate() {
                assert!((u - v).abs() <= 1e-6, "{seed} {call} {i}: {u} {v}\n{found:?}\n{other:?}");
            }
            active[0] += found.active.iter().filter(|side| **side != 0).count();
            active[1] += many.warm().unwrap()[m * steps..].iter().filter(|side| **side != 0).count();
            let u = found.control[..m].to_vec();
            many.follow(&u).unwrap();
            one.follow(&u).unwrap();
            x = plant.step(&x, &u, if kind.states == Some(None) { 0.05 } else { 0.5 });
        }
    }
    assert!(active[0] > 100 && active[1] > 500 && unmet < 100, "{active:?} {unmet}");
}

#[test]
fn calls_allocate_nothing() {
    for (seed, n, m, steps, kind) in [
        (11, 10, 5, 20, BOX),
        (12, 2, 1, 6, BOX),
        (13, 10, 5, 20, RATES),
        (14, 4, 2, 10, SOFT),
        (15, 4, 2, 10, BOTH),
        (16, 8, 4, 60, RATES),
        (17, 6, 2, 12, FREE),
        (18, 10, 10, 24, BOX),
        (19, 4, 300, 1, BOX),
        (20, 4, 2, 800, BOX),
    ] {
        let mut plant = Plant::new(seed, n, m, 0.8);
        let mut many = RecedingHorizon::new(plant.horizon(steps, kind), &Stop::new()).unwrap();
        let (mut x, stop) = (plant.normal.take(n), Stop::new());
        for call in 0..40 {
            let limit = (call % 4 == 3).then_some(Duration::from_micros(call));
            let (u, bytes) = counted(|| {
                let found = many.solve(&x, Until::new(&stop, limit)).unwrap();
                assert!(limit.is_some() || found.status == Status::Optimal, "{seed} {call} {found:?}");
                [found.control[0], found.control[m - 1]]
            });
            assert_eq!(bytes, 0, "{seed} {call}");
            many.follow(&vec![0.5 * (u[0] + u[1]); m].iter().map(|u| u.clamp(-0.3, 0.3)).collect::<Vec<_>>()).unwrap();
            // at first no limit is reached
            x = plant.step(&x, &vec![u[0]; m], if call < 8 { 0.0 } else { 0.5 });
            x.iter_mut().filter(|_| call < 8).for_each(|x| *x *= 1e-6);
        }
    }
}

/// Calls without any time go on where the last one ended, and none is worse than the last plan a step later.
#[test]
fn cut_calls_go_on() {
    let mut optimal = 0;
    for (seed, kind) in [(21, RATES), (22, BOTH), (23, SOFT)] {
        let mut plant = Plant::new(seed, 6, 3, 0.8);
        let (mut one, stop) = (plant.horizon(12, kind), Stop::new());
        let mut many = RecedingHorizon::new(plant.horizon(12, kind), &Stop::new()).unwrap();
        let (mut x, mut last) = (plant.normal.take(6).iter().map(|v| 2.0 * v).collect::<Vec<_>>(), Vec::new());
        for call in 0..30 {
            let best = one.best(&x, false, None, Until::new(&stop, None)).unwrap().found;
            let found = many.solve(&x, Until::new(&stop, Some(Duration::ZERO))).unwrap().clone();
            let size = 1e-9 * (1.0 + best.objective);
            assert!(found.objective >= best.objective - best.gap - size, "{seed} {call}");
            assert!(found.objective - best.objective <= found.gap + size, "{seed} {call} {found:?}");
            if !last.is_empty() && found.status != Status::Optimal {
                let later = one.objective(&x, &last).unwrap();
                assert!(found.objective <= later + size, "{seed} {call} {later} {found:?}");
            }
            optimal += usize::from(found.status == Status::Optimal);
            let u = found.control[..3].to_vec();
            last = [&found.control[3..], &found.control[33..]].concat();
            many.follow(&u).unwrap();
            one.follow(&u).unwrap();
            x = plant.step(&x, &u, 0.0);
        }
    }
    assert!(optimal > 30, "{optimal} of 90");
}

#[test]
fn no_call_takes_more_than_the_most() {
    for (seed, n, m, steps, kind) in [(31, 4, 2, 10, BOX), (32, 4, 2, 10, BOTH)] {
        let mut plant = Plant::new(seed, n, m, 1.0);
        let mut many = RecedingHorizon::new(plant.horizon(steps, kind), &Stop::new()).unwrap();
        let (mut x, stop) = (plant.normal.take(n), Stop::new());
        let first = many.solve(&x, Until::new(&stop, None)).unwrap().control.clone();
        let most = many.most().unwrap().unwrap();
        assert!(most.operations > 1e4 && most.seconds > 0.0, "{most:?}");
        let again = many.solve(&x, Until::new(&stop, None)).unwrap();
        assert!(again.control.iter().zip(&first).all(|(a, b)| (a - b).abs() < 1e-9));
        for _ in 0..200 {
            let start = Instant::now();
            let found = many.solve(&x, Until::new(&stop, None)).unwrap();
            let took = start.elapsed().as_secs_f64();
            assert!(found.iterations <= most.factorizations);
            // a pause of the system is none of the loop
            assert!(took < most.seconds || took > 1e-3, "{took} {most:?}");
            let u = found.control[..m].to_vec();
            many.follow(&u).unwrap();
            x = plant.step(&x, &u, 0.5);
        }
    }
}

/// Each of these was taken for no limit at all, with the status of an optimum, or read in part.
#[test]
fn what_is_no_limit_is_refused() {
    type Change<'a> = &'a dyn Fn(&mut Task<'static>);
    let of = |change: Change<'_>| {
        let mut task = Task {
            low: (&[[-1.0]; 8]).into(),
            high: (&[[1.0]; 8]).into(),
            stage: (&[[1.0, 0.1], [0.1, 1.0]]).into(),
            terminal: (&[[1.0, 0.0], [0.0, 1.0]]).into(),
            reference: (&[[0.0; 2]; 8]).into(),
            r: Some((&[[0.1]]).into()),
            rate: Some((&[0.1], &[0.0])),
            states: Some(((&[[-1.0; 2]; 8]).into(), (&[[1.0; 2]; 8]).into())),
            soft: Some(1.0),
        };
        change(&mut task);
        Horizon::new(&[[1.0, 0.1], [0.0, 1.0]], &[[0.0], [0.1]], None, task)
    };
    let mut right = RecedingHorizon::new(of(&|_| ()).unwrap(), &Stop::new()).unwrap();
    let wrong: [(&str, Change<'_>); 17] = [
        ("rate", &|task| task.rate = Some((&[f64::NAN], &[0.0]))),
        ("rate", &|task| task.rate = Some((&[0.0], &[0.0]))),
        ("rate", &|task| task.rate = Some((&[], &[0.0]))),
        ("previous", &|task| task.rate = Some((&[0.1], &[f64::NAN]))),
        ("previous", &|task| task.rate = Some((&[0.1], &[]))),
        ("state_high", &|task| task.states = task.states.map(|(low, _)| (low, MatrixView::default()))),
        ("state_low", &|task| task.states = task.states.map(|(_, high)| ((&[[f64::NAN; 2]; 8]).into(), high))),
        ("low", &|task| task.low = (&[[-1.0], [f64::NAN], [0.0], [0.0], [0.0], [0.0], [0.0], [0.0]]).into()),
        ("low", &|task| task.low = (&[[2.0]; 8]).into()),
        ("soft", &|task| task.soft = Some(-1.0)),
        ("stage", &|task| task.stage = (&[[1.0, 0.2], [0.1, 1.0]]).into()),
        ("terminal", &|task| task.terminal = (&[[-1.0, 0.0], [0.0, 1.0]]).into()),
        ("R", &|task| task.r = Some((&[[-0.1]]).into())),
        ("reference", &|task| task.reference = MatrixView::default()),
        // as many entries as the right ones have
        ("low` must have 8 x 1 entries, got 1 x 8", &|task| task.low = (&[[-1.0; 8]]).into()),
        ("stage` must have 2 x 2 entries, got 1 x 4", &|task| task.stage = (&[[1.0, 0.1, 0.1, 1.0]]).into()),
        ("reference` must have 2 x 2 entries, got 2 x 8", &|task| task.reference = (&[[0.0; 8]; 2]).into()),
    ];
    for (name, change) in wrong {
        let error = of(change).unwrap_err().to_string();
        assert!(error.contains(&format!("`{name}")), "{name}: {error}");
    }
    let stop = Stop::new();
    let first = right.solve(&[0.5, 0.0], Until::new(&stop, None)).unwrap().control.clone();
    for wrong in [&[f64::NAN][..], &[], &[0.0, 0.0]] {
        assert!(right.follow(wrong).is_err());
    }
    assert!(right.about(&[0.0], &[f64::NAN, 0.0]).is_err() && right.toward(&[f64::NAN; 16], &stop).is_err());
    assert!(right.fix(&[f64::INFINITY; 8]).is_err() && right.fix(&[0.0; 7]).is_err());
    right.resume(None).unwrap();
    assert_eq!(right.solve(&[0.5, 0.0], Until::new(&stop, None)).unwrap().control, first);
}

#[test]
fn an_input_is_fixed_at_once_and_chosen_again() {
    for kind in [BOX, FREE] {
        let mut plant = Plant::new(21, 3, 2, 0.9);
        let mut many = RecedingHorizon::new(plant.horizon(6, kind), &Stop::new()).unwrap();
        let (x, stop) = (plant.normal.take(3), Stop::new());
        let mut call = |values: Option<f64>| {
            if let Some(value) = values {
                let fixed: Vec<f64> = (0..12).map(|i| if i % 2 == 1 { value } else { f64::NAN }).collect();
                many.fix(&fixed).unwrap();
            }
            let found = many.solve(&x, Until::new(&stop, None)).unwrap();
            assert_eq!(found.status, Status::Optimal);
            found.control.clone()
        };
        let before = call(None);
        let fixed = call(Some(0.05));
        assert!(fixed.iter().skip(1).step_by(2).all(|u| *u == 0.05) && before[1] != 0.05, "{before:?} {fixed:?}");
        let after = call(Some(f64::NAN));
        assert!(before.iter().zip(&after).all(|(u, v)| (u - v).abs() <= 1e-9), "{before:?} {after:?}");
    }
}

#[test]
fn the_gap_of_a_cut_call_counts_inputs_that_are_chosen_again() {
    let (stop, mut cut) = (Stop::new(), 0);
    for seed in 0..20 {
        let mut plant = Plant::new(seed, 3, 2, 0.9);
        let mut many = RecedingHorizon::new(plant.horizon(6, BOX), &stop).unwrap();
        let (x, now) = (plant.normal.take(3), Until::new(&stop, Some(Duration::ZERO)));
        many.fix(&(0..12).map(|i| if i % 2 == 1 { 0.05 } else { f64::NAN }).collect::<Vec<_>>()).unwrap();
        many.solve(&x, now).unwrap(); // its gap is one of the other inputs alone
        many.fix(&[f64::NAN; 12]).unwrap();
        let (found, gap) = many.solve(&x, now).map(|one| (one.objective, one.gap)).unwrap();
        let best = many.solve(&x, Until::new(&stop, None)).unwrap();
        assert_eq!(best.status, Status::Optimal);
        assert!(found - best.objective <= gap + 1e-12, "{seed}: {found} - {} is above {gap}", best.objective);
        cut += usize::from(found > best.objective + 1e-6);
    }
    assert!(cut > 10, "{cut}");
}
