"""What to be careful about in least squares, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .. import _core
    from .._base.types import Floats

# ratio of singular values, about sqrt(EPS), below which a decision on the rank is delicate: the
# directions that the data do not determine are then known to fewer than half of the digits
TRUSTED = 1e-8


def missing_directions(found: Sequence[_core.Fitted], names: Sequence[str]) -> tuple[str, ...]:
    """The directions that the data do not determine in any block, ``x[1] - 0.5 u[0]``."""
    said: dict[str, None] = {}
    for block in found:
        own = [names[j] for j in block.columns]
        said |= dict.fromkeys(_combination(row, own) for row in block.combinations())
    return tuple(said)


def _combination(row: Floats, names: Sequence[str]) -> str:
    text = ""
    for value, name in zip(row, names, strict=True):
        if value == 0.0:
            continue
        number = "" if abs(abs(value) - 1.0) < 5e-4 else f"{abs(value):.3g} "
        sign = ("-" if value < 0.0 else "") if not text else (" - " if value < 0.0 else " + ")
        text += f"{sign}{number}{name}"
    return text


def cautions(found: Sequence[_core.Fitted], missing: tuple[str, ...]) -> list[str]:
    """What to be careful about in the fits of the rows of a model."""
    said = []
    if missing:
        said.append(f"the data do not determine the model along {'; '.join(missing)}")
    ratio = min((one.ratio for one in found if one.rank), default=1.0)
    if ratio < TRUSTED:
        said.append(
            f"the states and inputs are nearly dependent (ratio {ratio:.1e}): bounds are large"
        )
    return said
