"""Arithmetic without overflow and underflow, and the smallest sufficient size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import gate

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Relative differences up to 4 500 eps are rounding: sums of n terms in pairs lose log2(n) eps
# (Higham, Accuracy and Stability of Numerical Algorithms (2002), 4.2), sampling errors are larger.
ROUNDING = 1e-12
TINY = 1e-300  # in place of 0 below a fraction or in a logarithm; its inverse is finite


def norm(values: Floats) -> float:
    """Return the 2-norm of all entries, scaled so that no square overflows or underflows."""
    largest = float(np.abs(values).max())
    return largest and largest * float(np.linalg.norm((values / largest).ravel()))


def smallest_size(enough: Callable[[int], bool]) -> int | None:
    """Smallest size in 1 .. 2^53 for which `enough` is true; None if 2^53 is not enough.

    Doubling from 1, then bisection: what is enough must stay enough for larger sizes.
    """
    if enough(1):
        return 1
    too_few, sufficient = 1, 2
    while not enough(sufficient):
        if sufficient >= gate.EXACT:
            return None
        too_few, sufficient = sufficient, 2 * sufficient
    while sufficient - too_few > 1:
        middle = (too_few + sufficient) // 2
        too_few, sufficient = (too_few, middle) if enough(middle) else (middle, sufficient)
    return sufficient
