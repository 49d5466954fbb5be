"""Plans and loops of models of outputs: coverage of their bounds, loops from readings."""

from __future__ import annotations

import pickle
import time

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from hidden_outputs import Arx, Rig, of_lags, one_log
from stochens_rs._base import show as html
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")


def arx(seed, runs=14, steps=50):
    """A system, a model of it, a record, and the source of its noise."""
    rng = np.random.default_rng([7, seed])
    system = Arx(rng)
    model = system.model(runs, steps, rng)
    return system, model, system.run(20, rng), rng


def test_readings_are_in_the_tube_and_their_mean_alone_is_not_enough():
    """80 systems, in `make test` 15, 5 fresh runs of 10 steps each; seen 0, 3, 2 of 400 outside."""
    systems = sets(80, 15)
    outside = dict.fromkeys((0.05, 0.5, "each", "without noise"), 0)
    missed = 0
    for seed in range(systems):
        system, model, record, _ = arx(seed)
        plan = se.control(model, record=record, steps=10)
        rng, predicted = np.random.default_rng([8, seed]), plan.predicted_outputs[1:]
        bounds = {delta: plan.bound(delta) for delta in (0.05, 0.5)}
        mean = system.follow(*record, plan.u, rng, noise=0.0)
        missed += (np.linalg.norm(mean - predicted, axis=1) > bounds[0.5].mean[1:]).any()
        for _ in range(5):
            off = system.follow(*record, plan.u, rng) - predicted
            sizes = np.linalg.norm(off, axis=1)
            for delta, bound in bounds.items():
                outside[delta] += (sizes > bound.tube[1:]).any()
            outside["each"] += (np.abs(off) > bounds[0.5]["readings"].radius[1:]).any()
            outside["without noise"] += (sizes > bounds[0.05].mean[1:]).any()
    assert outside[0.05] <= 0.25 * systems
    assert outside[0.5] <= 2.5 * systems
    assert outside["each"] <= 2.5 * systems
    assert outside["without noise"] > 3.5 * systems  # the anti-test
    assert missed == 0


def test_a_plan_and_its_certificate():
    system, model, record, rng = arx(3)
    plan = se.control(model, record=record, steps=10, limits=(-2.0, 2.0), target=[0.0] * system.p)
    bound = plan.bound(0.05)
    assert plan.predicted_outputs.shape == (11, system.p)
    np.testing.assert_array_equal(plan.predicted_outputs[0], record[0][-1])
    np.testing.assert_allclose(
        plan.predicted_outputs, plan.predicted_states[:, : system.p], atol=1e-12
    )
    assert bound.tube.shape == bound.mean.shape == (11,)
    assert bound.outputs.shape == (10, system.p)
    assert bound.tube[0] == bound.mean[0] == 0.0
    assert (bound.mean[1:] < bound.tube[1:]).all()
    last = np.linalg.norm(bound.tube[-model.window.count :])
    assert last <= bound.target <= sum(bound.parts.values()) * (1.0 + 1e-12)
    assert "readings" in bound["tube"].text
    mean = plan.bound(0.05, noise=False)
    assert "means" in mean["tube"].text
    assert mean.target < bound.target
    np.testing.assert_array_equal(mean.tube, mean.mean)
    # the last p outputs together
    away = np.linalg.norm(system.follow(*record, plan.u, rng)[-model.window.count :])
    assert away <= bound.target
    assert len(plan.plot().axes) == system.p + system.m
    assert len(bound.plot().axes) >= 2
    assert se.Certificate.from_dict(bound.to_dict()) == bound


def test_an_offset_in_the_model():
    y, u = one_log(lambda y, u: 1.1 * y[-1] - 0.3 * y[-2] + u[-1] + 0.4, 5, 400, noise=0.02, lags=2)
    model = of_lags(y, u, 2, intercept=True)
    plan = se.control(model, record=(y[-9:], u[-8:]), target=[1.0], steps=6, limits=(-2.0, 2.0))
    np.testing.assert_allclose(plan.predicted_outputs[-2:, 0], 1.0, atol=1e-5)
    loop = se.regulate(model, 10, offset_free=False, target=[1.0], cost=se.Cost(Q=[1.0], R=1.0))
    y = [0.0, 0.0]
    for _ in range(60):
        y.append(1.1 * y[-1] - 0.3 * y[-2] + loop([y[-1]])[0] + 0.4)
    assert abs(y[-1] - 1.0) < 0.05


