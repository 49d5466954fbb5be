"""Many steps of unstable systems: what is called optimal is, by arithmetic of 120 digits."""

from __future__ import annotations

from dataclasses import replace
from decimal import Decimal as D
from decimal import localcontext

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.limits.problem import OPTIMAL

CART = se.System.from_any(
    (
        [[0, 0, 1, 0], [0, 0, 0, 1], [0, -1.96, -0.5, 0], [0, 11.77, 0.5, 0]],
        [[0], [0], [1.0], [-1.0]],
        0,
    ),
    dt=0.05,
)
COST, ONES = se.Cost(Q=1.0, R=0.1), se.Cost(Q=1.0, R=1.0)


def exact(array):
    return np.vectorize(D, otypes=[object])(np.asarray(array, dtype=float))


def followed(A, B, x0, R, plan, limit):
    """J of the plan, with its feedback, and of its inputs alone; Q = I."""
    A, B, x0, u = exact(A), exact(B), exact(x0), exact(plan.u)
    gains = None if plan.limited.feedback is None else exact(plan.limited.feedback)
    costs, wanted = [], exact(plan.predicted_states)
    for K in (gains, None):
        x, J = x0, D(0)
        for k in range(len(u)):
            now = u[k]
            if K is not None:
                now = now + K[k] @ (x - wanted[k])
                now = np.array([min(max(v, -D(limit)), D(limit)) for v in now])
            x = A @ x + B @ now
            J += x @ x + D(R) * (now @ now)
        costs.append(J)
    return costs


def least(A, B, x0, R, steps, held):
    """The least J of one input, `held` (step: value) aside, by Riccati's recursion; Q = I."""
    n = len(A)
    A, b, x0 = exact(A), exact(B)[:, 0], exact(x0)
    P, s, c = exact(np.eye(n)), exact(np.zeros(n)), D(0)
    for k in reversed(range(steps)):
        if k in held:
            v = D(float(held[k]))
            c = c + v * v * (b @ P @ b) + 2 * v * (s @ b) + D(R) * v * v
            s, P = A.T @ (P @ b * v + s), A.T @ P @ A
        else:
            G, g, h = D(R) + b @ P @ b, A.T @ (P @ b), s @ b
            s, P, c = A.T @ s - g * h / G, A.T @ P @ A - np.outer(g, g) / G, c - h * h / G
        if k:
            P = P + exact(np.eye(n))
    return x0 @ P @ x0 + 2 * (s @ x0) + c


def drawn(seed):
    """A system of 1 to 3 states that grows by 1e2 to 1e40 over its steps, and a start."""
    rng = np.random.default_rng(seed)
    n, steps, grown = int(rng.integers(1, 4)), int(rng.integers(25, 90)), rng.uniform(2.0, 40.0)
    A = rng.standard_normal((n, n))
    A *= 10.0 ** (grown / steps) / np.abs(np.linalg.eigvals(A)).max()
    return A, rng.standard_normal((n, 1)), rng.standard_normal(n), steps, 10.0 ** rng.uniform(-4, 1)


@pytest.mark.parametrize("seed", range(24))
def test_no_plan_is_called_optimal_that_costs_more(seed):
    A, B, x0, steps, R = drawn(seed)
    cost = se.Cost(Q=1.0, R=R)
    free = se.control((A, B), x0, 0 * x0, steps=steps, cost=cost)
    for share in (np.inf, 0.97):
        limit = 1e6 if share == np.inf else share * float(np.abs(free.u).max())
        plan = se.control((A, B), x0, 0 * x0, steps=steps, cost=cost, limits=(-limit, limit))
        with localcontext() as context:
            context.prec = 120
            J, alone = followed(A, B, x0, R, plan, limit)
            at = {k: plan.u[k, 0] for k in np.flatnonzero(plan.limited.active[:, 0])}
            # limits that are held and should not be only make this larger
            excess = float(J - least(A, B, x0, R, steps, at))
        assert plan.status == "optimal"
        assert excess <= plan.limited.gap * (1 + 1e-6) + 1e-60 <= OPTIMAL * plan.limited.objective
        assert float(J) == pytest.approx(plan.limited.objective, rel=1e-12)
        assert (plan.limited.multipliers >= 0).all()
        if plan.limited.open_until is None:
            assert float(alone) == pytest.approx(plan.limited.objective, rel=1e-9)
            assert plan.limited.feedback is None
        else:
            assert float(alone) == pytest.approx(plan.limited.open_objective, rel=1e-4)
            follow = f"follow with `limited.feedback` from step {plan.limited.open_until} on"
            assert follow in repr(plan)


