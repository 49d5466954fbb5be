use std::sync::Arc;

use super::*;
use crate::Stop;
use crate::identify::{Assumed, Covariance, Data, Design, Estimate, Magnitudes, Noise, Wish, f_upper, triangle};
use crate::matrix::MatrixView;

/// A part with V = I and S = I: `||D z|| <= sqrt(factor) ||z||`.
pub(crate) fn round(rows: &[usize], columns: &[usize], factor: f64) -> Arc<Part> {
    let eye = |n: usize| (0..n * n).map(|at| f64::from(u8::from(at % (n + 1) == 0))).collect::<Vec<_>>();
    let (white, shape) = (eye(columns.len()), eye(rows.len()));
    let (white, shape) = (MatrixView::of(&white, columns.len()), MatrixView::of(&shape, rows.len()));
    let of = PartOf { rows, columns, white, root: white, missing: None, ratio: 1.0, shape, factor };
    Arc::new(Part::new(of).unwrap())
}

/// V = diag(4, 16), S = diag(1, 4): everything in closed form.
fn region(factor: f64, by_rows: bool) -> Region {
    let (white, root) = ((&[[0.5, 0.0], [0.0, 0.25]]).into(), (&[[2.0, 0.0], [0.0, 4.0]]).into());
    let part = |rows: &[usize], shape: &[f64]| {
        let shape = MatrixView::of(shape, rows.len());
        let of = PartOf { rows, columns: &[0, 1], white, root, missing: None, ratio: 1.0, shape, factor };
        Arc::new(Part::new(of).unwrap())
    };
    let parts =
        if by_rows { vec![part(&[1], &[4.0]), part(&[0], &[1.0])] } else { vec![part(&[0, 1], &[1.0, 0.0, 0.0, 4.0])] };
    // the last column, that of the input, is known
    Region::new(&[[0.5, 1.0, 0.0], [0.1, 0.2, 7.0]], 1, parts, None, false).unwrap()
}

fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-14 * expected.abs(), "{found} is not {expected}");
}

#[test]
fn bounds_of_one_step() {
    let z = [2.0, 4.0, 5.0]; // ||z|| = sqrt(1 + 1)
    let one = region(0.09, false);
    near(one.radius(), 0.6);
    near(one.bound(&z, false).unwrap(), 0.6 * 2f64.sqrt());
    near(one.bound(&z, true).unwrap(), 0.6 * 3f64.sqrt());
    let found = one.component_bounds(&z).unwrap();
    near(found[0], 0.3 * 2f64.sqrt());
    near(found[1], 0.6 * 2f64.sqrt());
    let rows = region(0.09, true);
    near(rows.radius(), 0.45f64.sqrt());
    assert_eq!(rows.component_bounds(&z).unwrap(), found);
    near(rows.bound(&z, false).unwrap(), 0.9f64.sqrt());
    for both in [&one, &rows] {
        let entries = both.entry_bounds().unwrap();
        [0.15, 0.075, 0.0, 0.3, 0.15, 0.0].iter().zip(&entries).for_each(|(e, f)| near(*f, *e));
        near(both.spread(0, 2).unwrap(), both.radius() * 0.5);
        near(both.spread(1, 2).unwrap(), both.radius() * 0.25);
        assert_eq!(both.spread(2, 3).unwrap(), 0.0);
        assert_eq!(both.bound(&[0.0, 0.0, 3.0], false).unwrap(), 0.0);
    }
    assert!(one.bound(&z[..2], false).is_err());
}

#[test]
fn models_inside_and_outside() {
    for by_rows in [false, true] {
        let region = region(0.09, by_rows);
        let moved = |by: [f64; 3], second: [f64; 3]| {
            let mut theta = region.centre.clone();
            by.iter().chain(&second).zip(&mut theta).for_each(|(by, to)| *to += by);
            region.holds(&theta).unwrap()
        };
        assert!(moved([0.0; 3], [0.0; 3]));
        assert!(moved([0.149, 0.0, 0.0], [0.0; 3]) && !moved([0.151, 0.0, 0.0], [0.0; 3]));
        assert!(moved([0.0; 3], [0.0, 0.149, 0.0]) && !moved([0.0; 3], [0.0, 0.151, 0.0]));
        // both at once only where the rows are judged apart
        assert_eq!(moved([0.149, 0.0, 0.0], [0.299, 0.0, 0.0]), by_rows);
        assert!(!moved([0.0; 3], [0.0, 0.0, 1e-6])); // the known entry
        assert!(region.contains(&[[f64::NAN; 3]; 2]).is_ok_and(|inside| !inside));
        assert!(region.contains(&[[0.0; 2]; 2]).is_err() && region.contains(&[[0.0; 2]; 3]).is_err());
    }
    // no size at all: the centre alone; an infinite one: all
    let same = region(0.0, false);
    assert!(same.holds(&same.centre).unwrap());
    let mut other = same.centre.clone();
    other[0] += 1e-9;
    assert!(!same.holds(&other).unwrap() && region(f64::INFINITY, false).holds(&other).unwrap());
}

