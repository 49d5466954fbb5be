"""What an uncertain A and B do to the best control within limits: see ``_core.Horizon.apart``."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from .._base.types import Floats

HARD = "with hard limits of the states the best control may move by any multiple of an error"
SMALL = "the inputs have too little weight for what is known of the system: give a larger R"


class Around(NamedTuple):
    """Where the true A and B are around those that a control was computed with.

    `radii` are bounds of ``||A - A^||`` and ``||B - B^||``. The differences are `shifts`, if there
    are any, and a sum of D with ``||D' p|| <= sqrt(factor p' S p) length``, a part ``(factor, S,
    length for A, length for B)`` each.
    """

    radii: tuple[float, float]
    shifts: tuple[Floats, Floats] | None
    parts: list[tuple[float, Floats, float, float]]


def product(a: float, b: float) -> float:
    """``a b``, where 0 times infinity is 0: nothing to bound."""
    return 0.0 if a == 0.0 or b == 0.0 else float(a) * float(b)
