"""Sign-perturbed sums: regions for independent symmetric noise of any law.

If the w_t are independent, symmetric and independent of all z_t, the true Theta makes
``S_a = sum a_t e_t(Theta) b_t'`` equal in law for all sign vectors a, with
``e_t(Theta) = y_t - Theta z_t`` and the whitened ``b_t``: the rank of ``||S_1||_F`` among m of them
is uniform, so that {||S_1|| is not among the q largest} has probability 1 - q / m (Csaji, Campi
and Weyer 2015).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.records import Record
from .._base.threads import get_num_threads
from ..rng import Key

if TYPE_CHECKING:
    from .._base.types import Floats


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

    @property
    def _of(self) -> tuple[Floats, Floats, Floats, int, int, bytes]:
        arrays = map(np.ascontiguousarray, (self.Z, self.Y, self.basis))
        return *arrays, self.size, self.largest, bytes(self.key)  # type: ignore[return-value]

    def contains(self, Theta: Floats) -> bool:
        """Whether the set contains `Theta`; ties count as inside, which is safe."""
        return _core.sign_contains(self._of, Theta, get_num_threads())
