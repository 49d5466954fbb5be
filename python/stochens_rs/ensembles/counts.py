"""How often every entry was hit, without the realizations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate
from .._base.records import by_constructor
from ..exceptions import InputError, InputTypeError, ShapeError
from ..rng import Key
from .law import Law

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Counts:
    """Hits of every entry in N realizations that were not drawn one by one.

    Attributes
    ----------
    counts : ndarray of int64, shape (n,) or (n, m)
        ``counts[i, j]``: realizations that hit entry (i, j). Zero in a zero line.
    estimate : ndarray, same shape
        The uniform average ``g_j sign(A_ij) counts[i, j] / N``.
    size : int
        Number of realizations N.
    key : Key
        The key the draw can be repeated with.
    law : Law or None
        What was drawn from; None if that is not known.
    """

    counts: NDArray[np.int64]
    estimate: NDArray[np.float64]
    size: int
    key: Key
    law: Law | None = None

    def __post_init__(self) -> None:
        if type(self.counts) is not np.ndarray or self.counts.dtype != np.int64:
            raise InputTypeError(
                f"`counts` must be a numpy.ndarray of int64, got {gate.show(self.counts)}"
            )
        gate.kept("estimate", self.estimate, shape=self.counts.shape)
        gate.size("size", self.size)
        gate.instance("key", self.key, Key)
        if self.counts.min() < 0:
            raise InputError(f"`counts` must be >= 0, got {self.counts.min()}")
        if self.law is not None:
            self._check_law(gate.instance("law", self.law, Law))

    def _check_law(self, law: Law) -> None:
        """Refuse a law that these cannot be the counts of."""
        if law.values.shape != self.shape:
            raise ShapeError(
                f"`law` must have values of shape {self.shape}, got {law.values.shape}"
            )
        along = 1 if law.axis == "rows" and law.values.ndim == 2 else 0
        # exact: at most 2^53; cast at once: short of memory, NumPy's buffered loops crash
        hits = self.counts.astype(np.float64).sum(axis=along)
        expected = np.where(law.values.any(axis=along), float(self.size), 0.0)
        beside = (law.values == 0.0) & (self.counts != 0)
        if (hits != expected).any() or beside.any():
            raise InputError(f"`counts` must add up to {self.size} in every line that is drawn")

    def __reduce__(self) -> tuple[Any, ...]:
        return by_constructor(self)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the vector or matrix."""
        return self.counts.shape
