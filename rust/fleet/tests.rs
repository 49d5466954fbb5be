use super::binomial::{Odds, log_choose, log_tails};
use super::*;
use crate::limits::Until;
use crate::parallel::Stop;

fn check(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 6e-13, "{found:.15} is not {expected:.12}");
}

#[test]
fn risks_of_the_published_equations() {
    check(at_most(60, 3, 0.05).unwrap(), 0.124187210477);
    check(at_most(3000, 20, 1e-6).unwrap(), 0.016696732911);
    check(judged(60, 3, 0.05).unwrap(), 0.166517980033);
    check(judged(3000, 5, 1e-6).unwrap(), 0.009723323179);
    // t^(N-k) = beta / (N C(N, k)), so e = 1 - t
    for (n, k, beta, choose) in [(60, 3, 0.05f64, 34220.0), (60, 0, 0.05, 1.0), (300, 2, 1e-6, 44850.0)] {
        let level = (beta / n as f64 / choose).ln() / (n - k) as f64;
        check(compression(n, k, 0, beta).unwrap(), -level.exp_m1());
    }
    assert!(compression(60, 3, 2, 0.05).unwrap() > compression(60, 3, 1, 0.05).unwrap());
    assert_eq!(compression(60, 3, 57, 0.05), Ok(1.0));
    check(relaxed(60, 3, 0.05).unwrap().1, 0.181159658474);
    let (low, high) = relaxed(60, 10, 0.01).unwrap();
    check(low, 0.046720257502);
    check(high, 0.377934953896);
    assert_eq!((required(0.05, 21, 1e-6), required(0.01, 21, 1e-6)), (Ok(992), Ok(5020)));
    check(at_most(7, 6, 1e-9).unwrap(), 1.0 - 1e-9 / 7.0); // 1 - e^7 = beta
    assert_eq!((at_most(5, 5, 0.1), compression(5, 5, 0, 0.1)), (Ok(1.0), Ok(1.0)));
    assert!(at_most(5, 1, 0.0).is_err() && judged(5, 1, f64::NAN).is_err() && required(1.0, 1, 0.5).is_err());
}

#[test]
fn tails_are_sums_of_probabilities() {
    for (n, e) in [(7.0, 0.3), (60.0, 0.01), (60.0, 0.9), (500.0, 0.5)] {
        let odds = Odds::new(e / (1.0 - e));
        let pmf = |k: f64| (log_choose(n, k) + k * f64::ln(e) + (n - k) * f64::ln_1p(-e)).exp();
        let mut sum = 0.0;
        for k in 0..n as usize {
            sum += pmf(k as f64);
            let (below, above) = log_tails(n, k as f64, odds);
            assert!((below.exp() - sum).abs() <= 1e-12 * sum.max(1e-3), "{n} {e} {k}");
            let rest: f64 = (k + 1..=n as usize).map(|k| pmf(k as f64)).sum();
            assert!((above.exp() - rest).abs() <= 1e-11 * rest, "{n} {e} {k}: {} {rest}", above.exp());
        }
    }
}

/// `x(1) = a_s u`, target 1.
fn scalar<'a>(a: &'a [f64], zeros: &'a [f64]) -> Units<'a> {
    let size = a.len();
    Units {
        a: &zeros[..size],
        b: a,
        c: &[],
        x0: &[0.0],
        reference: &[1.0],
        stage: &[],
        terminal: &[1.0],
        n: 1,
        m: 1,
        steps: 1,
        size,
    }
}

#[test]
fn two_units_have_their_commands() {
    let zeros = [0.0; 2];
    let two = scalar(&[1.0, 2.0], &zeros).checked().unwrap();
    let stop = Stop::new();
    let found = moments(&two, 1, &stop).unwrap();
    assert_eq!((found.h[0], found.f[0], found.constant), (2.5, 1.5, 1.0));
    let (square, gradient) = slope(&two, &[0.6], 1, &stop).unwrap();
    assert!((square - 0.1).abs() < 1e-15 && gradient[0].abs() < 1e-15);
    for (end, u, value) in [(f64::INFINITY, 2.0 / 3.0, 1.0 / 3.0), (0.5, 0.5, 0.5)] {
        let limits = Limits { low: &[-end], high: &[end], ..Limits::default() };
        let best = worst(&two, limits, (&[false; 2], &[]), (1, Until::new(&stop, None))).unwrap();
        assert!((best.control[0] - u).abs() < 1e-8 && (best.value - value).abs() < 1e-8);
        assert!(best.value - best.lower_bound <= 1e-7 * best.value && best.lower_bound <= value + 1e-15);
    }
}

#[test]
fn limits_of_states_are_kept_or_lack_what_they_lack() {
    // x(1) = 3 + u, target 2.5: u = -2 keeps x(1) <= 1, and with |u| <= 1 at least 1 is missing
    let one = Units {
        a: &[1.0],
        b: &[1.0],
        c: &[],
        x0: &[3.0],
        reference: &[2.5],
        stage: &[],
        terminal: &[1.0],
        n: 1,
        m: 1,
        steps: 1,
        size: 1,
    };
    let (one, stop) = (one.checked().unwrap(), Stop::new());
    let states = Some((&[f64::NEG_INFINITY][..], &[1.0][..]));
    for (end, u, missing) in [(3.0, -2.0, 0.0), (1.0, -1.0, 1.0)] {
        let limits = Limits { low: &[-end], high: &[end], states, ..Limits::default() };
        let mean = least_mean(&one, limits, None, 1, &stop).unwrap();
        let few = of_few(&one, limits, (true, 0), None, 1, &stop).unwrap();
        for (control, lacks) in [(mean.control, mean.missing), (few.control, few.missing)] {
            assert!((control[0] - u).abs() < 1e-5 && (lacks - missing).abs() < 1e-9, "{control:?} {lacks}");
        }
    }
}

/// Some of these ended in a panic, the others in an optimum of something else.
#[test]
fn units_that_do_not_fit_are_refused_by_every_function() {
    let (zeros, stop) = ([0.0; 2], Stop::new());
    let right = scalar(&[1.0, 2.0], &zeros);
    let limits = Limits { low: &[-1.0], high: &[1.0], ..Limits::default() };
    for (name, wrong) in [
        ("A", Units { a: &[0.0], ..right }),
        ("B", Units { b: &[1.0], ..right }),
        ("c", Units { c: &[1.0], ..right }),
        ("x0", Units { x0: &[0.0; 3], ..right }),
        ("reference", Units { reference: &[], ..right }),
        ("A", Units { n: 0, ..right }),
        ("B", Units { b: &[1.0, f64::NAN], ..right }),
    ] {
        let run = (1, Until::new(&stop, None));
        let errors = [
            worst(&wrong, limits, (&[false; 2], &[]), run).map(drop),
            least_mean(&wrong, limits, None, 1, &stop).map(drop),
            misses(&wrong, limits, &[0.5], 1, &stop).map(drop),
        ];
        for error in errors {
            let error = error.unwrap_err().to_string();
            assert!(error.contains(&format!("`{name}`")), "{name}: {error}");
        }
    }
    assert!(misses(&right, limits, &[], 1, &stop).is_err());
}