#[test]
fn what_the_data_do_not_determine() {
    let across = [[0.5f64.sqrt()], [0.5f64.sqrt()]];
    let of = PartOf {
        rows: &[0],
        columns: &[0, 1],
        white: (&[[0.5, -0.5]]).into(),
        root: (&[[1.0, -1.0]]).into(),
        missing: Some((&across).into()),
        ratio: 1.0,
        shape: (&[[1.0]]).into(),
        factor: 1.0,
    };
    let part = Part::new(of).unwrap();
    assert_eq!(part.length(&[1.0, -1.0]), 1.0);
    assert_eq!(part.length(&[1e200, -1e200]), 1e200);
    assert_eq!(part.length(&[1.0, 0.0]), f64::INFINITY);
    assert_eq!(part.length(&[1.0, -1.0 + 1e-9]), f64::INFINITY);
    assert_eq!((part.length(&[0.0; 2]), part.rank()), (0.0, 1));
    let region = Region::new(&[[0.0, 0.0]], 1, vec![Arc::new(part)], None, false).unwrap();
    assert_eq!(region.spread(0, 1).unwrap(), f64::INFINITY);
    assert_eq!(region.projection((0, 0), (0, 1)).unwrap(), None);
    assert!(Part::new(PartOf { factor: f64::NAN, ..of }).is_err());
    // as many entries as the right ones have, or others
    let (row, column) = ((&[[0.5, -0.5]]).into(), (&[[0.5], [-0.5]]).into());
    let shapes = [
        ("white", PartOf { white: column, ..of }, "any x 2", "2 x 1"),
        ("root", PartOf { root: column, ..of }, "any x 2", "2 x 1"),
        ("missing", PartOf { missing: Some(row), ..of }, "2 x any", "1 x 2"),
        ("S", PartOf { shape: row, ..of }, "1 x 1", "1 x 2"),
    ];
    for (name, of, expected, found) in shapes {
        let why = Part::new(of).unwrap_err().to_string();
        assert_eq!(why, format!("`{name}` must have {expected} entries, got {found}"));
    }
    for (centre, found) in [(column, "2 x 1"), (MatrixView::of(&[0.0; 4], 4), "1 x 4")] {
        let why = Region::new(centre, 1, Vec::new(), None, false).unwrap_err().to_string();
        assert!(why.starts_with("`centre`") && why.ends_with(found), "{why}");
    }
}

/// In one row the projection is an ellipse, by rows a box; the polygon is around both, and touches them.
#[test]
fn projections() {
    let one = region(0.09, false).projection((0, 0), (0, 1)).unwrap().unwrap();
    assert_eq!(one.len(), 2 * DIRECTIONS);
    for corner in one.chunks_exact(2) {
        let size = (corner[0] / 0.15).hypot(corner[1] / 0.075);
        assert!((1.0..1.0001).contains(&size), "{size}");
    }
    let rows = region(0.09, true).projection((0, 0), (1, 1)).unwrap().unwrap();
    let largest = |at: usize| rows.iter().skip(at).step_by(2).fold(0.0f64, |m, v| m.max(v.abs()));
    assert!((largest(0) - 0.15).abs() < 1e-12 && (largest(1) - 0.15).abs() < 1e-12);
    assert_eq!(region(0.09, true).projection((0, 0), (0, 2)).unwrap(), None); // known
}

/// Pairs (x, u, y) of `y = x / 2 + u + w`.
fn estimate(known: Option<&[f64]>) -> Estimate {
    let row = |k: f64| (k.cos(), (1.7 * k).sin(), 0.01 * (2.9 * k).sin());
    let rows: Vec<f64> = (0..40).map(|k| row(f64::from(k))).flat_map(|(x, u, w)| [x, u, x / 2.0 + u + w]).collect();
    let triangle = triangle(&rows, 3, 1, &Stop::new()).unwrap();
    let of = Data { triangle: &triangle, size: 40, n: 1, m: 1, offset: false, known };
    Estimate::new(of, &Stop::new()).unwrap()
}

#[test]
fn pairs_are_the_rows_of_a_triangle() {
    let known = estimate(None);
    let at = |of: fn(f64) -> f64| -> [[f64; 1]; 40] { std::array::from_fn(|k| [of(k as f64)]) };
    let (x, u) = (at(f64::cos), at(|k| (1.7 * k).sin()));
    let y = at(|k| k.cos() / 2.0 + (1.7 * k).sin() + 0.01 * (2.9 * k).sin());
    let found = Estimate::from_pairs(&x, &u, &y, 1, &Stop::new()).unwrap();
    assert_eq!(format!("{found:?}"), format!("{known:?}"));
    assert_eq!(found.theta().row(0), Some(&known.model[..]));
    // one row less, a column more, nothing at all
    assert!(Estimate::from_pairs(&x, &u[1..], &y, 1, &Stop::new()).is_err());
    assert!(Estimate::from_pairs(&x, &u, &[[0.0; 2]; 40], 1, &Stop::new()).is_err());
    let nothing: &[[f64; 0]] = &[[]; 40];
    assert!(Estimate::from_pairs(nothing, &u, nothing, 1, &Stop::new()).is_err());
    assert!(Estimate::from_pairs(&x, nothing, &y, 1, &Stop::new()).is_err());
}

