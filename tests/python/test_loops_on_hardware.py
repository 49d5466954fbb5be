"""Loops beside a plant: what sensors send, targets that are no points of rest, tubes about them."""

from __future__ import annotations

import copy
import pickle
import threading
from typing import NamedTuple

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from hidden_outputs import Arx, of_lags, one_log, regulated_belt
from stochens_rs.exceptions import (
    InputError,
    InputTypeError,
    NonFiniteError,
    ShapeError,
    StateError,
)
from stochens_rs.loops import readings as gate

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
LIMITS, TARGET = (-3.0, 3.0), [4.0, 40.0]
TAKEN = "rejected 3 times, and so no false reading: now taken for true"


@pytest.fixture(scope="module")
def belt():
    return regulated_belt()


@pytest.fixture(scope="module")
def loops(belt):
    """Every kind of loop in the middle of its work, and a good reading for it."""
    _, model, gain = belt
    x, u, w = np.random.default_rng(1).standard_normal((3, 100, 1))
    states = se.identify(
        se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.05 * w), noise=se.Noise(sigma=0.05)
    )
    one = se.gain(states, 1.0, 1.0)
    cost, far = se.Cost(Q=[1.0, 0.01], R=0.1), np.array(TARGET)
    rate = se.Limits(u=LIMITS, rate=0.5, previous=0.0)
    made = {
        "gain": (one, np.ones(1)),
        "plans": (se.regulate(states, 5, limits=LIMITS), np.ones(1)),
        "rate": (se.regulate(states, 5, limits=rate), np.ones(1)),
        "kept": (se.regulate(states, 5, limits=LIMITS, keep=se.Keep(one, 99)), np.ones(1)),
        "readings": (se.regulate(gain, offset_free=True, target=TARGET, limits=LIMITS), far),
        "plans of readings": (
            se.regulate(model, 20, offset_free=True, target=TARGET, limits=LIMITS, cost=cost),
            far,
        ),
    }
    for loop, good in made.values():
        for _ in range(model.window.fill + 2):
            loop(good)
    return made


NAMES = ["gain", "plans", "rate", "kept", "readings", "plans of readings"]
WRONG = {
    "complex": ([1j], InputTypeError),
    "text": (["1.0"], InputTypeError),
    "word": ("1.0", InputTypeError),
    "bool": ([True], InputTypeError),
    "date": (np.array(["2020-01-01"], dtype="datetime64[D]"), InputTypeError),
    "span": (np.array([1], dtype="timedelta64[s]"), InputTypeError),
    "none": ([None], InputTypeError),
    "long": ([10**400], InputTypeError),
    "shape": ([[1.0]], ShapeError),
    "many": ([1.0] * 7, ShapeError),
}


@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_number_raises_and_changes_nothing(loops, name):
    loop, good = loops[name]
    before = pickle.dumps(loop)
    for value, error in WRONG.values():
        row = value * len(good) if isinstance(value, list) and len(value) == 1 else value
        row = np.repeat(row, len(good)) if isinstance(row, np.ndarray) else row
        with pytest.raises(error, match=r"^`[xy]` "):
            loop(row)
    assert pickle.dumps(loop) == before


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308])
def test_a_gain_gives_no_force_that_is_not_finite(bad):
    """It remembers no input to hold. ``Loop([1e308, 1e308])`` returned -inf."""
    loop = se.gain(([[3.0, 0.1], [0.0, 3.0]], np.eye(2)), 1.0, 1.0)
    with pytest.raises(NonFiniteError, match="`x` must be finite"):
        loop([bad, bad])


@pytest.mark.parametrize("name", NAMES[1:])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e308, -1e300, 1e155])
def test_a_broken_sensor_holds_and_is_said(loops, name, bad):
    """The force was nan for ever after one 1e308."""
    loop, good = loops[name]
    loop, usual = copy.deepcopy(loop), copy.deepcopy(loop)
    for at in range(len(good)):
        row = good.copy()
        row[at] = bad
        for _ in range(12):
            u = loop(row)
            assert ((u >= LIMITS[0]) & (u <= LIMITS[1])).all()
            assert loop.log[-1].reason
        for _ in range(40):
            u = loop(good)
            usual(good)
        assert loop.log[-1].reason is None
        np.testing.assert_allclose(u, usual(good), atol=0.3)


