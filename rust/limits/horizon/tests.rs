use std::sync::Arc;

use super::*;
use crate::limits::linear::{decomposition, root, singular_values, times};
use crate::limits::{Status, Until};
use crate::matrix::MatrixView;
use crate::parallel::Stop;
use crate::region::tests::round;
use crate::region::{Part, Region};
use crate::simulate::Plans;
use crate::{Key, Scheme};

const A: [f64; 4] = [0.9, 0.2, -0.1, 0.8];
const B: [f64; 2] = [1.0, 0.5];
const X0: [f64; 2] = [1.0, 2.0];

fn of(a: &[f64]) -> MatrixView<'_> {
    MatrixView::of(a, 2)
}

fn of_input(b: &[f64]) -> MatrixView<'_> {
    MatrixView::of(b, 1)
}

/// Every entry of a matrix of so many rows.
fn filled(value: f64, rows: usize, columns: usize) -> MatrixView<'static> {
    MatrixView::of(vec![value; rows * columns].leak(), columns)
}

fn task(steps: usize, limit: f64) -> Task<'static> {
    Task {
        low: filled(-limit, steps, 1),
        high: filled(limit, steps, 1),
        stage: (&[[2.0, 0.5], [0.5, 1.0]]).into(),
        terminal: (&[[1.0, 0.0], [0.0, 3.0]]).into(),
        reference: of((0..2 * steps).map(|i| (i as f64).sin()).collect::<Vec<_>>().leak()),
        r: Some((&[[0.1]]).into()),
        ..Task::default()
    }
}

fn horizon(task: Task<'_>) -> Horizon {
    Horizon::new(of(&A), of_input(&B), Some(&[0.1, -0.2]), task).unwrap()
}

fn solved(h: &Horizon, x0: &[f64]) -> Solved {
    h.solve(x0, Until::new(&Stop::new(), None)).unwrap()
}

#[test]
fn the_condensed_cost_is_that_of_the_states() {
    let h = horizon(task(4, 1.0));
    let u = [0.3, -0.7, 0.2, 0.9];
    let (map, state, target) = (h.map().unwrap(), h.state().unwrap(), h.target().unwrap());
    let (moved, free) = (times(map, &u, 4).unwrap(), times(&state, &X0, 2).unwrap());
    let condensed: f64 = (0..target.len()).map(|i| (moved[i] + free[i] - target[i]).powi(2)).sum::<f64>()
        + u.iter().map(|u| 0.1 * u * u).sum::<f64>();
    // the sum over the steps
    let (mut x, mut wanted) = (X0, 0.0);
    for (k, u) in u.iter().enumerate() {
        x = [0.9 * x[0] + 0.2 * x[1] + u + 0.1, -0.1 * x[0] + 0.8 * x[1] + 0.5 * u - 0.2];
        let e = [x[0] - (2.0 * k as f64).sin(), x[1] - (2.0 * k as f64 + 1.0).sin()];
        let q = if k == 3 { [1.0, 0.0, 3.0] } else { [2.0, 0.5, 1.0] };
        wanted += q[0] * e[0] * e[0] + 2.0 * q[1] * e[0] * e[1] + q[2] * e[1] * e[1] + 0.1 * u * u;
    }
    assert!((condensed - wanted).abs() <= 1e-12 * wanted);
    assert!((h.objective(&X0, &u).unwrap() - wanted).abs() <= 1e-12 * wanted);
}

#[test]
fn the_best_inputs_are_no_worse_than_others_within_the_limits() {
    let h = horizon(task(4, 0.4));
    let best = solved(&h, &X0);
    assert_eq!(best.found.status, Status::Optimal);
    for i in 0..200 {
        let u: Vec<f64> = (0..4).map(|j| 0.4 * ((7 * i + 3 * j + i * j) as f64).sin()).collect();
        let worse = h.objective(&X0, &u).unwrap() - best.found.objective;
        assert!(worse >= -best.found.gap, "{worse}");
    }
    let free = solved(&horizon(task(4, 1e6)), &X0);
    assert!((best.missed - (best.found.objective - free.found.objective)).abs() <= 1e-9);
    assert!(best.missed > 0.0 && free.missed == 0.0);
}

