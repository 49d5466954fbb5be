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

from .._base import gate
from .._base.records import Record, require_shapes
from .least_squares import Fitted, length

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats


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
        gate.kept("S", self.S, ndim=(2,))
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
        """The part around least squares."""
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
        with np.errstate(over="ignore", invalid="ignore"):
            X = difference[np.ix_(self.rows, self.columns)] @ self.root.T
            square = X @ X.T
        if not np.isfinite(square).all():
            return False
        return bool(np.linalg.eigvalsh(self.factor * self.S - square)[0] >= 0.0)