@pytest.mark.parametrize(
    ("A", "B", "x0", "steps", "limit", "J", "first"),
    [
        ([[2.0]], [[1.0]], [0.5], 30, 10.0, 0.0932, -0.932),
        (CART.A, CART.B, [0.1, 0.05, 0, 0], 150, 10.0, 3.95, 2.6),
        ([[1.2, 1.0], [0.0, 1.1]], [[0.0], [1.0]], [0.01, 0.0], 400, 1.0, 2.94218e-4, None),
    ],
)
def test_public_cases(A, B, x0, steps, limit, J, first):
    plan = se.control((A, B), x0, 0 * np.array(x0), steps=steps, limits=(-limit, limit), cost=COST)
    assert plan.status == "optimal"
    assert plan.limited.objective == pytest.approx(J, rel=1e-3)
    assert not plan.warnings  # the rank of C_K is that of C_n, whatever is left of it in doubles
    least, v = conic(np.array(A), np.array(B), np.array(x0), steps, u=limit)
    assert plan.limited.objective == pytest.approx(least, rel=1e-6)
    np.testing.assert_allclose(plan.u[0], v[0], rtol=1e-3)
    cost = replace(COST, Qf=COST.Q)
    loop = se.regulate((A, B), steps, limits=(-limit, limit), cost=cost)
    u = loop(x0)
    assert loop.log[-1].status == "optimal"
    np.testing.assert_allclose(u, plan.u[0], rtol=1e-9)
    if first is not None:
        assert u[0] == pytest.approx(first, rel=1e-2)


@pytest.mark.parametrize("steps", [32, 35])
def test_inputs_that_stop_just_short_of_their_limits(steps):
    """Eight states, nearly all inputs at a limit, slopes up to 1e6: it ended with gap = J."""
    rng = np.random.RandomState(7)
    A, B, x0 = np.eye(8) + 0.2 * rng.randn(8, 8), rng.randn(8, 2), 5.0 * rng.randn(8)
    plan = se.control((A, B), x0, np.zeros(8), steps=steps, limits=(-1, 1), cost=ONES)
    assert plan.status == "optimal"
    assert plan.limited.gap <= 1e-11 * plan.limited.objective


def conic(A, B, x0, steps, **sides):
    """The least J over inputs and states by Clarabel: x and u to some 1e-8."""
    import clarabel
    from scipy import sparse

    n, m = B.shape
    d, N = steps * m, steps * (n + m)
    P = sparse.diags([0.2] * d + [2.0] * (steps * n))
    rows = sparse.lil_matrix((steps * n, N))
    right = np.zeros(steps * n)
    for k in range(steps):
        at = slice(k * n, (k + 1) * n)
        rows[at, d + k * n : d + (k + 1) * n] = np.eye(n)
        rows[at, k * m : (k + 1) * m] = -B
        if k:
            rows[at, d + (k - 1) * n : d + k * n] = -A
        else:
            right[at] = A @ x0
    E, one = rows.tocsc(), sparse.identity(N, format="csc")
    more, limits = [one[:d], -one[:d]], [np.full(d, sides["u"])] * 2
    if "rate" in sides:
        change = sparse.eye(d) - sparse.eye(d, k=-m)
        change = sparse.hstack([change, sparse.csc_matrix((d, steps * n))])
        more, limits = [*more, change, -change], [*limits, *[np.full(d, sides["rate"])] * 2]
    if "x" in sides:
        more, limits = [*more, one[d:], -one[d:]], [*limits, *[np.tile(sides["x"], steps)] * 2]
    C, c = sparse.vstack([E, *more]).tocsc(), np.concatenate([right, *limits])
    keep = np.isfinite(c)
    C, c = C[keep], c[keep]
    cones = [clarabel.ZeroConeT(len(right)), clarabel.NonnegativeConeT(len(c) - len(right))]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    found = clarabel.DefaultSolver(P.tocsc(), np.zeros(N), C, c, cones, settings).solve()
    return found.obj_val, np.array(found.x[:d]).reshape(-1, m)
