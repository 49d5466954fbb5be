//! Numbers of an exact small case, computed by other code.

use std::sync::Arc;

use super::*;
use crate::matrix::MatrixView;
use crate::memory::tests::counted;
use crate::region::{Part, PartOf, Region};
use crate::window::{Kind, Window};

const CENTRE: [f64; 6] = [0.9, 0.2, 0.0, -0.1, 0.8, 1.0];
const SBAR: [[f64; 2]; 2] = [[0.09, 0.01], [0.01, 0.04]];

fn z(t: i64) -> [f64; 3] {
    [0, 1, 2].map(|i| ((2 * i + 1) * (t + 1) * (t + 1) % 11 - 5) as f64)
}

fn y(theta: &[f64; 6], t: i64) -> [f64; 2] {
    let w = [0, 1].map(|i: i64| (((i + 3) * (t + 2) * (t + 2)).rem_euclid(13) - 6) as f64 / 20.0);
    let z = z(t);
    [0, 1].map(|i| (0..3).map(|j| theta[3 * i + j] * z[j]).sum::<f64>() + w[i])
}

/// The changed system: the gain of the input on the second row is .9.
fn changed() -> [f64; 6] {
    let mut theta = CENTRE;
    theta[5] = 0.9;
    theta
}

/// The region around C with V of the twelve pairs, or with another `white` and `root`.
fn region(of: Option<[f64; 9]>) -> Region {
    let mut v = [0.0; 9];
    for t in 0..12 {
        (0..9).for_each(|at| v[at] += z(t)[at / 3] * z(t)[at % 3]);
    }
    let l = crate::identify::cholesky(&v, 3).unwrap().unwrap(); // V = L L': root = L', white = L^-1
    let mut white = [0.0; 9];
    for j in 0..3 {
        for i in j..3 {
            let done: f64 = (j..i).map(|k| l[3 * i + k] * white[3 * k + j]).sum();
            white[3 * i + j] = (f64::from(u8::from(i == j)) - done) / l[4 * i];
        }
    }
    let mut root = [0.0; 9];
    (0..9).for_each(|at| root[at] = l[at % 3 * 3 + at / 3]);
    if let Some(one) = of {
        (white, root) = (one, one);
    }
    let part = PartOf {
        rows: &[0, 1],
        columns: &[0, 1, 2],
        white: MatrixView::of(&white, 3),
        root: MatrixView::of(&root, 3),
        missing: None,
        ratio: 1.0,
        shape: (&[[0.02, 0.004], [0.004, 0.01]]).into(),
        factor: 1.0,
    };
    Region::new(MatrixView::of(&CENTRE, 3), 1, vec![Arc::new(Part::new(part).unwrap())], None, false).unwrap()
}

fn frame() -> Frame {
    Frame::new(&region(None), &SBAR, 12).unwrap()
}

/// The one bet of the oracles: on the gain of the input, .1 of it, in blocks of so many steps.
fn bank(frame: &Frame, steps: usize) -> Bank {
    let mut bank = Bank::new(frame, 2..3, false).unwrap();
    let at = bank.direction.iter().position(|direction| *direction == 2).unwrap();
    (bank.direction, bank.column) = (vec![2], vec![bank.column[at]]);
    (bank.unit, bank.whole) = (vec![bank.whole[at]], vec![bank.whole[at]]);
    (bank.shifts, bank.small, bank.blocks) = (vec![0.1], 1, [steps, 1000 * steps]);
    bank
}

fn near(found: f64, expected: f64, places: f64) {
    assert!((found - expected).abs() <= places * expected.abs().max(1.0), "{found:.12} is not {expected:.12}");
}

/// `h, x, p, v` of the bet at t, in units in which its direction has length 1 times `size`.
fn bet(t: i64) -> (Frame, f64, [f64; 4]) {
    let frame = frame();
    let (mut e, mut wz, mut h) = ([0.0; 2], [0.0; 3], [0.0]);
    assert!(frame.residual(&z(t), &y(&changed(), t), &mut e, &mut wz, &mut h));
    let bank = bank(&frame, 12);
    let (l, size) = (&bank.directions[2 * bank.direction[0]..][..2], bank.whole[0]);
    let g = -z(t)[2];
    let (x, p) = (g * (l[0] * e[0] + l[1] * e[1]), g.abs() * bank.spreads[bank.direction[0]] * h[0]);
    (frame, size, [h[0], size * x, size * p, size * size * g * g])
}

