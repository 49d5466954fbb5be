"""`regulate`: the twin at every state, copies, holds, swaps, bad input, and bounded work."""

from __future__ import annotations

import copy
import html
import pickle

import numpy as np
import pytest

import stochens_rs as se
from limit_plans import within
from limit_problems import draw_steps
from stochens_rs.exceptions import DataWarning, InputTypeError, NonFiniteError, ShapeError
from stochens_rs.limits.problem import Horizon
from twin.limited_control import solve
from twin.limited_problems import objective, several_steps

LOST = [np.nan, np.nan]
A, B = np.array([[1.0, 0.3], [-0.1, 0.9]]), np.array([[0.0], [0.1]])


def plant(seed, n=4, m=2):
    gen = np.random.default_rng(seed)
    A = gen.normal(size=(n, n))
    return 1.05 * A / np.abs(np.linalg.eigvals(A)).max(), gen.normal(size=(n, m)), gen


def made(**more):
    """A loop of 6 steps whose inputs are mostly at a limit."""
    return se.regulate((A, B), 6, **within(**more, limits=(-0.5, 1.0), Q=[1.0, 0.1], R=0.01))


def driven(loop, x, count):
    inputs = []
    for _ in range(count):
        inputs.append(loop(x))
        x = A @ x + B @ inputs[-1]
    return np.array(inputs), x


def test_oracle_of_one_integrator():
    """x+ = x + u, |u| <= 1, Q = R = 1, K = 1 from 5: the fourth -1 has the multiplier 0."""
    loop, x = (
        se.regulate(([[1.0]], [[1.0]]), 1, limits=(-1.0, 1.0), cost=se.Cost(Q=1.0, Qf=1.0, R=1.0)),
        np.array([5.0]),
    )
    for _ in range(6):
        x = x + loop(x)
    assert [call.u[0] for call in loop.log] == [-1.0, -1.0, -1.0, -1.0, -0.5, -0.25]
    assert [call.x[0] for call in loop.log] == [5.0, 4.0, 3.0, 2.0, 1.0, 0.5]
    assert {call.status for call in loop.log} == {"optimal"}
    assert max(call.gap for call in loop.log) <= 1e-15
    assert min(call.seconds for call in loop.log) > 0.0


@pytest.mark.filterwarnings("ignore:the loop grows")
def test_equals_the_twin_at_every_state():
    """60 random loops of unlike kinds, half with rates, 5 calls each: J, gap and inputs."""
    gen, checked, at_rate = np.random.default_rng(15), 0, 0
    for index in range(60):
        A, B, x0, K, more = draw_steps(gen, index)
        more.pop("S", None)
        goal, low, high = np.ones(len(A)), more.pop("low"), more.pop("high")
        rate, last = more.get("rate", np.inf), more.pop("previous", np.zeros(B.shape[1]))
        begin = {"previous": last} if "rate" in more else {}
        x = x0
        loop = se.regulate((A, B), K, goal, **within(limits=(low, high), **begin, **more))
        for _ in range(5):
            u = loop(x)
            assert np.all((low <= u) & (u <= high))
            assert np.all(np.abs(u - last) <= rate + 1e-12)
            at_rate += bool(np.any(np.abs(u - last) >= rate - 1e-9))
            limits = {"low": low, "high": high, "previous": last}
            problem = several_steps(A, B, x, goal, K, **limits, **more)
            best = solve(problem)
            scale = objective(problem, 0.0 * best.u) + best.objective
            gap, last = loop.log[-1].gap, u
            assert objective(problem, loop.plan.ravel()) - best.objective <= gap + 1e-12 * scale
            assert gap <= 1e-9 * scale
            apart = loop.plan.ravel() - best.u
            # both are within their distances of the best control, in the norm of the problem
            assert apart @ problem.H @ apart <= (gap**0.5 + best.distance) ** 2 + 1e-12 * scale
            checked += bool(np.any((u == low) | (u == high)))
            x = A @ x + B @ u
    assert checked > 60  # of 300 inputs
    assert at_rate > 20  # of 150


