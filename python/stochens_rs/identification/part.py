"""A part of a region: a bound on some rows of the matrix of a model.

With ``Theta = [A B c]`` and ``z = (x, u, 1)``, a part of a region is
``(Theta - C) V (Theta - C)' <= factor S`` in the order of symmetric matrices, for some rows of
Theta. By Cauchy and Schwarz, for all z at once, also for z chosen after the data,
``||(Theta - C) z|| <= sqrt(factor ||S||) ||z||`` in the norm of V^-1, and no bound for z off the
range of V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._base import validation
from .._base.records import Record, require_shapes
from ..theory.exact import EPS
from .least_squares import Fitted, length

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats

WIDER = 10.0


@dataclass(frozen=True, eq=False)
class Part(Record):
    """``(Theta - C) V (Theta - C)' <= factor S`` for some rows and columns of Theta.

    Attributes
    ----------
    rows, columns : ndarray of int64
        Which.
    white, root, missing : ndarray
        Factors of V^+ and V, and the directions that the data do not determine.
    ratio : float
        Smallest over largest singular value of the scaled data.
    S : ndarray, shape (rows, rows)
        The shape of the region.
    factor : float
        Its size; may be infinite.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    white: Floats
    root: Floats
    missing: Floats
    ratio: float
    S: Floats
    factor: float

    def __post_init__(self) -> None:
        validation.kept("S", self.S, ndim=(2,))
        require_shapes(self, S=(len(self.rows),) * 2)

    @classmethod
    def of(
        cls,
        fitted: Fitted,
        rows: NDArray[np.int64],
        columns: NDArray[np.int64],
        S: Floats,
        factor: float,
    ) -> Part:
        """The part around least squares, widened by its rounding.

        With rows wrong by r, in the data and in D, ``||l' D V^1/2||`` is at most ``sqrt(factor)
        (||l' E|| + |l|' r) + |l|' r``, and ``(|l|' r)^2 <= n l' diag(r^2) l``. The factor WIDER
        takes the product of both terms, up to 2 / WIDER^2 of the first one.
        """
        if 0.0 < factor < np.inf:
            r = WIDER * (1.0 + factor**-0.5) * fitted.rounding
            S = S + len(S) * np.diag(r**2)
        some = fitted.white, fitted.root, fitted.missing, fitted.ratio
        return cls(rows, columns, *some, S, factor)

    @property
    def radius(self) -> float:
        """``sqrt(factor ||S||)``."""
        if not np.isfinite(self.factor):
            return np.inf
        return float(np.sqrt(self.factor * np.linalg.norm(self.S, 2)))

    @property
    def deviations(self) -> Floats:
        """``sqrt(factor S_ii)``."""
        if not np.isfinite(self.factor):
            return np.full(len(self.S), np.inf)
        return np.sqrt(self.factor * np.maximum(np.diag(self.S), 0.0))

    def length(self, z: Floats) -> float:
        """``||z||`` in the norm of V^-1, infinite off the range of V."""
        return length(self.white, self.missing, self.ratio, z[self.columns])

    def contains(self, difference: Floats) -> bool:
        """Whether this difference of Theta from the centre is in the part."""
        if not np.isfinite(self.factor):
            return True
        inside = difference[np.ix_(self.rows, self.columns)]
        n, terms = len(inside), sum(self.root.shape)
        with np.errstate(over="ignore", invalid="ignore"):
            X = inside @ self.root.T
            # in units of the rows, those of S or of the rounding of X: no units, no singular S
            rounding = terms * EPS * (np.abs(inside) @ np.linalg.norm(self.root, axis=0))
            sizes = np.hypot(self.deviations, rounding)
            if np.any(X[sizes == 0.0]):
                return False
            sizes = np.where(sizes == 0.0, 1.0, sizes)
            X /= sizes[:, None]
        if not np.isfinite(X).all() or np.abs(X).max(initial=0.0) > 2.0:
            return False
        room = self.factor * self.S / sizes[:, None] / sizes
        room += n * np.diag((rounding / sizes) ** 2)
        # entries of up to 1, wrong by the rounding of `terms` products, and the eigenvalues by n
        least = np.linalg.eigvalsh(room - X @ X.T)[0]
        return bool(least >= -n * (terms + n) * EPS)
