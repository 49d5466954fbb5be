"""Single coefficients of ``[A B c]``: their names, and whether they are estimated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from .._base import validation
from ..exceptions import InputError, ShapeError

if TYPE_CHECKING:
    from .. import _core


def coefficient(entry: tuple[int, int], n: int, m: int) -> str:
    """The name of an entry of ``[A B c]``."""
    i, j = entry
    return f"A[{i}, {j}]" if j < n else f"B[{i}, {j - n}]" if j < n + m else f"c[{i}]"


def chosen_entry(
    argument: str, entry: object, size: tuple[int, int, int], parts: Sequence[_core.RegionPart]
) -> tuple[int, int]:
    """Row and column of a coefficient that is not known; `size` is n, m and the columns."""
    n, m, d = size
    pair = validation.items(argument, entry)
    if len(pair) != 2:
        raise ShapeError(f"`{argument}` must be (row, column), got {len(pair)} items")
    i = validation.size(argument, pair[0], minimum=0, maximum=n - 1)
    j = validation.size(argument, pair[1], minimum=0, maximum=d - 1)
    if not any(i in part.rows and j in part.columns for part in parts):
        raise InputError(f"`{argument}` must be estimated, {coefficient((i, j), n, m)} is known")
    return i, j
