"""How often the risk of a fleet exceeds its bounds, and what breaks them."""

from __future__ import annotations

import numpy as np

import stochens_rs as se
from coverage_study import at_most, failures, repeated, sets
from stochens_rs.theory import scenario

FLEETS, BETA = sets(2000, 40), 0.05


def test_bounds_of_small_fleets_hold() -> None:
    """n = 2, m = 2, K = 1, N = 60, limits: d = 4; the risk is estimated by 3000 fresh units."""
    N, fresh = 60, 3000

    def case(gen):
        A, B = gen.standard_normal((2, 2, 2))
        As = A + 0.3 * gen.standard_normal((N + fresh + N, 2, 2))
        Bs = B + 0.3 * gen.standard_normal((N + fresh + N, 2, 2))
        units = se.SystemEnsemble(As[:N], Bs[:N])
        plan = se.control_fleet(units, [1.0, -1.0], [0.0, 0.0], 1, limits=(-2, 2), risk="worst")
        others = se.SystemEnsemble(As[N:-N], Bs[N:-N])
        risk = plan.validate(others, BETA).count / fresh
        compressed = plan.certify(BETA)
        bounds = {
            "a_priori": plan.certify(BETA, method="a priori").epsilon,
            "compression": compressed.epsilon,
        }
        shares = {name: risk / epsilon for name, epsilon in bounds.items()}
        # for a threshold that was fixed beforehand
        level = 0.8 * plan.threshold
        held = plan.validate(se.SystemEnsemble(As[-N:], Bs[-N:]), BETA, threshold=level)
        above = plan.validate(others, BETA, threshold=level).count / fresh
        return {**shares, "hold_out": above / held.epsilon, "support": compressed.count}

    found = repeated(case, FLEETS, 7)
    for name in ("a_priori", "compression", "hold_out"):
        at_most((found[name] > 1.0).sum(), FLEETS, BETA)
    # the bounds are no trivial ones, and supports are mostly those
    # of two inputs, the value, and the unit that the weight was taken from
    assert np.count_nonzero(found["support"] > 4) <= max(1, FLEETS // 100)
    assert found["a_priori"].max() > 0.6
    assert found["hold_out"].max() > 0.9


def test_replicates_of_one_plant_are_no_units() -> None:
    """Resampled means of 4 measured gains never leave their range; the true gain does in 1 of 8."""
    N, plants = 300, 400

    def failed(gen):
        measured = 1.0 + 0.3 * gen.standard_normal(4)
        replicates = measured[gen.integers(0, 4, (N, 4))].mean(axis=1)[:, None, None]
        fleet = se.SystemEnsemble(0.0 * replicates, replicates)  # declared as units, falsely
        plan = se.control_fleet(fleet, [0.0], [1.0], 1, risk="worst")
        return abs(plan.u[0, 0] - 1.0) > plan.threshold

    epsilon = scenario.a_priori(N, 2, 1e-3)
    assert epsilon < 0.04
    assert failures(failed, plants, 9) / plants > 2 * epsilon
