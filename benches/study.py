"""What a study costs beside a bare loop, joblib and dask.bag.

``python benches/study.py`` prints a table; ``--tasks`` and ``--workers`` change the work, and
``--large`` adds the time and memory of a million replicates. joblib and dask are taken where they
are installed.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor

import stochens_rs as se

Line = tuple[str, str, Callable[[], object], float, Callable[[], object], float]
TASKS = 3000  # of `studies`


def busy(key: se.Key, milliseconds: float) -> dict[str, float]:
    """Compute for a given time of the processor, so that workers compete for nothing else."""
    x, end = 0.0, time.thread_time() + milliseconds / 1000
    while time.thread_time() < end:
        x = (x + 1.0) * 0.5
    return {"x": x}


def cheap(key: se.Key) -> dict[str, float]:
    return {"a": 1.0, "b": key.bytes32[0] / 256, "c": key.bytes32[1] / 256}


def keyed(task: tuple[se.Key, float]) -> dict[str, float]:
    return busy(*task)


def ways(tasks: int, milliseconds: float, workers: int) -> dict[str, Callable[[], object]]:
    """The same work in several ways, by name."""
    key = se.studies.study.as_key(1)
    made = [(key.child(f"replicate {r}"), milliseconds) for r in range(tasks)]
    folder = tempfile.mkdtemp()

    def study(executor: object = None, path: str | None = None) -> object:
        grid = {"milliseconds": [milliseconds]}
        return se.Study(busy, grid, replicates=tasks, rng=1).run(executor, path)  # type: ignore[arg-type]

    def bare_loop() -> object:
        return [keyed(task) for task in made]

    def kept() -> object:
        path = os.path.join(folder, f"{time.monotonic_ns()}.study")
        return study(None, path)

    found: dict[str, Callable[[], object]] = {
        "bare loop": bare_loop,
        "study": study,
        "study with a file": kept,
    }
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("fork"))
    list(pool.map(time.sleep, [0.05] * workers))  # start them
    found[f"study, {workers} processes"] = lambda: study(pool)
    found[f"pool.map, {workers} processes"] = lambda: list(pool.map(keyed, made))
    try:
        from joblib import Parallel, delayed

        parallel = Parallel(workers)
        parallel(delayed(time.sleep)(0.05) for _ in range(workers))
        found[f"joblib, {workers} processes"] = lambda: parallel(map(delayed(keyed), made))
    except ImportError:
        pass
    try:
        from dask import bag

        options = {"scheduler": "processes", "num_workers": workers}
        found[f"dask.bag, {workers} processes"] = lambda: (
            bag.from_sequence(made, npartitions=4 * workers).map(keyed).compute(**options)
        )
    except ImportError:
        pass
    return found


def studies() -> Iterator[Line]:
    """What is added to a task of 0.1 ms; the ratio is below one where a study costs more."""
    found = ways(TASKS, 0.1, 2)
    for name, peer in (
        ("study", "bare loop"),
        ("study with a file", "bare loop"),
        ("study, 2 processes", "pool.map, 2 processes"),
    ):
        yield f"{name}, a task of 0.1 ms", peer, found[name], TASKS, found[peer], TASKS


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", type=int, default=300)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--large", action="store_true")
    chosen = parser.parse_args()
    for milliseconds, tasks in ((10.0, chosen.tasks), (0.1, 10 * chosen.tasks)):
        every = ways(tasks, milliseconds, chosen.workers)
        seconds: dict[str, list[float]] = {name: [] for name in every}
        for _ in range(chosen.rounds):
            for name, run in every.items():
                began = time.perf_counter()
                run()
                seconds[name].append(time.perf_counter() - began)
        print(f"\n{tasks} tasks of {milliseconds:g} ms, median of {chosen.rounds} rounds")
        for name, times in seconds.items():
            took = statistics.median(times)
            print(f"{name:>24}  {took:8.3f} s  {1e6 * took / tasks:10.1f} us per task")
    if chosen.large:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        began = time.perf_counter()
        path = os.path.join(tempfile.mkdtemp(), "large.study")
        results = se.Study(cheap, {}, replicates=10**6, rng=1).run(path=path)
        took = time.perf_counter() - began
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"\n10^6 replicates of 3 numbers: {took:.1f} s, {peak:.0f} MB ({before:.0f} before)")
        began = time.perf_counter()
        str(se.Study.resume(path).results)
        took = time.perf_counter() - began
        size = os.path.getsize(path) / 2**20
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"read again ({size:.0f} MB) and summed up: {took:.1f} s, {peak:.0f} MB; {results}")


if __name__ == "__main__":
    main()
