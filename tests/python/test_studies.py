"""Studies: keys, numbers, failures, interruptions and what becomes of the results."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
import study_functions as functions
from stochens_rs.exceptions import InputError
from stochens_rs.studies import running
from stochens_rs.studies import study as study_module
from stochens_rs.studies.tasks import Block
from study_functions import GRID, fused, noise, prefixes, slow, sometimes

FORK = pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")


def study(replicates: int | range = 7, **changed: object) -> se.Study:
    given = {"rng": 3, "shared": ["method"], **changed}
    return se.Study(fused, GRID, replicates=replicates, **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def undisturbed() -> se.studies.Results:
    return study().run()


# -- numbers ---------------------------------------------------------------------------------------


def test_numbers_are_those_of_the_documented_keys(undisturbed: se.studies.Results) -> None:
    key = se.studies.study.as_key(3)
    assert undisturbed.values["error"].shape == (3, 2, 7)
    assert undisturbed.values["estimate"].shape == (3, 2, 7, 2, 2)
    for i, size in enumerate(GRID["size"]):
        own = key.child(f'{{"size":{size}}}')  # the methods share it
        for r in range(7):
            for j, method in enumerate(GRID["method"]):
                found = fused(own.child(f"replicate {r}"), size, method)
                assert undisturbed.values["error"][i, j, r] == found["error"]
                assert np.array_equal(undisturbed.values["estimate"][i, j, r], found["estimate"])


def test_numbers_depend_on_neither_other_values_nor_order() -> None:
    whole = se.Study(noise, {"scale": [1.0, 2.0, 4.0]}, replicates=9, rng=5).run()
    part = se.Study(noise, {"scale": [4, 1]}, replicates=range(4, 9), rng=5).run()
    assert np.array_equal(part.values["x"], whole.values["x"][[2, 0], 4:])
    other = se.Study(noise, {"scale": [1.0, 2.0, 4.0]}, replicates=9, rng=6).run()
    assert not np.any(other.values["x"] == whole.values["x"])
    assert not np.any(whole.values["x"][0] * 2 == whole.values["x"][1])  # other keys


def test_nested_sizes_are_prefixes_of_one_sample() -> None:
    results = se.Study(prefixes, {"size": [5, 20, 80]}, replicates=6, rng=1, nested="size").run()
    assert results.values["error"].shape == (3, 6)
    fewer = se.Study(prefixes, {"size": [20, 80]}, replicates=6, rng=1, nested="size").run()
    assert np.array_equal(fewer.values["error"], results.values["error"][1:])
    table = results.columns()
    assert list(table) == ["size", "replicate", "error"]
    assert len(table["error"]) == 18
    assert results.done.shape == (3, 6)


def test_objects_have_names_in_the_grid() -> None:
    systems = {"slow": se.System([[0.9]], [[1.0]]), "fast": se.System([[0.1]], [[1.0]])}

    def first(key: se.Key, system: se.System) -> dict[str, float]:
        return {"a": system.A[0, 0]}

    results = se.Study(first, {"system": systems}, replicates=2, rng=1).run()
    assert results.grid == {"system": ("slow", "fast")}
    assert results.values["a"].tolist() == [[0.9, 0.9], [0.1, 0.1]]


# -- executors -------------------------------------------------------------------------------------


def test_threads_find_the_same(undisturbed: se.studies.Results) -> None:
    with ThreadPoolExecutor(3) as threads:
        assert study().run(threads).digest == undisturbed.digest


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_processes_find_the_same(undisturbed: se.studies.Results, method: str) -> None:
    if method == "fork" and not hasattr(os, "fork"):
        pytest.skip("forks")
    with ProcessPoolExecutor(2, mp_context=get_context(method)) as processes:
        assert study().run(processes).digest == undisturbed.digest


def test_loky_finds_the_same(undisturbed: se.studies.Results) -> None:
    loky = pytest.importorskip("loky")
    with loky.ProcessPoolExecutor(2) as processes:
        assert study().run(processes).digest == undisturbed.digest


def test_workers_use_one_thread_each() -> None:
    before = se.get_num_threads()
    with ThreadPoolExecutor(2) as threads:
        found = se.Study(functions.threads, {}, replicates=5, rng=1).run(threads)
    assert set(found.values["threads"]) == {1.0}
    assert se.get_num_threads() == before


@pytest.mark.parametrize(("cost", "most", "count"), [(1e-7, 10**6, 30), (0.004, 125, 260)])
def test_blocks_grow_to_their_time(cost: float, most: int, count: int) -> None:
    """By four at most, up to half a second; at the end, the tasks that are left are shared."""
    pace, left, sizes = running.Pace(0.5, 1), 30_000, []
    while left:
        sizes.append(pace.size(left))
        left, none = left - sizes[-1], np.zeros(sizes[-1], np.int8)
        pace.measure(Block(np.arange(sizes[-1]), none, {}, (), {}, cost * sizes[-1]))
    assert sum(sizes) == 30_000
    assert len(sizes) < count
    assert max(sizes) <= most
    assert all(new <= 4 * max(sizes[: k + 1]) for k, new in enumerate(sizes[1:]))


def test_the_first_block_is_alone_until_names_and_shapes_are_known() -> None:
    """Two first blocks could find two layouts."""
    layouts: list[object] = []

    class Listening(ThreadPoolExecutor):
        def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
            layouts.append(args[2])
            return super().submit(fn, *args, **kwargs)

    with Listening(3) as executor:
        se.Study(noise, {"scale": [1.0, 2.0]}, replicates=50, rng=1).run(executor)
    assert layouts[0] == {}
    assert layouts[1:] == [{"x": ()}] * (len(layouts) - 1)
    assert len(layouts) > 6


def test_what_workers_cannot_import_is_refused() -> None:
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes,
        pytest.raises(InputError, match="workers must import"),
    ):
        se.Study(lambda key: {"x": 1.0}, {}, replicates=2, rng=1).run(processes)


# -- failures --------------------------------------------------------------------------------------


def test_failures_are_kept_and_can_be_retried(monkeypatch: pytest.MonkeyPatch) -> None:
    made = se.Study(sometimes, {"scale": [1.0, 2.0]}, replicates=40, rng=8)
    results = made.run()
    assert results.status == "completed"
    assert 5 <= len(results.failures) == results.failed.sum() <= 30
    one = results.failures[0]
    assert one.configuration["scale"] in (1.0, 2.0)
    assert one.error.startswith("ValueError: x is ")
    assert "\n" not in one.error
    at = (results.grid["scale"].index(one.configuration["scale"]), one.replicate)
    assert np.isnan(results.values["x"][at])
    assert not results.done[at]
    assert made.run().digest == results.digest  # not run again
    assert made.run(retry=True).digest == results.digest  # they fail again
    monkeypatch.setenv("STUDY_TEST_CALM", "1")
    again = made.run(retry=True)
    assert again.failures == ()
    assert again.digest == se.Study(noise, {"scale": [1.0, 2.0]}, replicates=40, rng=8).run().digest


def test_a_function_that_always_fails_is_given_up() -> None:
    def broken(key: se.Key) -> dict[str, float]:
        raise RuntimeError("no such thing")

    with pytest.raises(InputError, match=r"failed in the first \d+ replicates: RuntimeError"):
        se.Study(broken, {}, replicates=10**6, rng=1).run()


WRONG = {
    "must return a mapping of numbers, got int 3": lambda key: 3,
    "must return a mapping of numbers, got .*dict": lambda key: {},
    "return x.real": lambda key: {"x": 1j},
    "`x` must be a number or an array, got str 'text'": lambda key: {"x": "text"},
    "return names that are no axes, got str 'a b'": lambda key: {"a b": 1},
    "return names that are no axes, got int 3": lambda key: {3: 1},
    "at most 2\\^53": lambda key: {"x": 2**53 + 2},
}


@pytest.mark.parametrize("text", WRONG)
def test_what_a_function_must_return(text: str) -> None:
    with pytest.raises(InputError, match=text):
        se.Study(WRONG[text], {}, replicates=2, rng=1).run()


def test_all_replicates_have_the_names_and_shapes_of_the_first() -> None:
    calls: list[int] = []

    def shapes(key: se.Key) -> dict[str, object]:
        calls.append(0)
        return [{"x": [1.0, 2.0]}, {"x": [1.0]}, {"x": 1.0}, {"y": 1}, {"x": (3, 4)}][
            len(calls) - 1
        ]

    results = se.Study(shapes, {}, replicates=5, rng=1).run()
    assert [one.replicate for one in results.failures] == [1, 2, 3]
    assert "must have shape (2,) in all tasks, got (1,)" in results.failures[0].error
    assert "must return the names 'x', got 'y'" in results.failures[2].error
    assert results.values["x"].tolist()[4] == [3.0, 4.0]


def test_numbers_keep_their_bits() -> None:
    odd = [-0.0, np.inf, np.float32(0.1), np.int64(-3), True, 5e-324, np.nan]
    results = se.Study(lambda key: {"x": odd[0], "all": odd}, {}, replicates=1, rng=1).run()
    assert np.signbit(results.values["x"][0])
    assert results.values["all"][0].tobytes() == np.array(odd, dtype=np.float64).tobytes()
    assert results.done.all()
    written = json.loads(json.dumps(results.to_dict(), allow_nan=False))
    assert written["values"]["all"][0][:2] == [-0.0, "inf"]
    assert written["values"]["all"][0][-1] is None


# -- interruptions ---------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.skipif(sys.platform == "win32", reason="signals cannot be sent to oneself on Windows")
@pytest.mark.parametrize("workers", [0, 2])
def test_a_signal_returns_what_is_done(number: signal.Signals, workers: int) -> None:
    calls: list[float] = []

    def signals(key: se.Key, scale: float) -> dict[str, float]:
        """The thirtieth task sends it; with workers, nothing ends before it has been seen."""
        calls.append(scale)
        if len(calls) == 30:
            os.kill(os.getpid(), number)
        while workers and len(calls) >= 30 and not (seen or running._open[-1].count):
            time.sleep(0.001)
        seen.extend([True] * (len(calls) >= 30))
        return noise(key, scale)

    seen: list[bool] = []
    made = se.Study(signals, {"scale": [1.0, 2.0]}, replicates=150, rng=4)
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    executor = ThreadPoolExecutor(workers) if workers else None
    results = made.run(executor)
    assert results.status == "interrupted"
    assert 29 <= results.done.sum() < 300
    assert workers or results.done.sum() == 29  # the task that ran is broken off
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before
    again = made.run(executor)
    assert again.status == "completed"
    whole = se.Study(noise, {"scale": [1.0, 2.0]}, replicates=150, rng=4).run()
    assert again.digest == whole.digest
    if executor is not None:
        executor.shutdown()


PARTIAL = """
import os, signal, threading, time
import numpy as np, stochens_rs as se
A = np.random.default_rng(0).standard_normal((100, 100))
hard = se.sample(A, 19_000, rng=2)
def interrupt():
    begun = time.process_time()  # of this process: it is at work then
    while time.process_time() < begun + 0.3:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)
