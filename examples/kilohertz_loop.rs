//! A loop at 1 kHz within limits: one map for all states, no thread, and the time of every call.
//!
//! `cargo run --release --example kilohertz_loop`

#![allow(clippy::print_stdout, clippy::disallowed_methods, clippy::disallowed_macros, reason = "a program")]

use std::time::{Duration, Instant};

use stochens::limits::Until;
use stochens::limits::horizon::{Horizon, RecedingHorizon, Task};
use stochens::{Result, Stop};

/// A mass of 1 kg, 1 ms a step: position [m], speed [m/s], force [N].
const A: [[f64; 2]; 2] = [[1.0, 0.001], [0.0, 1.0]];
const B: [[f64; 1]; 2] = [[5e-7], [0.001]];
const STEPS: usize = 20;

pub fn main() -> Result<()> {
    let stop = Stop::new();
    // |u| <= 10 N over the next 20 steps, to rest at 0
    let task = Task {
        low: (&[[-10.0]; STEPS]).into(),
        high: (&[[10.0]; STEPS]).into(),
        stage: (&[[100.0, 0.0], [0.0, 1.0]]).into(),
        terminal: (&[[5000.0, 500.0], [500.0, 100.0]]).into(),
        reference: (&[[0.0; 2]; STEPS]).into(),
        r: Some((&[[1e-4]]).into()),
        ..Task::default()
    };
    let mut plans = RecedingHorizon::new(Horizon::new(&A, &B, None, task)?, &stop)?;

    let (mut x, mut took) = ([0.02, 0.0], Vec::new());
    for _ in 0..1000 {
        let began = Instant::now();
        let found = plans.solve(&x, Until::new(&stop, Some(Duration::from_micros(900))))?;
        took.push(began.elapsed());
        let u = found.control[0]; // the first input of the plan acts, the next call plans anew
        x = [0, 1].map(|i| A[i][0] * x[0] + A[i][1] * x[1] + B[i][0] * u);
    }
    took.sort();
    println!("after 1 s: {:.6} m, {:.6} m/s", x[0], x[1]);
    println!("a call: {:?} half of the time, {:?} at most", took[500], took[999]);
    assert!(x[0].abs() < 1e-3);
    Ok(())
}