@pytest.mark.parametrize("name", NAMES)
def test_attributes_that_do_not_exist_cannot_be_set(loops, name):
    for attribute in ("aim", "limit", "K2", "plan"):
        with pytest.raises(AttributeError):
            setattr(loops[name][0], attribute, 1.0)


@pytest.mark.parametrize("held", [0, 2])
@pytest.mark.parametrize("name", NAMES[1:])
def test_a_saved_loop_goes_on(loops, name, held, tmp_path):
    loop, good = copy.deepcopy(loops[name])
    for _ in range(held):
        loop(np.nan * good)
    loop.save(tmp_path / "loop")
    again = type(loop).load(tmp_path / "loop")
    assert again.log == ()
    assert again.calls == loop.calls
    for other in (again, pickle.loads(pickle.dumps(loop)), copy.deepcopy(loop)):
        one, two = copy.deepcopy(loop), other
        for k in range(20):
            read = good + (0.01 * np.sin(k + np.arange(len(good))) if k else np.nan)
            np.testing.assert_array_equal(one(read), two(read))
    other = se.loops.ReadingLoop if isinstance(loop, se.loops.Regulator) else se.loops.Regulator
    with pytest.raises(StateError, match="must be of a"):
        other.load(tmp_path / "loop")


def test_a_loop_of_readings_in_two_threads(belt):
    loop, seen = se.regulate(belt[2], offset_free=True), []
    inside, go = threading.Event(), threading.Event()

    class Slow:
        def __array__(self, dtype=None, copy=None):
            inside.set()
            go.wait(10.0)
            return np.zeros(2)

    thread = threading.Thread(target=lambda: seen.append(loop(Slow())))
    thread.start()
    assert inside.wait(10.0)
    for use in (lambda: loop([0.0, 0.0]), loop.reset, lambda: loop.start("rest")):
        with pytest.raises(InputError, match="in use by another thread"):
            use()
    with pytest.raises(InputError, match="in use"):
        pickle.dumps(loop)
    go.set()
    thread.join()
    assert loop.calls == len(seen) == 1


# -- the gate ------------------------------------------------------------------------------------


def test_true_readings_pass_the_gate_as_often_as_said(monkeypatch):
    """8 systems, 250 calls each, at 5 % in place of 1e-5; with 3 times the noise it must fail."""
    monkeypatch.setattr(gate, "FALSE_ALARM", 0.05)
    rejected = {1.0: 0, 3.0: 0}
    for seed in range(8):
        rng = np.random.default_rng([11, seed])
        system = Arx(rng)
        model = system.model(14, 50, rng)
        own, J, window = gate.gate_of(model), model.loop.J, model.window
        centre = model.region(0.05, method="mixture").centre
        for noise in rejected:
            y, u = system.run(20, rng)
            x = window.state_of(y, u)
            for _ in range(250):
                act = np.clip(system.K @ y[-1], -1.0, 1.0)
                read = system.follow(y[-9:], u[-9:], [act], rng, noise)[0]
                z = J @ np.concatenate([x, act])
                off = read - centre @ z
                rejected[noise] += own.excess(off, z, [True] * len(read)) > 1.0
                read = system.follow(y[-9:], u[-9:], [act], rng, 1.0)[
                    0
                ]  # the loop goes on as usual
                y, u = np.vstack([y, read]), np.vstack([u, act])
                x = window.core.advance(x, read, act)
    assert rejected[1.0] <= 0.05 * 2000
    assert rejected[3.0] > 0.05 * 2000


def test_the_gate_stands_where_the_tests_of_the_log_withhold_certificates(belt):
    _, model, _ = belt
    doubted = se.identify(model.data, checks=False, window=se.Window(filters=(0.6, 4)))
    assert "memory" in doubted._faults
    given = np.ones(2), np.ones(model.window.length), [True, True]
    one, other = (gate.gate_of(m).excess(*given) for m in (model, doubted))
    assert one == other


