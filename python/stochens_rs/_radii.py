"""Radii that hold with probability 1 - delta, as far as `multistep` needs them.

Each takes what was sampled, the number of realizations N and delta, and bounds the distance from
the uniform average to the exact value. Lines of zeros are exact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .theory.moments._formulas import _others, _transition

Array = NDArray[np.float64]


def vector_radius(w: Array, N: int, delta: float) -> float:
    """2-norm, by bounded differences: ``(sqrt(g^2 - ||w||^2) + g sqrt(log 1/delta)) / sqrt N``.

    Exchanging one realization moves the distance by at most ``sqrt(2) g / N`` (McDiarmid).
    """
    variance = float((np.abs(w) * _others(w[:, None])[:, 0]).sum())
    if variance == 0.0:  # one entry, or none: every realization is w
        return 0.0
    g = float(np.abs(w).sum())
    return (math.sqrt(variance) + g * math.sqrt(-math.log(delta))) / math.sqrt(N)


def matrix_radius(A: Array, N: int, delta: float) -> float:
    """Spectral norm, by the matrix Bernstein inequality for ``N m`` independent columns.

    ``L l / 3 + sqrt((L l / 3)^2 + 2 v l)`` with ``l = log((n + m) / delta)``,
    ``v = max(||T_A(1)||_2, max_j (g_j^2 - ||a_j||^2)) / N`` and
    ``L = max_ij ||g_j sign(a_ij) e_i - a_j|| / N`` over the entries that are not 0.
    """
    others = _others(A)
    columns = (np.abs(A) * others).sum(axis=0)
    spread = float(np.linalg.norm(_transition(A, np.ones(A.shape[1])), 2))
    v = max(spread, float(columns.max())) / N
    squares = np.where(A != 0.0, others**2 + _others(A**2), 0.0)
    L = math.sqrt(float(squares.max())) / N
    log = math.log(sum(A.shape)) - math.log(delta)
    third = L * log / 3.0
    return third + math.sqrt(third * third + 2.0 * v * log)


def systematic_radius(lines: Array, N: int) -> float:
    """Frobenius norm, surely: each count is within 1 of its mean, ``sqrt(sum_j n_j g_j^2) / N``.

    `lines` has the sampled lines as columns, n_j of whose entries are not 0.
    """
    hit = np.count_nonzero(lines, axis=0)
    g = np.abs(lines).sum(axis=0)
    return math.sqrt(float((np.where(hit > 1, hit, 0) * g * g).sum())) / N
