"""Noise to come as the core takes it, and the states and spreads of the centre of a region."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from ..theory.dynamics import states

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region


class SizedNoise(NamedTuple):
    """Noise to come that is not in the region: ``||[w(0) .. w(K-1)]|| <= radius`` after `root`^-1.

    `root` (n, n) is a root of the known covariance.
    """

    radius: float
    root: Floats


class GaussianNoise(NamedTuple):
    """Gaussian noise to come, independent of the data, of covariance at most ``root root'``.

    Given the data, its part ``sum_i A^(k-1-i) w(i)`` of e(k) is Gaussian, A that of the centre.
    `end` is the level of its quantile for the last state, `before` that of each earlier one, and
    again of what the error of the model makes of it.
    """

    root: Floats
    end: float
    before: float


ToCome: TypeAlias = SizedNoise | GaussianNoise


def trajectory(Theta: Floats, x0: Floats, u: Floats) -> Floats:
    """The states (K + 1, n) of ``x(k+1) = Theta (x(k), u(k), 1)``."""
    n = len(Theta)
    ones = np.ones((len(u), Theta.shape[1] - n - u.shape[1]))
    return states(Theta[:, :n], Theta[:, n:], x0, np.hstack([u, ones]))


def spread(region: Region, columns: slice) -> float:
    """``||D v||`` is at most this for all ``||v|| = 1`` in these columns: ``rho ||white||``."""
    first, end, _ = columns.indices(region.centre.shape[1])
    return region._core.spread(first, end)


def root_of(S: Floats) -> Floats:
    """A root of S, `root root' = S`; the rounding of each row is relative to its own size."""
    sizes = np.sqrt(np.maximum(np.diag(S), 0.0))[:, None]
    units = np.where(sizes == 0.0, 1.0, sizes)
    values, vectors = np.linalg.eigh(S / units / units.T)
    return np.ascontiguousarray(sizes * vectors * np.sqrt(np.maximum(values, 0.0)))
