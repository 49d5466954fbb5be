"""Sign-perturbed sums: regions for independent symmetric noise of any law.

If the w_t are independent, symmetric and independent of all z_t, the true Theta makes
``S_a = sum a_t e_t(Theta) b_t'`` equal in law for all sign vectors a, with
``e_t(Theta) = y_t - Theta z_t`` and the whitened ``b_t``: the rank of ``||S_1||_F`` among m of them
is uniform, so that {||S_1|| is not among the q largest} has probability 1 - q / m (Csaji, Campi
and Weyer 2015).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.records import Record
from .._base.threads import get_num_threads
from ..exceptions import InputError
from ..rng import Key

if TYPE_CHECKING:
    from .._base.types import Floats


SMALLEST = 1e-5  # delta: that takes 1 / delta sign vectors
SIZE = 100  # sign vectors m, the one of ones included


@dataclass(frozen=True, eq=False)
class SignTest(Record):
    """The exact set of sign-perturbed sums, for one model at a time.

    Attributes
    ----------
    Z, Y : ndarray, shapes (N, d), (N, n)
        The pairs.
    basis : ndarray, shape (N, r)
        Orthonormal columns spanning those of `Z`.
    size, largest : int
        m and q: the probability is ``1 - q / m``.
    key : Key
        That of the m - 1 random sign vectors, which must never be drawn anew for the same data.
    """

    Z: Floats
    Y: Floats
    basis: Floats
    size: int
    largest: int
    key: Key

    def _errors(self, Theta: Floats) -> Floats:
        return np.hstack([self.basis, self.Y - self.Z @ Theta.T])

    def contains(self, Theta: Floats) -> bool:
        """Whether the set contains `Theta`; ties count as inside, which is safe."""
        rows, n = self._errors(Theta), self.Y.shape[1]
        own = float(np.linalg.norm(rows[:, -n:].T @ self.basis))
        key, threads = bytes(self.key), get_num_threads()
        others = _core.sign_statistics(rows, n, self.size - 1, key, None, threads)
        return bool(np.sum(others >= own * (1.0 - 1e-12)) >= self.largest)

    def radius(self, Theta: Floats) -> float:
        """Of the ball around least squares `Theta` that holds the set, in the Frobenius norm.

        The q-th largest of the radii of the sign vectors; infinite where one bounds nothing.
        """
        rows, n = self._errors(Theta), self.Y.shape[1]
        key, threads = bytes(self.key), get_num_threads()
        radii = _core.sign_radii(rows, n, self.size - 1, key, None, threads)
        return float(np.sort(radii)[::-1][self.largest - 1])


def sizes(delta: float) -> tuple[int, int]:
    """m and q with ``q / m <= delta``, equal where delta has two decimals."""
    if delta < SMALLEST:
        raise InputError(f"`delta` must be at least {SMALLEST:g} for noise='symmetric'")
    m = max(SIZE, math.ceil(1.0 / delta - 1e-9))
    return m, math.floor(delta * m + 1e-9)


def chance_of_infinity(N: int, d: int) -> float:
    """P(one sign vector bounds nothing) for z in general position: ``2 P(Bin(N, 1/2) < d)``."""
    if 2 * (d - 1) >= N:
        return 1.0
    log = [math.lgamma(N + 1) - math.lgamma(k + 1) - math.lgamma(N - k + 1) for k in range(d)]
    return min(1.0, 2.0 * math.fsum(math.exp(value - N * math.log(2.0)) for value in log))
