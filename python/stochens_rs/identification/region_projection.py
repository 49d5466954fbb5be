"""The shadow of a region on the plane of two coefficients.

A part is ``Theta - C = sqrt(factor) S^(1/2) W V^(-1/2)`` with ``||W|| <= 1``. In the direction
``G = cos(t) e_i e_j' + sin(t) e_k e_l'`` it reaches as far as the nuclear norm
``sqrt(factor) ||S^(1/2) G V^(-1/2)||_*``, the dual of the spectral norm. ``G`` has rank two, hence
``||.||_*^2 = trace + 2 sqrt(det)`` of a 2 by 2 matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._base import validation
from ..exceptions import InputError, ShapeError

if TYPE_CHECKING:
    from .._base.types import Floats
    from .part import Part

DIRECTIONS = 720  # a multiple of 4, so that a box keeps its corners


def shadow(parts: Sequence[Part], one: tuple[int, int], other: tuple[int, int]) -> Floats | None:
    """Corners (DIRECTIONS, 2) around the shadow of ``Theta - C``; None if it is not bounded.

    `one` and `other` are (row, column) of entries that are in a part. The polygon is made of
    tangents, so it contains the shadow.
    """
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    cos, sin = np.cos(angles), np.sin(angles)
    first, second = (next(p for p in parts if _has(p, entry)) for entry in (one, other))
    sizes = [_reach(first, one), _reach(second, other)]
    if not np.isfinite(sizes).all():
        return None
    if first is not second:  # rows of their own: each entry whatever the other one is
        reach = np.abs(cos) * sizes[0] + np.abs(sin) * sizes[1]
    else:
        i, k = (list(first.rows).index(entry[0]) for entry in (one, other))
        w = [first.white[:, list(first.columns).index(entry[1])] for entry in (one, other)]
        across, up, both = (
            sizes[0] ** 2,
            sizes[1] ** 2,
            first.factor * first.S[i, k] * (w[0] @ w[1]),
        )
        in_rows = first.S[i, i] * first.S[k, k] - first.S[i, k] ** 2
        in_columns = (w[0] @ w[0]) * (w[1] @ w[1]) - (w[0] @ w[1]) ** 2
        det = first.factor**2 * max(in_rows, 0.0) * max(in_columns, 0.0)
        trace = cos**2 * across + 2.0 * cos * sin * both + sin**2 * up
        reach = np.sqrt(np.maximum(trace + 2.0 * np.abs(cos * sin) * np.sqrt(det), 0.0))
    # where the tangents of neighbouring directions meet
    after, cos1, sin1 = np.roll(reach, -1), np.roll(cos, -1), np.roll(sin, -1)
    corners = np.stack([reach * sin1 - after * sin, after * cos - reach * cos1], axis=1)
    return np.asarray(corners / np.sin(2.0 * np.pi / DIRECTIONS), dtype=np.float64)


def coefficient(entry: tuple[int, int], n: int, m: int) -> str:
    """The name of an entry of ``[A B c]``."""
    i, j = entry
    return f"A[{i}, {j}]" if j < n else f"B[{i}, {j - n}]" if j < n + m else f"c[{i}]"


def chosen_entry(
    argument: str, entry: object, size: tuple[int, int, int], parts: Sequence[Part]
) -> tuple[int, int]:
    """Row and column of a coefficient that is not known; `size` is n, m and the columns."""
    n, m, d = size
    pair = validation.items(argument, entry)
    if len(pair) != 2:
        raise ShapeError(f"`{argument}` must be (row, column), got {len(pair)} items")
    i = validation.size(argument, pair[0], minimum=0, maximum=n - 1)
    j = validation.size(argument, pair[1], minimum=0, maximum=d - 1)
    if not any(_has(part, (i, j)) for part in parts):
        raise InputError(f"`{argument}` must be estimated, {coefficient((i, j), n, m)} is known")
    return i, j


def _has(part: Part, entry: tuple[int, int]) -> bool:
    return entry[0] in part.rows and entry[1] in part.columns


def _reach(part: Part, entry: tuple[int, int]) -> float:
    """``sqrt(factor S_ii) ||e_j||``, how far one entry can be from that of the centre."""
    row, column = entry
    unit = np.zeros(int(part.columns.max()) + 1)
    unit[column] = 1.0
    deviation = float(part.deviations[list(part.rows).index(row)])
    return deviation * part.length(unit) if deviation else 0.0
