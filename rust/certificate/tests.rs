use std::sync::Arc;

use super::*;
use crate::matrix::MatrixView;
use crate::parallel::Stop;
use crate::region::tests::round;
use crate::region::{Part, PartOf, Region};

/// Components have room for the rounding of singular values.
fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 5e-12 * expected.abs().max(1e-3), "{found} is not {expected}");
}

/// One state, one input.
fn scalar(white: &[f64], missing: &[f64], factor: f64, frobenius: Option<f64>, future: bool) -> Region {
    let of = PartOf {
        rows: &[0],
        columns: &[0, 1],
        white: MatrixView::of(white, 2),
        root: (&[[10.0, 0.0], [0.0, 5.0]]).into(),
        missing: MatrixView::new(missing, 2, missing.len() / 2).ok(),
        ratio: 1.0,
        shape: (&[[0.25]]).into(),
        factor,
    };
    Region::new(&[[0.8, 1.0]], 1, vec![Arc::new(Part::new(of).unwrap())], frobenius, future).unwrap()
}

const WHITE: [f64; 4] = [0.1, 0.0, 0.0, 0.2];

/// Everything in closed form.
#[test]
fn a_scalar_system() {
    let (a, s) = (0.8, 0.5);
    let region = scalar(&WHITE, &[], 2.25, None, false);
    let found = trajectory(&region, &[2.0], &[1.0, -1.0], 0.0, None, (false, &Stop::new())).unwrap();
    let states = [2.0, 2.6, 0.8 * 2.6 - 1.0];
    let sizes = [(0.04f64 + 0.04).sqrt()];
    // ||a c_0 + c_1|| with c_0 = (0.2, 0.2) and c_1 = (0.26, -0.2)
    let first = [0.0, 1.5 * s * sizes[0], 1.5 * s * (a * 0.2 + 0.26f64).hypot(a * 0.2 - 0.2)];
    let b1 = 0.1 * first[1];
    (0..3).for_each(|k| near(found.states[k], states[k]));
    (0..3).for_each(|k| near(found.linear[k], first[k]));
    near(found.rest[1], b1);
    near(found.radii[2], first[2] + 1.5 * s * b1);
    near(found.components()[0], found.radii[2]);
    // an uncertain start is multiplied by |a| each step, and seen through the model's error
    let moved = trajectory(&region, &[2.0], &[1.0], 0.3, None, (false, &Stop::new())).unwrap();
    near(moved.radii[1], first[1] + a * 0.3 + 1.5 * s * 0.1 * 0.3);
    // noise of known size adds to one step, and joins the radii of several
    let noise = Some(ToCome::Sized { radius: 2.0, root: &[0.5] });
    let one = trajectory(&region, &[2.0], &[1.0], 0.0, noise, (false, &Stop::new())).unwrap();
    near(one.radii[1], first[1] + 1.0);
    near(one.components()[0], first[1] + 1.0);
    let two = trajectory(&region, &[0.0], &[0.0, 0.0], 0.0, noise, (false, &Stop::new())).unwrap();
    // lin_k = 2.5 s ||(a, 1)|| over two columns of noise, b_1 = 2.5 s / 10
    near(two.linear[2], 2.5 * s * a.hypot(1.0));
    near(two.radii[2], two.linear[2] + 2.5 * s * 2.5 * s * 0.1);
    // noise that the region covers is one more coordinate
    let with = scalar(&WHITE, &[], 2.25, None, true);
    let found = trajectory(&with, &[2.0], &[1.0], 0.0, None, (false, &Stop::new())).unwrap();
    near(found.radii[1], 1.5 * s * sizes[0].hypot(1.0));
    // Gaussian noise: a quantile of its own
    let root = [0.5];
    let noise = Some(ToCome::Gaussian(Gaussian { root: &root, end: 0.05, before: 0.01 }));
    let found = trajectory(&region, &[2.0], &[1.0], 0.0, noise, (false, &Stop::new())).unwrap();
    assert!((found.radii[1] - first[1] - 0.5 * 1.959963984540054).abs() < 1e-9);
    let endless = Some(ToCome::Gaussian(Gaussian { root: &[f64::INFINITY], end: 0.05, before: 0.01 }));
    let found = trajectory(&region, &[2.0], &[1.0], 0.0, endless, (false, &Stop::new())).unwrap();
    assert_eq!((found.radii[1], found.components()[0]), (f64::INFINITY, f64::INFINITY));
}

#[test]
fn what_the_data_do_not_show_is_infinite() {
    let region = scalar(&[0.1, 0.0], &[0.0, 1.0], 1.0, Some(1.0), false); // nothing is known of B
    let found = trajectory(&region, &[1.0], &[0.0, 1.0], 0.0, None, (false, &Stop::new())).unwrap();
    assert!(found.radii[1].is_finite() && found.radii[2] == f64::INFINITY);
    assert_eq!(found.components(), [f64::INFINITY]);
    // squares that overflow, and states that do
    let region = scalar(&WHITE, &[], 1.0, None, false);
    let found = trajectory(&region, &[1e300], &[0.0], 1e300, None, (false, &Stop::new())).unwrap();
    assert_eq!(found.states[0], 1e300);
    assert!(trajectory(&region, &[1e308], &[1e308], 0.0, None, (false, &Stop::new())).is_err());
}

