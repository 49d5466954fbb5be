"""What a loop returns is within its limits, whatever acts, is missing or begins anew."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError

LIMITS = se.Limits(u=(-2.0, 2.0), rate=0.3, previous=0.0)


@pytest.fixture(scope="module")
def model():
    """Readings of ``y+ = 1.2 y - 0.4 y- + u + 0.1 w``."""
    rng = np.random.default_rng(3)
    y, u = np.zeros((300, 1)), rng.standard_normal((299, 1))
    for t in range(1, 299):
        y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
    data = se.Trajectories([y], [u], outputs=True)
    return se.identify(data, window=se.Window(lags=2))


@pytest.fixture(scope="module", params=["gain", "plan"])
def made(request, model):
    """Loops from readings by a gain, and by plans."""
    if request.param == "gain":
        gain = se.gain(model, 1.0, 1.0)
        return lambda **given: se.regulate(gain, offset_free=True, **given)
    return lambda **given: se.regulate(model, 10, offset_free=False, **given)


def test_an_input_that_acts_far_outside_stops_no_loop(made):
    """An operator holds 2.5 of 2; the nearest input within the limits, whatever the rate."""
    loop = made(limits=LIMITS)
    for k in range(12):
        u = loop([0.1], applied=[2.5] if k else None)
    assert loop.full
    assert u == pytest.approx([2.0])
    assert "held" not in [call.status for call in loop.log]
    assert made(limits=LIMITS).start(([[0.3], [0.2], [0.1]], [[5.0], [5.0]])) == [2.0]


def test_a_loop_that_begins_anew_keeps_the_rate(made):
    loop, y = made(limits=LIMITS, target=[5.0]), [0.0, 0.0]
    for _ in range(60):
        y.append(1.2 * y[-1] - 0.4 * y[-2] + float(loop([y[-1]])[0]))
    last = loop.log[-1].u
    assert last > 0.9
    loop.reset()
    assert loop([y[-1]]) == last
    free = made(limits=(-2.0, 2.0), hold=[0.5])
    for value in (0.1, 0.2, 0.3, 0.2):
        free([value])
    free.reset()
    assert free([0.1]) == 0.5


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize("limits", [(0.3, 2.0), (0.2, 0.2), (-2.0, -0.1)])
def test_the_first_inputs_are_within_the_limits(made, limits):
    loop = made(limits=limits)
    for _ in range(6):
        assert limits[0] <= loop([0.1])[0] <= limits[1]
    loop.reset()
    assert limits[0] <= loop([np.nan])[0] <= limits[1]


@pytest.mark.parametrize("hold", [5.0, 2.0])
def test_an_input_to_hold_that_breaks_a_limit_is_refused(made, hold):
    with pytest.raises(InputError, match="`hold` must be within the limits"):
        made(limits=LIMITS, hold=[hold])


def test_what_is_held_is_within_the_limits_of_the_first_step():
    low = np.array([[-0.1], [-5.0], [-5.0], [-5.0]])
    loop = se.regulate(([[1.0]], [[1.0]]), 4, limits=se.Limits(u=(low, -low)))
    assert loop([10.0]) == -0.1
    assert loop([np.nan]) == -0.1


def test_no_tube_where_the_loop_itself_saw_why_not(model):
    gain = se.gain(model, 1.0, 1.0)
    near = se.regulate(gain, limits=(-0.1, 0.1), offset_free=False)
    near.start(([[8.0], [8.0], [8.0]], [[0.0], [0.0]]))
    with pytest.raises(InputError, match="would be cut in step 1"):
        near.tube(6)
    wrong, y = se.regulate(gain, limits=(-2.0, 2.0), offset_free=True), [0.0, 0.0]
    for _ in range(80):
        y.append(0.2 * y[-1] + 0.4 * y[-2] - float(wrong([y[-1]])[0]) + 1.0)
    assert wrong.log[-1].status == "unproved"
    with pytest.raises(InputError, match="`tube` has no proof"):
        wrong.tube(5)


@pytest.fixture
def kept():
    """A loop with a promise for 20 calls: ``x+ = 0.9 x + u + 0.05 w``, x within 2."""
    x, u, w = np.random.default_rng(1).standard_normal((3, 200, 1))
    data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.05 * w)
    model = se.identify(data, noise=se.Noise(sigma=0.05))
    gain = se.gain(model, 1.0, 1.0)
    limits = se.Limits(u=(-3.0, 3.0), x=(-2.0, 2.0), soft=False)
    loop = se.regulate(model, 5, limits=limits, keep=se.Keep(gain, 20))
    return loop, gain


def test_a_promise_ends_with_its_calls_and_beyond_a_limit(kept):
    loop, _ = kept
    for _ in range(21):
        loop([0.1])
    assert loop.kept.ended is None
    loop([0.1])
    assert loop.kept.ended.endswith("its calls are over")
    assert loop.log[-1].reason == loop.kept.ended
    loop.reset()
    loop([0.1])
    loop([2.6])
    assert loop.log[-1].status == "unproved"
    assert loop.kept.ended.endswith("x[0] was beyond its limits")


def test_a_promise_ends_where_the_watch_rings(kept):
    loop, gain = kept
    loop.watch = gain.certificate(0.05).watch(every=1e3)
    x = 0.1
    for k in range(15):
        u = float(loop([x])[0])
        x = 0.9 * x + (1.0 if k < 5 else -3.0) * u + 0.4 * (k >= 5)
        if loop.log[-1].watch.status == "alarm":
            break
    assert loop.kept.ended is not None
    assert any("the watch rings" in str(call.reason) for call in loop.log)


def test_pairs_of_inputs_keep_the_rate(made):
    """Random readings, gaps and targets."""
    loop, rng, inputs = made(limits=LIMITS), np.random.default_rng(5), [0.0]
    for _ in range(300):
        y = rng.choice([np.nan, 1e9, 3.0 * rng.standard_normal()], p=[0.1, 0.05, 0.85])
        inputs.append(float(loop([y], target=[float(3.0 * rng.standard_normal())])[0]))
        if rng.random() < 0.02:
            loop.reset()
    assert all(abs(b - a) <= 0.3 + 1e-12 for a, b in pairwise(inputs))
    assert max(map(abs, inputs)) <= 2.0
