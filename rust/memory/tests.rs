//! Failing allocations must not abort. The k-th allocation fails, for k = 1, 2, 3, ..., until the call succeeds (as in
//! the tests of SQLite). A failure that is not handled aborts, so each call runs in its own process.

#![allow(unsafe_code, reason = "an allocator is unsafe by its trait; this one hands everything to the system's")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::certificate::{
    Endpoints, Gaussian, Goal, NextRuns, PlannedRun, ToCome, Way, certify, drawn_misses, next_runs,
};
use crate::control::{Entity, Factors, Motion, Realized, best_control, pseudoinverse};
use crate::fuse::{self, Dense, Settings, Weights};
use crate::identify;
use crate::limits::{self, Bounds, Penalty, Rows, Steps, Until};
use crate::matrix::MatrixView;
use crate::region::{Part, PartOf, Region};
use crate::sample::{multinomial_counts, systematic_counts};
use crate::simulate::{self, Average, Drawn, Exact, Model, PlanEntity, Plans, Second, mean_field, runs};
use crate::storage::{self, Saved, Section, Sections, Values};
use crate::streaming::{Budget, Config, DataStream, Geometry, Order, Rule, Stream, StreamLaws};
use crate::tails::Norm;
use crate::{Key, Law, Scheme, Singletons, Stop, sample};

/// Smallest allocation that can fail, in bytes. The tested arrays are larger; everything of bounded size (messages,
/// names, channels and handles of threads) is smaller.
const SMALLEST: usize = 1000;

struct Failing;

#[global_allocator]
static FAILING: Failing = Failing;

/// Allocations of at least [`SMALLEST`] bytes so far, and the first and last of them that fail.
static SEEN: AtomicUsize = AtomicUsize::new(0);
static FIRST: AtomicUsize = AtomicUsize::new(usize::MAX);
static LAST: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    static BYTES: Cell<usize> = const { Cell::new(0) };
    /// inside of [`covered`]: bytes held now, and at most, above those at its beginning
    static HELD: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
    static COVERED: Cell<bool> = const { Cell::new(false) };
}

fn asked(bytes: usize) -> bool {
    BYTES.set(BYTES.get().saturating_add(bytes));
    if COVERED.get() {
        HELD.set(HELD.get().saturating_add_unsigned(bytes));
        PEAK.set(PEAK.get().max(HELD.get()));
        return true;
    }
    let first = FIRST.load(Ordering::Relaxed);
    if bytes < SMALLEST || first == usize::MAX {
        return true;
    }
    let number = SEEN.fetch_add(1, Ordering::Relaxed) + 1;
    number < first || number > LAST.load(Ordering::Relaxed)
}

fn returned(bytes: usize) {
    if COVERED.get() {
        HELD.set(HELD.get().saturating_sub_unsigned(bytes));
    }
}

// SAFETY: every call goes to the system's allocator as it came, or fails.
unsafe impl GlobalAlloc for Failing {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if asked(layout.size()) { unsafe { System.alloc(layout) } } else { std::ptr::null_mut() }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        returned(layout.size());
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if asked(layout.size()) { unsafe { System.alloc_zeroed(layout) } } else { std::ptr::null_mut() }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        if !asked(size) {
            return std::ptr::null_mut();
        }
        returned(layout.size());
        unsafe { System.realloc(pointer, layout, size) }
    }
}

/// The result of `work`, and the bytes it asked for on this thread, given back or not.
pub(crate) fn counted<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = BYTES.get();
    let result = work();
    (result, BYTES.get() - before)
}

#[test]
fn the_count_counts() {
    let (bytes, asked) = counted(|| vec![1u8; 1000]);
    assert_eq!((bytes.len(), asked), (1000, 1000));
}

/// While it lives, allocations of this thread do not fail; when it ends, it panics if they were larger than foreseen.
pub(super) struct Cover(usize);

