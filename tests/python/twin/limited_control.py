"""Slow and certain solvers for least squares over limits, and how far a point is from the best.

Nothing here shares an algorithm with the core: enumeration, or least distance by NNLS. What a
solver says is not believed: the gap is recomputed from the data. D = ||u~ - u||_H is the distance
of a feasible u~ from the best u.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .laws import scipy
from .limited_problems import Problem, all_rows, gradient, limits, objective, residual_form

Array = NDArray[np.float64]


class Solution(NamedTuple):
    """The best u of a problem, and what it costs."""

    u: Array
    active: NDArray[np.int8]  # by value: 1 at `high` (also if fixed), -1 at `low`, 0 between
    multipliers: Array  # -J' - C' rows of the box: >= 0 at `high`, <= 0 at `low`, 0 between
    rows: Array  # (r,), >= 0, the multipliers of C u <= c
    objective: float
    gap: (
        float  # >= 2 D^2, recomputed: Frank-Wolfe's, or by multipliers with rows or infinite limits
    )
    distance: float  # >= D = ||u - best||_H, the smaller of both ways
    missed: float  # J(u) - min J without limits


def solve(p: Problem) -> Solution:
    """The best u, for H > 0: least distance by nonnegative least squares (Lawson, Hanson 1974).

    With M = Q1 T and z = T (u - v), v the best without limits, J = ||z||^2 + const over X z <= y.
    NNLS min_{w >= 0} ||(X' w, y' w + 1)|| gives z = -X' w / (1 + y' w); then the rows with w > 0
    are solved once more as equations.
    """
    M, target = residual_form(p)
    fixed = p.low == p.high
    u = np.where(fixed, p.low, 0.0)
    rows, ends = all_rows(p)
    weights = np.zeros(len(rows))
    t, y = target - M @ u, ends - rows @ u
    used = np.any(rows[:, ~fixed] != 0.0, axis=1)
    if np.any(y[~used] < -1e-12 * (1.0 + np.abs(ends[~used]))):
        raise ValueError("the fixed inputs break a limit: see `missing`")
    if not np.all(fixed):
        q, T = np.linalg.qr(M[:, ~fixed])
        if np.min(np.abs(np.diag(T))) <= 1e-14 * np.max(np.abs(T)):
            raise ValueError("H is singular")
        v = np.linalg.solve(T, q.T @ t)
        X = np.linalg.solve(T.T, rows[used][:, ~fixed].T).T
        w, z = _least_distance(X, y[used] - rows[used][:, ~fixed] @ v)
        u[~fixed] = v + np.linalg.solve(T, z)
        weights[used] = 2.0 * w
    up, down = int(np.sum(np.isfinite(p.high))), int(np.sum(np.isfinite(p.low)))
    at = [np.isfinite(p.high), np.isfinite(p.low)]
    u[at[0]] = np.where(weights[:up] > 0.0, p.high[at[0]], u[at[0]])
    u[at[1]] = np.where(weights[up : up + down] > 0.0, p.low[at[1]], u[at[1]])
    if not np.any(weights[up + down :]):  # the rest once more, as those are at their limits exactly
        rest = ~fixed
        rest[at[0]] &= weights[:up] == 0.0
        rest[at[1]] &= weights[up : up + down] == 0.0
        u[rest] = np.linalg.lstsq(M[:, rest], target - M[:, ~rest] @ u[~rest], rcond=None)[0]
    return finished(p, u, weights[up + down :])


def _least_distance(X: Array, y: Array) -> tuple[Array, Array]:
    """w >= 0 and z = -X' w, the shortest z with X z <= y."""
    size = np.linalg.norm(X, axis=1)
    X, y = X / size[:, None], y / size
    scale = float(np.max(-y, initial=0.0))
    if scale <= 0.0:
        return np.zeros(len(X)), np.zeros(X.shape[1])
    target = np.zeros(X.shape[1] + 1)
    target[-1] = -1.0
    w = scipy().optimize.nnls(np.vstack([X.T, y / scale]), target, maxiter=100 * len(X))[0]
    if 1.0 + y @ w / scale <= 1e-13:
        raise ValueError("no u keeps all limits: see `missing`")
    held = w > 0.0
    z = np.linalg.lstsq(X[held], y[held], rcond=1e-13)[0]
    w[held] = np.linalg.lstsq(-X[held].T, z, rcond=1e-13)[0]
    return np.maximum(w, 0.0) / size, z


def finished(p: Problem, u: Array, rows: Array) -> Solution:
    """All that is reported about u, from the data; values within rounding of a limit are at it."""
    for limit in (p.low, p.high):
        near = np.abs(u - limit) <= 1e-13 * (1.0 + np.abs(limit))
        u = np.where(np.isfinite(limit) & near, limit, u)
    u = np.clip(u, p.low, p.high)
    M, t = residual_form(p)
    free = float(np.sum((M @ np.linalg.lstsq(M, t, rcond=None)[0] - t) ** 2))
    active = np.where(u >= p.high, 1, np.where(u <= p.low, -1, 0)).astype(np.int8)
    box = np.where(active == 0, 0.0, -gradient(p, u) - p.C.T @ rows)
    J = objective(p, u)
    found = Solution(u, active, box, rows, J, 0.0, 0.0, J - free)
    D = multiplier_distance(p, u, row_multipliers(p, found))
    gap = np.inf if len(p.c) else frank_wolfe_gap(p, u)
    gap = gap if np.isfinite(gap) else 2.0 * D * D
    return found._replace(gap=gap, distance=min(D, gap_distance(gap)))


# -- certificates ----------------------------------------------------------------------------------


