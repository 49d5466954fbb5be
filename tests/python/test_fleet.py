"""One command for a fleet: exact cases, the reference, symmetries, hostile input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import stochens_rs as se
from coverage_study import most, sets
from stochens_rs import _core
from stochens_rs.exceptions import InputError, ShapeError
from stochens_rs.fleet import Units
from stochens_rs.plots.lines import draw_misses


def gains(*values: float) -> se.SystemEnsemble:
    """x(1) = a_s u."""
    B = np.array(values)[:, None, None]
    return se.SystemEnsemble(0.0 * B, B)


def drawn(
    gen: np.random.Generator, N: int, n: int, m: int, *, offsets: bool = False, spread: float = 0.2
) -> se.SystemEnsemble:
    """Units of a population around a system with modes of size about 0.8."""
    A = gen.standard_normal((n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B = gen.standard_normal((n, m))
    As = A + spread * gen.standard_normal((N, n, n)) / np.sqrt(n)
    Bs = B + spread * gen.standard_normal((N, n, m))
    return se.SystemEnsemble(As, Bs, gen.standard_normal((N, n)) if offsets else None)


def maps(units: Units) -> list[tuple[np.ndarray, np.ndarray]]:
    """G_s and b_s of every unit, by powers."""
    s, K = units.systems, units.task.steps
    found = []
    for i in range(units.size):
        powers = [np.linalg.matrix_power(s.A[i], k) for k in range(K + 1)]
        G = np.hstack([powers[K - 1 - k] @ s.B[i] for k in range(K)])
        b = units.task.reference[-1] - powers[K] @ units.x0[i % len(units.x0)]
        if s.c is not None:
            b = b - sum(powers[k] @ s.c[i] for k in range(K))
        found.append((G, b))
    return found


def test_two_units_have_their_commands() -> None:
    two = gains(1.0, 2.0)
    mean = se.control_fleet(two, [0.0], [1.0], 1)
    assert mean.u[0, 0] == pytest.approx(3 / 5, abs=1e-15)
    assert mean.value == pytest.approx(np.sqrt(0.1), abs=1e-15)
    for limit, u, value, support in ((None, 2 / 3, 1 / 3, 2), (0.5, 1 / 2, 1 / 2, 1)):
        limits = None if limit is None else (-limit, limit)
        plan = se.control_fleet(two, [0.0], [1.0], 1, limits=limits, risk="worst")
        assert plan.u[0, 0] == pytest.approx(u, abs=1e-8)
        assert plan.value == pytest.approx(value, abs=1e-7)  # the weight is in it
        assert plan.threshold == pytest.approx(value, abs=1e-8)
        assert 0.0 <= plan.gap < 1e-7
        assert plan.status == "optimal"
        # the unit with the larger gain, which the weight was taken from, is counted
        assert plan.certify(0.1).count == 2
        own = se.control_fleet(
            two, [0.0], [1.0], 1, risk="worst", limits=limits, cost=se.Cost(R=0.0)
        )
        assert own.certify(0.1).count == support
        assert plan.active.tolist() == [[int(limit is not None)]]
    zero = se.control_fleet(gains(0.0, 2.0), [0.0], [1.0], 1)
    assert zero.u[0, 0] == pytest.approx(0.5)
    assert zero.value**2 == pytest.approx(0.5)


@pytest.mark.parametrize("limits", [None, (None, 3.0)])
def test_an_input_that_moves_no_unit_leaves_the_mean_as_it_is(limits, gen) -> None:
    for _ in range(20):
        units = drawn(gen, 30, 2, 1)
        idle = np.concatenate([units.B, 0.0 * units.B], axis=2)
        both = se.control_fleet(
            se.SystemEnsemble(units.A, idle), [1.0, 2.0], [0.0, 0.0], 3, limits=limits
        )
        alone = se.control_fleet(units, [1.0, 2.0], [0.0, 0.0], 3, limits=limits)
        assert both.status == "optimal"
        assert both.value == pytest.approx(alone.value, rel=1e-9)
        np.testing.assert_allclose(both.u[:, 0], alone.u[:, 0], rtol=1e-6, atol=1e-8)


def test_a_unit_that_no_input_moves_gives_no_false_support() -> None:
    """It misses 1 for every u, and the others less for all u in (-4/2.1, -2/1.9)."""
    gains, x0 = np.array([0.0, 1.9, 2.0, 2.1])[:, None, None], [[1.0], [3.0], [3.0], [3.0]]
    fleet = se.SystemEnsemble(np.ones((4, 1, 1)), gains)
    plan = se.control_fleet(fleet, x0, [0.0], 1, risk="worst", limits=(-5, 5), cost=se.Cost(R=0.0))
    assert plan.value == pytest.approx(1.0)
    assert plan.misses[0] == plan.threshold
    # by its multipliers it were 1
    risk = plan.certify(0.1)
    assert risk.count > 1
    # where the command is unique, the unit that sets it counts as well
    weighed = se.control_fleet(fleet, x0, [0.0], 1, risk="worst", cost=se.Cost(R=0.1))
    assert weighed.certify(0.1).count == 2


def test_units_left_out_miss_more() -> None:
    gen = np.random.default_rng(3)
    starts = gen.random((60, 1))
    fleet = se.SystemEnsemble(np.ones((60, 1, 1)), np.ones((60, 1, 1)))
    plan = se.control_fleet(fleet, starts, [0.0], 1, risk="worst", discard=6)
    assert len(set(plan.removed)) == 6
    assert (plan.misses[list(plan.removed)] > plan.threshold).all()
    kept = np.delete(starts[:, 0], plan.removed)
    assert plan.value == pytest.approx((kept.max() - kept.min()) / 2, rel=1e-6)
    risk = plan.certify(0.05)
    assert risk.method == "compression"
    found = se.theory.scenario.compression(60, len(plan.support), 0.05, violations=6)
    assert risk.epsilon == found
    assert not set(plan.support) & set(plan.removed)
    convex = plan.certify(0.05, method="discarding")
    assert convex.epsilon == se.theory.scenario.discarding(60, 6, 3, 0.05)
    with pytest.raises(InputError, match="does not hold after units were left out"):
        plan.certify(0.05, method="a priori")


def test_radii_of_models_enter_the_threshold() -> None:
    plan = se.control_fleet(gains(*np.linspace(1, 2, 30)), [0.0], [1.0], 1, risk="worst")
    radius = np.full(30, 0.01)
    radius[7] = 0.5
    risk = plan.certify(0.1, radius=radius, delta=0.02)
    assert risk.threshold == pytest.approx(plan.misses[7] + 0.5)
    # the unit that sets the threshold is not of those that give the command
    assert 7 not in plan.support
    assert risk.count == 2
    assert risk.delta == 0.02
    assert "+ 2 %" in repr(risk)
    assert "plant behind" in risk.covers
    held = plan.validate(gains(1.1, 1.3), 0.1, radius=[0.0, 1.0], delta=0.02)
    assert held.count == 1
    with pytest.raises(InputError, match="`delta` must be given"):
        plan.certify(0.1, radius=radius)


def test_a_time_limit_gives_a_command_that_is_certified(gen: np.random.Generator) -> None:
    fleet, x0 = drawn(gen, 3000, 4, 2), [3.0, 1.0, -2.0, 1.0]
    for limit in (1e-9, 1e-3, 5e-3, 0.02):
        plan = se.control_fleet(
            fleet, x0, np.zeros(4), 10, limits=(-1, 1), risk="worst", time_limit=limit
        )
        assert plan.value == pytest.approx(plan.misses.max(), rel=1e-6)
        assert plan.lower_bound <= plan.value
        count = len(plan.support)
        assert np.array_equal(plan.u.ravel(), alone(plan))
        risk = plan.certify(0.1)
        assert (risk.count, risk.threshold) == (count, plan.threshold)
        assert risk.epsilon == se.theory.scenario.compression(3000, count, 0.1)
        if limit == 1e-9:
            assert (plan.status, count) == ("user_limit", 0)
            with pytest.raises(InputError, match="needs an optimal plan"):
                plan.certify(0.1, method="a priori")


def alone(plan: se.FleetPlan) -> np.ndarray:
    """The command of a plan from its support alone: of the other units nothing is known."""
    few, task = list(plan.support), plan.units.task
    s, rows = plan.units.systems, slice(None) if len(plan.units.x0) == 1 else few
    c = None if s.c is None else s.c[few]
    part = s.A[few], s.B[few], c, plan.units.x0[rows]
    if not few:
        return np.clip(
            np.zeros(plan.u.size), plan.units.task.low.ravel(), plan.units.task.high.ravel()
        )
    return _core.fleet_alone(part, task, task.R is None, list(range(len(few))), 1).ravel()


@pytest.mark.parametrize("limits", [None, (None, 5.0)])
def test_a_working_set_that_can_be_reached_gives_no_bound(limits):
    """One state: a few units are all led to the target, and the dual vectors are rounding."""
    gen = np.random.default_rng(2)
    low, high = (None, None) if limits is None else limits
    for N in (3, 6, 8, 20, 60) * 4:
        K = int(gen.integers(2, 6))
        A = 0.5 + 0.3 * gen.standard_normal((N, 1, 1))
        B = 1.0 + 0.4 * gen.standard_normal((N, 1, 2))
        plan = se.control_fleet(
            se.SystemEnsemble(A, B),
            [1.0],
            [-3.0],
            K,
            risk="worst",
            limits=limits,
            cost=se.Cost(R=0.0),
        )
        a = A[:, 0]
        G = np.hstack([a ** (K - 1 - k) * B[:, 0] for k in range(K)])
        b = -3.0 - a[:, 0] ** K
        one = np.ones((N, 1))
        best = linprog(
            np.r_[np.zeros(2 * K), 1.0],
            np.block([[G, -one], [-G, -one]]),
            np.r_[b, -b],
            bounds=[(low, high)] * (2 * K) + [(0.0, None)],
        ).fun
        assert plan.lower_bound <= best + 1e-7
        assert plan.value <= best + 1e-6


def test_fresh_units_of_another_step_or_of_other_names_are_refused() -> None:
    A, B = np.array([[[0.5]], [[0.4]]]), np.ones((2, 1, 1))
    names = se.System([[1.0]], [[1.0]], states=["v"], inputs=["F"]).labels
    units = se.SystemEnsemble(A, B, dt=0.05, labels=names)
    fleet = se.control_fleet(units, [1.0], [0.0], 2, risk="worst")
    plan = se.control(units[0], [1.0], [0.0], steps=2)
    other = se.System([[1.0]], [[1.0]], states=["w"], inputs=["F"]).labels
    for check in (lambda fresh: fleet.validate(fresh, 0.1), plan.validate):
        check(se.SystemEnsemble(A + 0.05, B))  # without names and dt: by position
        check(se.SystemEnsemble(A + 0.05, B, dt=0.05 * (1.0 + 1e-12), labels=names))
        with pytest.raises(ShapeError, match=r"must have dt=0\.05 as this plan, got dt=0\.1"):
            check(se.SystemEnsemble(A + 0.1, B, dt=0.1))
        with pytest.raises(InputError, match="'w'"):
            check(se.SystemEnsemble(A + 0.1, B, labels=other))
    for compare in (plan.states, lambda system, x0: plan.error(system, x0, [0.0])):
        with pytest.raises(ShapeError, match="`system` must have dt"):
            compare(([[0.5]], [[1.0]], 0.1), [1.0])


@pytest.mark.parametrize("risk", ["mean", "worst"])
def test_a_risk_gives_its_threshold(risk) -> None:
    """Of 300 samples of fresh units, in `make test` 100, 0.1 may mislead; alarm 1e-4."""
    gen = np.random.default_rng(4)
    plan = se.control_fleet(gains(*gen.uniform(0.5, 1.5, 20)), [0.0], [1.0], 1, risk=risk)
    u, failed, sharp, count = plan.u[0, 0], 0, 0, sets(300, 100)
    for _ in range(count):
        fresh = gains(*gen.uniform(0.5, 1.5, 80))
        found = plan.validate(fresh, 0.1, epsilon=0.2)
        assert found.epsilon <= 0.2
        assert found.count == np.sum(found.misses > found.threshold)
        low, high = (1.0 + side * found.threshold for side in (-1.0, 1.0))
        inside = np.clip((low / u, high / u), 0.5, 1.5)
        failed += inside[1] - inside[0] < 0.8
        again = plan.validate(fresh, 0.1, threshold=found.threshold)
        assert again.epsilon == found.epsilon
        sharp += inside[1] - inside[0] < 0.85
    assert failed <= most(count, 0.1) < sharp
    for words, text in (
        ({"epsilon": 0.01}, "needs 230 fresh units at least, got 80"),
        ({"epsilon": 0.2, "threshold": 1.0}, "`threshold` must be left out"),
        ({"epsilon": 0.0}, "`epsilon`"),
    ):
        with pytest.raises(InputError, match=text):
            plan.validate(fresh, 0.1, **words)


def test_units_that_leave_their_limits_have_no_threshold() -> None:
    limits = se.Limits(x=(None, 1.1), soft=False)
    plan = se.control_fleet(gains(0.9, 1.0), [0.0], [1.0], 1, limits=limits, risk="worst")
    fresh = gains(*([0.95] * 15 + [5.0] * 5))
    with pytest.raises(InputError, match="allows 2 units to leave limits: more do"):
        plan.validate(fresh, 0.1, epsilon=0.3)
    assert plan.validate(fresh, 0.1, epsilon=0.5).threshold < 1.0


@pytest.mark.parametrize("level", [0.05, 0.3, 0.5, 0.7, 0.97])
def test_the_legend_of_misses_stands_beside_the_threshold(level: float) -> None:
    misses = np.linspace(0.0, 1.0, 30) ** 2
    none = np.zeros(30, dtype=bool)
    ax = draw_misses(misses, level, none, none, named="threshold", fresh=misses)
    ax.figure.canvas.draw()
    box = ax.get_legend().get_window_extent()
    line = ax.transData.transform((0.5, level))[1]
    assert not box.y0 < line < box.y1
