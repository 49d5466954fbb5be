"""`Counts`: how many realizations hit each entry, without the realizations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._base import validation
from .._base.records import SavedRecord
from .._base.types import Floats
from ..exceptions import InputError, InputTypeError, ShapeError
from ..rng import Key
from .law import Law

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Counts(SavedRecord):
    """How many of N realizations hit each entry.

    Attributes
    ----------
    counts : ndarray of int64, shape (n,) or (n, m)
        ``counts[i, j]``: how many realizations hit entry (i, j); 0 in a zero line.
    estimate : ndarray, same shape
        The uniform average ``g_j sign(A_ij) counts[i, j] / N``.
    size : int
        Number of realizations N.
    key : Key
        The key to repeat the draw.
    law : Law or None
        The law of the realizations; None if unknown.
    """

    counts: NDArray[np.int64]
    estimate: Floats
    size: int
    key: Key
    law: Law | None = None

    def __post_init__(self) -> None:
        if type(self.counts) is not np.ndarray or self.counts.dtype != np.int64:
            raise InputTypeError(
                f"`counts` must be a numpy.ndarray of int64, got {validation.show(self.counts)}"
            )
        validation.kept("estimate", self.estimate, shape=self.counts.shape)
        validation.size("size", self.size)
        validation.instance("key", self.key, Key)
        if self.counts.min() < 0:
            raise InputError(f"`counts` must be >= 0, got {self.counts.min()}")
        if self.law is not None:
            self._check_law(validation.instance("law", self.law, Law))

    def _check_law(self, law: Law) -> None:
        """Refuse a law that cannot give these counts."""
        if law.values.shape != self.shape:
            raise ShapeError(
                f"`law` must have values of shape {self.shape}, got {law.values.shape}"
            )
        along = 1 if law.axis == "rows" and law.values.ndim == 2 else 0
        # Sums up to 2^53 are exact. Converted in one step: NumPy's buffered loops, which mix
        # types, crash if memory runs out.
        hits = self.counts.astype(np.float64).sum(axis=along)
        expected = np.where(law.values.any(axis=along), float(self.size), 0.0)
        outside = (law.values == 0.0) & (self.counts != 0)
        if (hits != expected).any() or outside.any():
            raise InputError(f"`counts` must add up to {self.size} in every nonzero line")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the vector or matrix."""
        return self.counts.shape
