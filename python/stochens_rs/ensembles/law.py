"""What realizations were drawn from, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate
from .._base.records import by_constructor
from .._base.types import Axis, Scheme

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Law:
    """The vector or matrix that realizations were drawn from, and how.

    Attributes
    ----------
    values : ndarray, shape (n,) or (n, m)
        What they average to.
    axis : str
        "columns" or "rows": which lines of a matrix were drawn independently.
    scheme : str
        "iid" or "systematic", as in `sample`.
    """

    values: NDArray[np.float64]
    axis: Axis
    scheme: Scheme

    def __post_init__(self) -> None:
        gate.kept("values", self.values)
        checked_axis(self.axis)
        checked_scheme(self.scheme)

    def __reduce__(self) -> tuple[Any, ...]:
        return by_constructor(self)


def checked_axis(axis: str) -> Axis:
    """Return which lines of a matrix are drawn independently."""
    return "rows" if gate.choice("axis", axis, ("columns", "rows")) == "rows" else "columns"


def checked_scheme(scheme: str) -> Scheme:
    """Return how realizations are drawn."""
    name = gate.choice("scheme", scheme, ("iid", "systematic"))
    return "iid" if name == "iid" else "systematic"
