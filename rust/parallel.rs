//! Work on independent chunks with scoped threads, and a way to stop it.
//!
//! Threads are started and joined inside the call: no pool has to survive a `fork`, nothing is initialised at import,
//! and if no thread can be started, the calling thread does the work alone. Each chunk, not each thread, owns its
//! random stream and its part of the output, so results do not depend on the number of threads.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::error::{Error, Result};

/// A request to stop, shared between the caller and a running computation.
///
/// The computation stays on the caller's thread, whose caches are warm. What only that thread can see, such as Python's
/// signals, is therefore looked at from time to time within its checks for a stop.
#[derive(Default)]
pub struct Stop {
    requested: AtomicBool,
    watch: Option<Box<Watch>>,
}

impl std::fmt::Debug for Stop {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stop").finish_non_exhaustive()
    }
}

impl Stop {
    /// No request yet.
    #[must_use]
    pub const fn new() -> Self {
        Self { requested: AtomicBool::new(false), watch: None }
    }

    /// No request yet. The current thread calls `look` in its checks, at most once in `every`; if it returns true, the
    /// stop is requested.
    #[must_use]
    pub fn watching(every: Duration, look: impl Fn() -> bool + Send + Sync + 'static) -> Self {
        let now = Instant::now();
        let looks = Mutex::new(Looks { at_the_clock: now, for_a_reason: now, skipped: 0 });
        let watch = Watch { by: here(), skip: AtomicU32::new(0), looks, every, look: Box::new(look) };
        Self { requested: AtomicBool::new(false), watch: Some(Box::new(watch)) }
    }

    /// Ask the computation to end at its next check.
    pub fn request(&self) {
        self.requested.store(true, Ordering::Relaxed);
    }

    /// Whether a stop was asked for.
    pub fn requested(&self) -> bool {
        if self.watch.as_ref().is_some_and(|watch| watch.sees_a_reason()) {
            self.request();
        }
        self.requested.load(Ordering::Relaxed)
    }

    /// [`Self::requested`] for a thread that waits, and so checks rarely: it does not skip the clock.
    pub fn requested_after_a_wait(&self) -> bool {
        if let Some(watch) = self.watch.as_ref().filter(|watch| watch.by == here()) {
            watch.skip.store(0, Ordering::Relaxed);
        }
        self.requested()
    }

    /// [`Error::Interrupted`] once a stop was asked for; loops call this every few milliseconds of work.
    pub fn check(&self) -> Result<()> {
        if self.requested() { Err(Error::Interrupted) } else { Ok(()) }
    }
}

/// A condition that one thread checks while it works.
struct Watch {
    by: usize,
    /// Checks to skip before the next one that reads the clock; only counts on the thread `by`.
    skip: AtomicU32,
    looks: Mutex<Looks>,
    every: Duration,
    look: Box<dyn Fn() -> bool + Send + Sync>,
}

struct Looks {
    at_the_clock: Instant,
    for_a_reason: Instant,
    /// Checks skipped between the last two readings of the clock.
    skipped: u32,
}

impl Watch {
    /// Checks closer than this may skip the clock, whose reading takes several times as long as a check.
    const CLOSE: Duration = Duration::from_micros(20);
    /// Most checks to skip. The number grows while checks are close, and is 0 after one that is not.
    const MOST: u32 = 15;

    fn sees_a_reason(&self) -> bool {
        if here() != self.by {
            return false;
        }
        let skip = self.skip.load(Ordering::Relaxed);
        self.skip.store(skip.saturating_sub(1), Ordering::Relaxed);
        skip == 0 && self.due() && (self.look)()
    }

    #[cold]
    fn due(&self) -> bool {
        let Ok(mut looks) = self.looks.lock() else { return false };
        let now = Instant::now();
        let close = now.duration_since(looks.at_the_clock) < Self::CLOSE * (looks.skipped + 1);
        looks.at_the_clock = now;
        looks.skipped = if close { (2 * looks.skipped + 1).min(Self::MOST) } else { 0 };
        self.skip.store(looks.skipped, Ordering::Relaxed);
        let due = now.duration_since(looks.for_a_reason) >= self.every;
        if due {
            looks.for_a_reason = now;
        }
        due
    }
}