def driven(belt, faults, steps=700, force=0.0, **options):
    """How far off its target the load is, and the loop; a force acts from 300 on."""
    plant, _, gain = belt
    loop = se.regulate(gain, offset_free=True, target=TARGET, limits=LIMITS, **options)
    k, inputs = 0, []

    def act(read):
        nonlocal k
        read = read.copy()
        faults(k, read)
        k += 1
        inputs.append(loop(read))
        return inputs[-1] + (force if k > 300 else 0.0)

    _, _, true = plant.simulate(act, steps, np.random.default_rng(2))
    assert np.isfinite(inputs).all()
    assert (np.abs(inputs) <= 3.0).all()
    return np.abs(true[:, 1] - 40.0), loop


@pytest.mark.parametrize("spike", [0.05, 0.5, 10.0, 1e4, 1e9, 1e300, np.nan])
@pytest.mark.parametrize("count", [1, 3])
def test_false_readings_do_nothing(belt, spike, count):
    """Before: .42 mm at 10 mm; 1e4: 115 steps beyond .5 mm, 7.6 mm at most; 1e9: 247, 34 mm."""

    def fault(k, read):
        if 300 <= k < 300 + count:
            read[1] += spike

    off, loop = driven(belt, fault, 600)
    assert off[300:].max() < 0.3
    told = [k for k, call in enumerate(loop.log) if call.reason and k > 290]
    if not abs(spike) <= 0.5:
        assert told == list(range(300, 300 + count))


def test_the_picture_of_a_loop_shows_what_was_not_taken_for_true(belt):
    pytest.importorskip("matplotlib")
    faults = {300: (1, 1e300), 310: (1, 80.0), 320: (0, np.nan)}

    def fault(k, read):
        if k in faults:
            read[faults[k][0]] += faults[k][1]

    loop = driven(belt, fault, 400)[1]
    *panels, _, _ = loop.plot().axes
    for i, (ax, rows) in enumerate(zip(panels, ([310, 320], [300, 310]), strict=True)):
        lines = {line.get_label(): np.array(line.get_ydata()) for line in ax.get_lines()}
        calls, log = lines["predicted, not read"], loop.log
        assert np.flatnonzero(np.isfinite(calls[290:])).tolist() == [row - 290 for row in rows]
        np.testing.assert_array_equal(calls[rows], [log[row].predicted[i] for row in rows])
        assert not np.isfinite(lines["measured"][rows]).any()
        assert (lines["target"] == TARGET[i]).all()
        assert [log[row].rejected for row in (299, 300, 310, 320)] == [False, False, True, False]


def after_false_readings(belt, size):
    """How far off the load is at most, with one false reading or two before the window is full."""
    worst = 0.0
    for at in ((0,), (1,), (2,), (9,), (20,), (27,), (28,), (0, 2), (8, 13)):
        for i in (0, 1):

            def fault(k, read, at=at, i=i):
                read[i] += size * (k in at)

            worst = max(worst, driven(belt, fault, 350)[0][200:].max())
    return worst


@pytest.mark.parametrize("size", [80.0, -1e5])
def test_false_readings_before_the_window_is_full(belt, size):
    """Nothing rejected them there; with 12 lags one of 50 belts was 32 mm off for 700 calls."""
    assert after_false_readings(belt, size) < 0.3


def test_without_a_gate_they_stay(belt, monkeypatch):
    monkeypatch.setattr(gate, "gate_of", lambda model: None)
    assert after_false_readings(belt, -1e5) > 10.0


@pytest.mark.parametrize("spike", [80.0, -80.0, 1e3])
def test_a_false_reading_as_a_force_begins(belt, spike):
    """Three true ones are rejected behind it: 37 mm off, as it was believed with them."""

    def fault(k, read):
        read[0] += spike * (k == 300)

    off, loop = driven(belt, fault, 600, force=2.0)
    alone, _ = driven(belt, lambda k, read: None, 600, force=2.0)
    assert off[250:].max() < 1.2 * alone[250:].max()
    assert off[-100:].max() < 0.3
    assert TAKEN in {call.reason for call in loop.log}


