"""Arithmetic that neither overflows nor vanishes, and the smallest sufficient whole number."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# Largest whole number up to which every whole number is a float64.
_LARGEST = 2**53


def norm(values: Floats) -> float:
    """2-norm of all entries, scaled so that squares neither overflow nor vanish."""
    largest = float(np.abs(values).max())
    return largest and largest * float(np.linalg.norm((values / largest).ravel()))


def smallest_size(enough: Callable[[int], bool]) -> int | None:
    """The smallest size in 1 .. 2^53 that is enough, as all larger ones must be; None: none is.

    Doubles from 1 on, then bisects.
    """
    too_few, size = 0, 1
    while not enough(size):
        if size >= _LARGEST:
            return None
        too_few, size = size, 2 * size
    while size - too_few > 1:
        middle = (too_few + size) // 2
        too_few, size = (too_few, middle) if enough(middle) else (middle, size)
    return size
