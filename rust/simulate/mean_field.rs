//! Mean fields: `F(k+1) = A^_k F(k) + B^_k u(k)` with the averages of `size` fresh realizations at each step.
//!
//! An average needs the counts only, so a step costs `O(n (n + m))` for any `size`. Equal in distribution to averaging
//! that many realizations, not draw by draw.

use rand::rngs::ChaCha8Rng;

use super::model::{Drawn, Model, add_product};
use super::moments::{Ensemble, Second, Sums, Tree};
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::sample::{Law, line_counts};
use crate::stream::{Key, Purpose};

/// Replicates in one leaf of the tree of sums.
const LEAF: usize = 8;

/// Mean and covariance of `replicates` independent mean-field trajectories; the trajectories themselves with `keep`.
///
/// Replicate `r` depends on `(key, r)`, `size` and the model only. It draws the counts of `x0`, then at every step
/// those of the columns of `A` with `F_j(k) != 0` and of the columns of `B` with `u_j(k) != 0`, for the entities that
/// are drawn.
///
/// # Errors
/// [`Error::Value`] for no replicates, or a `size` outside `1 ..= 2^53`; [`Error::Overflow`] if a state or a second
/// moment is not finite, [`Error::Memory`], [`Error::Interrupted`] after a stop.
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub fn mean_field(
    model: &Model,
    drawn: Drawn,
    size: u64,
    replicates: usize,
    second: Second,
    keep: bool,
    key: &Key,
    threads: usize,
    stop: &Stop,
) -> Result<Ensemble> {
    if size == 0 || size > 1 << 53 {
        return Err(Error::Value { name: "size", expected: "in [1, 2^53]", found: size.to_string() });
    }
    if replicates == 0 {
        return Err(Error::Value { name: "replicates", expected: "at least 1", found: "0".into() });
    }
    let n = model.n();
    let center = model.trajectory(stop)?;
    let (what, one) = ("the replicates", center.len());
    let mut kept: Vec<f64> = try_zeros(what, if keep { checked_len(what, replicates, one)? } else { 0 })?;
    let tree = Tree::new();
    let mut parts = kept.chunks_mut(LEAF.saturating_mul(one));
    let leaves = (0..replicates.div_ceil(LEAF)).map(|leaf| (leaf, parts.next().unwrap_or_default()));
    for_each_chunk(leaves, threads, stop, |(leaf, part)| {
        let mut sums = Sums::new(&center, n, second)?;
        let mut parts = part.chunks_mut(one);
        let (mut x, mut next) = (try_zeros(what, n)?, try_zeros(what, n)?);
        for replicate in leaf * LEAF..replicates.min((leaf + 1) * LEAF) {
            let mut rng = key.stream(Purpose::MeanField, replicate);
            let part = parts.next().unwrap_or_default();
            for k in 0..=model.steps() {
                next.fill(0.0);
                if k == 0 {
                    add_average(model.x0(), drawn.x0, &[1.0], size, &mut rng, &mut next, stop)?;
                } else {
                    add_average(model.a(), drawn.a, &x, size, &mut rng, &mut next, stop)?;
                    add_average(model.b(), drawn.b, model.input(k - 1), size, &mut rng, &mut next, stop)?;
                }
                std::mem::swap(&mut x, &mut next);
                sums.add_one(k, &x);
                if let Some(to) = part.get_mut(k * n..(k + 1) * n) {
                    to.copy_from_slice(&x);
                }
            }
        }
        tree.insert(leaf, sums);
        Ok(())
    })?;
    tree.finish(replicates, kept)
}

/// `out += M^ v` with `M^ = M`, or the average of `size` fresh realizations: `M^_ij = g_j sign(M_ij) counts_ij / size`.
fn add_average(
    law: &Law,
    drawn: bool,
    v: &[f64],
    size: u64,
    rng: &mut ChaCha8Rng,
    out: &mut [f64],
    stop: &Stop,
) -> Result<()> {
    if !drawn {
        return add_product(law, v, out, stop);
    }
    for (j, &v) in v.iter().enumerate().filter(|(_, v)| **v != 0.0) {
        stop.check()?;
        let counts = line_counts(law.line(j), law.gamma()[j], size, rng)?;
        for ((out, entry), count) in out.iter_mut().zip(law.line(j)).zip(counts).filter(|(_, count)| *count > 0) {
            *out += v * (law.gamma()[j].copysign(*entry) * (count as f64 / size as f64));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::model::tests::model;

    #[test]
    fn threads_change_nothing_and_a_huge_average_is_nearly_exact() {
        let a = [0.5, -1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.25, -0.5];
        let model = model(&a, &[1.0, 0.0, -1.0], &[1.0, 0.0, -2.0], &[0.0, 1.0, -1.0, 0.5]);
        let (drawn, stop) = (Drawn { a: true, b: true, x0: true }, Stop::new());
        let run = |size, threads| {
            mean_field(&model, drawn, size, 3 * LEAF + 1, Second::Full, true, &Key([1; 32]), threads, &stop)
        };
        let one = run(100, 1).unwrap();
        assert_eq!(run(100, 3).unwrap(), one);
        assert_eq!(run(0, 1).map_err(|e| matches!(e, Error::Value { name: "size", .. })), Err(true));
        // a relative error of 10^-6, and growth by a small factor: no error is above 10^-4
        let exact = model.trajectory(&stop).unwrap();
        let huge = run(1_000_000_000_000, 1).unwrap();
        assert!(huge.runs.chunks_exact(15).all(|run| run.iter().zip(&exact).all(|(a, b)| (a - b).abs() < 1e-4)));
        assert!(huge.runs != one.runs);
    }
}
