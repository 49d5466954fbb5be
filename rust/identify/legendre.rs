//! The rule of Gauss and Legendre.

use std::f64::consts::PI;

use crate::error::Result;
use crate::memory::{checked_len, try_filled, try_zeros};

const WHAT: &str = "the nodes of an integral";

/// Nodes and weights of Gauss and Legendre on [-1, 1].
pub(super) fn gauss_legendre(size: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    let rule = Rule::new(size)?;
    Ok((rule.nodes, rule.weights))
}

/// Nodes and weights of Gauss and Legendre on [-1, 1], and Legendre's polynomials at the nodes (node by node).
pub(super) struct Rule {
    pub nodes: Vec<f64>,
    pub weights: Vec<f64>,
    pub legendre: Vec<f64>,
}

impl Rule {
    pub fn new(size: usize) -> Result<Self> {
        let (mut nodes, mut weights) = (try_zeros(WHAT, size)?, try_zeros(WHAT, size)?);
        for i in 0..size.div_ceil(2) {
            // Newton's method from the asymptotic node
            let mut x = (PI * (i as f64 + 0.75) / (size as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..20 {
                let (mut value, mut before) = (1.0, 0.0);
                for l in 0..size {
                    let l = l as f64;
                    (value, before) = (((2.0 * l + 1.0) * x * value - l * before) / (l + 1.0), value);
                }
                slope = size as f64 * (x * value - before) / (x * x - 1.0);
                let step = value / slope;
                x -= step;
                if step.abs() < 1e-15 {
                    break;
                }
            }
            if 2 * i + 1 == size {
                x = 0.0;
            }
            let weight = 2.0 / ((1.0 - x * x) * slope * slope);
            (nodes[i], nodes[size - 1 - i]) = (-x, x);
            (weights[i], weights[size - 1 - i]) = (weight, weight);
        }
        let mut legendre = try_filled(WHAT, 1.0, checked_len(WHAT, size, size)?)?;
        for (x, line) in nodes.iter().zip(legendre.chunks_exact_mut(size)) {
            line[1] = *x;
            for l in 1..size - 1 {
                let k = l as f64;
                line[l + 1] = ((2.0 * k + 1.0) * x * line[l] - k * line[l - 1]) / (k + 1.0);
            }
        }
        Ok(Self { nodes, weights, legendre })
    }
}
