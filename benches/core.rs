//! Kernels of the core, timed by criterion: sampling, closed form, ALSE of matrices, SLSE, batched controls, simulated
//! runs, steps of a stream.

#![allow(clippy::disallowed_methods, clippy::disallowed_macros, reason = "benches may end where there is no memory")]

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use stochens::control::{Entity, Memory, Realized, pseudoinverse};
use stochens::fuse::{Fusion, Settings, WeightStatus, Weights, alse, closed_form, slse, slse_each};
use stochens::sample::multinomial_counts;
use stochens::simulate::{ClosedLoop, Drawn, Model, Second, mean_field, runs};
use stochens::streaming::{Budget, Config, Geometry, Order, Stream, StreamLaws};
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

/// Stores past the caches (non-temporal), if the architecture has them.
fn fill_nontemporal(out: &mut [f64], value: f64) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: eight borrowed bytes at a time, and a fence before they are read; SSE2, which every x86-64 has.
    unsafe {
        use std::arch::x86_64::{_mm_sfence, _mm_stream_si64};
        out.iter_mut().for_each(|to| _mm_stream_si64(std::ptr::from_mut(to).cast(), value.to_bits().cast_signed()));
        _mm_sfence();
    }
    #[cfg(not(target_arch = "x86_64"))]
    out.fill(value);
}

/// The limits of the machine, one operation each: random words, stores to memory, gathers from a small table.
fn limits(c: &mut Criterion) {
    let mut group = c.benchmark_group("limits");
    let mut words = vec![0u64; 1 << 14]; // 128 KiB, in the second-level cache, as a chunk of draws
    group.throughput(Throughput::Elements(words.len() as u64));
    group.bench_function("words", |b| b.iter(|| Key([1; 32]).words(0, black_box(&mut words))));
    let mut out = vec![0.0f64; 1 << 24]; // 128 MB: memory, not cache
    group.throughput(Throughput::Bytes(8 * out.len() as u64));
    group.bench_function("stores", |b| b.iter(|| black_box(&mut out).fill(black_box(1.5))));
    group.bench_function("stores past the caches", |b| {
        b.iter(|| fill_nontemporal(black_box(&mut out), black_box(1.5)));
    });
    let table: Vec<f64> = entries(256);
    let indices: Vec<u8> = (0..1usize << 16).map(|i| (i * 167 % 256) as u8).collect();
    group.throughput(Throughput::Elements(indices.len() as u64));
    group.bench_function("gathers", |b| {
        b.iter(|| {
            let (table, mut sums) = (black_box(&table), [0.0; 4]);
            for four in black_box(&indices).as_chunks::<4>().0 {
                for (sum, &r) in sums.iter_mut().zip(four) {
                    *sum += table[usize::from(r)];
                }
            }
            sums
        });
    });
    group.finish();
}

fn sampling(c: &mut Criterion) {
    let mut group = c.benchmark_group("sample");
    let vectors = [10, 100, 1000, 1_000_000].map(|length| (1, length, 1_000_000));
    for (lines, length, size) in vectors.into_iter().chain([(10, 10, 100_000), (100, 100, 10_000), (300, 300, 3000)]) {
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
                assert_eq!(fit.status, WeightStatus::Optimal);
                fit
            });
        });
    }
    group.finish();
}

/// Independent ensembles on threads: two threads should halve the time.
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
    for (n, m, size) in [(10, 2, 4_000_000), (10, 8, 2_000_000), (100, 10, 2_000_000), (100, 100, 400_000)] {
        let (vector, matrix) = (law(1, n), law(n, n));
        let p = pseudoinverse(&entries(n * m), n, m).expect("finite entries");
        let entity = |law| Entity::Singletons { draws: draw(law, size), rows: false };
        let realized = Realized::new(entity(&vector), entity(&vector), entity(&matrix), n).expect("fitting shapes");
        let mut out = vec![1.0; size * m];
        group.throughput(Throughput::Bytes((size * m * 8) as u64));
        group.bench_function(BenchmarkId::from_parameter(format!("n={n} m={m}")), |b| {
            b.iter(|| realized.controls_into(&p.matrix, m, &mut out, Memory::Used, 1, &Stop::new()));
        });
        group.bench_function(BenchmarkId::new("fill", format!("m={m}")), |b| {
            b.iter(|| black_box(&mut out).fill(1.0));
        });
    }
    group.finish();
}

