"""Fleets whose largest miss can be nearly 0: the tiny weight, true lower bounds, the count."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from test_fleet import drawn, gains, maps
from twin import populations as twin

GOOD = 1e-9  # of value^2 - lower_bound^2, relative to J(0) + J(u)


def near_one(gen: np.random.Generator, N: int) -> tuple[se.SystemEnsemble, np.ndarray]:
    """N units with two states and one input around one, and where they begin."""
    A = gen.standard_normal((2, 2))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    B = gen.standard_normal((2, 1))
    As = A + 0.05 * gen.standard_normal((N, 2, 2))
    Bs = B + 0.05 * gen.standard_normal((N, 2, 1))
    return se.SystemEnsemble(As, Bs), gen.standard_normal(2)


def at_zero(plan: se.FleetPlan) -> float:
    return float(plan.units.misses(np.zeros_like(plan.u))[0].max())


@pytest.mark.parametrize("N", [3, 5, 10, 40])
def test_twenty_inputs_for_a_few_units(N: int) -> None:
    """2 N equations of 20 unknowns; with 3 units the miss can be 0."""
    pytest.importorskip("clarabel")
    for seed in range(sets(8, 2)):
        fleet, x0 = near_one(np.random.default_rng(seed), N)
        plan = se.control_fleet(fleet, x0, np.zeros(2), 20, risk="worst")
        scale = at_zero(plan)
        assert plan.status == "optimal"
        assert 0.0 <= plan.gap <= 1e-5
        near = plan.value**2 - plan.lower_bound**2 <= GOOD * (scale**2 + plan.value**2)
        assert near or plan.gap <= 1e-6
        assert plan.R is not None
        both = np.hypot(plan.threshold, np.sqrt(plan.R[0, 0]) * np.linalg.norm(plan.u))
        assert plan.value == pytest.approx(both, rel=1e-9)
        # any other command costs as much as the lower bound at least
        pairs = maps(plan.units)
        units = [twin.unit(G, b, plan.R[0, 0] * np.eye(20)) for G, b in pairs]
        best = twin.worst(units)
        assert plan.lower_bound <= best * (1 + 1e-9)
        assert plan.value <= best + 1e-5 * scale
        if N == 3:
            G, b = (np.concatenate(part) for part in zip(*pairs, strict=True))
            smallest = np.linalg.lstsq(G, b, rcond=None)[0]
            assert np.linalg.norm(plan.u) <= 1.001 * np.linalg.norm(smallest)
            assert plan.threshold <= 1e-3 * scale
            assert plan.certify(0.1).size == 3


@pytest.mark.parametrize("N", [1, 2, 3])
def test_without_a_weight_and_with_as_many_inputs_as_needed(
    gen: np.random.Generator, N: int
) -> None:
    """Where all units reach the target nothing weighs in the dual, and no argument is at fault."""
    for k in range(60):
        n, m, K = gen.integers(1, 4), gen.integers(1, 4), int(gen.integers(1, 4))
        units = [(gen.standard_normal((n, n)), gen.standard_normal((n, m))) for _ in range(N)]
        x0, xf, cost = gen.standard_normal(n), gen.standard_normal(n), se.Cost(R=0.0)
        within = (None, (-1.0, 1.0))[k % 2]
        plan = se.control_fleet(units, x0, xf, K, risk="worst", cost=cost, limits=within)
        assert plan.status == "optimal"
        if within is None:
            maps_of = maps(plan.units)
            G, b = (np.concatenate(part) for part in zip(*maps_of, strict=True))
            left = G @ np.linalg.lstsq(G, b, rcond=None)[0] - b
            assert plan.threshold <= np.linalg.norm(left) + 1e-5 * at_zero(plan)


def test_the_weight_is_that_of_the_widest_map(gen: np.random.Generator) -> None:
    fleet, x0 = drawn(gen, 30, 3, 2), gen.standard_normal(3)
    Q = np.diag([1.0, 2.0, 0.5])
    plan = se.control_fleet(fleet, x0, np.zeros(3), 4, risk="worst", cost=se.Cost(Qf=Q))
    sizes = [np.trace(G.T @ Q @ G) / 8 for G, _ in maps(plan.units)]
    assert plan.widest == int(np.argmax(sizes))
    np.testing.assert_allclose(plan.R, 1e-8 * max(sizes) * np.eye(2), rtol=1e-12)
    assert se.control_fleet(fleet, x0, np.zeros(3), 4, cost=se.Cost(Qf=Q)).R is None
    own = se.control_fleet(fleet, x0, np.zeros(3), 4, risk="worst", cost=se.Cost(Qf=Q, R=0.0))
    assert own.widest is None
    assert not own.R.any()
    idle = se.control_fleet(gains(0.0, 0.0), [0.0], [1.0], 2, risk="worst")
    assert (idle.widest, idle.R, idle.value, idle.u.any()) == (None, None, 1.0, False)


def test_the_unit_of_the_weight_is_counted() -> None:
    for R, count in ((None, 2), (0.0, 1)):
        # the unit with gain 1 alone gives the command
        plan = se.control_fleet(
            gains(1.0, 2.0, 1.5),
            [0.0],
            [1.0],
            1,
            risk="worst",
            limits=(-0.5, 0.5),
            cost=se.Cost(R=R),
        )
        assert plan.support == (0, 1)[:count]
        assert plan.certify(0.1).count == count
        assert plan.certify(0.1, method="a priori").count == 1 + count
        radius = np.array([0.1, 0.1, 0.2])
        assert plan.certify(0.1, radius=radius, delta=0.01).count == count


def weights(gen: np.random.Generator) -> list[np.ndarray]:
    """Diagonal, full, singular ones, and one of a single input."""
    X = gen.standard_normal((3, 3))
    return [
        0.05 * np.diag(gen.uniform(0.1, 1.0, 3)),
        0.05 * X @ X.T,
        0.05 * X[:, :1] @ X[:, :1].T,
        np.diag([0.1, 0.0, 0.0]),
    ]


@pytest.mark.parametrize("sides", [None, (None, 0.3), (-0.4, 0.2), ([-0.2, -np.inf, 0.1], 0.1)])
def test_lower_bounds_with_any_weight(gen: np.random.Generator, sides) -> None:
    pytest.importorskip("clarabel")
    for k in range(sets(6, 3)):
        K, N = 1 + k % 3, 25
        fleet, x0 = drawn(gen, N, 3, 3, spread=0.3), 3.0 * gen.standard_normal(3)
        for R in weights(gen):
            plan = se.control_fleet(
                fleet, x0, np.zeros(3), K, risk="worst", limits=sides, cost=se.Cost(R=R)
            )
            whole = np.kron(np.eye(K), R)
            units = [twin.unit(G, b, whole) for G, b in maps(plan.units)]
            best = twin.worst(units, plan.units.task.low.ravel(), plan.units.task.high.ravel())
            assert plan.status == "optimal"
            assert plan.value == pytest.approx(best, rel=2e-6)
            assert plan.lower_bound <= best * (1 + 1e-9)
            assert plan.gap <= 1e-6
