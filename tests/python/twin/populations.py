"""One command for many units: x_s = G_s u + (what u does not change), each with its own target.

A unit is (M, t) with miss ||M u - t||: M = G_s, t = b_s, and below them the rows of R. `worst` is
the largest miss of the command that makes it least.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .laws import scipy
from .limited_problems import limits, root

Array = NDArray[np.float64]
Unit = tuple[Array, Array]


def unit(G: Array, b: Array, R: Array) -> Unit:
    """G and b, with R^(1/2) and 0 below."""
    return np.vstack([G, root(R)]), np.concatenate([b, np.zeros(G.shape[1])])


def misses(units: Sequence[Unit], u: Array) -> Array:
    """||M_s u - t_s||, (N,)."""
    return np.array([np.linalg.norm(M @ u - t) for M, t in units])


def program(units: Sequence[Unit], C: Array, c: Array) -> tuple[Array, float]:
    """min z over C u <= c and ||M_s u - t_s|| <= z, N cones: u and z, by Clarabel."""
    import clarabel  # type: ignore[import-untyped]

    sparse = scipy().sparse
    d = C.shape[1]
    top = np.concatenate([np.zeros(d), [-1.0]])
    rows = [np.hstack([C, np.zeros((len(C), 1))])]
    rows += [np.vstack([top, np.hstack([-M, np.zeros((len(M), 1))])]) for M, _ in units]
    ends = [c, *[np.concatenate([[0.0], -t]) for _, t in units]]
    cones = [clarabel.NonnegativeConeT(len(C))]
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
    return np.array(found.x[:d]), float(found.x[d])


def worst(units: Sequence[Unit], low: ArrayLike = -np.inf, high: ArrayLike = np.inf) -> float:
    """The least of the largest misses over the limits, by an input that is within them."""
    d = units[0][0].shape[1]
    low, high = limits(low, high, (d,))
    up, down = np.isfinite(high), np.isfinite(low)
    C, c = np.vstack([np.eye(d)[up], -np.eye(d)[down]]), np.concatenate([high[up], -low[down]])
    return float(np.max(misses(units, np.clip(program(units, C, c)[0], low, high))))