impl Cover {
    pub(super) fn watch(bytes: usize) -> Self {
        HELD.set(0);
        PEAK.set(0);
        COVERED.set(true);
        Self(bytes)
    }
}

impl Drop for Cover {
    fn drop(&mut self) {
        COVERED.set(false);
        let (peak, foreseen) = (PEAK.get(), self.0);
        assert!(std::thread::panicking() || peak <= foreseen as isize, "{peak} bytes where {foreseen} were foreseen");
    }
}

#[test]
#[should_panic(expected = "bytes where 100 were foreseen")]
fn a_cover_that_is_too_small_is_noticed() {
    covered("a test", 100, || vec![1u8; 101]).unwrap();
}

/// Entries of both signs, every fifth zero.
fn entries(len: usize) -> Vec<f64> {
    (0..len).map(|i| if i % 5 == 3 { 0.0 } else { (i as f64 * 2.399).sin() }).collect()
}

fn draws(lines: usize, length: usize, size: usize) -> Singletons {
    let law = Law::new(entries(lines * length), lines, length).unwrap();
    sample(&law.into(), size, Scheme::Iid, &Key([7; 32]), 1, &Stop::new()).unwrap()
}

type Call = Box<dyn Fn() -> Result<()>>;

/// Every public function of the core, with arrays above [`SMALLEST`].
fn call(name: &str) -> Option<Call> {
    const N: usize = 150;
    let (key, stop) = (Key([3; 32]), Stop::new());
    let square = || Arc::new(Law::new(entries(N * N), N, N).unwrap());
    let settings = |set| Settings { max_passes: Some(60), threads: 2, ..Settings::new(set, 1e-12) };
    // few realizations per dimension, some, and many
    let (few, some, many) = (|| draws(8, 150, 1001), || draws(6, 40, 1001), || draws(2, 40, 1003));
    let alse = |draws: Singletons, set| -> Call {
        let stop = Stop::new();
        Box::new(move || fuse::alse(&draws, draws.law().values(), &settings(set), &stop).map(drop))
    };
    let model = |steps: usize| -> Model {
        let law = |lines: usize| Law::new(entries(lines * N), lines, N).unwrap();
        Model::new(law(N), law(2), law(1), entries(2 * steps)).unwrap()
    };
    let all = Drawn { a: true, b: true, x0: true };
    let simulated = |second, drawn| -> Call {
        let (model, stop) = (model(70), Stop::new());
        Box::new(move || runs(&model, drawn, 5, second, true, &key, 2, &stop).map(drop))
    };
    let stream = |safeguard, order| -> Call {
        let stop = Stop::new();
        Box::new(move || {
            let copy = |len| try_copy("an input", entries_of(len));
            let laws = StreamLaws { x0: copy(N)?, xf: copy(N)?, a: copy(N * N)?, keys: [key; 4] };
            let geometry = Geometry::new(copy(2 * N)?, N, 2)?;
            let mut stream = Stream::new(geometry, laws, Config { safeguard, order })?;
            let limits = Budget { steps: 2500, tolerance: Some((Rule::Certificate, 0.0)), deadline: None };
            let _ = stream.advance(&limits, &stop)?;
            let _ =
                stream.advance(&Budget { steps: 3, tolerance: Some((Rule::Printed, 0.0)), deadline: None }, &stop)?;
            let _ = (stream.control()?, stream.estimates()?, stream.residuals()?, stream.certificate()?);
            Stream::from_sections(stream.to_sections()?).map(drop)
        })
    };
    Some(match name {
        "sample" => {
            let law = square();
            Box::new(move || sample(&law, 200, Scheme::Iid, &key, 2, &stop).map(drop))
        }
        "systematic" => {
            let law = square();
            Box::new(move || sample(&law, 1001, Scheme::Systematic, &key, 2, &stop).map(drop))
        }
        "counts" => {
            let law = square();
            Box::new(move || {
                systematic_counts(&law, 1 << 40, &key)?;
                multinomial_counts(&law, 1 << 40, &key, &stop).map(drop)
            })
        }
        "combine" => {
            let (draws, weights) = (few(), vec![1e-3; 1001]);
            Box::new(move || {
                draws.combine(&weights, &stop)?;
                draws.correlate(draws.law().values())?;
                fuse::uniform(draws.law(), &draws.counts(&stop)?, 1001).map(drop)
            })
        }
        "closed form" => {
            let draws = few();
            Box::new(move || {
                fuse::closed_form(&draws, draws.law().values(), Weights::Subsimplex, &stop)?;
                fuse::closed_form(&draws, draws.law().values(), Weights::Simplex, &stop).map(drop)
            })
        }
        "alse of few" => alse(few(), Weights::Simplex),
        "alse of some" => alse(some(), Weights::Simplex),
        "alse of many" => alse(many(), Weights::Subsimplex),
        "alse of one line" => alse(draws(1, 150, 1001), Weights::Subsimplex),
        "alse dense" => {
            let samples = entries(300 * 150);
            Box::new(move || {
                let dense = Dense::new(&samples, 300, 150)?;
                fuse::alse(&dense, &samples[..150], &settings(Weights::Simplex), &stop).map(drop)
            })
        }
        "alse of prefixes" => {
            let draws = some();
            Box::new(move || {
                let settings = settings(Weights::Simplex);
                fuse::alse_prefixes(&draws, draws.law().values(), &settings, &[300, 600], &stop, |_| Ok(()))
            })
        }
        "second opinion" => {
            let draws = draws(6, 40, 200);
            Box::new(move || {
                let settings = settings(Weights::Simplex);
                fuse::second_opinion(&draws, draws.law().values(), &settings, &stop).map(drop)
            })
        }
        "slse" | "slse safeguarded" => {
            let (small, large, safeguard) = (some(), few(), name != "slse");
            Box::new(move || {
                fuse::slse(&small, small.law().values(), safeguard, &[5, 1001], true, &stop)?;
                fuse::slse(&large, large.law().values(), safeguard, &[1001], false, &stop).map(drop)
            })
        }
        "slse dense" => {
            let samples = entries(200 * 150);
            Box::new(move || {
                let dense = Dense::new(&samples, 200, 150)?;
                fuse::uniform_dense(&dense, &samples[..150], &[5, 200], true, &stop)?;
                fuse::slse_dense(&dense, &samples[..150], true, &[5, 200], true, &stop).map(drop)
            })
        }
        "paths" => {
            let draws = few();
            Box::new(move || {
                let values = draws.law().values();
                fuse::uniform_path(&draws, values, &[5, 1001], true, &stop)?;
                fuse::alse_path(&draws, values, Weights::Simplex, &[5, 1001], true, &stop).map(drop)
            })
        }
        "pseudoinverse" => {
            let b = entries(150 * 20);
            Box::new(move || pseudoinverse(&b, 150, 20).map(drop))
        }
        "best control" => {
            let (a, b, x) = (entries(30 * 30), entries(30 * 2), entries(30));
            Box::new(move || {
                let p = pseudoinverse(&b, 30, 2)?;
                let factors =
                    Factors { basis: &p.basis, right: &p.right, singular_values: &p.singular_values, gap: 0.1 };
                let motion = Motion { a: &a, b: &b, n: 30, m: 2, steps: 1 };
                best_control(&motion, &factors, &x, &x, &stop).map(drop)
            })
        }
        "limits" | "limits of steps" => {
            let (one, steps) = (entries(N * N), name == "limits of steps");
            let ill: Vec<f64> = one.iter().enumerate().map(|(i, v)| v * 0.8f64.powi((i % N) as i32)).collect();
            let (low, high) = (vec![-0.1; N], vec![0.1; N]);
            let identity: Vec<f64> = (0..N * N).map(|i| f64::from(u8::from(i % (N + 1) == 0))).collect();
            let wide: Vec<f64> = (0..N).map(|i| if i % 2 == 0 { f64::INFINITY } else { 0.1 }).collect();
            Box::new(move || {
                let until = || Until::new(&stop, None);
                let (zero, bounds, open) = ([0.0; N], Bounds::new(&low, &high, N)?, Bounds::new(&low, &wide, N)?);
                if steps {
                    let (a, b) = (&[0.5, 1.0, 0.0, 0.7], &[0.0, 1.0]);
                    let (stage, terminal, r) = (&[1.0, 0.0, 0.0, 1.0], &[1.0, 0.0, 0.0, 1.0], &[0.01]);
                    let horizon = Steps { a, b, x0: &one[..2], reference: &one[..2 * N], stage, terminal, r };
                    let _ = limits::horizon_control(&horizon, bounds, None, until())?;
                    return limits::horizon_control(&horizon, open, None, until()).map(drop);
                }
                let _ = limits::box_control(&ill, &one[..N], Penalty::Diagonal(&zero), open, None, until())?;
                let _ = limits::box_control(&one, &one[..N], Penalty::Full(&identity), bounds, None, until())?;
                let goal = (&one[..2 * N], &one[..N]);
                let penalty = Penalty::Diagonal(&[0.1; N]);
                let mut solver = limits::Solver::new(&one, penalty, bounds, 2, goal, &stop)?;
                solver.solve(&one[..2], until())?;
                limits::box_batch(&one, &one[..2 * N], 2, penalty, bounds, true, 2, &stop)?;
                let small = Bounds::new(&low[..5], &high[..5], 5)?;
                let penalty = Penalty::Diagonal(&[0.0; 5]);
                limits::box_batch(&one[..50], &one[..5000], 500, penalty, small, true, 2, &stop).map(drop)
            })
        }
        "limits of rows" => {
            let (one, low, high) = (entries(2 * N), vec![-1.0; 2 * N], vec![1.0; 2 * N]);
            Box::new(move || {
                let until = || Until::new(&stop, None);
                let (stage, terminal, r) = (&[1.0, 0.0, 0.0, 1.0], &[1.0, 0.0, 0.0, 1.0], &[0.01]);
                let (a, b) = (&[0.5, 1.0, 0.0, 0.7], &[0.0, 1.0]);
                let horizon = Steps { a, b, x0: &one[..2], reference: &one, stage, terminal, r };
                let bounds = Bounds::new(&low[..N], &high[..N], N)?;
                let rate = Some((&[0.3][..], &[0.0][..]));
                let soft = Rows { rate, states: Some((&low, &high)), soft: Some(2.0), grows: false };
                let _ = limits::rows_control(&horizon, bounds, soft, until())?;
                let hard = Rows { states: Some((&high, &high)), soft: None, ..soft };
                limits::rows_control(&horizon, bounds, hard, until()).map(drop)
            })
        }
        "controls" => {
            let (a, x0, xf, pinv) = (draws(150, 150, 130), draws(1, 150, 130), entries(150), entries(2 * 150));
            let dense = entries(130 * 150);
            Box::new(move || {
                let picks = |draws: &Singletons| Entity::Singletons { draws: draws.clone(), rows: false };
                let realized = Realized::new(picks(&x0), Entity::Exact(&xf), picks(&a), 150)?;
                realized.controls(&pinv, 2, 2, &stop)?;
                realized.mean(&stop)?;
                let states = Entity::Dense(Dense::new(&dense, 130, 150)?);
                let realized = Realized::new(states, Entity::Exact(&xf), picks(&a), 150)?;
                realized.controls(&pinv, 2, 2, &stop).map(drop)
            })
        }
        "trajectory" => {
            let model = model(70);
            Box::new(move || model.trajectory(&stop).map(drop))
        }
        "runs" => simulated(Second::Diagonal, all),
        "runs with covariance" => simulated(Second::Full, Drawn { b: false, ..all }),
        "mean field" => {
            let model = model(2);
            Box::new(move || mean_field(&model, all, 100, 2, Second::Diagonal, true, &key, 2, &stop).map(drop))
        }
        "estimate errors" => {
            let (b, scheme) = (entries(N * N), Scheme::Iid);
            Box::new(move || {
                let law = Law::new(try_copy("an input", &b)?, N, N)?;
                let average = Average::new(law, 100, scheme)?;
                simulate::estimate_errors(&average, Norm::Frobenius, 200, &key, 2, &stop)?;
                simulate::estimate_errors(&average, Norm::Spectral, 2, &key, 2, &stop).map(drop)
            })
        }
        "plan errors" => {
            let (x, a, b, c) = (entries(N), entries(N * N), entries(2 * N), entries(4 * N));
            Box::new(move || {
                let copy = |values: &[f64]| try_copy("an input", values);
                let average = |values: &[f64], lines| -> Result<PlanEntity> {
                    Ok(PlanEntity::Drawn(Average::new(Law::new(copy(values)?, lines, N)?, 100, Scheme::Systematic)?))
                };
                for (several, paired) in [(false, true), (true, false)] {
                    let fixed = PlanEntity::Fixed(copy(&x)?);
                    let plans = Plans::new(average(&x, 1)?, fixed, average(&a, N)?, false, paired)?;
                    let exact = if several {
                        Exact::Steps { b: &b, c: &c, v: &x[..4] }
                    } else {
                        Exact::OneStep { basis: &b, singular_values: &[1.0, 2.0], y: &x }
                    };
                    plans.errors(exact, 200 / (1 + 99 * usize::from(several)), &key, 2, &stop)?;
                }
                Ok(())
            })
        }
        "stream" => stream(false, Order::Gain),
        "stream safeguarded" => stream(true, Order::Random),
        "data stream" => Box::new(move || {
            let copy = |len| try_copy("an input", entries_of(len));
            let geometry = Geometry::new(copy(2 * N)?, N, 2)?;
            let mut data = DataStream::new(geometry, [Some(copy(N)?), Some(copy(N)?), Some(copy(N * N)?)])?;
            let samples = entries_of(2 * N * N);
            data.update(0, &Dense::new(samples, 2 * N, N)?, &stop)?;
            data.update(1, &Dense::new(samples, 2 * N, N)?, &stop)?;
            data.update(2, &Dense::new(samples, 2, N * N)?, &stop)?;
            let _ = (data.control()?, data.certificate()?);
            DataStream::from_sections(data.to_sections()?).map(drop)
        }),
        "triangle" => {
            let rows = entries(200 * 40);
            Box::new(move || {
                let mut r = identify::triangle(&rows, 40, 2, &stop)?;
                identify::update(&mut r, &rows, 40, &stop)?;
                identify::update(&mut r, &rows[..40], 40, &stop)
            })
        }
        "exact quantiles" => Box::new(move || {
            identify::roy_quantile(10, 15, 100, 0.05, 2, &stop)?;
            identify::smallest_quantile(10, 100, 0.05, 2, &stop).map(drop)
        }),
        "a region from data" => {
            let (n, d) = (4, 12);
            let rows = entries(200 * (n + d));
            let (known, directions) = (entries(n * n), entries(d * 3));
            Box::new(move || {
                let triangle = identify::triangle(&rows, n + d, 1, &stop)?;
                let of = identify::Data { triangle: &triangle, size: 200, n, m: d - n, offset: false, known: None };
                let estimate = identify::Estimate::new(of, &stop)?;
                let (x, u) = (MatrixView::of(&rows[..200 * n], n), MatrixView::of(&rows[..200 * (d - n)], d - n));
                identify::Estimate::from_pairs(x, u, MatrixView::of(&rows[200..][..200 * n], n), 1, &stop)?;
                let assumed = |design| identify::Assumed {
                    tail: 0.0,
                    design,
                    noise: identify::Noise::Gaussian,
                    covariance: identify::Covariance::Known(&known),
                };
                let wish = identify::Wish::new(0.05);
                let units = identify::Magnitudes::Expected(&[1.0; 12]);
                let [any, exact] = [identify::Design::Adaptive, identify::Design::Independent].map(assumed);
                Region::from_data(&estimate, any, wish, units, 1, &stop)?;
                Region::from_data(&estimate, any, identify::Wish { components: true, ..wish }, units, 1, &stop)?;
                let wish = identify::Wish { directions: Some(&directions), ..wish };
                Region::from_data(&estimate, exact, wish, units, 1, &stop)?;
                let full = identify::Assumed { covariance: identify::Covariance::Full, ..exact };
                let region = Region::from_data(&estimate, full, wish, units, 1, &stop)?;
                let mut sections = Sections::default();
                estimate.put(&mut sections)?;
                region.put(&mut sections)?;
                Region::take(&mut sections, &stop)?;
                identify::Estimate::take(&mut sections, &stop).map(drop)
            })
        }
        "several steps" => {
            let (model, square) = (entries(40 * 42), entries(42 * 42));
            // by all rows, with Gaussian noise to come; by rows; and a region of one step, with that of all its rows
            Box::new(move || {
                let (n, d) = (40, 42);
                let places: Vec<usize> = (0..d).collect();
                let part = |rows: &[usize], shape: &[f64]| {
                    let (white, shape) = (MatrixView::of(&square, d), MatrixView::of(shape, rows.len()));
                    let (columns, root, missing) = (&places[..], white, None);
                    let of = PartOf { rows, columns, white, root, missing, ratio: 1.0, shape, factor: 1.0 };
                    Part::new(of).map(Arc::new)
                };
                let centre = MatrixView::of(&model, d);
                let whole = Region::new(centre, 2, vec![part(&places[..n], &square[..n * n])?], Some(9.0), true)?;
                let parts = (0..n).map(|i| part(&places[i..=i], &[1.0])).collect::<Result<_>>()?;
                let rows = Region::new(centre, 2, parts, None, false)?;
                let noise = Gaussian { root: &square[..n * n], end: 0.02, before: 0.01 };
                let task = Endpoints { x0: &model[..n], rho0: 0.1, xf: &model[..n], predicted: &model[..4 * n] };
                let to_come = Some(ToCome::Gaussian(noise));
                let way = |region, to_come| Way { region, inputs: &model[..6], to_come, compares: false };
                let ways = [way(&whole, to_come), way(&rows, None)];
                let _ = certify(task, &ways, Some(way(&rows, to_come)), (true, &stop))?;
                let task = Endpoints { predicted: &model[..2 * n], ..task };
                let one = Way { region: &whole, inputs: &model[..2], to_come: None, compares: true };
                let _ = certify(task, &[one], None, (true, &stop))?;
                whole.projection((0, 0), (1, 1))?;
                whole.entry_bounds()?;
                whole.holds(&model).map(drop)
            })
        }
        "replicates" => {
            let (model, white) = (entries(15 * 15), entries(15 * 15));
            Box::new(move || {
                let centre = identify::Centre { model: &model, white: &white };
                let law = identify::EstimateLaw::new(centre, &white, identify::NoiseLaw::Full(40))?;
                law.models(&key, 3, 2, &stop)?;
                let (x0, inputs) = (&model[..15], &model[..3]);
                let aim = PlannedRun { x0, inputs: &[], m: 1, target: x0, noise: true, window: None, gain: None };
                drawn_misses(&law, aim, &key, 3, 2, &stop).err();
                let goal = Goal {
                    model: &model[..90],
                    n: 9,
                    m: 1,
                    white: &white[..100],
                    covariance: &white[..81],
                    x0: &x0[..9],
                    inputs,
                };
                let runs = NextRuns { starts: &model[..18], steps: 4, low: &[-1.0; 4], high: &[1.0; 4] };
                next_runs(goal, runs, &key, &stop).map(drop)
            })
        }
        "residuals" => {
            let rows: Vec<f64> = (0..150 * 25).map(|i| (0.37 * (i * i) as f64).cos()).collect();
            let tested: Vec<usize> = (0..10).collect();
            Box::new(move || identify::residual_checks(&rows, 25, 15, &tested, 3, &key, 2, &stop).map(drop))
        }
        "storage" => {
            let values = entries(1000);
            Box::new(move || {
                let section =
                    |at: usize| Section { name: format!("s{at}").into(), values: Values::Reals(values[..].into()) };
                let sections = try_collect("a test", (0..50).map(section))?;
                let bytes = storage::encode("test", 1, &sections, &stop)?;
                storage::decode("x".as_ref(), &bytes, "test", &stop).map(drop)
            })
        }
        _ => return None,
    })
}

