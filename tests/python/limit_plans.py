"""Random control problems within limits, and what is asked of a plan for one."""

from __future__ import annotations

import numpy as np

import stochens_rs as se
from limit_problems import draw_box, draw_map, weight
from twin import limited_control as lc
from twin import limited_problems as lp

LIMITS = {
    "limits": "u",
    "rate": "rate",
    "previous": "previous",
    "state_limits": "x",
    "soft": "soft",
}


def within(**given):
    """The arguments of `control`, from limits and weights that have a name each."""
    limits = {to: given.pop(name) for name, to in LIMITS.items() if name in given}
    cost = {name: given.pop(name) for name in ("Q", "Qf", "R", "reference") if name in given}
    if limits:
        given["limits"] = limits["u"] if list(limits) == ["u"] else se.Limits(**limits)
    return given | ({"cost": se.Cost(**cost)} if cost else {})


def exactly(a, b):
    np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


def at_a_limit(plan):
    """Whether an input is at a limit or changes by its rate, or a state is at a limit."""
    limited = plan.limited
    sides = limited.active, limited.rate_active, limited.state_active
    return any(bool(one.any()) for one in sides if one is not None)


WAYS = ("half", "tight", "one-sided", "fixed inputs", "loose")


def draw_case(gen, i, steps=(1, 2, 3, 5, 20)):
    """A system, and the arguments of `control` and of the twin."""
    n, m, K = int(gen.integers(1, 5)), int(gen.integers(1, 4)), steps[i % len(steps)]
    A = gen.normal(size=(n, n))
    A *= gen.uniform(0.5, 1.05) / max(1e-3, np.max(np.abs(np.linalg.eigvals(A))))
    B = draw_map(gen, ("plain", "sparse", "zero columns", "ill-conditioned")[i % 4], n, m)
    low, high = draw_box(gen, WAYS[i % 5], K * m if i % 2 else m, 1.0)
    if i % 2:
        low, high = low.reshape(K, m), high.reshape(K, m)
    weights = {
        "Q": None if i % 3 == 0 else weight(gen, n) if i % 3 == 1 else gen.uniform(0, 2, size=n),
        "Qf": weight(gen, n) + 0.1 * np.eye(n) if i % 4 else None,
        "R": np.diag(gen.uniform(0.5, 2, m)) + 0.3 if i % 2 else 10.0 ** gen.uniform(-3, 0),
    }
    return A, B, 3.0 * gen.normal(size=n), K, low, high, weights


def check(plan, p, tolerance=1e-8):
    """The plan is as good as the twin's answer, and what it says of itself is true."""
    best, size = lc.solve(p), np.sqrt(lp.objective(p, np.zeros(len(p.low)))) + 1e-6
    u, shape = plan.u.ravel(), plan.u.shape
    assert plan.status == "optimal"
    assert np.all(u >= p.low)
    assert np.all(u <= p.high)
    assert lp.norm(u - best.u, p.H) <= tolerance * size
    assert lp.norm(u - best.u, p.H) <= plan.limited.distance + best.distance + 1e-13 * size
    J = lp.objective(p, u)
    np.testing.assert_allclose(plan.limited.objective, J, rtol=1e-9, atol=1e-12 * size**2)
    assert best.objective >= J - plan.limited.gap - 1e-12 * size**2
    np.testing.assert_allclose(plan.limited.missed, best.missed, rtol=1e-6, atol=1e-9 * size**2)
    fixed = p.low == p.high
    side = np.where(u >= p.high, 1, np.where(u <= p.low, -1, 0))
    assert np.array_equal(plan.limited.active.ravel()[~fixed], side[~fixed])
    assert plan.limited.multipliers.shape == plan.limited.active.shape == shape
    return best
