"""What explains a bias that was learned at rest, for a window of lags without delay."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .laws import chi2_upper

Array = NDArray[np.float64]
SPLITS = np.logspace(-3.0, 3.0, 25)  # of a sum of two ellipsoids


class Causes(NamedTuple):
    """Constants at the inputs, how much more each sensor reads, and whether two are wrong."""

    constants: Array | None
    sensors: list[float | None]
    two: bool


def settled(L: Array, noise: Array, calls: int) -> Array:
    """The covariance of the mean over so many calls of ``e+ = e + L (w - e)``, long after."""
    keeps = np.eye(len(L)) - L
    one, power = L @ noise @ L.T, keeps
    for _ in range(40):
        one, power = one + power @ one @ power.T, power @ power
    mean, power = one / calls, np.eye(len(L))
    for k in range(1, calls):
        power = keeps @ power
        later = power @ one
        mean = mean + (calls - k) / calls**2 * (later + later.T)
    return 0.5 * (mean + mean.T)


def causes(
    H: Array, lags: int, region: Any, learned: tuple[Array, int, Array, Array, Array], level: float
) -> Causes | None:
    """``e = (Theta - H) z + b d + M s + n``: what is not refuted; None where nothing is needed.

    An ellipsoid of `region` for each of its parts; z at rest is ``N_y y + N_u u + N_1``.
    """
    bias, calls, L, noise, rest = learned
    p, k = len(H), len(rest)
    N = np.zeros((H.shape[1], k))
    N[: lags * p, :p] = np.tile(np.eye(p), (lags, 1))
    N[lags * p : lags * k, p:] = np.tile(np.eye(k - p), (lags, 1))
    effects = np.hstack([np.eye(p) - H @ N[:, :p], H @ N[:, p:]])
    moves = N * np.where(np.arange(k) < p, -1.0, 1.0)  # of the true z
    z = N @ rest
    z[lags * k :] = 1.0
    covariance = settled(L, noise, calls)
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    near = covariance * chi2_upper(level, p)

    def misfit(z: Array) -> Array:
        far = np.zeros((p, p))
        for part in region.parts:
            at = np.ix_(part.rows, part.rows)
            far[at] += len(region.parts) * part.factor * part.S * part.length(z) ** 2
        return far

    def fitted(which: list[int]) -> Array | None:
        """The sizes of these causes; None if they are refuted."""
        size = np.linalg.lstsq(white @ effects[:, which], white @ bias, rcond=1e-9)[0]
        for far in map(misfit, (z, z + moves[:, which] @ size)):
            if not np.isfinite(far).all():
                return size
            least = 0.0
            for t in SPLITS:  # any ellipsoid around the sum refutes
                T = np.linalg.inv(np.linalg.cholesky((1.0 + 1.0 / t) * near + (1.0 + t) * far))
                best = np.linalg.lstsq(T @ effects[:, which], T @ bias, rcond=1e-9)[0]
                least = max(least, float(np.linalg.norm(T @ (bias - effects[:, which] @ best))))
            if least <= 1.0:
                return size
        return None

    if not bias.any() or fitted([]) is not None:
        return None
    inputs = list(range(p, k))
    acting = fitted(inputs)
    beside = [] if acting is not None else inputs
    sizes = [fitted([i, *beside]) for i in range(p)]
    sensors = [None if size is None else float(size[0]) for size in sizes]
    none = acting is None and sensors == [None] * p
    pairs = itertools.combinations(range(p), 2)
    two = none and any(fitted([*pair, *beside]) is not None for pair in pairs)
    return Causes(acting, sensors, two)