#[test]
fn rates_and_states_and_a_loop() {
    let mut limited = task(4, 0.4);
    limited.rate = Some((&[0.2], &[0.0]));
    limited.states = Some((filled(-0.3, 4, 2), filled(f64::INFINITY, 4, 2)));
    limited.soft = Some(10.0);
    let h = horizon(limited);
    let best = solved(&h, &X0);
    let u = &best.found.control;
    assert!(u[0].abs() <= 0.2 + 1e-12 && u.windows(2).all(|u| (u[1] - u[0]).abs() <= 0.2 + 1e-12));
    assert_eq!(best.state_active.as_ref().map(Vec::len), Some(8));
    let mut many = RecedingHorizon::new(horizon(limited), &Stop::new()).unwrap();
    let mut first = many.solve(&X0, Until::new(&Stop::new(), None)).unwrap().control.clone();
    assert!(!many.condensed() && first.iter().zip(u).all(|(a, b)| (a - b).abs() < 1e-8));
    let warm = many.warm().map(<[i8]>::to_vec);
    assert_eq!(warm.as_ref().map(Vec::len), Some(16));
    many.follow(&[0.4]).unwrap();
    first = many.solve(&X0, Until::new(&Stop::new(), None)).unwrap().control.clone();
    assert!(first[0] >= 0.2 - 1e-12);
    assert!(many.resume(Some(vec![0; 3])).is_err() && many.resume(warm).is_ok());
}

/// The true system is at the edge of what is around: the error is at most the bound, and not far below it.
#[test]
fn another_system_is_within_the_bounds() {
    let model = horizon(task(3, 5.0));
    let given = solved(&model, &X0).found;
    let mut most = 0.0f64;
    for i in 0..20 {
        let size = 10f64.powf(-0.5 - 0.15 * f64::from(i));
        let (da, db) = ([size, 0.0, -0.5 * size, 0.3 * size], [0.2 * size, -size]);
        let a: Vec<f64> = A.iter().zip(da).map(|(a, d)| a + d).collect();
        let b: Vec<f64> = B.iter().zip(db).map(|(b, d)| b + d).collect();
        let exact = Horizon::new(of(&a), of_input(&b), Some(&[0.1, -0.2]), task(3, 5.0)).unwrap();
        let best = solved(&exact, &X0).found;
        let (at, model_at) = (exact.states(&X0, &given.control).unwrap(), model.states(&X0, &given.control).unwrap());
        let off: Vec<f64> = at.iter().zip(&model_at).map(|(a, b)| a - b).collect();
        let alpha = exact.weighted(&off).unwrap().iter().map(|v| v * v).sum::<f64>().sqrt();
        let truth = region(|i, j| if j < 2 { exact.a[2 * i + j] } else { exact.b[i] }, Vec::new());
        let found = model.apart(&truth, &model_at, &given.control, alpha, given.gap).unwrap();
        let wrong: Vec<f64> = given.control.iter().zip(&best.control).map(|(u, v)| u - v).collect();
        let moved = times(exact.map().unwrap(), &wrong, 3).unwrap();
        let state = moved.iter().map(|v| v * v).sum::<f64>().sqrt();
        let slack = 2.0 * best.distance + 1e-12;
        assert!(state <= found.state + slack, "{state} {}", found.state);
        let excess = exact.objective(&X0, &given.control).unwrap() - best.objective;
        assert!(excess <= found.excess + best.gap + 1e-12);
        let error = exact.error(&X0, &given, &Cause::Map(found), Until::new(&Stop::new(), None)).unwrap();
        assert!(error.state >= found.state && error.state <= found.state * (1.0 + 1e-9));
        let known = exact.error(&X0, &given, &Cause::Known, Until::new(&Stop::new(), None)).unwrap();
        assert!((known.state - state).abs() <= best.distance + 1e-12);
        most = most.max(state / found.state);
    }
    assert!(most > 0.3, "{most}");
}

