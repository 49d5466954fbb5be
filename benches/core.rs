//! Kernels of the core, timed by criterion: sampling, closed form, ALSE of matrices, SLSE, batched controls.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use stochens::control::{Entity, Realized, pseudoinverse};
use stochens::fuse::{Settings, Status, Weights, alse, closed_form, slse, slse_each};
use stochens::sample::multinomial_counts;
use stochens::{Key, Law, Scheme, Singletons, Stop, sample};

/// Entries of both signs and unequal magnitudes, the same in every run.
fn entries(count: usize) -> Vec<f64> {
    (0..count).map(|i| (1.0 + (i as f64 * 0.754_877).fract()) * if i % 3 == 0 { -1.0 } else { 1.0 }).collect()
}

fn law(lines: usize, length: usize) -> Arc<Law> {
    Arc::new(Law::new(entries(lines * length), lines, length).expect("finite entries"))
}

fn draw(law: &Arc<Law>, size: usize) -> Singletons {
    sample(law, size, Scheme::Iid, &Key([1; 32]), 1, &Stop::new()).expect("fits into memory")
}

fn sampling(c: &mut Criterion) {
    let mut group = c.benchmark_group("sample");
    for (lines, length, size) in [(1, 10, 1_000_000), (1, 100, 1_000_000), (1, 1000, 1_000_000), (100, 100, 10_000)] {
        let law = law(lines, length);
        group.throughput(Throughput::Elements((size * lines) as u64));
        group.bench_function(BenchmarkId::from_parameter(format!("{lines}x{length}")), |b| b.iter(|| draw(&law, size)));
    }
    group.finish();
    let law = law(100, 100);
    c.bench_function("counts of 10^12 realizations, 100x100", |b| {
        b.iter(|| multinomial_counts(&law, 1_000_000_000_000, &Key([1; 32]), &Stop::new()));
    });
}

fn fusing(c: &mut Criterion) {
    let law1 = law(1, 100);
    let vector = draw(&law1, 100_000);
    c.bench_function("closed form, n = 100, N = 10^5", |b| {
        b.iter(|| closed_form(black_box(&vector), law1.values(), Weights::Simplex, &Stop::new()));
    });
    let mut group = c.benchmark_group("slse");
    for n in [10, 100, 500] {
        let law = law(n, n);
        let size = 200_000 / n;
        let matrix = draw(&law, size);
        group.throughput(Throughput::Elements(size as u64));
        for safeguard in [false, true] {
            let name = if safeguard { "safeguarded" } else { "plain" };
            group.bench_function(BenchmarkId::new(name, n), |b| {
                b.iter(|| slse(&matrix, law.values(), safeguard, &[size], false, &Stop::new()));
            });
        }
    }
    group.finish();
}

/// Normal variates by Box-Muller on a low-discrepancy sequence: rare entries make ALSE ill conditioned, as in real data.
fn normal(count: usize) -> Vec<f64> {
    let uniform = |i: usize, step: f64| (0.5 + i as f64 * step).fract().max(1e-12);
    (0..count)
        .map(|i| {
            (-2.0 * uniform(i, 0.754_877_666).ln()).sqrt() * (std::f64::consts::TAU * uniform(i, 0.569_840_291)).cos()
        })
        .collect()
}

fn least_squares(c: &mut Criterion) {
    let mut group = c.benchmark_group("alse");
    group.sample_size(10);
    for (n, size) in [(10, 500), (30, 900), (30, 3000), (100, 1000), (100, 3000)] {
        let law = Arc::new(Law::new(normal(n * n), n, n).expect("finite entries"));
        let matrix = draw(&law, size);
        let settings = Settings::new(Weights::Simplex, 1e-9);
        group.bench_function(BenchmarkId::from_parameter(format!("{n}x{n}, N = {size}")), |b| {
            b.iter(|| {
                let fit = alse(&matrix, law.values(), &settings, &Stop::new()).expect("a posed problem");
                assert_eq!(fit.status, Status::Optimal);
                fit
            });
        });
    }
    group.finish();
}

/// Independent ensembles on threads: how close two of them come to half the time.
fn replicates(c: &mut Criterion) {
    let mut group = c.benchmark_group("slse_replicates");
    let law = law(30, 30);
    let draw = |seed| sample(&law, 5000, Scheme::Iid, &Key([seed; 32]), 1, &Stop::new()).expect("fits into memory");
    let ensembles: Vec<_> = (0..16).map(|seed| (draw(seed), law.values())).collect();
    group.throughput(Throughput::Elements(16 * 5000));
    for threads in [1, 2] {
        group.bench_function(BenchmarkId::new("threads", threads), |b| {
            b.iter(|| slse_each(&ensembles, false, &[5000], false, threads, &Stop::new()));
        });
    }
    group.finish();
}

/// Into memory that was used before; `fill` is the same number of bytes and nothing else.
fn controls(c: &mut Criterion) {
    let mut group = c.benchmark_group("controls");
    for (n, m, size) in [(10, 2, 1_000_000), (10, 8, 500_000), (100, 10, 200_000), (100, 80, 50_000)] {
        let (vector, matrix) = (law(1, n), law(n, n));
        let p = pseudoinverse(&entries(n * m), n, m).expect("finite entries");
        let entity = |law| Entity::Singletons { draws: draw(law, size), rows: false };
        let realized = Realized::new(entity(&vector), entity(&vector), entity(&matrix), n).expect("fitting shapes");
        let mut out = vec![1.0; size * m];
        group.throughput(Throughput::Bytes((size * m * 8) as u64));
        group.bench_function(BenchmarkId::from_parameter(format!("n={n} m={m}")), |b| {
            b.iter(|| realized.controls_into(&p.matrix, m, &mut out, 1, &Stop::new()));
        });
        group.bench_function(BenchmarkId::new("fill", format!("m={m}")), |b| {
            b.iter(|| black_box(&mut out).fill(1.0));
        });
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2));
    targets = sampling, fusing, least_squares, replicates, controls
}
criterion_main!(benches);