@pytest.mark.parametrize("steps", [1, 5, 40])
def test_a_loop_without_active_limits_is_the_gain(steps):
    """For any number of steps, of an unstable system, which other weights do not hold."""
    F, X, _ = plant(3, 4, 2)
    F, cost = 1.3 * F / np.abs(np.linalg.eigvals(F)).max(), {"Q": [1.0, 0.0, 0.3, 2.0], "R": 10.0}
    K = se.gain((F, X), **cost).K
    for limits in (None, se.Limits(rate=1e6, previous=0.0), se.Limits(x=(-1e6, 1e6))):
        loop = se.regulate((F, X), steps, limits=limits, cost=se.Cost(**cost))
        for x in np.eye(4):
            loop.reset()
            np.testing.assert_allclose(loop(x), K @ x, atol=1e-9)
    with pytest.warns(DataWarning, match="grows by 1"):
        se.regulate((F, X), 1, cost=se.Cost(**cost, Qf=0.1))


@pytest.mark.parametrize("kind", ["rate", "soft", "hard", "rate and soft"])
def test_limits_of_rates_and_states_begin_at_those_of_the_call_before(kind):
    """5 loops of 10 disturbed steps: each plan is that of `control`; an interior point is rare."""
    short = calls = 0
    for index in range(5):
        F, X, gen = plant(60 + index, 3, 2)
        F = F / 1.1
        task = {"limits": (-0.6, 0.6), "Q": 1.0, "Qf": 1.0, "R": 0.1}
        rate = {"rate": 0.25} if "rate" in kind else {}
        if kind != "rate":
            task |= {"state_limits": (-2.5, 2.5), "soft": None if "soft" in kind else False}
        last, x = np.zeros(2), np.ones(3)
        begin = {"previous": last} if rate else {}
        loop = se.regulate((F, X), 15, **within(**task, **rate, **begin))
        for _ in range(10):
            u = loop(x)
            now = {"previous": last} if rate else {}
            plan = se.control((F, X), x, np.zeros(3), steps=15, **within(**task, **rate, **now))
            gap = loop.log[-1].gap
            assert loop.log[-1].status == plan.status
            if plan.status == "optimal":
                J, size = (plan.limited.task, F, X), 1e-12 * plan.limited.objective
                apart = Horizon(*J).objective(x, loop.plan) - plan.limited.objective
                assert -plan.limited.gap - size <= apart <= gap + size
                assert gap <= 1e-10 * (1.0 + plan.limited.objective)
                assert np.allclose(loop.plan, plan.u, rtol=1e-6, atol=1e-6)
            x, last = F @ x + X @ u + 0.2 * gen.normal(size=3), u
            # as the next call does; its limits are then those of this state
            short += loop._solver.solve(x, None).iterations <= 10
            calls += 1
    assert short > 0.7 * calls  # an interior point alone takes more


@pytest.mark.parametrize("index", range(12))
def test_equals_control_at_every_state(index):
    """Also with an offset, from a model; 12 systems, 15 calls each."""
    F, X, gen = plant(20 + index, 3, 2)
    z = gen.normal(size=(60, 5))
    offset = 0.3 * (index % 2)
    y = z[:, :3] @ F.T + z[:, 3:] @ X.T + offset + 0.01 * gen.normal(size=(60, 3))
    data = se.Trajectories.from_pairs(z[:, :3], z[:, 3:], y)
    model = se.identify(data, intercept=bool(index % 2), checks=False)
    system = (F, X) if index % 3 == 0 else model
    task = {"limits": ([-0.4, -np.inf], 0.3), "Q": 1.0, "Qf": 3.0, "R": [0.1, 0.2]}
    loop, x, goal = (
        se.regulate(system, 7, np.ones(3), **within(**task)),
        3.0 * gen.normal(size=3),
        np.ones(3),
    )
    for _ in range(15):
        u = loop(x)
        plan = se.control(system, x, goal, steps=7, **within(**task))
        assert np.allclose(loop.plan, plan.u, rtol=1e-11, atol=1e-11)
        assert loop.log[-1].gap <= 1e-12 * (plan.limited.objective + 1.0)
        x = F @ x + X @ u + offset + 0.1 * gen.normal(size=3)
    assert any(np.any((call.u == 0.3) | (call.u == [-0.4, np.inf])) for call in loop.log)


