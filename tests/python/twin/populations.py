"""One command for many units: x_s = G_s u + (what u does not change), each with its own target.

A unit is (M, t) with miss ||M u - t||: M = Q^(1/2) G_s, t = Q^(1/2) b_s, and below them the rows of
R if inputs are weighed. `worst` minimizes the largest miss; its
command is unique if every M has full column rank, which weighed inputs make true.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .laws import scipy
from .limited_problems import limits, matrix, root

Array = NDArray[np.float64]
Unit = tuple[Array, Array]


class Worst(NamedTuple):
    """min_u max_s miss_s(u) over the limits."""

    u: Array
    value: float  # largest miss at u, over all units
    lower_bound: float  # by the dual, recomputed
    shares: Array  # (N,), the dual's weight of each unit, sum 1


def unit(
    G: ArrayLike, b: ArrayLike, *, Q: ArrayLike | None = None, R: ArrayLike | None = None
) -> Unit:
    """Q^(1/2) G and Q^(1/2) b, with R^(1/2) and 0 below if R is given."""
    G, b = np.asarray(G, dtype=np.float64), np.asarray(b, dtype=np.float64)
    half = root(matrix(Q, len(b), 1.0))
    if R is None:
        return half @ G, half @ b
    d = G.shape[1]
    return np.vstack([half @ G, root(matrix(R, d))]), np.concatenate([half @ b, np.zeros(d)])


def misses(units: Sequence[Unit], u: Array) -> Array:
    """||M_s u - t_s||, (N,)."""
    return np.array([np.linalg.norm(M @ u - t) for M, t in units])


def worst(units: Sequence[Unit], low: ArrayLike = -np.inf, high: ArrayLike = np.inf) -> Worst:
    """min z subject to ||M_s u - t_s|| <= z for all units at once: N cones, by Clarabel."""
    import clarabel  # type: ignore[import-untyped]

    sparse = scipy().sparse
    d = units[0][0].shape[1]
    low, high = limits(low, high, (d,))
    up, down = np.isfinite(high), np.isfinite(low)
    one = np.hstack([np.eye(d), np.zeros((d, 1))])
    top = np.concatenate([np.zeros(d), [-1.0]])
    rows = [one[up], -one[down]]
    rows += [np.vstack([top, np.hstack([-M, np.zeros((len(M), 1))])]) for M, _ in units]
    ends = [high[up], -low[down], *[np.concatenate([[0.0], -t]) for _, t in units]]
    cones = [clarabel.NonnegativeConeT(int(up.sum() + down.sum()))]
    cones += [clarabel.SecondOrderConeT(len(t) + 1) for _, t in units]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    found = clarabel.DefaultSolver(
        sparse.csc_matrix((d + 1, d + 1)),
        -top,
        sparse.csc_matrix(np.vstack(rows)),
        np.concatenate(ends),
        cones,
        settings,
    ).solve()
    u = np.clip(np.array(found.x[:d]), low, high)
    blocks = np.split(np.array(found.z), np.cumsum([len(x) for x in ends])[1:-1])[1:]
    vectors = [-block[1:] for block in blocks]
    shares = np.array([block[0] for block in blocks])
    lower = dual_value(units, vectors, low, high)
    return Worst(u, float(np.max(misses(units, u))), lower, shares / np.sum(shares))


def dual_value(units: Sequence[Unit], vectors: Sequence[Array], low: Array, high: Array) -> float:
    """A lower bound of max_s miss_s over the limits, from any vectors v_s: no solver is believed.

    With sum ||v_s|| <= 1, max_s ||M_s u - t_s|| >= sum v_s' (M_s u - t_s), at least
    -sum v_s' t_s + sum_i min(g_i low_i, g_i high_i), g = sum M_s' v_s; where g_i points to an
    infinite limit it must be 0, so the vectors are projected on that first.
    """
    M, t = np.vstack([M for M, _ in units]), np.concatenate([t for _, t in units])
    ends = np.cumsum([len(t) for _, t in units])[:-1]
    v = np.concatenate(list(vectors))
    free = np.zeros(len(low), dtype=bool)
    for _ in low:
        g = M.T @ v
        free |= (g >= 0.0) & np.isinf(low) | (g <= 0.0) & np.isinf(high)
        v = v - M[:, free] @ np.linalg.lstsq(M[:, free], v, rcond=None)[0]
    v = v / max(1e-300, sum(np.linalg.norm(x) for x in np.split(v, ends)))
    g = np.where(free, 0.0, M.T @ v)
    box = [x * (a if x > 0.0 else b) for x, a, b in zip(g, low, high, strict=True) if x != 0.0]
    return float(max(sum(box) - v @ t, 0.0))
