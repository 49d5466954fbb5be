use super::sizes::{one_norm, unit_of};
use super::*;

const PROBLEM: Problem<'_> = Problem {
    a: &[2.0, 0.0, 0.0, 4.0],
    b: &[2.0, 0.0, 0.0, 1.0],
    x0: &[1.0, 1.0],
    xf: &[3.0, -1.0],
    rows: false,
    control: true,
    paired: false,
};

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{found} {expected}");
}

#[test]
fn lines_by_hand() {
    // g = 4, Cv = 3 [[1, 1], [1, 1]]; the line that is exact does not count
    let lines = Lines::new(&[3.0, -1.0, 0.0, 5.0], 2, Norm::Spectral).unwrap();
    let square = lines.unit * lines.unit;
    close(lines.mean_square * square, 6.0);
    close(lines.top * square, 6.0);
    close(lines.variance * square, 6.0);
    // 4 e_2 is (3, 3) from the mean
    close(lines.farthest * lines.unit, 18f64.sqrt());
    close(lines.hits * square, 32.0);
    assert_eq!(lines.sizes, (1, 2, 2));
    close(Lines::new(&[3.0, -1.0], 2, Norm::One).unwrap().farthest * 3.0, 6.0);
    let radius = lines.radius(Inequality::Weissman, 0.01, 2.0).unwrap();
    close(radius * lines.unit, 4.0 * (0.01 * (2f64.ln() + 2.0)).sqrt());
    assert!(lines.radius(Inequality::McDiarmid, 1.0, 1.0).is_none());
}

#[test]
fn the_largest_eigenvalue_is_that_of_the_covariance() {
    for line in [&[1.0, 1.0, 1.0, 1.0][..], &[0.5, 0.25, 0.25], &[3.0, -1.0, 0.5, 0.0, 2.0], &[1.0, 1e-9]] {
        let n = line.len();
        let g = one_norm(line);
        let entry = |i: usize, k: usize| {
            let own = if i == k { g * line[i].abs() } else { 0.0 };
            own - line[i] * line[k]
        };
        let matrix: Vec<f64> = (0..n * n).map(|at| entry(at / n, at % n)).collect();
        let expected = crate::control::singular_values(&matrix, n).unwrap()[0];
        let unit = unit_of(line);
        let top = Lines::new(line, n, Norm::Frobenius).unwrap().top * unit * unit;
        assert!((top / expected - 1.0).abs() < 1e-7, "{top} {expected}");
    }
}

#[test]
fn a_known_diagonal_matrix_leaves_the_vectors() {
    let of = FusedControl::new(PROBLEM).unwrap();
    let (unit, rates) = (of.image.unit, [0.1, 0.1, 0.0]);
    // M = diag(1/2, 1); Cv(xf) = 3 [[1, 1], [1, 1]], A Cv(x0) A' = [[4, -8], [-8, 16]]
    close(of.mean_square(rates) * unit * unit, 0.1 * (7.0 / 4.0 + 19.0));
    // columns of one entry are exact
    close(of.mean_square([0.0, 0.0, 1.0]), 0.0);
    close(of.image.d_f * unit, 20f64.sqrt());
    let product = of.radius(Inequality::Bousquet, rates, 3.0).unwrap().unwrap();
    let paired = FusedControl::new(Problem { paired: true, ..PROBLEM }).unwrap();
    close(product, paired.radius(Inequality::Bousquet, rates, 3.0).unwrap().unwrap());
    assert!(paired.radius(Inequality::McDiarmid, rates, 3.0).unwrap().is_none());
    assert!(of.cap(rates) > 0.0);
}

#[test]
fn without_inputs_nothing_is_random() {
    for rows in [false, true] {
        let of = FusedControl::new(Problem { b: &[0.0, 0.0], rows, a: &[1.0, 2.0, 3.0, 4.0], ..PROBLEM }).unwrap();
        assert_eq!(of.cap([1.0; 3]), 0.0);
        assert_eq!(of.radius(Inequality::Bousquet, [1.0; 3], 9.0).unwrap(), Some(0.0));
    }
}

#[test]
fn wrong_arguments_are_errors() {
    assert!(Lines::new(&[1.0, 2.0, 3.0], 2, Norm::One).is_err());
    assert!(Lines::new(&[f64::NAN, 2.0], 2, Norm::One).is_err());
    for wrong in [
        Problem { x0: &[1.0], ..PROBLEM },
        Problem { b: &[1.0], ..PROBLEM },
        Problem { b: &[], ..PROBLEM },
        Problem { xf: &[1.0, f64::INFINITY], ..PROBLEM },
        Problem { a: &[1e10; 4], x0: &[1e308, 1e308], ..PROBLEM },
    ] {
        assert!(FusedControl::new(wrong).is_err(), "{wrong:?}");
    }
}

#[test]
fn covariances_by_hand_and_wrong_arguments() {
    let of = |size, systematic| Sampling { size, systematic };
    let stop = crate::Stop::new();
    // Cv = 3 [[1, 1], [1, 1]]; of two systematic samples one count is 1 or 2: (4 / 2)^2 / 4
    assert_eq!(of(2, false).covariances(&[3.0, -1.0], 2, &stop).unwrap(), [1.5; 4]);
    assert_eq!(of(2, true).covariances(&[3.0, -1.0], 2, &stop).unwrap(), [1.0; 4]);
    assert_eq!(of(8, true).mean_square(&[3.0, -1.0, 0.0, 0.0], 2).unwrap(), 0.0);
    assert!(of(1 << 54, true).mean_square(&[3.0, -1.0], 2).is_err());
    assert!(of(1, false).mean_square(&[1e200, 1e200], 2).is_err());
    let a = Averaged { entries: &[1.0, 0.0, 2.0, 5.0], columns: 2, rows: false, average: of(1, false) };
    assert_eq!(a.second_moment(&[1.0, 0.0, 0.0, 1.0]).unwrap(), [3.0, 0.0, 0.0, 31.0]);
    assert!(a.second_moment(&[1.0]).is_err());
    assert!(fused_covariance(a, [&[1.0], &[1.0]], [1, 1], false, None).is_err());
    assert!(final_covariance(a, &[1.0, 1.0], &[1.0], [1, 1], &stop).is_err());
    assert!(trajectory_covariances([a, a], of(1, false), &[1.0], &[1.0, 1.0], &stop).is_err());
}
