"""Tests of residuals with exact levels: warnings, never a licence for a region.

For regressors independent of the noise, chol(S)^-1 E has a law free of Theta and Sigma, that of
chol(X M X')^-1 X M with X standard normal and M = I - Z' V^+ Z: whatever statistic, the rank of
the observed one among simulated ones has an exact p-value at any N (Dufour and Khalaf 2002). On
trajectories the p-values are approximate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .triangle import _range, leverages, residuals

Array = NDArray[np.float64]

NAMES = ("correlation in time", "correlation at lag 1", "tails", "heteroscedasticity", "change")


def statistics(E: ArrayLike, Z: ArrayLike) -> Array:
    """The five statistics of residuals E (N, n), large where an assumption fails.

    With e scaled to sum e e' = I: sum_{j=1..5} ||C_j||_F^2 and ||C_1||_F^2, C_j = sum e_t e_{t-j}';
    the kurtosis sum ||e_t||^4 (Mardia 1970); |corr(||e_t||^2, h_t)| with the leverage h_t; and
    ||sum_{t <= N/2} e_t z_t' V^(-1/2)||_F^2, since the whole sum is 0.
    """
    E, Z = np.asarray(E, dtype=np.float64), np.asarray(Z, dtype=np.float64)
    e = E @ np.linalg.inv(np.linalg.cholesky(E.T @ E)).T
    N = len(e)
    lags = [float(np.sum((e[j:].T @ e[:-j]) ** 2)) for j in range(1, min(6, N))]
    square, h = np.sum(e * e, axis=1), leverages(Z)
    h = h - h.mean()
    spread = np.linalg.norm(square - square.mean()) * np.linalg.norm(h)
    tilt = abs(square @ h) / spread if spread > 1e-12 else 0.0
    half = e[: N // 2].T @ _range(Z)[: N // 2]
    return np.array([sum(lags), lags[0], square @ square, tilt, np.sum(half * half)])


def p_values(Z: ArrayLike, Y: ArrayLike, draws: int, gen: np.random.Generator) -> Array:
    """(1 + #{simulated >= observed}) / (draws + 1) for each of `NAMES`; NaN for N - rank < n.

    With all five looked at, one is below delta / 5 with probability at most delta.
    """
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    Q = _range(Z)
    if len(Z) - Q.shape[1] < Y.shape[1]:
        return np.full(len(NAMES), np.nan)
    observed = statistics(residuals(Z, Y), Z)
    larger = np.zeros(len(NAMES))
    for _ in range(draws):
        X = gen.standard_normal(Y.shape)
        larger += statistics(X - Q @ (Q.T @ X), Z) >= observed * (1.0 - 1e-12)
    return np.asarray((1.0 + larger) / (draws + 1.0))
