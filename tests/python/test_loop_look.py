"""`ModelStream.look` with a gain: stop measuring when the loop is certified."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import at_most, sets
from stochens_rs.exceptions import SolverError

A, B = np.array([[1.05, 0.3], [-0.1, 0.9]]), np.array([[0.0], [0.4]])


def pairs(gen, count, sigma=0.3):
    x, u = gen.standard_normal((count, 2)), gen.standard_normal((count, 1))
    return x, u, x @ A.T + u @ B.T + sigma * gen.standard_normal((count, 2))


def first_certified(stream, gen, most=40):
    """Look after every few pairs, each time with a gain for the model so far."""
    for _ in range(most):
        stream.update(*pairs(gen, 5))
        if stream.model.next_look != stream.size:
            stream.update(*pairs(gen, stream.model.next_look - stream.size))
        try:
            look = stream.look(gain=se.gain(stream.model, 1.0, 1.0))
        except SolverError:
            continue
        if look.stop:
            return look
    return None


@pytest.mark.parametrize("design", ["adaptive", "independent"])
def test_what_is_certified_at_any_look_is_stable(design):
    """100 streams (`make test`: 10), up to 40 looks, stopped where one certifies, delta = 10 %."""
    gen, found, missed, unstable = np.random.default_rng(1), 0, 0, 0
    count = sets(100, 10)
    for _ in range(count):
        stream = se.ModelStream(2, 1, delta=0.1, noise=se.Noise(sigma=0.3, design=design))
        look = first_certified(stream, gen, 40 if design == "adaptive" else 14)
        if look is None:
            continue
        found += 1
        missed += not look.proof.region.contains(A, B)
        unstable += np.abs(np.linalg.eigvals(A + B @ look.proof.K)).max() >= 1.0
        assert look.proof.check()
    assert found >= 0.9 * count
    at_most(missed, found, 0.1)
    assert unstable == 0


def test_the_forecast_and_the_words():
    gen, stream = np.random.default_rng(2), se.ModelStream(2, 1, noise=se.Noise(sigma=0.3))
    stream.update(*pairs(gen, 30))
    K = se.gain((A, B), 1.0, 1.0).K
    look = stream.look(gain=K)
    assert not look.stop
    assert 0.0 < look.forecast < np.inf
    assert "forecast: about" in repr(look)
    stream.update(*pairs(gen, 4 * int(look.forecast)))
    later = stream.look(gain=K)
    assert later.stop
    assert later.forecast == 0.0
    assert repr(later).startswith(f"<LoopLook: certified after {stream.size} pairs, margin at")
    assert later.proof.region.delta == stream.model.delta
    tube = later.proof.tube([1.0, 0.0], 10, noise=0.05)
    assert np.isfinite(tube.radii).all()
    one = se.ModelStream(2, 1, noise=se.Noise(sigma=0.3))
    one.update(*pairs(gen, 1))
    assert one.look(gain=K).forecast == np.inf
