use std::sync::Arc;

use super::*;
use crate::Stop;
use crate::region::{Part, PartOf, Region};

/// Around `[A B]` with `V = I` and `S = I`.
fn round(centre: &[f64], n: usize, m: usize, rho: f64) -> Region {
    let d = n + m;
    let eye = |k: usize| (0..k * k).map(|at| f64::from(u8::from(at / k == at % k))).collect::<Vec<_>>();
    let (rows, columns) = ((0..n).collect::<Vec<_>>(), (0..d).collect::<Vec<_>>());
    let (white, shape) = (eye(d), eye(n));
    let of = PartOf {
        rows: &rows,
        columns: &columns,
        white: &white,
        root: &white,
        missing: &[],
        ratio: 1.0,
        shape: &shape,
        factor: rho * rho,
    };
    Region::new(centre, n, m, vec![Arc::new(Part::new(of).unwrap())], None, false).unwrap()
}

fn near(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() <= within * expected.abs(), "{found} is not {expected}");
}

/// One state: `Q` is a root of `e2 q^2 - (1 - a0^2 + e2 rho^2) q + rho^2 = 0`, `g = sqrt(1 + K^2) / (1 - |a + b K|)`.
#[test]
fn one_state() {
    let region = round(&[1.2, 1.0], 1, 1, 0.3);
    let found = Loop::new(&region, &[-0.9], &Stop::new()).unwrap();
    let one = found.certificate();
    assert_eq!(one.status, Status::Certified);
    near(one.least, 0.3 * 1.81f64.sqrt() / 0.7, 1e-7); // rho is widened by 1e-8
    assert!(one.norm >= one.least && one.norm <= one.least * 1.002);
    let q = found.invariant(&[0.0], 1.0, 1.0, Some(0.0)).unwrap().unwrap();
    near(q[0] * q[0], 0.101142725470413, 1e-6); // its root
    for (by, status) in [(0.999, Status::Certified), (1.001, Status::Refuted)] {
        let region = round(&[1.2, 1.0], 1, 1, by * 0.7 / 1.81f64.sqrt());
        assert_eq!(Loop::new(&region, &[-0.9], &Stop::new()).unwrap().certificate().status, status);
    }
}

#[test]
fn widest_margins_of_one_state() {
    for (centre, most) in
        [([1.2, 1.0], 0.640184399664), ([0.5, 1.0], 0.894427190999916), ([0.9, 0.1], 0.14142135623731)]
    {
        let found = widest(&round(&centre, 1, 1, 0.01), &Stop::new()).unwrap();
        near(0.01 * found.parameter, most, 1e-3);
        let (margin, k) = (|k: f64| (1.0 - (centre[0] + centre[1] * k).abs()) / k.hypot(1.0), found.gain[0]);
        assert!(margin(k) > 0.9 * most && margin(k) < most * (1.0 + 1e-9), "{k}");
    }
}

/// A recursion that jumps over horizons without a solution and converges all the same.
#[test]
fn traps_are_refused() {
    let found = widest(&round(&[1.5, 0.3], 1, 1, 0.45), &Stop::new()).unwrap();
    near(0.45 * found.parameter, 1.0 / 26f64.sqrt(), 1e-3);
    let found = widest(&round(&[1.5, 0.6, -0.4, 0.9, -1.5, 1.0], 2, 1, 0.4), &Stop::new()).unwrap();
    assert!(found.parameter < 1.0);
    assert!(guaranteed(&round(&[1.5, 0.3], 1, 1, 0.45), &[1.0], &[1.0], None, &Stop::new()).is_err());
}

/// One state at the set point 1: `rho / .7 |(1, us)| / (1 - rho g)`, as `1.2 + us = 1`.
#[test]
fn rests_of_one_state() {
    let found = Loop::new(&round(&[1.2, 1.0], 1, 1, 0.3), &[-0.9], &Stop::new()).unwrap();
    let (rows, radius) = found.rest(&[1.0], &[-0.2]).unwrap();
    let expected = 0.3 / 0.7 * 1.04f64.sqrt() / (1.0 - 0.3 * 1.81f64.sqrt() / 0.7);
    near(rows[0], expected, 1e-5);
    near(rows[1], 0.9 * expected, 1e-5);
    assert!(radius >= expected && rows[0] >= expected);
    assert!(found.rest(&[1.0, 0.0], &[-0.2]).is_err());
}

/// Limits so wide that nothing lacks, and so narrow that noise alone is too much.
#[test]
fn plans_are_accepted_within_limits_only() {
    let found = Arc::new(Loop::new(&round(&[1.2, 1.0], 1, 1, 0.1), &[-0.9], &Stop::new()).unwrap());
    for (limit, accepted) in [(10.0, true), (0.5, false)] {
        let sides = ([f64::NEG_INFINITY, -limit], [f64::INFINITY, limit]);
        let keeper = Keeper::new(Arc::clone(&found), (&sides.0, &sides.1), &[0.01], 0.05, 50).unwrap().unwrap();
        let judged = keeper.judge(&[1.0], &[-0.4, -0.2], false, &Stop::new()).unwrap();
        let sharp = keeper.judge(&[1.0], &[-0.4, -0.2], true, &Stop::new()).unwrap();
        assert_eq!(judged.short.is_none(), accepted);
        assert!(sharp.model[1] <= judged.model[1] * (1.0 + 1e-5));
        // u(1) = -.2 + K (x - xb), xb = 1.2 - .4
        near(keeper.follow(&[1.0], &[-0.4, -0.2], 1, &[1.0]).unwrap()[0], -0.2 - 0.9 * 0.2, 1e-9);
    }
}