def test_a_held_input_is_the_next_of_the_plan():
    loop = made()
    assert np.array_equal(loop(LOST), [0.0])
    loop([3.0, 1.0])
    plan = loop.plan
    for k, x in enumerate([LOST, [np.nan, 0.0], [1e308, 0.0], LOST, LOST, LOST, LOST], start=1):
        assert np.array_equal(loop(x), plan[min(k, 5)])
    assert loop.calls == 9
    assert [call.status for call in loop.log] == ["held", "optimal"] + 7 * ["held"]
    assert all(call.reason and np.isnan(call.gap) for call in loop.log[2:])
    loop([3.0, 1.0])
    assert np.array_equal(loop(LOST), loop.plan[1])


def test_nothing_that_is_given_or_returned_is_shared():
    loop = made()
    x = np.array([3.0, 1.0])
    u = loop(x)
    kept = loop.plan, loop.log[0].x.copy(), loop.log[0].u.copy()
    x[:], u[:], loop.plan[:] = 7.0, 7.0, 7.0
    assert np.array_equal(loop.plan, kept[0])
    assert np.array_equal(loop.log[0].x, kept[1])
    assert np.array_equal(loop.log[0].u, kept[2])


def test_another_model_swaps_in_between_steps():
    loop = made()
    _, x = driven(loop, np.array([3.0, 1.0]), 5)
    plan = loop.plan
    other = A + 0.1, 2.0 * B
    loop.swap(other)
    assert np.array_equal(loop.plan, plan)  # to hold from
    assert np.array_equal(loop(LOST), plan[1])
    fresh = se.regulate(other, 6, limits=(-0.5, 1.0), cost=se.Cost(Q=[1.0, 0.1], R=0.01))
    assert np.allclose(loop(x), fresh(x), rtol=1e-12, atol=1e-12)
    before = loop.plan
    for bad, error in (
        (([[1.0]], [[1.0]]), ShapeError),
        ((A, np.hstack([B, B])), ShapeError),
        ((np.full((2, 2), np.nan), B), NonFiniteError),
        ((1e200 * A, B), NonFiniteError),
        ("model", InputTypeError),
    ):
        with pytest.raises(error):
            loop.swap(bad)
    assert np.array_equal(loop(x), before[0])


def test_another_target():
    how = {"limits": (-0.5, 1.0)}
    rows = 0.1 * np.arange(8.0).reshape(4, 2)
    loops = [se.regulate((A, B), 6, **how), se.regulate((A, B), 3, cost=se.Cost(reference=rows))]
    for loop, target in zip(loops, ([1.0, 0.2], 2.0 * rows[1:]), strict=True):
        _, x = driven(loop, np.array([3.0, 1.0]), 5)
        loop.target = target
        assert np.array_equal(loop.target, target)
        assert np.array_equal(copy.deepcopy(loop).target, target)
        cost = se.Cost(reference=np.vstack([rows[:1], np.broadcast_to(target, (loop.steps, 2))]))
        fresh = se.regulate((A, B), loop.steps, cost=cost, limits=loop.limits)
        assert np.allclose(loop(x), fresh(x), rtol=1e-12, atol=1e-12)


def test_a_model_of_a_stream_swaps_in():
    gen = np.random.default_rng(3)
    stream = se.ModelStream(2, 1, noise=se.Noise(sigma=0.01))
    x = np.zeros(2)
    for _ in range(60):
        u = gen.normal(size=1)
        y = A @ x + B @ u + 0.01 * gen.normal(size=2)
        stream.update(x, u, y)
        x = 0.5 * y
    loop = se.regulate(stream.model, 10, limits=(-4.0, 4.0), cost=se.Cost(Q=1.0, R=0.01))
    x, first = np.array([0.5, 0.0]), stream.model.A
    for k in range(60):
        u = loop(x)
        y = A @ x + B @ u + 0.01 * gen.normal(size=2)
        stream.update(x, u, y)
        x = y
        if k % 10 == 9:
            loop.swap(stream.model)
    assert not np.array_equal(loop._system.A, first)
    assert np.array_equal(loop._system.A, stream.model.A)
    assert np.linalg.norm(x) < 0.1
    assert loop.calls == 60


