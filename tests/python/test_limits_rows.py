"""Controls with limits on rates and states through `control`: known answers, and the twin."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import most, sets
from limit_plans import at_a_limit, within
from stochens_rs.limits.problem import loop_of


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_active_rates_are_those_with_multipliers(gen, scale):
    """30 systems, one input in 3 steps or two in 12; the core's multipliers say the same."""
    seen = 0
    for i in range(30):
        m, K = (1, 3) if i % 2 else (2, 12)
        A, B = 0.5 * gen.normal(size=(3, 3)), gen.normal(size=(3, m))
        how = {"rate": 0.2 * scale, "previous": 0.0, "Q": 1.0, "R": 1.0, "steps": K}
        x0 = scale * gen.normal(size=3)
        plan = se.control((A, B), x0, [0.0] * 3, **within(**how))
        loop = loop_of(plan.limited.task, A, B, None)
        loop.solve(x0, None)
        assert np.array_equal(plan.limited.rate_active.ravel(), loop.warm()[m * K :])
        assert at_a_limit(plan) == plan.limited.rate_active.any()
        seen += np.count_nonzero(plan.limited.rate_active)
    assert seen > 30


@pytest.mark.parametrize("highest", [0.8, 0.7])
def test_the_true_system_keeps_hard_limits_of_a_plan_from_data(highest):
    """At delta = 0.05 at most 5 % may leave the limits (false alarm 1e-4); 0 did."""
    A, B = np.array([[1.0, 0.1], [-0.2, 0.95]]), np.array([[0.0], [0.1]])
    left, found, without, count = 0, 0, 0, sets(100, 25)
    for seed in range(count):
        gen = np.random.default_rng(seed)
        z = gen.standard_normal((40, 3))
        y = z @ np.hstack([A, B]).T + 0.02 * gen.standard_normal((40, 2))
        data = se.Trajectories.from_pairs(z[:, :2], z[:, 2:], y)
        model = se.identify(data, checks=False, noise=se.Noise(design="independent"))
        sides = [-np.inf, -highest], [np.inf, highest]
        asked = {"steps": 8, "limits": (-6.0, 6.0), "state_limits": sides, "soft": False}
        plan = se.control(model, [1.0, 0.0], [0.0, 0.0], **within(**asked))
        if plan.status == "infeasible":
            assert plan.limited.missing > 1e-6
            continue
        room = plan.bound()["bands"].radius[1:, 1].min()
        assert np.abs(plan.predicted_states[1:, 1]).max() <= highest - room
        found += 1
        left += bool(np.abs(plan.states((A, B), [1.0, 0.0])[1:, 1]).max() > highest)
        # without a margin the limits are left about every second time
        naive = se.control((model.A, model.B), [1.0, 0.0], [0.0, 0.0], **within(**asked))
        without += bool(np.abs(naive.states((A, B), [1.0, 0.0])[1:, 1]).max() > highest)
    assert found >= 0.9 * count
    assert left <= most(count, 0.05)
    assert without >= 0.25 * count
