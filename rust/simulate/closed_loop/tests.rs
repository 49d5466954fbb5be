use super::*;
use crate::control::pseudoinverse;
use proptest::prelude::*;

/// `A` and `B` by columns, n of them in `A`; `work` is given a loop along the reference.
fn with_loop<T>(a: &[f64], b: &[f64], reference: &[f64], work: impl FnOnce(ClosedLoop<'_>) -> T) -> T {
    let n = (a.len() as f64).sqrt() as usize;
    let m = b.len() / n;
    let rows: Vec<f64> = (0..n * m).map(|at| b[at % m * n + at / m]).collect();
    let factors = pseudoinverse(&rows, n, m).unwrap();
    work(ClosedLoop {
        a: Law::new(a.to_vec(), n, n).unwrap().into(),
        b: Law::new(b.to_vec(), m, n).unwrap(),
        x0: &reference[..n],
        reference,
        basis: &factors.basis,
        right: &factors.right,
        singular_values: &factors.singular_values[..factors.rank],
        size: 40,
        method: Fusion::Uniform,
        feedback: true,
        sample_states: false,
    })
}

const A: [f64; 4] = [0.5, -0.25, 0.75, 0.5];
const B: [f64; 4] = [1.0, 0.5, 0.0, 1.0];
const R: [f64; 8] = [1.0, -1.0, 0.5, 2.0, 0.0, 1.0, -1.0, 0.5];

#[test]
fn threads_change_nothing_and_more_runs_start_with_the_fewer() {
    for ((_, method), sample_states) in Fusion::NAMED.into_iter().zip([false, true, true, false]) {
        with_loop(&A, &B, &R, |given| {
            let given = ClosedLoop { method, sample_states, ..given };
            let run = |runs, threads| given.run(runs, &Key([1; 32]), threads, &Stop::new()).unwrap();
            let whole = run(9, 1);
            assert!(whole.optimal);
            assert_eq!(run(9, 3), whole);
            assert_eq!(run(2, 2).states, whole.states[..16]);
            assert_ne!(whole.states[..8], whole.states[8..16]);
        });
    }
}

#[test]
fn a_stop_and_what_does_not_fit_are_errors_and_a_lost_run_ends() {
    with_loop(&A, &B, &R, |given| {
        let stop = Stop::new();
        let run = |given: &ClosedLoop<'_>| given.run(3, &Key([1; 32]), 2, &stop);
        let short = ClosedLoop { x0: &R[..1], ..given.clone() };
        assert!(matches!(run(&short), Err(Error::Shape { name: "x0", .. })));
        let short = ClosedLoop { reference: &R[..2], ..given.clone() };
        assert!(matches!(run(&short), Err(Error::Shape { name: "reference", .. })));
        let none = ClosedLoop { size: 0, method: Fusion::Alse, ..given.clone() };
        assert!(run(&none).is_err());
        let far = ClosedLoop { x0: &[1e200, 0.0], ..given.clone() };
        let lost = run(&far).unwrap();
        assert!(lost.states[2..4].iter().all(|x| x.abs() > 1e150));
        assert!(lost.states[4..8].iter().all(|&x| x == 0.0));
        stop.request();
        assert_eq!(run(&given), Err(Error::Interrupted));
    });
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// The states follow the exact system, and `B^T (y - B u) = 0` with the estimates of the named streams.
    #[test]
    fn every_step_is_the_one_of_the_formula(
        a in prop::collection::vec(-1.0..1.0f64, 9),
        b in prop::collection::vec(-1.0..1.0f64, 6),
        reference in prop::collection::vec(-2.0..2.0f64, 12),
        seed in any::<u8>(),
        feedback in any::<bool>(),
        sample_states in any::<bool>(),
    ) {
        let key = Key([seed; 32]);
        let found = with_loop(&a, &b, &reference, |given| {
            ClosedLoop { feedback, sample_states, ..given }.run(2, &key, 1, &Stop::new()).unwrap()
        });
        let product = |m: &[f64], v: &[f64], i: usize| -> f64 { v.iter().enumerate().map(|(j, v)| m[j * 3 + i] * v).sum() };
        for (run, k) in [(0, 0), (0, 2), (1, 1)] {
            let state = |k: usize| &found.states[run * 12 + k * 3..][..3];
            let u = &found.inputs[run * 6 + k * 2..][..2];
            let step = key.child(&format!("replicate-{run}")).child(&format!("step-{k}"));
            let average = |values: &[f64], lines: usize, name: &str| {
                let law = Law::new(values.to_vec(), lines, 3).unwrap();
                let counts = multinomial_counts(&law, 40, &step.child(name), &Stop::new()).unwrap();
                uniform(&law, &counts, 40).unwrap()
            };
            let vector = |values: &[f64], name| if sample_states { average(values, 1, name) } else { values.to_vec() };
            let now = vector(if feedback { state(k) } else { &reference[k * 3..][..3] }, "state");
            let goal = vector(&reference[(k + 1) * 3..][..3], "target");
            let a_hat = average(&a, 3, "A");
            let left: Vec<f64> = (0..3).map(|i| goal[i] - product(&a_hat, &now, i) - product(&b, u, i)).collect();
            for i in 0..3 {
                let next = product(&a, state(k), i) + product(&b, u, i);
                prop_assert!((state(k + 1)[i] - next).abs() <= 1e-13 * (1.0 + next.abs()));
            }
            for column in b.chunks(3) {
                let slope: f64 = column.iter().zip(&left).map(|(b, l)| b * l).sum();
                let size = 1.0 + goal.iter().chain(u).map(|v| v.abs()).fold(0.0, f64::max);
                prop_assert!(slope.abs() <= 1e-10 * size, "{slope}");
            }
        }
    }
}
