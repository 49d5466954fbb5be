//! Systems in discrete time whose inputs are constant over each step, by the exponential of `[dt A, dt B; 0, 0]`.

use faer::linalg::solvers::Solve;
use faer::{Mat, Scale};

use crate::error::{Error, Result};
use crate::matrix::MatrixView;
use crate::memory::{covered, room_for_products, try_collect, try_filled};

const WHAT: &str = "a system in discrete time";
/// Numerator of the Pade approximant of degree 13, and the largest norm for which it is exact to rounding (Higham, The
/// Scaling and Squaring Method for the Matrix Exponential Revisited (2005)).
const PADE: [f64; 14] = [
    64_764_752_532_480_000.0,
    32_382_376_266_240_000.0,
    7_771_770_303_897_600.0,
    1_187_353_796_428_800.0,
    129_060_195_264_000.0,
    10_559_470_521_600.0,
    670_442_572_800.0,
    33_522_128_640.0,
    1_323_241_920.0,
    40_840_800.0,
    960_960.0,
    16_380.0,
    182.0,
    1.0,
];
const THETA: f64 = 5.371_920_351_148_152;
/// Each squaring doubles the error of an exponent: after more squarings of a part that does not decay, fewer than six
/// of its digits are right.
const SQUARINGS: usize = 28;
const SHORT: &str = "short beside the time scales of the system: a part of its state lasts for so long that fewer than six \
                     digits of it would be right";
/// Sweeps at most: each about halves the logarithm of the imbalance.
const SWEEPS: usize = 100;

type Matrix = Mat<f64>;

/// e with `x = f 2^e`, 1/2 <= |f| < 1; 0 for 0.
fn exponent(x: f64) -> i64 {
    match (x.abs().to_bits() >> 52) as i64 {
        0 if x == 0.0 => 0,
        0 => exponent(x * 2f64.powi(64)) - 64,
        raw => raw - 1022,
    }
}

/// `x 2^e`.
fn scaled(mut x: f64, mut e: i64) -> f64 {
    while e != 0 && x != 0.0 && x.is_finite() {
        let part = e.clamp(-1000, 1000);
        x *= 2f64.powi(part as i32);
        e -= part;
    }
    x
}

fn norm(of: &Matrix, rows: usize, cols: usize) -> f64 {
    (0..cols).map(|j| (0..rows).map(|i| of[(i, j)].abs()).sum()).fold(0.0, f64::max)
}

/// `e^X`, and how many squarings doubled rounding that lasts in the first n rows and columns: the columns of inputs and
/// the faster parts have decayed where it does not.
fn exponential(x: &Matrix, n: usize) -> (Matrix, usize) {
    let (size, one) = (x.nrows(), norm(x, x.nrows(), x.ncols()));
    let squarings = if one > 0.0 { (one / THETA).log2().ceil().max(0.0) as usize } else { 0 };
    let x = Mat::from_fn(size, size, |i, j| scaled(x[(i, j)], -(squarings as i64)));
    let identity = Matrix::identity(size, size);
    let two = &x * &x;
    let four = &two * &two;
    let six = &four * &two;
    let sum = |at: [usize; 3]| &six * Scale(PADE[at[0]]) + &four * Scale(PADE[at[1]]) + &two * Scale(PADE[at[2]]);
    let u = &x * (&six * sum([13, 11, 9]) + sum([7, 5, 3]) + &identity * Scale(PADE[1]));
    let v = &six * sum([12, 10, 8]) + sum([6, 4, 2]) + &identity * Scale(PADE[0]);
    let (mut found, mut lasting) = (identity + (v - &u).partial_piv_lu().solve(&u) * Scale(2.0), 0);
    for _ in 0..squarings {
        let slow = norm(&found, n, n);
        lasting += usize::from(slow.is_nan() || slow > 0.5);
        found = &found * &found;
    }
    (found, lasting)
}