/// `x(k+1) = A x(k) + B u(k)` with n = 100 states over 10 steps; throughput in runs and steps.
fn simulating(c: &mut Criterion) {
    let (n, steps, size) = (100, 10, 10_000);
    let (drawn, key, stop) = (Drawn { a: true, b: true, x0: true }, Key([1; 32]), Stop::new());
    let matrix = |lines| Law::new(entries(lines * n).iter().map(|v| v / 100.0).collect(), lines, n).expect("finite");
    let mut group = c.benchmark_group("simulate");
    for (name, m, input) in [("m = 1", 1, 1.0), ("m = 10", 10, 1.0), ("m = 100", 100, 1.0), ("no input", 1, 0.0)] {
        let model = Model::new(matrix(n), matrix(m), matrix(1), vec![input; steps * m]).expect("fitting shapes");
        group.throughput(Throughput::Elements((size * steps) as u64));
        group.bench_function(BenchmarkId::new("runs", name), |b| {
            b.iter(|| runs(black_box(&model), drawn, size, Second::Diagonal, false, &key, 1, &stop));
        });
        if m == 10 {
            group.bench_function(BenchmarkId::new("runs, full covariance", name), |b| {
                b.iter(|| runs(black_box(&model), drawn, size, Second::Full, false, &key, 1, &stop));
            });
            group.throughput(Throughput::Elements(steps as u64));
            group.bench_function(BenchmarkId::new("mean field of 10^6", name), |b| {
                b.iter(|| mean_field(black_box(&model), drawn, 1_000_000, 1, Second::Diagonal, false, &key, 1, &stop));
            });
        }
    }
    group.finish();
}

/// 16 runs along a reference of 100 steps with n = 20 states: counts of `A` at every step; throughput in runs and steps.
fn following(c: &mut Criterion) {
    let (n, m, steps, runs) = (20, 10, 100, 16);
    let matrix = |lines| Law::new(entries(lines * n).iter().map(|v| v / 10.0).collect(), lines, n).expect("finite");
    let (b, reference) = (matrix(m), entries((steps + 1) * n));
    let rows: Vec<f64> = (0..n * m).map(|at| b.line(at % m)[at / m]).collect();
    let factors = pseudoinverse(&rows, n, m).expect("finite entries");
    let given = ClosedLoop {
        a: matrix(n).into(),
        b,
        x0: &reference[..n],
        reference: &reference,
        basis: &factors.basis,
        right: &factors.right,
        singular_values: &factors.singular_values[..factors.rank],
        size: 10_000,
        method: Fusion::Uniform,
        feedback: false,
        sample_states: false,
    };
    let mut group = c.benchmark_group("closed loop");
    group.throughput(Throughput::Elements((runs * steps) as u64));
    for threads in [1, 2] {
        group.bench_function(BenchmarkId::new("threads", threads), |bench| {
            bench.iter(|| given.run(runs, &Key([1; 32]), threads, &Stop::new()));
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
            let laws = StreamLaws { x0: entries(n), xf: entries(n), a: entries(n * n), keys };
            let config = Config { safeguard, order: Order::Random };
            let mut stream = Stream::new(geometry, laws, config).expect("fitting shapes");
            let limits = Budget { steps, tolerance: None, deadline: None };
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
    targets = limits, sampling, fusing, least_squares, replicates, controls, simulating, following, streaming
}
criterion_main!(benches);
