"""Least squares over limits in plain NumPy, against enumeration and an interior point."""

from __future__ import annotations

import numpy as np
import pytest

from limit_problems import draw_steps, draws
from twin import limited_control as lc
from twin import limited_problems as lp

# -- the stacked problem ---------------------------------------------------------------------------


def test_the_stacked_problem_is_the_sum_over_steps(gen):
    for i in range(40):
        F, X, x0, K, more = draw_steps(gen, i)
        n, m = X.shape
        wanted, r = gen.normal(size=m), gen.normal(size=(K, n))
        p = lp.several_steps(F, X, x0, r, K, wanted=wanted, **more)
        u, x = gen.normal(size=(K, m)), x0
        last, J = np.broadcast_to(more.get("previous", 0.0), m), 0.0
        for k in range(K):
            x = F @ x + X @ u[k]
            stage = np.zeros((n, n)) if more["Q"] is None else more["Q"]
            J += lp.norm(x - r[k], more["Qf"] if k == K - 1 else stage) ** 2
            J += more["R"] * np.sum((u[k] - wanted) ** 2)
            J += more.get("S", 0.0) * np.sum((u[k] - last) ** 2)
            last = u[k]
        np.testing.assert_allclose(lp.objective(p, u.ravel()), J, rtol=1e-11)
        C, c = lp.state_rows(F, X, x0, K, np.eye(n), np.ones(n))
        np.testing.assert_allclose((c - C @ u.ravel())[-n:], 1.0 - x, rtol=1e-9, atol=1e-10)
        if "rate" in more:
            changes = np.diff(np.vstack([more["previous"], u]), axis=0)
            inside = np.all(np.abs(changes) <= more["rate"])
            assert inside == np.all(p.C @ u.ravel() <= p.c)


# -- solvers ---------------------------------------------------------------------------------------


def test_least_distance_equals_enumeration(gen):
    """300 boxes of unlike kinds: the objective, the gap, and the signs of the multipliers."""
    for p in draws(gen, 300):
        s, u = lc.solve(p), lc.by_enumeration(p)
        zero = lp.objective(p, np.clip(np.zeros(len(u)), p.low, p.high))
        assert abs(s.objective - lp.objective(p, u)) <= 1e-12 * zero
        assert -1e-13 * zero <= s.gap <= 1e-8 * zero
        assert lp.norm(s.u - u, p.H) <= 1e-6 * np.sqrt(zero)
        assert np.all(s.u >= p.low)
        assert np.all(s.u <= p.high)
        free = p.low < p.high
        assert np.all((s.multipliers * s.active)[free] >= -1e-9 * np.sqrt(zero))
        assert s.missed >= -1e-10 * zero


def test_rows_and_rates_equal_an_interior_point(gen):
    """60 problems of several steps against Clarabel, with the multipliers as the certificate."""
    pytest.importorskip("clarabel")
    for i in range(60):
        F, X, x0, K, more = draw_steps(gen, i)
        p = lp.several_steps(F, X, x0, np.zeros(len(F)), K, **more)
        s = lc.solve(p)
        size = np.sqrt(lp.objective(p, np.zeros(len(s.u)))) + 1e-3
        assert s.distance <= 1e-6 * size
        assert np.all(p.C @ s.u <= p.c + 1e-12)
        other = lc.by_clarabel(p)  # to its own tolerances, also those of the limits
        assert lp.norm(other - s.u, p.H) <= 1e-3 * size
        assert abs(lp.objective(p, other) - s.objective) <= 1e-7 * size**2
        if len(p.c) and np.all(np.isfinite(p.low)):
            assert abs(lc.frank_wolfe_gap(p, s.u)) <= 1e-6 * size**2


def test_soft_rows_are_the_quadratic_penalty(gen):
    for p in draws(gen, 60):
        d, rho = len(p.low), 10.0 ** gen.uniform(-1, 3)
        C, c = gen.normal(size=(2, d)), 0.1 * gen.normal(size=2)
        u = lc.solve(lp.softened(p, C, c, rho)).u[:d]
        over = np.maximum(0.0, C @ u - c)
        g = lp.gradient(p, u) + 2.0 * rho * C.T @ over
        zero = lp.objective(p, 0.0 * u) + rho * np.sum(np.maximum(0.0, -c) ** 2) + 1e-6
        gap = lc.box_gap(g, u, p.low, p.high)
        if np.all(np.isfinite([p.low, p.high])):
            assert gap <= 1e-9 * zero
        inside = (u > p.low) & (u < p.high)
        assert np.all(np.abs(g[inside]) <= 1e-7 * (1.0 + rho) * np.sqrt(zero))
