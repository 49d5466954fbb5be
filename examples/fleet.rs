//! One command for many carts, and how often a fresh one misses by more.
//!
//! `cargo run --release --example fleet`

#![allow(clippy::print_stdout, clippy::disallowed_methods, clippy::disallowed_macros, reason = "a program")]

use stochens::fleet::{Limits, Units, compression, misses, worst};
use stochens::limits::Until;
use stochens::{Key, Result, Stop};

const STEPS: usize = 20;

pub fn main() -> Result<()> {
    let stop = Stop::new();
    // 200 carts from 0 to 1 m in 2 s: masses and frictions differ by a fifth
    let (size, dt) = (200, 0.1);
    let mut words = vec![0; 2 * size];
    Key([3; 32]).words(0, &mut words);
    let mut draws = words.iter().map(|word| *word as f64 / 2f64.powi(64));
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for _ in 0..size {
        let mut about = |x: f64| x * (0.8 + 0.4 * draws.next().unwrap_or(0.5));
        let (mass, friction) = (about(1.0), about(0.5));
        let fade = (-friction / mass * dt).exp();
        let moved = (1.0 - fade) * mass / friction;
        a.extend([1.0, moved, 0.0, fade]);
        b.extend([(dt - moved) / friction, (1.0 - fade) / friction]);
    }

    // the last of the wanted states counts: at rest at 1 m
    let reference = [1.0, 0.0].repeat(STEPS);
    let units = Units {
        a: &a,
        b: &b,
        c: &[],
        x0: &[0.0, 0.0],
        reference: &reference,
        stage: &[],
        terminal: &[1.0, 0.0, 0.0, 1.0],
        n: 2,
        m: 1,
        steps: STEPS,
        size,
    };
    let (low, high) = ([-2.0; STEPS], [2.0; STEPS]);
    let limits = Limits { low: &low, high: &high, r: &[1e-6], ..Limits::default() };
    let none_left_out = vec![false; size];
    let found = worst(&units, limits, (&none_left_out, &[]), (1, Until::new(&stop, None)))?;

    // it was solved for a few of the carts alone: the others are fresh to it
    let risk = compression(size, found.working.len(), 0, 1e-6)?;
    println!("{:?}: no cart misses by more than {:.3}", found.status, found.value);
    println!("a fresh cart does with at most {:.1} %, at confidence 1 - 1e-6", 100.0 * risk);
    let (each, _) = misses(&units, limits, &found.control, 1, &stop)?;
    assert!(each.iter().all(|miss| *miss <= found.value + 1e-9) && risk < 0.4);
    Ok(())
}
