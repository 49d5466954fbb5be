"""How often the risk of a fleet exceeds its bounds, and what breaks them."""

from __future__ import annotations

import numpy as np

import stochens_rs as se
from stochens_rs.theory import scenario

FLEETS, BETA = 2000, 0.05
# 5 % of 2000 are expected at most; this many or more have a probability below 1e-5
MOST = 100 + 45


def test_bounds_of_small_fleets_hold() -> None:
    """n = 2, m = 2, K = 1, N = 60, limits: d = 3; the risk is estimated by 3000 fresh units."""
    gen = np.random.default_rng(7)
    N, fresh = 60, 3000
    exceeded = dict.fromkeys(("a priori", "compression", "judged", "hold-out"), 0)
    counts = np.zeros(N + 1, dtype=int)
    for _ in range(FLEETS):
        A, B = gen.standard_normal((2, 2, 2))
        As = A + 0.3 * gen.standard_normal((N + fresh + N, 2, 2))
        Bs = B + 0.3 * gen.standard_normal((N + fresh + N, 2, 2))
        units = se.SystemEnsemble(As[:N], Bs[:N])
        plan = se.control_fleet(units, [1.0, -1.0], [0.0, 0.0], 1, limits=(-2, 2), risk="worst")
        others = se.SystemEnsemble(As[N:-N], Bs[N:-N])
        risk = plan.validate(others, BETA).count / fresh
        compressed = plan.certify(BETA)
        counts[compressed.count] += 1
        bounds = {
            "a priori": plan.certify(BETA, method="a priori").epsilon,
            "compression": compressed.epsilon,
            "judged": scenario.judged(N, compressed.count, BETA),
        }
        for name, epsilon in bounds.items():
            exceeded[name] += risk > epsilon
        # for a threshold that was fixed beforehand
        level = 0.8 * plan.threshold
        held = plan.validate(se.SystemEnsemble(As[-N:], Bs[-N:]), BETA, threshold=level)
        above = plan.validate(others, BETA, threshold=level).count / fresh
        exceeded["hold-out"] += above > held.epsilon
    assert max(exceeded.values()) < MOST, exceeded
    # unverified supports are rare, and the bounds are no trivial ones
    assert counts[4:].sum() <= FLEETS // 100, np.flatnonzero(counts)
    assert exceeded["a priori"] > 0
    assert exceeded["hold-out"] > 0


def test_replicates_of_one_plant_are_no_units() -> None:
    """Resampled means of 4 measured gains never leave their range; the true gain does in 1 of 8."""
    gen = np.random.default_rng(9)
    N, plants, failed = 300, 400, 0
    for _ in range(plants):
        measured = 1.0 + 0.3 * gen.standard_normal(4)
        replicates = measured[gen.integers(0, 4, (N, 4))].mean(axis=1)[:, None, None]
        fleet = se.SystemEnsemble(0.0 * replicates, replicates)  # declared as units, falsely
        plan = se.control_fleet(fleet, [0.0], [1.0], 1, risk="worst")
        failed += abs(plan.u[0, 0] - 1.0) > plan.threshold
    epsilon = scenario.a_priori(N, 2, 1e-3)
    assert epsilon < 0.04
    assert failed / plants > 2 * epsilon
