//! Independent runs: a fresh `A` and `B` for every run and step.

use super::block::{Block, RUNS, States, Stepper};
use super::model::{Drawn, Model};
use super::moments::{Ensemble, Second, Sums, Tree};
use super::words::Words;
use crate::error::{Error, Result};
use crate::memory::{checked_len, try_zeros};
use crate::parallel::{Stop, for_each_chunk};
use crate::stream::Key;

/// Blocks in one leaf of the tree of sums; a thread takes one leaf at a time.
const LEAF: usize = 16;

/// Mean and covariance of `size` independent runs at the times `0 .. K`; the runs themselves only with `keep`.
///
/// Run `s` depends on `(key, s)` and the model only: the first runs of a larger ensemble are those of a smaller one.
///
/// # Errors
/// [`Error::Value`] for no runs, [`Error::Overflow`] if a state or a second moment is not finite, [`Error::Memory`],
/// [`Error::Interrupted`] after a stop.
#[expect(clippy::too_many_arguments, reason = "the arguments of one call")]
pub fn runs(
    model: &Model,
    drawn: Drawn,
    size: usize,
    second: Second,
    keep: bool,
    key: &Key,
    threads: usize,
    stop: &Stop,
) -> Result<Ensemble> {
    if size == 0 {
        return Err(Error::Value { name: "size", expected: "at least 1", found: "0".into() });
    }
    let n = model.n();
    let center = model.trajectory(stop)?;
    let stepper = Stepper::new(model, drawn, stop)?;
    let what = "the runs";
    let one = center.len();
    let mut kept: Vec<f64> = try_zeros(what, if keep { checked_len(what, size, one)? } else { 0 })?;
    let tree = Tree::new();
    let mut parts = kept.chunks_mut((LEAF * RUNS).saturating_mul(one));
    let leaves = (0..size.div_ceil(LEAF * RUNS)).map(|leaf| (leaf, parts.next().unwrap_or_default()));
    for_each_chunk(leaves, threads, stop, |(leaf, part)| {
        let mut sums = Sums::new(&center, n, second)?;
        let block_size = checked_len("a block of runs", n, RUNS)?;
        let (mut x, mut next) = (try_zeros("a block of runs", block_size)?, try_zeros("a block of runs", block_size)?);
        let mut parts = part.chunks_mut(RUNS * one);
        for index in leaf * LEAF..size.div_ceil(RUNS).min((leaf + 1) * LEAF) {
            let count = RUNS.min(size - index * RUNS);
            let part = parts.next().unwrap_or_default();
            let mut block = Block::new(&stepper, Words::new(key, index), &mut x, &mut next);
            for k in 0..=model.steps() {
                if k > 0 {
                    block.step(stop)?;
                }
                sums.add(k, &block.states(), count);
                for (s, run) in part.chunks_exact_mut(one).enumerate() {
                    write(&block.states(), s, &mut run[k * n..(k + 1) * n]);
                }
            }
        }
        tree.insert(leaf, sums);
        Ok(())
    })?;
    tree.finish(size, kept)
}

/// Writes the state of run `s` into zeros.
fn write(states: &States, s: usize, out: &mut [f64]) {
    match states {
        States::Singles { indices, values } => out[indices[s] as usize] = values[s],
        States::Rows(rows) => out.iter_mut().zip(*rows).for_each(|(to, row)| *to = row[s]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::model::tests::model;

    const ALL: Drawn = Drawn { a: true, b: true, x0: true };

    fn example() -> Model {
        let a = [0.5, -1.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.25, -0.5];
        model(&a, &[1.0, 0.0, -1.0], &[1.0, 0.0, -2.0], &[0.0, 1.0, -1.0, 0.5])
    }

    #[test]
    fn threads_change_nothing_and_a_larger_ensemble_starts_with_the_smaller_one() {
        let (model, key, stop) = (example(), Key([2; 32]), Stop::new());
        let run = |size, second, threads| runs(&model, ALL, size, second, true, &key, threads, &stop).unwrap();
        for second in [Second::Diagonal, Second::Full] {
            let whole = run(5000, second, 1);
            for threads in [2, 3, 8] {
                assert_eq!(run(5000, second, threads), whole);
            }
            for size in [1, RUNS + 1, LEAF * RUNS, LEAF * RUNS + 1] {
                assert_eq!(run(size, second, 2).runs, whole.runs[..size * 15]);
            }
        }
    }

    #[test]
    fn a_stop_no_runs_and_overflow_are_errors() {
        let (model, key, stop) = (example(), Key([2; 32]), Stop::new());
        let run = |model: &Model, size, stop: &Stop| runs(model, ALL, size, Second::Diagonal, false, &key, 1, stop);
        assert!(matches!(run(&model, 0, &stop), Err(Error::Value { name: "size", .. })));
        stop.request();
        assert_eq!(run(&model, 10, &stop), Err(Error::Interrupted));
        let stop = Stop::new();
        let a = [1e200, -1e200, -1e200, 1e200]; // the exact trajectory of (1, 1) is zero
        let grows = |steps| self::model(&a, &[1.0, 1.0], &[1.0, 1.0], &vec![0.0; steps]);
        assert_eq!(run(&grows(1), 9, &stop), Err(Error::Overflow { what: "a second moment of the ensemble" }));
        assert_eq!(run(&grows(3), 9, &stop), Err(Error::Overflow { what: "a state of the ensemble" }));
    }
}
