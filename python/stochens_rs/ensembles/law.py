"""`Law` and `Counts`: the distribution of realizations, and how many hit each entry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .._base import running, validation
from .._base.records import Count, Dense, Record, SavedRecord
from .._base.types import Axis, Floats, Scheme
from ..exceptions import InputError, ShapeError
from ..rng import Key


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

    values: Dense
    axis: Axis
    scheme: Scheme


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
    running.need("the dense realizations", (draws.size * entries + 4 * largest) * 8)
    out = np.empty((draws.size, *shape))
    first = 0
    for block in dense_blocks(draws, shape, axis, rows):
        out[first : first + len(block)] = block
        first += len(block)
    return out


@dataclass(frozen=True, eq=False)
class Counts(SavedRecord):
    """How many of N realizations hit each entry.

    Attributes
    ----------
    counts : ndarray of int64, shape (n,) or (n, m)
        ``counts[i, j]``: how many realizations hit entry (i, j); 0 in a zero line.
    estimate : ndarray, same shape
        The uniform average ``g_j sign(A_ij) counts[i, j] / N``.
    size : int
        Number of realizations N.
    key : Key
        The key to repeat the draw.
    law : Law or None
        The law of the realizations; None if unknown.
    """

    counts: NDArray[np.int64]
    estimate: Floats
    size: Count
    key: Key
    law: Law | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.kept("estimate", self.estimate, shape=self.counts.shape)
        if self.counts.min() < 0:
            raise InputError(f"`counts` must be >= 0, got {self.counts.min()}")
        law = self.law
        if law is None:
            return
        if law.values.shape != self.shape:
            raise ShapeError(
                f"`law` must have values of shape {self.shape}, got {law.values.shape}"
            )
        along = 1 if law.axis == "rows" and law.values.ndim == 2 else 0
        # Sums up to 2^53 are exact. Converted in one step: NumPy's buffered loops, which mix
        # types, crash if memory runs out.
        hits = self.counts.astype(np.float64).sum(axis=along)
        expected = np.where(law.values.any(axis=along), float(self.size), 0.0)
        outside = (law.values == 0.0) & (self.counts != 0)
        if (hits != expected).any() or outside.any():
            raise InputError(f"`counts` must add up to {self.size} in every nonzero line")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the vector or matrix."""
        return self.counts.shape
