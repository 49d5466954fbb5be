//! Test instances: a small random number generator, random laws, samples.
#![allow(dead_code)]

use crate::fuse::simplex::{IndexView, Options, SingletonProblem, Solution};
use crate::parallel::Stop;

/// xoshiro256++ seeded by splitmix64.
pub struct Rng([u64; 4]);

impl Rng {
    pub fn new(seed: u64) -> Self {
        let mut x = seed;
        let mut next = || {
            x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = x;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        };
        Self([next(), next(), next(), next()])
    }

    pub fn u64(&mut self) -> u64 {
        let s = &mut self.0;
        let out = s[0].wrapping_add(s[3]).rotate_left(23).wrapping_add(s[0]);
        let t = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= t;
        s[3] = s[3].rotate_left(45);
        out
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.u64()) * n as u128) >> 64) as usize
    }

    pub fn normal(&mut self) -> f64 {
        let (u, v) = (1.0 - self.uniform(), self.uniform());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

/// An instance in sign-free form, with 32-bit indices.
#[derive(Clone)]
pub struct Instance {
    pub indices: Vec<u32>,
    pub size: usize,
    pub lines: usize,
    pub length: usize,
    pub g: Vec<f64>,
    pub target: Vec<f64>,
}

impl Instance {
    /// Samples from the law of the nonnegative line-major matrix `e`.
    pub fn sample(e: Vec<f64>, lines: usize, length: usize, size: usize, rng: &mut Rng) -> Self {
        let g: Vec<f64> = e.chunks(length).map(|l| l.iter().sum()).collect();
        let mut cumulative = e.clone();
        for line in cumulative.chunks_mut(length) {
            for r in 1..length {
                line[r] += line[r - 1];
            }
        }
        let mut indices = Vec::with_capacity(size * lines);
        for _ in 0..size {
            for (j, line) in cumulative.chunks(length).enumerate() {
                if g[j] == 0.0 {
                    indices.push(0);
                    continue;
                }
                let u = rng.uniform() * line[length - 1];
                let mut r = line.partition_point(|&c| c <= u).min(length - 1);
                while e[j * length + r] == 0.0 {
                    r -= 1;
                }
                indices.push(r as u32);
            }
        }
        Self { indices, size, lines, length, g, target: e }
    }

    pub fn gaussian(n: usize, size: usize, seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let e = (0..n * n).map(|_| rng.normal().abs()).collect();
        Self::sample(e, n, n, size, &mut rng)
    }

    pub fn problem(&self) -> SingletonProblem<'_> {
        SingletonProblem::new(IndexView::U32(&self.indices), self.size, self.lines, self.length, &self.g, &self.target)
            .unwrap()
    }

    pub fn narrow(&self) -> Vec<u8> {
        self.indices.iter().map(|&r| r as u8).collect()
    }

    pub fn solve(&self, options: &Options) -> Solution {
        crate::fuse::simplex::solve(&self.problem(), options, None, &Stop::new()).unwrap()
    }

    pub fn dense(&self) -> Vec<f64> {
        let d = self.lines * self.length;
        let mut s = vec![0.0; self.size * d];
        for i in 0..self.size {
            for j in 0..self.lines {
                s[i * d + j * self.length + self.indices[i * self.lines + j] as usize] = self.g[j];
            }
        }
        s
    }
}

/// Objective and gap by plain formulas, nothing shared with the solver: `(f, gap)`, for the simplex or the subsimplex.
pub fn recompute(x: &Instance, w: &[f64], subsimplex: bool) -> (f64, f64) {
    let mut r: Vec<f64> = x.target.iter().map(|t| -t).collect();
    for i in 0..x.size {
        for j in 0..x.lines {
            r[j * x.length + x.indices[i * x.lines + j] as usize] += w[i] * x.g[j];
        }
    }
    let f: f64 = r.iter().map(|v| v * v).sum();
    let at: f64 = r.iter().zip(&x.target).map(|(r, t)| r * (r + t)).sum();
    let mut low = if subsimplex { 0.0 } else { f64::INFINITY };
    for i in 0..x.size {
        let v: f64 = (0..x.lines).map(|j| x.g[j] * r[j * x.length + x.indices[i * x.lines + j] as usize]).sum();
        low = f64::min(low, v);
    }
    (f, 2.0 * (at - low))
}
