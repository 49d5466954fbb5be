//! Many steps, against the same problems condensed.

use super::*;

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
            let horizon = Steps {
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
    let horizon = Steps {
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
            &Steps { r: &[-1.0], ..horizon },
            Bounds::new(&[0.0; 2], &[1.0; 2], 2).unwrap(),
            None,
            Until::new(&stop, None)
        )
        .is_err()
    );
    let steep = Steps { a: &[1e200, 1.0, 0.0, 1.0], ..horizon };
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
        let horizon = Steps {
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
