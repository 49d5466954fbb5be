"""What a learned bias says of a loop at rest: constants, sensors that are wrong, undecided."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stochens_rs as se
import two_masses
from coverage_study import sets
from stochens_rs.controls.set_point import points_of
from stochens_rs.loops.sensors import FALSE_ALARM, bounded, explained
from twin import causes

SIGMA = 0.05


def hidden(seed, p, m):
    """A stable plant of p states and m inputs, and a model from 8 logs of it."""
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((p, p)), rng.standard_normal((p, m))
    A *= rng.uniform(0.5, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    y, u = np.zeros((8, 61, p)), rng.standard_normal((8, 60, m))
    for t in range(60):
        y[:, t + 1] = y[:, t] @ A.T + u[:, t] @ B.T + SIGMA * rng.standard_normal((8, p))
    data = se.Trajectories(list(y), list(u), outputs=True)
    return A, B, se.identify(data, window=se.Window(lags=1), checks=False), rng


def ridden(seed, p, m, sensors=None, inputs=None, calls=400):
    """The explanation of a loop behind wrong sensors, and constants at its inputs."""
    A, B, model, rng = hidden(seed, p, m)
    target = np.full(p, np.nan)
    target[: min(p, m)] = rng.standard_normal(min(p, m))
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True, target=target)
    y, off, d = np.zeros(p), np.zeros(p), np.zeros(m)
    off[list(sensors or {})] = list((sensors or {}).values())
    d[list(inputs or {})] = list((inputs or {}).values())
    for _ in range(calls):
        u = loop(y + off)
        y = A @ y + B @ (u + d) + SIGMA * rng.standard_normal(p)
    return loop


def number(text, pattern):
    found = re.search(pattern, text)
    return None if found is None else float(found.group(1))


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize(("p", "m"), [(1, 1), (2, 1), (3, 1), (4, 2), (2, 2)])
def test_nothing_wrong_is_ever_named(p, m):
    """Hidden plants: none acts, one sensor is off, a constant acts. No verdict leaves it out."""
    named = 0
    for seed in range(sets(40, 2)):
        i, j = seed % p, seed % m
        assert ridden(seed, p, m).explanation is None
        for off in (20.0 * SIGMA, -60.0 * SIGMA):
            said = ridden(seed, p, m, sensors={i: off}).explanation
            more = "more" if off > 0.0 else "less"
            if said is not None:
                assert f"y[{i}] reads" in said
                size = number(said, rf"y\[{i}\] reads ([0-9.e+-]+) {more}")
                assert size is not None
                if p > 1:
                    assert abs(size - abs(off)) < 0.35 * abs(off)
                named += "undecided" not in said
            said = ridden(seed, p, m, inputs={j: off}).explanation
            if said is not None:
                assert abs(number(said, rf"(-?[0-9.e+-]+) at u\[{j}\]") - off) < 0.3 * abs(off)
    if p >= m + 2:
        assert named > 0
    else:
        assert named == 0  # which sensor it is cannot be seen


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_when_two_sensors_are_wrong_none_is_named_alone():
    """The anti-test: what is assumed, one cause, is broken; it is refuted, and said so."""
    said = [ridden(seed, 5, 1, sensors={0: 3.0, 3: -3.0}).explanation for seed in range(4)]
    said = [text for text in said if text is not None]
    assert said
    for text in said:
        assert "no single sensor explains what was learned at rest: a load acts elsewhere" in text
        assert "or two sensors are wrong" in text


def test_the_fit_is_exact_without_noise():
    """``e = M s`` and ``e = b d`` of the centre, by hand; a wide region explains them itself."""
    _, _, model, _ = hidden(1, 3, 1)
    H, L, y, u = model.coefficients, 0.05 * np.eye(3), np.zeros(3), np.zeros(1)
    M, b = np.eye(3) - H[:, :3], H[:, 3]
    for i, s in ((0, 4.0), (2, -2.5)):
        reads = y + s * np.eye(3)[i]
        said = explained(model, M[:, i] * s, L, reads, u)
        assert (
            said == f"y[{i}] reads {abs(s):.3g} {'more' if s > 0 else 'less'} than the others say"
        )
    assert explained(model, b * 1.5, L, y, u) == "a constant acts, as 1.5 at u[0]"
    assert explained(model, 1e-3 * b, L, y, u) is None
    # at a far point of rest the error of the model explains as much
    assert explained(model, b * 1.5, L, y, np.array([1e3])) is None


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize("intercept", [False, True])
@pytest.mark.parametrize(
    ("p", "m", "lags"), [(1, 1, 2), (2, 1, 1), (4, 1, 3), (5, 2, 1), (2, 3, 2)]
)
def test_the_core_finds_the_causes_of_the_plain_twin(p, m, lags, intercept):
    """Biases of one cause, of two, and of any, at places of rest that are near and far."""
    verdicts = set()
    for seed in range(sets(6, 2)):
        data, rng = hidden(seed, p, m)[2].data, np.random.default_rng(seed)
        window = se.Window(lags=lags)
        model = se.identify(data, window=window, intercept=intercept, checks=False)
        (region, noise), points = bounded(model), points_of(model)
        H, L = model.coefficients, rng.uniform(0.02, 0.2) * np.eye(p)
        L = L + 0.01 * rng.standard_normal((p, p))
        y_of, u_of = np.split(H[:, : lags * (p + m)], [lags * p], axis=1)
        M = np.eye(p) - y_of.reshape(p, lags, p).sum(axis=1)
        b = u_of.reshape(p, lags, m).sum(axis=1)
        for size in (1e-3, 0.3, 3.0):
            two, some = size * rng.standard_normal(p), b @ rng.standard_normal(m) * size
            two[2:] = 0.0  # of sensors, or of loads
            for bias in (M[:, 0] * size, M @ two, some, two, 0.0 * two):
                rest = rng.choice([0.1, 5.0, 1e3]) * rng.standard_normal(p + m)
                learned = bias, int(rng.integers(1, 60)), np.ascontiguousarray(L), noise, rest
                found = points.causes(region.core, learned, FALSE_ALARM)
                wanted = causes.causes(H, lags, region, learned, FALSE_ALARM)
                assert (found is None) == (wanted is None)
                if found is None:
                    verdicts.add(None)
                    continue
                (constants, sensors, pair), (its, their, both) = found, wanted
                assert (pair, constants is None) == (both, its is None)
                if its is not None:
                    np.testing.assert_allclose(constants, its, rtol=1e-7, atol=1e-9 * size)
                for of, twin in zip(sensors, their, strict=True):
                    assert (of is None) == (twin is None)
                    assert of is None or of == pytest.approx(twin, rel=1e-7, abs=1e-9)
                verdicts.add((constants is None, sum(of is not None for of in sensors), pair))
    assert len(verdicts) >= (2 if p == 1 else 3)


def test_when_there_is_nothing_to_say():
    loop = ridden(1, 3, 1, sensors={0: 3.0}, calls=50)
    assert loop.explanation is None  # not for long enough
    model = hidden(1, 3, 1)[2]
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=False, target=[0.0, np.nan, np.nan])
    assert loop.explanation is None


@pytest.mark.parametrize("constant", [-0.1, -0.3, 1.0])
def test_a_constant_at_the_input_of_a_long_window_is_said(constant):
    """Many lags: what the region may be off is an ellipsoid, of which no ball is needed."""
    drive = two_masses.Drive(np.random.default_rng(3))
    drive.at_input = constant
    said = two_masses.ride(two_masses.loop(), drive, 1200).explanation
    assert number(said, "^a constant acts, as (-?[0-9.e+-]+) at torque$") == pytest.approx(
        constant, rel=0.1
    )


@pytest.mark.parametrize("load", [-0.3, 0.1, 0.4])
def test_a_load_at_no_input_accuses_no_sensor(load):
    drive = two_masses.Drive(np.random.default_rng(3))
    drive.load = load
    said = two_masses.ride(two_masses.loop(), drive, 1200).explanation
    assert said.startswith("a load acts elsewhere than at torque, or motor reads ")
    assert said.endswith("undecided which")
    still = two_masses.ride(two_masses.loop(), two_masses.Drive(np.random.default_rng(3)), 1200)
    assert still.explanation is None


def test_readings_of_the_wrong_sign_do_not_follow_the_model():
    drive = two_masses.Drive(np.random.default_rng(1))
    drive.x[:2] = 0.8
    loop = two_masses.ride(two_masses.loop(), drive, 400, sign=-1.0)
    last = loop.log[-1]
    assert last.status == "unproved"
    assert "the readings do not follow the model: for many calls no system explains" in last.reason
    assert {call.status for call in loop.log} == {"filling", "gain", "unproved"}
    loop.reset()
    well = two_masses.ride(loop, two_masses.Drive(np.random.default_rng(1)), 400)
    assert {call.status for call in well.log} == {"filling", "gain"}


def test_an_angle_that_turns_on_is_not_outside_of_the_logs():
    """An output that integrates may go anywhere; see the next test for one that does not."""
    loop, drive = two_masses.loop(), two_masses.Drive(np.random.default_rng(1))
    loop.target = {"load": 4.0 * np.arange(1000.0)}  # 4000 degrees
    two_masses.ride(loop, drive, 1000)
    assert loop.log[-1].y[1] > 3500.0
    assert {call.status for call in list(loop.log)[20:]} == {"gain"}


def test_readings_far_outside_of_the_logs_prove_nothing():
    """All in kelvin."""
    rng = np.random.default_rng(1)
    y, u = np.full((400, 2), 15.0), rng.uniform(0.0, 10.0, (399, 1))
    for k in range(399):
        warms = 0.1 * (y[k, ::-1] - y[k]) + 0.1 * (10.0 - y[k]) + [0.1 * u[k, 0], 0.0]
        y[k + 1] = y[k] + warms + 0.02 * rng.standard_normal(2)
    data = se.Trajectories([y], [u], outputs=True, state_names=["a", "b"])
    model = se.identify(data, window=se.Window(lags=2), intercept=True, checks=False)
    gain = se.gain(model, 1.0, 1.0)
    loop = se.regulate(gain, target={"a": 15.0}, limits=(0.0, 10.0), offset_free=True)
    for now in y:
        loop(now)
    assert {call.status for call in loop.log} == {"filling", "gain"}
    loop.reset()
    for now in y:
        u = loop(now + 273.15)
    last = loop.log[-1]
    assert (last.status, u.tolist()) == ("unproved", [0.0])
    assert "is far outside of the logs, which had" in last.reason
    assert last.reason.endswith(": nothing is proved")
