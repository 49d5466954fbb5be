"""Fleets with rates, limits of states and path costs, against one program of all units."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import stochens_rs as se
from coverage_study import at_most, repeated, sets
from stochens_rs.exceptions import InputError
from stochens_rs.theory import scenario
from test_fleet import alone, drawn
from twin import populations as twin

BETA = 0.05


def paths(plan: se.FleetPlan) -> list[tuple[np.ndarray, np.ndarray]]:
    """S and y with ``x(1) .. x(K) = S u + y`` of every unit, by simulation of unit inputs."""
    systems, task = plan.units.systems, plan.units.task
    K, m = task.low.shape
    found = []
    for s in range(systems.size):
        x0 = plan.units.x0[s % len(plan.units.x0)]
        c = np.zeros(systems.n) if systems.c is None else systems.c[s]

        def run(u: np.ndarray, x: np.ndarray, c: np.ndarray, s: int = s) -> np.ndarray:
            states = []
            for now in u.reshape(K, m):
                x = systems.A[s] @ x + systems.B[s] @ now + c
                states.append(x)
            return np.concatenate(states)

        none = np.zeros(systems.n)
        S = np.array([run(one, none, none) for one in np.eye(K * m)]).T
        found.append((S, run(np.zeros(K * m), x0, c)))
    return found


def everything(plan: se.FleetPlan) -> tuple[list, np.ndarray, np.ndarray]:
    """The rows (M, t) of every unit with those of R, and all limits ``C u <= c``."""
    task = plan.units.task
    K, m = task.low.shape
    roots = [np.linalg.cholesky(Q + 1e-300 * np.eye(len(Q))).T for Q in (task.stage, task.terminal)]
    half = np.kron(np.eye(K), np.zeros_like(task.stage))
    n = len(task.stage)
    for k in range(K):
        half[k * n : (k + 1) * n, k * n : (k + 1) * n] = roots[k == K - 1]
    R = np.zeros((m, m)) if plan.R is None else plan.R
    weight = np.kron(np.eye(K), np.linalg.cholesky(R + 1e-300 * np.eye(m)).T)
    one = np.eye(K * m)
    C, c = [one, -one], [task.high.ravel(), -task.low.ravel()]
    if task.rate is not None:
        D = one - np.eye(K * m, k=-m)
        first = np.r_[task.previous, np.zeros((K - 1) * m)]
        C += [D, -D]
        c += [np.tile(task.rate, K) + first, np.tile(task.rate, K) - first]
    units = []
    for S, y in paths(plan):
        units.append(
            (np.vstack([half @ S, weight]), np.r_[half @ (task.reference.ravel() - y), 0 * one[0]])
        )
        if task.state_low is not None:
            C += [S, -S]
            c += [task.state_high.ravel() - y, y - task.state_low.ravel()]
    rows, right = np.vstack(C), np.concatenate(c)
    return units, rows[np.isfinite(right)], right[np.isfinite(right)]


def at_once(plan: se.FleetPlan) -> float:
    """The least value, by one cone problem of all units and limits for Clarabel."""
    pytest.importorskip("clarabel")
    units, C, c = everything(plan)
    if plan.risk == "mean":  # one cone of all rows
        share = np.sqrt(len(units))
        units = [tuple(np.concatenate(part) / share for part in zip(*units, strict=True))]
    return twin.program(units, C, c)[1]


@pytest.mark.parametrize("risk", ["mean", "worst"])
@pytest.mark.parametrize("seed", range(12))
def test_the_command_is_that_of_all_rows_at_once(risk, seed: int) -> None:
    gen = np.random.default_rng(seed)
    n, m, K, N = 2 + seed % 3, 1 + seed % 2, 3 + seed % 4, 25
    fleet = drawn(gen, N, n, m, offsets=seed % 3 == 1, spread=0.15)
    x0 = gen.standard_normal((N, n) if seed % 4 == 0 else n)
    free = se.control_fleet(fleet, x0, np.zeros(n), K, limits=(-3.0, 3.0), risk=risk)
    extremes = np.array([S @ free.u.ravel() + y for S, y in paths(free)]).reshape(N, K, n)
    # half of the largest states that the command without these limits leads to
    size = np.abs(extremes).max(axis=(0, 1))
    high = np.where(gen.random((K, n)) < 0.5, 0.8 * size, np.inf)
    high[0] = np.inf
    asked = se.Limits(
        u=(-3.0, 3.0),
        rate=2.0 if seed % 2 else None,
        previous=0.1 if seed % 2 else None,
        x=(None if seed % 3 else -1.2 * size, high),
        soft=False,
    )
    cost = se.Cost(
        Q=0.5 * (1.0 + gen.random(n)) if seed % 2 else None,
        R=0.1 if seed % 3 == 0 else None,
        reference=gen.standard_normal((K + 1, n)) if seed % 4 == 1 else None,
    )
    plan = se.control_fleet(
        fleet, x0, None if seed % 4 == 1 else np.zeros(n), K, limits=asked, cost=cost, risk=risk
    )
    if plan.status == "infeasible":
        _, C, c = everything(plan)
        assert linprog(np.zeros(C.shape[1]), C, c - 1e-6, bounds=(None, None)).status == 2
        assert plan.missing > 0.0
        return
    assert plan.status == "optimal", (plan, plan.excess.max())
    value = at_once(plan)
    _, C, c = everything(plan)
    assert plan.value == pytest.approx(value, rel=1e-6, abs=1e-9)
    assert plan.lower_bound <= value * (1 + 1e-7)
    assert plan.gap <= 1e-6
    assert (C @ plan.u.ravel() - c).max() <= 1e-7
    assert not plan.excess.any()
    if risk == "worst" and plan.support:
        assert np.array_equal(plan.u.ravel(), alone(plan))


def test_feasible_and_infeasible_cases_were_both_among_them() -> None:
    """One unit: x(1) = 3 + u <= 1 with |u| <= 1 lacks 1, and with |u| <= 3 nothing."""
    one = se.SystemEnsemble(np.ones((1, 1, 1)), np.ones((1, 1, 1)))
    for risk in ("mean", "worst"):
        for limit, missing in ((1.0, 1.0), (3.0, 0.0)):
            asked = se.Limits(u=(-limit, limit), x=(None, 1.0), soft=False)
            plan = se.control_fleet(one, [3.0], [2.5], 1, limits=asked, risk=risk)
            assert plan.missing == pytest.approx(missing, abs=1e-9)
            assert plan.status == ("infeasible" if missing else "optimal")
            assert plan.u[0, 0] == pytest.approx(-1.0 if missing else -2.0, abs=1e-5)
            assert plan.excess.max() == pytest.approx(missing, abs=1e-5)


def test_rates_of_the_double_integrator() -> None:
    """From (1, 0) to 0 in two steps: u = (-2/5, 1/10), J = 9/20, by hand."""
    one = se.SystemEnsemble(np.array([[[1.0, 1.0], [0.0, 1.0]]]), np.array([[[0.0], [1.0]]]))
    asked = se.Limits(u=(-0.5, 0.5), rate=0.5, previous=0.0)
    for risk in ("mean", "worst"):
        plan = se.control_fleet(
            one, [1.0, 0.0], [0.0, 0.0], 2, limits=asked, cost=se.Cost(R=0.0), risk=risk
        )
        np.testing.assert_allclose(plan.u.ravel(), [-0.4, 0.1], atol=1e-5)
        assert plan.value == pytest.approx(np.sqrt(9 / 20), abs=1e-7)
        assert plan.lower_bound == pytest.approx(np.sqrt(9 / 20), abs=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_what_limits_lack_is_the_least(seed: int) -> None:
    gen = np.random.default_rng(100 + seed)
    n, m, K, N = 2, 1, 3, 20
    fleet, x0 = drawn(gen, N, n, m), 4.0 * gen.standard_normal(n)
    asked = se.Limits(u=(-0.3, 0.3), x=(-0.2, 0.2), soft=False)
    plan = se.control_fleet(
        fleet, x0, np.zeros(n), K, limits=asked, risk=("mean", "worst")[seed % 2]
    )
    _, C, c = everything(plan)
    states = np.arange(len(c)) >= 2 * K * m
    found = linprog(
        np.r_[np.zeros(K * m), 1.0],
        np.hstack([C, -states[:, None].astype(float)]),
        c,
        bounds=[(None, None)] * (K * m) + [(0, None)],
    )
    assert plan.status == "infeasible"
    assert plan.missing == pytest.approx(found.fun, rel=1e-5)
    assert plan.excess.max() <= found.fun * (1 + 1e-4)
    if plan.risk == "worst":
        with pytest.raises(InputError, match="leave their limits of states"):
            plan.certify(BETA)


def tanks(gen: np.random.Generator, N: int) -> se.SystemEnsemble:
    """Two vessels in a row, with flows of a heavy-tailed law: x = (levels), u = inflow."""
    out = 0.2 + 0.05 * np.abs(gen.standard_t(3, N)).clip(max=8.0)
    leak = 0.1 * gen.beta(2.0, 5.0, N)
    A, B = np.zeros((N, 2, 2)), np.zeros((N, 2, 1))
    A[:, 0, 0], A[:, 1, 0], A[:, 1, 1] = 1.0 - out, out, 1.0 - leak
    B[:, 0, 0] = gen.uniform(0.7, 1.3, N)
    return se.SystemEnsemble(A, B)


def test_the_risk_holds_for_misses_and_limits_together() -> None:
    """The first vessel may not run over: units that hold the limit are part of the support."""
    runs, N, fresh = sets(300, 80), 50, 3000
    asked = se.Limits(u=(0.0, 2.0), rate=0.8, previous=0.0, x=(0.0, [0.9, np.inf]), soft=False)

    def case(gen):
        plan = se.control_fleet(
            tanks(gen, N), [0.2, 0.1], [0.5, 1.2], 6, limits=asked, risk="worst"
        )
        others = tanks(gen, fresh)
        held = plan.validate(others, BETA)
        risk, certified = held.count / fresh, plan.certify(BETA)
        # counted as if only the units of the largest miss gave the command
        few = int(np.count_nonzero(plan.misses > (1 - 1e-6) * plan.threshold))
        wrong = scenario.hold_out(N, 0, 0.5)
        return {
            "status": plan.status == "optimal",
            "failed": risk > certified.epsilon,
            "a_priori": risk > plan.certify(BETA, method="a priori").epsilon,
            "more": len(plan.support) > few,
            "wrong": risk > wrong,
            "by_misses": np.mean(held.misses > plan.threshold) < risk,
        }

    found = repeated(case, runs, 41)
    assert found["status"].mean() > 0.95
    at_most(found["failed"].sum(), runs, BETA)
    at_most(found["a_priori"].sum(), runs, BETA)
    assert found["more"].mean() > 0.5
    assert found["by_misses"].mean() > 0.5  # fresh units do leave limits
    assert found["wrong"].mean() > 0.3  # as if the units were fixed beforehand: too often