def test_a_change_of_the_plant_is_believed(belt):
    """A constant 1 A is learned; a sensor that is 2 mm off for ever is believed, and said."""
    plant, _, gain = belt
    loop, k = se.regulate(gain, offset_free=True, target=TARGET, limits=LIMITS), 0

    def act(read):
        nonlocal k
        k += 1
        return loop(read) + (1.0 if k > 300 else 0.0)

    _, _, true = plant.simulate(act, 900, np.random.default_rng(2))
    # as one that acts at the input
    b = loop._point.of_bias[2:]
    assert b @ loop.bias == pytest.approx([-1.0], abs=0.1)
    assert abs(true[-100:, 1].mean() - 40.0) < 0.1
    assert sum(call.reason is not None for call in loop.log) < 60

    def off(k, read):
        read[1] += 2.0 if k >= 300 else 0.0

    _, loop = driven(belt, off, 900)
    assert "rejected, " in loop.log[300].reason
    assert TAKEN in {call.reason for call in loop.log[300:]}
    assert {call.status for call in loop.log[310:]} == {"gain"}


@pytest.mark.parametrize("a", [[-1.04], [1.04], [-0.99, -0.99], [0.0, 0.0, 0.99], [1.9, -0.95]])
def test_a_force_that_hides_behind_the_gate_is_believed(a):
    """y+ = -1.04 y + u + 10 sd: what takes the place of a rejected reading brings the next back."""
    rng, count = np.random.default_rng(0), len(a)
    y, u = np.zeros((40, 30, 1)), rng.standard_normal((40, 29, 1))
    for t in range(29):
        past = sum(a[i] * y[:, t - i] for i in range(min(count, t + 1)))
        y[:, t + 1] = past + u[:, t] + 0.1 * rng.standard_normal((40, 1))
    model = se.identify(
        se.Trajectories(list(y), list(u), outputs=True), window=se.Window(lags=count)
    )
    for force, spikes in ((1.0, 0.0), (3.0, 0.0), (0.0, 0.1)):
        loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
        past, off = np.zeros(count), []
        for t in range(400):
            read = past[:1] + (rng.random() < spikes) * rng.uniform(-50.0, 50.0, 1)
            act = float(loop(read)[0]) + force * (t >= 100) + 0.1 * rng.standard_normal()
            past = np.r_[a @ past + act, past[:-1]]
            off.append(abs(past[0]))
        why = [one.reason or "" for one in loop.log]
        assert sum("as far off as the gate" in text for text in why) <= (12 if force else 60)
        assert np.mean(off[-100:]) < 0.15  # it was .9, with every second reading rejected
        assert force or not any(TAKEN in text for text in why)


def test_the_cap_keeps_the_disturbance_within_the_limits(belt):
    """Four false readings in a row are believed; behind them the loop comes back."""

    def fault(k, read):
        if 300 <= k < 304:
            read[1] += 1e4

    off, loop = driven(belt, fault, 900)
    of_bias, us = loop._point.of_bias[2:], loop._point.place[2:]
    most = max(abs(us[0] + (of_bias @ call.bias)[0]) for call in loop.log)
    assert most <= 3.0 + 1e-9
    assert off[-100:].max() < 0.3


def test_the_cap_of_more_inputs_than_outputs():
    """y+ = .8 y + u_0 + .5 u_1 + 3: both inputs at their limits cannot be met; the bias jumped."""
    b = np.array([1.0, 0.5])
    model = of_lags(*one_log(lambda y, u: 0.8 * y[-1] + u[-1] @ b, 3, sizes=(1, 2)))
    low, high = np.array([-1.0, -0.3]), np.array([0.4, 1.5])
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=0.3, limits=(low, high))
    read, found = np.zeros(1), []
    for t in range(120):
        act = loop(read)
        wanted = loop._point.of_bias[1:] @ loop.bias
        assert ((wanted >= low - 1e-6) & (wanted <= high + 1e-6)).all()
        found.append(loop.bias[0])
        read = 0.8 * read + act @ b + (3.0 if 20 <= t < 80 else 0.0)
    found = np.array(found)
    assert np.ptp(found[60:80]) < 1e-6
    assert found[70] > 0.2
    assert abs(found[-1]) < 0.1