def test_filters():
    _, _, record, rng = arx(3)
    system = Arx(np.random.default_rng([7, 3]))
    data = system.data(14, 80, rng)
    model = se.identify(data, checks=False, window=se.Window(filters=(0.3, system.lags + 2)))
    record = system.run(60, rng)
    plan = se.control(model, record=record, steps=8, limits=(-3.0, 3.0))
    ahead = (
        model.coefficients @ model.loop.J @ np.concatenate([plan.predicted_states[0], plan.u[0]])
    )
    np.testing.assert_allclose(plan.predicted_outputs[1], ahead)
    assert np.isfinite(plan.bound(noise=False).tube[1])
    proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    assert proof.region.n == model.n


@pytest.mark.parametrize("filters", [(1 - 1e-9, 2), (0.5, 2**16), (0.99999, 1)])
def test_filters_that_fill_too_slowly_are_refused_at_once(filters):
    data = arx(3)[1].data
    began = time.perf_counter()
    with pytest.raises(InputError, match=r"`filters` must be a pole .* got \(0\.\d+, \d+\)"):
        se.identify(data, checks=False, window=se.Window(filters=filters))
    assert time.perf_counter() - began < 1.0


def test_the_last_record_is_that_of_the_last_piece():
    x, u = np.arange(12.0)[:, None], np.arange(11.0)[:, None]
    data = se.Trajectories([x, x + 20.0], [u, u], outputs=True)
    y, v = data.last_record()
    np.testing.assert_array_equal(y, x + 20.0)
    np.testing.assert_array_equal(v, u)


def test_the_last_record_of_enough_rows():
    """A lost cell near the end leaves a short piece there; the one before it is long enough."""
    x = np.sin(np.arange(30.0) ** 2)
    table = {"y": x.copy(), "u": np.cos(np.arange(30.0) ** 3)}
    table["y"][26] = np.nan
    data = se.Trajectories.from_table(table, outputs=["y"], inputs=["u"])
    assert len(data.last_record()[0]) == 3
    y, u = data.last_record(5)
    np.testing.assert_array_equal(y[:, 0], x[:26])
    np.testing.assert_array_equal(u[:, 0], table["u"][:25])
    with pytest.raises(InputError, match=r"`rows` must be at most 26, .*, got 27"):
        data.last_record(27)
    model = se.identify(data, window=se.Window(lags=4, delay=1), checks=False)
    plan = {"target": [0.0], "steps": 6}
    with pytest.raises(InputError, match=r"in Python data\.last_record\(5\) is the last piece"):
        se.control(model, record=data.last_record(), **plan)
    assert se.control(model, record=data.last_record(5), **plan).u.shape == (6, 1)


def plant(system, loop, steps, rng=None, force=0.0, noise=0.0, missing=()):
    """Readings of a loop around an ARX system, from a record in which it was pushed."""
    y = [np.ones(system.p)] * system.lags
    u = [np.zeros(system.m)] * (system.lags - 1)
    acted = loop.start((np.array(y), np.array(u).reshape(-1, system.m)))
    for k in range(steps):
        past, u = range(system.lags), [*u, acted]
        mean = sum(system.A[i] @ y[-1 - i] + system.B[i] @ (u[-1 - i] + force) for i in past)
        y.append(mean if rng is None else mean + noise * system.L @ rng.standard_normal(system.p))
        acted = loop(np.full(system.p, np.nan) if k in missing else y[-1])
    return np.array(y)


def test_mismatched_plants_rest_at_the_target():
    """50 plants, in `make test` 4, 3 % off their models; a constant of .3 at the inputs."""
    rested, plants = 0, sets(50, 4)
    for seed in range(plants):
        system, model, _, rng = arx(seed, runs=6)
        system.A = system.A * (1.0 + 0.03 * rng.standard_normal(system.A.shape))
        system.B = system.B * (1.0 + 0.03 * rng.standard_normal(system.B.shape))
        loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=0.05)
        y = plant(system, loop, 1500, force=0.3)
        if not np.abs(y[-1] - y[-200]).max() < 1e-8:
            continue  # not a stable loop, or a slow one
        rested += 1
        held = [loop.model.outputs.index(name) for name in loop.rest.exact]
        assert np.abs(y[-1][held]).max(initial=0.0) < 1e-6
        if system.m <= system.p:
            # as one that acts at the inputs: where it rests they take it off
            np.testing.assert_allclose(loop._last, -0.3, atol=1e-5)
    assert rested > 0.9 * plants


