"""`Law`: the distribution that realizations are drawn from."""

from __future__ import annotations

from dataclasses import dataclass

from .._base import validation
from .._base.records import Record
from .._base.types import AXES, SCHEMES, Axis, Floats, Scheme


@dataclass(frozen=True, eq=False)
class Law(Record):
    """The distribution of realizations.

    Attributes
    ----------
    values : ndarray, shape (n,) or (n, m)
        The mean of the realizations.
    axis : {"columns", "rows"}
        Which lines of a matrix are drawn independently.
    scheme : {"iid", "systematic"}
        As in `sample`.
    """

    values: Floats
    axis: Axis
    scheme: Scheme

    def __post_init__(self) -> None:
        validation.kept("values", self.values)
        checked_axis(self.axis)
        checked_scheme(self.scheme)


def checked_axis(axis: str) -> Axis:
    """Return `axis` if it is "columns" or "rows"."""
    return validation.choice("axis", axis, AXES)


def checked_scheme(scheme: str) -> Scheme:
    """Return `scheme` if it is "iid" or "systematic"."""
    return validation.choice("scheme", scheme, SCHEMES)
