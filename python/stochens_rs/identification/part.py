"""A part of a region: a bound on some rows of the matrix of a model.

With ``Theta = [A B c]`` and ``z = (x, u, 1)``, a part of a region is
``(Theta - C) V (Theta - C)' <= factor S`` in the order of symmetric matrices, for some rows of
Theta. By Cauchy and Schwarz, for all z at once, also for z chosen after the data,
``||(Theta - C) z|| <= sqrt(factor ||S||) ||z||`` in the norm of V^-1, and no bound for z off the
range of V.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import validation
from .._base.records import Record, require_shapes, trusted
from .least_squares import Fitted

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
        return trusted(
            cls,
            rows=rows,
            columns=columns,
            white=fitted.white,
            root=fitted.root,
            missing=fitted.missing,
            ratio=fitted.ratio,
            S=validation.kept("S", S, ndim=(2,)),
            factor=factor,
        )

    @cached_property
    def _core(self) -> _core.RegionPart:
        return _core.RegionPart(
            self.rows,
            self.columns,
            np.ascontiguousarray(self.white),
            np.ascontiguousarray(self.root),
            np.ascontiguousarray(self.missing),
            self.ratio,
            np.ascontiguousarray(self.S),
            self.factor,
        )

    @property
    def radius(self) -> float:
        """``sqrt(factor ||S||)``."""
        return self._core.radius

    def length(self, z: Floats) -> float:
        """``||z||`` in the norm of V^-1, infinite off the range of V."""
        return self._core.length(z)
