"""The concentration inequalities on plain numbers, with their inverses.

``level`` is ``L = log(1/delta)``; ``x_level(..., eps)`` is the level whose radius is eps.
"""

from __future__ import annotations

import math

import numpy as np

from ..formulas import Array


def mcdiarmid(mean: float, spread: float, level: float) -> float:
    """``E + sqrt(V L)`` where the squared ranges of all coordinates add up to ``2 V``."""
    return mean + math.sqrt(spread * level)


def mcdiarmid_level(mean: float, spread: float, eps: float) -> float:
    """``(eps - E)^2 / V`` beyond E."""
    if eps <= mean:
        return 0.0
    return square((eps - mean) / math.sqrt(spread)) if spread > 0.0 else math.inf


def bousquet(mean: float, variance: float, largest: float, level: float) -> float:
    """``E + sqrt(2 L (lam + 2 U E)) + U L / 3``."""
    return mean + math.sqrt(2.0 * level * (variance + 2.0 * largest * mean)) + largest * level / 3.0


def bousquet_level(mean: float, variance: float, largest: float, eps: float) -> float:
    """The L at which `bousquet` is eps: the positive root of a quadratic in ``sqrt(L)``."""
    if eps <= mean:
        return 0.0
    b = math.sqrt(2.0 * (variance + 2.0 * largest * mean))
    root = b + math.sqrt(b * b + 4.0 / 3.0 * largest * (eps - mean))
    return square(2.0 * (eps - mean) / root) if root > 0.0 else math.inf


def square(x: float) -> float:
    """``x^2``, inf where it overflows (Python's power raises)."""
    return x * x


def chebyshev_level(rms: float, eps: float) -> float:
    """``log(eps^2 / rms^2)``."""
    if rms == 0.0:
        return math.inf
    return 2.0 * (math.log(eps) - math.log(rms)) if eps > 0.0 else 0.0


def largest_eigenvalues(p: Array) -> Array:
    """Largest eigenvalue of ``diag(p) - p p^T`` for each column p, from above.

    Interlacing puts it between the two largest entries, where ``sum_i p_i^2 / (p_i - x)`` grows
    through 1 once.
    """
    if p.size == 0:
        return np.zeros(p.shape[1])
    below, above = np.partition(p, -2, axis=0)[-2:]
    for _ in range(60):
        middle = (below + above) / 2.0
        with np.errstate(divide="ignore", invalid="ignore"):
            secular = (p**2 / (p - middle)).sum(axis=0)
        beyond = ~(secular < 1.0)  # a middle that meets an entry is beyond, too
        above = np.where(beyond, middle, above)
        below = np.where(beyond, below, middle)
    return np.asarray(above, dtype=np.float64)