def frank_wolfe_gap(p: Problem, u: Array) -> float:
    """max_{v in U} <J'(u), u - v> >= 2 D^2, for u in U; infinite if U is unbounded that way.

    With rows a linear program, which has tolerances of its own.
    """
    g = gradient(p, u)
    if len(p.c) == 0:
        return box_gap(g, u, p.low, p.high)
    size = float(np.max(np.abs(g)))
    if size == 0.0:
        return 0.0
    found = scipy().optimize.linprog(
        g / size, A_ub=p.C, b_ub=p.c - p.C @ u, bounds=np.column_stack([p.low - u, p.high - u])
    )  # v - u, so that nothing cancels
    return np.inf if found.status == 3 else -size * float(found.fun)


def box_gap(g: Array, u: Array, low: Array, high: Array) -> float:
    """sum_i max(g_i (u_i - low_i), g_i (u_i - high_i)), 0 where g_i = 0."""
    far = np.where(g > 0.0, low, high)
    return float(sum(x * (v - e) for x, v, e in zip(g, u, far, strict=True) if x != 0.0))


def gap_distance(gap: float) -> float:
    """D <= sqrt(gap / 2) for the Frank-Wolfe gap; for any other duality gap D <= sqrt(gap)."""
    return float(np.sqrt(max(gap, 0.0) / 2.0))


def dual_norm(p: Problem, e: ArrayLike) -> float:
    """||e||_{H^-1} with the pseudoinverse: infinite if e is not in the range of H."""
    M, _ = residual_form(p)
    _, s, Vt = np.linalg.svd(M, full_matrices=False)
    keep = s > max(M.shape) * np.finfo(float).eps * np.max(s, initial=0.0)
    e, V = np.asarray(e, dtype=np.float64), Vt[keep]
    if np.linalg.norm(e - V.T @ (V @ e)) > 1e-12 * np.linalg.norm(e):
        return np.inf
    return float(np.linalg.norm(V @ e / s[keep]))


def multiplier_distance(p: Problem, u: Array, multipliers: ArrayLike) -> float:
    """D <= (a + sqrt(a^2 + 8 s)) / 4 with any multipliers >= 0 of the rows X u <= y of `all_rows`.

    a = ||J'(u) + X' mult||_{H^-1}, s = mult' (y - X u). Also for infinite limits, and for soft ones
    with J' of the penalized problem and H without the penalty.
    """
    rows, ends = all_rows(p)
    w = np.asarray(multipliers, dtype=np.float64)
    a = dual_norm(p, gradient(p, u) + rows.T @ w)
    s = max(float(w @ (ends - rows @ u)), 0.0)
    return float((a + np.sqrt(a * a + 8.0 * s)) / 4.0)


def row_multipliers(p: Problem, solution: Solution) -> Array:
    """The multipliers of a solution in the order of `all_rows`."""
    up, down = np.isfinite(p.high), np.isfinite(p.low)
    box = solution.multipliers
    return np.concatenate([np.maximum(box, 0)[up], np.maximum(-box, 0)[down], solution.rows])


# -- limits that must hold -------------------------------------------------------------------------


def forward_clip(
    u: ArrayLike, low: ArrayLike, high: ArrayLike, rate: ArrayLike, previous: ArrayLike
) -> Array:
    """Inputs (K, m) brought inside the limits and |u_k - u_(k-1)| <= rate, one step after another.

    Backward l'_k = max(l_k, l'_(k+1) - r), h'_k = min(h_k, h'_(k+1) + r): from inside [l'_k, h'_k]
    all later limits can be kept. Forward: clip u_k to them and to u_(k-1) +- r.
    """
    u = np.array(u, dtype=np.float64)
    low, high = (x.reshape(u.shape) for x in limits(low, high, u.shape))
    rate = np.asarray(rate, dtype=np.float64)
    for k in range(len(u) - 2, -1, -1):
        low[k] = np.maximum(low[k], low[k + 1] - rate)
        high[k] = np.minimum(high[k], high[k + 1] + rate)
    last = np.asarray(previous, dtype=np.float64)
    for k in range(len(u)):
        down, up = np.maximum(low[k], last - rate), np.minimum(high[k], last + rate)
        if np.any(down - up > 1e-12 * (1.0 + np.abs(down))):
            missed = float(np.max(down - up))
            raise ValueError(f"no input keeps limits and rate: step {k} misses {missed:g}")
        # rounding may leave down > up: then the limits are kept, the rate to rounding
        last = u[k] = np.clip(np.clip(u[k], down, up), low[k], high[k])
    return u


class Missing(NamedTuple):
    """How much C u <= c must give so that the other limits can hold, and a u for which it does."""

    amount: float  # smallest s >= 0 with C u <= c + s
    rows: Array  # (r,), what each row lacks at u
    u: Array


def missing(p: Problem, C: ArrayLike, c: ArrayLike) -> Missing:
    """min s over C u <= c + s, s >= 0 and the limits of `p`: a linear program."""
    C, c = np.asarray(C, dtype=np.float64), np.asarray(c, dtype=np.float64)
    d = len(p.low)
    found = scipy().optimize.linprog(
        np.concatenate([np.zeros(d), [1.0]]),
        A_ub=np.block([[C, -np.ones((len(C), 1))], [p.C, np.zeros((len(p.C), 1))]]),
        b_ub=np.concatenate([c, p.c]),
        bounds=[*zip(p.low, p.high, strict=True), (0.0, None)],
    )
    if found.status != 0:
        raise ValueError(f"the limits of the inputs leave nothing: {found.message}")
    u = found.x[:d]
    return Missing(float(found.x[-1]), np.maximum(C @ u - c, 0.0), u)
