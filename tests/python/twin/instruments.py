"""Regions when the states are measured with error, by instruments (Anderson and Rubin 1949).

y_t and z_t are measured values, e_t = y_t - Theta z_t contains the noise of both, and instruments
zeta_t (N, r), r >= d, are independent of all noises: past inputs in open loop, an exogenous dither
in closed loop, set points. On a trajectory e_t = w_t + v_{t+1} - A v_t, so only every second pair
may be used: then the e_t are independent.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .quantiles import roy_quantile
from .regions import Region
from .triangle import Fitted, r_factor

Array = NDArray[np.float64]


class Instrumented(NamedTuple):
    """(Theta - centre) V (Theta - centre)' <= S: "bounded", "unbounded" (V) or "empty" (S).

    Empty: no Theta explains the data, the assumptions are refuted at this delta. It is a refusal,
    never a radius of 0. Unbounded: the instruments say too little.
    """

    V: Array
    centre: Array
    S: Array
    status: str
    delta: float


def instrumented(
    zeta: ArrayLike,
    Z: ArrayLike,
    Y: ArrayLike,
    delta: float,
    *,
    q: float | None = None,
) -> Instrumented:
    """The set E P E' <= q E (I - P) E', P the projector on the columns of `zeta`; exact level.

    At the truth E is independent Gaussian given zeta, so both sides are Wishart of r and N - r
    degrees and q is Roy's quantile of (n, r, N - r). With Q = P - q (I - P), V = Z' Q Z and
    centre = Y' Q Z V^-1 (an estimator of the k class), completing the square gives
    S = centre V centre' - Y' Q Y. `zeta` = Z is least squares with its exact region.
    """
    zeta, Z, Y = (np.asarray(part, dtype=np.float64) for part in (zeta, Z, Y))
    d, n = Z.shape[1], Y.shape[1]
    r = int(np.linalg.matrix_rank(zeta))
    if q is None:
        q = roy_quantile(n, r, len(Z) - r, delta)
    basis = np.linalg.svd(zeta, full_matrices=False)[0][:, :r]
    both = np.hstack([Z, Y])
    inside = basis.T @ both
    outside = r_factor(both - basis @ inside)
    if not np.isfinite(q):
        return Instrumented(np.zeros((d, d)), np.zeros((n, d)), np.eye(n), "unbounded", delta)
    form = inside.T @ inside - q * (outside.T @ outside)  # [Z Y]' Q [Z Y]
    V, YZ, YY = form[:d, :d], form[d:, :d], form[d:, d:]
    C = np.asarray(np.linalg.solve(V, YZ.T).T, dtype=np.float64)
    S = C @ V @ C.T - YY
    if np.linalg.eigvalsh(V)[0] <= 1e-12 * np.linalg.norm(inside[:, :d]) ** 2:
        status = "unbounded"
    else:
        status = "empty" if np.linalg.eigvalsh(S)[0] < 0.0 else "bounded"
    return Instrumented(V, C, S, status, delta)


def contains(found: Instrumented, Theta: ArrayLike) -> bool:
    """Whether `Theta` is in the set, whatever its shape: S - (Theta - C) V (Theta - C)' >= 0."""
    X = np.asarray(Theta, dtype=np.float64) - found.centre
    return bool(np.linalg.eigvalsh(found.S - X @ found.V @ X.T)[0] >= 0.0)


def region(found: Instrumented) -> Region:
    """As a region of the common form; ValueError if it is empty, infinite if unbounded."""
    if found.status == "empty":
        raise ValueError("the region is empty: no model explains these data with the instruments")
    d = len(found.V)
    bounded = found.status == "bounded"
    root = np.asarray(np.linalg.cholesky(found.V).T if bounded else np.eye(d))
    white = np.asarray(np.linalg.inv(root).T)
    fitted = Fitted(found.centre, found.S, 0, d, white, root, np.zeros((d, 0)), 1.0)
    assumption = "Gaussian noise of states and process, instruments independent of both"
    return Region(fitted, 1.0 if bounded else np.inf, found.S, found.delta, assumption)


def corrected(Z: ArrayLike, Y: ArrayLike, covariance: ArrayLike) -> Array:
    """Y' Z (Z' Z - N C)^-1, C the known error covariance of z: consistent, without a region.

    Least squares tends to Theta (M - C) M^-1, M = E z z' of the measured z. ValueError if the
    bracket is not positive definite.
    """
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    bracket = Z.T @ Z - len(Z) * np.asarray(covariance, dtype=np.float64)
    if np.linalg.eigvalsh(bracket)[0] <= 0.0:
        raise ValueError("the error covariance is as large as the data: no estimate")
    return np.asarray(np.linalg.solve(bracket, Z.T @ Y).T)
