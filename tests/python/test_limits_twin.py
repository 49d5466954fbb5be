"""Least squares over limits in plain NumPy, against enumeration and an interior point."""

from __future__ import annotations

import numpy as np
import pytest

from limit_problems import draw_steps, draws
from twin import limited_control as lc
from twin import limited_problems as lp

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