@pytest.mark.parametrize("seed", range(sets(4, 1)))
def test_random_faults_never_leave_the_limits(belt, seed):
    """10 000 calls, in `make test` 3000, with every kind of fault: always said, back in the end."""
    gen, faulty, calls = np.random.default_rng(seed), set(), sets(10_000, 2_000)

    def fault(k, read):
        if k > calls - 300 or gen.random() > 0.05:
            return
        faulty.add(k)
        wrong = gen.choice([np.nan, np.inf, -1e300, 1e20, 1e6, 500.0, -80.0])
        read[gen.integers(2) if gen.random() < 0.5 else slice(None)] = wrong

    off, loop = driven(belt, fault, calls)
    assert loop.calls == calls
    first = loop.calls - len(loop.log)
    for k, call in enumerate(loop.log, start=first):
        assert call.reason or k not in faulty
    assert off[-100:].max() < 0.3


def every(count, *outputs):
    def fault(k, read):
        if k % count:
            read[list(outputs)] = np.nan

    return fault


@pytest.mark.parametrize(
    ("faults", "most"),
    [
        (every(1), 0),
        (every(2, 0, 1), 4),
        (every(4, 0, 1), 40),
        (every(2, 1), 4),
        (every(10**6, 1), 40),
        (every(10**6, 0, 1), None),
    ],
)
def test_a_window_that_never_fills_is_estimated(belt, faults, most):
    """With every second reading from the start the loop returned 0 for ever."""
    off, loop = driven(belt, faults, 300)
    began = [k for k, call in enumerate(loop.log) if call.status == "gain"]
    if most is None:
        assert loop.log[-1].status == "cannot start"
        assert "of phi 1 of 300 were read" in loop.log[-1].reason
        return
    assert loop.model.window.fill <= began[0] <= loop.model.window.fill + most
    assert loop.log[0].status == "filling"
    assert "will do, or 2" in loop.log[0].reason
    assert off[-50:].max() < 0.6


# -- targets -------------------------------------------------------------------------------------


def test_targets_that_are_no_points_of_rest(belt):
    """45 mm at 4 rad was "certified": the load went to 6.7 mm, -66.7 mm, and for 400 mm to -532."""
    plant, model, gain = belt
    cost = se.Cost(Q=[1.0, 0.01], R=0.1)
    for target in ([4.0, 45.0], [4.0, 400.0], [0.0, 3.0]):
        for use in (
            lambda target=target: se.regulate(gain, offset_free=True, target=target),
            lambda target=target: se.regulate(
                model, 20, offset_free=False, target=target, cost=cost
            ),
            lambda target=target: se.control(model, record="rest", target=target, steps=60),
        ):
            with pytest.raises(InputError, match=r"in no system.*: the nearest is \(") as said:
                use()
    place = said.value.args[0].split("nearest is (")[1].split(")")[0]
    nearest = [float(one) for one in place.split(", ")]
    assert nearest[1] == pytest.approx(10.0 * nearest[0], rel=1e-2)
    loop = se.regulate(gain, offset_free=True, target=[4.25, 42.5], limits=LIMITS)
    _, _, true = plant.simulate(loop, 700, np.random.default_rng(2))
    assert abs(true[-100:, 1].mean() - 42.5) < 0.1


def test_the_nearest_point_of_rest_is_within_the_limits():
    """y+ = .5 y + u rests at y = 2 u."""
    model = of_lags(*one_log(lambda y, u: 0.5 * y[-1] + u[-1], 1), checks=False)
    gain = se.gain(model, 1.0, 1.0)
    assert se.regulate(gain, offset_free=True, target=[2.0]).log == ()
    with pytest.raises(InputError, match=r"the nearest is \(.*held by the limit of u\[0\]"):
        se.regulate(gain, offset_free=True, target=[2.0], limits=(-0.5, 0.5))
    loop = se.regulate(gain, offset_free=True, target=[0.9], limits=(-0.5, 0.5))
    assert loop.rest.inputs == pytest.approx([0.45], abs=0.02)