def rig_loop(model, policy, offset_free, seed=2, **options):
    """Readings of the rig with a constant force of 0.5 N; at first the logger acts."""
    rig, rng = Rig(), np.random.default_rng(seed)
    loop, logger, last = se.regulate(policy, offset_free=offset_free, **options), None, 0.0
    logger = rig.logger(rng.standard_normal)

    def act(y):
        nonlocal last
        known = loop(y, applied=[last])
        last = float(known[0]) if loop.full else float(logger(y))
        return last

    y, _ = rig.simulate(act, 2000, rng, [0.0, 0.01, 0.0, 0.0], force=0.5)
    return y, loop


@pytest.fixture(scope="module")
def rig_model():
    data = Rig().data(40, np.random.default_rng(1))
    return se.identify(data, accept="memory", checks=False, window=se.Window(lags=8))


def test_a_constant_force_on_the_rig(rig_model):
    """The mean error of the position is 304 mm without, and 0.2 mm with the estimate."""
    gain = se.gain(rig_model, [1.0, 1.0], 0.1)
    y, loop = rig_loop(rig_model, gain, offset_free=False)
    assert abs(y[-1000:, 0].mean()) > 0.2
    y, loop = rig_loop(rig_model, gain, offset_free=True)
    assert abs(y[-1000:, 0].mean()) < 1e-3
    assert abs(loop._last[0] + 0.5) < 2.0
    of_input = np.asarray(loop._point.of_bias)[-1] @ loop.bias
    assert abs(of_input + 0.5) < 0.05
    cost, options = se.Cost(Q=[1.0, 1.0], R=0.1), {"limits": (-8.0, 8.0)}
    y, loop = rig_loop(rig_model, rig_model, offset_free=True, steps=60, cost=cost, **options)
    assert abs(y[-1000:, 0].mean()) < 2e-3
    assert {"filling", "optimal"} <= {call.status for call in loop.log} | {"filling"}


def test_the_window_the_limits_and_the_log():
    system, model, (y, _), _ = arx(3)
    hold = np.full(system.m, 0.25)
    loop = se.regulate(model, 8, offset_free=True, limits=(-0.5, 0.5), hold=hold)
    assert not loop.full
    for row in y[: model.window.fill]:
        np.testing.assert_array_equal(loop(row), hold)
        assert loop.log[-1].status == "filling"
    first = loop(y[model.window.fill])
    assert loop.full
    assert (np.abs(first) <= 0.5).all()
    # the same as from the record that just happened
    other = se.regulate(model, 8, offset_free=True, limits=(-0.5, 0.5), hold=hold)
    record = y[: model.window.fill + 1], np.tile(hold, (model.window.fill, 1))
    np.testing.assert_array_equal(other.start(record), first)
    # a copy goes on alike, also with an input that an outer layer changed
    copy = pickle.loads(pickle.dumps(loop))
    applied = np.zeros(system.m)

    def next_reading(acted):
        return model.coefficients @ model.loop.J @ np.concatenate([loop._window.now[0], acted])

    read = next_reading(applied) + 0.02
    np.testing.assert_array_equal(loop(read, applied=applied), copy(read, applied=applied))
    predicted = next_reading(loop._last) + loop.bias
    before = loop.bias
    read = predicted + 0.02
    loop([np.nan, *read[1:]])  # what is missing is as predicted
    np.testing.assert_allclose(loop.log[-1].predicted, predicted)
    assert np.isnan(loop.log[-1].y[0])
    off = np.concatenate([[0.0], (read - predicted)[1:]])
    np.testing.assert_allclose(loop.bias, before + loop._learning[0] @ off)
    loop.reset()
    assert not loop.full
    assert not loop.log


def test_missing_readings():
    system, model, _, rng = arx(3)
    gain = se.gain(model, 1.0, 1.0)
    loop = se.regulate(gain, offset_free=True, max_missing=2)
    y = plant(system, loop, 60, rng, noise=1.0, missing=(10, 11, 20))
    assert np.isfinite(y).all()
    assert {call.status for call in loop.log} == {"gain"}
    y = plant(system, loop, 60, rng, noise=1.0, missing=(10, 11, 12, 13))
    assert np.isfinite(y).all()
    held = [call for call in loop.log if call.status == "held"]
    assert len(held) == 2
    assert "nan cannot have been measured" in held[0].reason
    # a refused call leaves the loop as it was
    now, calls = loop._window.state(), loop.calls
    for wrong, error in (([1.0] * 7, ShapeError), ("word", InputTypeError)):
        with pytest.raises(error, match="`y`"):
            loop(wrong)
    np.testing.assert_array_equal(loop._window.state()[0][0], now[0][0])
    assert loop.calls == calls