@pytest.mark.parametrize(
    "limits",
    [
        se.Limits(u=(-1.0, 1.0), rate=0.2, previous=0.0),
        se.Limits(u=(-1.0, 1.0), x=(-3.0, 3.0)),
        se.Limits(u=(-1.0, 1.0), x=(-3.0, 3.0), rate=0.2, previous=0.0),
    ],
    ids=["rate", "soft", "both"],
)
def test_calls_that_are_all_cut_still_stabilise(limits):
    """An unstable system: cut at once, every call returned 0, and the state went to 1e5."""
    rng = np.random.default_rng(0)
    A, B = rng.standard_normal((6, 6)), rng.standard_normal((6, 2))
    A *= 1.02 / np.abs(np.linalg.eigvals(A)).max()
    cost = se.Cost(Q=1.0, R=0.1)
    loop = se.regulate((A, B), 15, limits=limits, cost=cost, time_limit=1e-9)
    x, last, rate = rng.standard_normal(6), np.zeros(2), 0.2 if limits.rate else 2.0
    for _ in range(300):
        u = loop(x)
        assert np.abs(u).max() <= 1.0
        assert np.abs(u - last).max() <= rate + 1e-12
        x, last = A @ x + B @ u + 0.01 * rng.standard_normal(6), u
    assert "user_limit" in {call.status for call in loop.log}
    assert np.abs(x).max() < 1.0


def saved(loop, path):
    loop.save(path / "loop.safetensors")
    return se.Regulator.load(path / "loop.safetensors")


def model_of(F):
    """A model: a loop of a plain system has no file."""
    x, u, w = np.random.default_rng(8).standard_normal((3, 200, 2))
    y = x @ F.T + u[:, :1] @ B.T + 1e-3 * w
    return se.identify(se.Trajectories.from_pairs(x, u[:, :1], y), checks=False)


def swapped(loop, _):
    loop.swap(model_of(0.9 * A))
    return loop


def held(loop, _):
    """Three calls without a state go on along the plan, which moves at the rate."""
    for _ in range(3):
        before = loop.log[-1].u
        u = loop(LOST)
        assert loop.log[-1].status == "held"
        assert np.abs(u - before).max() <= 0.1 + 1e-12
    return loop


def begun_anew(loop, _):
    loop.reset()
    return loop


@pytest.mark.parametrize(
    "change",
    [
        swapped,
        held,
        begun_anew,
        saved,
        lambda loop, _: pickle.loads(pickle.dumps(loop)),
        lambda loop, _: copy.deepcopy(loop),
        lambda loop, path: swapped(saved(held(loop, path), path), path),
    ],
    ids=["swap", "hold", "reset", "save", "pickle", "copy", "all"],
)
@pytest.mark.parametrize("calls", [1, 9])
def test_the_rate_counts_from_the_input_that_acts(change, calls, tmp_path):
    """The inputs are then far from `previous`, and the state asks for the other end at once."""
    limits = se.Limits(u=(-1.0, 1.0), rate=0.1, previous=0.0)
    loop = se.regulate(model_of(A), 12, limits=limits, cost=se.Cost(Q=[1.0, 0.1], R=0.001))
    for _ in range(calls):
        last = loop([-30.0, 0.0])
    assert abs(last[0] - 0.1 * calls) < 1e-9
    loop = change(loop, tmp_path)
    last = loop._last
    for call in range(3):
        u = loop([30.0, 30.0])
        assert abs(u[0] - last[0] + 0.1) < 1e-9, call  # at the rate, and not beyond it
        last = u


