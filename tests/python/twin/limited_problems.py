"""Least squares over limits: the problem, for one step or K steps stacked.

    J(u) = ||G u - b||_Q^2 + ||E u - t||^2   over   low <= u <= high,  C u <= c.

R = E' E weighs the inputs, H = G' Q G + R, J'(u) = 2 [G' Q (G u - b) + E' (E u - t)], and for all v

    J(v) = J(u) + <J'(u), v - u> + ||v - u||_H^2.

Rows of E with t != 0 are targets that are known exactly: wanted inputs, penalties on their change.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .laws import scipy

Array = NDArray[np.float64]


class Problem(NamedTuple):
    """J and its limits; d inputs in all, those of several steps one after another."""

    G: Array  # (p, d)
    b: Array  # (p,)
    Q: Array  # (p, p), >= 0
    E: Array  # (q, d)
    t: Array  # (q,)
    low: Array  # (d,), may be -inf
    high: Array  # (d,), may be inf; equal to `low`: a fixed input
    C: Array  # (r, d)
    c: Array  # (r,)

    @property
    def R(self) -> Array:
        """E' E: what the inputs are weighed with."""
        return np.asarray(self.E.T @ self.E)

    @property
    def H(self) -> Array:
        """G' Q G + R, half the second derivative."""
        return np.asarray(self.G.T @ self.Q @ self.G + self.R)


def root(Q: ArrayLike) -> Array:
    """A symmetric X with X X = Q, for Q >= 0."""
    values, vectors = np.linalg.eigh(np.asarray(Q, dtype=np.float64))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def norm(v: ArrayLike, Q: ArrayLike) -> float:
    """||v||_Q = sqrt(v' Q v)."""
    v = np.asarray(v, dtype=np.float64)
    return float(np.sqrt(max(v @ np.asarray(Q) @ v, 0.0)))


def matrix(weight: ArrayLike | None, size: int, default: float = 0.0) -> Array:
    """A weight as a matrix: a scalar times I, the diagonal (size,), or itself."""
    w = np.asarray(default if weight is None else weight, dtype=np.float64)
    return np.asarray(w * np.eye(size) if w.ndim == 0 else np.diag(w) if w.ndim == 1 else w)