#[test]
fn the_direction_of_a_gain() {
    // O1: l = Sbar^-1 C e_3 = (-20/7, 180/7), l'Sbar l = 180/7
    let (_, size, _) = bet(1);
    near(size * size, 180.0 / 7.0, 1e-13);
    let bank = bank(&frame(), 12);
    near(size * bank.spreads[bank.direction[0]], 2.487_519_869_7, 2e-9);
}

#[test]
fn one_step_of_each_law() {
    // O2, O3, O4
    let (_, size, [h, x, p, v]) = bet(1);
    near(h, 0.541_211_174_5, 2e-9);
    near(x, 17.714_285_714, 1e-9);
    near(p, 5.385_094_201_5, 4e-9);
    near(v, 411.428_571_43, 1e-9);
    near(0.1 - p / v, 0.086_911_229_37, 1e-8);
    for (t, gaussian, variance) in [
        (1, -0.482_330_376_9, 0.035_304_647_5),
        (2, 4.069_186_523_4, 2.173_832_505_3),
        (3, 0.985_626_402, 0.871_173_355_5),
    ] {
        let (_, _, [_, x, p, v]) = bet(t);
        let a = (0.1 - p / v).max(0.0);
        near(Laws::Gaussian.factor(a, x, p, v).ln(), gaussian, 2e-8);
        near(Laws::Variance.factor(a, x, p, v).ln(), variance, 2e-8);
        // the same in units of the direction
        near(Laws::Variance.factor(a * size, x / size, p / size, v / size / size).ln(), variance, 2e-8);
    }
}

/// The evidence of the bet after each step, single and over blocks of 12.
fn watched(law: Laws, promise: Promise, null: Null, steps: usize) -> (Vec<f64>, Watch) {
    let frame = frame();
    let bank = bank(&frame, steps);
    let window = Window::new(2, 1, Kind::Lags(1), 0, false, 0).unwrap();
    let mut watch = Watch::new(frame, bank, (law, null), promise, window).unwrap();
    let mut found = vec![];
    for t in 0..12 {
        // a window of one lag begins anew at each pair
        watch.step(&[f64::NAN; 2], &[0.0]).unwrap();
        let [a, b, u] = z(t);
        watch.step(&[a, b], &[0.0]).unwrap();
        assert_eq!(watch.status(), "skipping");
        watch.step(&y(&changed(), t), &[u]).unwrap();
        assert_eq!(watch.counts().skipped, 0.0);
        found.push(watch.evidence().0[1]); // the second side: g = -e_3
    }
    (found, watch)
}

#[test]
fn evidence_over_all_starts() {
    // O5, O6
    let huge = Promise::Every(1e14);
    let (m, _) = watched(Laws::Gaussian, huge, Null::Constant, 12);
    for (t, expected) in
        [(0, 1.0), (1, 1.234_686_144_7), (2, 130.750_027_6), (3, 353.022_854_65), (11, 80_746.480_515_5)]
    {
        near(m[t], expected, 1e-7);
    }
    let (m, _) = watched(Laws::Variance, huge, Null::Constant, 12);
    for (t, expected) in [(1, 2.071_870_511_6), (2, 27.007_623_245), (3, 66.930_186_755), (11, 3_202.847_424_01)] {
        near(m[t], expected, 1e-7);
    }
    let (m, _) = watched(Laws::Gaussian, Promise::Ever(1e-14), Null::Constant, 12);
    for (t, expected) in [(0, 0.5), (1, 0.411_562_048_1), (2, 28.956_005_722), (11, 17_568.053_603_1)] {
        near(m[t], expected, 1e-7);
    }
}

#[test]
fn calls_allocate_nothing() {
    let (_, mut watch) = watched(Laws::Variance, Promise::Every(10.0), Null::Constant, 12);
    for t in 0..200 {
        let [a, b, u] = z(t % 12);
        let (_, bytes) = counted(|| {
            watch.step(&[a, b], &[0.0]).unwrap();
            watch.step(&y(&changed(), t % 12), &[u]).unwrap();
        });
        assert_eq!(bytes, 0, "{t}");
    }
    assert!(watch.counts().alarms > 0.0);
}

