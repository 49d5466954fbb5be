//! Kernels of the core, timed by criterion: sampling, closed form, SLSE, batched controls, steps of a stream.

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use stochens::control::{Entity, Realized, pseudoinverse};
use stochens::fuse::{Weights, closed_form, slse};
use stochens::sample::multinomial_counts;
use stochens::streaming::{Config, Geometry, Laws, Limits, Order, Stream, Variant};
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

fn controls(c: &mut Criterion) {
    let mut group = c.benchmark_group("controls");
    for (n, m, size) in [(10, 2, 100_000), (100, 10, 100_000), (100, 80, 20_000)] {
        let (vector, matrix) = (law(1, n), law(n, n));
        let p = pseudoinverse(&entries(n * m), n, m).expect("finite entries");
        let entity = |law| Entity::Singletons { draws: draw(law, size), rows: false };
        let realized = Realized::new(entity(&vector), entity(&vector), entity(&matrix), n).expect("fitting shapes");
        group.throughput(Throughput::Bytes((size * m * 8) as u64));
        group.bench_function(BenchmarkId::from_parameter(format!("n={n} m={m}")), |b| {
            b.iter(|| realized.controls(&p.matrix, m, 1, &Stop::new()));
        });
    }
    group.finish();
}

fn streaming(c: &mut Criterion) {
    let mut group = c.benchmark_group("stream");
    for (n, steps) in [(10, 20_000u64), (100, 2000), (1000, 200)] {
        for safeguard in [false, true] {
            let m = n / 2;
            let geometry = Geometry::new(entries(n * m), n, m).expect("finite entries");
            let keys = [1, 2, 3, 4].map(|k| Key([k; 32]));
            let laws = Laws { x0: entries(n), xf: entries(n), a: entries(n * n), keys };
            let config = Config { variant: Variant::Consistent, safeguard, order: Order::Random };
            let mut stream = Stream::new(geometry, laws, config).expect("fitting shapes");
            let limits = Limits { steps, tolerance: None, deadline: None };
            group.throughput(Throughput::Elements(steps));
            let name = if safeguard { "safeguarded" } else { "plain" };
            group.bench_function(BenchmarkId::new(name, n), |b| b.iter(|| stream.advance(&limits, &Stop::new())));
        }
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20).measurement_time(std::time::Duration::from_secs(2));
    targets = sampling, fusing, controls, streaming
}
criterion_main!(benches);
