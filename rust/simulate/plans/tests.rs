use super::*;
use crate::sample::Law;

fn drawn(values: &[f64], lines: usize, size: u64) -> PlanEntity {
    let law = Law::new(values.to_vec(), lines, values.len() / lines).unwrap();
    PlanEntity::Drawn(Average::new(law, size, Scheme::Iid).unwrap())
}

/// `A = I`, `B = I`, `xf = 0`: the error of the state is that of `A_hat x0_hat`, by hand for one realization.
#[test]
fn one_realization_by_hand() {
    let (identity, x0, stop) = ([1.0, 0.0, 0.0, 1.0], [3.0, -1.0], Stop::new());
    let plans = |paired| {
        Plans::new(drawn(&x0, 1, 1), PlanEntity::Fixed(vec![0.0; 2]), drawn(&identity, 2, 1), false, paired).unwrap()
    };
    let exact = Exact::OneStep { basis: &identity, singular_values: &[1.0, 1.0], y: &[-3.0, 1.0] };
    for paired in [false, true] {
        let errors = plans(paired).errors(exact, 4000, &Key([1; 32]), 2, &stop).unwrap();
        // (4, 0) - (3, -1) with probability 3/4, else (0, -4) - (3, -1)
        let (near, far) = (2.0_f64.sqrt(), 18.0_f64.sqrt());
        assert!(errors.iter().all(|e| (e - near).abs() < 1e-12 || (e - far).abs() < 1e-12));
        let share = errors.iter().filter(|e| **e < 2.0).count() as f64 / errors.len() as f64;
        assert!((share - 0.75).abs() < 4.0 * (0.75 * 0.25 / 4000.0_f64).sqrt()); // false alarm 6e-5
    }
}

#[test]
fn threads_change_nothing_and_more_runs_start_with_the_fewer() {
    let (a, x0, stop) = ([0.5, -1.0, 0.25, 2.0], [1.0, -2.0], Stop::new());
    let plans = Plans::new(drawn(&x0, 1, 40), drawn(&x0, 1, 40), drawn(&a, 2, 40), true, false).unwrap();
    let (b, c, v) = ([1.0, 0.5], [1.0, 0.75, 0.5, 0.0], [-1.0, 1.0]);
    let exact = Exact::Steps { b: &b, c: &c, v: &v };
    let errors = |runs, threads| plans.errors(exact, runs, &Key([2; 32]), threads, &stop).unwrap();
    let whole = errors(100, 1);
    assert_eq!(errors(100, 3), whole);
    assert_eq!(errors(33, 2), whole[..66]);
    stop.request();
    assert_eq!(plans.errors(exact, 9, &Key([2; 32]), 1, &stop), Err(Error::Interrupted));
}

#[test]
fn what_does_not_fit_is_refused() {
    let fixed = |len| PlanEntity::Fixed(vec![1.0; len]);
    assert!(matches!(Plans::new(fixed(2), fixed(3), fixed(4), false, false), Err(Error::Shape { name: "xf", .. })));
    assert!(matches!(Plans::new(fixed(2), fixed(2), fixed(5), false, false), Err(Error::Shape { name: "A", .. })));
    let law = Law::new(vec![1.0; 4], 2, 2).unwrap();
    assert!(matches!(Average::new(law.clone(), 0, Scheme::Iid), Err(Error::Value { name: "size", .. })));
    let rows = PlanEntity::Drawn(Average::new(law, 5, Scheme::Systematic).unwrap());
    assert!(matches!(Plans::new(fixed(2), fixed(2), rows, true, true), Err(Error::Value { name: "fusion", .. })));
}

/// With `B = I` and one step the control of an estimate is `xf - A x0`.
#[test]
fn estimates_are_those_behind_the_errors() {
    let (a, x0, exact, stop) = ([0.5, -1.0, 0.25, 2.0], [1.0, -2.0], [0.3, -0.7], Stop::new());
    for rows in [false, true] {
        let fixed = PlanEntity::Fixed(exact.to_vec());
        let plans = Plans::new(drawn(&x0, 1, 40), fixed, drawn(&a, 2, 40), rows, false).unwrap();
        let (identity, key) = ([1.0, 0.0, 0.0, 1.0], Key([3; 32]));
        let errors = plans.errors(Exact::Steps { b: &identity, c: &identity, v: &exact }, 50, &key, 2, &stop).unwrap();
        let estimates = plans.estimates(0, 50, &key, &stop).unwrap();
        assert_eq!(plans.estimates(20, 30, &key, &stop).unwrap(), estimates[20 * 8..]);
        for (errors, of) in errors.chunks_exact(2).zip(estimates.chunks_exact(8)) {
            assert_eq!(of[2..4], exact);
            // xf - A x0 - v with v = xf
            let wrong = (0..2).map(|i| of[4 + 2 * i] * of[0] + of[5 + 2 * i] * of[1]);
            let size = wrong.map(|w| w * w).sum::<f64>().sqrt();
            assert!(errors.iter().all(|e| (e - size).abs() <= 1e-12 * (1.0 + size)), "{errors:?} {size}");
        }
    }
}
