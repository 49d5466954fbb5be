//! From measured steps to a gain that is certified for every system that the data allow, and its file.
//!
//! `cargo run --release --example certified_gain`

#![allow(clippy::print_stdout, clippy::disallowed_methods, clippy::disallowed_macros, reason = "a program")]

use std::path::Path;

use stochens::feedback::{Loop, Verdict, least_squares};
use stochens::identify::{Assumed, Covariance, Design, Estimate, Magnitudes, Noise, Wish};
use stochens::region::Region;
use stochens::storage::Saved;
use stochens::{Key, Result, Stop};

/// A mass on a table, 0.1 s a step: position [m], speed [m/s], force [N]; the data alone are known below.
const A: [[f64; 2]; 2] = [[1.0, 0.0975], [0.0, 0.951]];
const B: [f64; 2] = [0.0049, 0.0975];

fn step(x: [f64; 2], u: f64) -> [f64; 2] {
    [0, 1].map(|i| A[i][0] * x[0] + A[i][1] * x[1] + B[i] * u)
}

pub fn main() -> Result<()> {
    let file = std::env::temp_dir().join(format!("table-{}.loop", std::process::id()));
    design(&file)?;
    let far = operate(&file);
    for end in ["loop", "loop.lock"] {
        let _ = std::fs::remove_file(file.with_extension(end));
    }
    far
}

/// Where the data are.
fn design(file: &Path) -> Result<()> {
    let stop = Stop::new();

    // 300 steps of one run with forces of +-1 N, and noise of 0.001 at most
    let mut words = vec![0; 900];
    Key([7; 32]).words(0, &mut words);
    let mut draws = words.iter().map(|word| *word as f64 / 2f64.powi(63) - 1.0);
    let mut uniform = || draws.next().unwrap_or(0.0);
    let (mut states, mut inputs) = (vec![[0.0, 0.0]], Vec::new());
    for k in 0..300 {
        let u = uniform().signum();
        let w = [0.001 * uniform(), 0.001 * uniform()];
        let next = step(states[k], u);
        states.push([next[0] + w[0], next[1] + w[1]]);
        inputs.push([u]);
    }

    // the model, and a region that misses the true one with probability 5 % at most: the noise is sub-Gaussian with a
    // covariance of 1e-6 I or less (Hoeffding), which is declared
    let estimate = Estimate::from_pairs(&states[..300], &inputs[..], &states[1..], 1, &stop)?;
    let covariance = Covariance::Known(&[1e-6, 0.0, 0.0, 1e-6]);
    let assumed = Assumed { design: Design::Adaptive, noise: Noise::SubGaussian, covariance, tail: 0.0 };
    let sizes = Magnitudes::Expected(&[1.0, 1.0, 1.0]);
    let region = Region::from_data(&estimate, assumed, Wish::new(0.05), sizes, 1, &stop)?;

    // the gain that is best for the model, and what is proved of it for all of the region
    let (a, b) = (estimate.theta().columns(0..2)?, estimate.theta().columns(2..3)?);
    let gain = least_squares(a, b, &[[10.0, 0.0], [0.0, 1.0]], &[[0.1]], &stop)?;
    let closed = Loop::new(&region, &gain, &stop)?;
    let certificate = closed.certificate();
    println!("u = {:.3} position {:+.3} speed", gain.gain[0], gain.gain[1]);
    println!("{:?}: the model has a spectral radius of {:.3}", certificate.status, certificate.radius);

    // what goes wrong beside the data: any gain of the actuator in this interval
    let margins = closed.margins(None, &stop)?;
    println!("{:?}", margins.gains);
    closed.save(file, &stop)?;
    Ok(())
}

/// Where the plant is: the file is read, and what it says is proved again.
fn operate(file: &Path) -> Result<()> {
    let closed = Loop::load(file, &Stop::new())?;
    assert_eq!(closed.certificate().status, Verdict::Certified);
    let (gain, mut x) = (closed.gain(), [0.5, 0.0]);
    for _ in 0..100 {
        x = step(x, gain[0] * x[0] + gain[1] * x[1]);
    }
    println!("from 0.5 m, after 10 s: {:.6} m", x[0]);
    assert!(x[0].abs() < 1e-3);
    Ok(())
}