/// The evidence of the block.
fn block(watch: &Watch) -> f64 {
    let (evidence, begins) = watch.evidence();
    evidence[begins[1] + 1]
}

#[test]
fn a_block_of_twelve() {
    // O7: log e, and with the sum of the penalties of all steps
    let (xi, v, p, sum) = (256.142_857_14, 2_545.714_285_71, 24.750_510_199, 37.003_263_078);
    let (_, watch) = watched(Laws::Gaussian, Promise::Every(1e14), Null::Constant, 12);
    near(block(&watch).ln(), 10.410_663_266, 1e-7);
    near(0.1 * (xi - p) - 0.005 * v, 10.410_663_266, 1e-8);
    let (_, watch) = watched(Laws::Gaussian, Promise::Every(1e14), Null::Moving, 12);
    near(block(&watch).ln(), 0.1 * (xi - sum) - 0.005 * v, 1e-7);
    // `variance`, by the formula
    let (mut log, mut drift, mut squares) = (0.0, [0.0; 3], 0.0);
    let mut spread = 0.0;
    for t in 0..12 {
        let (frame, _, [h, x, _, v]) = bet(t);
        let s = 0.1 * x;
        let c = 1.0 + s.abs() + 0.5 * s * s;
        log += s.signum() * c.ln() - (0.005 * v).ln_1p();
        spread = 2.487_519_869_7;
        let g = -z(t)[2];
        squares += (g * h * spread).powi(2);
        for (to, row) in drift.iter_mut().zip(frame.white.chunks_exact(3)) {
            *to += (1.0 + s.abs()) / c * g * row.iter().zip(z(t)).map(|(a, b)| a * b).sum::<f64>();
        }
    }
    log -= 0.1 * spread * drift.iter().map(|v| v * v).sum::<f64>().sqrt() + 0.01 / 8.0 * squares;
    let (_, watch) = watched(Laws::Variance, Promise::Every(1e14), Null::Constant, 12);
    near(block(&watch).ln(), log, 1e-7);
}