def limits(low: ArrayLike, high: ArrayLike, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Both limits of every input, one after another."""
    low, high = (np.asarray(x, dtype=np.float64) for x in (low, high))
    return np.broadcast_to(low, shape).flatten(), np.broadcast_to(high, shape).flatten()


def one_step(
    B: ArrayLike,
    b: ArrayLike,
    *,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    low: ArrayLike = -np.inf,
    high: ArrayLike = np.inf,
) -> Problem:
    """||B u - b||_Q^2 + ||u||_R^2 over a box: b = xf - A x0; Q = I, R = 0 unless given."""
    B, b = np.asarray(B, dtype=np.float64), np.asarray(b, dtype=np.float64)
    n, m = B.shape
    E = root(matrix(R, m))
    return Problem(
        B,
        b,
        matrix(Q, n, 1.0),
        E,
        np.zeros(m),
        *limits(low, high, (m,)),
        np.zeros((0, m)),
        np.zeros(0),
    )


# -- several steps, stacked ------------------------------------------------------------------------


def powers(A: ArrayLike, K: int) -> list[Array]:
    """I, A, .., A^K."""
    return [np.linalg.matrix_power(np.asarray(A, dtype=np.float64), k) for k in range(K + 1)]


def stacked_map(A: ArrayLike, B: ArrayLike, K: int) -> Array:
    """(x(1), .., x(K)) = G u + (A x0, .., A^K x0): block (k, j) is A^(k-j) B for j <= k."""
    B, P = np.asarray(B, dtype=np.float64), powers(A, K)
    zero = np.zeros_like(B)
    return np.block([[P[k - j] @ B if j <= k else zero for j in range(K)] for k in range(K)])


def stacked_start(A: ArrayLike, x0: ArrayLike, K: int) -> Array:
    """(A x0, .., A^K x0), where no input leads."""
    return np.concatenate([P @ np.asarray(x0, dtype=np.float64) for P in powers(A, K)[1:]])


def several_steps(
    A: ArrayLike,
    B: ArrayLike,
    x0: ArrayLike,
    reference: ArrayLike,
    K: int,
    *,
    Q: ArrayLike | None = None,
    Qf: ArrayLike | None = None,
    R: ArrayLike | None = None,
    wanted: ArrayLike = 0.0,
    S: ArrayLike | None = None,
    low: ArrayLike = -np.inf,
    high: ArrayLike = np.inf,
    rate: ArrayLike | None = None,
    previous: ArrayLike = 0.0,
) -> Problem:
    """b_k = r_k - A^k x0 for k = 1 .. K, and u (K m,); limits are scalars, (m,) or (K, m).

    `reference` is xf (n,) or r_1 .. r_K (K, n). Q weighs x(1) .. x(K-1) (default 0), Qf x(K)
    (default Q, or I without Q), R every u_k - `wanted`, S every u_k - u_(k-1), u_(-1) = `previous`.
    Rate limits are the rows +-(u_k - u_(k-1)) <= rate.
    """
    n, m = np.shape(B)
    stage = matrix(Q, n)
    final = matrix(Qf, n, 1.0) if Qf is not None or Q is None else stage
    targets = np.broadcast_to(np.asarray(reference, dtype=np.float64), (K, n)).ravel()
    step = np.eye(K * m) - np.eye(K * m, k=-m)  # u_k - u_(k-1), the first without u_(-1)
    first = np.zeros((K, m))
    first[0] = previous
    half_R, half_S = np.kron(np.eye(K), root(matrix(R, m))), np.kron(np.eye(K), root(matrix(S, m)))
    v = np.broadcast_to(np.asarray(wanted, dtype=np.float64), (K, m)).ravel()
    C, c = np.zeros((0, K * m)), np.zeros(0)
    if rate is not None:
        r = np.broadcast_to(np.asarray(rate, dtype=np.float64), (K, m)).ravel()
        C, c = np.vstack([step, -step]), np.concatenate([r + first.ravel(), r - first.ravel()])
    return Problem(
        stacked_map(A, B, K),
        targets - stacked_start(A, x0, K),
        scipy().linalg.block_diag(*[stage] * (K - 1), final),
        np.vstack([half_R, half_S @ step]),
        np.concatenate([half_R @ v, half_S @ first.ravel()]),
        *limits(low, high, (K, m)),
        C,
        c,
    )


def state_rows(
    A: ArrayLike, B: ArrayLike, x0: ArrayLike, K: int, C: ArrayLike, h: ArrayLike
) -> tuple[Array, Array]:
    """C x(k) <= h for k = 1 .. K as rows for u; h is (rows,) or (K, rows)."""
    C = np.asarray(C, dtype=np.float64)
    all_C = np.kron(np.eye(K), C)
    each = np.broadcast_to(np.asarray(h, dtype=np.float64), (K, len(C))).ravel()
    return all_C @ stacked_map(A, B, K), each - all_C @ stacked_start(A, x0, K)


def with_rows(p: Problem, C: ArrayLike, c: ArrayLike) -> Problem:
    """The problem with the rows C u <= c as well."""
    return p._replace(C=np.vstack([p.C, C]), c=np.concatenate([p.c, np.asarray(c)]))


def softened(p: Problem, C: ArrayLike, c: ArrayLike, rho: float) -> Problem:
    """J + rho ||max(0, C u - c)||^2 as a problem for (u, s): C u - s <= c, rho ||s||^2 added."""
    C, r, d = np.asarray(C, dtype=np.float64), len(np.atleast_1d(c)), len(p.low)
    return Problem(
        np.hstack([p.G, np.zeros((len(p.G), r))]),
        p.b,
        p.Q,
        scipy().linalg.block_diag(p.E, np.sqrt(rho) * np.eye(r)),
        np.concatenate([p.t, np.zeros(r)]),
        np.concatenate([p.low, np.full(r, -np.inf)]),
        np.concatenate([p.high, np.full(r, np.inf)]),
        np.block([[p.C, np.zeros((len(p.C), r))], [C, -np.eye(r)]]).reshape(-1, d + r),
        np.concatenate([p.c, np.asarray(c)]),
    )


# -- J ---------------------------------------------------------------------------------------------


def objective(p: Problem, u: Array) -> float:
    """J(u)."""
    return norm(p.G @ u - p.b, p.Q) ** 2 + float(np.sum((p.E @ u - p.t) ** 2))


def gradient(p: Problem, u: Array) -> Array:
    """J'(u) from the residuals: H u - f would cancel."""
    return np.asarray(2.0 * (p.G.T @ (p.Q @ (p.G @ u - p.b)) + p.E.T @ (p.E @ u - p.t)))


def residual_form(p: Problem) -> tuple[Array, Array]:
    """M, t with J(u) = ||M u - t||^2."""
    half = root(p.Q)
    return np.vstack([half @ p.G, p.E]), np.concatenate([half @ p.b, p.t])


def all_rows(p: Problem) -> tuple[Array, Array]:
    """Finite `high`, finite `low`, then C: all limits as rows X u <= y."""
    one, up, down = np.eye(len(p.low)), np.isfinite(p.high), np.isfinite(p.low)
    return np.vstack([one[up], -one[down], p.C]), np.concatenate([p.high[up], -p.low[down], p.c])
