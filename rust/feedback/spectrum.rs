//! Eigenvalues and vectors of matrices in units that may differ by many orders: balanced first.

use faer::{Mat, c64};

use crate::error::Result;
use crate::scaled::nearest_power_of_two;

use super::data::{Matrix, absolute, filled, finite, in_units, inverse, lost};

/// Rounds over all states; each costs n^2.
const ROUNDS: usize = 40;

/// Powers of 2, D, for which `D^-1 A D`, `D^-1 G D^-1` and `D Q D` have the least sum of sizes (Osborne 1960; for the
/// three of a Riccati equation Benner 2001), G and Q symmetric. The units of the states do not count, and nothing is
/// rounded.
pub(super) fn balancing(a: &Matrix, riccati: Option<(&Matrix, &Matrix)>) -> Vec<f64> {
    let n = a.nrows();
    // a group of states that no other and no input moves has no best units
    let start = if riccati.is_some() { balancing(a, None) } else { filled(n, 1.0) };
    let most = if riccati.is_some() { 2f64.powi(64) } else { 2f64.powi(100) };
    let mut d = start.clone();
    let entry = |of: Option<&Matrix>, i: usize, j: usize| of.map_or(0.0, |of| of[(i, j)].abs());
    let (g, q) = (riccati.map(|both| both.0), riccati.map(|both| both.1));
    let own = (0..n).map(|i| a[(i, i)].abs()).fold(0.0, f64::max);
    for _ in 0..ROUNDS {
        let mut moved = false;
        for i in 0..n {
            // with d_i t in place of d_i the sum is c + up t + more t^2 + down / t + less / t^2
            let (mut up, mut down) = (0.0, 0.0);
            for j in (0..n).filter(|j| *j != i) {
                up += a[(j, i)].abs() * d[i] / d[j] + 2.0 * entry(q, i, j) * d[i] * d[j];
                down += a[(i, j)].abs() * d[j] / d[i] + 2.0 * entry(g, i, j) / d[i] / d[j];
            }
            let (more, less) = (entry(q, i, i) * d[i] * d[i], entry(g, i, i) / d[i] / d[i]);
            // what only leads out of a state, or into it, is brought to the size of the diagonal
            match (up + more > 0.0, down + less > 0.0) {
                (true, true) => {}
                (true, false) => down = own,
                (false, true) => up = own,
                (false, false) => continue,
            }
            let slope = |t: f64| up * t + 2.0 * more * t * t - down / t - 2.0 * less / t / t;
            let (mut low, mut high) = (-600.0f64, 600.0f64);
            while high - low > 0.05 {
                let middle = 0.5 * (low + high);
                if slope(middle.exp2()) < 0.0 { low = middle } else { high = middle }
            }
            let t = nearest_power_of_two((0.5 * (low + high)).exp2());
            let next = d[i] * t;
            if t != 1.0 && (1.0 / most..most).contains(&(next / start[i])) {
                (d[i], moved) = (next, true);
            }
        }
        if !moved {
            break;
        }
    }
    d
}

fn balanced(a: &Matrix) -> (Matrix, Vec<f64>) {
    let d = balancing(a, None);
    (in_units(a, &inverse(&d), &d), d)
}

/// All eigenvalues.
pub(super) fn eigenvalues(a: &Matrix) -> Result<Vec<c64>> {
    balanced(a).0.eigenvalues().map_err(lost)
}

/// The eigenvalues, and a right eigenvector for each in the columns, in the units of `a`.
pub(super) fn eigen(a: &Matrix) -> Result<(Vec<c64>, Mat<c64>)> {
    let (own, d) = balanced(a);
    let found = own.eigen().map_err(lost)?;
    let mut values = Vec::new();
    values.extend(found.S().column_vector().iter().copied());
    Ok((values, Mat::from_fn(a.nrows(), a.nrows(), |i, j| found.U()[(i, j)] * d[i])))
}

/// The same of a complex matrix.
pub(super) fn radius_of_complex(re: &Matrix, im: &Matrix) -> Result<f64> {
    if !(finite(re) && finite(im)) {
        return Ok(f64::INFINITY);
    }
    let d = balancing(&(absolute(re) + absolute(im)), None);
    let own = Mat::from_fn(re.nrows(), re.nrows(), |i, j| c64::new(re[(i, j)], im[(i, j)]) * (d[j] / d[i]));
    Ok(own.eigenvalues().map_err(lost)?.iter().fold(0.0, |most, value| value.re.hypot(value.im).max(most)))
}

/// The spectral radius; infinite for what is not finite.
pub(super) fn radius(a: &Matrix) -> Result<f64> {
    if !finite(a) {
        return Ok(f64::INFINITY);
    }
    Ok(eigenvalues(a)?.iter().fold(0.0, |most, value| value.re.hypot(value.im).max(most)))
}
