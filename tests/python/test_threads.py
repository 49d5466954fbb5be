"""Many threads at once get what one thread gets: every object of the core is frozen or locked."""

from __future__ import annotations

import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import stochens_rs as se
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
        model = se.identify(data, sigma=0.01, rng=1)
        plan = se.control(model, [1.0, 0.0], [0.0, 0.0], steps=8, limits=(-5.0, 5.0))
        drawn = se.sample(A, 2000, rng=2)
        fit = se.fuse(drawn, "alse", target=A)
        found = plan.u, fit.estimate, drawn.mean(), plan.bound(0.05).tube
        return b"".join(one.tobytes() for one in found)

    assert set(together(work)) == {work()}


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
    assert (
        len({drawn.to_bytes() for _ in range(2)} | set(together(lambda _: drawn.to_bytes()))) == 1
    )


def test_pairs_from_many_threads_are_all_counted_or_refused():
    stream, refused = se.ModelStream(2, 1, sigma=0.1), []

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
