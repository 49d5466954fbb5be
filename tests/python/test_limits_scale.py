"""Controls within limits in all units, at all sizes, and without time."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stochens_rs as se
from hidden_systems import KINDS, drawn
from limit_plans import draw_case, within
from limit_problems import draws
from stochens_rs import _core as core
from stochens_rs.controls.constraints import root
from stochens_rs.controls.limited import OPTIMAL, Horizon
from stochens_rs.theory.dynamics import states

INF = np.inf
A, B = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[1.0, 1.0], [0.5, -2.0]])


def level(plan, A, B, x0):
    """``1e-9 (J(0) + J(u))``, of many steps with the size of J along the states if it is less."""
    task, u = plan.limited.task, plan.u
    horizon = Horizon(task, A, B)
    scale = horizon.objective(x0, np.zeros_like(u))
    if horizon.core.long or not task.boxed:
        weights = [task.stage] * (len(u) - 1) + [task.terminal]
        drift, wanted = states(A, B, x0, u)[:-1] @ A.T, task.reference
        size = sum(x @ Q @ x + r @ Q @ r for x, r, Q in zip(drift, wanted, weights, strict=True))
        scale = min(scale, size + np.sum((u @ plan.limited.R) * u))
    return OPTIMAL * (scale + plan.objective)


def follows_the_gap(plan, A, B, x0):
    most = level(plan, A, B, x0)
    if plan.status == "optimal":
        return plan.gap <= most * (1 + 1e-6)
    return plan.status == "infeasible" or plan.gap > most * (1 - 1e-6)


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
        assert plan.gap <= 1e-12 * plan.objective
        assert np.all(np.abs(np.diff(plan.u, axis=0, prepend=0.0)) <= limit * (1 + 1e-12))
        found.append((plan.objective, plan.u * D))
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


def test_the_status_follows_the_gap_of_drawn_problems(gen):
    for p in draws(gen, 300):
        F = root(p.Q)
        M, y = np.ascontiguousarray(F @ p.G), F @ p.b
        found = core.box_control(M, y, np.ascontiguousarray(p.R), p.low, p.high, None, None)
        assert (found.status == "optimal") == (
            found.gap <= OPTIMAL * (found.at_zero + found.objective)
        )
        assert found.status == "optimal"
    for i in range(60):
        F, X, x0, K, low, high, weights = draw_case(gen, i)
        goal = np.ones(len(F))
        plan = se.control((F, X), x0, goal, steps=K, **within(limits=(low, high), **weights))
        assert follows_the_gap(plan, F, X, x0)


# -- sizes -----------------------------------------------------------------------------------------


def test_the_way_follows_the_work():
    """Riccati's recursion for many steps of few states, condensed matrices for few of many."""
    for n, m, K, recursion in ((10, 5, 50, True), (520, 26, 10, False), (4, 2, 300, True)):
        F, X = np.zeros((n, n)), np.zeros((n, m))
        X[:m] = np.eye(m)
        plan = se.control(
            (F, X), np.ones(n), np.zeros(n), steps=K, limits=(-0.3, 0.3), cost=se.Cost(R=0.1)
        )
        assert Horizon(plan.limited.task, F, X).core.long == recursion
        assert plan.status == "optimal"


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
            assert found.objective - best.objective <= found.gap
            plan = se.control((F, X), x0, np.zeros(n), time_limit=1e-12, **within(**how))
            assert plan.status == "user_limit"
            assert np.all(np.abs(plan.u) <= 0.2)
            assert math.isnan(plan.missed)
            assert "nan" not in repr(plan)