def test_control_weighs_inputs_from_those_that_hold_the_target():
    """y+ = .9 y + .1 u: it ended at 44 for 50, as R was about u and not about u - 50."""
    y, u = one_log(lambda y, u: 0.9 * y[-1] + 3.0 * u[-1], 1, 400, noise=0.01)
    model = of_lags(y, 30.0 * u, checks=False)
    for limits in (None, (-20.0, 80.0)):
        plan = se.control(
            model, record="rest", target=[50.0], steps=120, cost=se.Cost(Q=1.0, R=1.0),
            limits=limits,
        )  # fmt: skip
        assert plan.predicted_outputs[-1] == pytest.approx([50.0], abs=0.05)
        assert plan.u[-1] == pytest.approx([50.0], abs=0.5)
        if limits is not None:
            assert plan.u.max() <= 80.0
        # the cost is about u_s, and the plan the best of those near it
        horizon = plan.limited
        u_s = horizon.task.resting
        assert u_s == pytest.approx([50.0], abs=0.1)
        again = se.Plan.from_dict(plan.to_dict())
        np.testing.assert_array_equal(again.limited.task.resting, u_s)


# -- certificates about the target ---------------------------------------------------------------


def members(proof, model, count, rng, z):
    """Systems on the boundary of the region, half of them the worst for the point of rest z."""
    region = model.region(0.05)
    part, C = region.parts[0], region.centre
    D = np.linalg.cholesky(np.asarray(part.S) * part.factor)
    W = np.asarray(part.white)
    for k in range(count):
        G = np.outer(rng.standard_normal(2), W @ z) if k % 2 else rng.standard_normal((2, len(W)))
        yield model.window.loop(C + D @ (G / np.linalg.norm(G, 2)) @ W).ABc


class Place(NamedTuple):
    """A window and inputs at rest."""

    x: np.ndarray
    u: np.ndarray


def test_one_tube_about_the_target(belt):
    """It was +-76 mm by `rest=` and +-1.9 mm as the way from -xs to 0, which is another loop."""
    _, model, gain = belt
    loop = se.regulate(gain, offset_free=False, target=TARGET, limits=LIMITS)
    proof, rest = (
        loop.certificate(0.05),
        Place(*loop._point.moving(*[np.zeros(2)] * 3, np.zeros(1))),
    )
    assert proof.status == "certified"
    np.testing.assert_array_equal(proof.rest().states, rest.x)
    np.testing.assert_array_equal(proof.rest().inputs, rest.u)
    x0, K = np.zeros(model.n), 60
    tube, given = proof.tube(x0, K), proof.tube(x0, K, rest=proof.rest(rest.x))
    np.testing.assert_allclose(tube.components, given.components, rtol=1e-3)
    assert tube.components[:, 1].max() < 3.0
    z, n = np.concatenate([np.tile(rest.x[: model.n_outputs], 4), np.tile(rest.u, 4)]), model.n
    worst, beside = np.zeros(2), 0.0
    systems = np.array(list(members(proof, model, 60, np.random.default_rng(1), z)))
    x = np.tile(x0, (60, 1))
    for k in range(400):
        whole = np.hstack([x, rest.u + (x - rest.x) @ proof.K.T])
        if k <= K:
            off = np.abs(x - tube.states[k])
            assert (off <= tube.components[k] + 1e-9).all()
            worst = np.maximum(worst, off[:, :2].max(axis=0))
        assert (np.abs(whole) <= tube.reach).all()
        x = (systems @ whole[:, :, None])[:, :, 0]
    for system in systems:
        point = np.linalg.solve(
            np.eye(n) - system[:, :n] - system[:, n:] @ proof.K,
            system[:, n:] @ (rest.u - proof.K @ rest.x),
        )
        assert (np.abs(point - rest.x) <= proof.rest().components).all()
        beside = max(beside, abs(point - rest.x)[1])
    assert tube.components[:, 1].max() < 8.0 * worst[1]
    assert proof.rest().components[1] < 2.0 * beside
    with pytest.raises(InputError, match="rests at 0"):
        proof.holds(LIMITS)
    again = se.feedback.LoopCertificate.from_dict(proof.to_dict())
    np.testing.assert_array_equal(again.rest().states, rest.x)