/// A number that identifies this thread while it lives; cheaper than its `ThreadId`.
pub(crate) fn here() -> usize {
    thread_local!(static HERE: u8 = const { 0 });
    HERE.with(|here| std::ptr::from_ref(here).addr())
}

/// How often a thread that waits for others checks for a stop.
pub(crate) const WAIT: Duration = Duration::from_millis(20);

/// Calls `work` once for every chunk, on up to `threads` threads; the first error wins and ends the others.
pub fn for_each_chunk<T, I, F>(chunks: I, threads: usize, stop: &Stop, work: F) -> Result<()>
where
    T: Send,
    I: Iterator<Item = T> + Send,
    F: Fn(T) -> Result<()> + Sync,
{
    let threads = threads.min(chunks.size_hint().1.unwrap_or(threads)); // no thread without a chunk
    let queue = Mutex::new(chunks);
    let failed: Mutex<Option<Error>> = Mutex::new(None);
    let drain = || loop {
        let next = queue.lock().ok().and_then(|mut chunks| chunks.next());
        let Some(chunk) = next else { return };
        if let Err(error) = stop.check().and_then(|()| work(chunk)) {
            if let (Ok(mut first), Ok(mut chunks)) = (failed.lock(), queue.lock()) {
                first.get_or_insert(error);
                chunks.by_ref().for_each(drop); // empty the queue: the other threads end after their chunk
            }
            return;
        }
    };
    on_threads(threads, stop, &drain);
    match failed.into_inner() {
        Ok(Some(error)) => Err(error),
        _ => Ok(()),
    }
}

/// Calls `work` on this thread and on up to `threads - 1` others; compiled once for all kinds of chunks.
fn on_threads(threads: usize, stop: &Stop, work: &(dyn Fn() + Sync)) {
    if threads < 2 || cfg!(not(feature = "threads")) {
        return work();
    }
    std::thread::scope(|scope| {
        let (working, done) = channel::<()>();
        for _ in 1..threads {
            let working = working.clone();
            let theirs = move || {
                work();
                drop(working);
            };
            // EAGAIN under a process limit is no failure: this thread takes all chunks.
            if std::thread::Builder::new().spawn_scoped(scope, theirs).is_err() {
                break;
            }
        }
        work();
        drop(working);
        // the others may take long, and perhaps only this thread can see a reason to stop
        while done.recv_timeout(WAIT) == Err(RecvTimeoutError::Timeout) {
            stop.requested_after_a_wait();
        }
    });
}

/// Takes the work, which either the new thread runs or, if none could be started, the caller.
fn take<F>(slot: &Mutex<Option<F>>) -> Option<F> {
    slot.lock().ok().and_then(|mut work| work.take())
}

/// Runs `work`, which cannot check for a stop, on its own thread. After a stop the caller returns
/// [`Error::Interrupted`] at once, and the thread runs on until `work` ends; therefore `work` owns its data.
pub(crate) fn detached<T, F>(name: &str, stop: &Stop, work: F) -> Result<T>
where
    T: Send + 'static,
    F: FnOnce() -> Result<T> + Send + 'static,
{
    detached_until(name, || stop.requested_after_a_wait(), work)
}

