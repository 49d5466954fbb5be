"""The command of a fleet is that of its support alone, and its risk is what `certify` says."""

from __future__ import annotations

import numpy as np
import pytest

import hidden_systems
import stochens_rs as se
from coverage_study import at_most, repeated, sets
from stochens_rs.exceptions import InputError
from test_fleet import alone, drawn, gains
from test_fleet_near_zero import near_one

BETA = 0.05
TRIMS = 30
SIZE, SMALL = 1e-6, 2e-7  # of the gains of the large input, and of the trims
LIMITS = (np.r_[-np.inf, -np.ones(TRIMS)], np.r_[np.inf, np.ones(TRIMS)])


def trimmed(gen: np.random.Generator, N: int) -> se.SystemEnsemble:
    """One input of about 1e6 with a gain of two values, and trims below 1 that break the ties."""
    B = np.empty((N, 1, 1 + TRIMS))
    B[:, 0, 0] = SIZE * np.where(gen.random(N) < 0.5, 0.5, 1.5)
    B[:, 0, 1:] = SMALL * gen.standard_normal((N, TRIMS))
    return se.SystemEnsemble(np.zeros((N, 1, 1)), B, SMALL * gen.standard_normal((N, 1)))


@pytest.mark.parametrize("R", [None, 0.0])
def test_trims_beside_a_large_input_are_counted(R) -> None:
    """The trims move the value by less than 1e-6 of it and the command by 1e-6 of it: 31 inputs."""
    runs, N, fresh = sets(20, 5), 400, 20_000

    def case(gen):
        plan = se.control_fleet(
            trimmed(gen, N), [0.0], [1.0], 1, risk="worst", limits=LIMITS, cost=se.Cost(R=R)
        )
        others = trimmed(gen, fresh)
        miss = np.abs(others.B[:, 0] @ plan.u[0] + others.c[:, 0] - 1.0)
        risk, certified = np.mean(miss > plan.threshold), plan.certify(BETA)
        # what was said of the 12 units without which neither changed by more
        few = se.theory.scenario.judged(N, 12, BETA)
        same = np.array_equal(plan.u.ravel(), alone(plan))
        return {
            "same": same,
            "excess": plan.threshold / plan.lower_bound - 1.0,
            "count": certified.count,
            "failed": risk > certified.epsilon,
            "few": risk > few,
            "epsilon": certified.epsilon,
        }

    found = repeated(case, runs, 23)
    assert found["same"].all()
    assert (found["excess"] <= 1e-6).all()
    assert found["failed"].sum() == 0
    at_most(found["failed"].sum(), runs, BETA)
    assert (found["epsilon"] < 0.6).all()
    assert (found["count"] >= 30).all()
    assert found["few"].sum() >= runs / 2  # a count up to tolerances is exceeded in most runs


def test_units_alone_give_the_command_of_any_fleet() -> None:
    """Units around a system of each kind; with and without limits and R."""
    gen = np.random.default_rng(5)
    certified = 0
    for k, system in enumerate(hidden_systems.of_each_kind(gen)):
        N, (n, m) = 40, system.B.shape
        A = system.A * (1.0 + 0.05 * gen.standard_normal((N, n, n)))
        B = system.B * (1.0 + 0.1 * gen.standard_normal((N, n, m)))
        fleet = se.SystemEnsemble(A, B)
        for limits, R in ((None, None), ((-0.5, 0.5), None), ((-0.5, 0.5), 0.0)):
            plan = se.control_fleet(
                fleet,
                gen.standard_normal(n),
                np.zeros(n),
                1 + k % 3,
                risk="worst",
                limits=limits,
                cost=se.Cost(R=R),
            )
            assert plan.status in ("optimal", "optimal_inaccurate")
            if len(plan.support) < N:
                assert np.array_equal(plan.u.ravel(), alone(plan)), system.kind
            risk = plan.certify(BETA)
            assert risk.threshold == plan.misses.max()
            assert risk.count == len(plan.support)
            certified += risk.epsilon < 1.0
    assert certified >= 60


def test_the_risk_of_any_fleet_is_below_its_bound() -> None:
    """A kind by chance, up to two units left out; the risk is estimated by 2000 fresh units."""
    kinds, runs, N, fresh = list(hidden_systems.KINDS), sets(210, 60), 30, 2000

    def case(gen):
        system = hidden_systems.drawn(kinds[int(gen.integers(len(kinds)))], gen, 3, 2)
        n, m = system.B.shape
        A = system.A * (1.0 + 0.2 * gen.standard_normal((N + fresh, n, n)))
        B = system.B * (1.0 + 0.2 * gen.standard_normal((N + fresh, n, m)))
        discard = int(gen.integers(3))
        plan = se.control_fleet(
            se.SystemEnsemble(A[:N], B[:N]),
            gen.standard_normal(n),
            np.zeros(n),
            2,
            limits=(-1.0, 1.0),
            risk="worst",
            discard=discard,
        )
        risk = plan.validate(se.SystemEnsemble(A[N:], B[N:]), BETA).count / fresh
        # the same k, counted as if these units had been fixed beforehand
        fixed = se.theory.scenario.hold_out(N, 0, 0.5)
        return {"failed": risk > plan.certify(BETA).epsilon, "fixed": risk > fixed}

    found = repeated(case, runs, 29)
    at_most(found["failed"].sum(), runs, BETA)
    assert found["fixed"].sum() > 0.2 * runs


