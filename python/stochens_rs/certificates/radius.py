"""How far one quantity can be from another one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._base import html, validation
from .._base.records import Record, trusted
from .._base.types import Floats
from ..exceptions import InputError, ShapeError


@dataclass(frozen=True, eq=False, repr=False)
class Radius(Record):
    """A quantity is at most `radius` away from another one; an entry of a `Certificate`.

    Attributes
    ----------
    radius : float or ndarray
        The bound, in the units of the quantity. Of several entries, for each step, component or
        both, all hold together.
    distance_from : str
        What it is the distance from.
    probability : float
        It holds with this probability at least; 1 where nothing is random.
    method : str
        What gave it.
    reason : str or None
        Why it is infinite, or larger than what another method gives.
    """

    radius: float | Floats
    distance_from: str
    probability: float
    method: str
    reason: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        found = np.asarray(self.radius)
        if found.ndim > 2:
            raise ShapeError(f"`radius` must have at most two dimensions, got {found.ndim}")
        if not (found >= 0.0).all():
            raise InputError(f"`radius` must be >= 0, got {validation.show(self.radius)}")
        if not 0.0 < self.probability <= 1.0:
            raise InputError(f"`probability` must be in (0, 1], got {self.probability:g}")
        if np.isinf(found).any() and not self.reason:
            raise InputError("`reason` must say why `radius` is infinite, got None")

    @classmethod
    def _at(
        cls,
        radius: float | Floats,
        distance_from: str,
        delta: float,
        method: str,
        reason: str | None,
    ) -> Radius:
        """One that holds with probability ``1 - delta``; its `reason` only where it is infinite."""
        because = None if np.isfinite(radius).all() else reason
        return trusted(Radius, radius, distance_from, 1.0 - delta, method, because)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Radius) and self.to_dict() == other.to_dict()

    __hash__ = None  # type: ignore[assignment]

    @property
    def text(self) -> str:
        """The bound in words."""
        if np.ndim(self.radius):
            each = np.asarray(self.radius)  # of a table the largest of all steps
            size = html.vector(each if each.ndim == 1 else each.max(axis=0, initial=0.0))
        else:
            size = html.at_most(float(self.radius))
        if np.isinf(self.radius).all():
            return f"not bounded: {self.reason}"
        because = f"; {self.reason}" if self.reason else ""
        return f"within {size} of {self.distance_from} ({self.method}){because}"

    def __repr__(self) -> str:
        return f"<Radius: {self.text}>"

    def _repr_html_(self) -> str:
        return html.card(self, [("with probability", self.probability)])
