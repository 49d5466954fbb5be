"""Controls within limits in all units, at all sizes, and without time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg, optimize

import stochens_rs as se
from hidden_systems import KINDS, drawn
from limit_plans import within
from stochens_rs.limits.problem import OPTIMAL, Horizon
from stochens_rs.theory.exact import states

NOTHING = 1e-20  # squares of rounding, as in the core
A, B = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[1.0, 1.0], [0.5, -2.0]])


def level(plan, A, B, x0):
    """``1e-9 J(u)``, and rounding of J(0), or of the size of J along the states if it is less."""
    task, u = plan.limited.task, plan.u
    horizon = Horizon(task, A, B)
    scale = horizon.objective(x0, np.zeros_like(u))
    if horizon.core.long or not task.boxed:
        weights = [task.stage] * (len(u) - 1) + [task.terminal]
        drift, wanted = states(A, B, x0, u)[:-1] @ A.T, task.reference
        size = sum(x @ Q @ x + r @ Q @ r for x, r, Q in zip(drift, wanted, weights, strict=True))
        scale = min(scale, size + np.sum((u @ plan.limited.R) * u))
    return OPTIMAL * plan.limited.objective + NOTHING * scale


def follows_the_gap(plan, A, B, x0):
    most = level(plan, A, B, x0)
    if plan.status == "optimal":
        return plan.limited.gap <= most * (1 + 1e-6)
    return plan.status == "infeasible" or plan.limited.gap > most * (1 - 1e-6)


# -- units -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", ["tight", "wide"])
@pytest.mark.parametrize("R", [0.0, 1e-6, 1e-2])
def test_the_unit_of_an_input_does_not_matter_for_its_rate(rate, R):
    """The second input in units of 1 to 1e9; "wide": its rate is far above what is ever needed."""
    found, x0 = [], [3.0, -2.0]
    for unit in (1.0, 1e3, 1e6, 1e9):
        D = np.array([1.0, unit])
        weight = R * D**2 if rate == "tight" else R * np.array([1.0, min(unit, 1e3)])
        limit = 0.3 / D if rate == "tight" else np.array([0.3, 0.3])
        plan = se.control(
            (A, B * D),
            x0,
            [0.0, 0.0],
            steps=10,
            limits=se.Limits(rate=limit, previous=0.0),
            cost=se.Cost(Q=1.0, R=weight),
        )
        assert plan.status == "optimal"
        assert plan.limited.gap <= 1e-12 * plan.limited.objective
        assert np.all(np.abs(np.diff(plan.u, axis=0, prepend=0.0)) <= limit * (1 + 1e-12))
        found.append((plan.limited.objective, plan.u * D))
    if rate == "tight":
        for J, u in found:
            assert pytest.approx(found[0][0], rel=1e-9) == J
            np.testing.assert_allclose(u, found[0][1], atol=1e-6)
    elif R == 0.0:  # from 1e3 on the rate of the second input is never reached
        assert found[2][0] == pytest.approx(found[1][0], rel=1e-9)
        assert found[3][0] == pytest.approx(found[1][0], rel=1e-9)


def test_one_step_of_more_inputs_than_states_in_mixed_units(gen):
    """One-sided limits and R = 0: many controls are equally good, and one of them is found."""
    for _ in range(40):
        n = int(gen.integers(2, 6))
        m = n + int(gen.integers(1, 5))
        X = gen.standard_normal((n, m)) * 10.0 ** gen.uniform(-6.0, 6.0, m)
        high = gen.uniform(0.0, 2.0, m) / np.abs(X).max(axis=0)
        plan = se.control(
            (0.5 * np.eye(n), X),
            gen.standard_normal(n),
            np.ones(n),
            limits=(None, high),
            cost=se.Cost(R=0.0),
        )
        assert plan.status == "optimal"
        assert np.all(plan.u <= high)


def ring(buses=12, dt=0.1):
    """Angles and frequencies of a ring of machines, storage at three of them."""
    gen = np.random.default_rng(0)
    lines, inertia = gen.uniform(0.5, 2.0, buses), gen.uniform(2.0, 6.0, buses)
    pulls = np.diag(lines + np.roll(lines, 1))
    for i, line in enumerate(lines):
        pulls[i, (i + 1) % buses] -= line
        pulls[(i + 1) % buses, i] -= line
    faster = np.block([np.zeros((buses, buses)), np.eye(buses)])
    slower = np.block([-10.0 * pulls / inertia[:, None], -np.diag(1.0 / inertia)])
    inputs = np.zeros((2 * buses, 3))
    inputs[buses + np.array([0, 4, 8]), range(3)] = 3.0 / inertia[[0, 4, 8]]
    whole = np.block([[np.vstack([faster, slower]), inputs], [np.zeros((3, 2 * buses + 3))]])
    moved = linalg.expm(dt * whole)
    return moved[: 2 * buses, : 2 * buses], moved[: 2 * buses, 2 * buses :]


@pytest.mark.parametrize("more", [{"x": 0.2}, {"x": 5.0}, {"rate": 10.0}, {"rate": 0.05}])
def test_one_machine_of_a_ring_is_brought_back_whatever_is_limited_besides(more):
    """Most states begin at 0, where a single step says little of their size: the plan was u = 0."""
    system, x0, xf = ring(), np.eye(24)[3] * 0.1, np.zeros(24)
    free = se.control(system, x0, xf, steps=20, limits=(-0.3, 0.3))
    if "x" in more:
        high = np.where(np.arange(24) == 3, more["x"], np.inf)
        limits = se.Limits(u=(-0.3, 0.3), x=(-high, high), soft=False)
    else:
        limits = se.Limits(u=(-0.3, 0.3), previous=0.0, **more)
    plan = se.control(system, x0, xf, steps=20, limits=limits)
    assert plan.status == "optimal"
    if more != {"rate": 0.05}:  # the others are not reached
        assert plan.limited.objective == pytest.approx(free.limited.objective, rel=1e-8)


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_status_follows_the_gap_in_every_kind_of_system(gen, kind):
    """6 ways of limits over 1, 3 or 10 steps; where only inputs have unlike units, all optimal."""
    found = set()
    for K in (1, 3, 10):
        one = drawn(kind, gen)
        n, m = one.B.shape
        x0, unit = gen.standard_normal(n), 1.0 / np.maximum(np.abs(one.B).max(axis=0), 1e-30)
        slow = {"rate": 0.2 * unit, "previous": np.zeros(m)}
        for more in (
            {"limits": (-0.3 * unit, 0.3 * unit)},
            {"limits": (-0.3 * unit, None), "R": 0.0},
            slow,
            {"limits": (-0.3 * unit, None), "R": 0.0, **slow},
            {"rate": 0.2, "previous": 0.0, "R": 1e-6},
            {"limits": (-0.3 * unit, 0.3 * unit), "state_limits": (-0.8, 0.8)},
        ):
            plan = se.control((one.A, one.B), x0, np.zeros(n), steps=K, **within(**more, Q=1.0))
            assert follows_the_gap(plan, one.A, one.B, x0), (K, more)
            found.add(plan.status)
    if kind in ("mixed_input_units", "one_huge_entry", "dense", "sparse", "zero_column", "tiny"):
        assert found == {"optimal"}


# -- time ------------------------------------------------------------------------------------------


def test_without_time_nothing_is_factored(gen):
    """Each way ends early, and its gap is true."""
    n, m, K = 6, 3, 40
    F, X = gen.standard_normal((n, n)) * 0.3, gen.standard_normal((n, m))
    x0 = 3.0 * gen.standard_normal(n)
    for more in ({}, {"rate": 0.1, "previous": 0.0}, {"state_limits": (-1.0, 1.0)}):
        for steps in (K, 5 * K):
            how = {"limits": (-0.2, 0.2), "Q": 1.0, "R": 0.1, "steps": steps, **more}
            best = se.control((F, X), x0, np.zeros(n), **within(**how))
            horizon = Horizon(best.limited.task, F, X)
            found = horizon.solve(x0, time_limit=0.0)
            assert found.status == "user_limit"
            assert found.objective - best.limited.objective <= found.gap
            plan = se.control((F, X), x0, np.zeros(n), time_limit=1e-12, **within(**how))
            assert plan.status == "user_limit"
            assert np.all(np.abs(plan.u) <= 0.2)
            assert plan.limited.missed is None
            assert "nan" not in repr(plan)


def test_limits_of_states_from_data_leave_what_each_state_can_be_wrong_by(gen):
    """A plan in units that are apart by 1e4 is found wherever each state has room for its band."""
    F, X, D = np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.0], [1.0]]), np.array([1.0, 1e4])
    states = np.zeros((20, 21, 2))
    u = gen.standard_normal((20, 20, 1))
    for k in range(20):
        noise = 0.01 * gen.standard_normal((20, 2))
        states[:, k + 1] = states[:, k] @ F.T + u[:, k] @ X.T + noise
    statuses = []
    for scale in (np.ones(2), D):
        x, now, after = (
            states[:, :-1].reshape(-1, 2),
            u.reshape(-1, 1),
            states[:, 1:].reshape(-1, 2),
        )
        data = se.Trajectories.from_pairs(x * scale, now, after * scale)
        model = se.identify(data)
        limits = se.Limits(
            u=(-2, 2), x=(-np.array([1.2, 1.0]) * scale, [1.2, 1.0] * scale), soft=False
        )
        plan = se.control(
            model,
            [1.0, 0.5] * scale,
            np.zeros(2),
            steps=5,
            limits=limits,
            cost=se.Cost(Q=1 / scale**2, R=0.1),
        )
        statuses.append(plan.status)
        bands = plan.bound(model.level, bands=True)["bands"].radius
        if plan.status != "infeasible":
            assert (
                np.abs(plan.predicted_states) + bands <= [1.2, 1.0] * scale + 1e-9 * scale
            ).all()
    assert statuses == ["optimal", "optimal"]


def test_a_weight_of_the_inputs_alone_keeps_hard_limits_of_states():
    limits, K = se.Limits(x=(None, 0.9), soft=False), 6
    cost = se.Cost(Q=0.0, Qf=0.0, R=1.0)
    plan = se.control(([[1.1]], [[1.0]]), [1.0], [0.0], steps=K, cost=cost, limits=limits)
    S = np.tril(1.1 ** np.subtract.outer(np.arange(K), np.arange(K)).clip(0))
    free = 1.1 ** np.arange(1, K + 1)
    found = optimize.minimize(
        lambda u: u @ u, np.full(K, -0.2), jac=lambda u: 2.0 * u, method="SLSQP",
        constraints={"type": "ineq", "fun": lambda u: 0.9 - free - S @ u},
    )  # fmt: skip
    assert plan.status == "optimal"
    np.testing.assert_allclose(plan.u[:, 0], found.x, atol=1e-6)
    assert (free + S @ plan.u[:, 0]).max() <= 0.9 + 1e-12


@pytest.mark.parametrize("size", [1e-12, 1e-16, 1e-150])
def test_a_gap_is_finite_where_the_cost_is_nearly_nothing(size):
    how = {"steps": 6, "cost": se.Cost(R=1.0), "limits": (-1.0, 1.0)}
    plan = se.control(([[0.9]], [[1.0]]), [size], [0.0], **how)
    assert plan.status == "optimal"
    assert plan.limited.gap <= 1e-9 * size**2