/// Rows of their own: two copies of a scalar system, each with the error of its own, and their norm.
#[test]
fn parts_of_single_rows() {
    let part = |row: usize| {
        let of = PartOf {
            rows: &[row],
            columns: &[row, 2],
            white: MatrixView::of(&WHITE, 2),
            root: (&[[10.0, 0.0], [0.0, 5.0]]).into(),
            missing: None,
            ratio: 1.0,
            shape: (&[[0.25]]).into(),
            factor: 2.25,
        };
        Arc::new(Part::new(of).unwrap())
    };
    let centre = [[0.8, 0.0, 1.0], [0.0, 0.8, 1.0]];
    let region = Region::new(&centre, 1, vec![part(1), part(0)], None, false).unwrap();
    let found = trajectory(&region, &[2.0, 2.0], &[1.0, -1.0], 0.01, None, (false, &Stop::new())).unwrap();
    let c = [0.75 * (0.04f64 + 0.04).sqrt(), 0.75 * (0.26f64 * 0.26 + 0.04).sqrt()];
    let s = 0.75 * 0.1; // |D_x e|_i <= s ||e||
    let first = 0.01 * s + c[0] + 0.01 * 0.8;
    // the same with norms throughout: ||A|| rho0 + ||c|| + ||s|| rho0
    let r1 = (first * 2f64.sqrt()).min(0.008 + c[0] * 2f64.sqrt() + 0.01 * s * 2f64.sqrt());
    near(found.radii[1], r1);
    let second = 0.8 * (c[0] + 0.01 * s) + c[1] + r1 * s + 0.01 * 0.64;
    let pushes = (c[0] + 0.01 * s) * 0.8 + c[1] + r1 * s;
    let r2 = (second * 2f64.sqrt()).min(0.0064 + pushes * 2f64.sqrt());
    near(found.radii[2], r2);
    (0..2).for_each(|i| near(found.components()[i], second.min(r2)));
    let noise = Some(ToCome::Sized { radius: 1.0, root: &[0.1, 0.0, 0.0, 0.0] });
    let noisy = trajectory(&region, &[2.0, 2.0], &[1.0], 0.0, noise, (false, &Stop::new())).unwrap();
    near(noisy.components()[0], c[0] + 0.1);
    near(noisy.components()[1], c[0]);
}

#[test]
fn a_plan_takes_the_best_of_all_ways() {
    let (wide, narrow) = (scalar(&WHITE, &[], 2.25, None, false), scalar(&WHITE, &[], 1.0, None, false));
    let way = |region| Way { region, inputs: &[1.0], to_come: None, compares: true };
    let (x0, xf, predicted) = ([2.0], [3.0], [2.0, 2.5]);
    let task = Endpoints { x0: &x0, rho0: 0.0, xf: &xf, predicted: &predicted };
    let found = certify(task, &[way(&wide), way(&narrow)], None, (true, &Stop::new())).unwrap();
    let radius = 0.5 * 0.08f64.sqrt();
    assert_eq!(found.best, 1);
    near(found.reach, 0.5);
    near(found.target, 0.4 + radius);
    near(found.tube[1], radius + 0.1); // around what was predicted, not where the centre leads
    near(found.components[0], 0.4 + radius);
    near(found.bands[0], 0.0);
    near(found.bands[1], radius + 0.1);
    assert_eq!((found.start, found.tube[0]), (0.0, 0.0));
    near(found.model_error, radius - 0.1);
    // eB = .5 * .2: (||D z|| + (|r| + eB |r|) / (1 - eB)) / (1 - eB)
    let Some(ControlError::Within(control)) = found.control else { panic!("{:?}", found.control) };
    near(control, (radius + 0.4 * 1.1 / 0.9) / 0.9);
    // an uncertain start is told apart
    let found = certify(Endpoints { rho0: 0.1, ..task }, &[way(&wide)], None, (true, &Stop::new())).unwrap();
    near(found.model_error, 1.5 * radius - 0.1);
    near(found.start, 0.8 * 0.1 + 0.75 * 0.1 * 0.1);
    near(found.target, found.reach + found.model_error + found.start);
    // a region of all steps at once: x(2) = a x(0) + b0 u(0) + b1 u(1)
    let direct = Region::new(&[[0.64, 0.8, 1.0]], 2, vec![round(&[0], &[0, 1, 2], 1.0)], None, false).unwrap();
    let way = Way { region: &direct, inputs: &[1.0, 1.0], to_come: None, compares: true };
    let task = Endpoints { predicted: &[2.0, 2.6, 3.08], ..task };
    let found = certify(task, &[way], None, (true, &Stop::new())).unwrap();
    assert_eq!((found.tube[0], found.tube[1], found.control), (0.0, f64::INFINITY, Some(ControlError::Many)));
    near(found.tube[2], 6f64.sqrt());
    let blurred = scalar(&[0.1, 0.0, 0.0, 4.0], &[], 1.0, None, false);
    let way = Way { region: &blurred, inputs: &[1.0], to_come: None, compares: true };
    let task = Endpoints { predicted: &[2.0, 2.6], ..task };
    assert_eq!(certify(task, &[way], None, (true, &Stop::new())).unwrap().control, Some(ControlError::NoEffect));
    assert!(certify(task, &[], None, (true, &Stop::new())).is_err());
}
