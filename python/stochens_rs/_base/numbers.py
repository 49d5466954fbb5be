"""Arithmetic without overflow and underflow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
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
