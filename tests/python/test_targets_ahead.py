"""Loops that plan along targets to come, and plans along targets: one answer, and a twin."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from hidden_outputs import Arx

# four filters are too few for some of these plants, which is not what is tested
pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
K = 12
KINDS = {
    "inputs": {},
    "rates": {"rate": 0.4, "previous": 0.0},
    "readings": {"x": (-0.9, 1.1), "soft": 1e3},
}


def plant(seed):
    """A hidden plant of one output at least, that does not grow."""
    rng = np.random.default_rng(seed)
    while True:
        found = Arx(rng)
        if np.abs(found.A).max() < 1.5 and found.p <= found.m:
            return found, rng


def model_of(found, rng, window=None):
    window = window or se.Window(lags=found.lags)
    return se.identify(found.data(25, 40, rng), window=window)


def stairs(model, calls, ramp=0.0):
    """Rows of targets that jump, and may have a ramp at the end."""
    rng, rows = np.random.default_rng(3), np.zeros((calls, model.n_outputs))
    for k in range(0, calls, 7):
        rows[k:] = rng.uniform(-1.0, 1.0, model.n_outputs)
    rows[-8:] += np.linspace(0.0, ramp, 8)[:, None]
    return rows


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 2, 3][: sets(3, 2)])
@pytest.mark.parametrize("window", [None, se.Window(filters=(0.5, 4))], ids=["lags", "filters"])
def test_loop_and_plan_along_targets_are_one_answer(kind, seed, window):
    found, rng = plant(seed)
    model = model_of(found, rng, window)
    rows = stairs(model, 30)
    limits = se.Limits((-3.0, 3.0), **KINDS[kind])
    how = {"limits": limits, "cost": se.Cost(Q=1.0, Qf=1.0, R=0.1)}
    loop = se.regulate(model, K, rows, offset_free=False, **how)
    y, u = (list(one) for one in found.run(40, rng))
    limits_then = dict(KINDS[kind])
    inputs = [loop.start((y, u))]
    for k in range(34):
        if "previous" in limits_then:
            limits_then["previous"] = u[-1]
        now_on = {"limits": se.Limits((-3.0, 3.0), **limits_then), "cost": how["cost"]}
        if k == 25:
            loop.target = rows[-1]
            rows = np.repeat(rows[-1:], 40, axis=0)
        plan = se.control(model, record=(y, u), target=rows[k:][: K + 2], steps=K, **now_on)
        # filters see the targets of the calls before, too
        if k != 25 and (window is None or k == 0):
            np.testing.assert_allclose(inputs[-1], plan.u[0], atol=2e-6)
        u.append(inputs[-1])
        y.append(found.follow(np.array(y), np.array(u[:-1]), u[-1:], rng, noise=0.2)[0])
        inputs.append(loop(y[-1]))
        if k < 24:
            np.testing.assert_allclose(loop.plan.u[0], inputs[-1], atol=2e-6)
    assert {call.status for call in loop.log} <= {"optimal"}


def test_plan_along_targets_is_the_least_cost():
    """Without limits in the way: least squares over all inputs, with the windows at rest."""
    for seed in range(4, 8):
        found, rng = plant(seed)
        model = model_of(found, rng)
        y, u = found.run(40, rng)
        rows = stairs(model, K + 1, ramp=0.5)
        cost = se.Cost(Q=2.0, R=0.3)
        plan = se.control(model, record=(y, u), target=rows, steps=K, cost=cost)
        A, B, p, m = model.A, model.B, model.n_outputs, model.m
        powers = [np.linalg.matrix_power(A, k) for k in range(K + 1)]
        G = np.zeros((K, p, K, m))
        for k in range(K):
            for j in range(k + 1):
                G[k, :, j] = (powers[k - j] @ B)[:p]
        free = np.array([(powers[k + 1] @ plan.basis.x0)[:p] for k in range(K)])
        task = plan.limited.task
        wanted = task.reference[:, :p]
        # of lags the window at rest begins with the target itself
        np.testing.assert_allclose(wanted, rows[1:], atol=1e-9)
        M = np.vstack([np.sqrt(2.0) * G.reshape(K * p, K * m), np.sqrt(0.3) * np.eye(K * m)])
        held = np.tile(task.resting, K)
        right = np.r_[np.sqrt(2.0) * (wanted - free).ravel(), np.sqrt(0.3) * held]
        best = np.linalg.lstsq(M, right, rcond=None)[0].reshape(K, m)
        np.testing.assert_allclose(plan.u, best, atol=1e-7)


class Tank:
    """Two tanks in a row, one step of dead time."""

    def __init__(self):
        self.x, self.last = np.zeros(2), 0.0

    def step(self, u, w=0.0):
        self.x = np.array([0.9 * self.x[0] + 0.1 * self.last, 0.85 * self.x[1] + 0.15 * self.x[0]])
        self.last = u
        return self.x[1] + w


def test_a_loop_that_plans_begins_before_the_step():
    """Targets that are known beforehand are followed with less than half of the error."""
    rng, y, u = np.random.default_rng(5), [], []
    for _ in range(20):
        tank, read, given = Tank(), [0.0], rng.uniform(-3.0, 3.0, (60, 1))
        read += [tank.step(float(one[0]), 0.01 * rng.standard_normal()) for one in given]
        y.append(np.array(read)[:, None])
        u.append(given)
    model = se.identify(se.Trajectories(y, u, outputs=True), window=se.Window(lags=3))
    rows = np.repeat([0.0, 1.0, -0.5, 0.5], 30)[:, None]
    off = {}
    for ahead in (True, False):
        for rate in (None, 0.8):
            more = {} if rate is None else {"rate": rate, "previous": 0.0}
            limits = se.Limits((-3.0, 3.0), **more)
            cost = se.Cost(Q=1.0, R=0.01)
            loop = se.regulate(model, 20, rows[:1], limits=limits, cost=cost, offset_free=True)
            if ahead:
                loop.target = rows
            tank, read, seen = Tank(), 0.0, []
            for row in rows:
                seen.append(read - row[0])
                known = {} if ahead else {"target": row}
                read = tank.step(float(loop([read], **known)[0]), 0.005 * rng.standard_normal())
            off[ahead, rate] = np.sqrt(np.mean(np.square(seen[20:])))
    assert off[True, None] < 0.5 * off[False, None], off
    assert off[True, 0.8] < 0.5 * off[False, 0.8], off


def test_a_loop_is_done_with_targets_that_it_has_reached():
    """Behind the last row filters see it for some calls; then a call is as that of one target."""
    found, rng = plant(1)
    model = model_of(found, rng, se.Window(filters=(0.5, 4)))
    rows = np.zeros((4, found.p))
    rows[0, 0] = 1.0
    limits = se.Limits((-3.0, 3.0))
    loop, one = (
        se.regulate(model, K, target, limits=limits, cost=se.Cost(Q=1.0), offset_free=False)
        for target in (rows, rows[-1])
    )
    y, u = found.run(40, rng)
    loop.start((y, u))
    acted = one.start((y, u))
    calls = rng.standard_normal((80, found.p)) * 0.1
    for row in calls:
        inputs = one(row), loop(row, applied=acted)
        acted = inputs[0]
    assert not loop._ahead
    np.testing.assert_allclose(*inputs, atol=1e-9)
