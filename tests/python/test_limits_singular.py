"""Controls within limits without a weight of the inputs, where many controls are equally good."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from stochens_rs import _core

KINDS = ("none", "low", "high", "some", "both")


def drawn_sides(gen, d, kind):
    """Limits of d inputs: below, above, on some sides of some inputs, on both."""
    low, high = np.full(d, -np.inf), np.full(d, np.inf)
    size = 10.0 ** gen.uniform(-2.0, 2.0)
    below = {"low": 1.0, "both": 1.0, "some": 0.5}.get(kind, 0.0)
    above = {"high": 1.0, "both": 1.0, "some": 0.5}.get(kind, 0.0)
    chosen = gen.random(d) < below
    low[chosen] = size * gen.uniform(-1.0, 0.2, chosen.sum())
    chosen = gen.random(d) < above
    high[chosen] = size * gen.uniform(0.2, 1.0, chosen.sum())
    return low, high


def conic(M, y, low, high):
    """An upper bound of the least ``||M u - y||^2``, close to it: by Clarabel, then clipped."""
    clarabel = pytest.importorskip("clarabel")
    (rows, d), size, unit = M.shape, np.abs(M).max(), np.linalg.norm(y)
    M, y = M / size, y / unit
    low, high = low * size / unit, high * size / unit
    up, down = np.isfinite(high), np.isfinite(low)
    one, zero = np.eye(d), np.zeros
    # M u - w = y, u <= high, -u <= -low, the least w'w
    A = np.vstack([
        np.hstack([M, -np.eye(rows)]),
        np.hstack([one[up], zero((up.sum(), rows))]),
        np.hstack([-one[down], zero((down.sum(), rows))]),
    ])  # fmt: skip
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    found = clarabel.DefaultSolver(
        sparse.csc_matrix(np.diag(np.r_[zero(d), 2.0 * np.ones(rows)])),
        zero(d + rows),
        sparse.csc_matrix(A),
        np.r_[y, high[up], -low[down]],
        [clarabel.ZeroConeT(rows), clarabel.NonnegativeConeT(int(up.sum() + down.sum()))],
        settings,
    ).solve()
    u = np.clip(np.array(found.x[:d]), low, high)
    return unit**2 * float(np.sum((M @ u - y) ** 2))


@pytest.mark.parametrize("kind", KINDS)
def test_least_squares_of_any_rank(gen, kind) -> None:
    for k in range(60):
        d, rows = int(gen.integers(2, 25)), int(gen.integers(1, 27))
        rank = int(gen.integers(1, min(d, rows) + 1))
        M = gen.standard_normal((rows, rank)) @ gen.standard_normal((rank, d))
        if k % 3 == 0:
            M = M * 10.0 ** gen.uniform(-1.0, 1.0, d)
        M = np.ascontiguousarray(M * 10.0 ** gen.uniform(-3.0, 3.0))
        y = gen.standard_normal(rows) * 10.0 ** gen.uniform(-2.0, 2.0)
        low, high = drawn_sides(gen, d, kind)
        found = _core.box_control(M, y, np.zeros(d), low, high, None, None)
        u, scale = found.control, float(y @ y) + found.objective
        assert np.all((u >= low) & (u <= high))
        assert found.objective == pytest.approx(float(np.sum((M @ u - y) ** 2)), abs=1e-12 * scale)
        best = conic(M, y, low, high)
        assert found.status == "optimal", (k, found.gap / scale)
        assert found.gap <= 1e-9 * scale
        assert found.objective <= best + 1e-9 * scale
        assert found.objective - found.gap <= best + 1e-10 * scale


def test_the_gap_of_a_control_that_is_not_the_best_is_finite_and_true(gen) -> None:
    """After a time limit: the first point that was judged."""
    for _ in range(30):
        d, rank = 12, 4
        M = gen.standard_normal((20, rank)) @ gen.standard_normal((rank, d))
        y, low = gen.standard_normal(20), -0.1 * gen.random(d)
        none = np.full(d, np.inf)
        found = _core.box_control(np.ascontiguousarray(M), y, np.zeros(d), low, none, None, 1e-12)
        best = conic(M, y, low, none)
        assert found.objective - found.gap <= best + 1e-12 * float(y @ y)
