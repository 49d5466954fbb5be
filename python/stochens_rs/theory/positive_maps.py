"""Growth of second moments under sampling: the spectral radius of one kind of positive map.

``L_r(M) = F M F^T + r G T_A(diag M) G^T`` on symmetric matrices, ``T_A(d) = sum_j d_j Cv(a_j)``:
``F`` propagates an error, and the second term is added by sampling the columns of ``A``, with
``r = 1 / N``. The second term depends on the diagonal of ``M`` only. With ``rho(F) < 1`` and the
nonnegative n x n matrix ``Psi_ij = [sum_k F^k G Cv(a_j) G^T F^kT]_ii``, the map is stable,
``rho(L_r) < 1``, if and only if ``r rho(Psi) < 1``; and ``rho(L_r) = s`` if and only if the
same holds with equality for ``L_r / s``.

``Psi v`` is the diagonal of one sum over k, O(n^3), while Psi itself takes n of them. Its spectral
radius is therefore found by power iteration between the bounds of Collatz and Wielandt,
``min_i (Psi v)_i / v_i <= rho(Psi) <= max_i (Psi v)_i / v_i`` for every ``v > 0``; the eigenvalues
of Psi are computed if it does not converge (Psi reducible or periodic, most often tiny or sparse).
"""

from __future__ import annotations

import math

import numpy as np

from .._base.numbers import TINY
from .._base.types import Floats

# Doublings of the number of terms of a sum: 2^50 terms are enough for every rho(F)^2 / s that
# float64 can tell from 1.
_DOUBLINGS = 50
# Powers of F with entries up to here add 1e-20 of the sum, less than its rounding.
_VANISHED = 1e-10
# The search for the spectral radius above the floor rho(F)^2 ends at a gap of ten digits of the
# floor, or of 50 eps of its start.
_FLOOR, _START = 1e-10, 1e-14
# Power iteration: relative difference of the two bounds at which it ends, and its last step.
_CLOSE = 1e-11
_ITERATIONS = 100


def spectral_radius(M: Floats) -> float:
    """The largest modulus of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(M)).max())


def excitation_radius(
    A: Floats, F: Floats, G: Floats, s: float = 1.0, start: Floats | None = None
) -> float:
    """``rho(Psi)`` for ``L / s``: inf where ``rho(F)^2 >= s``, or beyond what a float can hold.

    `start` (n,), if given, is the first vector of the power iteration, and is set to the last one.
    """
    if not spectral_radius(F) < math.sqrt(s):
        return math.inf
    powers = _powers(F / math.sqrt(s))
    if powers is None:
        return math.inf
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        v = np.ones(len(A)) if start is None else start
        found = _perron(A, G, powers, v) if powers else None
        if found is not None:
            return found / s
        Psi = _excitation(A, G, powers)
    return spectral_radius(np.maximum(Psi, 0.0)) / s if np.isfinite(Psi).all() else math.inf


def _powers(power: Floats) -> list[Floats] | None:
    """``power^(2^i)`` up to the last that matters; None if they do not vanish."""
    powers: list[Floats] = []
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            if np.abs(power).max() <= _VANISHED:
                return powers
            powers.append(power)
            power = power @ power
            if not np.isfinite(power).all():  # the eigenvalues of a defective F are inexact
                return None
    return None


def _perron(A: Floats, G: Floats, powers: list[Floats], v: Floats) -> float | None:
    """``rho(Psi)`` by power iteration from (and in) ``v > 0``; None if it does not converge."""
    absolute = np.abs(A)
    Phi = absolute * (absolute.sum(axis=0) - absolute)
    for _ in range(_ITERATIONS):
        T = -(A * v) @ A.T
        np.fill_diagonal(T, Phi @ v)
        X = G @ T @ G.T
        for power in powers:  # sum_k F^k X F^kT, by doubling the number of terms
            X = X + power @ X @ power.T
        image = X.diagonal()
        if not (np.isfinite(image).all() and image.min() > 0.0):
            break
        ratios = image / v
        low, high = float(ratios.min()), float(ratios.max())
        v[:] = image / image.max()
        if high - low <= _CLOSE * high:
            return math.sqrt(low) * math.sqrt(high)
        if v.min() == 0.0:
            break
    v[:] = 1.0
    return None


def _excitation(A: Floats, G: Floats, powers: list[Floats]) -> Floats:
    """Psi itself."""
    absolute = np.abs(A)
    weights = absolute * absolute.sum(axis=0)
    if not powers:  # F = 0: one term
        return np.asarray((G * G) @ weights - (G @ A) ** 2)
    n = A.shape[0]
    # Y_i = sum_k (F^k)^T e_i e_i^T F^k, by doubling the number of terms
    Y = np.zeros((n, n, n))
    Y[np.arange(n), np.arange(n), np.arange(n)] = 1.0
    for power in powers:
        Y += power.T @ Y @ power
    # Psi_ij = <G^T Y_i G, Cv(a_j)>, Cv(a_j) = g_j diag|a_j| - a_j a_j^T
    Z = G.T @ Y @ G
    Psi = np.diagonal(Z, axis1=1, axis2=2) @ weights
    return np.asarray(Psi - (np.matmul(Z, A) * A).sum(axis=1))


def moment_radius(A: Floats, F: Floats, G: Floats, r: float) -> float:
    """``rho(L_r)``, to about ten digits."""
    slowest = spectral_radius(F)
    floor = slowest * slowest
    if r == 0.0 or floor == math.inf:
        return floor
    if not F.any():
        return r * excitation_radius(A, F, G)

    v = np.ones(len(A))

    def excess(gap: float) -> float:
        """``log(r rho(Psi))`` for ``L / s``, ``s = floor + gap``: falls, 0 at ``s = rho(L_r)``."""
        return math.log(max(r * excitation_radius(A, F, G, floor + gap, v), TINY))

    # One term of Psi gives the start; if it is 0, so is the second term of the map.
    first = r * float(_excitation(A, G, []).max())
    gap = max(floor, first)
    if first <= 0.0:
        return floor
    least = max(_FLOOR * floor, _START * gap)
    value = excess(gap)
    low = high = gap
    at_low = at_high = value
    while at_high > 0.0:
        low, at_low, high = high, at_high, 4.0 * high
        at_high = excess(high)
    while at_low <= 0.0:
        if low <= least:
            return floor
        high, at_high, low = low, at_low, max(low / 16.0, least)
        at_low = excess(low)
    # Regula falsi in logarithms, in which rho(Psi) is nearly a straight line of slope -1, far from
    # the floor and next to it. Illinois rule: an end that is kept twice counts half.
    side = 0
    for _ in range(100):
        t = at_low / (at_low - at_high) if math.isfinite(at_low) else 0.5
        gap = math.exp((1.0 - t) * math.log(low) + t * math.log(high))
        value = excess(gap)
        if abs(value) < _CLOSE or high - low < _CLOSE * (floor + high):
            break
        if value > 0.0:
            low, at_low = gap, value
            at_high /= 2.0 if side > 0 else 1.0
            side = 1
        else:
            high, at_high = gap, value
            at_low /= 2.0 if side < 0 else 1.0
            side = -1
    return floor + gap
