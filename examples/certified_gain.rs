//! From measured steps to a gain that is certified for every system that the data allow.
//!
//! `cargo run --release --example certified_gain`

#![allow(clippy::print_stdout, clippy::disallowed_methods, clippy::disallowed_macros, reason = "a program")]

use stochens::feedback::{Loop, Verdict, least_squares};
use stochens::identify::{Assumed, Covariance, Data, Design, Estimate, Magnitudes, Noise, Wish, triangle};
use stochens::region::Region;
use stochens::{Key, Result, Stop};

/// A mass on a table, 0.1 s a step: position [m], speed [m/s], force [N]; the data alone are known below.
const A: [f64; 4] = [1.0, 0.0975, 0.0, 0.951];
const B: [f64; 2] = [0.0049, 0.0975];

pub fn main() -> Result<()> {
    let (n, m, stop) = (2, 1, Stop::new());

    // 300 rows (x, u, x one step later): one run with forces of +-1 N, and noise of 0.001 at most
    let mut words = vec![0; 900];
    Key([7; 32]).words(0, &mut words);
    let mut draws = words.iter().map(|word| *word as f64 / 2f64.powi(63) - 1.0);
    let mut uniform = || draws.next().unwrap_or(0.0);
    let (mut x, mut rows) = ([0.0, 0.0], Vec::new());
    for _ in 0..300 {
        let u = uniform().signum();
        let w = [0.001 * uniform(), 0.001 * uniform()];
        let next = [0, 1].map(|i| A[2 * i] * x[0] + A[2 * i + 1] * x[1] + B[i] * u + w[i]);
        rows.extend([x[0], x[1], u, next[0], next[1]]);
        x = next;
    }

    // the model, and a region that misses the true one with probability 5 % at most: the noise is sub-Gaussian with a
    // covariance of 1e-6 I or less (Hoeffding), which is declared
    let size = rows.len() / (2 * n + m);
    let triangle = triangle(&rows, 2 * n + m, 1, &stop)?;
    let estimate = Estimate::new(Data { triangle: &triangle, size, n, m, offset: false, known: None }, &stop)?;
    let covariance = Covariance::Known(&[1e-6, 0.0, 0.0, 1e-6]);
    let assumed = Assumed { design: Design::Adaptive, noise: Noise::SubGaussian, covariance, tail: 0.0 };
    let sizes = Magnitudes::Expected(&[1.0, 1.0, 1.0]);
    let region = Region::from_data(&estimate, assumed, Wish::new(0.05), sizes, 1, &stop)?;

    // the gain that is best for the model, and what is proved of it for all of the region
    let (mut a, mut b) = (Vec::new(), Vec::new());
    for row in estimate.model.chunks_exact(n + m) {
        a.extend_from_slice(&row[..n]);
        b.extend_from_slice(&row[n..]);
    }
    let gain = least_squares(&a, &b, &[10.0, 0.0, 0.0, 1.0], &[0.1], n, m, &stop)?;
    let closed = Loop::new(&region, &gain.gain, &stop)?;
    let certificate = closed.certificate();
    println!("u = {:.3} position {:+.3} speed", gain.gain[0], gain.gain[1]);
    println!("{:?}: the model has a spectral radius of {:.3}", certificate.status, certificate.radius);

    // what goes wrong beside the data: any gain of the actuator in this interval
    let margins = closed.margins(None, &stop)?;
    println!("{:?}", margins.gains);
    assert_eq!(certificate.status, Verdict::Certified);
    Ok(())
}