def fused(key, wait):  # returns after Ctrl-C with the best weights so far
    if wait:
        threading.Thread(target=interrupt).start()
    fit = se.fuse(hard if wait else hard.prefix(20), "alse", target=A)
    statuses.append(fit.status)
    return {"error": fit.error}
statuses = []
results = se.Study(fused, {"wait": [False, True]}, replicates=1, rng=1).run()
print(results.status, statuses[-1], results.done.tolist())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGINT cannot be sent to oneself on Windows")
def test_a_result_that_ctrl_c_cut_short_is_not_kept() -> None:
    run = subprocess.run(
        [sys.executable, "-c", PARTIAL], capture_output=True, text=True, timeout=300
    )
    assert run.stdout.split("\n")[0] == "interrupted interrupted [[True], [False]]", run.stderr


def test_a_time_limit_ends_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = functions.Clock()
    for module in (running, study_module, functions):
        monkeypatch.setattr(module, "time", clock)
    made = se.Study(slow, {}, replicates=2000, rng=4)
    results = made.run(time_limit=0.3)
    assert results.status == "time_limit"
    assert 75 <= results.done.sum() <= 75 + 25  # the limit, and a block of 0.1 s that had begun
    assert repr(made).startswith("<Study: study_functions.slow of 2000 replicates, ")