fn made(known: Option<&[f64]>, design: Design, wish: Wish<'_>) -> crate::Result<Region> {
    let assumed = Assumed { design, noise: Noise::Gaussian, covariance: Covariance::Full, tail: 0.0 };
    Region::from_data(&estimate(known), assumed, wish, Magnitudes::Expected(&[1.0, 1.0]), 1, &Stop::new())
}

#[test]
fn one_row_of_an_independent_design_has_the_law_of_f() {
    let region = made(None, Design::Independent, Wish::new(0.05)).unwrap();
    let part = region.parts()[0].of();
    assert!((part.factor - 2.0 / 38.0 * f_upper(0.05, 2.0, 38.0).unwrap()).abs() < 1e-13);
    assert!(region.contains(&[[0.5, 1.0]]).unwrap() && !region.contains(&[[0.6, 1.0]]).unwrap());
    // one entry is known: one column of G
    let region = made(Some(&[0.5, f64::NAN]), Design::Independent, Wish::new(0.05)).unwrap();
    assert_eq!((region.centre()[0], region.parts()[0].of().columns), (0.5, &[1][..]));
    assert!((region.parts()[0].of().factor - f_upper(0.05, 1.0, 39.0).unwrap() / 39.0).abs() < 1e-13);
    // all of them: a region of one model
    let region = made(Some(&[0.5, 1.0]), Design::Independent, Wish::new(0.05)).unwrap();
    assert!(region.contains(&[[0.5, 1.0]]).unwrap() && !region.contains(&[[0.5, 1.1]]).unwrap());
}

#[test]
fn directions_take_what_spans_them() {
    let whole = made(None, Design::Independent, Wish::new(0.05)).unwrap();
    let wish = Wish { directions: Some(&[1.0, 0.0]), ..Wish::new(0.05) };
    let along = made(None, Design::Independent, wish).unwrap();
    assert!(along.bound(&[2.0, 0.0], false).unwrap() < whole.bound(&[2.0, 0.0], false).unwrap());
    assert!(along.bound(&[2.0, 0.1], false).unwrap().is_infinite());
}

#[test]
fn no_region_is_made_up() {
    let refused = |design, wish| made(None, design, wish).is_err();
    assert!(refused(Design::Independent, Wish::new(0.0)) && refused(Design::Independent, Wish::new(f64::NAN)));
    let future = Wish { future: 1, ..Wish::new(0.05) };
    assert!(refused(Design::Adaptive, future) && !refused(Design::Independent, future));
    assert!(refused(Design::Independent, Wish { components: true, ..future }));
    let one = Wish { directions: Some(&[1.0]), ..Wish::new(0.05) };
    assert!(refused(Design::Independent, one) && refused(Design::Adaptive, one));
    let assumed =
        Assumed { design: Design::Adaptive, noise: Noise::SubGaussian, covariance: Covariance::Full, tail: 0.0 };
    let found = Region::from_data(
        &estimate(None),
        assumed,
        Wish::new(0.05),
        Magnitudes::Expected(&[1.0, 1.0]),
        1,
        &Stop::new(),
    );
    assert!(found.is_err()); // a size that bounds the noise must be known
}

/// It made the bias nan, and with it every later call.
#[test]
fn a_reading_that_is_no_number_is_missing() {
    use crate::window::{Filter, Kind, Window};
    let window = Window::new(1, 1, Kind::Lags(1), 0, false, 0).unwrap();
    let theta = [[0.9, 0.5]];
    let of = || {
        let filter = Filter::new(window, &theta, &[[0.01]], &[0.0], &[1.0, 1.0]).unwrap();
        let bias = Bias::learned(&[[0.5]], &[0.1], &[[0.01]]).unwrap();
        let aim = Aim { of_bias: vec![-2.0], limits: [vec![0.0], vec![-1.0], vec![1.0]] };
        Readings::new(filter, &theta, None, bias, aim, 3).unwrap()
    };
    let run = |lost: f64, seen: bool| {
        let (mut readings, mut bias) = (of(), vec![0.0]);
        for k in 0..9 {
            let (y, seen) = if k == 5 { (lost, seen) } else { (0.1 * k as f64, true) };
            let step = readings.step(&[y], &[seen], &[0.2], &bias, k > 2).unwrap();
            bias = step.bias.clone();
            assert!(!step.lost && bias[0].is_finite(), "{k} {bias:?}");
        }
        bias
    };
    assert_eq!(run(f64::NAN, true), run(0.0, false));
    assert_eq!(run(f64::INFINITY, true), run(0.0, false));
    let mut readings = of();
    assert!(readings.step(&[0.0], &[true], &[f64::NAN], &[0.0], true).is_err());
    assert!(readings.step(&[0.0], &[true], &[0.0], &[f64::NAN], true).is_err());
    assert!(readings.step(&[0.0], &[], &[0.0], &[0.0], true).unwrap_err().to_string().contains("`seen`"));
    assert!(readings.start(&[]).is_err() && readings.start(&[f64::NAN]).is_err());
}
