"""Ensembles of models from one data set, and pooling of several.

Every ensemble here but `region_draws` of the truth scatters about the estimate H, not about Theta:
no statement about the distance to Theta follows from its mean. Rows of `Z` (N, d) and `Y` (N, n)
are pairs; a model is (n, d).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .triangle import Fitted, Triangle, fit, merge

Array = NDArray[np.float64]


def region_draws(fitted: Fitted, size: int, gen: np.random.Generator) -> Array:
    """H + S^(1/2) E^(-1/2) G V^(-1/2), E ~ W_n(I, nu), (size, n, d); for nonlinear functions.

    Mean H; covariance V^-1 x S / (nu - n - 1). E^(-1/2) from Bartlett's triangle.
    """
    n, nu = len(fitted.H), fitted.nu
    L = np.linalg.cholesky(fitted.S)
    i = np.arange(n)
    T = np.tril(gen.standard_normal((size, n, n)), -1)
    T[:, i, i] = np.sqrt(gen.chisquare(nu - i, (size, n)))
    G = gen.standard_normal((size, n, fitted.rank))
    root = np.linalg.solve(T.transpose(0, 2, 1), G)  # E = T T': E^-1 = T'^-1 T^-1
    return np.asarray(fitted.H + L @ root @ fitted.white)


def pooled(data: Sequence[Triangle]) -> Fitted:
    """Least squares of all data together (Gauss and Markov): (sum H_i V_i)(sum V_i)^-1."""
    return fit(merge(*data))


def precision_weights(data: Sequence[Triangle]) -> Array:
    """The best weights where only the estimates H_i may be combined: w_i ~ 1 / tr V_i^-1.

    E||sum w_i H_i - Theta||_F^2 = tr Sigma sum w_i^2 tr V_i^-1. Pooling is better.
    """
    w = np.array([1.0 / np.sum(fit(part).white ** 2) for part in data])
    return np.asarray(w / w.sum())


def autoregression_bias(a: float, T: int) -> float:
    """-2 a / T: bias of least squares on one stationary scalar trajectory, to O(1/T^2).

    Nicholls and Pope (1988); for display, not to be subtracted.
    """
    return -2.0 * a / T