/// A region (2, 3) with this centre.
fn region(centre: impl Fn(usize, usize) -> f64, parts: Vec<Arc<Part>>) -> Region {
    let entries: Vec<f64> = (0..6).map(|at| centre(at / 3, at % 3)).collect();
    Region::new(MatrixView::of(&entries, 3), 1, parts, None, false).unwrap()
}

/// A part holds every D whose `||D' p||` it bounds.
#[test]
fn parts_and_shifts_agree() {
    let model = horizon(task(3, 0.5));
    let given = solved(&model, &X0).found;
    let at = model.states(&X0, &given.control).unwrap();
    let own = |i: usize, j: usize| if j < 2 { A[2 * i + j] } else { B[i] };
    let one = region(|i, j| own(i, j) + if i == j { 0.01 } else { 0.0 }, Vec::new());
    let other = region(own, vec![round(&[0, 1], &[0, 1], 1e-4)]);
    let found = [one, other].map(|around| model.apart(&around, &at, &given.control, 0.1, given.gap).unwrap());
    assert!((found[0].distance - found[1].distance).abs() <= 1e-12 * found[0].distance);
}

#[test]
fn drawn_errors_do_not_depend_on_threads_and_follow_the_estimates() {
    for auto in [false, true] {
        let mut given = task(3, 0.3);
        given.r = if auto { None } else { given.r };
        let h = Horizon::new(of(&A), of_input(&B), None, given).unwrap();
        let columns = [A[0], A[2], A[1], A[3]];
        let drawn = |lines, length| DrawnEntity { lines, length, drawn: Some((50, Scheme::Iid)) };
        let [x0, xf] = [
            DrawnEntity { lines: &X0, length: 2, drawn: None },
            DrawnEntity { lines: &[0.0; 2], length: 2, drawn: None },
        ];
        let a = drawn(&columns, 2);
        let plans = || Plans::new(x0.estimate()?, xf.estimate()?, a.estimate()?, false, false);
        let (stop, key) = (Stop::new(), Key([3; 32]));
        let [one, two] = [1, 2].map(|threads| {
            let runs = Runs { count: 150, key: &key, threads };
            h.drawn_errors(&plans().unwrap(), &X0, (false, auto), runs, &stop).unwrap()
        });
        assert_eq!(one, two);
        // each is the error of the best inputs of its estimates
        let estimates = plans().unwrap().estimates(0, 150, &key, &stop).unwrap();
        let best = solved(&h, &X0).found;
        for (errors, estimate) in one.chunks_exact(3).zip(estimates.chunks_exact(8)).step_by(10) {
            let own = Horizon::new(of(&estimate[4..]), of_input(&B), None, given).unwrap();
            let u = solved(&own, &estimate[..2]).found.control;
            let wrong = u.iter().zip(&best.control).map(|(u, v)| (u - v) * (u - v)).sum::<f64>().sqrt();
            assert!((errors[1] - wrong).abs() <= 1e-6 * (1.0 + wrong), "{} {wrong}", errors[1]);
        }
    }
}

#[test]
fn moved_targets_are_zero_without_draws() {
    let entity = |lines| DrawnEntity { lines, length: 2, drawn: None };
    let columns = [A[0], A[2], A[1], A[3]];
    let (stop, key) = (Stop::new(), Key([3; 32]));
    for (steps, soft) in [(1, None), (3, None), (1, Some(2.0)), (3, Some(2.0))] {
        let mut given = task(steps, 0.3);
        given.soft = soft;
        given.states = soft.map(|_| (filled(-1.0, steps, 2), filled(1.0, steps, 2)));
        let h = Horizon::new(of(&A), of_input(&B), None, given).unwrap();
        let given = [entity(&X0), entity(&[0.5, 0.5]), entity(&columns)];
        let runs = Runs { count: 20, key: &key, threads: 1 };
        let found = h.moved_targets(given, (false, false), [&X0, &[0.5, 0.5]], runs, &stop).unwrap();
        assert!(found.len() == 20 && found.iter().all(|d| *d < 1e-14));
        // a start that is wrong by e moves the target by sup over its range
        let wrong = [entity(&[1.5, 2.0]), entity(&[0.5, 0.5]), entity(&columns)];
        let moved = h.moved_targets(wrong, (false, false), [&X0, &[0.5, 0.5]], runs, &stop).unwrap();
        let bound = h.moved_target([0.5, 0.0, 0.0], [&A, &X0]).unwrap();
        assert!(moved.iter().all(|d| *d > 0.01 && *d <= bound * (1.0 + 1e-12)), "{} {bound}", moved[0]);
    }
}

