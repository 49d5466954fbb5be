"""Many threads at once get what one thread gets: every object of the core is frozen or locked."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import _core
from stochens_rs._base.running import interruptible
from stochens_rs.exceptions import InputError

A, B = np.array([[1.0, 0.1], [-0.2, 0.95]]), np.array([[0.0], [0.1]])


def together(work, count=8):
    """What each of many threads gets that begin at the same time."""
    gate = threading.Barrier(count)

    def one(k):
        gate.wait()
        return work(k)

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(count) as pool:
            return list(pool.map(one, range(count)))
    finally:
        sys.setswitchinterval(before)


def test_calls_in_threads_give_what_they_give_alone():
    x, u, w = np.split(np.random.default_rng(1).standard_normal((60, 5)), [2, 3], axis=1)
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.01 * w)

    def work(_=0):
        model = se.identify(data, noise=se.Noise(sigma=0.01))
        plan = se.control(model, [1.0, 0.0], [0.0, 0.0], steps=8, limits=(-5.0, 5.0))
        drawn = se.sample(A, 2000, rng=2)
        fit = se.fuse(drawn, "alse", target=A)
        found = plan.u, fit.estimate, drawn.mean(), plan.bound(0.05).tube
        return b"".join(one.tobytes() for one in found)

    assert set(together(work)) == {work()}


BIG, BIG_B = np.random.default_rng(5).standard_normal((2, 9, 9)) / 4.0
UNITS = se.SystemEnsemble(np.tile(BIG, (517, 1, 1)), np.tile(BIG_B, (517, 1, 1)), np.ones((517, 9)))
U, X = np.linspace(-1.0, 1.0, 36).reshape(4, 9), np.arange(1.0, 10.0)
MEAN_FIELD = {"averaging": "mean-field", "replicates": 100}
SPLIT = {
    "sample": lambda: [se.sample(BIG, 90_000, rng=3).indices],
    "sample of rows": lambda: [se.sample(BIG, 90_000, rng=3, axis="rows").indices],
    "systematic": lambda: [se.sample(BIG, 90_000, rng=3, scheme="systematic").indices],
    "runs": lambda: vars(
        se.simulate_ensemble((BIG, BIG_B), X, U, 5000, rng=1, keep="covariance runs")
    ).values(),
    "mean field": lambda: vars(
        se.simulate_ensemble((BIG, BIG_B), X, U, 5000, rng=1, keep="runs", **MEAN_FIELD)
    ).values(),
    "systems": lambda: vars(se.simulate_ensemble(UNITS, X, U, keep="covariance runs")).values(),
    "controls": lambda: [
        se.realization_controls((se.sample(BIG, 700, rng=3), BIG_B), se.sample(X, 700, rng=1), X)
    ],
    "controls within limits": lambda: [
        se.realization_controls((se.sample(BIG, 700, rng=3), BIG_B), X, X, limits=(-1.0, 1.0))
    ],
    "triangle": lambda: [_core.triangle(np.tile(BIG, (9000, 1)), se.get_num_threads())],
}


@pytest.mark.parametrize("name", SPLIT)
def test_no_number_of_threads_changes_a_bit(name):
    found = set()
    for threads in (1, 2, 3, 7):
        se.set_num_threads(threads)
        arrays = [one for one in SPLIT[name]() if isinstance(one, np.ndarray)]
        found.add(b"".join(one.tobytes() for one in arrays))
    assert len(found) == 1 < len(found.pop())


def test_one_object_in_many_threads():
    loop = se.regulate((A, B), 10, limits=(-1.0, 1.0))
    alone = se.regulate((A, B), 10, limits=(-1.0, 1.0))([1.0, 0.0])

    def call(_):
        try:
            return loop([1.0, 0.0])
        except InputError:  # in use by another thread
            return alone

    assert np.allclose(together(call), alone, atol=1e-7)
    drawn = se.sample([1.0, -2.0, 3.0], 5000, rng=1)
    assert len({drawn.dense().tobytes(), *together(lambda _: drawn.dense().tobytes())}) == 1


def test_pairs_from_many_threads_are_all_counted_or_refused():
    stream, refused = se.ModelStream(2, 1, noise=se.Noise(sigma=0.1)), []

    def work(k):
        rng = np.random.default_rng(k)
        for _ in range(50):
            x, u = rng.standard_normal((1, 2)), rng.standard_normal((1, 1))
            try:
                stream.update(x, u, x @ A.T + u @ B.T)
            except InputError:  # in use by another thread
                refused.append(k)

    together(work)
    assert stream.size == 400 - len(refused)


def test_steps_of_one_stream_from_many_threads_are_the_steps_of_one_thread():
    def stream():
        return se.Stream((A, B), [1.0, -0.5], [0.2, 0.4], rng=1)

    shared, alone = stream(), stream()
    together(lambda _: [shared.step(25) for _ in range(20)])
    alone.step(8 * 20 * 25)
    assert shared.steps == 4000
    assert shared.u.tobytes() == alone.u.tobytes()


def test_objects_of_their_own_do_not_meet():
    def work(k):
        stream = se.Stream((A, B), [1.0, -0.5], [0.2, 0.4], rng=k)
        means = se.DataStream(B)
        loop, x = se.regulate((A, B), 10, limits=(-1.0, 1.0)), np.array([1.0, 0.1 * k])
        found = []
        for i in range(20):
            stream.step(50)
            means.update(x0=[1.0, 0.0], xf=np.full(2, 1.0 * i + k), A=A + 0.01 * k)
            x = A @ x + B @ loop(x)
            found += [stream.u, means.u, x]
        return np.concatenate(found).tobytes()

    assert together(work) == [work(k) for k in range(8)]
    assert len(set(together(work))) == 8


def test_one_plan_and_one_model_are_asked_by_many_threads():
    x, u, w = np.split(np.random.default_rng(1).standard_normal((60, 5)), [2, 3], axis=1)
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.01 * w)

    def asked(model, plan):
        found = model.region(0.05).bound([1.0, 0.0], [1.0]), plan.bound(0.05).state
        return np.array([*found, *model.A.flat, *model.covariance.flat]).tobytes()

    def fresh():
        model = se.identify(data, noise=se.Noise(sigma=0.01))
        return model, se.control(model, [1.0, 0.0], [0.0, 0.0], steps=5)

    shared = fresh()
    assert set(together(lambda _: asked(*shared))) == {asked(*fresh())}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_child_forked_while_a_thread_computes_a_value(monkeypatch):
    """What a record computes once is no lock of its class, which the child would wait for."""
    x, u, w = np.split(np.random.default_rng(1).standard_normal((60, 5)), [2, 3], axis=1)
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + 0.01 * w)
    one, other = (se.identify(data, checks=False, noise=se.Noise(sigma=0.01)) for _ in range(2))
    began, end = threading.Event(), threading.Event()

    def slow(model):
        if model is one:
            began.set()
            end.wait()
        return 7

    monkeypatch.setattr(se.Model.__dict__["core"], "func", slow)
    for model in (one, other):
        model.__dict__.pop("core", None)
    thread = threading.Thread(target=lambda: one.core)
    thread.start()
    began.wait()
    child = os.fork()
    if child == 0:
        os._exit(other.core)
    until = time.monotonic() + 5.0
    while not (done := os.waitpid(child, os.WNOHANG))[0] and time.monotonic() < until:
        time.sleep(0.01)
    if not done[0]:
        os.kill(child, signal.SIGKILL)
        done = os.waitpid(child, 0)
    end.set()
    thread.join()
    assert os.waitstatus_to_exitcode(done[1]) == 7


def test_work_whose_thread_never_begins_is_done_here(monkeypatch):
    """As a thread that finds no memory for its first call."""
    monkeypatch.setattr("_thread.start_new_thread", lambda *_: 0)
    monkeypatch.setattr(threading.Thread, "start", lambda self: threading.Event().wait(20.0))
    began = time.monotonic()
    assert interruptible(lambda: 7) == 7
    assert time.monotonic() - began < 5.0
    monkeypatch.undo()
    assert interruptible(threading.get_ident) != threading.get_ident()
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)