const CALLS: [&str; 38] = [
    "sample",
    "systematic",
    "counts",
    "combine",
    "closed form",
    "alse of few",
    "alse of some",
    "alse of many",
    "alse of one line",
    "alse dense",
    "alse of prefixes",
    "second opinion",
    "slse",
    "slse safeguarded",
    "slse dense",
    "paths",
    "pseudoinverse",
    "best control",
    "limits",
    "limits of steps",
    "limits of rows",
    "controls",
    "trajectory",
    "runs",
    "runs with covariance",
    "mean field",
    "estimate errors",
    "plan errors",
    "stream",
    "stream safeguarded",
    "data stream",
    "triangle",
    "exact quantiles",
    "a region from data",
    "several steps",
    "replicates",
    "residuals",
    "storage",
];

/// The first of many [`entries`], which are made before any allocation fails.
fn entries_of(len: usize) -> &'static [f64] {
    static ALL: OnceLock<Vec<f64>> = OnceLock::new();
    &ALL.get_or_init(|| entries(50_000))[..len]
}

const CASE: &str = "STOCHENS_LADDER";

#[test]
#[ignore = "a process of its own, started by the test below"]
fn ladder() {
    let Ok(name) = std::env::var(CASE) else { return };
    let call = call(&name).unwrap();
    entries_of(1);
    call().unwrap();
    let mut rungs = 0;
    // one failure, or all from there on
    for alone in [true, false] {
        let mut at = 1;
        loop {
            SEEN.store(0, Ordering::Relaxed);
            LAST.store(if alone { at } else { usize::MAX }, Ordering::Relaxed);
            FIRST.store(at, Ordering::Relaxed);
            let result = call();
            FIRST.store(usize::MAX, Ordering::Relaxed);
            rungs += 1;
            if SEEN.load(Ordering::Relaxed) < at {
                result.unwrap();
                break;
            }
            // a solver continues without a factor that does not fit
            assert!(matches!(result, Ok(()) | Err(Error::Memory { .. })), "{name}, {at}: {result:?}");
            // each of the first, then ever fewer: solvers allocate in loops
            at += 1 + at / 20;
        }
    }
    std::io::Write::write_all(&mut std::io::stdout(), format!("rungs: {rungs}\n").as_bytes()).unwrap();
}

#[test]
fn no_failed_allocation_ends_the_process() {
    let program = std::env::current_exe().unwrap();
    for name in CALLS {
        let child = Command::new(&program)
            .args(["memory::tests::ladder", "--exact", "--include-ignored", "--nocapture", "--test-threads=1"])
            .env(CASE, name)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&child.stdout);
        assert!(child.status.success() && said.contains("rungs: "), "{name}: {:?} {said} {}", child.status, {
            String::from_utf8_lossy(&child.stderr)
        });
    }
}