def test_the_work_of_a_call_is_bounded():
    """As much for every state, however far, and not reached; none where plans grow."""
    F, X, gen = plant(7, 4, 2)
    cost = se.Cost(Q=1.0, R=0.1)
    for limits in (
        se.Limits(u=(-0.3, 0.3)),
        se.Limits(u=(-0.3, 0.3), rate=0.1, previous=0.0),
        se.Limits(u=(-0.3, 0.3), x=(-2.0, 2.0)),
    ):
        loop = se.regulate((F / 1.1, X), 10, limits=limits, cost=cost)
        before = loop(np.ones(4))
        work = loop.worst_time()
        assert work.operations > 1e4
        assert 0.0 < work.seconds < 60.0
        loop.reset()
        for _ in range(50):
            x = 10.0 ** gen.uniform(-1, 2) * gen.normal(size=4)
            assert loop._solver.solve(x, None).iterations < work.factorizations
        assert loop.worst_time()[:2] == work[:2]
        assert np.abs(before).max() <= 0.3
    grown = se.regulate((3.0 * F, X), 30, limits=limits, cost=cost)
    assert grown.worst_time().seconds == np.inf


def test_references_and_limits_that_differ_from_step_to_step():
    reference = np.cumsum(np.ones((7, 2)), axis=0)
    low, high = -np.arange(1.0, 7.0)[:, None], np.full((6, 1), np.inf)
    loop = se.regulate(
        (A, B), 6, limits=(low, high), cost=se.Cost(reference=reference, Q=1.0, Qf=1.0, R=0.1)
    )
    x = np.array([5.0, 1.0])
    u = loop(x)
    problem = several_steps(A, B, x, reference[1:], 6, Q=1.0, R=0.1, low=low, high=high)
    assert np.allclose(loop.plan.ravel(), solve(problem).u, rtol=1e-9, atol=1e-9)
    assert np.array_equal(loop.limits[0], [-1.0])
    assert np.array_equal(loop.limits[1], [np.inf])
    assert u[0] >= -1.0


def test_the_log_is_a_ring():
    loop = se.regulate(([[1.0]], [[1.0]]), 2, limits=(-1.0, 1.0))
    for k in range(1005):
        loop([float(k)])
    assert (len(loop.log), loop.calls) == (1000, 1005)
    assert loop.log[0].x[0] == 5.0


# -- the closed loop -------------------------------------------------------------------------------


def test_track_with_a_regulator_is_the_loop_by_hand():
    system, rest, start = se.System(A, B), np.zeros((21, 2)), np.array([2.0, 0.5])
    loop, by_hand = made(), made()
    run = se.track(system, rest, controller=loop, x0=start, rng=1)
    inputs, end = driven(by_hand, start, 20)
    assert np.array_equal(run.inputs, inputs)
    assert np.allclose(run.states[-1], end, rtol=1e-12, atol=1e-12)
    assert np.array_equal(run.errors, np.linalg.norm(run.states, axis=1))
    assert loop.calls == 20  # its log has the run
    assert run.status == "optimal"
    assert run.info["statuses"] == {"optimal": 20}
    assert run.info["controller"] == "Regulator"
    assert np.array_equal(run.info["limits"], [[-0.5], [1.0]])
    assert "{'optimal': 20}" in html.unescape(run._repr_html_())
    assert repr(run).startswith("<Tracking: 20 steps, m=1, optimal, last error")


def test_track_draws_the_noise_of_each_run_from_the_key():
    rest, start = np.zeros((11, 2)), np.array([2.0, 0.5])
    loop = made()
    first, again = (
        se.track((A, B), rest, controller=loop, x0=start, noise=[0.1, 0.0], rng=7, runs=3)
        for _ in range(2)
    )
    assert np.array_equal(first.states, again.states)
    assert loop.calls == 0  # each run has a copy
    assert first.states.shape == (3, 11, 2)
    w = first.states[:, 1:] - first.states[:, :-1] @ A.T - first.inputs @ B.T
    assert np.abs(w[:, :, 1]).max() < 1e-12
    assert not np.allclose(w[0], w[1])
    one = se.track((A, B), rest, controller=made(), x0=start, noise=[0.1, 0.0], rng=7)
    assert np.array_equal(one.states, first.states[0])
    assert first.info["statuses"] == {"optimal": 30}