# -- workers that die ------------------------------------------------------------------------------


@FORK
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_pool_that_dies_ends_the_run_and_a_new_one_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "a.study"
    made = se.Study(functions.deadly, {"folder": [str(tmp_path)]}, replicates=30, rng=1)
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as processes:
        for _ in range(2):
            with pytest.raises(InputError, match="`executor` has lost its workers: run the study"):
                made.run(processes, path)
    before = se.Study.resume(path).results.done
    results, left = finished(made, 30, path)
    assert left < 30
    assert np.all(results.done | ~before)
    again = se.Study(functions.deadly, {"folder": [str(tmp_path)]}, replicates=30, rng=1).run()
    assert results.digest == se.Study.resume(path).results.digest == again.digest


def finished(made: se.Study, most: int, path: Path | None = None) -> tuple[se.studies.Results, int]:
    """Run a study on, by a new pool for each that dies."""
    for lost in range(most):
        with (
            contextlib.suppress(InputError),
            ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool,
        ):
            return made.run(pool, path), lost
    raise AssertionError(f"{most} pools have died")


@pytest.mark.parametrize("error", [ConnectionRefusedError(111, "refused"), EOFError("end")])
def test_workers_that_cannot_be_started(error: Exception) -> None:
    left = [1]

    class Dead(ThreadPoolExecutor):
        def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
            if left:
                left.pop()
                raise error
            return super().submit(fn, *args, **kwargs)

    made = se.Study(noise, {"scale": [1.0, 3.0]}, replicates=150, rng=2)
    whole = se.Study(noise, {"scale": [1.0, 3.0]}, replicates=150, rng=2).run().digest
    with Dead(2) as dead:
        with pytest.raises(InputError, match=f"lost its workers.*{type(error).__name__}"):
            made.run(dead)
        assert made.run(dead).digest == whole


def test_a_broken_pool_does_not_outlive_the_run() -> None:
    """Nor does it keep the interpreter from ending, if a worker does not answer SIGTERM."""
    text = """
from concurrent.futures import ProcessPoolExecutor
import stochens_rs as se, study_functions
if __name__ == "__main__":
    grid = {"part": ["first", "stays", "dies"]}
    study = se.Study(study_functions.deaf, grid, replicates=1, rng=1)
    try:
        study.run(ProcessPoolExecutor(2))
    except se.exceptions.InputError as error:
        print("lost its workers" in str(error))
"""
    folder = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, timeout=300, cwd=folder
    )
    assert done.stdout == "True\n", done.stderr
