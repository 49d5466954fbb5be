"""How fast second moments grow under sampling: the spectral radius of one kind of positive map.

``L_r(M) = F M F^T + r G T_A(diag M) G^T`` on symmetric matrices, ``T_A(d) = sum_j d_j Cv(a_j)``:
``F`` carries an error on, the second term is what sampling the columns of ``A`` adds, with
``r = 1 / N``. The second term sees n numbers of ``M`` only. With ``rho(F) < 1`` and the n x n
matrix ``Psi_ij = [sum_k F^k G Cv(a_j) G^T F^kT]_ii``, nonnegative, the map is therefore stable,
``rho(L_r) < 1``, if and only if ``r rho(Psi) < 1``; and ``rho(L_r) = s`` if and only if the
same holds with equality for ``L_r / s``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# 2^50 terms: enough for every rho(F)^2 / s < 1 that float64 can tell from 1.
_DOUBLINGS = 50


def spectral_radius(M: Array) -> float:
    """The largest modulus of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(M)).max())


def excitation_radius(A: Array, F: Array, G: Array, s: float = 1.0) -> float:
    """``rho(Psi)`` for ``L / s``: inf where ``rho(F)^2 >= s``, or beyond what a float can hold."""
    if not spectral_radius(F) < math.sqrt(s):
        return math.inf
    n = A.shape[0]
    # Y_i = sum_k (F^k)^T e_i e_i^T F^k / s^k, by doubling the number of terms
    Y = np.zeros((n, n, n))
    Y[np.arange(n), np.arange(n), np.arange(n)] = 1.0
    power = F / math.sqrt(s)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            if np.abs(power).max() <= 1e-10:
                break
            Y += power.T @ Y @ power
            power = power @ power
            if not np.isfinite(power).all():  # the eigenvalues of a defective F are inexact
                return math.inf
        else:
            return math.inf
        # Psi_ij = <G^T Y_i G, Cv(a_j)>, Cv(a_j) = g_j diag|a_j| - a_j a_j^T
        Z = G.T @ Y @ G
        absolute = np.abs(A)
        Psi = np.diagonal(Z, axis1=1, axis2=2) @ (absolute * absolute.sum(axis=0))
        Psi -= (np.matmul(Z, A) * A).sum(axis=1)
    return spectral_radius(np.maximum(Psi, 0.0)) / s if np.isfinite(Psi).all() else math.inf


def map_radius(A: Array, F: Array, G: Array, r: float) -> float:
    """``rho(L_r)``, to about ten digits."""
    slowest = spectral_radius(F)
    floor = slowest * slowest
    if r == 0.0 or floor == math.inf:
        return floor
    if not F.any():
        return r * excitation_radius(A, F, G)

    def excess(s: float) -> float:
        """``log(r rho(Psi))`` for ``L / s``: falls with s, 0 at ``s = rho(L_r)``."""
        return math.log(max(r * excitation_radius(A, F, G, s), 1e-300))

    low = floor * (1.0 + 1e-10) if floor > 0.0 else 1e-12 * float(np.sum(A**2))
    at_low = excess(low)
    if at_low <= 0.0:
        return floor
    high, at_high = 2.0 * low, excess(2.0 * low)
    while at_high > 0.0:
        low, at_low, high = high, at_high, 4.0 * high
        at_high = excess(high)
    # Regula falsi in logarithms (Illinois: an end that stays put counts half the next time).
    for _ in range(100):
        t = at_low / (at_low - at_high) if math.isfinite(at_low) else 0.5
        middle = math.exp((1.0 - t) * math.log(low) + t * math.log(high))
        value = excess(middle)
        if abs(value) < 1e-12 or high - low < 1e-11 * high:
            return middle
        if value > 0.0:
            low, at_low, at_high = middle, value, at_high / 2.0
        else:
            high, at_high, at_low = middle, value, at_low / 2.0
    return middle
