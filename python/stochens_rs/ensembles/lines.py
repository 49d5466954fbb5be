"""Conversion of vectors and matrices to the layout of the core, ``(lines, length)``, and back.

A line is what is drawn independently: a vector, or a column (or row) of a matrix.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import validation
from .._base.types import Axis, Floats
from .law import checked_axis

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def checked_target(target: ArrayLike, axis: str) -> tuple[Floats, Axis]:
    """Check a vector or matrix to be sampled, and the axis of its lines."""
    checked = checked_axis(axis)
    return validation.array("target", target, ndim=(1, 2)), checked


def to_lines(values: Floats, axis: Axis) -> Floats:
    """Return a vector as one row, a matrix with its lines as rows."""
    if values.ndim == 1:
        return values.reshape(1, -1)
    return np.ascontiguousarray(values.T) if axis == "columns" else values


def from_lines(values: NDArray[Any], shape: tuple[int, ...], axis: Axis) -> NDArray[Any]:
    """Undo `to_lines`."""
    if len(shape) == 1:
        return values.reshape(shape)
    return np.ascontiguousarray(values.T) if axis == "columns" else values


def stack_from_lines(values: NDArray[Any], shape: tuple[int, ...], axis: Axis) -> NDArray[Any]:
    """Undo `to_lines` for every row of (k, entries)."""
    if len(shape) == 1 or axis == "rows":
        return values.reshape(-1, *shape)
    return np.ascontiguousarray(values.reshape(-1, shape[1], shape[0]).transpose(0, 2, 1))