#[test]
fn overflow_and_wrong_shapes_are_refused() {
    let huge = Horizon::new(&[[1e200, 0.0], [0.0, 1.0]], of_input(&B), None, task(4, 1.0));
    assert!(matches!(huge, Err(crate::Error::Overflow { .. })));
    let mut short = task(4, 1.0);
    short.low = filled(-1.0, 3, 1);
    assert!(matches!(Horizon::new(of(&A), of_input(&B), None, short), Err(crate::Error::Shape { name: "low", .. })));
}

#[test]
fn roots_and_singular_values() {
    let q = [4.0, 1.0, 1.0, 0.25]; // of rank one
    let f = root(&q, 2).unwrap();
    assert_eq!(f.len(), 2);
    let back = [f[0] * f[0], f[0] * f[1], f[1] * f[1]];
    assert!(back.iter().zip([4.0, 1.0, 0.25]).all(|(a, b)| (a - b).abs() < 1e-14));
    let s = singular_values(&[3.0, 0.0, 0.0, 4.0, 0.0, 0.0], 2).unwrap();
    assert!((s[0] - 4.0).abs() < 1e-14 && (s[1] - 3.0).abs() < 1e-14);
    assert_eq!(decomposition(&[1.0, 2.0, 2.0, 4.0], 2).unwrap().s.len(), 1);
    assert_eq!(singular_values(&[], 2).unwrap().len(), 0);
}

/// `x' = 1.9 x + u` over 80 steps: `J` is that of Riccati's recursion, not that of a condensed map; an offset is one
/// more state.
#[test]
fn a_plan_over_which_the_system_grows_is_followed() {
    let (steps, r, x0) = (80, 0.1, 0.5);
    let task = |limit: f64, q: MatrixView<'static>| Task {
        low: filled(-limit, steps, 1),
        high: filled(limit, steps, 1),
        stage: q,
        terminal: q,
        reference: filled(0.0, steps, q.shape().0),
        r: Some(filled(r, 1, 1)),
        ..Task::default()
    };
    let p = (1..steps).fold(1.0, |p, _| 1.0 + 1.9 * 1.9 * p * r / (r + p));
    let least = 1.9 * 1.9 * p * r / (r + p) * x0 * x0;
    for limit in [10.0, 0.8] {
        let h = Horizon::new(&[[1.9]], &[[1.0]], None, task(limit, (&[[1.0]]).into())).unwrap();
        let best = h.solve(&[x0], Until::new(&Stop::new(), None)).unwrap();
        let followed = best.followed.unwrap();
        assert_eq!(best.found.status, Status::Optimal);
        assert!(best.found.gap <= 1e-20 && followed.open_until < steps && followed.open_objective > 1.0);
        assert!((best.found.objective - best.missed - least).abs() <= 1e-14 * least);
        assert!(best.found.control.iter().all(|u| u.abs() <= limit));
        assert_eq!(best.found.active[0], if limit < 0.88 { -1 } else { 0 });
    }
    let h = Horizon::new(&[[1.9]], &[[1.0]], Some(&[0.3]), task(10.0, (&[[1.0]]).into())).unwrap();
    let wide = task(10.0, (&[[1.0, 0.0], [0.0, 0.0]]).into());
    let more = Horizon::new(&[[1.9, 0.3], [0.0, 1.0]], &[[1.0], [0.0]], None, wide).unwrap();
    let [one, two] = [(h, vec![x0]), (more, vec![x0, 1.0])]
        .map(|(h, x0)| h.solve(&x0, Until::new(&Stop::new(), None)).unwrap().found);
    assert!(one.objective == two.objective && one.control == two.control && one.status == Status::Optimal);
}