/// Exponents e for which the rows and columns of `2^-e A 2^e` have nearly equal sums (Osborne 1960), without rounding.
/// A state that none of the others moves, or that moves none, has no best unit: 1 takes the place of an empty sum.
fn balance(a: &[f64], n: usize) -> Result<Vec<i64>> {
    let mut e = try_filled(WHAT, 0i64, n)?;
    let beside = |e: &[i64], i: usize, j: usize| scaled(a[i * n + j].abs(), e[j] - e[i]);
    for _ in 0..SWEEPS {
        let mut moved = false;
        for i in 0..n {
            let others = || (0..n).filter(|j| *j != i);
            let row: f64 = others().map(|j| beside(&e, i, j)).sum();
            let column: f64 = others().map(|j| beside(&e, j, i)).sum();
            if !(row + column > 0.0 && (row + column).is_finite()) {
                continue;
            }
            let or = |side: f64, other: f64| if side > 0.0 { side } else { other.min(1.0) };
            let k = ((or(row, column) / or(column, row)).log2() / 2.0).round_ties_even() as i64;
            if k != 0 && scaled(column, k) + scaled(row, -k) < 0.95 * (row + column) {
                (e[i], moved) = (e[i] + k, true);
            }
        }
        if !moved {
            break;
        }
    }
    Ok(e)
}

/// `A_d` (n, n) and `B_d` (n, m) of `x' = A x + B u` with u constant over each step of `dt`.
///
/// In units of states and inputs, powers of two, in which `dt A` is balanced and the columns of B are of size 1:
/// neither its size, nor the units of the states, nor dt in another unit of time change the digits.
///
/// # Errors
/// [`Error::Shape`], [`Error::NonFinite`], [`Error::Value`] and [`Error::Overflow`] where dt is too large,
/// [`Error::Memory`].
pub fn zero_order_hold<'a>(
    a: impl Into<MatrixView<'a>>,
    b: impl Into<MatrixView<'a>>,
    dt: f64,
) -> Result<(Vec<f64>, Vec<f64>)> {
    let b = b.into();
    let (n, m) = b.shape();
    let (a, b) = (a.into().finite("A", n, n)?, b.finite("B", n, m)?);
    room_for_products()?;
    let steps = try_collect(WHAT, a.iter().map(|v| dt * v))?;
    let e = balance(&steps, n)?;
    let whole = exponent(dt);
    let largest = (0..m).map(|j| exponent((0..n).map(|i| b[i * m + j].abs()).fold(0.0, f64::max)));
    let largest = try_collect(WHAT, largest)?;
    let unit = |i: usize, j: usize| scaled(scaled(b[i * m + j], -largest[j]), -e[i]);
    let more = try_collect(WHAT, (0..m).map(|j| exponent((0..n).map(|i| unit(i, j).abs()).sum())))?;
    covered(WHAT, 256 * ((n + m) as u128 + 16).pow(2), || {
        let all = Mat::from_fn(n + m, n + m, |i, j| match (i < n, j < n) {
            (true, true) => scaled(steps[i * n + j], e[j] - e[i]),
            (true, false) => scaled(dt, -whole) * scaled(unit(i, j - n), -more[j - n]),
            _ => 0.0,
        });
        let size = norm(&all, n, n);
        let (found, lasting) = if size.is_finite() { exponential(&all, n) } else { (all, SQUARINGS + 1) };
        if lasting > SQUARINGS {
            return Err(Error::Value {
                name: "dt",
                expected: SHORT,
                found: format!("{dt:e} s, a norm of dt A of {size:.1e}"),
            });
        }
        let own = (0..n * n).map(|at| (at / n, at % n)).map(|(i, j)| scaled(found[(i, j)], e[i] - e[j]));
        let by = |i: usize, j: usize| whole + largest[j] + more[j] + e[i];
        let inputs = (0..n * m).map(|at| (at / m, at % m)).map(|(i, j)| scaled(found[(i, n + j)], by(i, j)));
        let (own, inputs) = (try_collect(WHAT, own)?, try_collect(WHAT, inputs)?);
        for (what, values) in [("A of the discretized system", &own), ("B of the discretized system", &inputs)] {
            if values.iter().any(|v| !v.is_finite()) {
                return Err(Error::Overflow { what });
            }
        }
        Ok((own, inputs))
    })?
}