def test_the_certificate_of_a_loop_with_its_estimate():
    """Every member that is drawn rests; the number is that of the small gain of the wider loop."""
    system, model, _, rng = arx(3)
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=0.05)
    proof = loop.certificate(0.05)
    assert proof.status == "certified"
    assert proof.check()
    n, p = model.n, system.p
    region, J, H = model.region(0.05), model.loop.J, model.coefficients
    part = region.parts[0]
    L, r, point = loop._learning[0], p, loop._point
    F = point.of_bias[p:] - loop._policy @ point.states_of_bias
    join = np.vstack([np.eye(n, n + r), np.hstack([loop._policy, F])])
    root = np.linalg.cholesky(np.asarray(part.S) * part.factor)

    def closed(Theta):
        """The loop of a member, from its own equations."""
        A = np.zeros((n + r, n + r))
        A[:n] = model.window.loop(Theta).ABc @ join
        A[n:] = (np.eye(r) - L) @ np.eye(r, n + r, n) + L @ (Theta - H) @ J @ join
        return A

    D = np.vstack([model.loop.G, L]) @ root
    W = np.asarray(part.white) @ J @ join
    sizes = []
    for angle in np.linspace(0.0, np.pi, 400):
        inverse = np.linalg.inv(np.exp(1j * angle) * np.eye(n + r) - closed(H))
        sizes.append(np.linalg.norm(W @ inverse @ D, 2))
    assert max(sizes) <= proof.norm * (1.0 + 1e-9)
    assert proof.norm < 1.02 * max(sizes)
    for _ in range(50):
        direction = rng.standard_normal((p, len(part.white)))
        direction /= np.linalg.norm(direction, 2)
        member = H + root @ direction @ np.asarray(part.white)
        assert np.abs(np.linalg.eigvals(closed(member))).max() < 1.0


def test_gains_of_outputs():
    system, model, _, _ = arx(3)
    p, n = system.p, model.n
    padded = np.zeros((n, n))
    padded[:p, :p] = np.diag([1.0, 2.0, 3.0])
    found = se.gain(model, [1.0, 2.0, 3.0], 1.0)
    np.testing.assert_array_equal(found.K, se.gain(model, padded, 1.0).K)
    region = model.region(0.05)
    assert found.certificate(region).norm == found.certificate(0.05).norm
    with pytest.raises(InputError, match="another size"):
        found.certificate(found.certificate(0.05).region)
    assert se.gain(model).certificate(0.05).status == "certified"
    assert se.gain(model, 1.0, 1.0, guarantee=0.05).certificate(0.05).status == "certified"


@pytest.mark.parametrize("lags", [12, 16])
@pytest.mark.parametrize("intercept", [False, True])
def test_the_widest_margin_of_long_windows(lags, intercept):
    """Their states nearly depend on each other: the proof needs more room for its rounding."""
    data = Rig().data(40, np.random.default_rng(2))
    model = se.identify(
        data, intercept=intercept, accept="memory", checks=False, window=se.Window(lags=lags)
    )
    loop = se.gain(model)
    proof = loop.certificate(0.05)
    assert proof.status == "certified"
    assert 0.95 * loop.parameter < proof.margin < 1.001 * loop.parameter
    assert proof.margin > 0.98 * se.gain(model, [1.0, 10.0], 0.01).certificate(0.05).margin


def test_a_chosen_window_that_is_refuted_points_to_a_shorter_one():
    data = Rig().data(20, np.random.default_rng(4))
    model = se.identify(data, accept="memory", checks=False)
    assert model.window.found is not None
    proof = se.gain(model, [1.0, 10.0], 0.01).certificate(0.05)
    assert proof.status == "refuted"
    few = f"Window(lags={model.window.found})"
    assert f"; careful: the data chose the window of {model.window.text}: a shorter" in repr(proof)
    assert f"declared beforehand (as {few}), has a smaller region" in proof.warnings[0]
    assert proof.warnings[1:] == model.warnings
    declared = se.identify(
        data, accept="memory", checks=False, window=se.Window(lags=model.window.count)
    )
    proof = se.gain(declared, [1.0, 10.0], 0.01).certificate(0.05)
    assert proof.status == "refuted"
    assert proof.warnings == declared.warnings