@pytest.mark.parametrize("seed", range(6))
def test_more_inputs_than_a_few_units_need_have_a_bound(seed: int) -> None:
    """Twenty inputs, two states: the least miss is nearly 0, and a part of the units gives it."""
    fleet, x0 = near_one(np.random.default_rng(seed), 100)
    plan = se.control_fleet(fleet, x0, np.zeros(2), 20, risk="worst")
    assert plan.status == "optimal"
    assert np.array_equal(plan.u.ravel(), alone(plan))
    assert plan.certify(BETA).epsilon < 0.75
    fresh, _ = near_one(np.random.default_rng(seed), 3000)  # begins with the same system
    assert np.mean(plan.validate(fresh, BETA).misses > plan.threshold) <= plan.certify(BETA).epsilon


def test_fleets_of_equal_units_rest_on_one() -> None:
    plan = se.control_fleet(gains(*[1.5] * 50), [0.0], [1.0], 1, risk="worst")
    assert plan.support == (0,)
    assert plan.certify(BETA).epsilon == se.theory.scenario.compression(50, 1, BETA)
    one = se.control_fleet(gains(1.5), [0.0], [1.0], 1, risk="worst")
    assert (one.support, one.certify(BETA).epsilon) == ((0,), 1.0)
    # no input moves a unit: the command is 0, whatever the units are
    idle = se.control_fleet(gains(*[0.0] * 50), [0.0], [1.0], 1, risk="worst")
    assert idle.support == ()
    assert idle.certify(BETA).epsilon == pytest.approx(1 - (BETA / 50) ** (1 / 50))


def test_the_weight_is_that_of_the_support_also_after_its_unit_was_left_out() -> None:
    """The unit of the largest map misses most and is left out."""
    gen = np.random.default_rng(3)
    B = gen.uniform(0.9, 1.1, (40, 1, 1))
    B[7] = 10.0
    plan = se.control_fleet(se.SystemEnsemble(0 * B, B), [0.0], [1.0], 1, risk="worst", discard=1)
    assert plan.removed == (7,)
    assert plan.widest == int(np.argmax(np.where(B[:, 0, 0] < 2, B[:, 0, 0], 0.0)))
    assert plan.widest in plan.support
    assert np.array_equal(plan.u.ravel(), alone(plan))
    assert plan.certify(BETA).epsilon == se.theory.scenario.compression(
        40, len(plan.support), BETA, violations=1
    )


def test_the_units_of_the_design_are_not_fresh() -> None:
    gen = np.random.default_rng(1)
    fleet = drawn(gen, 20, 2, 1, offsets=True)
    order = gen.permutation(20)
    other = se.SystemEnsemble(fleet.A[order], fleet.B[order], fleet.c[order])
    plan = se.control_fleet(fleet, [0.5, 0.0], [0.0, 0.0], 2, risk="worst")
    for x0 in (None, [0.5, 0.0], [[0.5, 0.0]] * 20):
        for units in (fleet, other):
            with pytest.raises(InputError, match="must be fresh"):
                plan.validate(units, BETA, x0=x0)
    fresh = drawn(gen, 40, 2, 1, offsets=True)
    one = 1.0 + 2e-16 * gen.standard_normal(59)[:, None, None]  # as after a file or another unit
    some = se.SystemEnsemble(
        one * np.concatenate([fleet.A[order[:19]], fresh.A]),
        np.concatenate([fleet.B[order[:19]], fresh.B]),
        np.concatenate([fleet.c[order[:19]], fresh.c]),
    )
    with pytest.raises(InputError, match=r"must be fresh, 19 of 59 are of the design"):
        plan.validate(some, BETA)
    assert plan.validate(fresh, BETA).size == 40
    # of a law with equal units, a fresh one may be equal to one of the design
    coins = se.control_fleet(gains(1.0, 2.0, 2.0), [0.0], [1.0], 1, risk="worst")
    assert coins.validate(gains(1.0, 2.0, 1.0, 1.0), BETA).size == 4
    # the same machines from elsewhere, and others from there, are other units
    assert plan.validate(fleet, BETA, x0=[0.4, 0.0]).size == 20
    assert plan.validate(drawn(gen, 20, 2, 1), BETA, x0=[0.5, 0.0]).size == 20
    starts = gen.standard_normal((20, 2))
    own = se.control_fleet(fleet, starts, [0.0, 0.0], 2, risk="worst")
    with pytest.raises(InputError, match="must be fresh"):
        own.validate(other, BETA, x0=starts[order])
    assert own.validate(other, BETA, x0=starts).size == 20