/// The same, left behind once `ended()`.
pub(crate) fn detached_until<T, F>(name: &str, ended: impl Fn() -> bool, work: F) -> Result<T>
where
    T: Send + 'static,
    F: FnOnce() -> Result<T> + Send + 'static,
{
    let (send, receive) = sync_channel(1);
    if cfg!(not(feature = "threads")) {
        return work();
    }
    let slot = Arc::new(Mutex::new(Some(work)));
    let theirs = Arc::clone(&slot);
    let spawned = std::thread::Builder::new().name(name.into()).spawn(move || {
        let result = catch_unwind(AssertUnwindSafe(|| take(&theirs).map(|work| work())));
        let lost = || Some(Err(Error::Numerical("a solver panicked on this problem".into())));
        send.send(result.unwrap_or_else(|_| lost())).ok() // no receiver after a stop
    });
    if spawned.is_err() {
        // no thread could be started: run it here; it cannot be interrupted
        return take(&slot).map_or_else(|| Err(Error::Interrupted), |work| work());
    }
    loop {
        match receive.recv_timeout(WAIT) {
            Ok(Some(result)) => return result,
            Err(RecvTimeoutError::Timeout) if ended() => return Err(Error::Interrupted),
            Err(RecvTimeoutError::Timeout) => {}
            Ok(None) | Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::Numerical("the solver's thread ended without a result".into()));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    #[test]
    fn every_chunk_is_visited_once_for_any_number_of_threads() {
        for threads in [1, 2, 8] {
            let mut data = vec![0u32; 1000];
            for_each_chunk(data.chunks_mut(7), threads, &Stop::new(), |chunk| {
                chunk.iter_mut().for_each(|v| *v += 1);
                Ok(())
            })
            .unwrap();
            assert!(data.iter().all(|&v| v == 1));
        }
    }

    /// A look that counts its calls, and returns true from the `n`-th on.
    fn nth_look(n: usize) -> (Arc<AtomicUsize>, impl Fn() -> bool) {
        let looks = Arc::new(AtomicUsize::new(0));
        (Arc::clone(&looks), move || looks.fetch_add(1, Ordering::Relaxed) + 1 >= n)
    }

    #[test]
    fn one_thread_looks_now_and_then() {
        let (looks, look) = nth_look(2);
        let looks = || looks.load(Ordering::Relaxed);
        let every = Duration::from_millis(30);
        let (began, stop) = (Instant::now(), Stop::watching(every, look));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while began.elapsed() < 2 * every {
                    assert!(!stop.requested());
                }
            });
        });
        assert_eq!(looks(), 0, "another thread looked");
        while looks() < 1 {
            assert!(!stop.requested());
        }
        let first = began.elapsed();
        while !stop.requested() {}
        assert!(first >= every && began.elapsed() >= 2 * every && looks() == 2);
        assert_eq!(stop.check(), Err(Error::Interrupted));
    }

    #[test]
    fn close_checks_share_a_look_at_the_clock_and_others_do_not() {
        let (looks, look) = nth_look(usize::MAX);
        let stop = Stop::watching(Duration::ZERO, look);
        let looks = || looks.swap(0, Ordering::Relaxed);
        (0..16_000).for_each(|_| assert!(!stop.requested()));
        let close = looks();
        assert!((1000..2000).contains(&close), "{close} looks"); // a few more where the thread had to pause
        for _ in 0..50 {
            stop.requested();
            stop.requested();
            std::thread::sleep(Duration::from_millis(1));
        }
        let mixed = looks();
        assert!(mixed >= 40, "{mixed} looks in 50 ms");
    }

    /// The thread that looks only waits here, for another that ends only after a stop.
    #[test]
    fn who_waits_for_the_others_looks() {
        let stop = Stop::watching(WAIT, nth_look(1).1);
        let caller = here();
        let started = Mutex::new(0);
        let result = for_each_chunk(0..2, 2, &stop, |_| {
            *started.lock().unwrap() += 1;
            while *started.lock().unwrap() < 2 {
                std::thread::yield_now(); // one chunk each
            }
            while here() != caller {
                stop.check()?;
                std::thread::yield_now();
            }
            Ok(())
        });
        assert_eq!(result, Err(Error::Interrupted));
    }

    #[test]
    fn an_error_and_a_stop_reach_the_caller() {
        let stop = Stop::new();
        let result =
            for_each_chunk(0..100, 2, &stop, |i| if i == 5 { Err(Error::Numerical("five".into())) } else { Ok(()) });
        assert_eq!(result, Err(Error::Numerical("five".into())));
        stop.request();
        assert_eq!(for_each_chunk(0..100, 2, &stop, |_| Ok(())), Err(Error::Interrupted));
    }
}
