"""Arithmetic without overflow and underflow, and the smallest sufficient size."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np

from . import validation
from .types import Floats

# Relative differences up to 4 500 eps are rounding: sums of n terms in pairs lose log2(n) eps
# (Higham, Accuracy and Stability of Numerical Algorithms (2002), 4.2), sampling errors are larger.
ROUNDING = 1e-12


def norm(values: Floats) -> float:
    """Return the 2-norm of all entries, scaled so that no square overflows or underflows."""
    largest = float(np.abs(values).max())
    if largest == np.inf:  # and not inf / inf
        return largest
    return largest and largest * float(np.linalg.norm((values / largest).ravel()))


def shared(a: Floats, b: Floats) -> int:
    """How many different rows of `b` are rows of `a`, but for rounding of the largest entries.

    Rows are sorted by one combination of their entries, and compared where it is the same.
    """
    a, b = np.unique(a, axis=0), np.unique(b, axis=0)
    size = np.maximum(np.abs(a).max(axis=0), np.abs(b).max(axis=0))
    size[size == 0.0] = 1.0
    a, b = a / size, b / size
    along = 1.0 + np.arange(len(size)) * 0.6180339887498949 % 1.0
    order = np.argsort(a @ along)
    a, near = a[order], ROUNDING * along.sum()
    first = np.searchsorted(a @ along, b @ along - near, "left")
    last = np.searchsorted(a @ along, b @ along + near, "right")
    return sum(
        bool((np.abs(a[first[i] : last[i]] - b[i]) <= ROUNDING).all(axis=1).any())
        for i in np.flatnonzero(last > first)
    )


def most_changing(curves: Floats, most: int) -> list[int]:
    """The places of the columns that change most, at most so many, in their order."""
    with np.errstate(over="ignore", invalid="ignore"):
        order = np.argsort(-np.ptp(curves, axis=0), kind="stable")
    return sorted(order[:most].tolist())


def smallest_size(enough: Callable[[int], bool]) -> int | None:
    """The smallest size in 1 .. 2^53 that is enough, as all larger ones must be; None: none is."""
    sizes = range(1, validation.EXACT + 1)
    at = bisect_left(sizes, True, key=enough)
    return sizes[at] if at < len(sizes) else None
