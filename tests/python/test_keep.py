"""`regulate` with a gain: limits that noisy runs keep, whatever system of the region is true."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs.exceptions import SolverError
from test_feedback import RIG, WEIGHTS

A, B = RIG[:, :4], RIG[:, 4:]
START = np.array([0.1, 0.05, 0.0, 0.0])
COST = se.Cost(Q=[1.0, 10.0, 0.1, 1.0], Qf=[1.0, 10.0, 0.1, 1.0], R=0.01)


def model_of_runs(N, *, seed=1, noise=0.0005, declared=0.0005, accept=()):
    """N runs of ten steps of the pendulum on a cart."""
    gen, states, inputs = np.random.default_rng(seed), [], []
    for _ in range(N):
        force = gen.standard_normal((10, 1))
        x = [[0.1, 0.01, 0.1, 0.03] * gen.standard_normal(4)]
        for u in force:
            x.append(A @ x[-1] + B @ u + noise * gen.standard_normal(4))
        states.append(np.array(x))
        inputs.append(force)
    data = se.Trajectories(states, inputs, dt=0.1)
    scale = [0.1, 0.01, 0.1, 0.03, 1.0]
    return se.identify(
        data, scale=scale, accept=accept, checks=False, noise=se.Noise(sigma=declared)
    )


def kept_loop(N, *, calls=60, limits=(-1.0, 1.0), **options):
    model = model_of_runs(N, **options)
    proof = se.gain(model, *WEIGHTS).certificate(0.05)
    return se.regulate(model, 20, limits=limits, cost=COST, keep=se.Keep(proof, calls, 0.9))


# three systems unlike the rig: A, B, limits of states, of inputs, start
ANGLE = np.array([[np.cos(0.6), np.sin(0.6)], [-np.sin(0.6), np.cos(0.6)]])
OSCILLATOR = np.block([[0.98 * ANGLE, np.zeros((2, 1))], [0.1, 0.0, 0.7]])
UNSTABLE = [[1.15, 0.2, 0, 0], [0, 0.9, 0.3, 0], [0, 0, 1.02, 0.4], [0, 0, 0, 0.5]]
PLANTS = {
    "integrators": ([[1, 0.3], [0, 1]], [[0.045], [0.3]], [1.0, 1.5], 2.0, [0.9, 0]),
    "oscillator": (OSCILLATOR, [[0, 0.2], [1, 0], [0.3, 0.5]], [1.0] * 3, 1.0, [0.8, 0, 0.5]),
    "unstable": (
        UNSTABLE,
        [[0.5, 0], [0, 0.3], [0.2, 0.1], [0, 1]],
        [1.0] * 4,
        1.5,
        [0.7, 0, 0, 0],
    ),
}


def plant_loop(name, *, kept=True, N=100, calls=25):
    """A loop that is asked to go beyond the limit of the first state."""
    A, B, states, inputs, _ = (np.array(part, dtype=float) for part in PLANTS[name])
    (n, m), gen = B.shape, np.random.default_rng(1)
    x, u = gen.standard_normal((N, n)), gen.standard_normal((N, m))
    y = x @ A.T + u @ B.T + 0.01 * gen.standard_normal((N, n))
    model = se.identify(
        se.Trajectories.from_pairs(x, u, y), checks=False, noise=se.Noise(sigma=0.01)
    )
    limits = se.Limits(u=(-inputs, inputs), x=(-states, states), soft=False)
    given = {"limits": limits, "cost": se.Cost(Q=1.0, Qf=1.0, R=0.1)}
    if kept:
        given["keep"] = se.Keep(se.gain(model, 1.0, 1.0), calls, 0.9)
    return se.regulate(model, 12, 3.0 * np.eye(n)[0], **given)


def ride(loop, plant, x0, steps, noise, gen):
    """The states and inputs of a noisy run."""
    A, B = plant
    states, inputs = [np.array(x0, dtype=float)], []
    for _ in range(steps):
        inputs.append(loop(states[-1]))
        w = noise * gen.standard_normal(len(A))
        states.append(A @ states[-1] + B @ inputs[-1] + w)
    return np.array(states), np.array(inputs)


def violations(loop, limits, plant, x0, steps, noise, runs):
    """How many runs violate a limit at some time."""
    gen, count = np.random.default_rng(1), 0
    for _ in range(runs):
        loop.reset()
        rows = np.hstack(
            [part.reshape(steps, -1) for part in _after(loop, plant, x0, steps, noise, gen)]
        )
        broken = loop.kept is not None and loop.kept.ended is not None
        count += broken or bool((np.abs(rows) > limits).any())
    return count


def _after(loop, plant, x0, steps, noise, gen):
    states, inputs = ride(loop, plant, x0, steps, noise, gen)
    return states[1:], inputs


def on_the_rig(loop, runs, noise=0.0005):
    limits = np.array([np.inf] * 4 + [1.0])
    return violations(loop, limits, (A, B), START, 60, noise, runs)


def on_plant(loop, name, runs, noise=0.01):
    A, B, states, inputs, x0 = PLANTS[name]
    A, B = np.array(A, dtype=float), np.array(B, dtype=float)
    limits = np.concatenate([states, np.full(B.shape[1], inputs)])
    return violations(loop, limits, (A, B), x0, 25, noise, runs)


@pytest.mark.parametrize("N", [30, 100])
def test_the_rig_keeps_its_limit(N):
    """10 % may violate the limit in one of 60 calls."""
    loop, count = kept_loop(N), sets(10_000, 50)
    assert on_the_rig(loop, count) <= count // 10
    assert {call.status for call in loop.log} == {"optimal", "kept"}
    kept = loop.kept
    np.testing.assert_array_equal(kept.tightening, kept.model + kept.noise)
    assert 0.0 < kept.model[-1] < kept.noise[-1]
    assert kept.tightening[-1] < 0.25
    assert kept.keep == pytest.approx(0.9)
    assert repr(kept).startswith("<Kept: every limit in 60 steps together with 0.9,")


def test_noise_ten_times_as_large_breaks_the_limit():
    count = sets(200, 50)
    assert on_the_rig(kept_loop(30), count, noise=0.005) > count // 10


@pytest.mark.parametrize("name", PLANTS)
def test_limits_of_states_of_other_systems(name):
    """Nominally 10 % of violations; without a gain, or with more noise, there are more."""
    loop, count = plant_loop(name), sets(200, 20)
    assert on_plant(loop, name, count) <= count // 10
    assert on_plant(plant_loop(name, kept=False), name, 5) == 5
    assert on_plant(plant_loop(name), name, 10, noise=0.06) > 1


@pytest.mark.parametrize("N", [5, 10])
def test_few_runs_are_not_enough(N):
    loop = kept_loop(N)
    u = loop(START)  # that of the gain, within the limits
    np.testing.assert_array_equal(u, np.clip(loop.kept.proof.K @ START, -1.0, 1.0))
    assert loop.log[-1].status == "infeasible"
    assert re.search(r"u\[0\].* lacks .* for the error of the model", loop.log[-1].reason)
    assert loop.plan is None
    assert loop.kept.missing > 0.0
    loop([0.01, 0.001, 0.0, 0.0])  # from nearer it is
    assert loop.kept.missing == 0.0


def test_accepted_once_is_never_infeasible():
    """Wherever the state is thrown, the plan before goes on."""
    loop, gen = kept_loop(30), np.random.default_rng(2)
    first = loop(START)
    assert first == pytest.approx([1.0])  # nothing is off yet: the whole limit
    for _ in range(100):  # 3.0 and more of the input without its limits
        assert np.abs(loop(0.5 * gen.standard_normal(4))) <= 1.0
    assert "infeasible" not in [call.status for call in loop.log]
    assert loop.kept.missing > 0.0


def test_the_promise_ends_where_its_theorem_does():
    """An input that was cut, and a state that was not known: said once, until `reset`."""
    text = "no limit is promised any more: "
    for far, why in ((np.full(4, 0.5), "an input had to be cut"), (np.full(4, np.nan), "a state")):
        loop = kept_loop(30)
        for x in (START, 0.9 * START, far, 0.8 * START, START, far):
            assert np.abs(loop(x)) <= 1.0
        before, after = loop.log[:2], loop.log[2:]
        assert all(call.status in ("optimal", "kept") and call.reason is None for call in before)
        assert all(text + why in one for one in (after[0].reason, repr(loop.kept)))
        assert {call.status for call in after[1:3]} == {"unproved"}
        assert not any(text in str(call.reason) for call in after[1:])
        loop.reset()
        loop(START)
        assert (loop.kept.ended, loop.log[-1].status) == (None, "optimal")


def test_more_is_kept_back_once_a_plan_needs_it():
    loop = kept_loop(100)
    loop(0.01 * START)
    assert loop.kept.model[-1] == 0.0
    loop(0.8 * START)  # pushed
    assert loop.log[-1].status == "optimal"
    assert loop.kept.model[-1] > 0.0


def test_plans_that_go_on_are_corrected_by_the_gain():
    loop = kept_loop(30)
    loop(START)
    plan, K = loop.plan, loop.kept.proof.K
    # far away where the gain sees little: no new plan is accepted, and no input is cut
    off = 3.0 * np.linalg.svd(K)[2][3] + 0.1 * K[0] / (K @ K.T)[0, 0]
    xb = START
    for k in range(1, 40):
        u = plan[k - 1] if k <= len(plan) else K @ xb
        xb = loop.kept.proof.region.centre @ np.concatenate([xb, u])
        v = plan[k] if k < len(plan) else K @ xb
        np.testing.assert_allclose(loop(xb + off), v + K @ off, rtol=1e-9)
        assert loop.log[-1].status == "kept"


def test_without_a_plan_the_call_ends_with_its_time(monkeypatch):
    """No round is begun behind the deadline; there were up to 8, each with the whole time."""
    model, plans = model_of_runs(10), []
    own = se.Regulator._solve
    monkeypatch.setattr(se.Regulator, "_solve", lambda *given: plans.append(1) or own(*given))
    given = {"keep": se.Keep(se.gain(model, *WEIGHTS), 60), "limits": (-1.0, 1.0)}
    for limit in (1e-5, 60.0):
        loop = se.regulate(model, 30, time_limit=limit, **given)
        plans.clear()
        assert np.abs(loop(START)) <= 1.0
        assert loop.log[-1].status == "infeasible"
        assert (len(plans) > 1) == (limit > 1.0)
    with pytest.raises(se.StochensError, match="cannot change with `keep`"):
        loop.target = np.zeros(4)


def test_limits_too_close_for_the_margins_are_refused_without_a_state():
    """When the loop is made there is no state yet: the message names the limits."""
    model = model_of_runs(60)
    limits = se.Limits(u=(-1.0, 1.0), x=(-1e-3, 1e-3), soft=False)
    keep = se.Keep(se.gain(model, *WEIGHTS), 60, 0.9)
    text = r"^no plan keeps the limits with 0\.9: .* between its limits lacks .* for noise$"
    with pytest.raises(SolverError, match=text):
        se.regulate(model, 20, limits=limits, cost=COST, keep=keep)
