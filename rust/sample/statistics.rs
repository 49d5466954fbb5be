//! Tests of the sampler's distribution, and tests that wrong samplers fail them.
//!
//! Chi-square on `10^6` draws with fixed keys. Critical value: the Wilson-Hilferty quantile at false-alarm probability
//! `1e-8` per test (z = 5.61); the 15 cases together raise a false alarm with probability below `2e-7`, once per change
//! of the stream, since keys are fixed. At n = 10, 100, 1000 a root-mean-square relative bias of 1.0, 1.4, 2.1 % is
//! detected with probability 0.999.

use super::categorical::AliasTable;
use crate::stream::{CHUNK, Key};

const DRAWS: usize = 1_000_000;

/// The words of line 0 under `key`, as the sampler uses them.
fn words(key: &Key) -> impl Iterator<Item = u64> {
    let key = *key;
    (0..DRAWS.div_ceil(CHUNK))
        .flat_map(move |chunk| {
            let mut block = vec![0u64; CHUNK];
            key.lanes(0, chunk).fill(&mut block);
            block
        })
        .take(DRAWS)
}

fn shapes(n: usize) -> [(&'static str, Vec<f64>); 5] {
    let value = |f: &dyn Fn(f64) -> f64| (0..n).map(|i| f(i as f64)).collect();
    [
        ("uniform", value(&|_| 1.0)),
        ("linear", value(&|i| i + n as f64 / 20.0)),
        ("harmonic", value(&|i| -1.0 / (i + 1.0))),
        ("two levels", value(&|i| if i % 2.0 == 0.0 { 1.0 } else { 3.0 })),
        (
            "every third zero",
            value(&|i| {
                if i % 3.0 == 1.0 { 0.0 } else { 2.0 + (i * 0.7).sin() }
            }),
        ),
    ]
}

/// The chi-square statistic over its critical value; infinite if a zero component was drawn.
fn excess(draws: impl Iterator<Item = u32>, weights: &[f64]) -> f64 {
    let mut counts = vec![0u64; weights.len()];
    draws.for_each(|i| counts[i as usize] += 1);
    let total: f64 = weights.iter().map(|w| w.abs()).sum();
    let (mut statistic, mut cells) = (0.0, 0.0);
    for (w, &count) in weights.iter().zip(&counts) {
        if *w == 0.0 {
            if count > 0 {
                return f64::INFINITY;
            }
            continue;
        }
        let expected = DRAWS as f64 * w.abs() / total;
        assert!(expected >= 10.0, "a chi-square test needs filled cells");
        statistic += (count as f64 - expected).powi(2) / expected;
        cells += 1.0;
    }
    let dof: f64 = cells - 1.0;
    statistic / (dof * (1.0 - 2.0 / (9.0 * dof) + 5.61 * (2.0 / (9.0 * dof)).sqrt()).powi(3))
}

#[test]
fn the_sampler_follows_its_weights() {
    for (at, n) in [10, 100, 1000].into_iter().enumerate() {
        for (shape, (name, weights)) in shapes(n).into_iter().enumerate() {
            let table = AliasTable::new(&weights).unwrap().unwrap();
            let key = Key([(10 * at + shape) as u8; 32]);
            let excess = excess(words(&key).map(|word| table.draw(word)), &weights);
            assert!(excess < 1.0, "{name}, n = {n}: {excess} of the critical value");
        }
    }
}

#[test]
fn wrong_tables_are_caught() {
    const COIN: u64 = 1 << 32;
    let low = |entry: u64| entry & (COIN - 1);
    let n = 100;
    let (_, weights) = &shapes(n)[1];
    type Mutant<'a> = (&'a str, &'a dyn Fn(usize, u64) -> u64);
    let mutants: [Mutant; 4] = [
        ("the coin is ignored", &|cell, _| cell as u64),
        ("thresholds are a tenth too small", &|_, entry| ((entry >> 32) * 9 / 10 * COIN) | low(entry)),
        ("aliases are off by one", &|_, entry| (entry >> 32 << 32) | ((low(entry) + 1) % n as u64)),
        ("threshold and its complement are swapped", &|_, entry| ((COIN - 1 - (entry >> 32)) << 32) | low(entry)),
    ];
    for (name, mutant) in mutants {
        let mut table = AliasTable::new(weights).unwrap().unwrap();
        table.mutate(mutant);
        // cells beyond n would index out of range: such a draw counts as component 0
        let draws = words(&Key([1; 32])).map(|word| if table.draw(word) < n as u32 { table.draw(word) } else { 0 });
        assert!(excess(draws, weights) > 1.0, "{name} went unnoticed");
    }
    let modulo = words(&Key([1; 32])).map(|word| (word % n as u64) as u32);
    assert!(excess(modulo, weights) > 1.0, "a missing table went unnoticed");
    // a 32-bit seed, a stream without its line, ... show up as repeated words, not here: see the stream tests
}
