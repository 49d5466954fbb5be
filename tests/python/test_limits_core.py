"""Controls within limits, as the core gives them: an independent solver, starts, errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from stochens_rs import _core as core

INF = np.inf


def problem(gen: np.random.Generator, rows: int, d: int) -> tuple[np.ndarray, ...]:
    M, y = gen.standard_normal((rows, d)), gen.standard_normal(rows)
    low = np.where(gen.random(d) < 0.2, -INF, -0.3 * gen.random(d))
    high = np.where(gen.random(d) < 0.2, INF, 0.3 * gen.random(d))
    return M, y, gen.random(d), low, high


def test_an_independent_solver_finds_the_same_control() -> None:
    gen = np.random.default_rng(0)
    for trial in range(100):
        M, y, r, low, high = problem(gen, 3 + trial % 20, 1 + trial % 13)
        found = core.box_control(M, y, r, low, high, None, None)
        d = len(r)
        theirs = lsq_linear(
            np.vstack([M, np.diag(np.sqrt(r))]), np.r_[y, np.zeros(d)], (low, high), method="bvls"
        ).x
        assert found.status == "optimal"
        assert found.control == pytest.approx(theirs, abs=1e-8)
        full = core.box_control(M, y, np.diag(r), low, high, found.active, None)
        assert full.control == pytest.approx(found.control, abs=1e-11)
        slope = 2 * (M.T @ (M @ found.control - y) + r * found.control)
        balanced = slope + found.active * found.multipliers
        assert np.abs(balanced).max() <= 1e-10
        assert found.multipliers.min() >= 0
        assert found.objective == pytest.approx(
            np.sum((M @ found.control - y) ** 2) + r @ found.control**2
        )


def test_the_distance_bounds_the_distance() -> None:
    """With no time at all the control is only a guess; its certificate is still true."""
    gen = np.random.default_rng(1)
    for _ in range(200):
        M, y, r, low, high = problem(gen, 12, 8)
        guess = core.box_control(M, y, r, low, high, None, 0.0)
        best = core.box_control(M, y, r, low, high, None, None)
        off = guess.control - best.control
        distance = np.sqrt(np.sum((M @ off) ** 2) + r @ off**2)
        assert distance <= guess.distance * (1 + 1e-9) + 1e-12
        assert guess.objective - best.objective <= guess.gap * (1 + 1e-9) + 1e-12
        assert guess.status in ("optimal", "user_limit")
