//! Controls of realizations without structure: a block of `y`, reading every entry once, then one matrix product.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

use super::realizations::{Entity, Realized};
use crate::error::Result;
use crate::parallel::Stop;

/// Entries of `A` between two looks at the stop flag: well below a millisecond.
const STEP: usize = 1 << 18;

/// The controls of the realizations from `first` on, as many as `out` has rows for; `transposed` is `(B^+)^T`.
pub(super) fn controls(
    realized: &Realized<'_>,
    first: usize,
    transposed: &[f64],
    m: usize,
    out: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    let n = realized.n;
    let count = out.len() / m;
    let mut y = vec![0.0; count * n];
    differences(realized, first, &mut y, stop)?;
    // U = Y (B^+)^T
    matmul(
        MatMut::from_row_major_slice_mut(out, count, m),
        Accum::Replace,
        MatRef::from_row_major_slice(&y, count, n),
        MatRef::from_row_major_slice(transposed, n, m),
        1.0,
        Par::Seq,
    );
    Ok(())
}

/// `y^s = xf^s - A^s x0^s`, from zeros.
fn differences(realized: &Realized<'_>, first: usize, y: &mut [f64], stop: &Stop) -> Result<()> {
    let n = realized.n;
    let a = match (&realized.x0, &realized.a) {
        (Entity::Dense(x0), Entity::Exact(a)) => {
            let count = y.len() / n;
            stop.check()?;
            y.chunks_exact_mut(n).enumerate().for_each(|(at, y)| set_goal(realized, first + at, y));
            // Y = Xf - X0 A^T
            matmul(
                MatMut::from_row_major_slice_mut(y, count, n),
                Accum::Add,
                MatRef::from_row_major_slice(&x0.values()[first * n..(first + count) * n], count, n),
                MatRef::from_row_major_slice(a, n, n).transpose(),
                -1.0,
                Par::Seq,
            );
            return Ok(());
        }
        (Entity::Dense(_) | Entity::Exact(_), Entity::Dense(a)) => a,
        _ => return few_differences(realized, first, y, stop),
    };
    for (at, y) in y.chunks_exact_mut(n).enumerate() {
        if at % (STEP / (n * n) + 1) == 0 {
            stop.check()?;
        }
        let s = first + at;
        set_goal(realized, s, y);
        let x = match &realized.x0 {
            Entity::Dense(x0) => x0.row(s),
            Entity::Exact(x0) => x0,
            Entity::Singletons { .. } => &[], // excluded above
        };
        subtract_product(a.row(s), x, y);
    }
    Ok(())
}

/// `y = xf^s`, over zeros.
fn set_goal(realized: &Realized<'_>, s: usize, y: &mut [f64]) {
    match &realized.xf {
        Entity::Exact(xf) => y.copy_from_slice(xf),
        Entity::Dense(xf) => y.copy_from_slice(xf.row(s)),
        Entity::Singletons { .. } => realized.goal(s, |i, v| y[i] += v),
    }
}

/// The same from the contributions one by one, where there are few of them.
fn few_differences(realized: &Realized<'_>, first: usize, y: &mut [f64], stop: &Stop) -> Result<()> {
    for (at, y) in y.chunks_exact_mut(realized.n).enumerate() {
        stop.check()?;
        realized.contributions(first + at, |i, v| y[i] += v);
    }
    Ok(())
}

/// `y -= A x`, row after row. (Four rows together read the memory in four places, which is slower.)
#[inline(never)]
fn subtract_product(a: &[f64], x: &[f64], y: &mut [f64]) {
    for (y, row) in y.iter_mut().zip(a.chunks_exact(x.len())) {
        *y -= dot(row, x);
    }
}

/// `<a, b>`, eight sums at a time: one sum alone would wait for every addition.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a8, a_rest) = a.as_chunks::<8>();
    let (b8, b_rest) = b.as_chunks::<8>();
    let mut s = [0.0; 8];
    for (a, b) in a8.iter().zip(b8) {
        for k in 0..8 {
            s[k] += a[k] * b[k];
        }
    }
    let mut last = 0.0;
    for (a, b) in a_rest.iter().zip(b_rest) {
        last += a * b;
    }
    ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7])) + last
}
