//! Random instances of many kinds: no gap above tolerance, certificate confirmed by plain formulas.
use super::common::{Instance, Rng, recompute};
use crate::fuse::simplex::{Options, WeightStatus};

/// One random instance: size 1-24, N/dimension 0.3-40, column scales, heavy tails, duplicates, foreign targets.
pub fn random(seed: u64) -> Instance {
    let mut rng = Rng::new(seed);
    let (length, lines) = (1 + rng.below(24), 1 + rng.below(24));
    let dimension = (lines * (length - 1)).max(1);
    let ratio = (0.3_f64.ln() + rng.uniform() * (40.0_f64 / 0.3).ln()).exp();
    let size = ((ratio * dimension as f64) as usize).max(1);
    let exponent = [0.0, 0.0, 1.0, 2.0, 4.0][rng.below(5)];
    let heavy = rng.below(3) == 0;
    let sparse = rng.below(4) == 0;
    let mut e = vec![0.0; lines * length];
    for line in e.chunks_mut(length) {
        let scale = 10f64.powf(exponent * (2.0 * rng.uniform() - 1.0));
        for v in line.iter_mut() {
            let z = rng.normal().abs();
            *v = scale * if heavy { z * z * z } else { z };
            if sparse && rng.below(2) == 0 {
                *v = 0.0;
            }
        }
        if rng.below(20) == 0 {
            line.fill(0.0);
        }
    }
    let mut x = Instance::sample(e, lines, length, size, &mut rng);
    if rng.below(5) == 0 {
        // duplicates: every sample is one of the first few
        let few = 1 + rng.below(1 + size / 2);
        for i in few..size {
            let k = rng.below(few);
            for j in 0..lines {
                x.indices[i * lines + j] = x.indices[k * lines + j];
            }
        }
    }
    // A third of the targets are not the matrix that was sampled: other signs, noise, one of the realizations, another
    // matrix.
    match rng.below(12) {
        0 => x.target.iter_mut().for_each(|t| *t *= if rng.below(2) == 0 { -1.0 } else { 1.0 }),
        1 => x.target.iter_mut().for_each(|t| *t += 0.3 * rng.normal()),
        2 => {
            let other = rng.below(size);
            x.target.fill(0.0);
            for j in 0..lines {
                let r = x.indices[other * lines + j] as usize;
                x.target[j * length + r] = x.g[j];
            }
        }
        3 => x.target.iter_mut().for_each(|t| *t = rng.normal() * (1.0 + t.abs())),
        _ => {}
    }
    x
}

fn check(seed: u64, options: &Options) {
    let x = random(seed);
    let s = x.solve(options);
    let total: f64 = s.weights.iter().sum();
    assert!(s.weights.iter().all(|w| *w >= 0.0));
    if options.subsimplex {
        assert!(total <= 1.0 + 1e-12);
    } else {
        assert!((total - 1.0).abs() < 1e-12, "seed {seed}: sum {total}");
    }
    let mut reference: f64 = x.target.iter().map(|t| t * t).sum();
    let gamma: f64 = x.g.iter().map(|g| g * g).sum();
    if reference == 0.0 {
        reference = gamma;
    }
    let (f, gap) = recompute(&x, &s.weights, options.subsimplex);
    let rounding = 1e-13 * (reference + gamma);
    assert!((f - s.objective).abs() <= rounding, "seed {seed}: objective {f} {}", s.objective);
    assert!((gap - s.gap).abs() <= rounding, "seed {seed}: gap {gap} {}", s.gap);
    assert!(s.lower_bound <= s.objective && s.lower_bound >= s.objective - s.gap - rounding);
    let context = format!("seed {seed}: {} x {}, N = {}: {:?}", x.length, x.lines, x.size, s.info);
    assert_eq!(s.status, WeightStatus::Optimal, "{context}");
}

#[test]
fn a_thousand_random_instances_reach_the_tolerance() {
    (0..1500).for_each(|seed| check(seed, &Options::default()));
}

#[test]
fn three_hundred_subsimplex_instances_reach_the_tolerance() {
    (5000..5300).for_each(|seed| check(seed, &Options { subsimplex: true, ..Options::default() }));
}