#[test]
fn bets_of_a_size_in_absolute_units_are_none() {
    // O8: a t-type bet made only where the estimated variance is small, E over N(0, 1): why there are none
    let gamma = |half: usize| -> f64 {
        let odd = half % 2 == 1;
        let mut value = if odd { std::f64::consts::PI.sqrt() } else { 1.0 };
        let mut k = if odd { 1 } else { 2 };
        while k < half {
            value *= k as f64 / 2.0;
            k += 2;
        }
        value
    };
    let expected = |s2: f64, nu: usize| {
        // the ratio of the predictive t densities of scale 1.3 and 1, averaged over w ~ N(0, 1)
        let n = nu as f64;
        let t = |x: f64, c: f64| {
            let size = gamma(nu + 1) / gamma(nu) / (n * std::f64::consts::PI * s2).sqrt() / c;
            size * (1.0 + x * x / (n * s2 * c * c)).powf(-0.5 * (n + 1.0))
        };
        let h = 1e-3;
        (-20_000..=20_000).map(|k| f64::from(k) * h).fold(0.0, |sum, x| {
            sum + h * (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt() * t(x, 1.3) / t(x, 1.0)
        })
    };
    for (s2, nu, value) in
        [(0.1, 2, 1.225_983_243_8), (0.1, 5, 1.628_514_085_8), (1.0, 5, 0.935_865_974_6), (4.0, 5, 0.814_963_014_2)]
    {
        near(expected(s2, nu), value, 1e-9);
    }
}

#[test]
fn energy() {
    // O9
    let frame = frame();
    let (mut e, mut wz, mut h) = ([0.0; 2], [0.0; 3], [0.0]);
    assert!(frame.residual(&z(0), &y(&changed(), 0), &mut e, &mut wz, &mut h));
    let r = e[0].hypot(e[1]) - frame.norms[0] * h[0];
    near(r, 1.170_332_584_9, 5e-9);
    near(Laws::Gaussian.energy(0.6, r, 2).ln(), -0.505_387_224_1, 1e-8);
}

#[test]
fn the_fresh_set() {
    // O10: P = I, one kappa
    let own = Frame::new(&region(Some([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])), &SBAR, 1).unwrap();
    let mut fresh = Fresh::new(&own, Some(&[5.0])).unwrap();
    let mut of_data = Fresh::new(&frame(), None).unwrap();
    for t in 0..12 {
        let (mut e, mut wz, mut h) = ([0.0; 2], [0.0; 3], [0.0]);
        assert!(own.residual(&z(t), &y(&changed(), t), &mut e, &mut wz, &mut h));
        fresh.add(&own, &z(t), &e);
        of_data.add(&frame(), &z(t), &e);
    }
    let look = fresh.look(&own, 0.05, &[vec![0], vec![1], vec![2]]).unwrap();
    near(look.entries[0][5], 0.898_148_477_4, 1e-9);
    near(look.entries[1][5], 0.089_227_053_3, 1e-8);
    let old = of_data.look(&frame(), 0.05, &[]).unwrap().entries[2][5];
    near(old, 0.010_133_582_12, 1e-9);
    near(1.0 - look.entries[0][5] - look.entries[1][5] - old, 0.002_490_887_14, 3e-9);
    // what the set allows is the same in its own form: |l'(H - Theta) q| at l = e_2, q = e_3
    let size: f64 = look.allowed.0.chunks_exact(3).map(|row| row[2] * row[2]).sum::<f64>().sqrt();
    near((look.allowed.2 * 0.04).sqrt() * size, 0.089_227_053_3, 1e-8);
    for i in 0..9 {
        let (a, b) = (&look.allowed.0[i / 3 * 3..][..3], &look.allowed.1[i % 3 * 3..][..3]);
        near(a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>(), f64::from(u8::from(i / 3 == i % 3)), 1e-10);
    }
}

#[test]
fn the_test_of_two_logs() {
    // O11, O12
    let fitted = |times: std::ops::Range<i64>, twin: bool| {
        let size = times.end - times.start;
        let rows: Vec<f64> = times
            .flat_map(|t| {
                let ([a, b, mut c], _) = (z(t), ());
                let own = y(&CENTRE, t);
                if twin {
                    c = 2.0 * b;
                }
                // the readings of the changed regressors
                let [p, q] = own;
                let off = c - z(t)[2];
                [a, b, c, p + CENTRE[2] * off, q + CENTRE[5] * off]
            })
            .collect();
        let stop = crate::Stop::new();
        let triangle = crate::identify::triangle(&rows, 5, 1, &stop).unwrap();
        crate::identify::fit(&triangle, 5, 3, size as usize, 1, &stop).unwrap()
    };
    let stop = crate::Stop::new();
    let found = open_loop(&fitted(0..8, false), &fitted(8..12, false), 0.492, 1, &stop).unwrap();
    near(found.statistic, 1.127_521_840_5, 1e-9);
    assert_eq!(found.sizes, (3, 6));
    near(found.limit, found.statistic, 2e-3); // p = .492
    let found = open_loop(&fitted(0..8, false), &fitted(8..12, true), 0.159, 1, &stop).unwrap();
    near(found.statistic, 1.501_002_713_1, 1e-9);
    assert_eq!(found.sizes, (2, 7));
    near(found.limit, found.statistic, 4e-3);
}

#[test]
fn blocks_that_are_kept_are_no_detector() {
    // O13, by quadrature over w_1 + w_2 = s, the middle w_2, and w_3
    let normal = |x: f64| (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
    let h = 1e-3;
    let below: f64 = (-10_000..1500).map(|k| h * normal((f64::from(k) + 0.5) * h)).sum(); // Phi(1.5)
    near(6.0 * below, 5.599_156_792_4, 1e-6);
    near(5.0 - below, 4.066_807_201_3, 1e-6);
    let evidence: f64 = (-20_000..20_000)
        .map(|k| f64::from(k) * h)
        .map(|s| h * normal(s / 2f64.sqrt()) / 2f64.sqrt() * (3.0 * s - 9.0).exp())
        .sum();
    near(evidence, 1.0, 1e-9); // E e of a block
    // noise 1.5 times as large, per equation
    near(0.5 * (2.25 - 1.0 - 2.25f64.ln()), 0.219_534_891_9, 1e-10);
}

#[test]
fn columns_that_never_moved() {
    // O14: rank and what is undetermined
    let rows = [
        [20.0, 20.5, 21.0, 20.7, 20.2, 19.9],
        [18.0, 18.2, 18.1, 18.4, 18.6, 18.3],
        [1.0; 6],
        [0.6; 6],
        [5.0, 4.0, 3.0, 4.0, 5.0, 6.0],
    ];
    let pairs: Vec<f64> =
        (0..6).flat_map(|t| [rows[0][t], rows[1][t], rows[2][t], rows[3][t], rows[4][t], 0.1]).collect();
    let stop = crate::Stop::new();
    let triangle = crate::identify::triangle(&pairs, 6, 1, &stop).unwrap();
    let fitted = crate::identify::fit(&triangle, 6, 5, 6, 1, &stop).unwrap();
    assert_eq!(fitted.rank(), 4);
    let off: Vec<usize> = (0..5).filter(|j| fitted.missing[*j].abs() > 0.0).collect();
    assert_eq!(off, [2, 3]);
}

#[test]
fn each_bet_has_expectation_at_most_1() {
    // by quadrature, Gaussian noise: the largest l'(Theta - C) z is p
    for law in [Laws::Variance, Laws::Gaussian, Laws::Symmetric] {
        for (a, p, v) in [(0.3, 0.5, 1.0), (2.0, 0.1, 0.5), (0.8, 3.0, 4.0), (5.0, 0.0, 1.0)] {
            let (h, deviation) = (1e-3, f64::sqrt(v));
            let mean = |p: f64| {
                (-30_000..30_000).map(|k| f64::from(k) * h).fold(0.0, |sum, w| {
                    sum + h * (-0.5 * w * w).exp() / 2.506_628_274_631
                        * law.factor(a, deviation * w + p, p.min(0.1 + p), v)
                })
            };
            assert!(mean(p) <= 1.0 + 1e-9, "{law:?} {a} {p} {v}: {}", mean(p));
        }
        // without the penalty it is none
        let (h, mut mean) = (1e-3, 0.0);
        for k in -20_000..20_000 {
            let w = f64::from(k) * h;
            mean += h * (-0.5 * w * w).exp() / 2.506_628_274_631 * law.factor(0.5, w + 0.5, 0.0, 1.0);
        }
        assert!(mean > 1.05, "{law:?}: {mean}");
    }
    // two points at the bound of the variance: `variance` holds, `gaussian` does not
    let rare = |law: Laws| (0..2).map(|k| [0.99, 0.01][k] * law.factor(1.0, [-0.1005, 9.95][k], 0.0, 1.0)).sum::<f64>();
    assert!(rare(Laws::Variance) <= 1.0 && rare(Laws::Gaussian) > 50.0);
}

#[test]
fn a_watch_goes_on_bit_by_bit() {
    let run = |watch: &mut Watch, from: i64| {
        for t in from..from + 150 {
            let [a, b, u] = z(t);
            let v = if t % 17 == 0 { f64::NAN } else { a };
            watch.step(&[v, b], &[u]).unwrap();
        }
    };
    let new = || {
        let frame = frame();
        let bank = Bank::new(&frame, 2..3, false).unwrap();
        let window = Window::new(2, 1, Kind::Lags(1), 0, false, 0).unwrap();
        Watch::new(frame, bank, (Laws::Variance, Null::Constant), Promise::Every(100.0), window).unwrap()
    };
    let (mut one, mut other) = (new(), new());
    run(&mut one, 0);
    other.resume(&one.numbers().unwrap()).unwrap();
    run(&mut one, 150);
    run(&mut other, 150);
    let bits = |watch: &mut Watch| watch.numbers().unwrap().iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&mut one), bits(&mut other));
    assert!(one.counts().alarms > 0.0, "there were alarms");
    assert!(one.resume(&[0.0; 3]).is_err());
}

#[test]
fn rows_without_noise_of_their_own() {
    let rows = |noise: [[f64; 2]; 2]| Frame::new(&region(None), &noise, 12).map(|frame| frame.rows);
    assert_eq!(rows(SBAR).unwrap(), [0, 1]);
    assert_eq!(rows([[1e-40, 0.0], [0.0, 0.04]]).unwrap(), [1]); // rounding of the readings
    assert_eq!(rows([[0.09, 0.06], [0.06, 0.04]]).unwrap(), [0]); // 2/3 of the first row
    assert_eq!(rows([[0.04, 0.0], [0.0, -1.0]]).unwrap(), [0]);
    assert!(rows([[0.0; 2]; 2]).is_err());
    assert!(Frame::new(&region(None), &SBAR[..1], 12).is_err());
}