def test_a_certificate_says_first_where_the_outputs_are_in_the_end(rig_model):
    data = Rig().data(2, np.random.default_rng(5))
    plan = se.control(rig_model, record=data.last_record(), target=[0.0, 0.0], steps=20)
    bound = plan.bound(0.05, gain=se.gain(rig_model, [1.0, 1.0], 0.1))
    np.testing.assert_array_equal(bound["last"].radius, bound.outputs[-1])
    assert bound.outputs.shape == (20, 2)
    text = html.vector(bound.outputs[-1])
    said = f"within {text} of the target, readings of pos and angle at step 20"
    assert repr(bound).startswith(f"<Certificate: last {said}")
    assert list(bound) == ["last", "target", "tube", "mean", "readings", "outputs"]
    with pytest.raises(InputError, match="it bounds last, target, tube, mean, readings, outputs"):
        bound["components"]


def test_a_plan_that_is_followed_with_a_gain():
    """It holds an unstable plant in a small tube; 5 runs of 20 systems, in `make test` 8."""
    shares, smaller, count = [], 0, sets(20, 8)
    for seed in range(count):
        system, model, record, _ = arx(seed)
        gain = se.gain(model, 1.0, 1.0)
        plan = se.control(model, record=record, steps=10)
        bound, rng = plan.bound(0.5, gain=gain), np.random.default_rng([9, seed])
        smaller += bound.tube[-1] < plan.bound(0.5).tube[-1]
        for _ in range(5):
            y, u = list(record[0]), list(record[1])
            for v, xh in zip(plan.u, plan.predicted_states, strict=False):
                x = model.window.state_of(y, u)
                u.append(v + gain.K @ (x - xh))
                y.append(system.follow(y, u[:-1], u[-1:], rng)[0])
            off = np.array(y[-10:]) - plan.predicted_outputs[1:]
            shares.append((np.linalg.norm(off, axis=1) / bound.tube[1:]).max())
    assert np.sum(np.array(shares) > 1.0) <= 2.5 * count
    assert np.median(shares[:40]) == pytest.approx(0.3943, rel=0.02)  # as wide as it was
    assert smaller > count / 2
    with pytest.raises(ShapeError, match="`gain`"):
        plan.bound(gain=se.gain(([[1.0]], [[1.0]]), 1.0, 1.0))


def test_a_made_up_record_is_outside_the_tube(rig_model):
    """A tilted pendulum that stood still is a record of no run: off by 18 mm, tube of 6 mm."""
    rig, fill = Rig(), rig_model.window.fill
    record = np.tile([0.0, 0.05], (fill + 1, 1)), np.zeros((fill, 1))
    cost = se.Cost(Q=[1.0, 1.0], R=0.01)
    plan = se.control(rig_model, record=record, steps=10, cost=cost)
    x = np.array([0.0, 0.05, 0.0, 0.0])
    for u in plan.u[:, 0]:
        x = rig.A @ x + rig.B * u
    mean = plan.bound(0.05, noise=False)
    assert np.linalg.norm(x[:2] - plan.predicted_outputs[-1]) > mean.tube[-1]


def test_what_is_not_bounded_is_infinite():
    """Eight readings are too few: nothing is nan, for which no comparison would hold."""
    gen = np.random.default_rng(1)
    A, B, x = np.array([[0.9, 0.4], [-0.4, 0.9]]), np.array([[0.0], [1.0]]), np.zeros(2)
    y, u = [], gen.standard_normal((7, 1))
    for k in range(8):
        y.append([x[0] + 0.01 * gen.standard_normal()])
        x = A @ x + B[:, 0] * u[min(k, 6)]
    model = se.identify(
        se.Trajectories(np.array(y), u, outputs=True), checks=False, window=se.Window(lags=2)
    )
    plan = se.control(model, record=(y[-5:], u[-4:]), target=[0.3], steps=6)
    bound = plan.bound(0.05)
    assert bound.target == bound.parts["noise"] == np.inf
    assert not any(np.isnan(part) for part in bound.parts.values())
    assert "nan" not in repr(bound)
