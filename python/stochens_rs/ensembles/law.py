"""What realizations are: their law, their lines as the core has them, and dense.

A line is what is drawn independently: a vector, or a column (or row) of a matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import memory, validation
from .._base.records import Record
from .._base.types import AXES, SCHEMES, Axis, Floats, Scheme

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray


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


_BLOCK = 2**20  # entries written at a time, 8 MiB; between two blocks Ctrl-C is handled


def dense_blocks(
    draws: _core.Draws, shape: tuple[int, ...], axis: Axis, rows: int
) -> Iterator[Floats]:
    """Yield `rows` realizations at a time, each block of shape (rows, *shape)."""
    for first in range(0, draws.size, rows):
        index = draws.indices()[first : first + rows].astype(np.intp)
        atoms = draws.atoms()
        out = np.zeros((len(index), *atoms.shape))
        s, j = np.arange(len(index))[:, None], np.arange(len(atoms))[None, :]
        out[s, j, index] = atoms[j, index]
        yield stack_from_lines(out.reshape(len(index), -1), shape, axis)


def dense(draws: _core.Draws, shape: tuple[int, ...], axis: Axis) -> Floats:
    """Return all realizations, shape (N, *shape)."""
    entries = int(np.prod(shape))
    rows = max(1, _BLOCK // entries)
    # the result, and four arrays of the size of a block
    largest = min(rows, draws.size) * entries
    memory.need("the dense realizations", (draws.size * entries + 4 * largest) * 8)
    out = np.empty((draws.size, *shape))
    first = 0
    for block in dense_blocks(draws, shape, axis, rows):
        out[first : first + len(block)] = block
        first += len(block)
    return out
