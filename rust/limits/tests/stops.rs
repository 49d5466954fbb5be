//! Stops and time limits at any moment.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use super::*;

/// A stop at the `at`-th look.
fn stopping(at: usize) -> Stop {
    let left = AtomicUsize::new(at);
    Stop::watching(Duration::ZERO, move || {
        left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_err()
    })
}

/// Whatever is solved, until no stop comes before the end: the gap is true, and the status says what happened.
fn stopped_at_any_look(solve: impl Fn(Until<'_>) -> Solution) {
    let never = Stop::new();
    let best = solve(Until::new(&never, None));
    assert_eq!(best.status, Status::Optimal);
    let none = solve(Until::new(&never, Some(Duration::ZERO)));
    assert_eq!((none.status, none.iterations), (Status::Limit, 0));
    assert!(none.objective - best.objective <= none.gap * (1.0 + 1e-12));
    let mut ended = 0;
    for at in 0..400 {
        let stop = stopping(at);
        let found = solve(Until::new(&stop, None));
        assert!(found.objective - best.objective <= found.gap + 1e-12 * best.at_zero, "{at}");
        assert!(matches!(found.status, Status::Interrupted | Status::Optimal), "{at}");
        if found.status == Status::Optimal {
            break;
        }
        ended += 1;
    }
    assert!(ended > 0, "{ended}");
}

#[test]
fn condensed_problems_of_several_panels() {
    let (mut normal, d, rows) = (Normal::new(20), 300, 310);
    let (m, y) = (normal.take(rows * d), normal.take(rows));
    let (r, low, high) = (vec![0.1; d], vec![-0.01; d], vec![0.02; d]);
    let bounds = Bounds::new(&low, &high, d).unwrap();
    stopped_at_any_look(|until| box_control(&m, &y, Penalty::Diagonal(&r), bounds, None, until).unwrap());
}

#[test]
fn horizons() {
    let (mut normal, n, m, steps) = (Normal::new(21), 4, 2, 60);
    let a: Vec<f64> = normal.take(n * n).iter().map(|v| 0.4 * v).collect();
    let (b, x0, reference) = (normal.take(n * m), normal.take(n), normal.take(n * steps));
    let unit = |n: usize, w: f64| -> Vec<f64> { (0..n * n).map(|i| if i % (n + 1) == 0 { w } else { 0.0 }).collect() };
    let (q, r) = (unit(n, 1.0), unit(m, 0.1));
    let horizon = Steps { a: &a, b: &b, x0: &x0, reference: &reference, stage: &q, terminal: &q, r: &r };
    let (low, high) = (vec![-0.2; steps * m], vec![0.2; steps * m]);
    let bounds = Bounds::new(&low, &high, steps * m).unwrap();
    stopped_at_any_look(|until| horizon_control(&horizon, bounds, None, until).unwrap());
    let rate = Some((&[0.1; 2][..], &[0.0; 2][..]));
    let rows = Rows { rate, ..Rows::default() };
    stopped_at_any_look(|until| rows_control(&horizon, bounds, rows, until).unwrap().found);
}

/// A large product by tiles of its own, and by rows.
#[test]
fn products_of_large_matrices() {
    let (mut normal, n, m) = (Normal::new(22), 150usize, 140usize);
    let (ln, lm) = (n.next_multiple_of(8), m.next_multiple_of(8));
    let (mut a, mut b) = (vec![0.0; n * ln], vec![0.0; n * lm]);
    a.chunks_exact_mut(ln).for_each(|row| row[..n].copy_from_slice(&normal.take(n)));
    b.chunks_exact_mut(lm).for_each(|row| row[..m].copy_from_slice(&normal.take(m)));
    for transposed in [false, true] {
        let mut out = vec![0.0; n * lm];
        factor::product(&a, ln, transposed, n, &b, &mut out, lm).unwrap();
        for i in 0..n {
            for j in 0..m {
                let at = |k: usize| if transposed { a[k * ln + i] } else { a[i * ln + k] };
                let sum: f64 = (0..n).map(|k| at(k) * b[k * lm + j]).sum();
                assert!((out[i * lm + j] - sum).abs() < 1e-11);
            }
        }
    }
}
