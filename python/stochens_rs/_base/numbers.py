"""Arithmetic without overflow and underflow, and the smallest sufficient size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import validation
from .types import Floats

if TYPE_CHECKING:
    from collections.abc import Callable


# Relative differences up to 4 500 eps are rounding: sums of n terms in pairs lose log2(n) eps
# (Higham, Accuracy and Stability of Numerical Algorithms (2002), 4.2), sampling errors are larger.
ROUNDING = 1e-12
TINY = 1e-300  # in place of 0 below a fraction or in a logarithm; its inverse is finite


def norm(values: Floats) -> float:
    """Return the 2-norm of all entries, scaled so that no square overflows or underflows."""
    largest = float(np.abs(values).max())
    if largest == np.inf:  # and not inf / inf
        return largest
    return largest and largest * float(np.linalg.norm((values / largest).ravel()))


def most_changing(curves: Floats, most: int) -> list[int]:
    """The places of the columns that change most, at most so many, in their order."""
    with np.errstate(over="ignore", invalid="ignore"):
        order = np.argsort(-np.ptp(curves, axis=0), kind="stable")
    return sorted(order[:most].tolist())


def smallest_size(enough: Callable[[int], bool]) -> int | None:
    """The smallest size in 1 .. 2^53 that is enough, as all larger ones must be; None: none is.

    Doubles from 1 on, then bisects.
    """
    too_few, size = 0, 1
    while not enough(size):
        if size >= validation.EXACT:
            return None
        too_few, size = size, 2 * size
    while size - too_few > 1:
        middle = (too_few + size) // 2
        too_few, size = (too_few, middle) if enough(middle) else (middle, size)
    return size
