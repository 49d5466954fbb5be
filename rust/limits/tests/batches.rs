//! One `M` for many states, and batches.

use super::*;

#[test]
fn a_solver_agrees_with_single_calls() {
    let (mut normal, stop) = (Normal::new(6), Stop::new());
    for (d, rows, n) in [(6, 9, 3), (30, 40, 5), (12, 5, 4)] {
        let (m, state, target) = (normal.take(rows * d), normal.take(rows * n), normal.take(rows));
        let (r, low, high) = (vec![0.1; d], vec![-0.2; d], vec![0.3; d]);
        let bounds = Bounds::new(&low, &high, d).unwrap();
        let mut solver = Solver::new(&m, Penalty::Diagonal(&r), bounds, 2, (&state, &target), &stop).unwrap();
        for _ in 0..20 {
            let x = normal.take(n);
            let of = |i: usize| target[i] - (0..n).map(|j| state[i * n + j] * x[j]).sum::<f64>();
            let y: Vec<f64> = (0..rows).map(of).collect();
            let single = solved(&m, &y, &r, &low, &high);
            let found = solver.solve(&x, Until::new(&stop, None)).unwrap();
            assert_eq!((found.status, &found.active), (Status::Optimal, &single.active), "{d}\n{found:?}\n{single:?}");
            assert!((found.objective - single.objective).abs() <= 1e-12 * single.objective);
            assert!((found.at_zero - single.at_zero).abs() <= 1e-12 * single.at_zero);
            assert!(found.control.iter().zip(&single.control).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        let before = solver.warm().unwrap().to_vec();
        assert!(solver.solve(&[f64::NAN].repeat(n), Until::new(&stop, None)).is_err());
        assert!(solver.solve(&[1.0], Until::new(&stop, None)).is_err() || n == 1);
        assert_eq!(solver.warm().unwrap(), before);
        assert!(solver.resume(Some(vec![0; d + 1])).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

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
        for (s, y) in y.chunks_exact(rows).enumerate().take(300) {
            let single = solved(&m, y, &r, &low, &high);
            let scale = single.at_zero + single.objective;
            assert!(gaps[s] <= 1e-12 * scale, "{d} {s} {}", gaps[s]);
            for i in 0..d {
                assert!((u[s * d + i] - single.control[i]).abs() < 1e-12);
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
